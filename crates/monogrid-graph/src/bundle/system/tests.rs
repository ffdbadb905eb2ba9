use crate::RobustKernel;
use crate::bundle::linear::{State, Window};
use crate::bundle::prepare::Layout;
use crate::bundle::schur::{back_substitute, solve_step};
use crate::bundle::shares::Shares;
use crate::bundle::system::reduce;
use crate::bundle::{
    AnchoredPoint, BundleConfig, BundleKeyframe, BundleProblem, InverseDepthPrior, Observation,
    PoseFreedom, adjust,
};
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3, Vec6};

/// A camera that moves sideways past a wall; each point is seen by its host and the four keyframes
/// after it. The first pose is fixed, the distance of the last to it held, and what was seen is a
/// little off.
fn chain(num_keyframes: usize) -> BundleProblem {
    let pinhole = Pinhole::new(300.0, 300.0, 160.0, 120.0);
    let pose = |k: usize| Se3::exp(&Vec6::new(-0.2 * k as f64, 0.0, 0.0, 0.0, 0.01, 0.0));
    let noise = |k: usize| 0.5 * (k as f64 * 12.9898).sin();
    let mut problem = BundleProblem {
        pinhole,
        keyframes: (0..num_keyframes)
            .map(|k| BundleKeyframe {
                camera_from_world: pose(k),
                freedom: PoseFreedom::Free,
            })
            .collect(),
        points: Vec::new(),
        observations: Vec::new(),
    };
    problem.keyframes[0].freedom = PoseFreedom::Fixed;
    problem.keyframes[num_keyframes - 1].freedom = PoseFreedom::FixedDistance { to: 0 };
    for host in 0..num_keyframes - 4 {
        for k in 0..12 {
            let pixel = Vec2::new(60.0 + 15.0 * f64::from(k), 20.0 + 70.0 * f64::from(k % 4));
            let inverse_depth = 1.0 / (2.0 + 0.3 * f64::from(k % 5));
            let in_world = pose(host).inverse() * (pinhole.unproject(&pixel) / inverse_depth);
            let point = problem.points.len();
            problem.points.push(AnchoredPoint {
                host,
                pixel,
                inverse_depth: inverse_depth * (1.0 + 0.02 * noise(7 * point)),
                prior: None,
            });
            for keyframe in host + 1..host + 5 {
                let n = problem.observations.len();
                let seen: Vec3 = pose(keyframe) * in_world;
                problem.observations.push(Observation {
                    keyframe,
                    point,
                    pixel: pinhole.project(&seen) + Vec2::new(noise(n), noise(n + 1)),
                    inv_sigma_px: 1.0,
                });
            }
        }
    }
    problem
}

/// Poses and inverse depths as the problem gives them.
fn start_of(problem: &BundleProblem) -> State {
    State {
        camera_from_world: (problem.keyframes.iter())
            .map(|k| k.camera_from_world)
            .collect(),
        inverse_depths: problem.points.iter().map(|p| p.inverse_depth).collect(),
    }
}

#[test]
fn a_step_is_that_of_the_dense_system() {
    let problem = chain(90);
    let config = BundleConfig::default();
    let state = start_of(&problem);
    let layout = Layout::new(&problem);
    let window = Window::new(&problem, &layout, None, &config);
    let normal = window.linearise(&state);
    let step = solve_step(&window, &normal, &state, 1e-3).unwrap();
    let (s, b) = reduce(&window, &normal, &state, 1e-3);
    let poses = layout.pattern.dense(&s).cholesky().unwrap().solve(&b);
    let dense = back_substitute(&window, &normal, 1e-3, poses);
    let size = dense.poses.norm();
    assert!(size > 1e-3, "{size}");
    assert!((&step.poses - &dense.poses).norm() < 1e-9 * size);
    for (a, b) in step.inverse_depths.iter().zip(&dense.inverse_depths) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
    assert!((step.predicted / dense.predicted - 1.0).abs() < 1e-9);
}

#[test]
fn shares_add_up_to_the_whole() {
    let problem = chain(90);
    let state = start_of(&problem);
    let config = BundleConfig::default();
    let system = |shares: usize| {
        let mut layout = Layout::new(&problem);
        layout.shares = Shares::so_many(&problem, shares);
        let window = Window::new(&problem, &layout, None, &config);
        let normal = window.linearise(&state);
        let (s, b) = reduce(&window, &normal, &state, 1e-3);
        let cost = window.cost(&state, &window.active);
        (layout.pattern.dense(&s), b, normal.b_points, cost)
    };
    let (s, b, b_points, cost) = system(1);
    for shares in [2, 4, 9] {
        let found = system(shares);
        assert!((&found.0 - &s).amax() < 1e-12 * s.amax());
        assert!((&found.1 - &b).amax() < 1e-12 * b.amax());
        assert_eq!(found.2, b_points, "a point belongs to one share");
        assert!((found.3 / cost - 1.0).abs() < 1e-12);
    }
}

#[test]
fn a_long_run_is_adjusted_with_its_length_held() {
    let problem = chain(90);
    let solution = adjust(&problem, &BundleConfig::default()).unwrap();
    assert!(solution.final_cost < 0.9 * solution.initial_cost);
    let length = |poses: &dyn Fn(usize) -> Se3| {
        (poses(89).inverse().translation - poses(0).inverse().translation).norm()
    };
    let before = length(&|k| problem.keyframes[k].camera_from_world);
    let after = length(&|k| solution.camera_from_world[k]);
    assert!((before - after).abs() < 1e-9 * before);
}

#[test]
fn the_slope_of_a_measured_depth_is_that_of_the_cost() {
    let mut problem = chain(10);
    // of one measurement, one that is wrong by ten standard deviations, and none
    for (point, off) in [(3, 0.5), (4, -10.0)] {
        let at = &mut problem.points[point];
        at.prior = Some(InverseDepthPrior {
            mean: at.inverse_depth + off * 0.01,
            sigma: 0.01,
            kernel: RobustKernel::Huber { delta: 2.0 },
        });
    }
    let config = BundleConfig::default();
    let mut state = start_of(&problem);
    let layout = Layout::new(&problem);
    let window = Window::new(&problem, &layout, None, &config);
    let normal = window.linearise(&state);
    let without = chain(10);
    let bare = Window::new(&without, &layout, None, &config).linearise(&state);
    for point in [3, 4, 5] {
        let mut cost_at = |step: f64| {
            let before = state.inverse_depths[point];
            state.inverse_depths[point] = before + step;
            let cost = window.cost(&state, &window.active);
            state.inverse_depths[point] = before;
            cost
        };
        let numeric = (cost_at(1e-6) - cost_at(-1e-6)) / 2e-6;
        let slope = -normal.b_points[point];
        assert!(
            (slope - numeric).abs() < 1e-4 * numeric.abs(),
            "{slope} {numeric}"
        );
    }
    let pull = |point: usize| normal.b_points[point] - bare.b_points[point];
    assert!((pull(3) - 50.0).abs() < 1e-9, "half a sigma");
    assert!((pull(4) + 200.0).abs() < 1e-9, "no more than two sigmas");
    assert_eq!(pull(5), 0.0);
}
