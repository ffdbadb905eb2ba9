//! A run from its first frame to its last file.

use crate::input::{Images, Input};
use crate::output::OutputFolder;
use crate::process::failure::{Failure, Outcome};
use crate::process::interrupt;
use crate::process::memory;
use crate::process::talk;
use crate::process::usage::{peak_rss_bytes, process_cpu};
use crate::run::align::{Align, MapFrame, Scene};
use crate::run::conclusion::verdict;
use crate::run::live::Viewer;
use crate::run::outputs::{self, Ground, Playback, Surface};
use crate::run::report::{Reference, ReportInput, write_page};
use crate::run::sensed::{Sensed, sense};
use crate::run::sessions::{RECORDING, tracked_frame};
use crate::run::summary::{Summary, is_metric, unit_name};
use crate::run::tracking::progress::watched;
use crate::run::tracking::salvage::Salvage;
use crate::run::tracking::threads::{track, viewer};
use crate::run::tracking::tracked::{EarlyEnd, Tracked};
use crate::run::trust::trust;
use crate::run::{MemoryLimit, RunSettings};
use monogrid_datasets::TimedPose;
use monogrid_evaluation::{DepthReport, MapReport};
use monogrid_geometry::{Pinhole, Se3, Sim3, Vec3};
use monogrid_mapping::{
    ImageOf, KeyframeCamera, KeyframeScan, Maps, MeshConfig, SceneCell, UprightView, camera_paths,
    scene_cell,
};
use monogrid_pipeline::attempt;
use monogrid_report::colours::Colours;
use monogrid_report::explorer::{SemiDense, ShownKeyframe};
use monogrid_report::surface::{CellColours, ColouredScan, SurfaceView};
use monogrid_slam::{KeptKeyframe, TrackedFrame, TrajectoryPose};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

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

/// Tracks, maps and writes everything. `extras` may evaluate against a truth.
pub fn run_all(
    input: &Input,
    folder: &Arc<OutputFolder>,
    settings: &RunSettings,
    align: &Align,
    extras: impl FnOnce(&Tracked, Option<&Maps>) -> Result<Extras, Failure>,
) -> Result<Finished, Failure> {
    interrupt::listen();
    let mut viewer = viewer(input, settings)?;
    let finished = run_watched(input, folder, settings, align, viewer.as_mut(), extras)?;
    // after everything is written, so that nothing waits for those who look
    let died = viewer.and_then(|viewer| viewer.end().err());
    Ok(Finished {
        failure: finished.failure.or(died.map(str::to_owned)),
        ..finished
    })
}

/// The run, which tells a viewer of itself.
fn run_watched(
    input: &Input,
    folder: &Arc<OutputFolder>,
    settings: &RunSettings,
    align: &Align,
    viewer: Option<&mut Viewer>,
    extras: impl FnOnce(&Tracked, Option<&Maps>) -> Result<Extras, Failure>,
) -> Result<Finished, Failure> {
    let config = settings.config.to_toml()?;
    folder.write("config.toml", &config)?;
    let salvage = Salvage::watch(&input.name, folder, settings)?;
    let mut tracked = track(input, folder, settings, viewer, Some(&salvage))?;
    let scans = final_depth(&mut tracked, settings);
    let mut looked = Looked::at(&tracked, &scans, align, input, settings);
    let (known, not_compared) = known_path(input, align, &tracked, &mut looked.frame);
    let poses = outputs::final_poses(&tracked, &looked.frame);
    outputs::write_tables(folder, &tracked, &looked.frame, &poses, settings)?;
    outputs::write_bridged(folder, &looked.sensed.bridged, &looked.frame)?;
    let paths = outputs::Paths::new(&poses, &tracked, &looked.frame);
    let ground = ground(&tracked, &looked.frame, &paths.path, settings);
    let posed = posed_keyframes(&tracked, &looked.frame);
    let shown = shown_keyframes(&posed, &scans, tracked.run.slam.pinhole());
    let colours = Colours::read(&folder.path().join(RECORDING))?;
    let mapping = &settings.config.mapping;
    let edge = looked.cell.map_or(mapping.resolution, |cell| cell.edge);
    let (cell_colours, written) = rayon::join(
        || CellColours::new(&coloured_scans(&posed, &scans), &colours, edge),
        || outputs::write_cloud(folder, &shown, &colours, unit_name(ground.is_metric)),
    );
    written?;
    let (maps, failure) = match final_maps(&mut tracked, scans, &looked, &paths.path, settings) {
        Ok(maps) => (maps, early_failure(&tracked)),
        Err(error) => (None, Some(error)),
    };
    let seen = (shown.as_slice(), &colours, &cell_colours);
    let surface = (seen, &mapping.mesh, ground);
    let write = |maps| write_maps(&tracked, folder, maps, &paths, surface);
    let pictures = maps.as_ref().map(write).transpose()?;
    talk::doing("the map is judged");
    let mut extras = extras(&tracked, maps.as_ref())?;
    (extras.warnings).extend(tracked.warnings.iter().cloned().chain(not_compared));
    let mut summary = summary(input, settings, &tracked, &looked, maps.as_ref(), extras);
    let plan = pictures.as_ref().and_then(|drawn| drawn.plan.as_ref());
    summary.map.band = plan.map(|plan| plan.band);
    let verdict = verdict(&summary, &tracked);
    let report = ReportInput {
        title: &format!("monogrid: {}", input.name),
        lead: &lead(&summary, &verdict),
        summary: &summary,
        frame: &looked.frame,
        reference: Reference::new(&known, &poses),
        paths,
        map: maps.as_ref().map(|maps| &maps.global),
        keyframes: &shown,
        colours: &colours,
        cell_colours: &cell_colours,
        pictures,
        config: &config,
    };
    play(folder, &report, (settings, &tracked), &poses, ground)?;
    folder.write_with("report.html", |out| write_page(out, &tracked, &report))?;
    write_summary(folder, &mut summary)?;
    Ok(Finished {
        outcome: summary.status.outcome(),
        summary,
        verdict,
        failure,
    })
}

