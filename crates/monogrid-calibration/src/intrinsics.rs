//! The camera model that is estimated, and what is known of it beforehand.

use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2, Vec3};
use nalgebra::{SMatrix, SVector};

/// Number of parameters of a camera.
pub const NUM_PARAMETERS: usize = 6;

/// Parameters of a camera in the order `[ln f, k1, k2, cx, cy, readout]`; `cx`, `cy` in px, the
/// readout in shares of the time from frame to frame.
pub type Parameters = SVector<f64, NUM_PARAMETERS>;

/// Which of the parameters the readout is.
pub(crate) const READOUT: usize = 5;

/// Covariance or information of [`Parameters`].
pub(crate) type ParameterMatrix = SMatrix<f64, NUM_PARAMETERS, NUM_PARAMETERS>;

/// A camera with square pixels and radial distortion (the first two terms of OpenCV's model).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal length, px.
    pub focal: f64,
    /// Principal point, px; the centre of the top-left pixel is (0, 0).
    pub centre: Vec2,
    /// Radial distortion, factors of the squared and the fourth power of the radius.
    pub radial: [f64; 2],
    /// Time from the first row to the last (rolling shutter), in shares of the time from frame to
    /// frame.
    pub readout: f64,
}

/// How a pixel changes with the camera and with the point.
pub(crate) struct Projection {
    pub pixel: Vec2,
    /// By the parameters; by the readout, what does not depend on the point, is left to the caller.
    pub by_parameters: SMatrix<f64, 2, NUM_PARAMETERS>,
    /// By the point in the camera's frame.
    pub by_point: SMatrix<f64, 2, 3>,
}

/// Depth below which a point counts as not in front of the camera, relative to its distance.
const MIN_FORWARD: f64 = 0.05;

impl Intrinsics {
    /// A camera without distortion whose principal point is the centre of the image.
    #[must_use]
    pub fn centred(focal: f64, (width, height): (usize, usize)) -> Self {
        Self {
            focal,
            centre: Vec2::new((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0),
            radial: [0.0; 2],
            readout: 0.0,
        }
    }

    /// Its parameters.
    #[must_use]
    pub fn parameters(&self) -> Parameters {
        let [k1, k2] = self.radial;
        Parameters::from([
            self.focal.ln(),
            k1,
            k2,
            self.centre.x,
            self.centre.y,
            self.readout,
        ])
    }

    /// The camera with these parameters.
    #[must_use]
    pub fn from_parameters(parameters: &Parameters) -> Self {
        let [log_focal, k1, k2, cx, cy, readout] = (*parameters).into();
        Self {
            focal: log_focal.exp(),
            centre: Vec2::new(cx, cy),
            radial: [k1, k2],
            readout,
        }
    }

    /// This camera for images of another size; `None` where its numbers are not those of a real
    /// one.
    #[must_use]
    pub fn camera(&self, (width, height): (usize, usize)) -> Option<Camera> {
        Camera::try_new(width, height, self.pinhole(), self.distortion()).ok()
    }

    fn distortion(&self) -> Distortion {
        let [k1, k2] = self.radial;
        if k1 == 0.0 && k2 == 0.0 {
            return Distortion::None;
        }
        Distortion::RadialTangential {
            k1,
            k2,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        }
    }

    /// The same camera for images enlarged by `factor`.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let half = Vec2::repeat(0.5);
        Self {
            focal: self.focal * factor,
            centre: (self.centre + half) * factor - half,
            ..*self
        }
    }

    /// Where the camera would see the same direction without distortion, px; `None` where the model
    /// cannot be inverted.
    #[must_use]
    pub fn undistort(&self, pixel: &Vec2) -> Option<Vec2> {
        let ideal = (self.distortion()).undistort(&((pixel - self.centre) / self.focal))?;
        Some(ideal * self.focal + self.centre)
    }

    /// The pinhole that belongs to [`undistort`](Self::undistort).
    pub(crate) fn pinhole(&self) -> Pinhole {
        Pinhole::new(self.focal, self.focal, self.centre.x, self.centre.y)
    }

    /// Pixel of a point in the camera's frame; `None` where it is not in front of the camera.
    #[must_use]
    pub fn project(&self, point: &Vec3) -> Option<Vec2> {
        // NaN fails as well
        (point.z > MIN_FORWARD * point.norm()).then(|| {
            let ideal = point.xy() / point.z;
            let [k1, k2] = self.radial;
            let r2 = ideal.norm_squared();
            self.centre + ideal * (self.focal * (1.0 + r2 * (k1 + k2 * r2)))
        })
    }

