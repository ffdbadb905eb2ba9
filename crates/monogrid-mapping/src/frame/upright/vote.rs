//! Which direction is up: planes and straight edges vote, the way in which the camera was held
//! decides among what they leave.

use super::Upright;
use super::evidence::Evidence;
use monogrid_geometry::nalgebra::SymmetricEigen;
use monogrid_geometry::{Mat3, Vec3};

/// Directions that are tried first, over the whole sphere: 2.6 degrees apart.
const NUM_DIRECTIONS: usize = 6000;
/// Angle within which a vote counts, from the first search to the last adjustment, degrees.
const REACH_DEG: [f64; 8] = [4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.5, 1.5];
/// Share of all votes, over those expected by chance, that is enough.
const ENOUGH_SUPPORT: f64 = 0.1;
/// Standard deviation of the roll of a hand-held camera, mean over a run, degrees.
const ROLL_SIGMA_DEG: f64 = 20.0;
/// Mean pitch of a hand-held camera, degrees: people look down rather than up.
const PITCH_DEG: f64 = -15.0;
/// Its standard deviation, degrees.
const PITCH_SIGMA_DEG: f64 = 35.0;
/// Directions closer than this are the same one, degrees.
const SAME_DEG: f64 = 20.0;

/// The direction that most speaks for, without a floor: searches the sphere, then adjusts the best
/// one. Few votes, or another direction that nearly as much speaks for, make it doubtful.
pub(super) fn vote(evidence: &Evidence) -> Option<Upright> {
    if evidence.poses.is_empty() || evidence.patches.is_empty() && evidence.edges.is_empty() {
        return None;
    }
    let reach = REACH_DEG[0].to_radians().sin();
    let score = |up: &Vec3| support(evidence, up, reach) * held(evidence, up);
    let directions = sphere(NUM_DIRECTIONS);
    let mut scored: Vec<(f64, Vec3)> = directions.map(|up| (score(&up), up)).collect();
    // equal scores in the order of the sphere
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (best, first) = *scored.first()?;
    if best <= 0.0 {
        return None;
    }
    let is_other = |up: &Vec3| up.dot(&first).abs() < SAME_DEG.to_radians().cos();
    let rival = scored.iter().find(|(_, up)| is_other(up));
    let rival = rival.map_or(0.0, |(score, _)| score.max(0.0) / best);
    let mut up = first;
    for reach_deg in REACH_DEG {
        up = adjusted(evidence, &up, reach_deg.to_radians().sin())?;
    }
    let support = support(evidence, &up, reach) / ENOUGH_SUPPORT;
    Some(Upright {
        up_in_world: up,
        confidence: support.clamp(0.0, 1.0) * (1.0 - rival),
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

/// Votes for a direction less those that a random direction gets, per keyframe: level planes,
/// upright planes, upright edges.
fn support(evidence: &Evidence, up: &Vec3, reach: f64) -> f64 {
    // the mean of the kernel over a random great circle; over a random plane's normal it is
    // negligible
    let by_chance = 8.0 / 15.0 * reach;
    let patches: f64 = evidence
        .patches
        .iter()
        .map(|patch| {
            let cosine = patch.normal_in_world.dot(up);
            let level = kernel(patch.normal_in_world.cross(up).norm(), reach);
            patch.weight * (level + kernel(cosine, reach) - by_chance)
        })
        .sum();
    let edges: f64 = evidence
        .edges
        .iter()
        .map(|edge| edge.weight * (kernel(edge.normal_in_world.dot(up), reach) - by_chance))
        .sum();
    (patches + edges) / (2 * evidence.poses.len()) as f64
}

/// How likely a camera is held so, over all keyframes: seldom rolled, not much pitched, rarely
/// upside down.
fn held(evidence: &Evidence, up: &Vec3) -> f64 {
    let (mut roll, mut pitch, mut above) = (0.0, 0.0, 0.0);
    for pose in &evidence.poses {
        let [right, down, ahead] = [Vec3::x(), Vec3::y(), Vec3::z()].map(|axis| {
            let axis: Vec3 = pose.rotation * axis;
            axis.dot(up).clamp(-1.0, 1.0)
        });
        roll += right.asin().abs();
        pitch += (ahead.asin() - PITCH_DEG.to_radians()).abs();
        // who looks at the ground has up ahead of the image's upper edge
        above -= down + 0.3 * ahead;
    }
    if above <= 0.0 {
        return 0.0;
    }
    let in_sigmas =
        |angle: f64, sigma_deg: f64| angle / evidence.poses.len() as f64 / sigma_deg.to_radians();
    let roll = in_sigmas(roll, ROLL_SIGMA_DEG);
    let pitch = in_sigmas(pitch, PITCH_SIGMA_DEG);
    (-0.5 * (roll * roll + pitch * pitch)).exp()
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
