//! The pose that explains pixels and points.
//!
//! A pose by direct alignment agrees with the dense depth of one keyframe, whose depth is refined with that
//! very pose: both drift together (by degrees within ten frames of a turning camera) while the residuals stay
//! small. Points of several keyframes, adjusted with their poses, do not take part in this: a few of them confirm
//! the pose of every frame. Where they do not, or alignment is weak or surprising, all are looked for from where alignment
//! has them, and the pose that most of them agree with is fused with that of alignment by their covariances. Where alignment
//! failed, they are looked for around the prediction, and random samples of them give the pose.

use super::again::polish;
use super::points::{PointMap, PointPose};
use super::{MotionPrior, Support, Tracked, judge, track};
use crate::frame::Frame;
use crate::policy::{may_be_confirmed, state_at_points};
use crate::{TrackingConfig, TrackingState};
use monogrid_alignment::{Alignment, AlignmentConfig, Freedom, Motion, Reference, align};
use monogrid_geometry::Pinhole;
use monogrid_image::Pyramid;

/// Tracks `frame` on `reference` by its pixels, then by the points of the map, if there is one.
pub(crate) fn track_with_points(
    reference: &Reference,
    frame: &Frame,
    prior: &MotionPrior,
    previous: &Pyramid,
    map: Option<&PointMap<'_>>,
    (pinhole, config): (&Pinhole, &TrackingConfig),
) -> Tracked {
    let aligned = track(reference, frame, prior, Some(previous), pinhole, config);
    let Some(map) = map.filter(|_| config.points.enabled) else {
        return aligned;
    };
    let by_alignment = aligned.alignment.motion;
    let pose = &by_alignment.frame_from_keyframe;
    if may_be_confirmed(aligned.state, aligned.is_surprising)
        && map.confirms(&frame.pyramid, pose, &config.points)
    {
        return Tracked {
            support: Support::Confirmed,
            ..aligned
        };
    }
    let near = (aligned.state != TrackingState::Lost)
        .then(|| {
            let covariance = aligned.alignment.covariance.as_ref();
            map.pose_near(&frame.pyramid, pose, covariance, &config.points)
        })
        .flatten();
    if let Some(points) = near {
        return at_points(
            reference,
            frame,
            prior,
            aligned,
            &points,
            by_alignment,
            config,
        );
    }
    let predicted = prior.motion().frame_from_keyframe;
    let around = [predicted, by_alignment.frame_from_keyframe]
        .iter()
        .filter(|start| start.is_finite())
        .find_map(|start| map.pose_around(&frame.pyramid, start, &config.points));
    let Some(points) = around else {
        return aligned;
    };
    // the brightness of an alignment that failed means nothing
    let start = Motion {
        frame_from_keyframe: points.frame_from_keyframe,
        ..prior.last_from_keyframe
    };
    let polished = polish(reference, frame, &start, &config.alignment);
    at_points(
        reference,
        frame,
        prior,
        aligned,
        &points,
        polished.motion,
        config,
    )
}

/// The pose that the points gave, with what the pixels say about it.
fn at_points(
    reference: &Reference,
    frame: &Frame,
    prior: &MotionPrior,
    aligned: Tracked,
    points: &PointPose,
    brightness: Motion,
    config: &TrackingConfig,
) -> Tracked {
    let motion = Motion {
        frame_from_keyframe: points.frame_from_keyframe,
        ..brightness
    };
    let alignment = look(reference, frame, &motion, &config.alignment);
    let (by_pixels, reason) = judge(&alignment, config);
    let is_far = prior.distance_to(&motion) > config.points.max_jump;
    let state = state_at_points(by_pixels, is_far);
    if state == TrackingState::Lost {
        return Tracked {
            state,
            reason,
            ..aligned
        };
    }
    Tracked {
        alignment,
        support: Support::Held {
            num_points: points.num_inliers,
        },
        state,
        reason: reason.filter(|_| state != TrackingState::Good),
        ..aligned
    }
}

/// What the pixels say about a pose, which stays as it is.
fn look(reference: &Reference, frame: &Frame, at: &Motion, config: &AlignmentConfig) -> Alignment {
    let settings = AlignmentConfig {
        coarsest_level: config.finest_level,
        max_iterations: vec![0; config.finest_level + 1],
        ..config.clone()
    };
    align(reference, &frame.target, at, Freedom::Rigid, &settings)
}
