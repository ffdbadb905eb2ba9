//! Pose of a camera from pixels of known points: three-point solutions inside random sampling,
//! then refinement on all inliers. For relocalisation and loop closure.

use crate::Rng;
use crate::polynomial::{multiply, real_roots};
use crate::ransac::samples_needed;
use monogrid_geometry::nalgebra::{Matrix2x3, Matrix2x6, Rotation3};
use monogrid_geometry::{Mat3, Mat6, Pinhole, Rotation, Se3, Vec2, Vec3, Vec6, hat};

/// Smallest share of inliers that samples are drawn for.
const MIN_INLIER_RATIO: f64 = 0.02;
/// A known point and where it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointPixel {
    /// Position in the world.
    pub point_in_world: Vec3,
    /// Undistorted pixel.
    pub pixel: Vec2,
}

/// Settings of [`absolute_pose`].
#[derive(Clone, Debug, PartialEq)]
pub struct AbsolutePoseConfig {
    /// Largest reprojection error of an inlier, px. Default 3.
    pub max_error_px: f64,
    /// Most random samples. Default 500.
    pub iterations: usize,
    /// Seed of the sampling. Default 0.
    pub seed: u64,
    /// Fewest inliers. Default 12.
    pub min_inliers: usize,
    /// Smallest share of inliers. Default 0.15.
    pub min_inlier_ratio: f64,
}

impl Default for AbsolutePoseConfig {
    fn default() -> Self {
        Self {
            max_error_px: 3.0,
            iterations: 500,
            seed: 0,
            min_inliers: 12,
            min_inlier_ratio: 0.15,
        }
    }
}

/// The pose `camera_from_world` that explains most sightings; `None` when too few agree.
///
/// Deterministic for a given seed.
#[must_use]
pub fn absolute_pose(
    sightings: &[PointPixel],
    pinhole: &Pinhole,
    config: &AbsolutePoseConfig,
) -> Option<Se3> {
    let needed = config
        .min_inliers
        .max((config.min_inlier_ratio * sightings.len() as f64).ceil() as usize)
        .max(4);
    if sightings.len() < needed {
        return None;
    }
    let limit = config.max_error_px * config.max_error_px;
    let mut rng = Rng::new(config.seed);
    let mut best: Option<(f64, Se3)> = None;
    let (mut done, mut enough) = (0, config.iterations);
    while done < enough.min(config.iterations) {
        done += 1;
        let sample: [usize; 3] = rng.sample(sightings.len());
        let points = sample.map(|i| sightings[i].point_in_world);
        let rays = sample.map(|i| pinhole.unproject(&sightings[i].pixel).normalize());
        for pose in three_point(&points, &rays) {
            let cost = truncated_cost(sightings, pinhole, &pose, limit);
            if best.as_ref().is_none_or(|b| cost < b.0) {
                // a pose of a minimal sample is rough: polish before it counts
                let polished = refine(sightings, pinhole, &pose, 2.0 * config.max_error_px, 2);
                let polished_cost = truncated_cost(sightings, pinhole, &polished, limit);
                let (cost, pose) = if polished_cost < cost {
                    (polished_cost, polished)
                } else {
                    (cost, pose)
                };
                best = Some((cost, pose));
                let ratio = 1.0 - cost / (limit * sightings.len() as f64);
                enough = samples_needed(ratio, MIN_INLIER_RATIO, 3);
            }
        }
    }
    let pose = refine(sightings, pinhole, &best?.1, config.max_error_px, 10);
    let errors = sightings.iter().map(|s| error_sq(s, pinhole, &pose));
    let num_inliers = errors.filter(|e| *e < limit).count();
    (num_inliers >= needed).then_some(pose)
}

