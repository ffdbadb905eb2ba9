//! How keyframes hang together: by tracked motion, and what of the map holds together by more.

use crate::{EdgeKind, KeyframeId, StoredEdge};

/// Of each keyframe, by identity, the oldest one that constraints between common points or by
/// direct alignment join it with, perhaps over others.
///
/// Within such a part, places are known as well as points and images say. Two parts know of each
/// other only by how the camera was tracked in between, which drifts, or across a loss.
pub(crate) fn parts(num_keyframes: usize, edges: &[StoredEdge]) -> Vec<KeyframeId> {
    let mut oldest: Vec<KeyframeId> = (0..num_keyframes as KeyframeId).collect();
    for edge in edges.iter().filter(|edge| edge.kind != EdgeKind::Odometry) {
        let [a, b] = [edge.edge.i, edge.edge.j].map(|id| usize::try_from(id).unwrap_or(usize::MAX));
        if a.max(b) < num_keyframes {
            let (a, b) = (root(&mut oldest, a), root(&mut oldest, b));
            oldest[a.max(b)] = a.min(b) as KeyframeId;
        }
    }
    (0..num_keyframes)
        .map(|id| root(&mut oldest, id) as KeyframeId)
        .collect()
}

/// The oldest keyframe of a part as known so far; ways to it become shorter.
fn root(oldest: &mut [KeyframeId], mut id: usize) -> usize {
    while oldest[id] as usize != id {
        let next = oldest[id] as usize;
        oldest[id] = oldest[next];
        id = next;
    }
    id
}

/// The keyframes along which tracking came from `a` to `b`, in either direction. Keyframes without
/// a common ancestor follow each other.
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

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Mat7, Sim3};
    use monogrid_graph::RobustKernel;
    use monogrid_graph::pose_graph::GraphEdge;

    fn edge(kind: EdgeKind, i: u64, j: u64) -> StoredEdge {
        StoredEdge {
            kind,
            edge: GraphEdge {
                i,
                j,
                i_from_j: Sim3::identity(),
                information: Mat7::identity(),
                kernel: RobustKernel::None,
            },
        }
    }

    #[test]
    fn parts_are_held_together_by_points_and_alignments_and_not_by_motion() {
        assert_eq!(parts(3, &[]), [0, 1, 2]);
        let mut edges: Vec<StoredEdge> =
            (1..7).map(|k| edge(EdgeKind::Odometry, k - 1, k)).collect();
        assert_eq!(parts(7, &edges), [0, 1, 2, 3, 4, 5, 6]);
        edges.push(edge(EdgeKind::Sparse, 5, 4));
        edges.push(edge(EdgeKind::Direct, 1, 2));
        edges.push(edge(EdgeKind::Sparse, 5, 6));
        assert_eq!(parts(7, &edges), [0, 1, 1, 3, 4, 4, 4]);
        // a loop joins what lies far apart in time
        edges.push(edge(EdgeKind::Direct, 6, 0));
        edges.push(edge(EdgeKind::Sparse, 2, 5));
        assert_eq!(parts(7, &edges), [0, 0, 0, 3, 0, 0, 0]);
        // an edge of a keyframe that does not exist says nothing
        edges.push(edge(EdgeKind::Direct, 3, 9));
        assert_eq!(parts(7, &edges)[3], 3);
    }
}
