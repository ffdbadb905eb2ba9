//! One point from two or more views with known poses.

use monogrid_geometry::{Mat3, Pinhole, Se3, Vec2, Vec3};
use nalgebra::{Matrix2x3, Matrix4, RowVector4};

/// A sighting of a point: pose of the camera and pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct View {
    /// Pose of the camera that saw it.
    pub(crate) camera_from_world: Se3,
    /// Where, px.
    pub(crate) pixel: Vec2,
}

/// A triangulated point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Triangulation {
    /// Position in the world.
    pub(crate) point_in_world: Vec3,
    /// Covariance of the position for a pixel noise of one.
    pub(crate) unit_covariance: Mat3,
    /// Root mean square of the reprojection errors over all coordinates, px.
    pub(crate) residual_rms_px: f64,
    /// Largest angle between two of its rays, degrees.
    pub(crate) parallax_deg: f64,
}

/// Why there is no point.
#[derive(Debug, thiserror::Error, Clone, Copy, PartialEq)]
pub(crate) enum TriangulationError {
    /// Fewer than two sightings.
    #[error("triangulation got {found} sightings, expected at least 2")]
    TooFewSightings {
        /// Sightings given.
        found: usize,
    },
    /// All rays are parallel, or nearly.
    #[error(
        "rays are parallel within the precision of numbers, expected views from different places"
    )]
    Parallel,
    /// The point lies behind a camera that saw it.
    #[error(
        "point lies behind sighting {index}, expected in front of all; is a match or a pose wrong?"
    )]
    Behind {
        /// Index of the first such sighting.
        index: usize,
    },
}

/// Triangulates one point: linear in homogeneous coordinates (points far away stay well
/// conditioned), then Gauss-Newton on the reprojection error.
///
/// # Errors
/// Fewer than two sightings, parallel rays, or a point behind one of the cameras.
pub(crate) fn triangulate(
    sightings: &[View],
    pinhole: &Pinhole,
) -> Result<Triangulation, TriangulationError> {
    if sightings.len() < 2 {
        return Err(TriangulationError::TooFewSightings {
            found: sightings.len(),
        });
    }
    let mut point = linear(sightings, pinhole)?;
    let mut system = check(sightings, pinhole, &point)?;
    for _ in 0..10 {
        let Some(inverse) = system.h.try_inverse() else {
            return Err(TriangulationError::Parallel);
        };
        let candidate = point - inverse * system.g;
        match check(sightings, pinhole, &candidate) {
            Ok(next) if next.cost < system.cost => {
                let done = system.cost - next.cost < 1e-10 * system.cost;
                (point, system) = (candidate, next);
                if done {
                    break;
                }
            }
            _ => break,
        }
    }
    let parallax_deg = parallax_deg(sightings, &point);
    if parallax_deg < MIN_PARALLAX_DEG {
        return Err(TriangulationError::Parallel);
    }
    let unit_covariance = system.h.try_inverse().ok_or(TriangulationError::Parallel)?;
    Ok(Triangulation {
        point_in_world: point,
        unit_covariance,
        residual_rms_px: (system.cost / (2 * sightings.len()) as f64).sqrt(),
        parallax_deg,
    })
}

/// A thousandth of a pixel for a focal length of 500: what is below is rounding.
const MIN_PARALLAX_DEG: f64 = 1e-4;

/// `[HZ04]` section 12.2, with bearings instead of pixels.
fn linear(sightings: &[View], pinhole: &Pinhole) -> Result<Vec3, TriangulationError> {
    let mut gram = Matrix4::zeros();
    for sighting in sightings {
        let bearing = pinhole.unproject(&sighting.pixel);
        let r = sighting.camera_from_world.rotation_matrix();
        let t = sighting.camera_from_world.translation;
        let row = |k: usize| RowVector4::new(r[(k, 0)], r[(k, 1)], r[(k, 2)], t[k]);
        for k in 0..2 {
            let equation = row(2) * bearing[k] - row(k);
            gram += equation.transpose() * equation;
        }
    }
    let eigen = gram.symmetric_eigen();
    let homogeneous = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let point = homogeneous.fixed_rows::<3>(0) / homogeneous[3];
    let is_near = point.iter().all(|v| v.is_finite() && v.abs() < 1e9);
    is_near.then_some(point).ok_or(TriangulationError::Parallel)
}

/// Normal equations of the reprojection error.
struct Normal {
    h: Mat3,
    g: Vec3,
    cost: f64,
}

