//! A run from its first frame to its last file.

use super::align::{Align, MapFrame, Scene};
use super::conclusion::verdict;
use super::outputs::{self, Ground, MapPictures, Playback, Surface, path_of};
use super::progress::watched;
use super::report::{ReportInput, write_page};
use super::sensed::{Sensed, sense};
use super::sessions::{RECORDING, tracked_frame};
use super::summary::{Summary, is_metric, unit_name};
use super::threads::{Tracked, track};
use super::tracking::EarlyEnd;
use super::{MemoryLimit, RunSettings};
use crate::colours::Colours;
use crate::explorer::{SemiDense, ShownKeyframe};
use crate::failure::{Failure, Outcome};
use crate::input::{Images, Input, MAX_UNREADABLE_IN_A_ROW};
use crate::memory;
use crate::output::OutputFolder;
use crate::surface::{CellColours, ColouredScan};
use crate::usage::{peak_rss_bytes, process_cpu};
use monogrid_datasets::TimedPose;
use monogrid_evaluation::{DepthReport, MapReport};
use monogrid_geometry::{Pinhole, Se3, Sim3, Vec3};
use monogrid_slam::mapping::{
    ImageOf, KeyframeCamera, KeyframeScan, Maps, SceneCell, UprightView, scene_cell,
};
use monogrid_slam::{KeptKeyframe, TrackedFrame};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// What a caller adds to summary and report.
#[derive(Debug, Default)]
pub struct Extras {
    /// Error of the depth.
    pub depth: Option<DepthReport>,
    /// Error of the global map.
    pub map: Option<MapReport>,
    /// More for the user to know.
    pub warnings: Vec<String>,
}

/// A run whose files are written.
#[derive(Debug)]
pub struct Finished {
    /// Numbers.
    pub summary: Summary,
    /// One sentence for people.
    pub verdict: String,
    /// Which exit code.
    pub outcome: Outcome,
    /// Why it failed although everything that exists was saved.
    pub failure: Option<String>,
}

/// Where the camera was, in the frame of the results.
struct Paths {
    /// All that is known at the end.
    path: Vec<[f64; 3]>,
    /// As it was reported frame by frame, where loops have changed it.
    reported: Option<Vec<[f64; 3]>>,
}

/// Tracks, maps and writes everything. `extras` may evaluate against a truth.
pub fn run_all(
    input: &Input,
    folder: &Arc<OutputFolder>,
    settings: &RunSettings,
    align: &Align,
    extras: impl FnOnce(&Tracked, Option<&Maps>) -> Result<Extras, Failure>,
) -> Result<Finished, Failure> {
    save_when_interrupted();
    let config = settings.config.to_toml()?;
    folder.write("config.toml", &config)?;
    let mut tracked = track(input, folder, settings, &INTERRUPTED)?;
    let scans = final_depth(&mut tracked, settings.memory_limit, settings.show_progress);
    let mut looked = Looked::at(&tracked, &scans, align, input, settings);
    let (known, not_compared) = known_path(input, align, &tracked, &mut looked.frame);
    let poses = outputs::final_poses(&tracked, &looked.frame);
    outputs::write_tables(folder, &tracked, &looked.frame, &poses, settings)?;
    outputs::write_bridged(folder, &looked.sensed.bridged, &looked.frame)?;
    let paths = Paths::new(&poses, &tracked, &looked.frame);
    let posed = posed_keyframes(&tracked, &looked.frame);
    let shown = shown_keyframes(&posed, &scans, tracked.run.slam.pinhole());
    let colours = Colours::read(&folder.path().join(RECORDING))?;
    let unit = unit_name(is_metric(&tracked, &looked.frame));
    let edge = looked.edge(settings);
    let (cell_colours, written) = rayon::join(
        || CellColours::new(&coloured_scans(&posed, &scans), &colours, edge),
        || write_points(folder, &shown, &colours, unit),
    );
    written?;
    let built = final_maps(&mut tracked, scans, &looked, &paths.path, settings);
    let (maps, failure) = match built {
        Ok(maps) => (maps, early_failure(&tracked)),
        Err(error) => (None, Some(error)),
    };
    let write = |maps| {
        let (colours, config) = (&cell_colours, &settings.config.mapping.mesh);
        let surface = Surface { colours, config };
        let ground = ground(&tracked, &looked.frame);
        outputs::write_maps(folder, maps, paths.both(), ground, surface)
    };
    let pictures = maps.as_ref().map(write).transpose()?;
    let mut extras = extras(&tracked, maps.as_ref())?;
    let doubts = tracked.doubts.iter().cloned();
    extras.warnings.extend(doubts.chain(not_compared));
    let mut summary = summary(input, settings, &tracked, &looked, maps.as_ref(), extras);
    let results = Results {
        frame: &looked.frame,
        reference: Reference::new(&known, &poses),
        paths,
        shown,
        colours,
        maps,
        pictures,
        config,
    };
    results.play(settings, &tracked, &poses)?;
    let verdict = verdict(&summary, &tracked);
    let title = format!("monogrid: {}", input.name);
    let report = results.report(&title, &verdict, &summary);
    folder.write_with("report.html", |out| write_page(out, &tracked, &report))?;
    write_summary(folder, &mut summary)?;
    Ok(Finished {
        outcome: summary.status.outcome(),
        summary,
        verdict,
        failure,
    })
}

