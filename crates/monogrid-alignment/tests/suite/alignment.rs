//! The normal equations against numeric differentiation, and recovery of known motions.

use crate::plane::{PINHOLE, render, samples};
use monogrid_alignment::{
    AlignmentConfig, Freedom, Motion, Reference, ReferenceLevel, Robust, Target, Weighting, align,
    linearize,
};
use monogrid_geometry::{Se3, Vec6};
use monogrid_image::{GrayImage, Pyramid};

fn weighting(robust: Robust) -> Weighting {
    Weighting {
        intensity_var: 16.0,
        robust,
        scale: 1.0,
        good_sq: 400.0,
        good_gradient_sq: 0.25,
    }
}

#[test]
fn gradient_of_the_cost_matches_numeric_differentiation() {
    let (reference_image, depth) = render(&Se3::identity(), 1.0, 0.0);
    let moved = Se3::exp(&Vec6::new(0.03, -0.02, 0.04, 0.01, -0.008, 0.02));
    let (frame_image, _) = render(&moved, 1.1, -5.0);
    let pyramid = Pyramid::new(reference_image, 1);
    let reference = Reference::new(&pyramid, &PINHOLE, &samples(&depth, 4, 40), 0, 0);
    let target = Target::new(&Pyramid::new(frame_image, 1), &PINHOLE, 0, 0);
    let states = [
        Motion::from_pose(Se3::identity()),
        Motion {
            frame_from_keyframe: Se3::exp(&Vec6::new(0.01, 0.0, -0.02, 0.004, 0.003, -0.01)),
            log_gain: 0.05,
            bias: 3.0,
        },
        Motion::from_pose(moved),
    ];
    for robust in [Robust::StudentT { nu: 5.0 }, Robust::Huber { k: 1e9 }] {
        for state in &states {
            let weighting = weighting(robust);
            let at = |delta: [f64; 8]| {
                let twist = Vec6::from_column_slice(&delta[..6]);
                let motion = Motion {
                    frame_from_keyframe: Se3::exp(&twist) * state.frame_from_keyframe,
                    log_gain: state.log_gain + delta[6],
                    bias: state.bias + delta[7],
                };
                linearize(
                    &reference.levels[0],
                    &target.levels[0],
                    &motion,
                    &weighting,
                    1,
                )
            };
            let linear = at([0.0; 8]);
            for i in 0..8 {
                let step = if i == 7 { 0.05 } else { 2e-4 };
                let mut plus = [0.0; 8];
                plus[i] = step;
                let mut minus = [0.0; 8];
                minus[i] = -step;
                let (a, b) = (at(plus), at(minus));
                assert_eq!(a.num_visible, b.num_visible, "all points stay inside");
                let numeric = (a.mean_cost() - b.mean_cost()) / (2.0 * step);
                let analytic = 2.0 * linear.gradient[i] / linear.num_visible as f64;
                let size = (linear.hessian[(i, i)] / linear.num_visible as f64).sqrt();
                assert!(
                    (numeric - analytic).abs() < 0.02 * analytic.abs() + 0.02 * size,
                    "unknown {i}, {robust:?}: numeric {numeric}, analytic {analytic}, size {size}"
                );
            }
        }
    }
}

#[test]
fn recovers_five_pixels_and_three_degrees_with_changed_brightness() {
    let (reference_image, depth) = render(&Se3::identity(), 1.0, 0.0);
    let pyramid = Pyramid::new(reference_image, 4);
    let reference = Reference::new(&pyramid, &PINHOLE, &samples(&depth, 2, 0), 0, 3);
    let config = AlignmentConfig {
        coarsest_level: 3,
        finest_level: 0,
        max_points: 0,
        ..AlignmentConfig::default()
    };
    let motions = [
        Vec6::new(0.04, 0.0, 0.0, 0.0, 0.0, 0.0),
        Vec6::new(0.0, -0.03, 0.05, 0.0, 0.0, 0.05),
        Vec6::new(0.02, 0.02, -0.04, 0.03, -0.03, 0.02),
        Vec6::new(0.0, 0.0, 0.0, 0.05, 0.02, -0.03),
    ];
    for (twist, (gain, bias)) in
        motions
            .iter()
            .zip([(1.0, 0.0), (1.6, -30.0), (0.7, 25.0), (1.2, 5.0)])
    {
        let truth = Se3::exp(twist);
        let (image, _) = render(&truth, gain, bias);
        let target = Target::new(&Pyramid::new(image, 4), &PINHOLE, 0, 3);
        let start = Motion::from_pose(Se3::identity());
        let result = align(&reference, &target, &start, Freedom::Rigid, &config);
        let error = (result.motion.frame_from_keyframe * truth.inverse()).log();
        let error_px =
            260.0 * (error.fixed_rows::<3>(0).norm() / 2.0 + error.fixed_rows::<3>(3).norm());
        assert!(error_px < 0.02, "{error_px} px for {twist:?}: {result:?}");
        assert!(
            (f64::from(result.gain()) / gain - 1.0).abs() < 0.01,
            "{result:?}"
        );
        assert!((f64::from(result.bias()) - bias).abs() < 1.5, "{result:?}");
        assert!(result.good_of_visible > 0.99 && result.covariance.is_some());
    }
}

