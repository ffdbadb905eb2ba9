//! Bundle adjustment on synthetic windows with known truth.

use crate::common::{
    PINHOLE, Scene, SceneOptions, disturb, scene, worst_centre_error, worst_rotation_error,
};
use monogrid_geometry::{Mat6, Se3, Vec2, Vec6};
use monogrid_graph::RobustKernel;
use monogrid_graph::bundle::{
    Appearance, BundleConfig, BundleError, BundleOutcome, BundleSolution, CovarianceOf,
    InverseDepthPrior, Observation, ObservationOutcome, PixelSlope, PoseFreedom, adjust,
    adjust_to_images,
};

fn options() -> SceneOptions {
    SceneOptions {
        keyframes: 10,
        points: 300,
        noise_px: 0.5,
        outlier_share: 0.0,
        seed: 1,
    }
}

/// Two fixed poses: everything is determined.
fn fixed_scene(options: &SceneOptions) -> Scene {
    let mut scene = scene(options);
    scene.problem.keyframes[0].freedom = PoseFreedom::Fixed;
    scene.problem.keyframes[1].freedom = PoseFreedom::Fixed;
    scene
}

#[test]
fn exact_observations_give_the_exact_window() {
    let mut scene = fixed_scene(&SceneOptions {
        noise_px: 0.0,
        ..options()
    });
    disturb(&mut scene.problem, 0.03, 0.1, 7);
    for kernel in [
        RobustKernel::None,
        RobustKernel::Huber { delta: 2.0 },
        RobustKernel::Cauchy { scale: 3.0 },
    ] {
        let config = BundleConfig {
            kernel,
            max_iterations: 50,
            min_relative_decrease: 1e-9,
            ..BundleConfig::default()
        };
        let solution = adjust(&scene.problem, &config).unwrap();
        assert!(worst_centre_error(&solution.camera_from_world, &scene.true_poses) < 1e-9);
        assert!(worst_rotation_error(&solution.camera_from_world, &scene.true_poses) < 1e-9);
        let depths = solution
            .inverse_depths
            .iter()
            .zip(&scene.true_inverse_depths);
        let worst = depths.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-9, "inverse depth off by {worst:e}");
        assert!(solution.final_cost < 1e-12 * solution.initial_cost);
        assert!(
            solution
                .observations
                .iter()
                .all(ObservationOutcome::is_inlier)
        );
    }
}

#[test]
fn noise_and_outliers_leave_the_window_near_the_truth() {
    for seed in 0..5 {
        let mut scene = fixed_scene(&SceneOptions {
            outlier_share: 0.1,
            seed,
            ..options()
        });
        // Both ends fixed: at an open end the covariance allows several mrad.
        scene.problem.keyframes[9].freedom = PoseFreedom::Fixed;
        disturb(&mut scene.problem, 0.03, 0.1, seed + 100);
        let solution = adjust(&scene.problem, &BundleConfig::default()).unwrap();
        // 0.5 px at 525 px focal length and 4 units distance are 4 mm for one point; the worst of
        // 35 poses.
        let error = worst_centre_error(&solution.camera_from_world, &scene.true_poses);
        assert!(error < 0.012, "seed {seed}: centre off by {error}");
        let turned = worst_rotation_error(&solution.camera_from_world, &scene.true_poses);
        assert!(
            turned < 2e-3,
            "seed {seed}: turned by {turned}, centre off by {error}"
        );
        let (mut wrong_kept, mut right_dropped, mut wrong, mut right) = (0, 0, 0, 0);
        for (outcome, &is_outlier) in solution.observations.iter().zip(&scene.is_outlier) {
            let is_inlier = outcome.is_inlier();
            wrong += usize::from(is_outlier);
            right += usize::from(!is_outlier);
            wrong_kept += usize::from(is_outlier && is_inlier);
            right_dropped += usize::from(!is_outlier && !is_inlier);
        }
        assert!(
            wrong_kept * 20 < wrong,
            "{wrong_kept} of {wrong} outliers kept"
        );
        assert!(
            right_dropped * 10 < right,
            "{right_dropped} of {right} inliers dropped"
        );
    }
}

