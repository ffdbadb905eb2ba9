//! The normal equations of Sim(3) against numeric differentiation, and recovery of known
//! similarities.

use crate::plane::{PINHOLE, render, samples};
use monogrid_alignment::{
    DepthPixel, Disagreement, KeyframeView, Robust, SimilarityConfig, SimilarityState,
    SimilarityWeighting, align_reciprocally, align_similarity, linearize_similarity,
};
use monogrid_geometry::{Se3, Sim3, Vec6, Vec7};
use monogrid_image::{GrayImage, Pyramid};

/// A keyframe whose unit is `unit` world units.
fn view(image: &GrayImage, samples: &[DepthPixel]) -> KeyframeView {
    let pyramid = Pyramid::new(image.clone(), 5);
    KeyframeView::new(&pyramid, &PINHOLE, samples, 0, 4)
}

fn keyframe(camera_from_world: &Se3, unit: f32, gain: f64, bias: f64) -> KeyframeView {
    let (image, depth) = render(camera_from_world, gain, bias);
    let mut points = samples(&depth, 2, 4);
    for point in &mut points {
        point.idepth *= unit;
        point.idepth_var = (0.01 * point.idepth).powi(2);
    }
    view(&image, &points)
}

/// `b_from_a` of two keyframes with the given poses and units.
fn true_similarity(a_from_world: &Se3, unit_a: f64, b_from_world: &Se3, unit_b: f64) -> Sim3 {
    let world_from_a = a_from_world.inverse().with_scale(unit_a);
    let world_from_b = b_from_world.inverse().with_scale(unit_b);
    world_from_b.inverse() * world_from_a
}

#[test]
fn gradient_of_the_joint_cost_matches_numeric_differentiation() {
    let moved = Se3::exp(&Vec6::new(0.03, -0.02, 0.04, 0.01, -0.008, 0.02));
    let (image_a, depth_a) = render(&Se3::identity(), 1.0, 0.0);
    let (image_b, depth_b) = render(&moved, 1.1, -5.0);
    let mut points_a = samples(&depth_a, 3, 20);
    points_a.iter_mut().for_each(|p| p.idepth_var = 1e-9);
    // The derivative of b's depth by the position is neglected by design: a constant has none.
    let mut points_b = samples(&depth_b, 1, 0);
    for point in &mut points_b {
        (point.idepth, point.idepth_var) = (0.55, 1e-3);
    }
    let (a, b) = (view(&image_a, &points_a), view(&image_b, &points_b));
    for robust in [Robust::Huber { k: 3.0 }, Robust::StudentT { nu: 5.0 }] {
        let weighting = SimilarityWeighting {
            intensity_var: 16.0,
            shared_depth_var: 0.0,
            robust,
            scale: [1.0; 2],
        };
        let state = SimilarityState {
            b_from_a: Sim3::from(moved)
                * Sim3::exp(&Vec7::from_column_slice(&[
                    0.01, 0.004, -0.02, 0.003, 0.002, -0.004, 0.03,
                ])),
            log_gain: 0.05,
            bias: 2.0,
        };
        let linear = |state: &SimilarityState| {
            let (points, image) = (&a.reference.levels[0], &b.target.levels[0]);
            linearize_similarity(points, image, &b.depth[0], state, &weighting, 1)
        };
        let analytic = linear(&state).gradient * 2.0;
        for k in 0..9 {
            let step = if k == 8 { 1e-2 } else { 2e-4 };
            let moved_by = |sign: f64| {
                let mut tangent = Vec7::zeros();
                let mut other = state;
                match k {
                    7 => other.log_gain += sign * step,
                    8 => other.bias += sign * step,
                    _ => {
                        tangent[k] = sign * step;
                        other.b_from_a = Sim3::exp(&tangent) * state.b_from_a;
                    }
                }
                linear(&other).cost
            };
            let numeric = (moved_by(1.0) - moved_by(-1.0)) / (2.0 * step);
            let tolerance = 0.02 * analytic[k].abs() + 0.01 * analytic.rows(0, 7).amax();
            assert!(
                (numeric - analytic[k]).abs() < tolerance.max(1.0),
                "{robust:?} unknown {k}: numeric {numeric}, analytic {}",
                analytic[k]
            );
        }
    }
}