fn write_summary(folder: &OutputFolder, summary: &mut Summary) -> Result<(), Failure> {
    summary.take_times();
    let json = serde_json::to_string_pretty(&summary).map_err(Failure::running)?;
    folder.write("summary.json", json + "\n")
}

/// What the report shows.
struct Results<'a> {
    frame: &'a MapFrame,
    paths: Paths,
    reference: Reference,
    shown: Vec<ShownKeyframe<'a>>,
    colours: Colours,
    maps: Option<Maps>,
    pictures: Option<MapPictures>,
    config: String,
}

impl Results<'_> {
    /// Writes the run as messages, where it is asked for; what was needed for the maps alone is given back.
    fn play(
        &self,
        settings: &RunSettings,
        tracked: &Tracked,
        poses: &[TimedPose],
    ) -> Result<(), Failure> {
        leave_room(tracked, settings.memory_limit);
        let Some(file) = &settings.mcap else {
            return Ok(());
        };
        let playback = Playback {
            poses,
            keyframes: &self.shown,
            colours: &self.colours,
            map: self.maps.as_ref().map(|maps| &maps.global),
            ground: ground(tracked, self.frame),
        };
        file.write_with(|out| Ok(playback.write(out)?))
    }

    fn report<'a>(
        &'a self,
        title: &'a str,
        verdict: &'a str,
        summary: &'a Summary,
    ) -> ReportInput<'a> {
        let pictures = self.pictures.as_ref();
        let (path, reported_path) = self.paths.both();
        ReportInput {
            title,
            verdict,
            summary,
            frame: self.frame,
            path,
            reported_path: reported_path.unwrap_or_default(),
            reference: &self.reference.path,
            errors: &self.reference.errors,
            map: self.maps.as_ref().map(|maps| &maps.global),
            keyframes: &self.shown,
            colours: &self.colours,
            cut: pictures.and_then(|pictures| pictures.cut),
            mesh: pictures.and_then(|pictures| pictures.mesh.as_ref()),
            preview: pictures.map(|pictures| pictures.preview.as_slice()),
            loops: pictures.and_then(|pictures| pictures.loops.as_ref()),
            config: &self.config,
        }
    }
}

fn ground(tracked: &Tracked, frame: &MapFrame) -> Ground {
    Ground {
        has_floor: frame.floor.is_some(),
        is_metric: is_metric(tracked, frame),
    }
}

/// The numbers, with what a truth says of them.
fn summary(
    input: &Input,
    settings: &RunSettings,
    tracked: &Tracked,
    looked: &Looked,
    maps: Option<&Maps>,
    extras: Extras,
) -> Summary {
    let mut summary = Summary::new(input, settings, tracked, &looked.frame, maps);
    let not_kept = tracked.run.slam.spill_failure();
    let exceeded = settings
        .memory_limit
        .and_then(|limit| limit.exceeded(peak_rss_bytes()));
    let said = extras.warnings.into_iter().chain(not_kept).chain(exceeded);
    let said = said.collect();
    summary.map.cell = looked.cell;
    summary.inertial.clone_from(&looked.sensed.summary);
    summary.warnings = warnings(input, looked.warning.clone(), said, &summary);
    summary.depth = extras.depth;
    summary.map_error = extras.map;
    summary
}

