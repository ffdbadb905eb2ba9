//! A run on the pipeline: what is read, who listens, what becomes of each frame.

use crate::input::Input;
use crate::input::depth_images::FrameDepths;
use crate::keyframe_colours::ColourSource;
use crate::output::OutputFolder;
use crate::process::failure::{Classify, Failure};
use crate::process::interrupt::INTERRUPTED;
use crate::process::usage::process_cpu;
use crate::run::RunSettings;
use crate::run::live::Viewer;
use crate::run::sessions::Continued;
use crate::run::tracking::Tracking;
use crate::run::tracking::recorder::Recorder;
use crate::run::tracking::salvage::Salvage;
use crate::run::tracking::tracked::Tracked;
use monogrid_datasets::SessionInfo;
use monogrid_pipeline::{Pipeline, Reading, Settings, attempt, read_ahead};

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Of a run that is not interrupted.
static NEVER: AtomicBool = AtomicBool::new(false);

/// Tracks all frames, records keyframes and grows the maps.
pub fn track(
    input: &Input,
    folder: &Arc<OutputFolder>,
    settings: &RunSettings,
    viewer: Option<&mut Viewer>,
    salvage: Option<&Salvage>,
) -> Result<Tracked, Failure> {
    let session = session_info(input, settings)?;
    let process_before = process_cpu();
    let mut pipeline = pipeline(input, settings)?;
    // without a file, which has no name and ends with the process, all keyframes stay in memory
    if let Ok(file) = tempfile::tempfile_in(folder.path()) {
        pipeline.slam().spill_into(file);
    }
    let mut frame_colours = None;
    if !settings.is_localise_only() {
        let source_colours = ColourSource::of(input);
        frame_colours = Some(Arc::clone(&source_colours.kept));
        let earlier = settings.earlier().cloned();
        let sources = (earlier, Some(source_colours));
        let recorder = Recorder::start(Arc::clone(folder), &session, sources, settings.submaps)?;
        let recorder = recorder.telling(viewer.as_ref().map(|viewer| viewer.ear()));
        pipeline.listen(recorder).map_err(Failure::running)?;
    }
    let reading = Reading {
        pace: settings.pace,
        must_be_used: settings.depth.as_ref().map(FrameDepths::first_frame),
    };
    if let Some(viewer) = &viewer {
        pipeline.listen(viewer.ear()).map_err(Failure::running)?;
    }
    // what nobody watches is a part of something larger, which looks for interrupts itself
    let interrupted = salvage.map_or(&NEVER, |_| &INTERRUPTED);
    let places = (input, folder.path());
    let colours = frame_colours.as_deref();
    let mut tracking = Tracking::begin((pipeline, viewer, colours), settings, places, interrupted);
    // nothing is tracked where nothing can be mapped
    let source = match input.no_map() {
        Some(_) => Box::new(std::iter::empty()),
        None => input.source(colours),
    };
    let depths = settings.depth.as_ref();
    let source = source.map(|frame| match depths {
        Some(depths) => depths.with_depth(frame),
        None => frame,
    });
    let take = |frame| tracking.take(frame);
    let reading = match attempt(|| read_ahead(source, &input.preparation, reading, take)) {
        Ok(reading) => reading.while_running("frames cannot be read")?,
        Err(message) => {
            tracking.fail(&message);
            Duration::ZERO
        }
    };
    tracking.finish(reading + input.reading_cpu(), process_before, salvage)
}

/// Shows the run while it goes on, if that is wanted.
pub fn viewer(input: &Input, settings: &RunSettings) -> Result<Option<Viewer>, Failure> {
    let Some(view) = &settings.view else {
        return Ok(None);
    };
    let (width, height) = input.size();
    let title = format!("monogrid: {}", input.name);
    let total = input.expected_frames().unwrap_or(0);
    Viewer::start(view, &title, (input.pinhole(), [width, height]), total).map(Some)
}

/// A new pipeline, or one that goes on with the map of an earlier run.
fn pipeline(input: &Input, settings: &RunSettings) -> Result<Pipeline, Failure> {
    let config = &settings.config;
    let first_measured = settings.depth.as_ref().map(FrameDepths::first_frame);
    let earlier = settings.continued.as_ref();
    let earlier = earlier.map(|Continued { earlier, purpose }| (earlier.map.clone(), *purpose));
    let inertial = input.inertial.as_ref();
    let settings = Settings {
        slam: config.slam.clone(),
        mapping: config.mapping.clone(),
        seed: config.seed,
        threads: settings.threads,
        imu: inertial.map(|inertial| Arc::clone(&inertial.imu)),
        first_measured,
        ..Settings::default()
    };
    Pipeline::with(input.preparation.clone(), settings, earlier).map_err(Failure::input)
}

fn session_info(input: &Input, settings: &RunSettings) -> Result<SessionInfo, Failure> {
    let (width, height) = input.size();
    Ok(SessionInfo {
        pinhole: *input.pinhole(),
        width,
        height,
        scale: match (&settings.depth, settings.earlier()) {
            (Some(_), _) => monogrid_datasets::Scale::Metric,
            (None, Some(earlier)) => earlier.session.scale,
            (None, None) => monogrid_datasets::Scale::Arbitrary,
        },
        seed: settings.config.seed,
        profile: settings.config.profile.name().to_owned(),
        source: input.name.clone(),
        config: settings.config.to_toml()?,
    })
}
