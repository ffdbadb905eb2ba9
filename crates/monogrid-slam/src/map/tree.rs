//! The tree of keyframes: each but the first of a fragment was tracked on its parent, which is older.

use crate::KeyframeId;

/// The keyframes along which tracking came from `a` to `b`, in either direction. Keyframes without a common
/// ancestor follow each other.
pub(crate) fn path_between(
    parent_of: impl Fn(KeyframeId) -> Option<KeyframeId>,
    a: KeyframeId,
    b: KeyframeId,
) -> Vec<KeyframeId> {
    let (mut left, mut right) = (vec![a], vec![b]);
    let (mut a, mut b) = (a, b);
    // a parent is always older than its child
    while a != b {
        let (side, end) = if a > b {
            (&mut left, &mut a)
        } else {
            (&mut right, &mut b)
        };
        match parent_of(*end) {
            Some(parent) => {
                *end = parent;
                side.push(parent);
            }
            None => break,
        }
    }
    if a == b {
        right.pop();
    }
    left.extend(right.iter().rev());
    left
}
