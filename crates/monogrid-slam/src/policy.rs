//! When a pose is believed, when points decide where a frame is, and when it becomes a keyframe.

use crate::tracker::{Support, Tracked};
use crate::{
    FragmentConfig, FragmentId, KeyframeConfig, LostReason, RefinementConfig, TrackingState,
};
use monogrid_alignment::Alignment;
use std::cmp::Reverse;

/// Frames of before a loss that must be tracked on a start.
const MIN_BRIDGE_FRAMES: usize = 4;
/// Largest standard deviation of the logarithm of the scale by which their positions agree.
pub(crate) const MAX_BRIDGE_SCALE_SIGMA: f64 = 0.1;
/// Largest root mean square of the angles between their orientations, degrees.
const MAX_BRIDGE_TURN_DEG: f64 = 1.0;
/// Largest relative standard deviation of the scale behind a loss, against that before it, with
/// which a fragment of the map is joined by inertial readings alone.
const MAX_JOIN_SCALE_SIGMA: f64 = 0.03;
/// Largest standard deviation of its position, as a share of the way during the loss.
const MAX_JOIN_POSITION_SHARE: f64 = 0.03;
/// Standard deviation of the position with which it is joined however short the way was, m.
const JOIN_POSITION_SIGMA_M: f64 = 0.02;

/// Usage below which the next keyframe is made at once.
const URGENT_USAGE: f64 = 0.35;
/// First frames of a keyframe, all of which refine it.
pub(crate) const FIRST_FRAMES: usize = 2;
/// Distance from the last frame that refined it, in units of the mean depth, from which a frame is
/// not passed over.
const MAX_PASSED_DISTANCE: f64 = 0.03;

/// For this many frames after a loss a pose near the prediction needs only the evidence of any
/// other frame.
const RETURN_NEAR_FRAMES: usize = 5;
/// Fewest points that decide where a frame is.
pub(crate) const MIN_POINT_INLIERS: usize = 30;
/// Smallest share of the points that were found, for these to decide where a frame is.
const MIN_POINT_INLIER_SHARE: f64 = 0.5;

/// What a pose must show before it is believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Demand {
    /// Nothing more.
    None,
    /// What a picture of another place could not show by chance.
    Convincing,
    /// The same, and almost all points fit: the camera may be anywhere.
    ConvincingAfterLoss,
    /// Points, since no image can: the camera cannot have come there.
    Points,
}

/// Points that agree leave no doubt: those near where the motion leads were asked first, and if
/// none of them do, the pose before may be wrong. Pixels alone that lead beyond the gate are of
/// another thing than the room. Right after a loss the camera is near where it was expected, and a
/// pose there needs no more than that of any other frame; a camera that moves on has no second
/// chance.
pub(crate) fn demand(tracked: &Tracked, lost_in_a_row: usize) -> Demand {
    let is_near = lost_in_a_row <= RETURN_NEAR_FRAMES && !tracked.has_other_gain;
    if tracked.support != Support::None {
        Demand::None
    } else if tracked.is_beyond_gate {
        Demand::Points
    } else if lost_in_a_row > 0 && !is_near {
        Demand::ConvincingAfterLoss
    } else if tracked.has_other_gain || tracked.state == TrackingState::Degraded {
        Demand::Convincing
    } else {
        Demand::None
    }
}

/// Whether a lost frame is where its corners were recognised: its pixels or points lead no
/// farther away than the camera can be. Weak pixels are enough, since the corners said the same.
pub(crate) fn is_where_recognised(tracked: &Tracked) -> bool {
    tracked.state != TrackingState::Lost
        && (tracked.support != Support::None || !tracked.is_beyond_gate)
}

/// Whether a few points that agree are enough to let a pose by alignment stand; else all points are
/// asked. What is weak or unexpected may be another place that looks alike there.
pub(crate) const fn may_be_confirmed(state: TrackingState, is_surprising: bool) -> bool {
    matches!(state, TrackingState::Good) && !is_surprising
}

/// How far a pose by points is believed, of which the pixels say so much, and why. Where they
/// disagree altogether it is believed, but the frame says nothing about the depth of the keyframe.
/// Too few pixels with depth are no contradiction: the frame gives more of them theirs.
pub(crate) const fn state_at_points(
    by_pixels: TrackingState,
    reason: Option<LostReason>,
) -> TrackingState {
    match by_pixels {
        TrackingState::Lost if matches!(reason, Some(LostReason::NoTexture)) => TrackingState::Good,
        TrackingState::Lost => TrackingState::Degraded,
        TrackingState::Degraded | TrackingState::Good => TrackingState::Good,
        other => other,
    }
}

