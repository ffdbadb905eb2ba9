//! The policy by its values alone.

use super::*;
use crate::policy::FIRST_FRAMES;
use crate::tracker::tests::perfect;
use monogrid_geometry::Se3;

/// A frame that was taken at this distance from its keyframe, aside.
fn tracked_at(distance: f64) -> Tracked {
    let mut alignment = perfect(1000);
    let place = Vec3::new(distance, 0.0, 0.0);
    alignment.motion.frame_from_keyframe = Se3::new(Rotation::identity(), -place);
    Tracked {
        alignment,
        is_beyond_gate: false,
        has_other_gain: false,
        support: Support::None,
        state: TrackingState::Good,
        reason: None,
    }
}

/// What a frame is for where there are many keyframes.
fn decided(policy: &KeyframePolicy, tracked: &Tracked, effort: Effort) -> Use {
    policy.decide(tracked, 100, &KeyframeConfig::default(), effort)
}

#[test]
fn frames_from_almost_the_same_place_are_passed_over_as_often_as_the_settings_say() {
    let mut policy = KeyframePolicy::default();
    let near = tracked_at(0.001);
    let mut uses = Vec::new();
    for _ in 0..FIRST_FRAMES + 6 {
        let what = decided(&policy, &near, Effort::Whole);
        match what {
            Use::RefineDepth => policy.refined(Some(Vec3::new(0.001, 0.0, 0.0))),
            Use::PassOver => policy.passed_over(),
            _ => panic!("{what:?}"),
        }
        uses.push(what == Use::RefineDepth);
    }
    assert!(uses[..FIRST_FRAMES].iter().all(|refines| *refines));
    let later = [false, false, true, false, false, true];
    assert_eq!(uses[FIRST_FRAMES..], later, "max_passed is 2");
}

#[test]
fn a_frame_from_elsewhere_refines_depth_unless_the_next_one_waits() {
    let mut policy = KeyframePolicy::default();
    for _ in 0..FIRST_FRAMES {
        policy.refined(Some(Vec3::new(0.1, 0.0, 0.0)));
    }
    let at = |distance, effort| decided(&policy, &tracked_at(distance), effort);
    assert_eq!(at(0.1, Effort::Whole), Use::PassOver);
    assert_eq!(at(0.14, Effort::Whole), Use::RefineDepth);
    assert_eq!(at(0.14, Effort::Hurried), Use::PassOver);
    // distance counts from where depth was refined, not from the keyframe
    assert_eq!(at(0.06, Effort::Whole), Use::RefineDepth);
}

#[test]
fn a_degraded_frame_refines_nothing_and_may_make_a_keyframe() {
    let policy = KeyframePolicy::after(100);
    let degraded = |distance| Tracked {
        state: TrackingState::Degraded,
        ..tracked_at(distance)
    };
    let near = decided(&policy, &degraded(0.0), Effort::Whole);
    assert_eq!(near, Use::None);
    let far = decided(&policy, &degraded(2.0), Effort::Whole);
    assert_eq!(far, Use::ChangeKeyframe);
}

#[test]
fn a_keyframe_is_made_after_enough_frames_and_looked_for_again_after_a_while() {
    let far = tracked_at(2.0);
    let min_mapped = KeyframeConfig::default().min_mapped_frames;
    let mut policy = KeyframePolicy::after(min_mapped - 1);
    assert_eq!(decided(&policy, &far, Effort::Whole), Use::RefineDepth);
    policy.passed_over();
    assert_eq!(decided(&policy, &far, Effort::Whole), Use::ChangeKeyframe);
    policy.wait();
    assert_eq!(decided(&policy, &far, Effort::Whole), Use::RefineDepth);
}
