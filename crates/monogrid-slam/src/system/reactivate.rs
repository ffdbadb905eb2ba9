//! Tracking goes on with a keyframe that exists already: where the camera stays in a known place,
//! the number of keyframes does not grow.
//!
//! The closest keyframe on which the frame can be tracked takes over. Its depth is refined further
//! and published again when it has become better. Where tracking and the poses disagree there is a
//! new keyframe instead: a loop is measured, not hidden.

use super::depth::stored_depth;
use super::tracking::track_on_other;
use crate::config::ReactivationConfig;
use crate::depth_step::tracking_samples;
use crate::frame::Frame;
use crate::map::{Map, MapKeyframe};
use crate::policy::{aligned_score, keyframe_score};
use crate::setup::Setup;
use crate::tracker::Tracked;
use crate::{KeyframeId, TrackingState};
use monogrid_alignment::{Alignment, Motion};
use monogrid_depth::DepthMap;
use monogrid_geometry::{Se3, Sim3};

/// Closest keyframes on which a frame is tracked to find out.
const MAX_CANDIDATES: usize = 2;
/// Largest score (distance and lost overlap, 1 where a new keyframe is made) as predicted from the
/// poses; the angle stands for the overlap.
const MAX_PREDICTED_SCORE: f64 = 1.0;
/// Smallest usage times share of good points.
const MIN_GOOD_USAGE: f32 = 0.7;
/// Largest score where there are enough old keyframes that should show about the same.
const CROWDED_MAX_SCORE: f64 = 2.0;
/// Largest difference of the tracked and the predicted pose there. So the number of keyframes in a
/// place is bounded.
const CROWDED_MAX_DISAGREEMENT: f64 = 0.1;

/// A keyframe that may show what the frame shows.
struct Candidate {
    id: KeyframeId,
    /// From the poses; translation in the candidate's units.
    frame_from_candidate: Se3,
    score: f64,
}

/// What a candidate must fulfil.
#[derive(Clone, Copy, Debug)]
struct Limits {
    score: f64,
    good_usage: f32,
    disagreement: f64,
}

/// A candidate that tracking confirms.
#[derive(Debug)]
pub(super) struct Confirmed {
    pub id: KeyframeId,
    pub depth: DepthMap,
    pub alignment: Alignment,
}

/// The closest keyframe that shows what the frame shows, and on which it can be tracked to
/// where the poses say that it is.
pub(super) fn find_known_view(
    setup: &Setup,
    map: &Map,
    (in_use_now, motion): (KeyframeId, &Motion),
    frame: &Frame,
) -> Option<Confirmed> {
    let config = in_use(setup);
    if !config.enabled {
        return None;
    }
    let current = &map[in_use_now];
    let exposure = current.exposure.then(motion.log_gain.exp(), motion.bias);
    let (candidates, limits) = choose(candidates(setup, map, (current, motion), &config), &config);
    candidates.into_iter().find_map(|candidate| {
        let keyframe = &map[candidate.id];
        let depth = stored_depth(setup, keyframe)?;
        let (gain, bias) = keyframe.exposure.relative(&exposure);
        let predicted = Motion {
            log_gain: gain.ln(),
            bias,
            ..Motion::from_pose(candidate.frame_from_candidate)
        };
        let samples = tracking_samples(&depth, &setup.config.tracking);
        let tracked = track_on_other(setup, &*keyframe.pyramid()?, &samples, frame, predicted);
        confirms(setup, &candidate, &tracked, limits).then_some(Confirmed {
            id: candidate.id,
            depth,
            alignment: tracked.alignment,
        })
    })
}

/// Keyframes that should show about the same as the frame.
fn candidates(
    setup: &Setup,
    map: &Map,
    (current, motion): (&MapKeyframe, &Motion),
    config: &ReactivationConfig,
) -> Vec<Candidate> {
    let keyframe_from_frame = Sim3::from(motion.frame_from_keyframe.inverse());
    let world_from_frame = current.world_from_keyframe * keyframe_from_frame;
    let width = setup.mask.width() as f64;
    let field_of_view = 2.0 * (0.5 * width / setup.pinhole.fx).atan();
    let recent = map.recent_in(current.fragment);
    let others = recent.iter().rev().skip(1 + config.min_keyframes_between);
    others
        .map(|id| &map[*id])
        .filter(|keyframe| keyframe.rank >= config.first_keyframe && keyframe.depth.is_some())
        .filter_map(|keyframe| {
            let candidate_from_frame = keyframe.world_from_keyframe.inverse() * world_from_frame;
            let turned = candidate_from_frame.rotation.angle() / field_of_view;
            let distance = candidate_from_frame.translation.norm();
            let usage = 1.0 - turned.min(1.0);
            let score = keyframe_score(distance, usage, &setup.config.keyframes);
            (score < MAX_PREDICTED_SCORE).then_some(Candidate {
                id: keyframe.id,
                frame_from_candidate: candidate_from_frame.to_se3().inverse(),
                score,
            })
        })
        .collect()
}

