//! What images say about the place of a point, beside the pixel at which it was found in them.

use monogrid_geometry::Vec2;
use nalgebra::Matrix2;

/// How observations look where their points are projected; who knows images implements it.
///
/// Both functions take the index of an observation in [`super::BundleProblem::observations`] and
/// the pixel to which its point is projected, and must agree: a step is taken by the derivatives
/// and kept when the cost falls. Threads call them at the same time.
pub trait Appearance: std::fmt::Debug + Sync {
    /// What it costs that the point of an observation is at a pixel, as half a squared error in
    /// standard deviations; 0 where nothing is known of it.
    fn cost(&self, observation: usize, pixel: &Vec2) -> f64;

    /// Its derivatives by the pixel; `None` where it does not change.
    fn slope(&self, observation: usize, pixel: &Vec2) -> Option<PixelSlope>;
}

/// Derivatives of a cost by a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelSlope {
    /// First.
    pub gradient: Vec2,
    /// Second, positive semi-definite.
    pub information: Matrix2<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::linear::{Normal, State, Window};
    use crate::bundle::prepare::Layout;
    use crate::bundle::{
        AnchoredPoint, BundleConfig, BundleKeyframe, BundleProblem, Observation, PoseFreedom,
    };
    use monogrid_geometry::{Pinhole, Se3, Vec6};

    /// Edges: each observation says where its point is across one direction only, the more softly
    /// the farther.
    #[derive(Debug)]
    struct Edges(Vec<(Vec2, Vec2)>);

    impl Edges {
        fn distance(&self, observation: usize, pixel: &Vec2) -> f64 {
            let (place, across) = &self.0[observation];
            across.dot(&(pixel - place))
        }
    }

    impl Appearance for Edges {
        fn cost(&self, observation: usize, pixel: &Vec2) -> f64 {
            0.5 * (1.0 + self.distance(observation, pixel).powi(2)).ln()
        }

        fn slope(&self, observation: usize, pixel: &Vec2) -> Option<PixelSlope> {
            let (distance, across) = (self.distance(observation, pixel), self.0[observation].1);
            let weight = 1.0 / (1.0 + distance * distance);
            Some(PixelSlope {
                gradient: across * (weight * distance),
                information: across * across.transpose() * weight,
            })
        }
    }

    /// Two keyframes that see the points of each other, away from their minimum.
    fn problem() -> BundleProblem {
        let pinhole = Pinhole::new(300.0, 310.0, 160.0, 120.0);
        let twist = |k: f64| Vec6::new(-0.2 * k, 0.05 * k, 0.03, 0.01, 0.06 * k, -0.02);
        let keyframes: Vec<BundleKeyframe> = [0.0, 1.0, 2.0]
            .into_iter()
            .map(|k| BundleKeyframe {
                camera_from_world: Se3::exp(&twist(k)),
                freedom: PoseFreedom::Free,
            })
            .collect();
        let points: Vec<AnchoredPoint> = (0..12)
            .map(|i| AnchoredPoint {
                host: i % 2,
                pixel: Vec2::new(60.0 + 17.0 * i as f64, 40.0 + 13.0 * (i * 5 % 12) as f64),
                inverse_depth: 0.2 + 0.03 * i as f64,
                prior: None,
            })
            .collect();
        let mut observations = Vec::new();
        for (point, anchor) in points.iter().enumerate() {
            for keyframe in (0..3).filter(|k| *k != anchor.host) {
                let pose = |k: usize| keyframes[k].camera_from_world;
                let in_host = pinhole.unproject(&anchor.pixel) / anchor.inverse_depth;
                let seen = pose(keyframe) * (pose(anchor.host).inverse() * in_host);
                let n = observations.len() as f64;
                observations.push(Observation {
                    keyframe,
                    point,
                    pixel: pinhole.project(&seen) + Vec2::new(n.sin(), (2.0 * n).cos()),
                    inv_sigma_px: 0.7,
                });
            }
        }
        BundleProblem {
            pinhole,
            keyframes,
            points,
            observations,
        }
    }

    fn edges(problem: &BundleProblem) -> Edges {
        let edge = |(i, o): (usize, &Observation)| {
            let angle = 1.3 * i as f64;
            let place = o.pixel + Vec2::new(0.6 * angle.cos(), 0.8 * angle.sin());
            (place, 2.0 * Vec2::new(angle.sin(), angle.cos()))
        };
        Edges(problem.observations.iter().enumerate().map(edge).collect())
    }

    fn state(problem: &BundleProblem) -> State {
        State {
            camera_from_world: (problem.keyframes.iter())
                .map(|k| k.camera_from_world)
                .collect(),
            inverse_depths: problem.points.iter().map(|p| p.inverse_depth).collect(),
        }
    }

    /// Where the point of an observation is projected to.
    fn pixel(problem: &BundleProblem, i: usize, state: &State) -> Vec2 {
        let observation = &problem.observations[i];
        let anchor = &problem.points[observation.point];
        let in_host =
            problem.pinhole.unproject(&anchor.pixel) / state.inverse_depths[observation.point];
        let in_world = state.camera_from_world[anchor.host].inverse() * in_host;
        let seen = state.camera_from_world[observation.keyframe] * in_world;
        problem.pinhole.project(&seen)
    }

    #[test]
    fn the_normal_equations_hold_the_gradient_of_the_cost() {
        let problem = problem();
        let edges = edges(&problem);
        let layout = Layout::new(&problem);
        let config = BundleConfig {
            kernel: crate::RobustKernel::None,
            ..BundleConfig::default()
        };
        let state = state(&problem);
        for appearance in [None, Some(&edges as &dyn Appearance)] {
            let window = Window::new(&problem, &layout, appearance, &config);
            let cost = |state: &State| window.cost(state, &window.active);
            let normal: Normal = window.linearise(&state);
            let step = 1e-6;
            for slot in 0..3 {
                for i in 0..6 {
                    let moved = |by: f64| {
                        let mut delta = Vec6::zeros();
                        delta[i] = by;
                        let mut moved = state.clone();
                        moved.camera_from_world[slot] =
                            Se3::exp(&delta) * moved.camera_from_world[slot];
                        cost(&moved)
                    };
                    let numeric = (moved(step) - moved(-step)) / (2.0 * step);
                    let found = -normal.b_poses[6 * slot + i];
                    assert!(
                        (found - numeric).abs() < 1e-4 * (1.0 + numeric.abs()),
                        "pose {slot} {i}: {found} {numeric}"
                    );
                }
            }
            for point in 0..problem.points.len() {
                let moved = |by: f64| {
                    let mut moved = state.clone();
                    moved.inverse_depths[point] += by;
                    cost(&moved)
                };
                let numeric = (moved(step) - moved(-step)) / (2.0 * step);
                let found = -normal.b_points[point];
                assert!(
                    (found - numeric).abs() < 1e-4 * (1.0 + numeric.abs()),
                    "point {point}: {found} {numeric}"
                );
            }
        }
    }

    #[test]
    fn second_derivatives_grow_by_those_of_the_images() {
        let problem = problem();
        let edges = edges(&problem);
        let layout = Layout::new(&problem);
        let config = BundleConfig::default();
        let state = state(&problem);
        let normal =
            |appearance| Window::new(&problem, &layout, appearance, &config).linearise(&state);
        let (without, with) = (normal(None), normal(Some(&edges as &dyn Appearance)));
        let step = 1e-6;
        for point in 0..problem.points.len() {
            let mut sums = [0.0; 2];
            for (i, observation) in problem.observations.iter().enumerate() {
                if observation.point != point {
                    continue;
                }
                let by_depth = |by: f64| {
                    let mut moved = state.clone();
                    moved.inverse_depths[point] += by;
                    pixel(&problem, i, &moved)
                };
                let by_turn = |by: f64| {
                    let mut moved = state.clone();
                    let turn = Se3::exp(&Vec6::new(0.0, 0.0, 0.0, 0.0, by, 0.0));
                    moved.camera_from_world[2] = turn * moved.camera_from_world[2];
                    pixel(&problem, i, &moved)
                };
                let j_depth = (by_depth(step) - by_depth(-step)) / (2.0 * step);
                let j_turn = (by_turn(step) - by_turn(-step)) / (2.0 * step);
                let slope = edges.slope(i, &pixel(&problem, i, &state));
                let information = slope.map_or(Matrix2::zeros(), |slope| slope.information);
                sums[0] += j_depth.dot(&(information * j_depth));
                sums[1] += j_turn.dot(&(information * j_depth));
            }
            let depth = with.h_points[point] - without.h_points[point];
            assert!(
                (depth - sums[0]).abs() < 1e-4 * sums[0],
                "{depth} {}",
                sums[0]
            );
            let mixed = |normal: &Normal| {
                let mut entries = layout.fans.of(point);
                let entry = entries.find(|entry| layout.fans.slot(*entry) == 2);
                normal.fans[entry.unwrap_or(usize::MAX)][4]
            };
            let mixed = mixed(&with) - mixed(&without);
            assert!(
                (mixed - sums[1]).abs() < 1e-4 * (1.0 + sums[1].abs()),
                "{mixed} {}",
                sums[1]
            );
        }
    }
}
