//! A hand-held sequence with keyframe changes: density, accuracy, honesty, no drift of the scale.

mod world;

use monogrid_depth::{DepthConfig, DepthMap, StereoFrame};
use monogrid_geometry::Se3;
use monogrid_image::GrayImage;
use world::{Normal, World, disturbed, handheld, host, pinhole_of, quality, sensor};

const SIZE: (usize, usize) = (320, 240);

fn run(
    label: &str,
    config: &DepthConfig,
    num_frames: usize,
    per_keyframe: usize,
    noise: f32,
    seed_first: bool,
) {
    let world = World::room();
    let pinhole = pinhole_of(SIZE);
    let mut normal = Normal(5);
    let (sigma_trans, sigma_rot) = (0.0003, 0.0002);
    let mut total = monogrid_depth::ObserveStats::default();
    let mut map: Option<(DepthMap, Se3, GrayImage)> = None;
    let mut old: Vec<(GrayImage, Se3)> = Vec::new();
    for n in 0..num_frames {
        let pose = handheld(n as f64 / 30.0);
        let view = world.render(&pinhole, SIZE, &pose);
        let image = sensor(&view.image, noise, n as u64 + 1);
        let image = if std::env::var("SMOOTH").is_ok() {
            smooth(&image)
        } else {
            image
        };
        let estimated = if n % per_keyframe == 0 {
            pose
        } else {
            disturbed(&pose, sigma_trans, sigma_rot, &mut normal)
        };
        let Some((current, keyframe_pose, depth)) = &mut map else {
            let mut first = DepthMap::empty(host(image, pinhole), config);
            if seed_first {
                first.initialize_from_depth(&view.depth, 0.02);
            }
            map = Some((first, estimated, view.depth));
            continue;
        };
        let stereo = |image, pose: &Se3, id| StereoFrame {
            image,
            frame_from_keyframe: pose.inverse() * *keyframe_pose,
            gain: 1.0,
            bias: 0.0,
            residual_rms: 3.0,
            pose_sigma_trans: sigma_trans as f32 * 1.4,
            pose_sigma_rot: sigma_rot as f32 * 1.4,
            id,
        };
        if n % per_keyframe == 0 {
            current.fill_holes(config);
            current.regularize(config);
            let q = quality(current, depth, 10);
            show(label, n, "end ", &q);
            let (mut next, stats) = current.propagate(
                host(image, pinhole),
                &(estimated.inverse() * *keyframe_pose),
                config,
            );
            let q = quality(&next, &view.depth, 10);
            show(label, n, "prop", &q);
            let _ = stats;
            next.fill_holes(config);
            next.regularize(config);
            old.insert(0, (current.host().image.clone(), *keyframe_pose));
            old.truncate(3);
            *keyframe_pose = estimated;
            *current = next;
            *depth = view.depth;
            let frames: Vec<_> = old
                .iter()
                .map(|(image, pose)| StereoFrame {
                    frame_from_keyframe: pose.inverse() * *keyframe_pose,
                    ..stereo_of(image, n as u32)
                })
                .collect();
            let stats = current.observe(&frames, config);
            let _ = stats;
            let q = quality(current, depth, 10);
            show(label, n, "old ", &q);
            continue;
        }
        let stats = current.observe(&[stereo(&image, &estimated, n as u32)], config);
        total.merge(&stats);
        current.fill_holes(config);
        current.regularize(config);
    }
    println!("{total:?}");
}

fn show(label: &str, n: usize, what: &str, q: &world::Quality) {
    println!(
        "{label} {n:3} {what} dense {:.3} w3 {:.3} prec {:.3} gross {:.3} bias {:+.4} med {:+.3} dev {:.3} std {:.2} w2s {:.3}",
        q.dense,
        q.within_3,
        q.precise,
        q.gross,
        q.bias,
        q.normal_median,
        q.normal_deviation,
        q.normal_std,
        q.within_2_sigma
    );
}
fn smooth(image: &GrayImage) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        let (mut s, mut n) = (0.0, 0.0);
        for dy in -1i32..=1 {
            for dx in -1i32..=1 {
                let (xx, yy) = (x as i32 + dx, y as i32 + dy);
                if xx < 0 || yy < 0 || xx >= image.width() as i32 || yy >= image.height() as i32 {
                    continue;
                }
                let w = ((2 - dx.abs()) * (2 - dy.abs())) as f32;
                s += w * image.at(xx as usize, yy as usize);
                n += w;
            }
        }
        s / n
    })
}

fn stereo_of(image: &GrayImage, id: u32) -> StereoFrame<'_> {
    StereoFrame {
        image,
        frame_from_keyframe: Se3::identity(),
        gain: 1.0,
        bias: 0.0,
        residual_rms: 3.0,
        pose_sigma_trans: 0.00042,
        pose_sigma_rot: 0.00028,
        id,
    }
}

#[test]
fn sequence() {
    run("default", &DepthConfig::default(), 50, 12, 1.5, false);
}
#[test]
fn sequence_noisy() {
    run("noise4", &DepthConfig::default(), 50, 12, 4.0, false);
}
#[test]
fn sequence_thesis() {
    run("thesis", &DepthConfig::thesis(), 50, 12, 1.5, false);
}