/// Poses from three points and unit rays: at most four.
///
/// Grunert's equations for the three distances `s1, u s1, v s1` as in `[HARALICK94]`: their
/// difference is linear in `u`, which leaves a quartic in `v`.
fn three_point(points: &[Vec3; 3], rays: &[Vec3; 3]) -> Vec<Se3> {
    let side_sq = |i: usize, j: usize| (points[i] - points[j]).norm_squared();
    let (a_sq, b_sq, c_sq) = (side_sq(1, 2), side_sq(0, 2), side_sq(0, 1));
    let cos = |i: usize, j: usize| rays[i].dot(&rays[j]);
    let (cos_alpha, cos_beta, cos_gamma) = (cos(1, 2), cos(0, 2), cos(0, 1));
    let area = (points[1] - points[0])
        .cross(&(points[2] - points[0]))
        .norm();
    if area.is_nan() || area <= 1e-9 * b_sq {
        return Vec::new(); // points on a line
    }
    // q(v) = 1 + v² - 2 v cos(beta) = b² / s1²
    let q = [1.0, -2.0 * cos_beta, 1.0];
    // u = numerator(v) / denominator(v)
    let k = (a_sq - c_sq) / b_sq;
    let numerator = [-1.0 - k * q[0], -k * q[1], 1.0 - k * q[2]];
    let denominator = [-2.0 * cos_gamma, 2.0 * cos_alpha];
    // u² - 2 u cos(gamma) + 1 - (c²/b²) q = 0, times denominator²
    let m = c_sq / b_sq;
    let rest = [1.0 - m * q[0], -m * q[1], -m * q[2]];
    let square_n = multiply(&numerator, &numerator);
    let mixed = multiply(&numerator, &denominator);
    let square_d_rest = multiply(&multiply(&denominator, &denominator), &rest);
    let quartic: Vec<f64> = (0..5)
        .map(|i| square_n[i] - 2.0 * cos_gamma * mixed.get(i).unwrap_or(&0.0) + square_d_rest[i])
        .collect();
    let mut poses = Vec::with_capacity(4);
    for v in real_roots(&quartic) {
        let u = (numerator[0] + v * (numerator[1] + v * numerator[2]))
            / (denominator[0] + v * denominator[1]);
        let s1 = (b_sq / (1.0 + v * (v - 2.0 * cos_beta))).sqrt();
        if !(v > 0.0 && u > 0.0 && u.is_finite() && s1.is_finite()) {
            continue;
        }
        let in_camera = [rays[0] * s1, rays[1] * (u * s1), rays[2] * (v * s1)];
        poses.extend(align_triangle(points, &in_camera));
    }
    poses
}

/// The motion that takes one triangle to a congruent one.
fn align_triangle(from: &[Vec3; 3], to: &[Vec3; 3]) -> Option<Se3> {
    let frame = |p: &[Vec3; 3]| {
        let x = (p[1] - p[0]).try_normalize(1e-12)?;
        let z = x.cross(&(p[2] - p[0])).try_normalize(1e-12)?;
        Some(Mat3::from_columns(&[x, z.cross(&x), z]))
    };
    let rotation = Rotation3::from_matrix_unchecked(frame(to)? * frame(from)?.transpose());
    let rotation = Rotation::from_rotation_matrix(&rotation);
    let centroid = |p: &[Vec3; 3]| (p[0] + p[1] + p[2]) / 3.0;
    Some(Se3::new(rotation, centroid(to) - rotation * centroid(from)))
}

fn error_sq(sighting: &PointPixel, pinhole: &Pinhole, pose: &Se3) -> f64 {
    let point = *pose * sighting.point_in_world;
    if point.z < Pinhole::MIN_DEPTH {
        return f64::INFINITY;
    }
    (pinhole.project(&point) - sighting.pixel).norm_squared()
}

fn truncated_cost(sightings: &[PointPixel], pinhole: &Pinhole, pose: &Se3, limit: f64) -> f64 {
    let errors = sightings.iter().map(|s| error_sq(s, pinhole, pose));
    errors.map(|e| if e < limit { e } else { limit }).sum()
}

/// Residual and its derivative by a left update `[v, w]`.
fn linearise(
    sighting: &PointPixel,
    pinhole: &Pinhole,
    pose: &Se3,
) -> Option<(Vec2, Matrix2x6<f64>)> {
    let p = *pose * sighting.point_in_world;
    if p.z < Pinhole::MIN_DEPTH {
        return None;
    }
    let (fx, fy) = (pinhole.fx / p.z, pinhole.fy / p.z);
    let projection = Matrix2x3::new(fx, 0.0, -fx * p.x / p.z, 0.0, fy, -fy * p.y / p.z);
    let mut jacobian = Matrix2x6::zeros();
    jacobian.fixed_columns_mut::<3>(0).copy_from(&projection);
    jacobian
        .fixed_columns_mut::<3>(3)
        .copy_from(&(projection * -hat(&p)));
    Some((pinhole.project(&p) - sighting.pixel, jacobian))
}

