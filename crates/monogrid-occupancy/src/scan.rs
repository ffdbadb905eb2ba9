//! What is put into a map: range measurements from one place, with their uncertainty.

use std::ops::{ControlFlow, Range};

use crate::error::MapError;
use serde::{Deserialize, Serialize};

/// A similarity transform: `x_in_world = scale * rotation * x_in_sensor + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// World units per sensor unit, positive.
    pub scale: f64,
    /// Rows of the rotation matrix.
    pub rotation: [[f64; 3]; 3],
    /// In world units.
    pub translation: [f64; 3],
}

/// The inner product.
#[inline]
pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Similarity {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self {
        scale: 1.0,
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };

    /// A transform of scale 1 from the 3 x 4 matrix `[R | t]`, row by row, as scan files hold it.
    #[must_use]
    pub fn from_rigid(row_major: &[f64; 12]) -> Self {
        let [a, b, c, x, d, e, f, y, g, h, i, z] = *row_major;
        Self {
            scale: 1.0,
            rotation: [[a, b, c], [d, e, f], [g, h, i]],
            translation: [x, y, z],
        }
    }

    /// `rotation * v`.
    #[must_use]
    #[inline]
    pub fn rotate(&self, v: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|row| dot(row, v))
    }

    /// The transformed point.
    #[must_use]
    #[inline]
    pub fn transform(&self, point: [f64; 3]) -> [f64; 3] {
        let rotated = self.rotate(point);
        std::array::from_fn(|i| self.scale * rotated[i] + self.translation[i])
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let r = self.rotation;
        let rotation = std::array::from_fn(|i| std::array::from_fn(|j| r[j][i]));
        let mut inverse = Self {
            scale: 1.0 / self.scale,
            rotation,
            translation: [0.0; 3],
        };
        inverse.translation = inverse.transform(self.translation).map(|t| -t);
        inverse
    }

    /// Whether all numbers are finite, the scale positive and the rotation orthonormal to 1e-3
    /// with determinant 1.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let r = &self.rotation;
        let orthonormal = (0..3)
            .all(|i| (0..3).all(|j| (dot(r[i], r[j]) - f64::from(u8::from(i == j))).abs() < 1e-3));
        let cross = [
            r[0][1] * r[1][2] - r[0][2] * r[1][1],
            r[0][2] * r[1][0] - r[0][0] * r[1][2],
            r[0][0] * r[1][1] - r[0][1] * r[1][0],
        ];
        orthonormal
            && dot(cross, r[2]) > 0.0
            && self.scale.is_finite()
            && self.scale > 0.0
            && self.translation.iter().all(|t| t.is_finite())
    }
}

/// Uncertainty of the sensor's pose relative to its neighbours, added to that of each range:
/// `sigma^2 + translation^2 + (range * rotation_rad)^2`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseSigma {
    /// Standard deviation of the position, in world units.
    pub translation: f64,
    /// Standard deviation of the direction, in radians.
    pub rotation_rad: f64,
}

/// Points in the sensor frame, measured from its origin.
#[derive(Clone, Copy, Debug)]
pub struct PointScan<'a> {
    /// End points, in sensor units.
    pub points: &'a [[f32; 3]],
    /// Standard deviation of each range in sensor units, or one value for all.
    pub sigmas: &'a [f32],
}

/// One pixel of a semi-dense depth image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthPixel {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// Inverse depth along the optical axis, 1 / sensor unit.
    pub idepth: f32,
    /// Standard deviation of the inverse depth.
    pub sigma_idepth: f32,
}

/// A semi-dense depth image of a pinhole camera (x right, y down, z forward; the centre of the
/// top-left pixel is (0, 0)).
#[derive(Clone, Copy, Debug)]
pub struct DepthScan<'a> {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal length along x in pixels.
    pub fx: f64,
    /// Focal length along y in pixels.
    pub fy: f64,
    /// Principal point along x in pixels.
    pub cx: f64,
    /// Principal point along y in pixels.
    pub cy: f64,
    /// The pixels that have a depth.
    pub pixels: &'a [DepthPixel],
}