/// The first Ctrl-C ends tracking, a second one the process.
fn save_when_interrupted() {
    // a second handler in one process is refused, which does no harm
    let _ = ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("interrupted: saving (once more to stop at once)");
    });
}

/// What the keyframes together say about the results.
struct Looked {
    frame: MapFrame,
    /// Why it is not the one that was asked for.
    warning: Option<String>,
    /// The cell that follows from the scene, where nothing else says how large cells are.
    cell: Option<SceneCell>,
    /// What the inertial sensor says.
    sensed: Sensed,
}

impl Looked {
    fn at(
        tracked: &Tracked,
        scans: &[KeyframeScan],
        align: &Align,
        input: &Input,
        settings: &RunSettings,
    ) -> Self {
        let keyframes = tracked.run.slam.keyframes();
        let posed = keyframes.iter().zip(scans);
        let views: Vec<UprightView> = posed
            .filter_map(|(keyframe, scan)| {
                Some(UprightView {
                    scan,
                    image: Some(ImageOf::Kept(keyframe)),
                    world_from_keyframe: *tracked.run.poses.in_main_map(keyframe.id)?,
                })
            })
            .collect();
        let mapping = &settings.config.mapping;
        let inertial = input.inertial.as_ref();
        let sensed = sense(inertial, tracked, &settings.config.slam.inertial);
        let path = stamped_path(tracked);
        let (frame, warning) = align.frame(&path, &sensed.frame, &mut || Scene {
            views: views.clone(),
            config: &mapping.upright,
        });
        let is_free = mapping.auto_resolution && !is_metric(tracked, &frame);
        let cell = is_free.then(|| scene_cell(&views, mapping));
        Self {
            frame,
            warning,
            cell: cell.flatten(),
            sensed,
        }
    }
}

impl Looked {
    /// Edge of a cell of the maps.
    fn edge(&self, settings: &RunSettings) -> f64 {
        let asked = settings.config.mapping.resolution;
        self.cell.map_or(asked, |cell| cell.edge)
    }
}

fn stamped_path(tracked: &Tracked) -> Vec<(i64, Se3)> {
    let poses = tracked.run.trajectory.iter();
    poses
        .map(|pose| (pose.timestamp_ns, pose.world_from_camera))
        .collect()
}

/// Where the camera really was, by time and in the frame of the results: the trajectory that decided the frame, else the
/// one that lies beside the images, with which the results are compared. With it why there is none, if there should be.
fn known_path(
    input: &Input,
    align: &Align,
    tracked: &Tracked,
    frame: &mut MapFrame,
) -> (KnownPath, Option<String>) {
    if let (Align::Trajectory { poses, .. }, true) = (align, frame.fit.is_some()) {
        return (path_by_time(poses, &Sim3::identity()), None);
    }
    let Images::Files(dataset) = &input.images else {
        return Default::default();
    };
    let estimate = stamped_path(tracked);
    let Some((first, last)) = estimate.first().zip(estimate.last()) else {
        return Default::default();
    };
    let seen = |pose: &TimedPose| (first.0..=last.0).contains(&pose.timestamp_ns);
    let compared = match dataset.reference_trajectory() {
        Ok(None) => return Default::default(),
        Ok(Some(mut reference)) => {
            let fitted = frame.compare(&estimate, &reference);
            reference.retain(seen);
            fitted.map(|results_from_reference| path_by_time(&reference, &results_from_reference))
        }
        Err(error) => Err(error.to_string()),
    };
    match compared {
        Ok(known) => (known, None),
        Err(reason) => {
            let path = dataset.ground_truth.as_deref().unwrap_or(&dataset.root);
            let said = format!(
                "the path was not compared with {}: {reason}",
                path.display()
            );
            (KnownPath::new(), Some(said))
        }
    }
}

