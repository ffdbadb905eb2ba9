//! Frames that were missed: the keyframe in use may show what frames saw that were taken before one with a pose.

use super::camera::{Active, Last};
use super::setup::Setup;
use super::slam::Slam;
use super::tracking::track_on_active;
use crate::TrackingState;
use crate::frame::{BufferedFrame, Frame};
use crate::map::{Change, Map, Record};
use monogrid_alignment::Motion;

/// Where frames are on the keyframe in use, tracked from a later frame backwards in time: the last of them first, up
/// to the first that cannot be believed.
pub(super) fn track_back(
    setup: &Setup,
    map: &Map,
    active: &Active,
    later: Last,
    frames: &[BufferedFrame],
) -> Vec<Motion> {
    let mut last = later;
    let mut motions = Vec::with_capacity(frames.len());
    for buffered in frames.iter().rev() {
        let frame = setup.restored(buffered);
        let tracked = track_on_active(setup, map, active, &last, &frame);
        if tracked.state != TrackingState::Good {
            break;
        }
        let motion = tracked.alignment.motion;
        last = Last::after(Some(&last), &frame, motion);
        motions.push(motion);
    }
    motions
}

impl Slam {
    /// Looks once more for the frames of a loss that ends with a frame, before that one is stored.
    pub(super) fn find_missed(&mut self, frame: &Frame, motion: Motion) {
        let missed = self.camera.loss.take_frames();
        let Some(active) = self.camera.active.as_ref().filter(|_| !missed.is_empty()) else {
            return;
        };
        let later = Last::after(self.camera.last.as_ref(), frame, motion).reversed();
        let motions = track_back(&self.setup, &self.map, active, later, &missed);
        self.store_backwards(&missed, &motions);
    }

    /// Stores the poses of frames, the last of them first, as far as they are known.
    pub(super) fn store_backwards(&mut self, frames: &[BufferedFrame], motions: &[Motion]) {
        for (frame, motion) in frames.iter().rev().zip(motions) {
            let pose = motion.frame_from_keyframe;
            let record = Record::new(frame.index, frame.timestamp_ns, pose);
            self.map.apply(Change::Tracked(record));
        }
    }
}

#[cfg(test)]
mod tests;