/// Gauss-Newton with Huber weights over the sightings within three times `scale_px`.
fn refine(
    sightings: &[PointPixel],
    pinhole: &Pinhole,
    initial: &Se3,
    scale_px: f64,
    num_steps: usize,
) -> Se3 {
    let mut pose = *initial;
    for _ in 0..num_steps {
        let (mut h, mut g) = (Mat6::zeros(), Vec6::zeros());
        for sighting in sightings {
            let Some((residual, jacobian)) = linearise(sighting, pinhole, &pose) else {
                continue;
            };
            let error = residual.norm();
            if error > 3.0 * scale_px {
                continue;
            }
            let weight = (0.5 * scale_px / error.max(1e-12)).min(1.0);
            h += weight * jacobian.tr_mul(&jacobian);
            g += weight * jacobian.tr_mul(&residual);
        }
        let Some(cholesky) = h.cholesky() else {
            return pose;
        };
        let step = -cholesky.solve(&g);
        let moved = Se3::exp(&step) * pose;
        if !moved.is_finite() {
            return pose;
        }
        pose = moved;
        if step.norm() < 1e-10 {
            break;
        }
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::rotation_exp;

    const PINHOLE: Pinhole = Pinhole {
        fx: 500.0,
        fy: 490.0,
        cx: 320.0,
        cy: 240.0,
    };

    fn world(seed: u64, num: usize, noise_px: f64, outlier_ratio: f64) -> (Vec<PointPixel>, Se3) {
        let mut rng = Rng::new(seed);
        let mut vector = || Vec3::new(rng.normal(), rng.normal(), rng.normal());
        let truth = Se3::new(rotation_exp(&vector()), vector() * 2.0);
        let world_from_camera = truth.inverse();
        let sightings = (0..num)
            .map(|_| {
                let pixel = Vec2::new(rng.uniform() * 640.0, rng.uniform() * 480.0);
                let depth = 1.0 + 4.0 * rng.uniform();
                let point_in_world = world_from_camera * (PINHOLE.unproject(&pixel) * depth);
                let pixel = if rng.uniform() < outlier_ratio {
                    Vec2::new(rng.uniform() * 640.0, rng.uniform() * 480.0)
                } else {
                    pixel + Vec2::new(rng.normal(), rng.normal()) * noise_px
                };
                PointPixel {
                    point_in_world,
                    pixel,
                }
            })
            .collect();
        (sightings, truth)
    }

    #[test]
    fn three_points_allow_the_true_pose() {
        let mut missed = 0;
        for seed in 0..500 {
            let (sightings, truth) = world(seed, 3, 0.0, 0.0);
            let points = [0, 1, 2].map(|i| sightings[i].point_in_world);
            let rays = [0, 1, 2].map(|i| PINHOLE.unproject(&sightings[i].pixel).normalize());
            let poses = three_point(&points, &rays);
            assert!(poses.len() <= 4);
            let is_found = poses
                .iter()
                .any(|pose| (*pose * truth.inverse()).log().norm() < 1e-4);
            missed += usize::from(!is_found);
        }
        // nearly double roots lose digits
        assert!(missed <= 5, "{missed} of 500 missed");
    }

    #[test]
    fn two_thirds_of_outliers_are_survived() {
        for seed in 0..10 {
            let (sightings, truth) = world(seed, 150, 0.7, 0.66);
            let found =
                absolute_pose(&sightings, &PINHOLE, &AbsolutePoseConfig::default()).unwrap();
            let error = (found * truth.inverse()).log().norm();
            // fifty inliers at 1 to 5 units determine it to about 0.001
            assert!(error < 0.01, "seed {seed}: {error}");
        }
    }

    #[test]
    fn noise_is_no_pose() {
        for seed in 0..5 {
            let (sightings, _) = world(seed, 100, 0.5, 1.0);
            assert!(absolute_pose(&sightings, &PINHOLE, &AbsolutePoseConfig::default()).is_none());
        }
        assert!(absolute_pose(&[], &PINHOLE, &AbsolutePoseConfig::default()).is_none());
        let nan = vec![
            PointPixel {
                point_in_world: Vec3::new(f64::NAN, 0.0, 1.0),
                pixel: Vec2::new(1.0, f64::NAN)
            };
            30
        ];
        assert!(absolute_pose(&nan, &PINHOLE, &AbsolutePoseConfig::default()).is_none());
    }
}