/// A complete depth image as a camera delivers it (axes as of [`DepthScan`]).
///
/// The rule `fused` takes it as an image: no point is made of a pixel, and of pixels much finer
/// than cells some stand for all.
#[derive(Clone, Copy, Debug)]
pub struct DepthImage<'a> {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal length along x in pixels.
    pub fx: f64,
    /// Focal length along y in pixels.
    pub fy: f64,
    /// Principal point along x in pixels.
    pub cx: f64,
    /// Principal point along y in pixels.
    pub cy: f64,
    /// Depths along the optical axis in sensor units, row by row; what is not positive and finite
    /// is no measurement.
    pub depths: &'a [f32],
    /// Standard deviation of each range in sensor units, or one value for all.
    pub sigmas: &'a [f32],
}

impl DepthImage<'_> {
    /// Depth and standard deviation of the range of pixel `index`; `None` if it has no measurement.
    #[inline]
    pub(crate) fn measured(&self, index: usize) -> Option<(f32, f32)> {
        let depth = self.depths[index];
        let sigma = self.sigmas[index.min(self.sigmas.len() - 1)];
        // Written so that NaN fails.
        let is_usable = depth > 1e-9 && depth < 1e8 && sigma > 0.0 && sigma < 1e9;
        is_usable.then_some((depth, sigma))
    }
}

/// The measurements of a scan.
#[derive(Clone, Copy, Debug)]
pub enum ScanData<'a> {
    /// Arbitrary points around an origin (lidar, any depth camera).
    Points(PointScan<'a>),
    /// Some pixels of a pinhole camera, each with its depth.
    Depth(DepthScan<'a>),
    /// All pixels of a pinhole camera.
    Image(DepthImage<'a>),
}

/// Measurements from one pose.
#[derive(Clone, Copy, Debug)]
pub struct Scan<'a> {
    /// Identity; scans of one map are taken in the order of their ids.
    pub id: u32,
    /// Pose of the sensor.
    pub world_from_sensor: Similarity,
    /// Uncertainty of that pose.
    pub pose_sigma: PoseSigma,
    /// The measurements.
    pub data: ScanData<'a>,
}

impl<'a> Scan<'a> {
    /// Points in the sensor frame with the standard deviation of each range (or one for all), from
    /// an exact pose.
    #[must_use]
    pub fn of_points(
        id: u32,
        world_from_sensor: Similarity,
        points: &'a [[f32; 3]],
        sigmas: &'a [f32],
    ) -> Self {
        Self {
            id,
            world_from_sensor,
            pose_sigma: PoseSigma::default(),
            data: ScanData::Points(PointScan { points, sigmas }),
        }
    }
}

/// What the standard deviation of an inverse depth is taken for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SigmaMode {
    /// Propagated to the range: `kappa sigma_d / d^2`, kappa the ray's length per unit depth.
    #[default]
    Range,
    /// Used as if it were a range, as the thesis may have done.
    RawInverseDepth,
}

/// One usable measurement in the sensor frame and sensor units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measurement {
    pub point: [f64; 3],
    pub range: f64,
    pub sigma: f64,
}

