//! A start after a loss whose first keyframe shows frames from before the loss: the map goes on
//! there, without a fragment.
//!
//! The frames of the loss, and then the last ones with a pose, are tracked backwards on the new
//! first keyframe. Those that the map and the start both know say where the start lies in the map,
//! and with which scale: a similarity of two paths. How well it is known follows from how well the
//! paths agree, over the length that they have in common.

use super::constrain::covariance_of;
use super::lost::Known;
use super::tracking::{Last, motion_prior, reference};
use crate::depth_step::tracking_samples;
use crate::graph::{Link, OdometryEdge};
use crate::map::Map;
use crate::policy::{BridgeEvidence, is_bridge};
use crate::setup::Setup;
use crate::start::Started;
use crate::tracker::Task;
use crate::{Bridge, KeyframeId, TrackingState};
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3, rotation_exp, rotation_log};
use std::collections::VecDeque;
use std::sync::Arc;

/// Where the first keyframe of a start lies in the map.
#[derive(Clone, Debug)]
pub(super) struct Landing {
    /// The keyframe on which the last frame before the loss was tracked.
    pub parent: KeyframeId,
    pub parent_from_start: Sim3,
    evidence: BridgeEvidence,
    /// Standard deviation of the position in the start's units.
    position_sigma: f64,
}

/// A frame as the map and the start have it.
#[derive(Clone, Copy, Debug)]
struct KnownTwice {
    /// In the world of the map.
    in_map: Se3,
    /// In the start's first keyframe, whose unit is its own.
    in_start: Se3,
}

/// Looks for the last frames with a pose in what a start shows; `None` where too few are seen,
/// or do not say enough.
pub(super) fn land(
    setup: &Setup,
    map: &Map,
    known: &VecDeque<Known>,
    started: &Started,
) -> Option<Landing> {
    let parent = &map[known.back()?.keyframe];
    let of_parent = |known: &&Known| map[known.keyframe].fragment == parent.fragment;
    let frames: Vec<&Known> = known.iter().filter(of_parent).rev().collect();
    let seen = seen_by_start(setup, started, &frames);
    let twice = frames.iter().zip(seen).map(|(known, in_start)| KnownTwice {
        in_map: map[known.keyframe].world_from_camera(&known.frame_from_keyframe),
        in_start,
    });
    let fit = Fit::of(&twice.collect::<Vec<_>>())?;
    is_bridge(&fit.evidence).then(|| Landing {
        parent: parent.id,
        parent_from_start: parent.world_from_keyframe.inverse() * fit.map_from_start,
        evidence: fit.evidence,
        position_sigma: fit.position_sigma / fit.map_from_start.scale,
    })
}

/// Poses of frames of the map, the last of them first, on the first keyframe of a start, as far as
/// each can be tracked from the one after it.
fn seen_by_start(setup: &Setup, started: &Started, known: &[&Known]) -> Vec<Se3> {
    let samples = tracking_samples(&started.depth, &setup.config.tracking);
    let reference = reference(setup, &started.keyframe.pyramid, &samples);
    let (step, interval_ns) = (started.first_step.inverse(), started.first_interval_ns());
    let mut last = Last::moving(&started.keyframe, step, interval_ns);
    let mut seen = Vec::new();
    let lost = started.earlier.iter().rev();
    let lost = lost.map(|frame| (setup.restored(frame), false));
    let known = known.iter().map(|known| {
        let when = (known.frame_index, known.timestamp_ns);
        (setup.of_pyramid(when, Arc::clone(&known.pyramid)), true)
    });
    for (frame, is_known) in lost.chain(known) {
        let prior = motion_prior(setup, &last, frame.timestamp_ns);
        let task = Task::new(setup, &reference, &frame, &prior);
        let tracked = task.track(Some(&*last.pyramid));
        if tracked.state != TrackingState::Good {
            break;
        }
        let motion = tracked.alignment.motion;
        last = Last::after(Some(&last), &frame, motion);
        if is_known {
            seen.push(motion.frame_from_keyframe.inverse());
        }
    }
    seen
}

