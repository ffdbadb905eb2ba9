//! Random pose graphs with known truth.

use super::Random;
use monogrid_geometry::{Mat7, Rotation, Sim3, Vec3, Vec7, rotation_exp};
use monogrid_graph::RobustKernel;
use monogrid_graph::pose_graph::{GraphEdge, GraphNode, PoseGraph};

/// Where wrong measurements may be.
#[derive(Clone, Copy, PartialEq)]
pub enum Wrong {
    /// Only between keyframes that do not follow each other; odometry is right, but drifts.
    Closures,
    /// Anywhere.
    Anywhere,
}

/// How a graph is made.
#[derive(Clone, Copy)]
pub struct GraphOptions {
    pub nodes: usize,
    /// Edges to near predecessors, beside the one to the direct predecessor.
    pub near: usize,
    /// Closures between any two keyframes, per keyframe.
    pub closures: f64,
    pub wrong_share: f64,
    pub wrong: Wrong,
    pub seed: u64,
}

/// Standard deviations of a measurement: translation in keyframe units, rotation, log-scale.
const SIGMAS: [f64; 7] = [0.01, 0.01, 0.01, 0.003, 0.003, 0.003, 0.005];

pub struct RandomGraph {
    pub graph: PoseGraph,
    pub truth: Vec<Sim3>,
    /// Per edge whether it is wrong.
    pub is_wrong: Vec<bool>,
    /// Extent of the true path.
    pub extent: f64,
}

/// A wandering camera whose keyframes have different scales, noisy measurements with true
/// information matrices, and starting poses that chain the measured odometry.
pub fn random_graph(options: &GraphOptions) -> RandomGraph {
    let mut random = Random(options.seed);
    let truth = wander(&mut random, options.nodes);
    let mut pairs: Vec<(usize, usize)> = vec![];
    for j in 1..options.nodes {
        for step in 1..=(1 + options.near).min(j) {
            pairs.push((j - step, j));
        }
    }
    for _ in 0..(options.closures * options.nodes as f64) as usize {
        let (a, b) = (random.below(options.nodes), random.below(options.nodes));
        if a.abs_diff(b) > 1 + options.near {
            pairs.push((a.min(b), a.max(b)));
        }
    }
    let (mut graph, mut is_wrong) = (PoseGraph::new(), vec![]);
    let information = Mat7::from_diagonal(&Vec7::from(SIGMAS).map(|s| 1.0 / (s * s)));
    let mut estimate = vec![truth[0]];
    let mut edges = vec![];
    for &(i, j) in &pairs {
        let noise = Vec7::from_fn(|k, _| random.normal() * SIGMAS[k]);
        let mut i_from_j = Sim3::exp(&noise) * truth[i].inverse() * truth[j];
        let may_be_wrong = options.wrong == Wrong::Anywhere || j > i + 1;
        let wrong = may_be_wrong && random.uniform() < options.wrong_share;
        if wrong {
            let w = Vec3::new(random.signed(), random.signed(), random.signed());
            let v = random.normal3() * 2.0;
            i_from_j = Sim3::new((0.7 * random.signed()).exp(), rotation_exp(&w), v) * i_from_j;
        }
        is_wrong.push(wrong);
        if j == i + 1 {
            // Pairs are ordered so that the direct predecessor's comes first.
            estimate.push(estimate[i] * i_from_j);
        }
        edges.push(GraphEdge {
            i: i as u64,
            j: j as u64,
            i_from_j,
            information,
            kernel: RobustKernel::DynamicCovariance { phi: 20.0 },
        });
    }
    for (id, pose) in estimate.into_iter().enumerate() {
        let node = GraphNode {
            id: id as u64,
            world_from_keyframe: pose,
            is_fixed: false,
        };
        graph.add_node(node).unwrap();
    }
    for edge in edges {
        graph.add_edge(edge).unwrap();
    }
    let mean = truth.iter().map(|t| t.translation).sum::<Vec3>() / truth.len() as f64;
    let distance = |t: &Sim3| (t.translation - mean).norm();
    let extent = 2.0 * truth.iter().map(distance).fold(0.0, f64::max);
    RandomGraph {
        graph,
        truth,
        is_wrong,
        extent,
    }
}

/// A path that turns, and keyframes whose unit is between half and twice the world's.
fn wander(random: &mut Random, nodes: usize) -> Vec<Sim3> {
    let mut poses = vec![Sim3::new(1.0, Rotation::identity(), Vec3::zeros())];
    let mut heading = Vec3::zeros();
    for _ in 1..nodes {
        heading = heading * 0.8 + random.normal3() * 0.1;
        let last = poses[poses.len() - 1];
        let step = Vec3::new(0.1, 0.0, 0.5) + random.normal3() * 0.1;
        let rotation = last.rotation * rotation_exp(&heading);
        let scale = (last.scale * (0.1 * random.normal()).exp()).clamp(0.5, 2.0);
        let translation = last.translation + last.rotation * step;
        poses.push(Sim3::new(scale, rotation, translation));
    }
    poses
}

impl RandomGraph {
    /// Largest error of a position, as a share of the path's extent, and of a scale.
    pub fn worst_errors(&self) -> (f64, f64) {
        let (mut position, mut scale) = (0.0_f64, 0.0_f64);
        for (node, truth) in self.graph.nodes().iter().zip(&self.truth) {
            let pose = node.world_from_keyframe;
            let error = (pose.translation - truth.translation).norm();
            position = position.max(error / self.extent);
            scale = scale.max((pose.scale / truth.scale).ln().abs());
        }
        (position, scale)
    }

    /// Root mean square error of the positions, as a share of the path's extent.
    pub fn rms_error(&self) -> f64 {
        let pairs = self.graph.nodes().iter().zip(&self.truth);
        let sum: f64 = pairs
            .map(|(n, t)| (n.world_from_keyframe.translation - t.translation).norm_squared())
            .sum();
        (sum / self.truth.len() as f64).sqrt() / self.extent
    }
}
