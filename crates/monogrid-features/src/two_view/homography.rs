//! Homographies from four matches, and the motions that a homography allows.

use monogrid_geometry::nalgebra::{Rotation3, SMatrix, SVector};
use monogrid_geometry::{Mat3, Rotation, Se3, Vec3};

/// The homography `b ~ H a` of four pairs of bearings; `None` for degenerate samples.
pub(super) fn four_point(a: &[Vec3; 4], b: &[Vec3; 4]) -> Option<Mat3> {
    let mut rows = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    for k in 0..4 {
        let (p, q) = (a[k] / a[k].z, b[k] / b[k].z);
        for i in 0..2 {
            for j in 0..3 {
                rows[(2 * k + i, 3 * i + j)] = p[j];
            }
            for j in 0..2 {
                rows[(2 * k + i, 6 + j)] = -q[i] * p[j];
            }
            right[2 * k + i] = q[i];
        }
    }
    // h33 = 1: the point straight ahead of a is never mapped to infinity between two views of one
    // surface that both see in front of them
    let h = rows.lu().solve(&right)?;
    let homography = Mat3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
    let norm = homography.norm();
    (norm.is_finite() && homography.determinant().abs() > 1e-9 * norm.powi(3)).then_some(homography)
}

/// The two motions with the plane in front of the bearings `a` that explain `homography` (`[MA04]`
/// section 5.3.3), with the length of `t` in units of the distance of the plane; none when it is a
/// rotation.
pub(super) fn decompose(homography: &Mat3, a: &[Vec3], b: &[Vec3]) -> Vec<Se3> {
    let svd = homography.svd(false, true);
    let Some(v_t) = svd.v_t else {
        return Vec::new();
    };
    let mut h = homography / svd.singular_values[1];
    let in_front = a.iter().zip(b).filter(|(a, b)| b.dot(&(h * *a)) > 0.0);
    if 2 * in_front.count() < a.len().min(b.len()) {
        h = -h;
    }
    let s1 = svd.singular_values[0] / svd.singular_values[1];
    let s3 = svd.singular_values[2] / svd.singular_values[1];
    if s1 - s3 < 1e-6 || !s1.is_finite() || !s3.is_finite() {
        return Vec::new();
    }
    let [v1, v2, v3] = [0, 1, 2].map(|i| v_t.row(i).transpose());
    let p = (1.0 - s3 * s3).max(0.0).sqrt();
    let q = (s1 * s1 - 1.0).max(0.0).sqrt();
    let denominator = (s1 * s1 - s3 * s3).sqrt();
    [1.0, -1.0]
        .into_iter()
        .filter_map(|sign| {
            let u = (v1 * p + v3 * (sign * q)) / denominator;
            let normal = v2.cross(&u);
            let from = Mat3::from_columns(&[v2, u, normal]);
            let (h_v2, h_u) = (h * v2, h * u);
            let to = Mat3::from_columns(&[h_v2, h_u, h_v2.cross(&h_u)]);
            let rotation = to * from.transpose();
            let translation = (h - rotation) * normal;
            if !rotation.iter().all(|v| v.is_finite()) || rotation.determinant() < 0.5 {
                return None;
            }
            let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix(&rotation));
            let visible = a.iter().filter(|a| normal.dot(a) > 0.0).count();
            let side = if 2 * visible >= a.len() { 1.0 } else { -1.0 };
            Some(Se3::new(rotation, translation * side))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;
    use monogrid_geometry::rotation_exp;

    #[test]
    fn the_true_motion_is_among_the_two_of_a_plane() {
        let mut rng = Rng::new(11);
        for _ in 0..200 {
            let mut vector = || Vec3::new(rng.normal(), rng.normal(), rng.normal());
            let truth = Se3::new(rotation_exp(&(vector() * 0.15)), vector() * 0.2);
            let normal = (vector() * 0.3 + Vec3::z()).normalize();
            let (mut a, mut b) = (Vec::new(), Vec::new());
            while a.len() < 4 {
                let mut ray = vector() * 0.3;
                ray.z = 1.0;
                let point = ray / normal.dot(&ray) * 2.0; // plane at distance 2
                let in_b = truth * point;
                if point.z > 0.1 && in_b.z > 0.1 {
                    a.push(ray);
                    b.push(in_b / in_b.z);
                }
            }
            let pick = |v: &[Vec3]| [v[0], v[1], v[2], v[3]];
            let Some(h) = four_point(&pick(&a), &pick(&b)) else {
                panic!("no homography");
            };
            let motions = decompose(&h, &a, &b);
            let error = motions
                .iter()
                .map(|m| {
                    m.rotation.angle_to(&truth.rotation)
                        + (m.translation - truth.translation / 2.0).norm()
                })
                .fold(f64::INFINITY, f64::min);
            assert!(error < 1e-5, "error {error} of {} motions", motions.len());
        }
    }

    #[test]
    fn a_rotation_has_no_motion() {
        let rotation = rotation_exp(&Vec3::new(0.1, -0.2, 0.05));
        let h = rotation.to_rotation_matrix().into_inner();
        assert!(decompose(&h, &[Vec3::z()], &[Vec3::z()]).is_empty());
    }
}
