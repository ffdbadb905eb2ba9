//! Camera models: pinhole with radial-tangential, FOV or equidistant distortion.
//!
//! All pixels follow the convention of the crate: the centre of the top-left pixel is (0, 0).

use crate::{Vec2, Vec3};

/// Intrinsics of an ideal pinhole camera, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Horizontal focal length, px.
    pub fx: f64,
    /// Vertical focal length, px.
    pub fy: f64,
    /// Horizontal principal point, px.
    pub cx: f64,
    /// Vertical principal point, px.
    pub cy: f64,
}

impl Pinhole {
    /// Intrinsics from four numbers in pixels.
    #[must_use]
    pub fn new(fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self { fx, fy, cx, cy }
    }

    /// Pixel of a point in the camera frame; meaningful only for `z > 0`.
    #[must_use]
    pub fn project(&self, point_in_camera: &Vec3) -> Vec2 {
        let inv_z = 1.0 / point_in_camera.z;
        Vec2::new(
            self.fx * point_in_camera.x * inv_z + self.cx,
            self.fy * point_in_camera.y * inv_z + self.cy,
        )
    }

    /// Direction of a pixel with `z = 1` ("bearing per unit depth").
    #[must_use]
    pub fn unproject(&self, pixel: &Vec2) -> Vec3 {
        Vec3::new(
            (pixel.x - self.cx) / self.fx,
            (pixel.y - self.cy) / self.fy,
            1.0,
        )
    }

    /// The same camera at half the resolution, where each pixel covers 2x2 of the old ones.
    ///
    /// The centre of the new pixel (0, 0) is at (0.5, 0.5) of the old image, hence the half pixel.
    #[must_use]
    pub fn half(&self) -> Self {
        self.scaled(0.5, 0.5)
    }

    /// The same camera for an image resampled by the given factors (new size over old size).
    #[must_use]
    pub fn scaled(&self, factor_x: f64, factor_y: f64) -> Self {
        Self::new(
            self.fx * factor_x,
            self.fy * factor_y,
            (self.cx + 0.5) * factor_x - 0.5,
            (self.cy + 0.5) * factor_y - 0.5,
        )
    }

    /// The same camera for an image whose first `left` columns and `top` rows were cut off.
    #[must_use]
    pub fn cropped(&self, left: f64, top: f64) -> Self {
        Self::new(self.fx, self.fy, self.cx - left, self.cy - top)
    }
}

/// Lens distortion, acting on normalised image coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Distortion {
    /// Ideal pinhole.
    #[default]
    None,
    /// OpenCV's radial-tangential model.
    RadialTangential {
        /// Radial, second order.
        k1: f64,
        /// Radial, fourth order.
        k2: f64,
        /// Tangential.
        p1: f64,
        /// Tangential.
        p2: f64,
        /// Radial, sixth order.
        k3: f64,
    },
    /// FOV (ATAN) model of Devernay and Faugeras, as in PTAM and LSD-SLAM.
    Fov {
        /// Field-of-view parameter, rad.
        omega: f64,
    },
    /// Equidistant (Kannala-Brandt) fisheye with four coefficients, as OpenCV's `fisheye`.
    Equidistant {
        /// Coefficients of theta^3, theta^5, theta^7, theta^9.
        k: [f64; 4],
    },
}

/// What is wrong with a calibration.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum CameraError {
    /// Image without area.
    #[error("image size is {width}x{height}, expected both at least 1 pixel")]
    Size {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
    /// A parameter is NaN or infinite.
    #[error("calibration value {name} is {value}, expected a finite number")]
    NotFinite {
        /// Which parameter.
        name: &'static str,
        /// What was found.
        value: f64,
    },
    /// A focal length that no lens has.
    #[error(
        "focal length {name} is {value} px for an image {size} px wide, expected between {min:.0} and \
         {max:.0}; is it given relative to the image size, or in millimetres?"
    )]
    FocalLength {
        /// `fx` or `fy`.
        name: &'static str,
        /// What was found.
        value: f64,
        /// Image size along this axis.
        size: usize,
        /// Smallest accepted.
        min: f64,
        /// Largest accepted.
        max: f64,
    },
    /// Principal point far outside the image.
    #[error(
        "principal point ({cx}, {cy}) is outside the {width}x{height} image; expected near its centre"
    )]
    PrincipalPoint {
        /// Found x.
        cx: f64,
        /// Found y.
        cy: f64,
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
}

