//! The newest keyframe in the sparse layer, and at the end all of them.

use super::setup::Setup;
use crate::FragmentId;
use crate::map::{Change, Map};
use crate::sparse::{
    LeftLens, SparseStats, adjust_all, adjust_all_to_images, adjust_window, anchor, dense_links,
    find_again, register, unconfirmed, world_from_keyframes,
};
use monogrid_depth::DepthMap;
use monogrid_geometry::Vec2;

/// Brings the newest keyframe, of which `depth` is the dense depth, into the sparse layer; poses and units of
/// the keyframes of its fragment follow. `None` without a sparse layer.
pub(super) fn adjust_points(setup: &Setup, map: &mut Map, depth: &DepthMap) -> Option<SparseStats> {
    let config = &setup.config.sparse;
    let newest = map.newest().filter(|_| config.enabled)?;
    let (id, fragment) = (newest.id, newest.fragment);

    let registration = register(map, &setup.pinhole, config);
    let inliers = registration.inliers.iter();
    let seen: Vec<Vec2> = inliers.map(|(_, pixel)| *pixel).collect();
    let (searched, found) = (registration.searched, registration.found);
    map.apply(Change::Registered(registration));

    let anchored = anchor(map, depth, &seen, &setup.pinhole, &setup.mask, config);
    let num_anchored = anchored.len();
    map.apply(Change::Anchored(anchored));

    let adjustment = adjust_window(map, &setup.pinhole, config);
    let stats = SparseStats {
        searched,
        found,
        inliers: seen.len(),
        anchored: num_anchored,
        adjusted_keyframes: adjustment.num_free,
        adjusted_points: adjustment.idepths.len(),
        removed_observations: adjustment.refuted.len(),
        failure: adjustment.failure.clone(),
    };
    map.apply(Change::Adjusted(adjustment));
    let dropped = unconfirmed(map, config);
    map.apply(Change::Unconfirmed(dropped));

    let links = dense_links(map.points(), &map[id].points, id, depth);
    map.apply(Change::Linked(id, links));
    let newest = setup.config.graph.window;
    let poses = world_from_keyframes(map, fragment, newest, &setup.pinhole);
    map.apply(Change::Posed(poses));
    Some(stats)
}

/// After the last frame: what the keyframes of a fragment share is looked for once more at the poses that all of them
/// have, and poses and points are adjusted together.
pub(super) fn adjust_whole(setup: &Setup, map: &mut Map, fragment: FragmentId) {
    let config = &setup.config.sparse;
    let num_keyframes = map.num_keyframes_in(fragment);
    if !config.enabled || num_keyframes > config.final_max_keyframes {
        return;
    }
    let pinhole = LeftLens::of_pinhole(&setup.pinhole);
    for _ in 0..config.final_rounds {
        let seen = find_again(map, fragment, &setup.pinhole, config);
        map.apply(Change::Observed(seen));
        let adjustment = adjust_all(map, fragment, &pinhole, config);
        map.apply(Change::Adjusted(adjustment));
    }
    if setup.left_radial != 0.0 {
        // points are looked for in the images as they are, so this comes last
        let lens = LeftLens::new(&setup.pinhole, setup.left_radial);
        let adjustment = adjust_all(map, fragment, &lens, config);
        map.apply(Change::Adjusted(adjustment));
    } else if config.images.enabled && num_keyframes >= config.images.min_keyframes {
        // images see what is wrong with a camera more sharply than places do, so this is for a camera of which nothing is left
        let adjustment = adjust_all_to_images(map, fragment, &pinhole, config);
        map.apply(Change::Adjusted(adjustment));
    }
    let poses = world_from_keyframes(map, fragment, num_keyframes, &setup.pinhole);
    map.apply(Change::Posed(poses));
}

#[cfg(test)]
mod tests;
