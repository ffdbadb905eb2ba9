//! What becomes of each frame.

mod frame_log;
pub mod frames;
pub mod memory_limit;
pub mod moments;
pub mod progress;
pub mod recorder;
pub(crate) mod salvage;
pub mod submaps;
pub mod threads;
pub mod tracked;

use crate::camera::calibration_check::CalibrationCheck;
use crate::camera::rolling::ShutterSearch;
use crate::input::frame_colours::FrameColours;
use crate::input::seen::{no_map, watch_of_working_images};
use crate::input::{Input, MAX_UNREADABLE_IN_A_ROW};
use crate::process::failure::{Failure, render};
use crate::process::memory;
use crate::process::talk;
use crate::process::usage::process_cpu;
use crate::run::RunSettings;
use crate::run::live::Viewer;
use crate::run::tracking::frame_log::FrameLog;
use crate::run::tracking::frames::{FrameFate, FrameRow};
use crate::run::tracking::moments::Moments;
use crate::run::tracking::progress::Progress;
use crate::run::tracking::salvage::Salvage;
use crate::run::tracking::tracked::{CpuTimes, EarlyEnd, Tracked};
use monogrid_calibration::{CameraMotion, MotionWatch};
use monogrid_pipeline::{
    Event, Pace, Pipeline, PipelineError, ReadFrame, ReadOn, Rectification, Unusable,
};
use monogrid_slam::{DepthInput, Effort, FrameInput, Slam, fault};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Between frames that follow each other lies no more than this, ns.
const MAX_INTERVAL_NS: i64 = 200_000_000;

/// The pipeline, and what its frames have come to.
pub struct Tracking<'a> {
    pipeline: Pipeline,
    settings: &'a RunSettings,
    interrupted: &'a AtomicBool,
    rows: FrameLog,
    moments: Moments,
    /// Finished keyframes.
    num_keyframes: usize,
    unreadable_in_a_row: usize,
    /// Whether no frame could be read yet.
    is_none_readable: bool,
    early_end: Option<EarlyEnd>,
    calibration: CalibrationCheck<'a>,
    shutter: ShutterSearch,
    /// How the camera moves, where nobody could look before.
    watch: Option<MotionWatch>,
    no_map: Option<CameraMotion>,
    progress: Progress,
    viewer: Option<&'a mut Viewer>,
    colours: Option<&'a FrameColours>,
    /// Time of the last frame.
    last_ns: Option<i64>,
}

