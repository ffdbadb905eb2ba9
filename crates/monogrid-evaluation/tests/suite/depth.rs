//! Depth metrics on keyframes whose errors are known.

use monogrid_evaluation::{DepthConfig, DepthError, DepthEvaluator, DepthReport, KeyframeDepth};
use monogrid_image::DepthPixel;

const WIDTH: usize = 80;
const HEIGHT: usize = 60;

/// A generator of uniform numbers in [0, 1), enough for a test.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

struct Scene {
    depth: Vec<f32>,
    gradient: Vec<f32>,
}

/// Depth 1 to 3; the left half has gradient 10, the right half 2; the last row has no truth.
fn scene() -> Scene {
    let depth = (0..WIDTH * HEIGHT)
        .map(|i| match i / WIDTH {
            row if row == HEIGHT - 1 => f32::NAN,
            _ => 1.0 + 2.0 * (i % 97) as f32 / 97.0,
        })
        .collect();
    let gradient = (0..WIDTH * HEIGHT)
        .map(|i| if i % WIDTH < WIDTH / 2 { 10.0 } else { 2.0 })
        .collect();
    Scene { depth, gradient }
}

/// Estimates at every pixel; `world_scale` the keyframe's unit, `factor` how much too small
/// all its depths are, noise of `sigma` (relative to the inverse depth), reported as `reported`.
fn estimates(
    scene: &Scene,
    world_scale: f64,
    factor: f64,
    (sigma, reported): (f64, f64),
    random: &mut Random,
) -> Vec<DepthPixel> {
    (0..WIDTH * HEIGHT)
        .map(|i| {
            let depth = f64::from(scene.depth[i]);
            let depth = if depth.is_finite() { depth } else { 1.0 };
            let idepth = factor * world_scale / depth;
            DepthPixel {
                x: (i % WIDTH) as u16,
                y: (i / WIDTH) as u16,
                idepth: (idepth * (1.0 + sigma * random.normal())) as f32,
                idepth_var: (idepth * reported).powi(2) as f32,
            }
        })
        .collect()
}

fn keyframe<'a>(
    id: u64,
    scene: &'a Scene,
    world_scale: f64,
    estimates: &'a [DepthPixel],
) -> KeyframeDepth<'a> {
    KeyframeDepth {
        id,
        width: WIDTH,
        height: HEIGHT,
        estimates,
        world_scale,
        true_depth: &scene.depth,
        gradient: &scene.gradient,
    }
}

fn evaluate(keyframes: &[KeyframeDepth]) -> DepthReport {
    let mut evaluator = DepthEvaluator::new(DepthConfig::default());
    for keyframe in keyframes {
        evaluator.add_keyframe(keyframe).expect("good input");
    }
    evaluator.finish().expect("a report")
}

#[test]
fn exact_depth_in_other_units_is_perfect() {
    let scene = scene();
    let mut random = Random(1);
    let first = estimates(&scene, 0.7, 4.0, (0.0, 0.01), &mut random);
    let second = estimates(&scene, 3.1, 4.0, (0.0, 0.01), &mut random);
    let report = evaluate(&[
        keyframe(0, &scene, 0.7, &first),
        keyframe(1, &scene, 3.1, &second),
    ]);
    assert!((report.scale - 4.0).abs() < 1e-5, "{}", report.scale);
    assert_eq!(report.gradient_pixels, 2 * (HEIGHT - 1) * WIDTH / 2);
    assert_eq!(report.estimates, 2 * (HEIGHT - 1) * WIDTH);
    assert_eq!(report.shares.within_3_percent, 1.0);
    assert_eq!(report.shares.density, 1.0);
    assert!(report.bias.abs() < 1e-6 && report.rmse_log_depth < 1e-6);
    assert_eq!(report.normalised_error.within_2_sigma, 1.0);
}

#[test]
fn honest_noise_has_deviation_one_and_over_confidence_shows() {
    let scene = scene();
    for (reported, deviation, within) in [(0.05, 1.0, 0.954), (0.025, 2.0, 0.683)] {
        let mut random = Random(7);
        let noisy = estimates(&scene, 1.0, 1.0, (0.05, reported), &mut random);
        let error = evaluate(&[keyframe(0, &scene, 1.0, &noisy)]).normalised_error;
        assert!(
            (error.robust_deviation / deviation - 1.0).abs() < 0.05,
            "{error:?}"
        );
        assert!((error.std / deviation - 1.0).abs() < 0.05, "{error:?}");
        assert!((error.within_2_sigma - within).abs() < 0.02, "{error:?}");
        assert!(error.absolute_median < 0.05 * deviation, "{error:?}");
    }
}

