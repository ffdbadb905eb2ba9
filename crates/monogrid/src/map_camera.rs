//! What the points of a map say about the camera that made it.
//!
//! The sparse layer sees hundreds of points from many keyframes: adjusted with the camera free, they show it better than
//! corners followed over the first seconds, at the cost of some twenty milliseconds per ten keyframes.

use monogrid_calibration::{
    Estimate, EstimateConfig, Intrinsics, Prior, Scene, Sighting, refine_intrinsics,
};
use monogrid_geometry::{Pinhole, Se3, Vec2};
use monogrid_slam::Slam;
use std::collections::BTreeMap;

/// Pieces that are looked at, evenly over the map: an upper limit for what it costs.
const MAX_PIECES: usize = 40;

/// The camera of the working images, which have no distortion, as the calibration has it.
pub fn as_calibrated(slam: &Slam) -> Intrinsics {
    let Pinhole { fx, fy, cx, cy } = *slam.pinhole();
    Intrinsics {
        focal: (fx * fy).sqrt(),
        centre: Vec2::new(cx, cy),
        radial: [0.0; 2],
        readout: 0.0,
    }
}

/// The camera of the images in working pixels that the main map shows in pieces of `num_views` keyframes, when `guess`
/// is about right.
pub fn shown_by_map(
    slam: &Slam,
    num_views: usize,
    guess: &Intrinsics,
    size: (usize, usize),
    prior: &Prior,
) -> Estimate {
    let pieces = scene(slam, guess).pieces(num_views);
    let step = pieces.len().div_ceil(MAX_PIECES).max(1);
    let pieces = pieces.into_iter().step_by(step).collect();
    refine_intrinsics(pieces, size, prior, &EstimateConfig::default())
}

/// The main map as a scene: its finished keyframes are the views.
fn scene(slam: &Slam, guess: &Intrinsics) -> Scene {
    let snapshot = slam.snapshot();
    let pinhole: &Pinhole = slam.pinhole();
    let ray_of = |[x, y]: [f64; 2]| pinhole.unproject(&Vec2::new(x, y));
    let mut views = BTreeMap::new();
    let mut scene = Scene {
        intrinsics: *guess,
        poses: Vec::new(),
        points: Vec::new(),
        sightings: Vec::new(),
    };
    for keyframe in slam.keyframes() {
        if let Some(pose) = snapshot.in_main_map(keyframe.id) {
            // units do not change what is seen
            let world_from_camera = Se3::new(pose.rotation, pose.translation);
            views.insert(keyframe.id, (scene.poses.len(), world_from_camera));
            scene.poses.push(world_from_camera.inverse());
        }
    }
    for point in slam.points() {
        let Some((_, world_from_host)) = views.get(&point.host) else {
            continue;
        };
        let index = scene.points.len();
        let own = std::iter::once((point.host, point.pixel));
        let mut seen: Vec<Sighting> = own
            .chain(point.observations)
            .filter_map(|(id, pixel)| {
                Some(Sighting {
                    view: views.get(&id)?.0,
                    point: index,
                    pixel: guess.project(&ray_of(pixel))?,
                    // its images are rectified
                    bend: Vec2::zeros(),
                })
            })
            .collect();
        seen.sort_unstable_by_key(|sighting| sighting.view);
        scene.sightings.extend(seen);
        let in_host = ray_of(point.pixel) / point.idepth;
        scene.points.push(*world_from_host * in_host);
    }
    scene
}