impl<'a> Tracking<'a> {
    /// Before the first frame; what becomes of the frames is kept on the disk of `folder`.
    pub fn begin(
        (pipeline, viewer, colours): (Pipeline, Option<&'a mut Viewer>, Option<&'a FrameColours>),
        settings: &'a RunSettings,
        (input, folder): (&'a Input, &Path),
        interrupted: &'a AtomicBool,
    ) -> Self {
        let num_frames = input.expected_frames().unwrap_or(0);
        let has_depth = settings.depth.is_some() || settings.continued.is_some();
        let may_be_refused = !input.is_repeatable() && !has_depth;
        Self {
            num_keyframes: pipeline.slam().num_keyframes(),
            pipeline,
            settings,
            interrupted,
            rows: FrameLog::begin(folder),
            moments: Moments::of(input),
            unreadable_in_a_row: 0,
            is_none_readable: true,
            early_end: None,
            calibration: CalibrationCheck::new(input, settings.pace == Pace::Taken),
            shutter: ShutterSearch::new(input),
            watch: may_be_refused.then(|| watch_of_working_images(input)),
            no_map: input.no_map(),
            progress: Progress::new(num_frames, settings.show_progress),
            viewer,
            colours,
            last_ns: None,
        }
    }

    /// Takes a frame; breaks when the user stops, or the source is unreadable.
    pub fn take(&mut self, frame: ReadFrame) -> ControlFlow<(), ReadOn> {
        if self.interrupted.load(Ordering::Relaxed) {
            self.early_end = Some(EarlyEnd::Interrupted);
            return ControlFlow::Break(());
        }
        if self.pipeline.has_failed() {
            // why is known when it is joined
            return ControlFlow::Break(());
        }
        if let Some(Err(Unusable::BrokeOff(reason))) = frame.image {
            self.early_end = Some(EarlyEnd::BrokeOff(reason));
            return ControlFlow::Break(());
        }
        let shown = match (&mut self.viewer, &frame.image) {
            (Some(viewer), Some(Ok(image))) => viewer.wanted(image),
            _ => None,
        };
        if let Some(Ok(image)) = &frame.image {
            self.moments.look(frame.index, image);
        }
        self.shutter.taken_out.note(frame.index, frame.readout_ms);
        let rectification = frame.rectification.clone();
        let (index, timestamp_ns, due) = (frame.index, frame.timestamp_ns, frame.due);
        let (fate, posed) = self.fate(frame);
        let row = FrameRow {
            index,
            timestamp_ns,
            fate,
            latency_ms: due.map(|due| 1e3 * posed.saturating_duration_since(due).as_secs_f32()),
        };
        self.moments.note(&row);
        if let Some(colours) = self.colours {
            self.keep_colours(colours, rectification, &row);
        }
        if let Some(viewer) = &mut self.viewer {
            viewer.show(&row, shown, &self.pipeline);
        }
        self.early_end = self.count_unreadable(&row.fate);
        self.progress.frame(&row, self.num_keyframes);
        self.rows.push(row);
        if self.early_end.is_some() {
            return ControlFlow::Break(());
        }
        let slam = self.pipeline.slam();
        ControlFlow::Continue(self.shutter.after_frame(slam, self.num_keyframes))
    }

    /// Keeps the colours of keyframes.
    fn keep_colours(
        &self,
        colours: &FrameColours,
        rectification: Option<Rectification>,
        row: &FrameRow,
    ) {
        let became_keyframe = row.report().is_some_and(|report| report.created_keyframe);
        colours.pass(row.index, rectification, became_keyframe);
        if row.report().is_some() {
            for event in self.pipeline.slam().events() {
                if let Event::Finished(keyframe, _) = event {
                    colours.keep(keyframe.frame_index);
                }
            }
        }
    }

    /// Does with a frame what can be done with it; also when it was known where it is, or that it
    /// is nowhere.
    fn fate(&mut self, frame: ReadFrame) -> (FrameFate, Instant) {
        let fate = match frame.image {
            Some(Ok(image)) => {
                let next_due = self.next_due(frame.due, frame.timestamp_ns);
                let depth = self.measured(frame.index, frame.depth);
                let frame = FrameInput {
                    index: frame.index,
                    timestamp_ns: frame.timestamp_ns,
                    image,
                    depth,
                };
                return self.process(frame, next_due);
            }
            Some(Err(Unusable::Repeats)) => FrameFate::Repeated,
            Some(Err(reason)) => {
                let said = format!("frame {} skipped: {reason}", frame.index);
                self.progress.warn(&said);
                FrameFate::Skipped(reason.to_string())
            }
            None => FrameFate::Dropped,
        };
        self.pipeline.pass_over();
        (fate, Instant::now())
    }

    /// When the next frame comes from a source at its own pace, by the time since the last one.
    fn next_due(&mut self, due: Option<Instant>, timestamp_ns: i64) -> Option<Instant> {
        let last_ns = self.last_ns.replace(timestamp_ns)?;
        let since_ns = timestamp_ns.saturating_sub(last_ns);
        let interval_ns = since_ns.clamp(0, MAX_INTERVAL_NS);
        Some(due? + Duration::from_nanos(interval_ns as u64))
    }

    /// What says how far the pixels of a frame are; a frame of which that cannot be read has none.
    fn measured(
        &mut self,
        index: usize,
        depth: Option<Result<DepthInput, Unusable>>,
    ) -> Option<DepthInput> {
        depth?
            .inspect_err(|reason| {
                let said = format!("the depth of frame {index} is not used: {reason}");
                self.progress.warn(&said);
            })
            .ok()
    }

    fn process(&mut self, frame: FrameInput, next_due: Option<Instant>) -> (FrameFate, Instant) {
        if let Some(watch) = self.watch.as_mut().filter(|watch| !watch.is_decided()) {
            watch.add(&frame.image);
        }
        let mut posed = None;
        fault::pass("tracking");
        let report = self.pipeline.track_telling(frame, &mut |_| {
            let now = Instant::now();
            posed = Some(now);
            match next_due.is_some_and(|next_due| now >= next_due) {
                true => Effort::Hurried,
                false => Effort::Whole,
            }
        });
        let posed = posed.unwrap_or_else(Instant::now);
        for event in self.pipeline.slam().events() {
            match event {
                Event::Finished(..) => {
                    self.num_keyframes += 1;
                    if let Some(limit) = self.settings.memory_limit {
                        limit.apply(self.pipeline.slam());
                    }
                }
                Event::NotAdjusted(error) => {
                    let text = format!("a bundle adjustment failed: {error}");
                    self.progress.warn(&text);
                }
                Event::NotOptimised(error) => {
                    let text = format!("the graph of keyframes was not optimised: {error}");
                    self.progress.warn(&text);
                }
                _ => {}
            }
        }
        let seen = (self.pipeline.slam(), &self.shutter.taken_out);
        for warning in self.calibration.early(seen, self.num_keyframes) {
            self.progress.warn(warning);
        }
        (FrameFate::Processed(Box::new(report)), posed)
    }

    /// Whether so many frames in a row are unreadable that the source is given up.
    fn count_unreadable(&mut self, fate: &FrameFate) -> Option<EarlyEnd> {
        match fate {
            FrameFate::Skipped(reason) => {
                self.unreadable_in_a_row += 1;
                (self.unreadable_in_a_row >= MAX_UNREADABLE_IN_A_ROW)
                    .then(|| EarlyEnd::Unreadable(self.unreadable_in_a_row, reason.clone()))
            }
            // it was not read
            FrameFate::Dropped => None,
            FrameFate::Processed(_) | FrameFate::Repeated => {
                self.unreadable_in_a_row = 0;
                self.is_none_readable = false;
                None
            }
        }
    }

    /// Tracking has panicked: nothing more comes of it.
    pub fn fail(&mut self, message: &str) {
        self.early_end = Some(EarlyEnd::Failed(message.to_owned()));
    }

    /// Why the source has ended before its last frame, where nothing else has ended the run.
    fn end_of_source(&self, rows: &[FrameRow]) -> Option<EarlyEnd> {
        match rows.last().map(|row| &row.fate) {
            // the source ended because of it
            _ if self.interrupted.load(Ordering::Relaxed) => Some(EarlyEnd::Interrupted),
            Some(FrameFate::Skipped(reason)) if self.is_none_readable => {
                Some(EarlyEnd::Unreadable(rows.len(), reason.clone()))
            }
            _ => None,
        }
    }

    /// What the map says against the calibration, in sentences; nothing where a part of the program
    /// has failed.
    fn camera_warnings(&mut self, rows: &[FrameRow]) -> Vec<String> {
        if matches!(self.early_end, Some(EarlyEnd::Failed(_))) {
            return Vec::new();
        }
        if let Some(limit) = self.settings.memory_limit {
            // what the map says of the camera is a question to its points alone
            memory::keep_least();
            limit.squeeze(self.pipeline.slam());
        }
        let poses = (rows.iter()).filter_map(|row| row.report()?.world_from_camera);
        let share = poses.count() as f64 / rows.len().max(1) as f64;
        let seen = (self.pipeline.slam(), &self.shutter.taken_out);
        let left_radial = self.calibration.left_radial(seen);
        let mut warnings = self.calibration.end(seen, share);
        warnings.extend(self.shutter.conclusion());
        if let Some(radial) = left_radial {
            self.pipeline.take_left_radial(radial);
            warnings.push(format!(
                "the calibration leaves a radial distortion of {radial:+.4} in the images, by \
                 which the poses were adjusted in the end; --refine-calibration takes it out of \
                 the images"
            ));
        }
        warnings
    }

    /// After the last frame: everything that was found. Given the CPU time of the reader, and of
    /// the process before the first frame.
    pub fn finish(
        mut self,
        reading: Duration,
        process_before: Duration,
        salvage: Option<&Salvage>,
    ) -> Result<Tracked, Failure> {
        self.progress.finish();
        talk::doing("final adjustment of all poses");
        let rows = self.rows.finish()?;
        if let Some(salvage) = salvage {
            let size = self.pipeline.preparation().size();
            salvage.keep(self.pipeline.slam(), size, rows.len());
        }
        self.early_end = self.early_end.take().or_else(|| self.end_of_source(&rows));
        let mut warnings = self.camera_warnings(&rows);
        let seen = self.watch.take().map(MotionWatch::conclusion);
        let mut seen = seen.filter(|did| no_map(*did).is_some());
        if self.early_end.is_some() {
            // what came before the end is kept as it is
            warnings.extend(seen.take().and_then(no_map).map(str::to_owned));
        }
        let limit = self.settings.memory_limit;
        if let Some(viewer) = self.viewer {
            viewer.note_end();
        }
        let mut released = |slam: &Slam| {
            if let Some(limit) = limit {
                limit.squeeze(slam);
            }
        };
        let mut run = self.pipeline.finish_telling(&mut released);
        let failed = run.failure.take().map(|failure| match failure {
            PipelineError::Listener(error) => render(&anyhow::Error::from_boxed(error)),
            error => error.to_string(),
        });
        // what failed first is the reason
        let early_end = match self.early_end {
            Some(EarlyEnd::Failed(first)) => Some(EarlyEnd::Failed(first)),
            other => failed.map(EarlyEnd::Failed).or(other),
        };
        let others = reading + run.cpu.listening + run.cpu.mapping;
        Ok(Tracked {
            rows,
            moments: self.moments.finish(),
            cpu: CpuTimes {
                slam: (process_cpu() - process_before).saturating_sub(others),
                mapping: run.cpu.mapping,
                reading,
                recording: run.cpu.listening,
            },
            run,
            early_end,
            warnings,
            readout_ms: self.shutter.wanted_ms,
            no_map: self.no_map.or(seen),
        })
    }
}