    /// [`project`](Self::project) with its derivatives.
    pub(crate) fn linearise(&self, point: &Vec3) -> Option<Projection> {
        let pixel = self.project(point)?;
        let f = self.focal;
        let (x, y) = (point.x / point.z, point.y / point.z);
        let [k1, k2] = self.radial;
        let r2 = x * x + y * y;
        // u = f d x with d = 1 + k1 r² + k2 r⁴, d' = 2 slope (x, y)
        let (d, slope) = (1.0 + r2 * (k1 + k2 * r2), k1 + 2.0 * k2 * r2);
        let by_parameters = SMatrix::<f64, 2, NUM_PARAMETERS>::new(
            f * d * x,
            f * r2 * x,
            f * r2 * r2 * x,
            1.0,
            0.0,
            0.0,
            f * d * y,
            f * r2 * y,
            f * r2 * r2 * y,
            0.0,
            1.0,
            0.0,
        );
        let mixed = 2.0 * f * slope * x * y;
        let by_ideal = SMatrix::<f64, 2, 2>::new(
            f * (d + 2.0 * slope * x * x),
            mixed,
            mixed,
            f * (d + 2.0 * slope * y * y),
        );
        let ideal_by_point = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -x, 0.0, 1.0, -y) / point.z;
        Some(Projection {
            pixel,
            by_parameters,
            by_point: by_ideal * ideal_by_point,
        })
    }
}

/// What is known of a camera before it is seen to move: independent Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Expected parameters.
    pub mean: Parameters,
    /// Standard deviations; small ones hold a parameter.
    pub sigma: Parameters,
}

impl Prior {
    /// An ordinary camera: a field of view of `fov_deg` along the longer side, little distortion
    /// and a principal point near the centre.
    ///
    /// The focal length is left within a factor of about 1.4, `k1` within 0.15, `k2` within 0.05,
    /// the principal point within 0.4 % of the longer side, the readout within half of the time
    /// from frame to frame (one standard deviation each).
    #[must_use]
    pub fn ordinary(fov_deg: f64, size: (usize, usize)) -> Self {
        let longer = size.0.max(size.1) as f64;
        let focal = longer / 2.0 / (fov_deg.to_radians() / 2.0).tan();
        let centre_px = 0.004 * longer;
        Self {
            mean: Intrinsics::centred(focal, size).parameters(),
            sigma: Parameters::from([0.35, 0.15, 0.05, centre_px, centre_px, 0.5]),
        }
    }

    /// The same for a camera that reads all rows at once.
    #[must_use]
    pub fn with_global_shutter(mut self) -> Self {
        self.mean[READOUT] = 0.0;
        self.sigma[READOUT] = 1e-6;
        self
    }

    /// Information of the prior.
    pub(crate) fn information(&self) -> ParameterMatrix {
        ParameterMatrix::from_diagonal(&self.sigma.map(|sigma| 1.0 / (sigma * sigma)))
    }
}

#[cfg(test)]
mod tests {
    use super::{Intrinsics, NUM_PARAMETERS};
    use monogrid_geometry::{Vec2, Vec3};

    fn lens() -> Intrinsics {
        Intrinsics {
            focal: 512.0,
            centre: Vec2::new(318.0, 251.0),
            radial: [0.21, -0.37],
            readout: 0.0,
        }
    }

    #[test]
    fn derivatives_are_those_of_the_projection() {
        let (lens, point) = (lens(), Vec3::new(0.7, -0.5, 2.1));
        let exact = lens.linearise(&point).unwrap();
        let step = 1e-6;
        for k in 0..NUM_PARAMETERS {
            let moved = |by: f64| {
                let mut parameters = lens.parameters();
                parameters[k] += by;
                Intrinsics::from_parameters(&parameters)
                    .project(&point)
                    .unwrap()
            };
            let numeric = (moved(step) - moved(-step)) / (2.0 * step);
            let error = (exact.by_parameters.column(k) - numeric).norm();
            assert!(error < 1e-5, "parameter {k}: {error}");
        }
        for k in 0..3 {
            let moved = |by: f64| {
                let mut point = point;
                point[k] += by;
                lens.project(&point).unwrap()
            };
            let numeric = (moved(step) - moved(-step)) / (2.0 * step);
            let error = (exact.by_point.column(k) - numeric).norm();
            assert!(error < 1e-5, "coordinate {k}: {error}");
        }
    }

    #[test]
    fn undistorting_and_scaling() {
        let (lens, point) = (lens(), Vec3::new(0.3, -0.2, 1.0));
        let pixel = lens.project(&point).unwrap();
        let ideal = lens.undistort(&pixel).unwrap();
        assert!((lens.pinhole().unproject(&ideal) - point).norm() < 1e-6);
        let twice = lens.scaled(2.0).project(&point).unwrap();
        assert!((twice - (pixel + Vec2::repeat(0.5)) * 2.0 + Vec2::repeat(0.5)).norm() < 1e-9);
        assert_eq!(lens.project(&Vec3::new(0.0, 0.0, -1.0)), None);
    }
}
