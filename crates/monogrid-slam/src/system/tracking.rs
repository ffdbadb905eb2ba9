//! A frame is tracked on the current keyframe, and believed or not; so are frames that were missed:
//! the keyframe in use may show what frames saw that were taken before one with a pose.

use super::outcome::Attempt;
use crate::frame::{BufferedFrame, Frame};
use crate::graph::Relocalised;
use crate::map::Map;
use crate::policy::{Demand, demand, is_where_recognised};
use crate::setup::Setup;
use crate::tracker::{
    Accelerations, MotionPrior, PointMap, Task, Tracked, extrapolate, is_convincing,
};
use crate::{KeyframeId, LostReason, TrackingState};
use monogrid_alignment::{DepthPixel, Motion, Reference};
use monogrid_geometry::{Rotation, Se3, Vec3};
use monogrid_image::Pyramid;
use std::sync::Arc;

/// Tracks frames on the keyframe in use.
#[derive(Debug, Default)]
pub(super) struct Tracker {
    /// The keyframe in use.
    pub active: Option<Active>,
    /// The last frame with a believed pose.
    pub last: Option<Last>,
}

/// The keyframe that frames are tracked on.
#[derive(Debug)]
pub(super) struct Active {
    pub id: KeyframeId,
    /// Of its image.
    pyramid: Arc<Pyramid>,
    /// Its points.
    reference: Reference,
}

impl Active {
    /// A keyframe with the points that frames are tracked on.
    pub(super) fn new(
        setup: &Setup,
        id: KeyframeId,
        pyramid: Arc<Pyramid>,
        samples: &[DepthPixel],
    ) -> Self {
        Self {
            id,
            reference: reference(setup, &pyramid, samples),
            pyramid,
        }
    }
}

impl Tracker {
    /// Tracks a frame on the keyframe in use, and doubts what it finds; `None` without a keyframe.
    pub(super) fn step(
        &self,
        setup: &Setup,
        map: &Map,
        frame: &Frame,
        lost_in_a_row: usize,
    ) -> Option<Attempt> {
        let (active, last) = (self.active.as_ref()?, self.last.as_ref()?);
        Some(Attempt {
            keyframe: active.id,
            tracked: active.track(setup, map, last, frame, lost_in_a_row),
            is_certain: map[active.id].is_certain(),
        })
    }

    /// Tracks a frame that comes before the one with the last pose. Nothing is said of how it
    /// compares with the frames before it, since these are not known yet.
    pub(super) fn step_back(&self, setup: &Setup, map: &Map, frame: &Frame) -> Option<Attempt> {
        let (active, last) = (self.active.as_ref()?, self.last.as_ref()?);
        Some(Attempt {
            keyframe: active.id,
            tracked: active.track(setup, map, last, frame, 0),
            is_certain: map[active.id].is_certain(),
        })
    }

    /// Poses of frames before the one with the last pose, as [`Active::track_back`].
    pub(super) fn track_back(
        &self,
        setup: &Setup,
        map: &Map,
        frames: &[BufferedFrame],
    ) -> Option<Vec<Motion>> {
        let (active, last) = (self.active.as_ref()?, self.last.clone()?);
        Some(active.track_back(setup, map, last, frames))
    }

    /// Poses of frames that were missed before one that is tracked now.
    pub(super) fn find_missed(
        &self,
        setup: &Setup,
        map: &Map,
        (frame, motion): (&Frame, Motion),
        missed: &[BufferedFrame],
    ) -> Vec<Motion> {
        let Some(active) = self.active.as_ref().filter(|_| !missed.is_empty()) else {
            return Vec::new();
        };
        let later = Last::after(self.last.as_ref(), frame, motion).reversed();
        active.track_back(setup, map, later, missed)
    }

    /// A pose is believed: it is the prior of the next frame.
    pub(super) fn believe(&mut self, frame: &Frame, motion: Motion) {
        self.last = Some(Last::after(self.last.as_ref(), frame, motion));
    }

    /// The depth of the keyframe in use was refined.
    pub(super) fn follow_depth(&mut self, setup: &Setup, samples: &[DepthPixel]) {
        if let Some(Active { id, pyramid, .. }) = self.active.take() {
            self.active = Some(Active::new(setup, id, pyramid, samples));
        }
    }

    /// Tracking goes on with another keyframe; `in_units` expresses lengths in its units.
    pub(super) fn continue_on(&mut self, motion: Motion, in_units: impl Fn(Vec3) -> Vec3) {
        if let Some(last) = self.last.as_mut() {
            last.motion = motion;
            let step = &mut last.frame_from_previous;
            step.translation = in_units(step.translation);
        }
    }
}

impl Active {
    /// Tracks a frame on the keyframe in use, and by the points of the map, from where the motion
    /// of the last frames leads, and doubts what it finds; before it so many frames were lost.
    fn track(
        &self,
        setup: &Setup,
        map: &Map,
        last: &Last,
        frame: &Frame,
        lost_in_a_row: usize,
    ) -> Tracked {
        let prior = motion_prior(setup, last, frame.timestamp_ns);
        let points = points_of(setup, map, self.id);
        let task = Task::new(setup, &self.reference, frame, &prior);
        let tracked = task.track_with_points(Some(&*last.pyramid), points.as_ref());
        doubt(setup, tracked, lost_in_a_row)
    }