/// Writes the maps, with the surface as the keyframes show it.
fn write_maps(
    tracked: &Tracked,
    folder: &OutputFolder,
    maps: &Maps,
    paths: &outputs::Paths,
    ((shown, images, colours), config, ground): (
        (&[ShownKeyframe], &Colours, &CellColours),
        &MeshConfig,
        Ground,
    ),
) -> Result<outputs::MapPictures, Failure> {
    talk::doing("maps and the surface are written");
    let views: Vec<SurfaceView> = match tracked.early_end {
        // nobody waits for a picture on the surface
        Some(EarlyEnd::Interrupted) => Vec::new(),
        _ => shown.iter().map(ShownKeyframe::view).collect(),
    };
    let surface = Surface {
        colours,
        config,
        views: &views,
        images,
    };
    outputs::write_maps(folder, maps, paths, ground, surface)
}

/// The first lines of the report: how far to trust the map, and how the run went.
fn lead(summary: &Summary, verdict: &str) -> String {
    let trust = summary.trust.iter().map(String::as_str);
    trust.chain([verdict]).collect::<Vec<_>>().join(" ")
}

fn write_summary(folder: &OutputFolder, summary: &mut Summary) -> Result<(), Failure> {
    summary.take_times();
    let json = serde_json::to_string_pretty(&summary).map_err(Failure::running)?;
    folder.write("summary.json", json + "\n")
}

/// Writes the run as messages, where it is asked for; what was needed for the maps alone is given
/// back.
fn play(
    folder: &OutputFolder,
    report: &ReportInput,
    (settings, tracked): (&RunSettings, &Tracked),
    poses: &[TimedPose],
    ground: Ground,
) -> Result<(), Failure> {
    talk::doing("the report is written");
    leave_room(tracked, settings.memory_limit);
    let Some(file) = &settings.mcap else {
        return Ok(());
    };
    let playback = Playback {
        poses,
        keyframes: report.keyframes,
        colours: report.colours,
        map: report.map,
        ground,
    };
    folder.write_beside(file, |out| Ok(playback.write(out)?))
}

fn ground(
    tracked: &Tracked,
    frame: &MapFrame,
    path: &[[f64; 3]],
    settings: &RunSettings,
) -> Ground {
    let earlier = frames_of_earlier(settings);
    let known = |id: u32| tracked.run.poses.in_main_map(id);
    let earlier = camera_paths(&earlier, known, &frame.map_from_world);
    Ground {
        has_floor: frame.floor.is_some(),
        has_level_surface: frame.level_surface.is_some(),
        is_up_certain: frame.up.is_certain,
        cameras: outputs::lowest_and_highest(earlier.iter().flatten().chain(path)),
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
    let limit = settings.memory_limit;
    let said = |count: usize, what: &str| (count > 0).then(|| format!("{count} frames {what}"));
    // in the order in which it was found out
    let mut warnings = input.warnings.clone();
    warnings.extend(input.faults());
    warnings.extend(looked.warning.clone());
    warnings.extend(extras.warnings);
    warnings.extend(tracked.run.slam.spill_failure());
    warnings.extend(limit.and_then(|limit| limit.exceeded(peak_rss_bytes())));
    warnings.extend(said(summary.skipped, "could not be used and were skipped"));
    let repeats = "repeat the one before and were left out";
    warnings.extend(said(summary.repeated, repeats));
    summary.warnings = warnings;
    summary.map.cell = looked.cell;
    summary.inertial.clone_from(&looked.sensed.summary);
    summary.depth = extras.depth;
    summary.map_error = extras.map;
    summary.trust = trust(&summary);
    summary
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
        talk::doing("which way is up, and where the results are");
        let keyframes = tracked.run.slam.keyframes();
        let views = keyframes.iter().zip(scans).filter_map(|(keyframe, scan)| {
            Some(UprightView {
                scan,
                image: Some(ImageOf::Kept(keyframe)),
                world_from_keyframe: *tracked.run.poses.in_main_map(keyframe.id)?,
            })
        });
        let views: Vec<UprightView> = views.collect();
        let mapping = &settings.config.mapping;
        let inertial = input.inertial.as_ref();
        let sensed = sense(inertial, tracked, &settings.config.slam.inertial);
        let path = stamped_path(tracked);
        let (frame, warning) = align.frame(&path, &sensed.frame, &mut || Scene {
            views: views.clone(),
            path: path.iter().map(|(_, pose)| *pose).collect(),
        });
        let is_free = mapping.auto_resolution && !is_metric(tracked, &frame);
        let cell = is_free.then(|| scene_cell(&views, mapping)).flatten();
        Self {
            frame,
            warning,
            cell,
            sensed,
        }
    }
}