/// Positions by time, nanoseconds.
type KnownPath = BTreeMap<i64, [f64; 3]>;

fn path_by_time(poses: &[TimedPose], results_from_reference: &Sim3) -> KnownPath {
    let place =
        |pose: &TimedPose| (*results_from_reference * pose.world_from_camera.translation).into();
    let placed = poses.iter().map(|pose| (pose.timestamp_ns, place(pose)));
    placed.collect()
}

impl Paths {
    fn new(poses: &[TimedPose], tracked: &Tracked, frame: &MapFrame) -> Self {
        let has_loops = tracked.run.slam.graph_stats().loop_closures > 0;
        Self {
            path: path_of(poses),
            reported: has_loops.then(|| outputs::reported_path(tracked, frame)),
        }
    }

    fn both(&self) -> (&[[f64; 3]], Option<&[[f64; 3]]>) {
        (&self.path, self.reported.as_deref())
    }
}

/// Where the camera really was, in the frame of the results.
#[derive(Default)]
struct Reference {
    path: Vec<[f64; 3]>,
    /// Distance of each pose from it.
    errors: Vec<Option<f64>>,
}

/// Poses of the reference belong to a frame of the same time, but for this.
const SAME_TIME_NS: u64 = 20_000_000;

impl Reference {
    /// The known path and the distances of the poses from it.
    fn new(known: &KnownPath, poses: &[TimedPose]) -> Self {
        if known.is_empty() {
            return Self::default();
        }
        let error = |pose: &TimedPose| {
            let time = pose.timestamp_ns;
            let around = [known.range(..=time).next_back(), known.range(time..).next()];
            let nearest = around.into_iter().flatten();
            let (then, place) = nearest.min_by_key(|(then, _)| time.abs_diff(**then))?;
            let is_same = time.abs_diff(*then) <= SAME_TIME_NS;
            is_same.then(|| (pose.world_from_camera.translation - Vec3::from(*place)).norm())
        };
        Self {
            errors: poses.iter().map(error).collect(),
            path: known.values().copied().collect(),
        }
    }
}

/// The final depth of the keyframes.
fn final_depth(
    tracked: &mut Tracked,
    limit: Option<MemoryLimit>,
    show_progress: bool,
) -> Vec<KeyframeScan> {
    let before = process_cpu();
    make_room(tracked, limit);
    let count = tracked.run.slam.num_keyframes();
    eprintln!("depth and maps of {count} keyframes at their final poses");
    // what is kept of each keyframe grows while others are read: the room for them shrinks meanwhile, which changes no result
    let keyframes = tracked.run.slam.room();
    let look = || {
        if let Some(limit) = limit {
            limit.apply_to(&keyframes);
        }
    };
    let scans = watched(("final depth", count), show_progress, look, |done| {
        tracked.run.final_scans(done)
    });
    tracked.cpu.mapping += process_cpu() - before;
    leave_room(tracked, limit);
    scans
}

/// Gives back what is free, and the keyframes as much room as is left now.
fn make_room(tracked: &Tracked, limit: Option<MemoryLimit>) {
    match limit {
        Some(limit) => limit.apply(&tracked.run.slam),
        None => memory::give_back(),
    }
}

/// The same for work that takes one keyframe after the other: with a limit they have the least room.
fn leave_room(tracked: &Tracked, limit: Option<MemoryLimit>) {
    match limit {
        Some(limit) => limit.squeeze(&tracked.run.slam),
        None => memory::give_back(),
    }
}

/// A keyframe of the main map with its final pose.
struct Posed {
    keyframe: KeptKeyframe,
    map_from_keyframe: Sim3,
}

/// The keyframes of the main map with their final poses.
fn posed_keyframes(tracked: &Tracked, frame: &MapFrame) -> Vec<Posed> {
    let posed = |keyframe: KeptKeyframe| {
        let world_from_keyframe = tracked.run.poses.in_main_map(keyframe.id)?;
        Some(Posed {
            keyframe,
            map_from_keyframe: frame.map_from_world * *world_from_keyframe,
        })
    };
    let keyframes = tracked.run.slam.keyframes().into_iter();
    keyframes.filter_map(posed).collect()
}