#[test]
fn result_is_a_minimum_of_the_stated_cost() {
    // Brute force: no small change of any single unknown lowers the cost, which is evaluated by the
    // solver itself at zero iterations.
    let mut scene = fixed_scene(&SceneOptions {
        keyframes: 5,
        points: 40,
        outlier_share: 0.05,
        ..options()
    });
    disturb(&mut scene.problem, 0.02, 0.05, 3);
    let config = BundleConfig {
        max_iterations: 100,
        min_relative_decrease: 1e-14,
        rejection_rounds: 0,
        ..BundleConfig::default()
    };
    let solution = adjust(&scene.problem, &config).unwrap();
    let still = BundleConfig {
        max_iterations: 0,
        ..config
    };
    let mut at_minimum = scene.problem.clone();
    for (k, pose) in solution.camera_from_world.iter().enumerate() {
        at_minimum.keyframes[k].camera_from_world = *pose;
    }
    for (p, &d) in solution.inverse_depths.iter().enumerate() {
        at_minimum.points[p].inverse_depth = d;
    }
    let cost = |problem: &_| adjust(problem, &still).unwrap().final_cost;
    let least = cost(&at_minimum);
    assert!((least - solution.final_cost).abs() < 1e-9 * least);
    for size in [1e-4, 1e-3, 1e-2] {
        for k in 2..5 {
            for i in 0..6 {
                for sign in [-1.0, 1.0] {
                    let mut d = Vec6::zeros();
                    d[i] = sign * size;
                    let mut moved = at_minimum.clone();
                    moved.keyframes[k].camera_from_world =
                        Se3::exp(&d) * moved.keyframes[k].camera_from_world;
                    assert!(cost(&moved) > least, "pose {k} direction {i} size {size}");
                }
            }
        }
        for p in 0..40 {
            for sign in [-1.0, 1.0] {
                let mut moved = at_minimum.clone();
                moved.points[p].inverse_depth *= 1.0 + sign * size;
                assert!(
                    cost(&moved) > least,
                    "point {p} by {size}: {} {least} {solution:?}",
                    cost(&moved)
                );
            }
        }
    }
}

#[test]
fn held_distance_keeps_the_scale_with_one_fixed_pose() {
    let mut scene = scene(&options());
    scene.problem.keyframes[0].freedom = PoseFreedom::Fixed;
    scene.problem.keyframes[9].freedom = PoseFreedom::FixedDistance { to: 0 };
    disturb(&mut scene.problem, 0.02, 0.1, 5);
    // Turn the held pose a little, without changing its distance.
    let turn = Se3::exp(&Vec6::new(0.0, 0.0, 0.0, 0.01, -0.01, 0.02));
    let held = scene.problem.keyframes[9].camera_from_world;
    scene.problem.keyframes[9].camera_from_world = turn * held;
    let solution = adjust(&scene.problem, &BundleConfig::default()).unwrap();
    let centre = |pose: &Se3| pose.inverse().translation;
    let baseline = |poses: &[Se3]| (centre(&poses[9]) - centre(&poses[0])).norm();
    let (found, truth) = (
        baseline(&solution.camera_from_world),
        baseline(&scene.true_poses),
    );
    assert!(
        (found / truth - 1.0).abs() < 1e-12,
        "{found} instead of {truth}"
    );
    let error = worst_centre_error(&solution.camera_from_world, &scene.true_poses);
    assert!(error < 0.01, "centre off by {error}");
}

#[test]
fn outer_ring_of_fixed_keyframes_stays_and_holds_the_rest() {
    let mut scene = scene(&options());
    for k in [0, 1, 2, 7, 8, 9] {
        scene.problem.keyframes[k].freedom = PoseFreedom::Fixed;
    }
    disturb(&mut scene.problem, 0.03, 0.1, 6);
    let solution = adjust(&scene.problem, &BundleConfig::default()).unwrap();
    for k in [0, 1, 2, 7, 8, 9] {
        assert_eq!(solution.camera_from_world[k], scene.true_poses[k]);
    }
    assert!(worst_centre_error(&solution.camera_from_world, &scene.true_poses) < 0.005);
}

#[test]
fn priors_pull_where_observations_are_silent() {
    // An unseen point goes to its prior.
    let mut scene = fixed_scene(&options());
    scene.problem.observations.retain(|o| o.point != 5);
    scene.problem.points[5].prior = Some(InverseDepthPrior {
        mean: 0.77,
        sigma: 0.1,
        kernel: RobustKernel::None,
    });
    let config = BundleConfig {
        max_iterations: 50,
        min_relative_decrease: 1e-12,
        ..BundleConfig::default()
    };
    let solution = adjust(&scene.problem, &config).unwrap();
    assert!((solution.inverse_depths[5] - 0.77).abs() < 1e-6);
}

#[test]
fn order_of_observations_does_not_matter_and_runs_repeat_exactly() {
    let mut scene = fixed_scene(&SceneOptions {
        outlier_share: 0.1,
        ..options()
    });
    disturb(&mut scene.problem, 0.03, 0.1, 8);
    let config = BundleConfig::default();
    let first = adjust(&scene.problem, &config).unwrap();
    assert_eq!(first, adjust(&scene.problem, &config).unwrap());
    let mut reversed = scene.problem.clone();
    reversed.observations.reverse();
    let second = adjust(&reversed, &config).unwrap();
    assert!(worst_centre_error(&first.camera_from_world, &second.camera_from_world) < 1e-7);
}