fn stamped_path(tracked: &Tracked) -> Vec<(i64, Se3)> {
    let stamped = |pose: &TrajectoryPose| (pose.timestamp_ns, pose.world_from_camera);
    tracked.run.trajectory.iter().map(stamped).collect()
}

/// Where the camera really was, by time and in the frame of the results: the trajectory that
/// decided the frame, else the one that lies beside the images, with which the results are
/// compared. With it why there is none, if there should be.
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
            let path = path.display();
            let said = format!("the path was not compared with {path}: {reason}");
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

/// The final depth of the keyframes; that of the filter where making it better has failed.
fn final_depth(tracked: &mut Tracked, settings: &RunSettings) -> Vec<KeyframeScan> {
    if tracked.no_map.is_some() {
        return Vec::new();
    }
    let (limit, before) = (settings.memory_limit, process_cpu());
    match limit {
        Some(limit) => limit.apply(&tracked.run.slam),
        None => memory::give_back(),
    }
    let count = tracked.run.slam.num_keyframes();
    eprintln!("depth and maps of {count} keyframes at their final poses");
    // what is kept of each keyframe grows while others are read: the room for them shrinks
    // meanwhile, which changes no result
    let keyframes = tracked.run.slam.room();
    let look = || {
        if let Some(limit) = limit {
            limit.apply_to(&keyframes);
        }
    };
    let what = ("final depth", "keyframes", count);
    let scans = match tracked.early_end {
        // nobody waits for better depth
        Some(EarlyEnd::Interrupted) => tracked.run.filter_scans(),
        _ => {
            let made = attempt(|| {
                let work = |done: &AtomicUsize| tracked.run.final_scans(done);
                watched(what, settings.show_progress, look, work)
            });
            made.unwrap_or_else(|message| {
                let failed = EarlyEnd::Failed(format!("the final depth failed: {message}"));
                tracked.early_end = Some(failed);
                tracked.run.filter_scans()
            })
        }
    };
    tracked.cpu.mapping += process_cpu() - before;
    leave_room(tracked, limit);
    scans
}

/// Gives back what is free, for work that takes one keyframe after the other: with a limit they
/// have the least room.
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
    if tracked.no_map.is_some() {
        return Ok(None);
    }
    let before = process_cpu();
    leave_room(tracked, settings.memory_limit);
    let camera = path.last().map(|point| Vec3::from(*point));
    let frames = frames_of_earlier(settings);
    let edge = looked.cell.map(|cell| cell.edge);
    let run = &mut tracked.run;
    let what = ("final maps", "keyframes", scans.len());
    let map_from_world = &looked.frame.map_from_world;
    let work = |done: &AtomicUsize| {
        let more = (frames.as_slice(), edge);
        run.maps_of(scans, map_from_world, camera, more, done)
    };
    let maps = watched(what, settings.show_progress, || {}, work);
    leave_room(tracked, settings.memory_limit);
    tracked.cpu.mapping += process_cpu() - before;
    maps.map_err(|error| error.to_string())
}

/// Frames of the runs that this one goes on with.
fn frames_of_earlier(settings: &RunSettings) -> Vec<TrackedFrame> {
    let frames = settings.earlier().into_iter().flat_map(|e| &e.frames);
    frames.map(tracked_frame).collect()
}

fn early_failure(tracked: &Tracked) -> Option<String> {
    match &tracked.early_end {
        Some(EarlyEnd::Failed(reason)) => {
            Some(format!("{reason}; what was mapped until then is saved"))
        }
        Some(EarlyEnd::BrokeOff(reason)) => Some(format!("the source broke off: {reason}")),
        Some(EarlyEnd::Unreadable(in_a_row, reason)) => Some(format!(
            "{in_a_row} images in a row cannot be used, the last because: {reason}"
        )),
        _ => None,
    }
}