/// What they measured, by the final depth.
fn shown_keyframes<'a>(
    posed: &'a [Posed],
    scans: &[KeyframeScan],
    pinhole: &Pinhole,
) -> Vec<ShownKeyframe<'a>> {
    let scans: BTreeMap<_, _> = scans.iter().map(|scan| (scan.id, scan)).collect();
    let shown = posed.par_iter().map(|posed| {
        let keyframe = &posed.keyframe;
        let scan = scans.get(&keyframe.id);
        let semi_dense = scan.and_then(|scan| Some(SemiDense::new(&keyframe.pixels()?, scan)));
        ShownKeyframe {
            frame_index: keyframe.frame_index as u64,
            timestamp_ns: keyframe.timestamp_ns,
            map_from_keyframe: posed.map_from_keyframe,
            pinhole: *pinhole,
            image: Some(ImageOf::Kept(keyframe)),
            semi_dense: semi_dense.unwrap_or_else(|| {
                let camera = KeyframeCamera::new(*pinhole, keyframe.size());
                SemiDense::recorded(keyframe.id, camera, &[])
            }),
        }
    });
    shown.collect()
}

/// What they measured as points, if there are any.
fn write_points(
    folder: &OutputFolder,
    shown: &[ShownKeyframe],
    colours: &Colours,
    unit: &str,
) -> Result<(), Failure> {
    if shown.is_empty() {
        return Ok(());
    }
    outputs::write_cloud(folder, shown, colours, unit)
}

/// What of them is mapped.
fn coloured_scans<'a>(posed: &'a [Posed], scans: &'a [KeyframeScan]) -> Vec<ColouredScan<'a>> {
    let scans: BTreeMap<_, _> = scans.iter().map(|scan| (scan.id, scan)).collect();
    let coloured = posed.iter().filter_map(|posed| {
        Some(ColouredScan {
            scan: scans.get(&posed.keyframe.id)?,
            image: Some(ImageOf::Kept(&posed.keyframe)),
            map_from_keyframe: posed.map_from_keyframe,
        })
    });
    coloured.collect()
}

/// The final maps; `None` without keyframes.
fn final_maps(
    tracked: &mut Tracked,
    scans: Vec<KeyframeScan>,
    looked: &Looked,
    path: &[[f64; 3]],
    settings: &RunSettings,
) -> Result<Option<Maps>, String> {
    let before = process_cpu();
    leave_room(tracked, settings.memory_limit);
    let camera = path.last().map(|point| Vec3::from(*point));
    let frames = settings.earlier().into_iter().flat_map(|e| &e.frames);
    let frames: Vec<TrackedFrame> = frames.map(tracked_frame).collect();
    let edge = looked.cell.map(|cell| cell.edge);
    let run = &mut tracked.run;
    let maps = watched(
        ("final maps", scans.len()),
        settings.show_progress,
        || {},
        |done| {
            let more = (frames.as_slice(), edge);
            run.maps_of(scans, &looked.frame.map_from_world, camera, more, done)
        },
    );
    leave_room(tracked, settings.memory_limit);
    tracked.cpu.mapping += process_cpu() - before;
    maps.map_err(|error| error.to_string())
}

fn early_failure(tracked: &Tracked) -> Option<String> {
    match &tracked.early_end {
        Some(EarlyEnd::Unreadable(reason)) => Some(format!(
            "{MAX_UNREADABLE_IN_A_ROW} images in a row cannot be used, the last because: {reason}"
        )),
        _ => None,
    }
}

/// What the user should know, in the order in which it was found out.
fn warnings(
    input: &Input,
    align: Option<String>,
    extras: Vec<String>,
    summary: &Summary,
) -> Vec<String> {
    let skipped = (summary.skipped > 0).then(|| {
        format!(
            "{} frames could not be used and were skipped",
            summary.skipped
        )
    });
    let repeated = (summary.repeated > 0).then(|| {
        format!(
            "{} frames repeat the one before and were left out",
            summary.repeated
        )
    });
    let found = align
        .into_iter()
        .chain(extras)
        .chain(skipped)
        .chain(repeated);
    input.warnings.iter().cloned().chain(found).collect()
}
