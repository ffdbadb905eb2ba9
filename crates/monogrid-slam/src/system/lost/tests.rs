//! Recovery by its values alone.

use super::*;

#[test]
fn a_frame_is_looked_for_from_the_second_lost_one_on_or_where_nothing_was_tracked() {
    let mut recovery = LossRecovery::default();
    assert!(!recovery.count(true), "one frame may be a bad one");
    assert!(recovery.count(true));
    assert!(recovery.count(true));
    assert_eq!(recovery.lost_in_a_row(), 3);

    let mut recovery = LossRecovery::default();
    assert!(recovery.count(false), "there is no keyframe in use");
}

#[test]
fn a_loss_ends_once() {
    let mut recovery = LossRecovery::default();
    assert!(!recovery.end(), "no frame was lost");
    recovery.count(true);
    assert!(recovery.end());
    assert_eq!(recovery.lost_in_a_row(), 0);
    assert!(!recovery.end());
    assert!(
        !recovery.count(true),
        "counted from the last frame with a pose"
    );
}