/// A camera as it was calibrated: size, intrinsics and distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width, px.
    pub width: usize,
    /// Image height, px.
    pub height: usize,
    /// Intrinsics.
    pub pinhole: Pinhole,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl Camera {
    /// A checked camera.
    ///
    /// # Errors
    /// When a value is not finite or cannot be that of a real camera.
    pub fn try_new(
        width: usize,
        height: usize,
        pinhole: Pinhole,
        distortion: Distortion,
    ) -> Result<Self, CameraError> {
        let camera = Self {
            width,
            height,
            pinhole,
            distortion,
        };
        camera.validate()?;
        Ok(camera)
    }

    /// Checks every parameter.
    ///
    /// # Errors
    /// The first parameter that cannot be that of a real camera.
    pub fn validate(&self) -> Result<(), CameraError> {
        let (width, height) = (self.width, self.height);
        if width == 0 || height == 0 {
            return Err(CameraError::Size { width, height });
        }
        let Pinhole { fx, fy, cx, cy } = self.pinhole;
        let named = [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)];
        let distortion = self.distortion.parameters();
        for (name, value) in named.iter().chain(distortion.iter()).copied() {
            if !value.is_finite() {
                return Err(CameraError::NotFinite { name, value });
            }
        }
        for (name, value, size) in [("fx", fx, width), ("fy", fy, height)] {
            // 0.05: beyond any fisheye; 50: a field of view of one degree.
            let longest = width.max(height) as f64;
            let (min, max) = (0.05 * longest, 50.0 * longest);
            if !(min..=max).contains(&value) {
                return Err(CameraError::FocalLength {
                    name,
                    value,
                    size,
                    min,
                    max,
                });
            }
        }
        let inside = |c: f64, size: usize| c > -0.5 * size as f64 && c < 1.5 * size as f64;
        if !inside(cx, width) || !inside(cy, height) {
            return Err(CameraError::PrincipalPoint {
                cx,
                cy,
                width,
                height,
            });
        }
        Ok(())
    }

    /// Distorted pixel of a point in the camera frame; `None` behind the camera or beyond the angle
    /// up to which the distortion model is one-to-one.
    #[must_use]
    pub fn project(&self, point_in_camera: &Vec3) -> Option<Vec2> {
        if point_in_camera.z <= 0.0 {
            return None;
        }
        let ideal = Vec2::new(
            point_in_camera.x / point_in_camera.z,
            point_in_camera.y / point_in_camera.z,
        );
        let distorted = self.distortion.distort(&ideal)?;
        Some(Vec2::new(
            self.pinhole.fx * distorted.x + self.pinhole.cx,
            self.pinhole.fy * distorted.y + self.pinhole.cy,
        ))
    }

    /// Viewing direction of a pixel with `z = 1`; `None` where the model cannot be inverted.
    #[must_use]
    pub fn unproject(&self, pixel: &Vec2) -> Option<Vec3> {
        let distorted = self.pinhole.unproject(pixel).xy();
        let ideal = self.distortion.undistort(&distorted)?;
        Some(Vec3::new(ideal.x, ideal.y, 1.0))
    }

    /// Full horizontal field of view in degrees, through the middle row.
    #[must_use]
    pub fn horizontal_fov_deg(&self) -> f64 {
        let row = (self.height as f64 - 1.0) / 2.0;
        let angle = |x: f64| {
            self.unproject(&Vec2::new(x, row))
                .map_or(f64::NAN, |d| d.x.atan())
        };
        (angle(self.width as f64 - 0.5) - angle(-0.5)).to_degrees()
    }
}

