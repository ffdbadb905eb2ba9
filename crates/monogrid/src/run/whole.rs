//! A run from its first frame to its last file.

use super::RunSettings;
use super::align::{Align, MapFrame};
use super::conclusion::verdict;
use super::outputs::{self, path_of};
use super::report::{ReportInput, page};
use super::summary::{Summary, is_metric, unit_name};
use super::threads::{Tracked, track};
use super::tracking::EarlyEnd;
use crate::failure::{Failure, Outcome};
use crate::input::{Input, MAX_UNREADABLE_IN_A_ROW};
use crate::output::OutputFolder;
use crate::usage::process_cpu;
use monogrid_datasets::TimedPose;
use monogrid_evaluation::{DepthReport, MapReport};
use monogrid_geometry::Vec3;
use monogrid_slam::mapping::Maps;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// What a caller adds to summary and report.
#[derive(Debug, Default)]
pub struct Extras {
    /// Reference path in the frame of the results.
    pub reference: Vec<[f64; 3]>,
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
    let (frame, align_warning) = frame_of_results(align, &tracked);
    let poses = outputs::final_poses(&tracked, &frame);
    outputs::write_tables(folder, &tracked, &frame, &poses, settings)?;
    let paths = Paths::new(&poses, &tracked, &frame);
    let (maps, failure) = match final_maps(&mut tracked, &frame, &paths.path) {
        Ok(maps) => (maps, early_failure(&tracked)),
        Err(error) => (None, Some(error)),
    };
    let pictures = match &maps {
        Some(maps) => Some(outputs::write_maps(
            folder,
            maps,
            &paths.path,
            paths.reported.as_deref(),
            unit_name(is_metric(&tracked, &frame)),
        )?),
        None => None,
    };
    let extras = extras(&tracked, maps.as_ref())?;
    let mut summary = Summary::new(input, settings, &tracked, &frame, maps.as_ref());
    summary.warnings = warnings(input, align_warning, extras.warnings, &summary);
    summary.depth = extras.depth;
    summary.map_error = extras.map;
    let verdict = verdict(&summary, &tracked);
    let report = ReportInput {
        title: &format!("monogrid: {}", input.name),
        verdict: &verdict,
        summary: &summary,
        frame: &frame,
        path: &paths.path,
        reported_path: paths.reported.as_deref().unwrap_or_default(),
        reference: &extras.reference,
        preview: pictures.as_ref().map(|p| p.preview.as_slice()),
        loops: pictures.as_ref().and_then(|p| p.loops.as_ref()),
        config: &config,
    };
    folder.write("report.html", page(&tracked, &report))?;
    summary.take_times();
    let json = serde_json::to_string_pretty(&summary).map_err(Failure::running)?;
    folder.write("summary.json", json + "\n")?;
    Ok(Finished {
        outcome: summary.status.outcome(),
        summary,
        verdict,
        failure,
    })
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

/// The frame of the results, and why it is not the one that was asked for.
fn frame_of_results(align: &Align, tracked: &Tracked) -> (MapFrame, Option<String>) {
    let trajectory: Vec<_> = tracked
        .run
        .trajectory
        .iter()
        .map(|pose| (pose.timestamp_ns, pose.world_from_camera))
        .collect();
    align.frame(&trajectory)
}

impl Paths {
    fn new(poses: &[TimedPose], tracked: &Tracked, frame: &MapFrame) -> Self {
        let has_loops = tracked.run.slam.graph_stats().loop_closures > 0;
        Self {
            path: path_of(poses),
            reported: has_loops.then(|| outputs::reported_path(tracked, frame)),
        }
    }
}

/// The final maps; `None` without keyframes.
fn final_maps(
    tracked: &mut Tracked,
    frame: &MapFrame,
    path: &[[f64; 3]],
) -> Result<Option<Maps>, String> {
    let before = process_cpu();
    eprintln!(
        "depth and maps of {} keyframes at their final poses",
        tracked.run.slam.keyframes().len()
    );
    let camera = path.last().map(|point| Vec3::from(*point));
    let maps = tracked.run.maps_in(&frame.map_from_world, camera);
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
