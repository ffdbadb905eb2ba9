//! Pose of one view in another by least squares over corners that both see, with the noise of
//! pixels and of depths.

use monogrid_geometry::nalgebra::{Matrix2, Matrix2x3, SMatrix};
use monogrid_geometry::{Mat7, Pinhole, Sim3, Vec2, Vec3, Vec7, hat};

/// A point known in one view and seen in the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    /// Position in the first view.
    pub point: Vec3,
    /// Relative standard deviation of its depth.
    pub relative_sigma: f64,
    /// Where the second view sees it.
    pub pixel: Vec2,
    /// Standard deviation of that, px.
    pub sigma_px: f64,
    /// Camera of the second view.
    pub pinhole: Pinhole,
}

/// A corner seen by both views: at least one knows its depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Correspondence {
    /// From `a`'s depth to `b`'s pixel.
    pub forward: Option<Projection>,
    /// From `b`'s depth to `a`'s pixel.
    pub backward: Option<Projection>,
}

/// What is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Freedom {
    /// Rotation and translation.
    Rigid,
    /// Also the ratio of the units.
    Similarity,
}

/// Result of [`refine`].
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub b_from_a: Sim3,
    /// Which correspondences agree.
    pub inliers: Vec<bool>,
    pub num_inliers: usize,
    /// Of a left update `[v, w, s]`; `s` is zero in a rigid fit.
    pub covariance: Mat7,
}

/// 99 % of chi squared with two degrees of freedom.
const INLIER_CHI_SQ: f64 = 9.21;
/// Three standard deviations, of a single number.
const INLIER_DEPTH_CHI_SQ: f64 = 9.0;
/// Beyond this many standard deviations the influence of a residual no longer grows (Huber).
const HUBER: f64 = 1.5;
/// Standard deviations beyond which a residual is ignored, while the pose is rough and afterwards.
const CUTS: [(f64, usize); 2] = [(10.0, 5), (4.0, 8)];

type Row2 = SMatrix<f64, 2, 7>;

/// Gauss-Newton from `initial`; `None` when the correspondences do not determine the pose.
pub(super) fn refine(
    correspondences: &[Correspondence],
    initial: &Sim3,
    freedom: Freedom,
) -> Option<Fit> {
    let mut pose = *initial;
    for (cut, num_steps) in CUTS {
        for _ in 0..num_steps {
            let system = accumulate(correspondences, &pose, cut);
            let step = -system
                .locked(freedom)
                .cholesky()?
                .solve(&system.gradient(freedom));
            pose = Sim3::exp(&step) * pose;
            if !pose.is_finite() {
                return None;
            }
            if step.norm() < 1e-9 {
                break;
            }
        }
    }
    let inliers = correspondences.iter().map(|c| is_inlier(c, &pose, freedom));
    let inliers: Vec<bool> = inliers.collect();
    let judged = correspondences.iter().zip(&inliers);
    let kept = judged.filter_map(|(c, is_inlier)| is_inlier.then_some(*c));
    let kept: Vec<Correspondence> = kept.collect();
    let system = accumulate(&kept, &pose, f64::INFINITY);
    let mut covariance = system.locked(freedom).cholesky()?.inverse();
    if freedom == Freedom::Rigid {
        covariance[(6, 6)] = 0.0;
    }
    // never better than the noise that was assumed
    let spare = (system.count as f64 - 7.0).max(1.0);
    covariance *= (system.chi_sq / spare).max(1.0);
    Some(Fit {
        b_from_a: pose,
        num_inliers: kept.len(),
        inliers,
        covariance,
    })
}

/// Normal equations.
struct System {
    h: Mat7,
    g: Vec7,
    chi_sq: f64,
    /// Numbers measured.
    count: usize,
}

impl System {
    /// The matrix with the scale fixed if it is.
    fn locked(&self, freedom: Freedom) -> Mat7 {
        let mut h = self.h;
        if freedom == Freedom::Rigid {
            h.fill_row(6, 0.0);
            h.fill_column(6, 0.0);
            h[(6, 6)] = 1.0;
        }
        h
    }

    fn gradient(&self, freedom: Freedom) -> Vec7 {
        let mut g = self.g;
        if freedom == Freedom::Rigid {
            g[6] = 0.0;
        }
        g
    }

    fn add_pixel(&mut self, row: &Row2, residual: &Vec2, information: &Matrix2<f64>, cut: f64) {
        let chi_sq = residual.dot(&(information * residual));
        if chi_sq > cut * cut {
            return;
        }
        let weight = (HUBER / chi_sq.sqrt().max(1e-12)).min(1.0);
        let weighted = row.transpose() * information * weight;
        self.h += weighted * row;
        self.g += weighted * residual;
        self.chi_sq += chi_sq;
        self.count += 2;
    }

    fn add_depth(&mut self, row: &Vec7, residual: f64, variance: f64, cut: f64) {
        let chi_sq = residual * residual / variance;
        if chi_sq > cut * cut {
            return;
        }
        let weight = (HUBER / chi_sq.sqrt().max(1e-12)).min(1.0) / variance;
        self.h += weight * row * row.transpose();
        self.g += weight * row * residual;
        self.chi_sq += chi_sq;
        self.count += 1;
    }
}