    /// Where frames are on the keyframe in use, tracked from a later frame backwards in time: the
    /// last of them first, up to the first that cannot be believed. Each is the prior of the one
    /// before it in time, so that a picture of another place would lead farther and farther away.
    fn track_back(
        &self,
        setup: &Setup,
        map: &Map,
        mut last: Last,
        frames: &[BufferedFrame],
    ) -> Vec<Motion> {
        let mut motions = Vec::with_capacity(frames.len());
        for buffered in frames.iter().rev() {
            let frame = setup.restored(buffered);
            let tracked = self.track(setup, map, &last, &frame, 0);
            if tracked.state != TrackingState::Good {
                break;
            }
            let motion = tracked.alignment.motion;
            last = Last::after(Some(&last), &frame, motion);
            motions.push(motion);
        }
        motions
    }
}

/// The last frame with a believed pose.
#[derive(Clone, Debug)]
pub(super) struct Last {
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    /// Relative to the keyframe in use.
    pub motion: Motion,
    /// Motion between the last two distinct frames, in the units of the keyframe in use, and its
    /// time.
    pub frame_from_previous: Se3,
    pub interval_ns: i64,
    accelerations: Accelerations,
}

impl Last {
    /// A frame after another, if that one's pose is known.
    pub(super) fn after(previous: Option<&Self>, frame: &Frame, motion: Motion) -> Self {
        let (frame_from_previous, interval_ns, accelerations) = match previous {
            Some(last) => last.step_to(frame, &motion),
            None => (Se3::identity(), 0, Accelerations::default()),
        };
        Self {
            accelerations,
            timestamp_ns: frame.timestamp_ns,
            pyramid: Arc::clone(&frame.pyramid),
            motion,
            frame_from_previous,
            interval_ns,
        }
    }

    /// The step from this frame to another, its time, and how the camera accelerated up to there.
    fn step_to(&self, frame: &Frame, motion: &Motion) -> (Se3, i64, Accelerations) {
        let step = motion.frame_from_keyframe * self.motion.frame_from_keyframe.inverse();
        let interval_ns = (frame.timestamp_ns - self.timestamp_ns).abs();
        let times = (self.interval_ns, interval_ns);
        let expected = extrapolate(&self.frame_from_previous, self.interval_ns, interval_ns);
        let mut accelerations = self.accelerations.clone();
        accelerations.add((&step, &expected), times);
        (step, interval_ns, accelerations)
    }

    /// A first keyframe, from where the camera moves by a step.
    pub(super) fn moving(keyframe: &Frame, step: Se3, interval_ns: i64) -> Self {
        Self {
            frame_from_previous: step,
            interval_ns,
            ..Self::after(None, keyframe, Motion::from_pose(Se3::identity()))
        }
    }

    /// The same frame for a camera that goes its way backwards.
    pub(super) fn reversed(self) -> Self {
        Self {
            frame_from_previous: self.frame_from_previous.inverse(),
            ..self
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
        gate: last.accelerations.gate(last.interval_ns, interval_ns),
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
    samples: &[DepthPixel],
    frame: &Frame,
    predicted: Motion,
) -> Tracked {
    let reference = reference(setup, keyframe, samples);
    Task::new(setup, &reference, frame, &MotionPrior::at(predicted)).track(None)
}

/// Tracks a frame by its pixels and the points of the map, from where its corners were recognised.
pub(super) fn track_where_recognised(
    setup: &Setup,
    map: &Map,
    found: &Relocalised,
    frame: &Frame,
) -> Option<Tracked> {
    let view = &found.view;
    let (pyramid, samples) = (view.image.pyramid()?, view.samples.get()?);
    let reference = reference(setup, &pyramid, &samples);
    let prior = MotionPrior::at(Motion::from_pose(found.frame_from_keyframe));
    let points = points_of(setup, map, view.id);
    let tracked =
        Task::new(setup, &reference, frame, &prior).track_with_points(None, points.as_ref());
    is_where_recognised(&tracked).then_some(tracked)
}

/// The points of the sparse layer as a keyframe has them.
fn points_of<'a>(setup: &'a Setup, map: &'a Map, keyframe: KeyframeId) -> Option<PointMap<'a>> {
    setup.config.sparse.enabled.then(|| PointMap {
        map,
        keyframe: &map[keyframe],
        setup,
    })
}

/// The points of a keyframe that frames are tracked on.
pub(super) fn reference(setup: &Setup, keyframe: &Pyramid, samples: &[DepthPixel]) -> Reference {
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
        Demand::Points => false,
    };
    let reason = if tracked.is_beyond_gate {
        LostReason::Jump
    } else {
        LostReason::Residuals
    };
    if tracked.state == TrackingState::Lost || is_believed {
        return tracked;
    }
    Tracked {
        state: TrackingState::Lost,
        reason: Some(reason),
        ..tracked
    }
}

#[cfg(test)]
mod tests;
