//! Camera models: an ideal pinhole, and a calibrated camera that adds lens distortion.
//!
//! All pixels follow the convention of the crate: the centre of the top-left pixel is (0, 0).

use crate::{Distortion, Vec2, Vec3};

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
    /// Points with less depth than this, in the unit of the scene, count as beside or behind the
    /// camera.
    pub const MIN_DEPTH: f64 = 1e-6;

    /// Intrinsics from four numbers in pixels.
    #[must_use]
    pub fn new(fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self { fx, fy, cx, cy }
    }

    /// A camera with square pixels that looks along the middle of its image.
    #[must_use]
    pub fn centred(focal_px: f64, width: usize, height: usize) -> Self {
        let [cx, cy] = [width, height].map(|length| 0.5 * (length as f64 - 1.0));
        Self::new(focal_px, focal_px, cx, cy)
    }

    /// Pixel of a point in the camera frame; meaningful only for `z > 0`.
    #[must_use]
    #[inline]
    pub fn project(&self, point_in_camera: &Vec3) -> Vec2 {
        let inv_z = 1.0 / point_in_camera.z;
        Vec2::new(
            self.fx * point_in_camera.x * inv_z + self.cx,
            self.fy * point_in_camera.y * inv_z + self.cy,
        )
    }

    /// Direction of a pixel with `z = 1` ("bearing per unit depth").
    #[must_use]
    #[inline]
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
    /// A parameter of the lens with which it sees nothing.
    #[error("calibration value {name} is {value}, expected {expected}")]
    Lens {
        /// Which parameter.
        name: &'static str,
        /// What was found.
        value: f64,
        /// What the model allows.
        expected: &'static str,
    },
    /// A focal length that no lens has.
    #[error(
        "focal length {name} is {value} px for an image {size} px wide, expected between {min:.0} \
         and {max:.0}; is it given relative to the image size, or in millimetres?"
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
        "principal point ({cx}, {cy}) is outside the {width}x{height} image; expected near its \
         centre"
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
        self.distortion.validate()?;
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
        if point_in_camera.z.is_nan() || point_in_camera.z <= 0.0 {
            return None;
        }
        let ideal = point_in_camera.xy() / point_in_camera.z;
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
