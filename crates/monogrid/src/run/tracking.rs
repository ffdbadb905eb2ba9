//! The thread that tracks: frames in, changes of the map of keyframes out.

use super::RunSettings;
use super::change::Change;
use super::frames::{FrameFate, FrameRow};
use super::progress::Progress;
use super::reader::{Content, Delivered};
use super::sessions::continuation;
use crate::input::MAX_UNREADABLE_IN_A_ROW;
use monogrid_datasets::EndRecord;
use monogrid_image::GrayImage;
use monogrid_slam::{Event, FrameInput, PoseSnapshot, Slam, TrajectoryPose};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};

/// Why a run ended before its last frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EarlyEnd {
    /// The user interrupted it.
    Interrupted,
    /// Too many frames in a row were unreadable; the reason of the last.
    Unreadable(String),
}

/// The system, and who is told about its keyframes.
pub struct Tracking<'a> {
    slam: Slam,
    settings: &'a RunSettings,
    rows: Vec<FrameRow>,
    /// Keyframes that the listeners know.
    num_keyframes: usize,
    /// Recorder and mapper; none when the map stays as it is.
    listeners: Vec<SyncSender<Change>>,
    progress: Progress,
}

/// What tracking leaves behind.
pub struct Ended {
    /// Every frame.
    pub rows: Vec<FrameRow>,
    /// Frames with a believed pose, final.
    pub trajectory: Vec<TrajectoryPose>,
    /// The system, which holds the finished keyframes.
    pub slam: Slam,
    /// Final poses of the keyframes.
    pub snapshot: Arc<PoseSnapshot>,
}

impl<'a> Tracking<'a> {
    /// Begins; listeners hear at once of the keyframes of an earlier session, which are new to them.
    pub fn begin(
        slam: Slam,
        settings: &'a RunSettings,
        num_frames: usize,
        listeners: Vec<SyncSender<Change>>,
    ) -> Self {
        let mut this = Self {
            slam,
            settings,
            rows: Vec::with_capacity(num_frames),
            num_keyframes: 0,
            listeners,
            progress: Progress::new(num_frames, settings.show_progress),
        };
        this.publish();
        this
    }

    /// Takes frames until there are no more, the user stops, or the source is unreadable.
    pub fn process_all(
        &mut self,
        frames: &Receiver<Delivered>,
        interrupted: &AtomicBool,
    ) -> Option<EarlyEnd> {
        let mut unreadable_in_a_row = 0;
        for delivered in frames {
            if interrupted.load(Ordering::Relaxed) {
                return Some(EarlyEnd::Interrupted);
            }
            let row = self.take(delivered);
            let early_end = match &row.fate {
                FrameFate::Skipped(reason) => {
                    unreadable_in_a_row += 1;
                    (unreadable_in_a_row >= MAX_UNREADABLE_IN_A_ROW)
                        .then(|| EarlyEnd::Unreadable(reason.clone()))
                }
                // it was not read
                FrameFate::Dropped => None,
                FrameFate::Processed(_) | FrameFate::BeforeSeed => {
                    unreadable_in_a_row = 0;
                    None
                }
            };
            self.progress.frame(&row, self.num_keyframes);
            self.rows.push(row);
            if early_end.is_some() {
                return early_end;
            }
        }
        None
    }

    /// Does with a frame what can be done with it.
    fn take(&mut self, delivered: Delivered) -> FrameRow {
        let Delivered {
            index,
            timestamp_ns,
            content,
        } = delivered;
        let fate = match content {
            Content::Image(image) => self.process(index, timestamp_ns, image),
            Content::Unusable(reason) => {
                self.progress
                    .warn(&format!("frame {index} skipped: {reason}"));
                FrameFate::Skipped(reason)
            }
            Content::TooEarly => FrameFate::Dropped,
        };
        FrameRow {
            index,
            timestamp_ns,
            fate,
        }
    }

    fn process(&mut self, index: usize, timestamp_ns: i64, image: GrayImage) -> FrameFate {
        let seed_depth = match &self.settings.seed_depth {
            Some((seeded, _)) if index < *seeded => return FrameFate::BeforeSeed,
            Some((seeded, depth)) if index == *seeded => Some(depth.clone()),
            _ => None,
        };
        let report = self.slam.process_frame(FrameInput {
            index,
            timestamp_ns,
            image,
            seed_depth,
        });
        self.publish();
        FrameFate::Processed(Box::new(report))
    }

    /// Tells the listeners about new keyframes, and new depth and poses of old ones.
    fn publish(&mut self) {
        for event in self.slam.events() {
            let change = match event {
                Event::Finished(keyframe, poses) => {
                    self.num_keyframes += 1;
                    Change::Finished(Arc::clone(keyframe), Arc::clone(poses))
                }
                Event::Revised(keyframe) => Change::Revised(Arc::clone(keyframe)),
                Event::Moved(poses) => Change::Moved(Arc::clone(poses)),
                Event::NotAdjusted(error) => {
                    self.progress
                        .warn(&format!("a bundle adjustment failed: {error}"));
                    continue;
                }
                Event::Lost { .. } | Event::Found { .. } | Event::Started(_) | Event::Joined(_) => {
                    continue;
                }
            };
            self.send(&change);
        }
    }

    /// A listener that has failed says so when it is joined.
    fn send(&self, change: &Change) {
        for listener in &self.listeners {
            let _ = listener.send(change.clone());
        }
    }

    /// Finishes the last keyframe and closes the channels.
    pub fn finish(mut self, source: &str) -> Ended {
        self.slam.finish();
        self.publish();
        let snapshot = self.slam.snapshot();
        let trajectory = self.slam.trajectory();
        let end = EndRecord {
            num_frames: self.rows.len() as u64,
            num_tracked: trajectory.len() as u64,
            summary: String::new(),
        };
        if !self.listeners.is_empty() {
            let continuation = continuation(&self.slam, self.settings.earlier(), source);
            let continuation = Arc::new(continuation);
            self.send(&Change::End(Arc::clone(&snapshot), continuation, end));
        }
        self.progress.finish();
        Ended {
            rows: self.rows,
            trajectory,
            slam: self.slam,
            snapshot,
        }
    }
}