#[test]
fn recovers_pose_and_scale_between_keyframes_of_different_units() {
    let b_from_world = Se3::exp(&Vec6::new(0.15, -0.08, 0.1, 0.03, -0.05, 0.06));
    let a = keyframe(&Se3::identity(), 1.0, 1.0, 0.0);
    let b = keyframe(&b_from_world, 1.6, 1.2, -12.0);
    let truth = true_similarity(&Se3::identity(), 1.0, &b_from_world, 1.6);
    for config in [SimilarityConfig::default(), SimilarityConfig::thesis()] {
        let off = Sim3::exp(&Vec7::from_column_slice(&[
            0.02, 0.02, -0.02, 0.01, 0.01, -0.015, 0.1,
        ]));
        let found =
            align_reciprocally(&a, &b, &SimilarityState::new(off * truth), &config).unwrap();
        let error = (found.b_from_a * truth.inverse()).log();
        assert!(error.rows(0, 6).amax() < 2e-3, "{error}");
        assert!(error[6].abs() < 2e-3, "scale off by {}", error[6]);
        assert!(found.visible_share > 0.5);
    }
}

/// Brightness that was handed on over a hundred keyframes says nothing any more.
#[test]
fn a_wrong_start_of_the_brightness_does_no_harm() {
    let b_from_world = Se3::exp(&Vec6::new(0.1, -0.05, 0.05, 0.02, -0.03, 0.03));
    let a = keyframe(&Se3::identity(), 1.0, 1.0, 0.0);
    let b = keyframe(&b_from_world, 1.3, 1.1, -6.0);
    let truth = true_similarity(&Se3::identity(), 1.0, &b_from_world, 1.3);
    for (log_gain, bias) in [(0.9, -80.0), (-1.2, 120.0)] {
        let start = SimilarityState {
            b_from_a: truth,
            log_gain,
            bias,
        };
        let found = align_reciprocally(&a, &b, &start, &SimilarityConfig::default()).unwrap();
        let error = (found.b_from_a * truth.inverse()).log();
        assert!(error.amax() < 2e-3, "{error}");
    }
}

#[test]
fn information_is_as_large_as_the_error_says() {
    // White noise of a known size on the images and depths of both.
    let mut random = 12345u64;
    let mut noise = || {
        let mut sum = 0.0f32;
        for _ in 0..12 {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            sum += (random >> 40) as f32 / (1u64 << 24) as f32;
        }
        sum - 6.0
    };
    let b_from_world = Se3::exp(&Vec6::new(0.1, -0.05, 0.05, 0.02, -0.03, 0.02));
    let mut noisy = |pose: &Se3| {
        let (image, depth) = render(pose, 1.0, 0.0);
        let image = GrayImage::from_fn(320, 240, |x, y| image.at(x, y) + noise());
        let mut points = samples(&depth, 1, 4);
        for point in &mut points {
            let sigma = 0.03 * point.idepth;
            point.idepth += sigma * noise();
            point.idepth_var = sigma * sigma;
        }
        view(&image, &points)
    };
    // Even with independent pixels eight count as one: noise in depths shrinks the motion a little,
    // noise in gradients counts as contrast.
    let config = SimilarityConfig {
        shared_depth_sigma: 0.0,
        finest_level: 0,
        max_points: 1000,
        ..SimilarityConfig::default()
    };
    let truth = true_similarity(&Se3::identity(), 1.0, &b_from_world, 1.0);
    let mut chi_sq = Vec::new();
    for _ in 0..6 {
        let (a, b) = (noisy(&Se3::identity()), noisy(&b_from_world));
        let found = align_similarity(&a, &b, &SimilarityState::new(truth), (2, 0), &config);
        let error = (found.state.b_from_a * truth.inverse()).log();
        chi_sq.push((error.transpose() * found.information.unwrap() * error)[0]);
    }
    chi_sq.sort_by(f64::total_cmp);
    // chi square with 7 degrees of freedom: 1 % below 1.2, 1 % above 18.5
    let median = chi_sq[chi_sq.len() / 2];
    assert!((1.2..18.5).contains(&median), "{chi_sq:?}");
}

#[test]
fn another_place_gives_no_constraint() {
    let a = keyframe(&Se3::identity(), 1.0, 1.0, 0.0);
    let (_, depth) = render(&Se3::identity(), 1.0, 0.0);
    let other = GrayImage::from_fn(320, 240, |x, y| {
        let (x, y) = (x as f32 * 0.11, y as f32 * 0.07);
        120.0 + 50.0 * (x * 1.3 + (y * 0.9).sin() * 3.0).sin() + 30.0 * (y * 2.1 - x * 0.4).cos()
    });
    let b = view(&other, &samples(&depth, 2, 4));
    let initial = SimilarityState::new(Sim3::identity());
    let config = SimilarityConfig::default();
    assert!(align_reciprocally(&a, &b, &initial, &config).is_err());
    let away = SimilarityState::new(Sim3::from(Se3::exp(&Vec6::new(
        0.0, 0.0, 0.0, 0.0, 1.2, 0.0,
    ))));
    let c = keyframe(&Se3::identity(), 1.0, 1.0, 0.0);
    let refused = align_reciprocally(&a, &c, &away, &config);
    assert!(
        matches!(refused, Err(Disagreement::Overlap(_))),
        "{refused:?}"
    );
}
