//! Depth images and the camera that took them.

use super::accepted::SMALL_FILE_PIXELS;
use super::decode::{decode_raster, image_of, read_image_file};
use super::raster::Samples;
use crate::calibration::camera_from_numbers;
use crate::text::{data_lines, numbers, read_text};
use crate::{DatasetError, pose_from_numbers};
use monogrid_geometry::{Camera, Se3};
use monogrid_image::Image;
use std::path::Path;

/// The camera of the depth images, their unit, and where it sits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthCalibration {
    /// Intrinsics, distortion and size of the depth images.
    pub camera: Camera,
    /// Stored value of one metre (5000 for TUM RGB-D, 1000 for millimetres).
    pub units_per_metre: f64,
    /// Pose of the depth camera in the colour camera.
    pub colour_from_depth: Se3,
}

/// Most pixels of a depth image, however large its file is: depth cameras have one million, those
/// that are registered to a colour camera as many as that.
const MAX_DEPTH_PIXELS: usize = SMALL_FILE_PIXELS;

/// Units per metre of TUM RGB-D depth images.
pub const TUM_UNITS_PER_METRE: f64 = 5000.0;

impl DepthCalibration {
    /// Depth images registered to the colour camera, in the units of TUM RGB-D.
    #[must_use]
    pub fn registered(colour: Camera) -> Self {
        Self {
            camera: colour,
            units_per_metre: TUM_UNITS_PER_METRE,
            colour_from_depth: Se3::identity(),
        }
    }

    /// Reads `calibration_depth.txt`: a line `fx fy cx cy [k1 k2 p1 p2 [k3]] width height`, a line
    /// with the units per metre, and optionally a line `tx ty tz qx qy qz qw` with the pose of the
    /// depth camera in the colour camera (metres).
    ///
    /// # Errors
    /// When a line is missing or is not of this form, or the numbers are not those of a camera.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let text = read_text(path)?;
        let lines: Vec<(usize, &str)> = data_lines(&text).collect();
        let (camera_line, units_line) = match lines.as_slice() {
            [camera, units] | [camera, units, _] => (*camera, *units),
            other => {
                let found = format!("{} lines", other.len());
                let expected =
                    "a camera line, a line with the units per metre and optionally a pose";
                return Err(DatasetError::content(path, found, expected));
            }
        };
        let values = numbers(camera_line.1).unwrap_or_default();
        let wrong = |(number, line): (usize, &str), expected| {
            DatasetError::line(path, number, line, expected)
        };
        let units: Option<f64> = units_line.1.parse().ok();
        let units = units.filter(|u| u.is_finite() && *u > 0.0);
        let pose_in_colour = |line: &(usize, &str)| {
            let pose = numbers(line.1).and_then(|values| pose_from_numbers(&values));
            let expected =
                "tx ty tz qx qy qz qw, the pose of the depth camera in the colour camera";
            pose.ok_or_else(|| wrong(*line, expected))
        };
        Ok(Self {
            camera: camera_from_numbers(&values, path, camera_line)?,
            units_per_metre: units
                .ok_or_else(|| wrong(units_line, "units per metre, a positive number"))?,
            colour_from_depth: lines.get(2).map_or(Ok(Se3::identity()), pose_in_colour)?,
        })
    }
}

/// Reads a 16-bit depth image: metres along the optical axis, NaN where the sensor saw nothing.
///
/// # Errors
/// When the file cannot be read, is damaged, or does not have 16 bits per pixel.
pub fn read_depth(path: &Path, units_per_metre: f64) -> Result<Image<f32>, DatasetError> {
    decode_depth(&read_image_file(path)?, units_per_metre, path)
}

/// Decodes a 16-bit depth image; `path` is only for messages.
///
/// 0 and 65535 (saturated, or the mark of 7-Scenes for "no measurement") are unknown.
///
/// # Errors
/// As [`read_depth`].
pub fn decode_depth(
    bytes: &[u8],
    units_per_metre: f64,
    path: &Path,
) -> Result<Image<f32>, DatasetError> {
    if bytes.starts_with(&[0xff, 0xd8]) {
        let reason = "a JPEG, whose 8 bits cannot hold depth; depth must be a 16-bit PNG";
        return Err(DatasetError::image(path, reason));
    }
    let raster = decode_raster(bytes, path)?;
    let (1, Samples::Words(samples)) = (raster.channels, raster.samples) else {
        let reason = "not one channel of 16 bits, which depth must have";
        return Err(DatasetError::image(path, reason));
    };
    if samples.len() > MAX_DEPTH_PIXELS {
        let (width, height) = (raster.width, raster.height);
        let reason = format!(
            "found {width}x{height} pixels, expected at most {MAX_DEPTH_PIXELS}, more than any \
             depth camera has"
        );
        return Err(DatasetError::image(path, reason));
    }
    let metres_per_unit = 1.0 / units_per_metre;
    let depth = |v: u16| match v {
        0 | u16::MAX => f32::NAN,
        v => (f64::from(v) * metres_per_unit) as f32,
    };
    let data = samples.into_iter().map(depth).collect();
    image_of(raster.width, raster.height, data, path)
}
