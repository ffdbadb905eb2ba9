//! The pose that explains pixels and points.
//!
//! A pose by direct alignment agrees with the dense depth of one keyframe, whose depth is refined
//! with that very pose: both drift together (by degrees within ten frames of a turning camera)
//! while the residuals stay small. Points of several keyframes, adjusted with their poses, do not
//! take part in this: a few of them confirm the pose of every frame. Where they do not, or
//! alignment is weak or surprising, all are looked for from where alignment has them, and the pose
//! that most of them agree with is fused with that of alignment by their covariances. Where
//! alignment failed, they are looked for around the prediction, and random samples of them give the
//! pose.

use super::points::{PointMap, PointPose};
use super::{Support, Task, Tracked, judge};
use crate::TrackingState;
use crate::policy::{may_be_confirmed, state_at_points};
use monogrid_alignment::{Alignment, AlignmentConfig, Motion};
use monogrid_image::Pyramid;

impl Task<'_> {
    /// Tracks the frame by its pixels, then by the points of the map, if there is one.
    pub(crate) fn track_with_points(
        &self,
        previous: Option<&Pyramid>,
        map: Option<&PointMap<'_>>,
    ) -> Tracked {
        let aligned = self.track(previous);
        let Some(map) = map.filter(|_| self.config.points.enabled) else {
            return aligned;
        };
        let pyramid = &self.frame.pyramid;
        let by_alignment = aligned.alignment.motion;
        let pose = &by_alignment.frame_from_keyframe;
        if may_be_confirmed(aligned.state, aligned.is_surprising()) && map.confirms(pyramid, pose) {
            return Tracked {
                support: Support::Confirmed,
                ..aligned
            };
        }
        if aligned.state != TrackingState::Lost && !aligned.is_beyond_gate {
            let covariance = aligned.alignment.covariance.as_ref();
            if let Some(points) = map.pose_near(pyramid, pose, covariance) {
                return self.at_points(aligned, &points, by_alignment);
            }
        }
        let predicted = self.prior.motion().frame_from_keyframe;
        let starts = [&predicted, pose].into_iter();
        let mut finite = starts.filter(|start| start.is_finite());
        // of two things that points belong to, the one that moves as the room did
        let near = map.pose_near(pyramid, &predicted, None);
        let Some(points) =
            near.or_else(|| finite.find_map(|start| map.pose_around(pyramid, start)))
        else {
            return aligned;
        };
        // the brightness of an alignment that failed means nothing
        let start = Motion {
            frame_from_keyframe: points.frame_from_keyframe,
            ..self.prior.last_from_keyframe
        };
        let polished = self.polish(&start);
        self.at_points(aligned, &points, polished.motion)
    }

    /// The pose that the points gave, with what the pixels say about it.
    fn at_points(&self, aligned: Tracked, points: &PointPose, brightness: Motion) -> Tracked {
        let motion = Motion {
            frame_from_keyframe: points.frame_from_keyframe,
            ..brightness
        };
        let alignment = self.look(&motion);
        let (by_pixels, reason) = judge(&alignment, self.config);
        let state = state_at_points(by_pixels, reason);
        Tracked {
            is_beyond_gate: self.is_beyond_gate(&alignment.motion),
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
    fn look(&self, at: &Motion) -> Alignment {
        let config = &self.config.alignment;
        let settings = AlignmentConfig {
            coarsest_level: config.finest_level,
            max_iterations: vec![0; config.finest_level + 1],
            ..config.clone()
        };
        self.align(at, &settings)
    }
}
