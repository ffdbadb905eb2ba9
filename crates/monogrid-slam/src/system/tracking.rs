//! A frame is tracked on the current keyframe, and believed or not.

use super::camera::{Active, Camera, Last};
use super::outcome::Attempt;
use super::setup::Setup;
use crate::frame::Frame;
use crate::map::Map;
use crate::policy::{Demand, DoubtEvidence, demand};
use crate::tracker::{
    MotionPrior, PointMap, Support, Tracked, extrapolate, is_convincing, track, track_with_points,
};
use crate::{LostReason, TrackingState};
use monogrid_alignment::{DepthSample, Motion, Reference};
use monogrid_geometry::{Rotation, Se3};
use monogrid_image::Pyramid;

/// Tracks a frame on the keyframe in use, and doubts what it finds; `None` without a keyframe.
pub(super) fn track_frame(
    setup: &Setup,
    map: &Map,
    camera: &Camera,
    frame: &Frame,
) -> Option<Attempt> {
    let (active, last) = (camera.active.as_ref()?, camera.last.as_ref()?);
    let tracked = track_on_active(setup, map, active, last, frame);
    Some(Attempt {
        keyframe: active.id,
        tracked: doubt(setup, tracked, camera.lost_in_a_row),
        doubt: None,
    })
}

/// Tracks a frame on the keyframe in use, and by the points of the map, from where the motion of the last frames
/// leads.
pub(super) fn track_on_active(
    setup: &Setup,
    map: &Map,
    active: &Active,
    last: &Last,
    frame: &Frame,
) -> Tracked {
    let config = &setup.config.tracking;
    let prior = motion_prior(setup, last, frame.timestamp_ns);
    let points = setup.config.sparse.enabled.then(|| PointMap {
        map,
        keyframe: &map[active.id],
        pinhole: &setup.pinhole,
        sparse: &setup.config.sparse,
    });
    track_with_points(
        &active.reference,
        frame,
        &prior,
        &last.pyramid,
        points.as_ref(),
        (&setup.pinhole, config),
    )
}

/// Where a frame should be if the camera goes on as in the last frames, and turns as the gyroscope says where there is one.
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
    let config = &setup.config.tracking;
    track(&reference, frame, &prior, None, &setup.pinhole, config)
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
    let evidence = DoubtEvidence {
        is_supported: tracked.support != Support::None,
        lost_in_a_row,
        is_surprising: tracked.is_surprising,
        is_degraded: tracked.state == TrackingState::Degraded,
    };
    let is_believed = match demand(&evidence, config) {
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
mod tests {
    use super::*;
    use monogrid_geometry::{Vec3, rotation_exp};

    #[test]
    fn another_turn_leaves_the_camera_at_its_place() {
        let step = Se3::new(
            rotation_exp(&Vec3::new(0.0, 0.1, 0.0)),
            Vec3::new(0.3, 0.0, -0.1),
        );
        let turn = rotation_exp(&Vec3::new(0.2, -0.4, 0.1));
        let found = turned(&step, turn);
        assert_eq!(found.rotation, turn);
        let place = |step: &Se3| step.inverse().translation;
        assert!((place(&found) - place(&step)).norm() < 1e-12);
    }
}
