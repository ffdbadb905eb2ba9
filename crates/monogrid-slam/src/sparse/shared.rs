//! Which keyframes share points.

use crate::KeyframeId;
use crate::graph::SharedPoints;
use crate::map::Map;
use std::collections::{BTreeMap, BTreeSet};

/// Shared points from which two keyframes have an edge.
const MIN_SHARED_POINTS: usize = 15;
/// Edges of a keyframe to older ones at most, those with the most shared points.
const MAX_EDGES: usize = 12;
/// Largest difference of the numbers of two keyframes with an edge. Points found again after a
/// long time pull both ends of a loop together only half, because each end is held by points of
/// its own: the relative pose that is left is no measurement.
pub(crate) const MAX_GAP: u32 = 25;

/// Pairs of keyframes with enough common points and not too far apart, of which one is among
/// `window`, older keyframe first: of each keyframe the older ones with the most common points,
/// those first.
pub(crate) fn shared_points(map: &Map, window: &[KeyframeId], max_gap: u32) -> Vec<SharedPoints> {
    let mut shared: BTreeMap<(KeyframeId, KeyframeId), usize> = BTreeMap::new();
    let mut seen_by = Vec::new();
    let seen: BTreeSet<usize> = window.iter().flat_map(|id| map[*id].points.all()).collect();
    let points = seen.into_iter().map(|index| &map.points()[index]);
    for point in points.filter(|p| p.alive) {
        seen_by.clear();
        seen_by.push(point.host);
        seen_by.extend(point.observations.iter().map(|o| o.keyframe));
        seen_by.sort_unstable();
        for (at, &j) in seen_by.iter().enumerate() {
            let is_recent = window.contains(&j);
            for &i in &seen_by[..at] {
                if is_recent || window.contains(&i) {
                    *shared.entry((i, j)).or_default() += 1;
                }
            }
        }
    }
    let mut pairs: Vec<SharedPoints> = shared
        .into_iter()
        .map(|((i, j), count)| SharedPoints { i, j, count })
        .filter(|pair| pair.count >= MIN_SHARED_POINTS)
        .filter(|pair| map.steps_between(pair.i, pair.j) <= max_gap)
        .collect();
    // the strongest of each newer keyframe
    pairs.sort_by_key(|pair| (pair.j, std::cmp::Reverse(pair.count), pair.i));
    let mut taken = (KeyframeId::MAX, 0);
    pairs.retain(|pair| {
        taken = (pair.j, if taken.0 == pair.j { taken.1 + 1 } else { 1 });
        taken.1 <= MAX_EDGES
    });
    pairs
}
