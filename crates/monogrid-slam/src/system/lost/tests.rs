//! Recovery by its values alone.

use super::*;

#[test]
fn a_loss_ends_once() {
    let mut recovery = LossRecovery::default();
    assert!(!recovery.end(), "no frame was lost");
    recovery.count();
    recovery.count();
    assert_eq!(recovery.lost_in_a_row(), 2);
    assert!(recovery.end());
    assert_eq!(recovery.lost_in_a_row(), 0);
    assert!(!recovery.end());
    recovery.count();
    assert_eq!(
        recovery.lost_in_a_row(),
        1,
        "counted from the last frame with a pose"
    );
}