/// Whether points decide where a frame is: enough of them agree with one pose, and they are the
/// larger part of those that were found.
pub(crate) fn do_points_decide(num_inliers: usize, num_found: usize) -> bool {
    num_inliers >= MIN_POINT_INLIERS
        && num_inliers as f64 >= MIN_POINT_INLIER_SHARE * num_found as f64
}

/// How well a start after a loss is known by the frames that it shares with the map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BridgeEvidence {
    /// These frames.
    pub num_frames: usize,
    /// Standard deviation of the logarithm of the scale, by how well their positions agree.
    pub scale_sigma: f64,
    /// Root mean square of the angles between their orientations, rad.
    pub turn_rms: f64,
}

/// Whether the map goes on with a start after a loss: enough frames agree about where it is. Frames
/// of another place agree with nothing.
pub(crate) fn is_bridge(evidence: &BridgeEvidence) -> bool {
    // NaN is no bridge
    evidence.num_frames >= MIN_BRIDGE_FRAMES
        && evidence.scale_sigma <= MAX_BRIDGE_SCALE_SIGMA
        && evidence.turn_rms <= MAX_BRIDGE_TURN_DEG.to_radians()
}

/// How well the readings of an inertial sensor say where a fragment lies in the map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaceEvidence {
    /// Standard deviation of the logarithm of its scale against that of the map.
    pub scale_sigma: f64,
    /// Standard deviation of its position, m.
    pub position_sigma_m: f64,
    /// Way of the camera between the map and the fragment, m.
    pub loss_m: f64,
}

/// Whether a fragment is joined to the map by the readings alone.
pub(crate) fn is_placed(evidence: &PlaceEvidence) -> bool {
    let share = MAX_JOIN_POSITION_SHARE * evidence.loss_m;
    // NaN is no place
    evidence.scale_sigma <= MAX_JOIN_SCALE_SIGMA
        && evidence.position_sigma_m <= share.max(JOIN_POSITION_SIGMA_M)
}

/// Which fragment is the map in the end, if not the main map: the one with the most frames (the
/// oldest of equal ones), where it has many more. `frames` are those of the main map, `apart` the
/// fragments that are not joined, with theirs.
pub(crate) fn larger_map(
    frames: usize,
    apart: impl Iterator<Item = (FragmentId, usize)>,
    config: &FragmentConfig,
) -> Option<FragmentId> {
    let (id, most) = apart.max_by_key(|(id, frames)| (*frames, Reverse(*id)))?;
    let needed = config.min_times_larger * frames as f64;
    (most > frames && most as f64 >= needed).then_some(id)
}

/// What the decision looks at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KeyframeEvidence {
    /// Distance from the keyframe times its mean inverse depth.
    pub relative_distance: f64,
    /// Share of the keyframe that the frame still resolves.
    pub usage: f64,
    /// Share of good points of the visible ones.
    pub good_of_visible: f32,
    /// Points that gave the pose; `None` where alignment did.
    pub num_holding: Option<usize>,
    /// Frames that were good enough to refine the keyframe's depth.
    pub num_mapped: usize,
    /// Keyframes that exist already.
    pub num_keyframes: usize,
}

/// How far a frame is from a keyframe: 1 where a new keyframe is needed. `[LSD14]` weighted
/// combination of distance, in units of the mean depth, and lost overlap.
pub(crate) fn keyframe_score(relative_distance: f64, usage: f64, config: &KeyframeConfig) -> f64 {
    let distance = relative_distance * config.distance_weight;
    let lost = (1.0 - usage) * config.usage_weight;
    distance * distance + lost * lost
}

/// The same as alignment of the frame to the keyframe has it.
pub(crate) fn aligned_score(alignment: &Alignment, config: &KeyframeConfig) -> f64 {
    let keyframe_from_frame = alignment.motion.frame_from_keyframe.inverse();
    let usage = f64::from(alignment.usage);
    keyframe_score(keyframe_from_frame.translation.norm(), usage, config)
}

