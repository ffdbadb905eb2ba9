//! Which direction is up: the posterior probability of every direction, given planes, straight
//! edges, and how the camera was held and moved.

use super::Upright;
use super::evidence::Evidence;
use monogrid_geometry::nalgebra::{Matrix4, SymmetricEigen};
use monogrid_geometry::{Mat3, Rotation, Se3, Vec3, rotation_log};

/// Directions that are tried first, over the whole sphere: 2.6 degrees apart.
const NUM_DIRECTIONS: usize = 6000;
/// Angle within which a vote counts, from the first search to the last adjustment, degrees.
const REACH_DEG: [f64; 8] = [4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.5, 1.5];
/// Log-likelihood of up where all votes are for it, and of that share of them. This and the next
/// are fitted, by maximum likelihood, to rendered recordings held level and askew (decision 028).
const VOTES_LOG_LIKELIHOOD: f64 = 20.0;
/// Power of the share of the votes that come from level planes: something level is nearly always
/// seen.
const LEVEL_POWER: f64 = 2.0;
/// What that share is at least: planes are missed.
const MIN_LEVEL_SHARE: f64 = 0.02;
/// Standard deviation of the roll of a hand-held camera, mean over a run, degrees.
const ROLL_SIGMA_DEG: f64 = 20.0;
/// Mean pitch of a hand-held camera, degrees: people look down rather than up.
const PITCH_DEG: f64 = -15.0;
/// Its standard deviation, degrees.
const PITCH_SIGMA_DEG: f64 = 35.0;
/// Share of the cameras that are held in any way.
const HELD_ANYHOW: f64 = 0.003;
/// Standard deviations of the share of the path that is vertical, and of the share of the turning
/// that is not about the vertical (root mean squares). Cameras in hands and on drones have 0.33
/// (TUM RGB-D, EuRoC; windows of 8 s).
const MOTION_SIGMA: f64 = 0.3;
/// Turning less than this says nothing: hands tremble about any axis, degrees.
const TREMOR_DEG: f64 = 3.0;
/// Directions closer than this are the same one, degrees.
const SAME_DEG: f64 = 10.0;

/// The most probable direction, without a floor: searches the sphere, then adjusts the best one.
/// The confidence is the probability of all directions that are the same.
pub(super) fn vote(evidence: &Evidence) -> Option<Upright> {
    if evidence.path.is_empty() || evidence.patches.is_empty() && evidence.edges.is_empty() {
        return None;
    }
    let motion = Motion::of(&evidence.path)?;
    let log_probability = |up: Vec3| {
        let votes = Votes::of(evidence, &up);
        (
            votes.log_likelihood() + held(&evidence.path, &up) + motion.log_likelihood(&up),
            up,
        )
    };
    let scored: Vec<(f64, Vec3)> = sphere(NUM_DIRECTIONS).map(log_probability).collect();
    // of equal ones the first
    let (best, first) = scored
        .iter()
        .copied()
        .reduce(|a, b| if b.0 > a.0 { b } else { a })?;
    let is_same = |up: &Vec3| up.dot(&first) > SAME_DEG.to_radians().cos();
    let (mut same, mut all) = (0.0, 0.0);
    for (score, up) in &scored {
        let probability = (score - best).exp();
        all += probability;
        same += if is_same(up) { probability } else { 0.0 };
    }
    let mut up = first;
    for reach_deg in REACH_DEG {
        up = adjusted(evidence, &up, reach_deg.to_radians().sin())?;
    }
    Some(Upright {
        up_in_world: if is_same(&up) { up } else { first },
        confidence: same / all,
        floor: None,
    })
}

/// Directions spread evenly over the sphere (Fibonacci's lattice).
fn sphere(count: usize) -> impl Iterator<Item = Vec3> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count).map(move |k| {
        let z = 1.0 - (2 * k + 1) as f64 / count as f64;
        let (sin, cos) = (golden_angle * k as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        Vec3::new(radius * cos, radius * sin, z)
    })
}

/// How far a vote reaches: 1 at no angle, 0 from the sine of `reach` on.
fn kernel(sine: f64, reach: f64) -> f64 {
    let ratio = sine / reach;
    (1.0 - ratio * ratio).max(0.0).powi(2)
}

/// Shares of the votes that are for a direction, per keyframe.
#[derive(Clone, Copy, Debug, Default)]
struct Votes {
    /// Of level planes.
    level: f64,
    /// Of upright planes and edges, less those that a random direction gets.
    upright: f64,
}

impl Votes {
    fn of(evidence: &Evidence, up: &Vec3) -> Self {
        let reach = REACH_DEG[0].to_radians().sin();
        // the mean of the kernel over a random great circle; over a random plane's normal it is
        // negligible
        let by_chance = 8.0 / 15.0 * reach;
        let mut votes = Self::default();
        for patch in &evidence.patches {
            let normal = &patch.normal_in_world;
            votes.level += patch.weight * kernel(normal.cross(up).norm(), reach);
            votes.upright += patch.weight * (kernel(normal.dot(up), reach) - by_chance);
        }
        for edge in &evidence.edges {
            votes.upright +=
                edge.weight * (kernel(edge.normal_in_world.dot(up), reach) - by_chance);
        }
        // all planes of a keyframe weigh 1, and so do its edges
        let total = (2 * evidence.poses.len()) as f64;
        Self {
            level: votes.level / total,
            upright: votes.upright / total,
        }
    }