impl Scan<'_> {
    /// Measurements, usable or not.
    #[must_use]
    pub fn len(&self) -> usize {
        match self.data {
            ScanData::Points(scan) => scan.points.len(),
            ScanData::Depth(scan) => scan.pixels.len(),
            ScanData::Image(image) => image.depths.len(),
        }
    }

    /// Focal lengths of the camera along x and y, if it is one.
    pub(crate) fn focal(&self) -> Option<[f64; 2]> {
        match self.data {
            ScanData::Points(_) => None,
            ScanData::Depth(scan) => Some([scan.fx, scan.fy]),
            ScanData::Image(image) => Some([image.fx, image.fy]),
        }
    }

    /// Whether there is no measurement at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Checks what would make every measurement meaningless.
    ///
    /// # Errors
    /// An invalid pose, camera or pose uncertainty, or as many sigmas as neither 1 nor points.
    pub fn validate(&self) -> Result<(), MapError> {
        let fail = |reason: String| {
            Err(MapError::Scan {
                id: self.id,
                reason,
            })
        };
        if !self.world_from_sensor.is_valid() {
            let pose = self.world_from_sensor;
            return fail(format!(
                "world_from_sensor {pose:?} is not a finite similarity with positive scale"
            ));
        }
        let sigma = self.pose_sigma;
        let (position, rotation) = (sigma.translation, sigma.rotation_rad);
        if !(position >= 0.0 && rotation >= 0.0 && (position + rotation).is_finite()) {
            return fail(format!("pose uncertainty {sigma:?} is negative"));
        }
        let (sigmas, camera) = match self.data {
            ScanData::Points(scan) => (scan.sigmas.len(), None),
            ScanData::Depth(scan) => (1, Some([scan.fx, scan.fy, scan.cx, scan.cy])),
            ScanData::Image(image) => {
                let [width, height] = [image.width, image.height].map(u64::from);
                if image.depths.len() as u64 != width * height {
                    let depths = image.depths.len();
                    return fail(format!("{depths} depths are not {width} x {height}"));
                }
                let camera = [image.fx, image.fy, image.cx, image.cy];
                (image.sigmas.len(), Some(camera))
            }
        };
        if sigmas != self.len() && sigmas != 1 {
            let measured = self.len();
            return fail(format!(
                "{measured} measurements have {sigmas} sigmas, expected 1 or all"
            ));
        }
        if let Some([fx, fy, cx, cy]) = camera
            && !(fx.is_normal() && fy.is_normal() && cx.is_finite() && cy.is_finite())
        {
            return fail(format!(
                "camera fx {fx} fy {fy} cx {cx} cy {cy} is not usable"
            ));
        }
        Ok(())
    }

    /// Calls `take` for every usable measurement until it breaks off.
    #[inline]
    pub(crate) fn each_measurement(
        &self,
        mode: SigmaMode,
        mut take: impl FnMut(Measurement) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        match self.data {
            ScanData::Points(PointScan {
                points,
                sigmas: [sigma],
            }) => points
                .iter()
                .filter_map(|point| measured_point(*point, *sigma))
                .try_for_each(take),
            ScanData::Points(PointScan { points, sigmas }) => points
                .iter()
                .zip(sigmas)
                .filter_map(|(point, sigma)| measured_point(*point, *sigma))
                .try_for_each(take),
            ScanData::Depth(_) | ScanData::Image(_) => {
                let mut all = (0..self.len()).filter_map(|index| self.measurement(index, mode));
                all.try_for_each(&mut take)
            }
        }
    }

    /// The scan with some of its measurements; `None` for an image, which has no list of them.
    pub(crate) fn part(&self, range: Range<usize>) -> Option<Self> {
        let data = match self.data {
            ScanData::Points(scan) => ScanData::Points(PointScan {
                points: &scan.points[range.clone()],
                sigmas: match scan.sigmas {
                    one @ [_] => one,
                    all => &all[range],
                },
            }),
            ScanData::Depth(scan) => ScanData::Depth(DepthScan {
                pixels: &scan.pixels[range],
                ..scan
            }),
            ScanData::Image(_) => return None,
        };
        Some(Self { data, ..*self })
    }

    /// Measurement `index`; `None` if it is not finite, has no length or no uncertainty.
    #[inline]
    pub(crate) fn measurement(&self, index: usize, mode: SigmaMode) -> Option<Measurement> {
        match self.data {
            ScanData::Points(scan) => {
                let sigma = scan.sigmas[index.min(scan.sigmas.len() - 1)];
                measured_point(scan.points[index], sigma)
            }
            ScanData::Depth(scan) => {
                let pixel = scan.pixels[index];
                let (d, sigma_d) = (f64::from(pixel.idepth), f64::from(pixel.sigma_idepth));
                if d <= 0.0 {
                    return None;
                }
                let ray = [
                    (f64::from(pixel.x) - scan.cx) / scan.fx,
                    (f64::from(pixel.y) - scan.cy) / scan.fy,
                    1.0,
                ];
                let sigma = match mode {
                    SigmaMode::Range => {
                        let kappa = (ray[0] * ray[0] + ray[1] * ray[1] + 1.0).sqrt();
                        kappa * sigma_d / (d * d)
                    }
                    SigmaMode::RawInverseDepth => sigma_d,
                };
                usable(ray.map(|c| c / d), sigma)
            }
            ScanData::Image(image) => {
                let (depth, sigma) = image.measured(index)?;
                let (x, y) = (index % image.width as usize, index / image.width as usize);
                let z = f64::from(depth);
                let point = [
                    (x as f64 - image.cx) / image.fx * z,
                    (y as f64 - image.cy) / image.fy * z,
                    z,
                ];
                usable(point, f64::from(sigma))
            }
        }
    }
}