fn accumulate(correspondences: &[Correspondence], pose: &Sim3, cut: f64) -> System {
    let mut system = System {
        h: Mat7::zeros(),
        g: Vec7::zeros(),
        chi_sq: 0.0,
        count: 0,
    };
    let inverse = pose.inverse();
    for c in correspondences {
        if let Some(forward) = &c.forward
            && let Some(seen) = project(forward, pose)
        {
            let row = seen.derivative * left_update(&seen.point);
            system.add_pixel(&row, &seen.residual, &seen.information, cut);
        }
        if let Some(backward) = &c.backward
            && let Some(seen) = project(backward, &inverse)
        {
            // a_from_b exp(-delta) point: the update acts on the point in b
            let linear = inverse.rotation.to_rotation_matrix().into_inner() * inverse.scale;
            let row = -(seen.derivative * linear) * left_update(&backward.point);
            system.add_pixel(&row, &seen.residual, &seen.information, cut);
        }
        if let Some((row, residual, variance)) = depth_residual(c, pose) {
            system.add_depth(&row, residual, variance, cut);
        }
    }
    system
}

/// Derivative of `exp([v, w, s]) point` at zero.
fn left_update(point: &Vec3) -> SMatrix<f64, 3, 7> {
    let mut out = SMatrix::<f64, 3, 7>::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&-hat(point));
    out.fixed_view_mut::<3, 1>(0, 6).copy_from(point);
    out
}

/// A projection at a pose.
struct Seen {
    /// The point in the second view.
    point: Vec3,
    residual: Vec2,
    /// Derivative of the pixel by the point.
    derivative: Matrix2x3<f64>,
    /// Inverse covariance of the residual: of the pixel, and of the depth along the epipolar line.
    information: Matrix2<f64>,
}

fn project(projection: &Projection, second_from_first: &Sim3) -> Option<Seen> {
    let p = *second_from_first * projection.point;
    if p.z < Pinhole::MIN_DEPTH {
        return None;
    }
    let pinhole = &projection.pinhole;
    let (fx, fy) = (pinhole.fx / p.z, pinhole.fy / p.z);
    let derivative = Matrix2x3::new(fx, 0.0, -fx * p.x / p.z, 0.0, fy, -fy * p.y / p.z);
    // a relative change of depth moves the point along its ray from the first camera
    let along = derivative * (p - second_from_first.translation) * projection.relative_sigma;
    let covariance = Matrix2::identity() * projection.sigma_px.powi(2) + along * along.transpose();
    Some(Seen {
        point: p,
        residual: pinhole.project(&p) - projection.pixel,
        derivative,
        information: covariance.try_inverse()?,
    })
}

/// Difference of the logarithms of both depths of a corner, its derivative and its variance.
fn depth_residual(c: &Correspondence, b_from_a: &Sim3) -> Option<(Vec7, f64, f64)> {
    let (forward, backward) = (c.forward.as_ref()?, c.backward.as_ref()?);
    let p = *b_from_a * forward.point;
    if p.z < Pinhole::MIN_DEPTH || backward.point.z < Pinhole::MIN_DEPTH {
        return None;
    }
    let row = left_update(&p).row(2).transpose() / p.z;
    let share = (p.z - b_from_a.translation.z) / p.z * forward.relative_sigma;
    let variance = share.powi(2) + backward.relative_sigma.powi(2) + 1e-6;
    Some((row, (p.z / backward.point.z).ln(), variance))
}