/// An image with white noise, even between -1.5 and 1.5 grey levels and another one for each `k`.
fn noisy(image: &GrayImage, k: usize) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        let index = (x + image.width() * (y + image.height() * k)) as u64;
        // an integer hash: neighbours share nothing
        let mut hash = index.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        hash = (hash ^ (hash >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        hash ^= hash >> 31;
        image.at(x, y) + 1.5 * ((hash % 2001) as f32 / 1000.0 - 1.0)
    })
}

#[test]
fn covariance_of_the_pose_is_that_of_its_errors() {
    let (image, depth) = render(&Se3::identity(), 1.0, 0.0);
    let pyramid = Pyramid::new(noisy(&image, 0), 3);
    let reference = Reference::new(&pyramid, &PINHOLE, &samples(&depth, 4, 20), 0, 2);
    let config = |pixels_per_measurement| AlignmentConfig {
        coarsest_level: 2,
        finest_level: 0,
        max_points: 0,
        // of both images; interpolation averages a half away in the frame
        sigma_intensity: 1.5 / 3.0_f32.sqrt() * 1.5_f32.sqrt(),
        robust: Robust::Huber { k: 10.0 },
        pixels_per_measurement,
        ..AlignmentConfig::default()
    };
    let num_motions = 12_u32;
    let mut sum = 0.0;
    for k in 0..num_motions {
        let angle = f64::from(k) * 0.7;
        let (s, c) = angle.sin_cos();
        let twist = Vec6::new(
            0.02 * c,
            0.015 * s,
            0.01 * c,
            0.006 * s,
            -0.008 * c,
            0.01 * s,
        );
        let truth = Se3::exp(&twist);
        let frame = Pyramid::new(noisy(&render(&truth, 1.0, 0.0).0, 1 + k as usize), 3);
        let target = Target::new(&frame, &PINHOLE, 0, 2);
        let start = Motion::from_pose(truth);
        let found = |n| align(&reference, &target, &start, Freedom::Rigid, &config(n));
        let one = found(1.0);
        let covariance = one.covariance.unwrap();
        let error = (one.motion.frame_from_keyframe * truth.inverse()).log();
        sum += error.dot(&(covariance.try_inverse().unwrap() * error)) / 6.0;
        let eight = found(8.0).covariance.unwrap();
        assert!((eight - covariance * 8.0).norm() < 1e-9 * eight.norm());
    }
    let normalised = sum / f64::from(num_motions);
    // 72 degrees of freedom: standard deviation 0.17
    assert!(normalised > 0.5 && normalised < 2.0, "{normalised}");
}

#[test]
fn rotation_alone_is_found_from_points_at_infinity() {
    let (reference_image, _) = render(&Se3::identity(), 1.0, 0.0);
    let pyramid = Pyramid::new(reference_image, 4);
    let truth = Se3::exp(&Vec6::new(0.0, 0.0, 0.0, 0.03, -0.05, 0.04));
    let (image, _) = render(&truth, 1.0, 0.0);
    let target = Target::new(&Pyramid::new(image, 4), &PINHOLE, 2, 3);
    let reference = Reference::at_infinity(&pyramid, &PINHOLE, 3);
    let config = AlignmentConfig {
        coarsest_level: 3,
        finest_level: 3,
        ..AlignmentConfig::default()
    };
    let start = Motion::from_pose(Se3::identity());
    let found = align(&reference, &target, &start, Freedom::Rotation, &config);
    let error = (found.motion.frame_from_keyframe * truth.inverse()).log();
    assert!(error.norm() < 4e-3, "{error:?}");
    assert!(found.motion.frame_from_keyframe.translation.norm() < 1e-12);
}

