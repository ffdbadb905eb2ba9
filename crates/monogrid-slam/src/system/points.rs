//! The newest keyframe in the sparse layer, and at the end all of them.

use crate::FragmentId;
use crate::map::Map;
use crate::setup::Setup;
use crate::sparse::{
    LeftLens, adjust_all, adjust_all_to_images, adjust_window, anchor, dense_links, find_again,
    register, unconfirmed, world_from_keyframes,
};
use monogrid_depth::DepthMap;
use monogrid_geometry::Vec2;

/// Brings the newest keyframe, of which `depth` is the dense depth, into the sparse layer, if there
/// is one; poses and units of the keyframes of its fragment follow.
pub(super) fn adjust_points(setup: &Setup, map: &mut Map, depth: &DepthMap) {
    let config = &setup.config.sparse;
    let Some(newest) = map.newest().filter(|_| config.enabled) else {
        return;
    };
    let (id, fragment) = (newest.id, newest.fragment);

    let registration = register(map, &setup.pinhole);
    let inliers = registration.inliers.iter();
    let seen: Vec<Vec2> = inliers.map(|(_, pixel)| *pixel).collect();
    map.register(registration);

    let anchored = anchor(
        map,
        depth,
        &seen,
        &setup.pinhole,
        &depth.host().mask,
        config,
    );
    map.anchor(anchored);

    map.adjust(adjust_window(map, &setup.pinhole, config));
    map.drop_points(unconfirmed(map));

    let links = dense_links(map.points(), &map[id].points, id, depth);
    map.link(id, links);
    let newest = setup.config.graph.window;
    map.pose(&world_from_keyframes(map, fragment, newest, &setup.pinhole));
}

/// After the last frame: what the keyframes of a fragment share is looked for once more at the
/// poses that all of them have, and poses and points are adjusted together.
pub(super) fn adjust_whole(setup: &Setup, map: &mut Map, fragment: FragmentId) {
    let config = &setup.config.sparse;
    let num_keyframes = map.num_keyframes_in(fragment);
    if !config.enabled || num_keyframes > config.final_max_keyframes {
        return;
    }
    let pinhole = LeftLens::of_pinhole(&setup.pinhole);
    for _ in 0..config.final_rounds {
        map.observe(find_again(map, fragment, &setup.pinhole));
        map.adjust(adjust_all(map, fragment, &pinhole, config));
    }
    if setup.left_radial != 0.0 {
        // points are looked for in the images as they are, so this comes last
        let lens = LeftLens::new(&setup.pinhole, setup.left_radial);
        map.adjust(adjust_all(map, fragment, &lens, config));
    } else if config.images.enabled && num_keyframes >= config.images.min_keyframes {
        // images see what is wrong with a camera more sharply than places do, so this is for a
        // camera of which nothing is left
        map.adjust(adjust_all_to_images(map, fragment, &pinhole, config));
    }
    let poses = world_from_keyframes(map, fragment, num_keyframes, &setup.pinhole);
    map.pose(&poses);
}

#[cfg(test)]
mod tests;
