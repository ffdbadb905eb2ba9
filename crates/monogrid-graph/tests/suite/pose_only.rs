//! Pose from known points, on synthetic data with known truth.

use crate::common::{PINHOLE, Random};
use monogrid_geometry::{Mat6, Se3, Vec2, Vec3, Vec6};
use monogrid_graph::{MapMatch, PoseOnlyConfig, PoseOnlyError, PoseOutcome, refine_pose};

const TRUE_POSE: [f64; 6] = [0.3, -0.2, 0.5, 0.4, -0.9, 0.2];

fn matches(n: usize, noise_px: f64, outlier_share: f64, seed: u64) -> (Se3, Vec<MapMatch>) {
    let mut random = Random(seed);
    let truth = Se3::exp(&Vec6::from(TRUE_POSE));
    let world_from_camera = truth.inverse();
    let matches = (0..n)
        .map(|_| {
            let pixel = Vec2::new(640.0 * random.uniform(), 480.0 * random.uniform());
            let x = PINHOLE.unproject(&pixel) * (1.0 + 5.0 * random.uniform());
            let noise = Vec2::new(random.normal(), random.normal()) * noise_px;
            let wrong = if random.uniform() < outlier_share {
                Vec2::new(random.signed(), random.signed()) * 200.0
            } else {
                Vec2::zeros()
            };
            MapMatch {
                point_in_world: world_from_camera * x,
                pixel: pixel + noise + wrong,
                inv_sigma_px: 1.0 / noise_px.max(0.1),
            }
        })
        .collect();
    (truth, matches)
}

fn start(truth: &Se3, size: f64, seed: u64) -> Se3 {
    let mut random = Random(seed);
    Se3::exp(&Vec6::from_fn(|_, _| random.signed() * size)) * *truth
}

fn error(a: &Se3, b: &Se3) -> Vec6 {
    (*a * b.inverse()).log()
}

#[test]
fn exact_matches_give_the_exact_pose() {
    let (truth, matches) = matches(100, 0.0, 0.0, 1);
    let config = PoseOnlyConfig::default();
    let found = refine_pose(&start(&truth, 0.1, 2), &PINHOLE, &matches, &config).unwrap();
    let missed = error(&truth, &found.camera_from_world).norm();
    assert!(
        missed < 1e-10,
        "missed by {missed:e}, {} iterations",
        found.iterations
    );
    assert_eq!((found.outcome, found.num_inliers), (PoseOutcome::Good, 100));
}

#[test]
fn thirty_percent_of_outliers_are_found() {
    for seed in 0..20 {
        let (truth, matches) = matches(300, 0.7, 0.3, seed);
        let first = start(&truth, 0.05, seed);
        let found = refine_pose(&first, &PINHOLE, &matches, &PoseOnlyConfig::default()).unwrap();
        let e = error(&truth, &found.camera_from_world);
        assert_eq!(found.outcome, PoseOutcome::Good);
        assert!(e.fixed_rows::<3>(0).norm() < 0.01, "seed {seed}: {e}");
        assert!(e.fixed_rows::<3>(3).norm() < 0.003, "seed {seed}: {e}");
        // Inliers stay within 2.45 sigma: their mean squared error is below the noise's 2 sigma^2.
        assert!(found.inlier_rmse_px < 1.0 && found.inlier_rmse_px > 0.8);
        assert!(
            (175..=225).contains(&found.num_inliers),
            "{}",
            found.num_inliers
        );
    }
}

#[test]
fn covariance_is_honest_over_many_noises() {
    let (mut sum, mut scatter, n) = (0.0, Mat6::zeros(), 400);
    for seed in 0..n {
        let (truth, matches) = matches(80, 0.5, 0.0, seed);
        let config = PoseOnlyConfig {
            inlier_chi2: 1e3,
            ..PoseOnlyConfig::default()
        };
        let found = refine_pose(&truth, &PINHOLE, &matches, &config).unwrap();
        let e = error(&truth, &found.camera_from_world);
        sum += e.dot(&(found.covariance.try_inverse().unwrap() * e));
        scatter += e * e.transpose() / f64::from(n as u32);
    }
    let normalised = sum / (6.0 * f64::from(n as u32));
    // 2400 degrees of freedom: standard deviation 0.03
    assert!((normalised - 1.0).abs() < 0.1, "{normalised}");
    assert!(scatter.trace() > 0.0);
}

#[test]
fn matches_of_nothing_are_not_believed() {
    let (truth, mut matches) = matches(100, 0.5, 0.0, 4);
    let mut random = Random(9);
    for m in &mut matches {
        m.pixel = Vec2::new(640.0 * random.uniform(), 480.0 * random.uniform());
    }
    let found = refine_pose(&truth, &PINHOLE, &matches, &PoseOnlyConfig::default()).unwrap();
    assert_eq!(found.outcome, PoseOutcome::TooFewInliers);
    assert_eq!(found.covariance, Mat6::zeros());
}

#[test]
fn points_on_one_ray_do_not_determine_a_pose() {
    let (truth, matches) = matches(1, 0.0, 0.0, 5);
    let same = vec![matches[0]; 50];
    let found = refine_pose(&truth, &PINHOLE, &same, &PoseOnlyConfig::default()).unwrap();
    assert_eq!(found.outcome, PoseOutcome::Degenerate);
}

#[test]
fn points_behind_the_camera_do_no_harm() {
    let (truth, mut matches) = matches(100, 0.3, 0.0, 6);
    for m in matches.iter_mut().take(30) {
        m.point_in_world = truth.inverse() * Vec3::new(0.1, 0.2, -3.0);
    }
    let first = start(&truth, 0.05, 1);
    let found = refine_pose(&first, &PINHOLE, &matches, &PoseOnlyConfig::default()).unwrap();
    assert!(found.inliers.iter().take(30).all(|i| !i));
    assert!(error(&truth, &found.camera_from_world).norm() < 0.01);
}

#[test]
fn bad_input_is_refused() {
    let (truth, mut matches) = matches(10, 0.3, 0.0, 7);
    let config = PoseOnlyConfig::default();
    assert_eq!(
        refine_pose(&truth, &PINHOLE, &matches[..2], &config),
        Err(PoseOnlyError::TooFew { found: 2 })
    );
    matches[6].pixel.x = f64::NAN;
    let error = refine_pose(&truth, &PINHOLE, &matches, &config).unwrap_err();
    assert!(error.to_string().contains("match 6"));
}