#[test]
fn an_empty_reference_or_a_blank_image_is_no_panic() {
    let blank = Pyramid::new(GrayImage::filled(320, 240, 90.0), 4);
    let target = Target::new(&blank, &PINHOLE, 1, 3);
    let start = Motion::from_pose(Se3::identity());
    let config = AlignmentConfig::default();
    let none = Reference::new(&blank, &PINHOLE, &[], 1, 3);
    let result = align(&none, &target, &start, Freedom::Rigid, &config);
    assert_eq!(result.num_points, 0);
    assert!(result.good_share <= 0.0);
    let flat = GrayImage::filled(320, 240, 2.0);
    let some = Reference::new(&blank, &PINHOLE, &samples(&flat, 4, 0), 1, 3);
    let result = align(&some, &target, &start, Freedom::Rigid, &config);
    assert!(result.motion.frame_from_keyframe.is_finite());
}

/// One point with an uncertain depth, before an image that rises steadily to the right and
/// downwards.
struct OnePoint {
    point: ReferenceLevel,
    target: Target,
    motion: Motion,
}

impl OnePoint {
    fn new(idepth_var: f32) -> Self {
        let image = GrayImage::from_fn(320, 240, |u, v| 20.0 + 0.4 * u as f32 + 0.2 * v as f32);
        Self {
            point: ReferenceLevel {
                x: vec![0.2],
                y: vec![-0.15],
                idepth: vec![0.5],
                idepth_var: vec![idepth_var],
                intensity: vec![90.0],
            },
            target: Target::new(&Pyramid::new(image, 1), &PINHOLE, 0, 0),
            motion: Motion::from_pose(Se3::exp(&Vec6::new(0.2, 0.1, 0.3, 0.01, 0.02, -0.01))),
        }
    }

    /// Residual, weight and cost: the bias moves the residual by minus one.
    fn evaluate(&self, robust: Robust) -> (f64, f64, f64) {
        let level = &self.target.levels[0];
        let linear = linearize(&self.point, level, &self.motion, &weighting(robust), 1);
        assert_eq!(linear.num_visible, 1);
        let weight = linear.hessian[(7, 7)];
        (-linear.gradient[7] / weight, weight, linear.cost)
    }
}

#[test]
fn an_uncertain_depth_adds_what_it_moves_the_residual_to_its_variance() {
    let plain = Robust::Huber { k: 1e9 };
    let (idepth_var, step) = (0.04, 0.01);
    let mut moved = OnePoint::new(idepth_var);
    moved.point.idepth[0] += step;
    let ahead = moved.evaluate(plain).0;
    moved.point.idepth[0] -= 2.0 * step;
    let by_idepth = (ahead - moved.evaluate(plain).0) / f64::from(2.0 * step);
    let expected = 16.0 + by_idepth * by_idepth * f64::from(idepth_var);
    // the depth matters here, so a variance that left it out or took it away would be seen
    assert!(expected > 20.0, "{expected}");
    let (residual, weight, cost) = OnePoint::new(idepth_var).evaluate(plain);
    assert!(
        (weight * expected - 1.0).abs() < 0.01,
        "{weight} {expected}"
    );
    assert!((cost * expected / (residual * residual) - 1.0).abs() < 0.01);
    let (_, certain, _) = OnePoint::new(0.0).evaluate(plain);
    assert!((certain * 16.0 - 1.0).abs() < 1e-6);
}

#[test]
fn hubers_weight_falls_with_the_residual_beyond_its_threshold() {
    let point = OnePoint::new(0.0);
    let (residual, plain, _) = point.evaluate(Robust::Huber { k: 1e9 });
    let sigmas = residual.abs() / 4.0;
    assert!(sigmas > 2.0, "{sigmas}");
    for k in [0.5, 1.0, 0.9 * sigmas] {
        let (_, weight, cost) = point.evaluate(Robust::Huber { k: k as f32 });
        assert!(
            (weight / plain - k / sigmas).abs() < 1e-5,
            "k = {k}: {weight}"
        );
        assert!((cost - k * (2.0 * sigmas - k)).abs() < 1e-4 * cost);
    }
    let (_, weight, _) = point.evaluate(Robust::Huber {
        k: 1.1 * sigmas as f32,
    });
    assert!((weight - plain).abs() < 1e-9);
}