    fn log_likelihood(&self) -> f64 {
        VOTES_LOG_LIKELIHOOD * (self.level + self.upright)
            + LEVEL_POWER * (MIN_LEVEL_SHARE + self.level).ln()
    }
}

/// Logarithm of how likely a camera is held so, over all frames: seldom rolled, not much pitched,
/// rarely upside down.
fn held(world_from_camera: &[Se3], up: &Vec3) -> f64 {
    let (mut roll, mut pitch, mut above) = (0.0, 0.0, 0.0);
    for pose in world_from_camera {
        let [right, down, ahead] = [Vec3::x(), Vec3::y(), Vec3::z()].map(|axis| {
            let axis: Vec3 = pose.rotation * axis;
            axis.dot(up).clamp(-1.0, 1.0)
        });
        roll += right.asin().abs();
        pitch += (ahead.asin() - PITCH_DEG.to_radians()).abs();
        // who looks at the ground has up ahead of the image's upper edge
        above -= down + 0.3 * ahead;
    }
    let in_sigmas = |angle: f64, sigma_deg: f64| {
        angle / world_from_camera.len() as f64 / sigma_deg.to_radians()
    };
    let roll = in_sigmas(roll, ROLL_SIGMA_DEG);
    let pitch = in_sigmas(pitch, PITCH_SIGMA_DEG);
    let as_usual = if above > 0.0 {
        (-0.5 * (roll * roll + pitch * pitch)).exp()
    } else {
        0.0
    };
    ((1.0 - HELD_ANYHOW) * as_usual + HELD_ANYHOW).ln()
}

/// How the camera moved: people, robots and cars go over the ground, and turn about the vertical.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Covariance of the places of the camera, of trace 1; 0 where it has one place.
    places: Mat3,
    /// Second moment of the rotation vectors from their mean orientation, of trace 1.
    turns: Mat3,
}

impl Motion {
    fn of(world_from_camera: &[Se3]) -> Option<Self> {
        let n = world_from_camera.len() as f64;
        let place = |pose: &Se3| pose.translation;
        let mean_place = world_from_camera.iter().map(place).sum::<Vec3>() / n;
        let moment = |vectors: &mut dyn Iterator<Item = Vec3>| {
            vectors.map(|v| v * v.transpose()).sum::<Mat3>() / n
        };
        let mut offsets = world_from_camera
            .iter()
            .map(|pose| pose.translation - mean_place);
        let places = moment(&mut offsets);
        let mean = mean_orientation(world_from_camera)?;
        let mut turns = world_from_camera
            .iter()
            .map(|pose| rotation_log(&(pose.rotation * mean.inverse())));
        let tremor = Mat3::identity() * (TREMOR_DEG.to_radians().powi(2) / 3.0);
        let turns = moment(&mut turns) + tremor;
        Some(Self {
            places: places / places.trace().max(f64::MIN_POSITIVE),
            turns: turns / turns.trace(),
        })
    }

    fn log_likelihood(&self, up: &Vec3) -> f64 {
        let vertical = up.dot(&(self.places * up));
        let about_others = 1.0 - up.dot(&(self.turns * up));
        -0.5 * (vertical + about_others) / (MOTION_SIGMA * MOTION_SIGMA)
    }
}

/// The mean of orientations: the eigenvector of the largest eigenvalue of the sum of `q q^T` over
/// their quaternions `[MARKLEY07]`.
fn mean_orientation(poses: &[Se3]) -> Option<Rotation> {
    let outer = |pose: &Se3| pose.rotation.coords * pose.rotation.coords.transpose();
    let sum: Matrix4<f64> = poses.iter().map(outer).sum();
    let eigen = SymmetricEigen::try_new(sum, f64::EPSILON, 100)?;
    let largest = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    Some(Rotation::new_normalize(largest.into_owned().into()))
}

/// The direction that the votes within reach agree on: least squares with the weights of the
/// kernel, that is the eigenvector of the smallest eigenvalue of the sum of `n n^T` over upright
/// planes and edges less that over level planes.
fn adjusted(evidence: &Evidence, up: &Vec3, reach: f64) -> Option<Vec3> {
    let mut sum = Mat3::zeros();
    for patch in &evidence.patches {
        let normal = &patch.normal_in_world;
        let level = kernel(normal.cross(up).norm(), reach);
        let upright = kernel(normal.dot(up), reach);
        sum += normal * normal.transpose() * (patch.weight * (upright - level));
    }
    for edge in &evidence.edges {
        let normal = &edge.normal_in_world;
        sum += normal * normal.transpose() * (edge.weight * kernel(normal.dot(up), reach));
    }
    let eigen = SymmetricEigen::try_new(sum, f64::EPSILON, 100)?;
    let smallest = eigen.eigenvalues.imin();
    let axis: Vec3 = eigen.eigenvectors.column(smallest).into();
    let axis = axis.normalize();
    Some(if axis.dot(up) < 0.0 { -axis } else { axis })
}
