//! Points looked for once more when all poses are known: in every keyframe that should see them.

use super::matching::{PointSearch, Which, find_in_images};
use crate::FragmentId;
use crate::map::{Map, MapKeyframe, Observation};
use monogrid_geometry::Pinhole;
use monogrid_image::Pyramid;
use rayon::prelude::*;
use std::sync::Arc;

/// Half width of the search for a point in the adjustments of all keyframes together, px.
const FINAL_RADIUS_PX: f64 = 4.0;

/// Keyframes in which points are looked for at the same time. All others are made ready once for so
/// many, and the pyramids of these are in memory.
const BLOCK: usize = 16;

/// Where keyframes of a fragment see points that were not found in them before: those that were
/// anchored later, and those that the poses of their time had elsewhere.
pub(crate) fn find_again(
    map: &Map,
    fragment: FragmentId,
    pinhole: &Pinhole,
) -> Vec<(usize, Observation)> {
    let keyframes: Vec<&MapKeyframe> = map.in_fragment(fragment).collect();
    let blocks = keyframes.chunks(BLOCK);
    blocks
        .flat_map(|block| find_in_block(map, block, pinhole))
        .collect()
}

/// The same for some of the keyframes.
fn find_in_block(
    map: &Map,
    keyframes: &[&MapKeyframe],
    pinhole: &Pinhole,
) -> Vec<(usize, Observation)> {
    let ready: Vec<(&MapKeyframe, Arc<Pyramid>)> = keyframes
        .par_iter()
        .filter_map(|keyframe| Some((*keyframe, keyframe.pyramid()?)))
        .collect();
    let searches: Vec<PointSearch> = ready
        .iter()
        .map(|(keyframe, pyramid)| {
            let which = Which::NotSeenBy(keyframe.id);
            PointSearch::in_keyframe((keyframe, pyramid), which, FINAL_RADIUS_PX)
        })
        .collect();
    let found = find_in_images(map, &searches, pinhole);
    let found = ready.iter().zip(found).flat_map(|((seen_by, _), search)| {
        let keyframe = seen_by.id;
        let observation = move |(point, pixel)| (point, Observation { keyframe, pixel });
        search.found.into_iter().map(observation)
    });
    found.collect()
}
