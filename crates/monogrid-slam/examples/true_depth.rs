//! Tracking alone: every keyframe gets the sequence's true depth, so that the error that remains is that
//! of the alignment, the images and the truth itself.
//!
//! `cargo run --release -p monogrid-slam --example true_depth -- FOLDER [frames per keyframe]`
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    missing_docs,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_alignment::{AlignmentConfig, DepthSample, Freedom, Motion, Reference, Target, align};
use monogrid_datasets::{Dataset, DepthRegistration, SourceOptions, read_depth, read_gray};
use monogrid_evaluation::{StampedPose, TrajectoryConfig, evaluate_trajectory};
use monogrid_geometry::Se3;
use monogrid_image::{GrayImage, Pyramid, Undistorter, WorkingSize};
use std::path::Path;

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
    let dataset = Dataset::open(Path::new(&folder), SourceOptions::default()).unwrap();
    let camera = dataset.calibration(None).unwrap().unwrap().camera;
    let undistorter = Undistorter::new(&camera, WorkingSize::Automatic, None);
    let (width, height) = undistorter.size();
    let pinhole = *undistorter.pinhole();
    let calibration = dataset.depth_calibration().unwrap().unwrap();
    let registration = DepthRegistration::new(&calibration, &pinhole, width, height);
    let config = AlignmentConfig::default();
    let (finest, coarsest) = (config.finest_level, config.coarsest_level);
    let mut world_from_keyframe = Se3::identity();
    let mut reference: Option<(usize, Reference)> = None;
    let mut motion = Motion::from_pose(Se3::identity());
    let mut velocity = Se3::identity();
    let mut poses: Vec<StampedPose> = Vec::new();
    for (i, entry) in dataset.frames.iter().enumerate() {
        let image = undistorter.apply(&read_gray(&entry.path).unwrap()).unwrap();
        let pyramid = Pyramid::new(image, 5);
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
        if let (true, Some(entry)) = (due, dataset.depth_of_frame(entry.timestamp_ns)) {
            let raw = read_depth(&entry.path, calibration.units_per_metre).unwrap();
            if let Some(depth) = registration.register(&raw) {
                let samples = samples(pyramid.level(0), &depth);
                let prepared = Reference::new(&pyramid, &pinhole, &samples, finest, coarsest);
                reference = Some((i, prepared));
                world_from_keyframe = world_from_frame;
                motion = Motion::from_pose(Se3::identity());
            }
        }
    }
    let truth: Vec<StampedPose> =
        monogrid_datasets::read_trajectory(dataset.ground_truth.as_ref().unwrap())
            .unwrap()
            .iter()
            .map(|p| (p.timestamp_ns, p.world_from_camera))
            .collect();
    let report = evaluate_trajectory(&poses, &truth, &TrajectoryConfig::default()).unwrap();
    println!(
        "ATE {:.4} m, scale {:.3}, drift {:?}, rotation per frame {:.3} deg",
        report.ate_rmse, report.scale, report.scale_drift, report.rpe_rot_rmse_deg
    );
}
