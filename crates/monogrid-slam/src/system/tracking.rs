//! A frame is tracked on the current keyframe, and believed or not; so are frames that were missed:
//! the keyframe in use may show what frames saw that were taken before one with a pose.

use super::camera::{Active, Last};
use super::outcome::Attempt;
use super::setup::Setup;
use super::slam::Slam;
use crate::frame::{BufferedFrame, Frame};
use crate::policy::{Demand, demand};
use crate::tracker::{MotionPrior, PointMap, Task, Tracked, extrapolate, is_convincing};
use crate::{LostReason, TrackingState};
use monogrid_alignment::{DepthSample, Motion, Reference};
use monogrid_geometry::{Rotation, Se3};
use monogrid_image::Pyramid;

impl Slam {
    /// Tracks a frame on the keyframe in use, and doubts what it finds; `None` without a keyframe.
    pub(super) fn track_frame(&self, frame: &Frame) -> Option<Attempt> {
        let (active, last) = (self.camera.active.as_ref()?, self.camera.last.as_ref()?);
        let tracked = self.track_on_active(active, last, frame);
        Some(Attempt {
            keyframe: active.id,
            tracked: doubt(&self.setup, tracked, self.camera.lost_in_a_row),
        })
    }

    /// Tracks a frame on the keyframe in use, and by the points of the map, from where the motion
    /// of the last frames leads.
    pub(super) fn track_on_active(&self, active: &Active, last: &Last, frame: &Frame) -> Tracked {
        let setup = &self.setup;
        let prior = motion_prior(setup, last, frame.timestamp_ns);
        let points = setup.config.sparse.enabled.then(|| PointMap {
            map: &self.map,
            keyframe: &self.map[active.id],
            setup,
        });
        let task = Task::new(setup, &active.reference, frame, &prior);
        task.track_with_points(&last.pyramid, points.as_ref())
    }

    /// Where frames are on the keyframe in use, tracked from a later frame backwards in time: the
    /// last of them first, up to the first that cannot be believed.
    pub(super) fn track_back(
        &self,
        active: &Active,
        mut last: Last,
        frames: &[BufferedFrame],
    ) -> Vec<Motion> {
        let mut motions = Vec::with_capacity(frames.len());
        for buffered in frames.iter().rev() {
            let frame = self.setup.restored(buffered);
            let tracked = self.track_on_active(active, &last, &frame);
            if tracked.state != TrackingState::Good {
                break;
            }
            let motion = tracked.alignment.motion;
            last = Last::after(Some(&last), &frame, motion);
            motions.push(motion);
        }
        motions
    }

    /// Looks once more for the frames of a loss that ends with a frame, before that one is stored.
    pub(super) fn find_missed(&mut self, frame: &Frame, motion: Motion) {
        let missed = self.camera.loss.take_frames();
        let Some(active) = self.camera.active.as_ref().filter(|_| !missed.is_empty()) else {
            return;
        };
        let later = Last::after(self.camera.last.as_ref(), frame, motion).reversed();
        let motions = self.track_back(active, later, &missed);
        self.store_backwards(&missed, &motions);
    }

    /// Stores the poses of frames, the last of them first, as far as they are known.
    pub(super) fn store_backwards(&mut self, frames: &[BufferedFrame], motions: &[Motion]) {
        for (frame, motion) in frames.iter().rev().zip(motions) {
            let pose = motion.frame_from_keyframe;
            self.map.track(frame.index, frame.timestamp_ns, pose);
        }
    }
}

/// Where a frame should be if the camera goes on as in the last frames, and turns as the gyroscope
/// says where there is one.
pub(super) fn motion_prior(setup: &Setup, last: &Last, timestamp_ns: i64) -> MotionPrior {
    let interval_ns = (timestamp_ns - last.timestamp_ns).abs();
    let frame_from_last = if setup.config.tracking.motion_hypotheses {
        extrapolate(&last.frame_from_previous, last.interval_ns, interval_ns)
    } else {
        Se3::identity()
    };
    let turn = setup.turn(last.timestamp_ns, timestamp_ns);
    MotionPrior {
        last_from_keyframe: last.motion,
        frame_from_last: turn.map_or(frame_from_last, |turn| turned(&frame_from_last, turn)),
    }
}

/// The same way with another turn: the camera comes to the same place.
fn turned(frame_from_last: &Se3, turn: Rotation) -> Se3 {
    let place_in_last = frame_from_last.inverse().translation;
    Se3::new(turn, -(turn * place_in_last))
}

/// Tracks a frame on a keyframe that is not in use, from a predicted pose.
pub(super) fn track_on_other(
    setup: &Setup,
    keyframe: &Pyramid,
    samples: &[DepthSample],
    frame: &Frame,
    predicted: Motion,
) -> Tracked {
    let reference = reference(setup, keyframe, samples);
    let prior = MotionPrior {
        last_from_keyframe: predicted,
        frame_from_last: Se3::identity(),
    };
    Task::new(setup, &reference, frame, &prior).track(None)
}

/// The points of a keyframe that frames are tracked on.
pub(super) fn reference(setup: &Setup, keyframe: &Pyramid, samples: &[DepthSample]) -> Reference {
    let levels = &setup.config.tracking.alignment;
    let (finest, coarsest) = (levels.finest_level, levels.coarsest_level);
    Reference::new(keyframe, &setup.pinhole, samples, finest, coarsest)
}

/// A pose that is doubtful for other reasons than its residuals must be convincing to count.
fn doubt(setup: &Setup, tracked: Tracked, lost_in_a_row: usize) -> Tracked {
    let config = &setup.config.tracking;
    let is_believed = match demand(&tracked, lost_in_a_row) {
        Demand::None => true,
        Demand::Convincing => is_convincing(&tracked.alignment, false, config),
        Demand::ConvincingAfterLoss => is_convincing(&tracked.alignment, true, config),
    };
    if tracked.state == TrackingState::Lost || is_believed {
        return tracked;
    }
    Tracked {
        state: TrackingState::Lost,
        reason: Some(LostReason::Residuals),
        ..tracked
    }
}

#[cfg(test)]
mod tests;