/// The settings; where no keyframe can be made, any closer one is better than none.
fn in_use(setup: &Setup) -> ReactivationConfig {
    let config = setup.config.keyframes.reactivation.clone();
    if !setup.is_frozen {
        return config;
    }
    ReactivationConfig {
        enabled: true,
        min_keyframes_between: 0,
        first_keyframe: 0,
        crowd: 1,
        ..config
    }
}

/// The closest candidates, and what they must fulfil: less where there is a crowd of them.
fn choose(mut candidates: Vec<Candidate>, config: &ReactivationConfig) -> (Vec<Candidate>, Limits) {
    candidates.sort_by(|a, b| a.score.total_cmp(&b.score).then(a.id.cmp(&b.id)));
    let limits = if candidates.len() >= config.crowd {
        candidates.truncate(config.crowd.max(MAX_CANDIDATES));
        Limits {
            score: CROWDED_MAX_SCORE,
            good_usage: 0.0,
            disagreement: CROWDED_MAX_DISAGREEMENT,
        }
    } else {
        candidates.truncate(MAX_CANDIDATES);
        Limits {
            score: config.max_score,
            good_usage: MIN_GOOD_USAGE,
            disagreement: config.max_disagreement,
        }
    };
    (candidates, limits)
}

/// Whether a frame was tracked on a candidate as well as on a keyframe of its own, to where it was
/// expected.
fn confirms(setup: &Setup, candidate: &Candidate, tracked: &Tracked, limits: Limits) -> bool {
    let alignment = &tracked.alignment;
    let found = &alignment.motion.frame_from_keyframe;
    let disagreement = *found * candidate.frame_from_candidate.inverse();
    tracked.state == TrackingState::Good
        && aligned_score(alignment, &setup.config.keyframes) < limits.score
        && alignment.usage * alignment.good_of_visible >= limits.good_usage
        && disagreement.log().norm() <= limits.disagreement
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Candidates with these scores, by identity.
    fn candidates(scores: &[f64]) -> Vec<Candidate> {
        let candidate = |(id, score): (usize, &f64)| Candidate {
            id: id as KeyframeId,
            frame_from_candidate: Se3::identity(),
            score: *score,
        };
        scores.iter().enumerate().map(candidate).collect()
    }

    fn ids(candidates: &[Candidate]) -> Vec<KeyframeId> {
        candidates.iter().map(|candidate| candidate.id).collect()
    }

    #[test]
    fn the_closest_two_are_tried_the_older_of_equal_ones_first() {
        let config = ReactivationConfig {
            crowd: 5,
            ..ReactivationConfig::default()
        };
        let (chosen, limits) = choose(candidates(&[0.9, 0.2, 0.5, 0.2]), &config);
        assert_eq!(ids(&chosen), [1, 3]);
        assert_eq!(limits.score, config.max_score);
        assert_eq!(limits.disagreement, config.max_disagreement);
        assert_eq!(limits.good_usage, MIN_GOOD_USAGE);
    }

    #[test]
    fn a_crowd_of_candidates_is_tried_with_wider_limits() {
        let config = ReactivationConfig {
            crowd: 4,
            ..ReactivationConfig::default()
        };
        let (chosen, limits) = choose(candidates(&[0.9, 0.2, 0.5, 0.3, 0.8]), &config);
        assert_eq!(ids(&chosen), [1, 3, 2, 4]);
        assert_eq!(limits.score, CROWDED_MAX_SCORE);
        assert_eq!(limits.disagreement, CROWDED_MAX_DISAGREEMENT);
        assert_eq!(limits.good_usage, 0.0);
    }
}