/// The similarity between two paths.
#[derive(Clone, Copy, Debug)]
struct Fit {
    map_from_start: Sim3,
    evidence: BridgeEvidence,
    /// Standard deviation of a position, in units of the map.
    position_sigma: f64,
}

impl Fit {
    /// The rotation is the mean of those between the orientations, the scale the ratio of the
    /// extents of both paths.
    fn of(twice: &[KnownTwice]) -> Option<Self> {
        let n = twice.len() as f64;
        let turn = |t: &KnownTwice| t.in_map.rotation * t.in_start.rotation.inverse();
        let turns = twice.iter().map(turn);
        let first = turns.clone().next()?;
        let about_first = turns.map(|turn| rotation_log(&(first.inverse() * turn)));
        let about_first: Vec<Vec3> = about_first.collect();
        let mean_turn = about_first.iter().sum::<Vec3>() / n;
        let rotation: Rotation = first * rotation_exp(&mean_turn);
        let turn_errors = about_first.iter().map(|t| (t - mean_turn).norm_squared());

        let mean = |of: fn(&KnownTwice) -> Vec3| twice.iter().map(of).sum::<Vec3>() / n;
        let map_mean = mean(|t| t.in_map.translation);
        let start_mean = mean(|t| t.in_start.translation);
        let extent = |of: fn(&KnownTwice) -> Vec3, mean: Vec3| {
            rms(twice.iter().map(|t| (of(t) - mean).norm_squared()), 1.0)
        };
        let map_extent = extent(|t| t.in_map.translation, map_mean);
        let scale = map_extent / extent(|t| t.in_start.translation, start_mean);
        let map_from_start = Sim3::new(scale, rotation, map_mean - rotation * start_mean * scale);
        let errors = twice.iter().map(|t| {
            (map_from_start * t.in_start.translation - t.in_map.translation).norm_squared()
        });
        // seven numbers of each three positions are used up
        let position_sigma = rms(errors, (3.0 * n - 7.0).max(1.0));
        map_from_start.is_finite().then_some(Self {
            map_from_start,
            evidence: BridgeEvidence {
                num_frames: twice.len(),
                scale_sigma: position_sigma / map_extent,
                turn_rms: rms(turn_errors, n),
            },
            position_sigma,
        })
    }
}

fn rms(squares: impl Iterator<Item = f64>, n: f64) -> f64 {
    (squares.sum::<f64>() / n).sqrt()
}

impl Landing {
    /// What is told of it: its first keyframe is this one.
    pub(super) fn bridge(&self, first_keyframe: KeyframeId, first_frame: usize) -> Bridge {
        Bridge {
            from_keyframe: self.parent,
            first_keyframe,
            first_frame,
            common_frames: self.evidence.num_frames,
            scale_sigma: self.evidence.scale_sigma.max(MIN_SCALE_SIGMA),
        }
    }

    /// What the graph is told: the position is as uncertain as the frames disagree, and as the
    /// scale is over the way to the parent.
    pub(super) fn link(&self, first_keyframe: KeyframeId) -> Link {
        let start = &self.parent_from_start;
        let scale_sigma = self.evidence.scale_sigma.max(MIN_SCALE_SIGMA);
        let along = start.translation.norm() * scale_sigma;
        let position = (self.position_sigma * start.scale)
            .hypot(along)
            .max(MIN_POSITION_SIGMA);
        let turn = self.evidence.turn_rms.max(MIN_TURN_SIGMA);
        Link::Odometry(OdometryEdge {
            i: self.parent,
            j: first_keyframe,
            i_from_j: *start,
            covariance: covariance_of(position, turn),
            scale_sigma,
        })
    }
}

/// Nothing is claimed to be known better than this: parallax of a few frames, a keyframe's median
/// depth as the unit.
const MIN_SCALE_SIGMA: f64 = 0.02;
const MIN_POSITION_SIGMA: f64 = 0.005;
const MIN_TURN_SIGMA: f64 = 0.005;

#[cfg(test)]
mod tests;
