//! One observation with exact poses: honest variance, no bias, no pixel locking (R5).

mod world;

use monogrid_depth::{DepthConfig, DepthMap, ObserveStats, StereoFrame};
use monogrid_geometry::{Rotation, Se3, Vec3};
use world::{World, host, pinhole_of, quality, sensor};

const SIZE: (usize, usize) = (320, 240);

fn frame<'a>(image: &'a monogrid_image::GrayImage, frame_from_keyframe: Se3) -> StereoFrame<'a> {
    StereoFrame {
        image,
        frame_from_keyframe,
        gain: 1.0,
        bias: 0.0,
        residual_rms: 3.0,
        pose_sigma_trans: 0.0,
        pose_sigma_rot: 0.0,
        id: 1,
    }
}

fn pair(motion: Se3, noise: f32, config: &DepthConfig) -> (DepthMap, world::View, ObserveStats) {
    let world = World::room();
    let pinhole = pinhole_of(SIZE);
    let keyframe = world.render(&pinhole, SIZE, &Se3::identity());
    let other = world.render(&pinhole, SIZE, &motion.inverse());
    let image = sensor(&other.image, noise, 2);
    let mut map = DepthMap::empty(host(sensor(&keyframe.image, noise, 1), pinhole), config);
    let frames = [frame(&image, motion)];
    let mut stats = ObserveStats::default();
    for _ in 0..5 {
        stats = map.observe(&frames, config);
    }
    (map, keyframe, stats)
}

#[test]
fn a_stereo_pair_gives_unbiased_depth_with_honest_variance() {
    let config = DepthConfig {
        line_sigma_px: 0.0,
        ..DepthConfig::default()
    };
    let motions = [
        Se3::new(Rotation::identity(), Vec3::new(0.02, 0.0, 0.0)),
        Se3::new(Rotation::identity(), Vec3::new(-0.015, 0.02, 0.0)),
        Se3::new(
            Rotation::from_euler_angles(0.02, -0.03, 0.05),
            Vec3::new(0.02, 0.01, -0.02),
        ),
        Se3::new(
            Rotation::from_euler_angles(0.0, 0.02, 0.0),
            Vec3::new(0.0, 0.0, 0.06),
        ),
    ];
    for noise in [0.5f32, 2.0] {
        for motion in motions {
            let (map, truth, stats) = pair(motion, noise, &config);
            let q = quality(&map, &truth.depth, 5);
            println!(
                "noise {noise} {:?}\n  {q:?}\n  noise {}  {stats:?}",
                motion.translation,
                map.noise_sigma()
            );
        }
    }
}