fn check(
    sightings: &[View],
    pinhole: &Pinhole,
    point: &Vec3,
) -> Result<Normal, TriangulationError> {
    let mut normal = Normal {
        h: Mat3::zeros(),
        g: Vec3::zeros(),
        cost: 0.0,
    };
    for (index, sighting) in sightings.iter().enumerate() {
        let p = sighting.camera_from_world * *point;
        if p.z <= 1e-9 {
            return Err(TriangulationError::Behind { index });
        }
        let residual = pinhole.project(&p) - sighting.pixel;
        let (fx, fy) = (pinhole.fx / p.z, pinhole.fy / p.z);
        let projection = Matrix2x3::new(fx, 0.0, -fx * p.x / p.z, 0.0, fy, -fy * p.y / p.z);
        let jacobian = projection * sighting.camera_from_world.rotation_matrix();
        normal.h += jacobian.tr_mul(&jacobian);
        normal.g += jacobian.tr_mul(&residual);
        normal.cost += residual.norm_squared();
    }
    Ok(normal)
}

fn parallax_deg(sightings: &[View], point: &Vec3) -> f64 {
    let ray = |view: &View| point - view.camera_from_world.inverse().translation;
    let rays: Vec<Vec3> = sightings.iter().map(ray).collect();
    let mut largest = 0.0f64;
    for (i, a) in rays.iter().enumerate() {
        for b in &rays[..i] {
            largest = largest.max(a.angle(b).to_degrees());
        }
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_features::Rng;
    use monogrid_geometry::rotation_exp;

    const PINHOLE: Pinhole = Pinhole {
        fx: 500.0,
        fy: 490.0,
        cx: 320.0,
        cy: 240.0,
    };

    fn views(point: &Vec3, num: usize, noise_px: f64, rng: &mut Rng) -> Vec<View> {
        (0..num)
            .map(|_| {
                let mut vector = || Vec3::new(rng.normal(), rng.normal(), rng.normal());
                let rotation = rotation_exp(&(vector() * 0.05));
                let camera_from_world = Se3::new(rotation, vector() * 0.3);
                let noise = Vec2::new(rng.normal(), rng.normal()) * noise_px;
                let pixel = PINHOLE.project(&(camera_from_world * *point)) + noise;
                View {
                    camera_from_world,
                    pixel,
                }
            })
            .collect()
    }

    #[test]
    fn exact_sightings_give_the_exact_point() {
        let mut rng = Rng::new(8);
        for num in 2..6 {
            for depth in [1.0, 5.0, 200.0] {
                let truth = Vec3::new(0.3 * depth, -0.1 * depth, depth);
                let found = triangulate(&views(&truth, num, 0.0, &mut rng), &PINHOLE).unwrap();
                assert!((found.point_in_world - truth).norm() < 1e-6 * depth * depth);
                assert!(found.residual_rms_px < 1e-6 && found.parallax_deg > 0.0);
            }
        }
    }

    #[test]
    fn errors_agree_with_the_covariance() {
        let mut rng = Rng::new(9);
        let truth = Vec3::new(0.4, 0.2, 4.0);
        let mut sum = 0.0;
        let trials = 300;
        for _ in 0..trials {
            let found = triangulate(&views(&truth, 4, 0.5, &mut rng), &PINHOLE).unwrap();
            let error = found.point_in_world - truth;
            let information = found.unit_covariance.try_inverse().unwrap() / 0.25;
            sum += (error.transpose() * information * error).x / 3.0;
        }
        let normalised = sum / f64::from(trials);
        assert!((0.85..1.2).contains(&normalised), "{normalised}");
    }

    #[test]
    fn what_cannot_be_triangulated_says_why() {
        let mut rng = Rng::new(10);
        let truth = Vec3::new(0.0, 0.0, 3.0);
        let mut sightings = views(&truth, 2, 0.0, &mut rng);
        assert_eq!(
            triangulate(&sightings[..1], &PINHOLE),
            Err(TriangulationError::TooFewSightings { found: 1 })
        );
        let same = [sightings[0], sightings[0]];
        assert!(triangulate(&same, &PINHOLE).is_err());
        // half a turn about the vertical axis: the point is behind the second camera
        let turn = Se3::new(
            rotation_exp(&Vec3::new(0.0, std::f64::consts::PI, 0.0)),
            Vec3::zeros(),
        );
        sightings[1].camera_from_world = turn * sightings[1].camera_from_world;
        assert!(matches!(
            triangulate(&sightings, &PINHOLE),
            Err(TriangulationError::Behind { .. })
        ));
    }
}
