//! The calibration of the second camera of a stereo pair.

use super::document::Document;
use super::{Images, cameras, kitti};
use crate::text::{data_lines, read_text};
use crate::trajectory::pose_from_matrix;
use crate::{Calibration, DatasetError};
use monogrid_geometry::{Camera, Distortion, Rotation, Se3, Vec3};
use std::path::Path;

/// How far the cameras of a pair are from each other, m.
const BASELINE_M: std::ops::RangeInclusive<f64> = 0.001..=1000.0;

/// The second camera of a stereo pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondCamera {
    /// As its images were taken.
    pub camera: Camera,
    /// With the translation in metres.
    pub second_from_first: Se3,
}

impl SecondCamera {
    /// By the files of both cameras (EuRoC's `sensor.yaml`), which say where these are in the body;
    /// `None` where they do not.
    pub(crate) fn of_sensors(
        files: [&Path; 2],
        image_size: (usize, usize),
    ) -> Result<Option<Self>, DatasetError> {
        let images = Images {
            size: Some(image_size),
            folder: None,
        };
        let [first, second] = files.map(|path| Calibration::read_for(path, images));
        let (first, second) = (first?, second?);
        let places = first.body_from_camera.zip(second.body_from_camera);
        let found = places.map(|(body_from_first, body_from_second)| Self {
            camera: second.camera,
            second_from_first: body_from_second.inverse() * body_from_first,
        });
        found.map(|found| found.check(files[1])).transpose()
    }

    fn check(self, path: &Path) -> Result<Self, DatasetError> {
        let refused = |reason: String| DatasetError::calibration(path, reason);
        let valid = self.camera.validate();
        valid.map_err(|error| refused(format!("the second camera: {error}")))?;
        let metres = self.second_from_first.translation.norm();
        if BASELINE_M.contains(&metres) {
            return Ok(self);
        }
        let [least, most] = [BASELINE_M.start(), BASELINE_M.end()];
        Err(refused(format!(
            "the cameras of the pair are {metres:e} m from each other, expected {least} to {most}"
        )))
    }

    /// By one file for both cameras: Kalibr's chain, or KITTI's projection matrices of the cameras
    /// with these numbers (`["0", "1"]`, `["00", "01"]`), whose images have this size; `None` where
    /// it is not for two.
    pub(crate) fn of_file(
        path: &Path,
        numbers: [&str; 2],
        image_size: (usize, usize),
    ) -> Result<Option<Self>, DatasetError> {
        let text = read_text(path)?;
        let chained = of_chain(&text, path, image_size)?;
        let found = chained.or_else(|| of_projections(&text, numbers, image_size));
        found.map(|found| found.check(path)).transpose()
    }
}

/// By Kalibr's chain of cameras, each of which says how it sees the one before it.
fn of_chain(
    text: &str,
    path: &Path,
    image_size: (usize, usize),
) -> Result<Option<SecondCamera>, DatasetError> {
    let Some(second) = Document::yaml(text).below("cam1") else {
        return Ok(None);
    };
    let matrix = second.list(&["t_cn_cnm1"], path)?;
    let Some(second_from_first) = matrix.and_then(|m| pose_from_matrix(&m)) else {
        return Ok(None);
    };
    let calibration = cameras::parse(&second, path, Some(image_size))?.check(path)?;
    Ok(Some(SecondCamera {
        camera: calibration.camera,
        second_from_first,
    }))
}

/// By KITTI's projection matrices of rectified images, `P0` and `P1` or `P_rect_00` and
/// `P_rect_01`: both cameras look in one direction, and the fourth column says how far they are
/// from a common origin, in px times metres.
fn of_projections(
    text: &str,
    cameras: [&str; 2],
    (width, height): (usize, usize),
) -> Option<SecondCamera> {
    let lines: Vec<(usize, &str)> = data_lines(text).collect();
    let first = kitti::projection_of(&lines, cameras[0])?;
    let second = kitti::projection_of(&lines, cameras[1])?;
    let offset = |m: &[f64; 12]| Vec3::new(m[3] / m[0], m[7] / m[5], 0.0);
    Some(SecondCamera {
        camera: Camera {
            width,
            height,
            pinhole: kitti::projection(&second),
            distortion: Distortion::None,
        },
        second_from_first: Se3::new(Rotation::identity(), offset(&second) - offset(&first)),
    })
}