#[inline]
fn measured_point(point: [f32; 3], sigma: f32) -> Option<Measurement> {
    usable(point.map(f64::from), f64::from(sigma))
}

/// The measurement, if it is finite and has a length and an uncertainty.
#[inline]
fn usable(point: [f64; 3], sigma: f64) -> Option<Measurement> {
    let range = dot(point, point).sqrt();
    // Written so that NaN fails.
    let usable = range > 1e-9 && range < 1e9 && sigma > 0.0 && sigma < 1e9;
    usable.then_some(Measurement {
        point,
        range,
        sigma,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_similarity_and_its_inverse_cancel() {
        let (s, c) = 0.7_f64.sin_cos();
        let world_from_sensor = Similarity {
            scale: 2.5,
            rotation: [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
            translation: [1.0, -2.0, 3.0],
        };
        assert!(world_from_sensor.is_valid());
        let point = [0.3, 4.0, -5.0];
        let there = world_from_sensor.transform(point);
        let back = world_from_sensor.inverse().transform(there);
        for axis in 0..3 {
            assert!((back[axis] - point[axis]).abs() < 1e-12);
        }
    }

    #[test]
    fn the_range_of_a_pixel_has_the_sigma_of_its_inverse_depth_by_numeric_derivative() {
        let range_at = |idepth: f32| {
            let pixels = [DepthPixel {
                x: 500,
                y: 17,
                idepth,
                sigma_idepth: 0.01,
            }];
            let scan = Scan {
                id: 0,
                world_from_sensor: Similarity::IDENTITY,
                pose_sigma: PoseSigma::default(),
                data: ScanData::Depth(DepthScan {
                    width: 640,
                    height: 480,
                    fx: 481.0,
                    fy: 480.0,
                    cx: 319.5,
                    cy: 239.5,
                    pixels: &pixels,
                }),
            };
            scan.measurement(0, SigmaMode::Range).unwrap()
        };
        let step = 1e-3_f32;
        let slope = (range_at(0.5 + step).range - range_at(0.5 - step).range) / (2e-3);
        let sigma = range_at(0.5).sigma;
        assert!(
            (sigma + slope * 0.01).abs() < 1e-3 * sigma,
            "{sigma} {slope}"
        );
    }

    #[test]
    fn unusable_measurements_are_none_and_unusable_scans_an_error() {
        let points = [[f32::NAN, 0.0, 1.0], [0.0; 3], [0.0, 0.0, 2.0]];
        let mut scan = Scan {
            id: 3,
            world_from_sensor: Similarity::IDENTITY,
            pose_sigma: PoseSigma::default(),
            data: ScanData::Points(PointScan {
                points: &points,
                sigmas: &[0.1],
            }),
        };
        assert!(scan.validate().is_ok());
        assert!(scan.measurement(0, SigmaMode::Range).is_none());
        assert!(scan.measurement(1, SigmaMode::Range).is_none());
        assert!(scan.measurement(2, SigmaMode::Range).is_some());
        scan.world_from_sensor.scale = 0.0;
        assert!(matches!(scan.validate(), Err(MapError::Scan { id: 3, .. })));
    }
}