#[test]
fn variances_are_honest_over_many_noises() {
    // Normalised errors of inverse depths and poses, over repeated noise, have unit variance.
    let (mut sum, mut count, mut pose_sum, mut pose_count) = (0.0, 0.0, 0.0, 0.0);
    for seed in 0..30 {
        let mut scene = fixed_scene(&SceneOptions {
            keyframes: 6,
            points: 60,
            seed,
            ..options()
        });
        scene.problem.keyframes[5].freedom = PoseFreedom::Fixed;
        let config = BundleConfig {
            kernel: RobustKernel::None,
            rejection_rounds: 0,
            covariance: CovarianceOf::PosesAndPoints,
            max_iterations: 30,
            min_relative_decrease: 1e-10,
            ..BundleConfig::default()
        };
        let solution = adjust(&scene.problem, &config).unwrap();
        let covariance = solution.covariance.unwrap();
        for (p, variance) in covariance.inverse_depth_variances.iter().enumerate() {
            let error = solution.inverse_depths[p] - scene.true_inverse_depths[p];
            sum += error * error / variance.unwrap();
            count += 1.0;
        }
        assert_eq!(covariance.poses[0], Mat6::zeros());
        for k in 2..5 {
            let truth = scene.true_poses[k];
            let error = (truth * solution.camera_from_world[k].inverse()).log();
            let information = covariance.poses[k].try_inverse().unwrap();
            pose_sum += error.dot(&(information * error));
            pose_count += 6.0;
        }
    }
    let (depths, poses) = (sum / count, pose_sum / pose_count);
    assert!(
        (depths - 1.0).abs() < 0.15,
        "mean normalised squared depth error {depths}"
    );
    assert!(
        (poses - 1.0).abs() < 0.25,
        "mean normalised squared pose error {poses}"
    );
}

#[test]
fn the_covariance_of_poses_is_the_one_without_that_of_points_too() {
    let mut scene = scene(&options());
    for keyframe in &mut scene.problem.keyframes[..2] {
        keyframe.freedom = PoseFreedom::Fixed;
    }
    let covariance = |of: CovarianceOf| {
        let config = BundleConfig {
            covariance: of,
            ..BundleConfig::default()
        };
        adjust(&scene.problem, &config).unwrap().covariance
    };
    assert_eq!(covariance(CovarianceOf::Nothing), None);
    let poses = covariance(CovarianceOf::Poses).unwrap();
    let all = covariance(CovarianceOf::PosesAndPoints).unwrap();
    assert_eq!(poses.poses, all.poses);
    assert!(poses.inverse_depth_variances.is_empty());
    assert_eq!(
        all.inverse_depth_variances.len(),
        scene.problem.points.len()
    );
}

#[test]
fn open_gauge_has_no_covariance_but_still_converges() {
    let mut scene = scene(&options());
    scene.problem.keyframes[0].freedom = PoseFreedom::Fixed; // scale is open
    let config = BundleConfig {
        covariance: CovarianceOf::PosesAndPoints,
        ..BundleConfig::default()
    };
    let solution = adjust(&scene.problem, &config).unwrap();
    assert!(solution.covariance.is_none());
    assert!(solution.final_cost < solution.initial_cost);
    let length = |poses: &[Se3]| poses[9].inverse().translation.norm();
    let ratio = length(&solution.camera_from_world) / length(&scene.true_poses);
    assert!((ratio - 1.0).abs() < 0.02, "scale drifted by {ratio}");
}

#[test]
fn bad_starts_never_raise_the_cost() {
    // So far off that many points start behind cameras and the linear model lies.
    for seed in 0..10 {
        let mut scene = fixed_scene(&SceneOptions { seed, ..options() });
        disturb(&mut scene.problem, 1.0, 1.0, seed);
        let config = BundleConfig {
            rejection_rounds: 0,
            ..BundleConfig::default()
        };
        let solution = adjust(&scene.problem, &config).unwrap();
        assert!(solution.final_cost <= solution.initial_cost);
        assert!(solution.camera_from_world.iter().all(Se3::is_finite));
        assert!(solution.inverse_depths.iter().all(|d| *d > 0.0));
    }
}

#[test]
fn empty_and_hopeless_problems_come_back_unchanged() {
    let mut scene = fixed_scene(&options());
    scene.problem.observations.clear();
    let solution = adjust(&scene.problem, &BundleConfig::default()).unwrap();
    assert_eq!(solution.outcome, BundleOutcome::NothingToDo);
    assert_eq!(solution.camera_from_world, scene.true_poses);
    // Observations by the host carry nothing.
    let mut anchors = fixed_scene(&options());
    let hosts: Vec<_> = anchors.problem.points.iter().map(|p| p.host).collect();
    for o in &mut anchors.problem.observations {
        o.keyframe = hosts[o.point];
    }
    let solution = adjust(&anchors.problem, &BundleConfig::default()).unwrap();
    assert!(
        solution
            .observations
            .iter()
            .all(|o| *o == ObservationOutcome::Anchor)
    );
    assert_eq!(solution.camera_from_world, anchors.true_poses);
}