/// The score against a threshold that grows over the first keyframes of a random start.
pub(crate) fn is_new_keyframe(evidence: &KeyframeEvidence, config: &KeyframeConfig) -> bool {
    if evidence.num_mapped < config.min_mapped_frames {
        // A frame that has lost most of the keyframe cannot wait, nor one that its depth does not
        // explain.
        return evidence.usage < URGENT_USAGE
            || evidence.good_of_visible < config.urgent_good_of_visible;
    }
    let ramp = if config.ramp_keyframes > 0 && evidence.num_keyframes < config.ramp_keyframes {
        0.7 * (0.2 + 0.16 * evidence.num_keyframes as f64)
    } else {
        1.0
    };
    let is_slipping = |num_points: usize| num_points < config.min_holding_points;
    evidence.good_of_visible < config.min_good_of_visible
        || evidence.num_holding.is_some_and(is_slipping)
        || keyframe_score(evidence.relative_distance, evidence.usage, config) > ramp
}

/// Frames in a row that refine no depth because the next one waits: a computer that is always late
/// makes a map all the same.
const MAX_HURRIED: usize = 6;

/// Whether a tracked frame refines the depth of the keyframe in use. Before it were `num_mapped`
/// frames that were good enough for it, `num_passed` of them after the last that refined it, which
/// is at this distance in units of the keyframe's mean depth; `is_hurried` where the next frame
/// waits already.
pub(crate) fn is_refining(
    (num_mapped, num_passed): (usize, usize),
    relative_distance: f64,
    is_hurried: bool,
    config: &RefinementConfig,
) -> bool {
    if is_hurried && num_passed < MAX_HURRIED {
        return false;
    }
    num_mapped < FIRST_FRAMES
        || num_passed >= config.max_passed
        || relative_distance >= MAX_PASSED_DISTANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracker::tests::perfect;

    #[test]
    fn points_overrule_pixels() {
        use TrackingState::{Degraded, Good, Lost};
        for (by_pixels, state) in [(Good, Good), (Degraded, Good), (Lost, Degraded)] {
            let reason = Some(LostReason::Residuals);
            assert_eq!(state_at_points(by_pixels, reason), state);
        }
        let few = Some(LostReason::NoTexture);
        assert_eq!(state_at_points(Lost, few), Good);
    }

    #[test]
    fn a_recognised_frame_needs_pixels_near_there_or_points() {
        use TrackingState::{Degraded, Good, Lost};
        let held = Support::Held { num_points: 30 };
        let is_believed = |state, is_beyond_gate, support| {
            is_where_recognised(&Tracked {
                is_beyond_gate,
                support,
                ..doubtful(false, state)
            })
        };
        for state in [Good, Degraded] {
            assert!(is_believed(state, false, Support::None));
            assert!(!is_believed(state, true, Support::None));
            assert!(is_believed(state, true, held));
        }
        assert!(!is_believed(Lost, false, Support::None));
    }

    #[test]
    fn only_points_make_a_pose_beyond_the_gate_believed() {
        let held = Support::Held { num_points: 30 };
        for (support, demanded) in [(Support::None, Demand::Points), (held, Demand::None)] {
            for lost_in_a_row in [0, 1, 100] {
                let tracked = Tracked {
                    is_beyond_gate: true,
                    support,
                    ..doubtful(false, TrackingState::Good)
                };
                assert_eq!(demand(&tracked, lost_in_a_row), demanded);
            }
        }
    }

    #[test]
    fn points_decide_when_enough_agree_and_most_of_those_found() {
        assert!(do_points_decide(30, 60));
        assert!(!do_points_decide(29, 29));
        assert!(!do_points_decide(30, 61));
        assert!(!do_points_decide(149, 300));
    }

    #[test]
    fn the_map_is_the_largest_fragment_where_it_is_much_larger() {
        let config = FragmentConfig {
            min_times_larger: 1.5,
            ..FragmentConfig::default()
        };
        let larger = |frames, apart: &[(FragmentId, usize)]| {
            larger_map(frames, apart.iter().copied(), &config)
        };
        assert_eq!(larger(100, &[]), None);
        assert_eq!(larger(100, &[(1, 149)]), None);
        assert_eq!(larger(100, &[(1, 150)]), Some(1));
        assert_eq!(larger(100, &[(1, 150), (2, 160), (4, 150)]), Some(2));
        // of equal ones the oldest
        assert_eq!(larger(100, &[(2, 160), (3, 160)]), Some(2));
        assert_eq!(larger(0, &[(1, 0)]), None);
        assert_eq!(larger(0, &[(1, 1)]), Some(1));
        // never
        let never = FragmentConfig {
            min_times_larger: f64::INFINITY,
            ..config.clone()
        };
        assert_eq!(larger_map(1, [(1, 1000)].into_iter(), &never), None);
        // the map stays where nothing is larger, whatever is asked for
        let equal = FragmentConfig {
            min_times_larger: 1.0,
            ..config.clone()
        };
        assert_eq!(larger_map(9, [(1, 9)].into_iter(), &equal), None);
        assert_eq!(larger_map(9, [(1, 10)].into_iter(), &equal), Some(1));
    }

    #[test]
    fn frames_bridge_a_loss_when_enough_of_them_agree() {
        let limit = BridgeEvidence {
            num_frames: MIN_BRIDGE_FRAMES,
            scale_sigma: MAX_BRIDGE_SCALE_SIGMA,
            turn_rms: MAX_BRIDGE_TURN_DEG.to_radians(),
        };
        assert!(is_bridge(&limit));
        for worse in [
            BridgeEvidence {
                num_frames: limit.num_frames - 1,
                ..limit
            },
            BridgeEvidence {
                scale_sigma: limit.scale_sigma * 1.01,
                ..limit
            },
            BridgeEvidence {
                turn_rms: limit.turn_rms * 1.01,
                ..limit
            },
            BridgeEvidence {
                scale_sigma: f64::NAN,
                ..limit
            },
        ] {
            assert!(!is_bridge(&worse), "{worse:?}");
        }
    }

    #[test]
    fn readings_place_a_fragment_when_scale_and_position_are_known() {
        let limit = PlaceEvidence {
            scale_sigma: MAX_JOIN_SCALE_SIGMA,
            position_sigma_m: 2.0 * MAX_JOIN_POSITION_SHARE,
            loss_m: 2.0,
        };
        assert!(is_placed(&limit));
        let worse = [
            (limit.scale_sigma * 1.01, limit.position_sigma_m),
            (limit.scale_sigma, limit.position_sigma_m * 1.01),
            (f64::NAN, limit.position_sigma_m),
            (limit.scale_sigma, f64::NAN),
        ];
        for (scale_sigma, position_sigma_m) in worse {
            let worse = PlaceEvidence {
                scale_sigma,
                position_sigma_m,
                ..limit
            };
            assert!(!is_placed(&worse), "{worse:?}");
        }
        // a camera that hardly moved
        let still = PlaceEvidence {
            position_sigma_m: JOIN_POSITION_SIGMA_M,
            loss_m: 0.0,
            ..limit
        };
        assert!(is_placed(&still));
    }

    #[test]
    fn only_a_good_pose_where_it_was_expected_stands_on_a_few_points() {
        assert!(may_be_confirmed(TrackingState::Good, false));
        assert!(!may_be_confirmed(TrackingState::Good, true));
        assert!(!may_be_confirmed(TrackingState::Degraded, false));
        assert!(!may_be_confirmed(TrackingState::Lost, false));
    }

    #[test]
    fn a_pose_that_points_support_is_not_doubted() {
        let mut tracked = doubtful(true, TrackingState::Degraded);
        assert_eq!(demand(&tracked, 100), Demand::ConvincingAfterLoss);
        tracked.support = Support::Confirmed;
        assert_eq!(demand(&tracked, 100), Demand::None);
    }

    /// A pose that no points support.
    fn doubtful(has_other_gain: bool, state: TrackingState) -> Tracked {
        Tracked {
            alignment: perfect(1000),
            is_beyond_gate: false,
            has_other_gain,
            support: Support::None,
            state,
            reason: None,
        }
    }

    #[test]
    fn near_the_prediction_a_loss_is_forgiven_for_some_frames() {
        let after = |lost_in_a_row: usize, has_other_gain: bool, is_degraded: bool| {
            let state = if is_degraded {
                TrackingState::Degraded
            } else {
                TrackingState::Good
            };
            demand(&doubtful(has_other_gain, state), lost_in_a_row)
        };
        let near = RETURN_NEAR_FRAMES;
        assert_eq!(after(0, false, false), Demand::None);
        assert_eq!(after(near, false, false), Demand::None);
        assert_eq!(after(near + 1, false, false), Demand::ConvincingAfterLoss);
        assert_eq!(after(1, true, false), Demand::ConvincingAfterLoss);
        assert_eq!(after(0, true, false), Demand::Convincing);
        assert_eq!(after(near, false, true), Demand::Convincing);
    }

    #[test]
    fn falling_agreement_makes_a_keyframe_in_time() {
        let config = KeyframeConfig::default();
        let agreeing = |good_of_visible: f32, num_mapped: usize| {
            let evidence = KeyframeEvidence {
                good_of_visible,
                num_mapped,
                ..evidence(0.0, 1.0)
            };
            is_new_keyframe(&evidence, &config)
        };
        let mapped = config.min_mapped_frames;
        assert!(!agreeing(config.min_good_of_visible + 0.01, mapped));
        assert!(agreeing(config.min_good_of_visible - 0.01, mapped));
        assert!(!agreeing(config.min_good_of_visible - 0.01, mapped - 1));
        assert!(!agreeing(config.urgent_good_of_visible + 0.01, 0));
        assert!(agreeing(config.urgent_good_of_visible - 0.01, 0));
    }

    #[test]
    fn a_pose_that_few_points_hold_makes_a_keyframe_before_they_are_too_few() {
        let config = KeyframeConfig::default();
        let held_by = |num_holding: Option<usize>, num_mapped: usize| {
            let evidence = KeyframeEvidence {
                num_holding,
                num_mapped,
                ..evidence(0.0, 1.0)
            };
            is_new_keyframe(&evidence, &config)
        };
        let mapped = config.min_mapped_frames;
        assert!(config.min_holding_points > MIN_POINT_INLIERS);
        assert!(!held_by(None, mapped));
        assert!(!held_by(Some(config.min_holding_points), mapped));
        assert!(held_by(Some(config.min_holding_points - 1), mapped));
        assert!(!held_by(Some(config.min_holding_points - 1), mapped - 1));
    }

    fn evidence(relative_distance: f64, usage: f64) -> KeyframeEvidence {
        KeyframeEvidence {
            relative_distance,
            usage,
            good_of_visible: 1.0,
            num_holding: None,
            num_mapped: 10,
            num_keyframes: 20,
        }
    }

    #[test]
    fn translation_alone_triggers_at_the_inverse_of_its_weight() {
        let config = KeyframeConfig::thesis();
        assert!(!is_new_keyframe(&evidence(0.32, 1.0), &config));
        assert!(is_new_keyframe(&evidence(0.35, 1.0), &config));
    }

    #[test]
    fn lost_overlap_alone_triggers_below_three_quarters() {
        let config = KeyframeConfig::thesis();
        assert!(!is_new_keyframe(&evidence(0.0, 0.77), &config));
        assert!(is_new_keyframe(&evidence(0.0, 0.73), &config));
    }

    #[test]
    fn a_young_keyframe_stays_unless_the_view_is_almost_gone() {
        let config = KeyframeConfig::thesis();
        let young = KeyframeEvidence {
            num_mapped: 2,
            ..evidence(0.5, 0.6)
        };
        assert!(!is_new_keyframe(&young, &config));
        let urgent = KeyframeEvidence {
            usage: URGENT_USAGE - 0.01,
            ..young
        };
        assert!(is_new_keyframe(&urgent, &config));
    }

    #[test]
    fn a_frame_from_the_same_place_is_passed_over_but_not_many_in_a_row() {
        let config = RefinementConfig::default();
        let refines = |num_mapped, num_passed, relative_distance| {
            is_refining((num_mapped, num_passed), relative_distance, false, &config)
        };
        let (first, near) = (FIRST_FRAMES, 0.9 * MAX_PASSED_DISTANCE);
        assert!(!refines(first, 0, near));
        assert!(
            refines(first - 1, 0, near),
            "the first frames of a keyframe"
        );
        assert!(refines(first, 0, MAX_PASSED_DISTANCE), "another place");
        assert!(!refines(first, config.max_passed - 1, near));
        assert!(refines(first, config.max_passed, near), "once in a while");
        let every = RefinementConfig::thesis();
        assert!(is_refining((100, 0), 0.0, false, &every));
    }

    #[test]
    fn a_frame_that_keeps_the_next_one_waiting_is_passed_over_but_not_for_ever() {
        let config = RefinementConfig::default();
        let far = 10.0 * MAX_PASSED_DISTANCE;
        let refines =
            |num_mapped, num_passed| is_refining((num_mapped, num_passed), far, true, &config);
        assert!(!refines(0, 0), "not even the first one");
        assert!(!refines(100, 0), "nor one from another place");
        assert!(!refines(100, MAX_HURRIED - 1));
        assert!(refines(100, MAX_HURRIED), "once in a while");
    }
}