impl Distortion {
    /// Names and values of the parameters.
    #[must_use]
    pub fn parameters(&self) -> Vec<(&'static str, f64)> {
        match *self {
            Self::None => vec![],
            Self::RadialTangential { k1, k2, p1, p2, k3 } => {
                vec![("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3)]
            }
            Self::Fov { omega } => vec![("omega", omega)],
            Self::Equidistant { k } => {
                vec![("k1", k[0]), ("k2", k[1]), ("k3", k[2]), ("k4", k[3])]
            }
        }
    }

    /// Distorted from ideal normalised coordinates; `None` where the model folds over.
    #[must_use]
    pub fn distort(&self, ideal: &Vec2) -> Option<Vec2> {
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        match *self {
            Self::None => Some(*ideal),
            Self::RadialTangential { k1, k2, p1, p2, k3 } => {
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                // d(r * radial)/dr must stay positive, else two angles share one pixel.
                let slope = 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3));
                if slope <= 0.0 || radial <= 0.0 {
                    return None;
                }
                Some(Vec2::new(
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                ))
            }
            Self::Fov { omega } => {
                let r = r2.sqrt();
                if omega.abs() < 1e-6 || r < 1e-9 {
                    // limit r -> 0 of the factor below
                    let factor = if omega.abs() < 1e-6 {
                        1.0
                    } else {
                        2.0 * (0.5 * omega).tan() / omega
                    };
                    return Some(ideal * factor);
                }
                let distorted = (2.0 * r * (0.5 * omega).tan()).atan() / omega;
                Some(ideal * (distorted / r))
            }
            Self::Equidistant { k } => {
                let r = r2.sqrt();
                if r < 1e-9 {
                    return Some(*ideal);
                }
                let theta = r.atan();
                let (distorted, slope) = equidistant(theta, &k);
                (slope > 0.0).then(|| ideal * (distorted / r))
            }
        }
    }

    /// Ideal from distorted normalised coordinates; `None` outside the range of the model.
    #[must_use]
    pub fn undistort(&self, distorted: &Vec2) -> Option<Vec2> {
        match *self {
            Self::None => Some(*distorted),
            Self::RadialTangential { .. } => self.undistort_newton(distorted),
            Self::Fov { omega } => {
                let r = distorted.norm();
                if omega.abs() < 1e-6 {
                    return Some(*distorted);
                }
                let angle = r * omega;
                if angle.abs() >= std::f64::consts::FRAC_PI_2 {
                    return None;
                }
                let denominator = 2.0 * (0.5 * omega).tan();
                let factor = if r < 1e-9 {
                    omega / denominator
                } else {
                    angle.tan() / denominator / r
                };
                Some(distorted * factor)
            }
            Self::Equidistant { k } => {
                let r = distorted.norm();
                if r < 1e-9 {
                    return Some(*distorted);
                }
                let theta = invert_equidistant(r, &k)?;
                (theta < std::f64::consts::FRAC_PI_2 - 1e-6).then(|| distorted * (theta.tan() / r))
            }
        }
    }

    /// Newton's method on [`Self::distort`] with a numeric Jacobian.
    fn undistort_newton(&self, distorted: &Vec2) -> Option<Vec2> {
        let mut ideal = *distorted;
        for _ in 0..30 {
            let Some(value) = self.distort(&ideal) else {
                // stepped beyond the fold: come back towards the axis
                ideal *= 0.7;
                continue;
            };
            let error = value - distorted;
            if error.norm() < 1e-13 {
                return Some(ideal);
            }
            let h = 1e-7;
            let dx = (self.distort(&(ideal + Vec2::new(h, 0.0)))? - value) / h;
            let dy = (self.distort(&(ideal + Vec2::new(0.0, h)))? - value) / h;
            let jacobian = nalgebra::Matrix2::from_columns(&[dx, dy]);
            ideal -= jacobian.lu().solve(&error)?;
        }
        let error = self.distort(&ideal)? - distorted;
        (error.norm() < 1e-9).then_some(ideal)
    }
}

/// Distorted radius and its derivative for the angle `theta`.
fn equidistant(theta: f64, k: &[f64; 4]) -> (f64, f64) {
    let t2 = theta * theta;
    let value = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    let slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])));
    (value, slope)
}

/// Angle with the distorted radius `r`, by Newton's method.
fn invert_equidistant(r: f64, k: &[f64; 4]) -> Option<f64> {
    let mut theta = r.min(std::f64::consts::FRAC_PI_2);
    for _ in 0..30 {
        let (value, slope) = equidistant(theta, k);
        if slope <= 0.0 {
            return None;
        }
        let step = (value - r) / slope;
        theta -= step;
        if step.abs() < 1e-14 {
            return (theta >= 0.0).then_some(theta);
        }
    }
    None
}