#[test]
fn bad_input_is_named() {
    let good = fixed_scene(&options()).problem;
    let config = BundleConfig::default();
    let mut bad = good.clone();
    bad.observations[3].keyframe = 99;
    let error = adjust(&bad, &config).unwrap_err();
    assert!(matches!(
        error,
        BundleError::Index {
            index: 99,
            len: 10,
            ..
        }
    ));
    assert!(error.to_string().contains("observation 3"), "{error}");
    let mut bad = good.clone();
    bad.points[4].inverse_depth = -1.0;
    assert!(
        adjust(&bad, &config)
            .unwrap_err()
            .to_string()
            .contains("point 4")
    );
    let mut bad = good.clone();
    bad.keyframes[4].freedom = PoseFreedom::FixedDistance { to: 5 };
    assert_eq!(
        adjust(&bad, &config),
        Err(BundleError::Distance { keyframe: 4, to: 5 })
    );
    let mut bad = good;
    bad.keyframes[2].camera_from_world.translation.x = f64::NAN;
    assert!(
        adjust(&bad, &config)
            .unwrap_err()
            .to_string()
            .contains("keyframe 2")
    );
}

/// Images in which each point lies on an edge: they say where it is across one direction, and
/// nothing beyond three pixels.
#[derive(Debug)]
struct Edges {
    /// Per observation a place on the edge and a direction across it, 1 / standard deviations.
    edges: Vec<(Vec2, Vec2)>,
}

impl Edges {
    /// Edges through where the points of a scene truly are.
    fn of(scene: &Scene) -> Self {
        let edge = |(i, o): (usize, &Observation)| {
            let anchor = &scene.problem.points[o.point];
            let in_host = PINHOLE.unproject(&anchor.pixel) / scene.true_inverse_depths[o.point];
            let in_world = scene.true_poses[anchor.host].inverse() * in_host;
            let angle = 0.9 * i as f64;
            let across = 10.0 * Vec2::new(angle.cos(), angle.sin());
            (
                PINHOLE.project(&(scene.true_poses[o.keyframe] * in_world)),
                across,
            )
        };
        let observations = scene.problem.observations.iter().enumerate();
        Self {
            edges: observations.map(edge).collect(),
        }
    }

    fn distance(&self, observation: usize, pixel: &Vec2) -> f64 {
        let (place, across) = &self.edges[observation];
        across.dot(&(pixel - place))
    }
}

impl Appearance for Edges {
    fn cost(&self, observation: usize, pixel: &Vec2) -> f64 {
        0.5 * self.distance(observation, pixel).powi(2).min(900.0)
    }

    fn slope(&self, observation: usize, pixel: &Vec2) -> Option<PixelSlope> {
        let distance = self.distance(observation, pixel);
        let across = self.edges[observation].1;
        (distance.abs() < 30.0).then(|| PixelSlope {
            gradient: across * distance,
            information: across * across.transpose(),
        })
    }
}

#[test]
fn images_say_more_than_the_places_at_which_points_were_found() {
    let mut scene = fixed_scene(&options());
    let edges = Edges::of(&scene);
    disturb(&mut scene.problem, 0.003, 0.01, 7);
    let config = BundleConfig {
        max_iterations: 50,
        ..BundleConfig::default()
    };
    let by_places = adjust(&scene.problem, &config).unwrap();
    let by_images = adjust_to_images(&scene.problem, &edges, &config).unwrap();
    let error = |solution: &BundleSolution| {
        worst_centre_error(&solution.camera_from_world, &scene.true_poses)
    };
    let (places, images) = (error(&by_places), error(&by_images));
    // ten times as sure, half as often
    assert!(images < 0.2 * places, "{images} of {places}");
    assert!(by_images.final_cost < by_images.initial_cost);
}

#[test]
fn images_that_say_nothing_change_nothing() {
    #[derive(Debug)]
    struct Blind;
    impl Appearance for Blind {
        fn cost(&self, _: usize, _: &Vec2) -> f64 {
            0.0
        }
        fn slope(&self, _: usize, _: &Vec2) -> Option<PixelSlope> {
            None
        }
    }
    let mut scene = fixed_scene(&options());
    disturb(&mut scene.problem, 0.03, 0.1, 7);
    let config = BundleConfig::default();
    assert_eq!(
        adjust_to_images(&scene.problem, &Blind, &config).unwrap(),
        adjust(&scene.problem, &config).unwrap()
    );
}