/// Whether everything known about a correspondence agrees with the pose. Depths of two keyframes
/// can be compared only when the ratio of their units is known.
fn is_inlier(c: &Correspondence, pose: &Sim3, freedom: Freedom) -> bool {
    let agrees = |projection: &Option<Projection>, pose: &Sim3| {
        projection.as_ref().is_none_or(|p| {
            project(p, pose)
                .is_some_and(|s| s.residual.dot(&(s.information * s.residual)) < INLIER_CHI_SQ)
        })
    };
    agrees(&c.forward, pose)
        && agrees(&c.backward, &pose.inverse())
        && (freedom == Freedom::Rigid
            || depth_residual(c, pose)
                .is_none_or(|(_, r, variance)| r * r / variance < INLIER_DEPTH_CHI_SQ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;
    use monogrid_geometry::Vec6;

    const PINHOLE: Pinhole = Pinhole {
        fx: 500.0,
        fy: 490.0,
        cx: 320.0,
        cy: 240.0,
    };

    /// Points seen from two cameras whose units differ; noise of pixels and depths as assumed.
    fn scene(seed: u64, num: usize, outlier_ratio: f64) -> (Vec<Correspondence>, Sim3) {
        let mut rng = Rng::new(seed);
        let twist = Vec6::from_fn(|_, _| 0.25 * rng.normal());
        let b_from_a = Sim3::exp(&Vec7::from_fn(|i, _| {
            if i == 6 { 0.3 * rng.normal() } else { twist[i] }
        }));
        let relative_sigma = 0.04;
        let mut out = Vec::new();
        for i in 0..num {
            let pixel_a = Vec2::new(rng.uniform() * 640.0, rng.uniform() * 480.0);
            let in_a = PINHOLE.unproject(&pixel_a) * (1.0 + 4.0 * rng.uniform());
            let in_b = b_from_a * in_a;
            if in_b.z < 0.1 {
                continue;
            }
            let mut noisy = |point: &Vec3| *point * (relative_sigma * rng.normal()).exp();
            let (known_a, known_b) = (noisy(&in_a), noisy(&in_b));
            let mut shifted = |pixel: Vec2| pixel + Vec2::new(rng.normal(), rng.normal());
            let mut pixel_b = shifted(PINHOLE.project(&in_b));
            if rng.uniform() < outlier_ratio {
                pixel_b += Vec2::new(80.0 * rng.normal(), 80.0 * rng.normal());
            }
            out.push(Correspondence {
                forward: Some(Projection {
                    point: known_a,
                    relative_sigma,
                    pixel: pixel_b,
                    sigma_px: 1.0,
                    pinhole: PINHOLE,
                }),
                // every other corner has no depth in b; its ray there is the noisy pixel's
                backward: (i % 2 == 0).then_some(Projection {
                    point: PINHOLE.unproject(&pixel_b) * known_b.z,
                    relative_sigma,
                    pixel: pixel_a,
                    sigma_px: 1.5,
                    pinhole: PINHOLE,
                }),
            });
        }
        (out, b_from_a)
    }

    #[test]
    fn similarity_is_found_with_an_honest_covariance() {
        let mut mean_chi_sq = 0.0;
        for seed in 0..20 {
            let (correspondences, truth) = scene(seed, 150, 0.2);
            // off by about five pixels, as a pose of random samples is
            let start = Sim3::exp(&Vec7::from_element(0.005)) * truth;
            let fit = refine(&correspondences, &start, Freedom::Similarity).unwrap();
            let error = (fit.b_from_a * truth.inverse()).log();
            let chi_sq = error.dot(&(fit.covariance.try_inverse().unwrap() * error));
            mean_chi_sq += chi_sq / 20.0;
            assert!(error.norm() < 0.1, "seed {seed}: {error}");
            assert!(fit.num_inliers > correspondences.len() / 2);
        }
        // seven on average if honest; both directions share pixels, so a little more is natural
        assert!((2.0..16.0).contains(&mean_chi_sq), "{mean_chi_sq}");
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let (correspondences, truth) = scene(3, 30, 0.0);
        let pose = Sim3::exp(&Vec7::from_element(0.01)) * truth;
        // without noise of depth the weights do not depend on the pose
        let plain: Vec<Correspondence> = correspondences
            .iter()
            .map(|c| {
                let exact = |p: Projection| Projection {
                    relative_sigma: 0.0,
                    ..p
                };
                Correspondence {
                    forward: c.forward.map(exact),
                    backward: c.backward.map(exact),
                }
            })
            .collect();
        for c in &plain {
            for (only_forward, projection) in [(true, c.forward), (false, c.backward)] {
                let Some(projection) = projection else {
                    continue;
                };
                let at = |pose: &Sim3| {
                    let pose = if only_forward { *pose } else { pose.inverse() };
                    project(&projection, &pose).unwrap()
                };
                let seen = at(&pose);
                let row = if only_forward {
                    seen.derivative * left_update(&seen.point)
                } else {
                    let inverse = pose.inverse();
                    let linear = inverse.rotation.to_rotation_matrix().into_inner() * inverse.scale;
                    -(seen.derivative * linear) * left_update(&projection.point)
                };
                for k in 0..7 {
                    let mut step = Vec7::zeros();
                    step[k] = 1e-6;
                    let ahead = at(&(Sim3::exp(&step) * pose)).residual;
                    let behind = at(&(Sim3::exp(&-step) * pose)).residual;
                    let numeric = (ahead - behind) / 2e-6;
                    let difference = (numeric - row.column(k)).norm();
                    assert!(
                        difference < 1e-3 * numeric.norm().max(1.0),
                        "{k}: {difference}"
                    );
                }
            }
            if let Some((row, _, _)) = depth_residual(c, &pose) {
                for k in 0..7 {
                    let mut step = Vec7::zeros();
                    step[k] = 1e-6;
                    let at = |pose: Sim3| depth_residual(c, &pose).unwrap().1;
                    let numeric =
                        (at(Sim3::exp(&step) * pose) - at(Sim3::exp(&-step) * pose)) / 2e-6;
                    assert!((numeric - row[k]).abs() < 1e-5 * numeric.abs().max(1.0));
                }
            }
        }
    }

    #[test]
    fn without_correspondences_nothing_is_determined() {
        let pose = Sim3::identity();
        assert!(refine(&[], &pose, Freedom::Rigid).is_none());
        let (few, truth) = scene(1, 30, 0.0);
        assert!(refine(&few[..2], &truth, Freedom::Rigid).is_none());
    }
}