#[test]
fn shares_follow_the_normal_distribution() {
    let scene = scene();
    let noisy = estimates(&scene, 1.0, 1.0, (0.03, 0.03), &mut Random(3));
    let report = evaluate(&[keyframe(0, &scene, 1.0, &noisy)]);
    // Of a normal distribution 68.3 % lie within one sigma and 99.9 % within 3.3.
    assert!(
        (report.shares.within_3_percent - 0.683).abs() < 0.03,
        "{report:?}"
    );
    assert!(report.shares.within_10_percent > 0.99);
}

#[test]
fn drift_of_the_scale_shows_beside_the_shares_with_own_scale() {
    let scene = scene();
    let mut random = Random(1);
    let scales = [1.0, 1.0, 1.2];
    let all: Vec<_> = scales
        .iter()
        .map(|s| estimates(&scene, 1.0, *s, (0.0, 0.01), &mut random))
        .collect();
    let keyframes: Vec<_> = (0..3)
        .map(|i| keyframe(i as u64, &scene, 1.0, &all[i]))
        .collect();
    let report = evaluate(&keyframes);
    assert!((report.shares.within_10_percent - 2.0 / 3.0).abs() < 1e-9);
    assert_eq!(report.shares_own_scale.within_3_percent, 1.0);
    let relative = report.per_keyframe[2].relative_scale.expect("estimates");
    assert!((relative - 1.2).abs() < 1e-5);
}

#[test]
fn missing_and_negative_depth_counts_against_the_shares() {
    let scene = scene();
    let mut few = estimates(&scene, 1.0, 1.0, (0.0, 0.01), &mut Random(1));
    few.retain(|e| e.x % 4 != 0);
    for estimate in few.iter_mut().filter(|e| e.x % 4 == 1) {
        estimate.idepth = -estimate.idepth;
    }
    let shares = evaluate(&[keyframe(0, &scene, 1.0, &few)]).shares;
    assert_eq!(shares.density, 0.75);
    assert_eq!(shares.within_10_percent, 0.5);
}

#[test]
fn bad_input_is_named() {
    let scene = scene();
    let mut wrong = estimates(&scene, 1.0, 1.0, (0.0, 0.01), &mut Random(1));
    let mut evaluator = DepthEvaluator::new(DepthConfig::default());
    let mut short = keyframe(5, &scene, 1.0, &wrong);
    short.gradient = &scene.gradient[1..];
    let error = evaluator.add_keyframe(&short).expect_err("wrong size");
    assert!(matches!(error, DepthError::Size { id: 5, .. }), "{error}");
    wrong[7].idepth_var = 0.0;
    let error = evaluator
        .add_keyframe(&keyframe(6, &scene, 1.0, &wrong))
        .expect_err("zero variance");
    assert!(
        matches!(error, DepthError::Estimate { estimate, .. } if estimate.x == 7),
        "{error}"
    );
    assert!(matches!(evaluator.finish(), Err(DepthError::NoTruth(0))));
}

#[test]
fn shares_of_all_pixels_count_those_without_texture_and_those_without_depth() {
    let scene = scene();
    let mut known = estimates(&scene, 1.0, 1.0, (0.0, 0.01), &mut Random(7));
    // every fourth pixel has no depth, and the rows of the lower half are 20 % off
    known.retain(|e| e.x % 4 != 0);
    for estimate in known.iter_mut().filter(|e| e.y >= 30) {
        estimate.idepth *= 1.2;
    }
    let mut evaluator = DepthEvaluator::new(DepthConfig {
        scale: Some(1.0),
        ..DepthConfig::default()
    });
    evaluator
        .add_keyframe(&KeyframeDepth {
            id: 0,
            width: WIDTH,
            height: HEIGHT,
            estimates: &known,
            world_scale: 1.0,
            true_depth: &scene.depth,
            gradient: &scene.gradient,
        })
        .expect("sizes fit");
    let report = evaluator.finish().expect("truth is known");
    // the last row has no truth
    assert_eq!(report.known_pixels, WIDTH * (HEIGHT - 1));
    let shares = report.shares_of_known;
    assert!((shares.density - 0.75).abs() < 1e-12, "{shares:?}");
    let expected = 0.75 * 30.0 / 59.0;
    assert!(
        (shares.within_3_percent - expected).abs() < 1e-12,
        "{shares:?}"
    );
    assert!(
        (shares.within_10_percent - expected).abs() < 1e-12,
        "{shares:?}"
    );
}
