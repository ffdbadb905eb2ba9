//! Tracking alone: every keyframe gets the sequence's true depth, so that the error that remains is that
//! of the alignment, the images and the truth itself.
//!
//! `cargo run --release -p monogrid-slam --example true_depth -- FOLDER [frames per keyframe]`
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

mod sequence;

use monogrid_alignment::{AlignmentConfig, DepthSample, Freedom, Motion, Reference, Target, align};
use monogrid_evaluation::{StampedPose, TrajectoryConfig, evaluate_trajectory};
use monogrid_geometry::Se3;
use monogrid_image::{GrayImage, Pyramid};
use sequence::Sequence;

/// Depth at pixels with a gradient, with 1 % standard deviation.
fn samples(image: &GrayImage, depth: &GrayImage) -> Vec<DepthSample> {
    let mut out = Vec::new();
    for y in 2..image.height() - 2 {
        for x in 2..image.width() - 2 {
            let dx = image.at(x + 1, y) - image.at(x - 1, y);
            let dy = image.at(x, y + 1) - image.at(x, y - 1);
            let z = depth.at(x, y);
            if dx.hypot(dy) > 10.0 && z.is_finite() && z > 0.0 {
                let idepth = 1.0 / z;
                let (x, y, idepth_var) = (x as u16, y as u16, (0.01 * idepth).powi(2));
                out.push(DepthSample {
                    x,
                    y,
                    idepth,
                    idepth_var,
                });
            }
        }
    }
    out
}

fn main() {
    let mut args = std::env::args().skip(1);
    let folder = args.next().unwrap();
    let frames_per_keyframe: usize = args.next().map_or(10, |n| n.parse().unwrap());
    let sequence = Sequence::open(&folder);
    let pinhole = *sequence.pinhole();
    let config = AlignmentConfig::default();
    let (finest, coarsest) = (config.finest_level, config.coarsest_level);
    let mut world_from_keyframe = Se3::identity();
    let mut reference: Option<(usize, Reference)> = None;
    let mut motion = Motion::from_pose(Se3::identity());
    let mut velocity = Se3::identity();
    let mut poses: Vec<StampedPose> = Vec::new();
    for (i, entry) in sequence.dataset.frames.iter().enumerate() {
        let pyramid = Pyramid::new(sequence.image(i), 5);
        if let Some((_, reference)) = &reference {
            let target = Target::new(&pyramid, &pinhole, finest, coarsest);
            let guess = Motion {
                frame_from_keyframe: velocity * motion.frame_from_keyframe,
                ..motion
            };
            let both =
                [guess, motion].map(|m| align(reference, &target, &m, Freedom::Rigid, &config));
            let best = both
                .into_iter()
                .min_by(|a, b| a.mean_cost.total_cmp(&b.mean_cost))
                .unwrap();
            velocity = best.motion.frame_from_keyframe * motion.frame_from_keyframe.inverse();
            motion = best.motion;
        }
        let world_from_frame = world_from_keyframe * motion.frame_from_keyframe.inverse();
        poses.push((entry.timestamp_ns, world_from_frame));
        let due = reference
            .as_ref()
            .is_none_or(|(at, _)| i >= at + frames_per_keyframe);
        if due && let Some(depth) = sequence.true_depth(entry.timestamp_ns) {
            let samples = samples(pyramid.level(0), &depth);
            let prepared = Reference::new(&pyramid, &pinhole, &samples, finest, coarsest);
            reference = Some((i, prepared));
            world_from_keyframe = world_from_frame;
            motion = Motion::from_pose(Se3::identity());
        }
    }
    let truth: Vec<StampedPose> = sequence.stamped_truth();
    let report = evaluate_trajectory(&poses, &truth, &TrajectoryConfig::default()).unwrap();
    println!(
        "ATE {:.4} m, scale {:.3}, drift {:?}, rotation per frame {:.3} deg",
        report.ate_rmse, report.scale, report.scale_drift, report.rpe_rot_rmse_deg
    );
}
