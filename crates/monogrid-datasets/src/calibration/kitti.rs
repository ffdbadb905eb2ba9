//! KITTI's calibrations: lines of a label and numbers, or a projection matrix alone.
//!
//! Odometry has `P0: ...`, raw recordings have for each camera `S_00`, `K_00` and `D_00` (size,
//! matrix and lens of the images as they were taken) and `S_rect_00` and `P_rect_00` (of the
//! rectified ones): which of them belong to the images, their size says.

use super::{Images, lens};
use crate::text::numbers;
use crate::{Calibration, DatasetError};
use monogrid_geometry::{Distortion, Pinhole};
use std::path::Path;

/// Cameras of a raw recording.
const CAMERAS: [&str; 4] = ["00", "01", "02", "03"];

/// The calibration of these lines; `None` where they are not KITTI's.
pub(super) fn parse(
    lines: &[(usize, &str)],
    path: &Path,
    images: Images<'_>,
) -> Option<Result<Calibration, DatasetError>> {
    let of_label = |label: &str| of_label(lines, label);
    let cameras = CAMERAS.map(|camera| Camera {
        name: camera,
        size: of_label(&format!("S_{camera}")),
        intrinsics: of_label(&format!("K_{camera}")),
        lens: of_label(&format!("D_{camera}")),
        rectified_size: of_label(&format!("S_rect_{camera}")),
        rectified: matrix(of_label(&format!("P_rect_{camera}"))),
    });
    let is_raw = |camera: &Camera| camera.rectified.is_some() || camera.intrinsics.is_some();
    if cameras
        .iter()
        .any(|camera| is_raw(camera) && camera.has_size())
    {
        return Some(raw(&cameras, path, images));
    }
    let labelled = of_label("P0").or_else(|| of_label("P_rect_00"));
    let first = || numbers(lines.first()?.1);
    let matrix = matrix(labelled.or_else(first))?;
    Some(alone(&matrix, path, images.size))
}

/// The numbers of a label.
fn of_label(lines: &[(usize, &str)], label: &str) -> Option<Vec<f64>> {
    let mut all = lines.iter();
    let values = all.find_map(|(_, line)| line.strip_prefix(label)?.strip_prefix(':'));
    values.and_then(numbers)
}

fn matrix(values: Option<Vec<f64>>) -> Option<[f64; 12]> {
    values?.try_into().ok()
}

/// The projection matrix of a rectified camera, by its number: of odometry, else of a raw
/// recording.
pub(super) fn projection_of(lines: &[(usize, &str)], camera: &str) -> Option<[f64; 12]> {
    let labels = [format!("P{camera}"), format!("P_rect_{camera}")];
    matrix(labels.iter().find_map(|label| of_label(lines, label)))
}

/// Whether a text has labels of KITTI in front of its numbers.
pub(super) fn has_labels(text: &str) -> bool {
    let is_label = |line: &str| {
        let label = line.trim_start().split(':').next().unwrap_or_default();
        label == "P0" || LABELS.iter().any(|start| label.starts_with(start))
    };
    text.lines().any(is_label)
}

/// What the labels of a raw recording begin with.
const LABELS: [&str; 3] = ["P_rect_", "K_0", "S_rect_"];

struct Camera {
    name: &'static str,
    size: Option<Vec<f64>>,
    intrinsics: Option<Vec<f64>>,
    lens: Option<Vec<f64>>,
    rectified_size: Option<Vec<f64>>,
    rectified: Option<[f64; 12]>,
}

impl Camera {
    fn has_size(&self) -> bool {
        self.size.is_some() || self.rectified_size.is_some()
    }

    /// The rectified images, where they have this size.
    fn as_rectified(&self, size: (usize, usize)) -> Option<Pinhole> {
        is_size(self.rectified_size.as_deref(), size).then_some(())?;
        self.rectified.as_ref().map(projection)
    }

    /// The images as they were taken, where they have this size: the camera and its coefficients.
    fn as_taken(&self, size: (usize, usize)) -> Option<(Pinhole, &[f64])> {
        is_size(self.size.as_deref(), size).then_some(())?;
        let &[fx, _, cx, _, fy, cy, ..] = self.intrinsics.as_deref()? else {
            return None;
        };
        let lens = self.lens.as_deref().unwrap_or_default();
        Some((Pinhole::new(fx, fy, cx, cy), lens))
    }
}

fn is_size(found: Option<&[f64]>, (width, height): (usize, usize)) -> bool {
    found == Some(&[width as f64, height as f64][..])
}

/// The pinhole of a projection matrix.
pub(super) fn projection(matrix: &[f64; 12]) -> Pinhole {
    Pinhole::new(matrix[0], matrix[5], matrix[2], matrix[6])
}

/// The camera of a raw recording whose rectified images, or those as they were taken, have the size
/// of the images.
fn raw(
    cameras: &[Camera; 4],
    path: &Path,
    images: Images<'_>,
) -> Result<Calibration, DatasetError> {
    let size = images.size.ok_or_else(|| no_size(path))?;
    let is_asked_for = |camera: &&Camera| {
        let own = format!("image_{}", camera.name);
        images.folder == Some(own.as_str())
    };
    let (asked_for, others): (Vec<&Camera>, Vec<&Camera>) = cameras.iter().partition(is_asked_for);
    let ordered = || asked_for.iter().chain(&others);
    let rectified = ordered().find_map(|camera| Some((camera, camera.as_rectified(size)?)));
    let taken = ordered().find_map(|camera| Some((camera, camera.as_taken(size)?)));
    match (rectified, taken) {
        (Some((camera, pinhole)), taken) => {
            let format = "KITTI raw calibration, rectified images";
            let mut draft = Calibration::draft(size, pinhole, Distortion::None, format);
            draft.note(format!("camera {} is used", camera.name));
            if taken.is_some() {
                draft.note(
                    "images as they were taken have the same size: the images are taken for \
                     rectified ones",
                );
            }
            Ok(draft)
        }
        (None, Some((camera, (pinhole, coefficients)))) => {
            let distortion = match coefficients {
                [] => Distortion::None,
                coefficients => lens("opencv", coefficients, path)?,
            };
            let format = "KITTI raw calibration, images as they were taken";
            let mut draft = Calibration::draft(size, pinhole, distortion, format);
            draft.note(format!("camera {} is used", camera.name));
            Ok(draft)
        }
        (None, None) => Err(other_size(cameras, path, size)),
    }
}

fn other_size(cameras: &[Camera; 4], path: &Path, (width, height): (usize, usize)) -> DatasetError {
    let text = |size: &Vec<f64>| match size.as_slice() {
        [width, height] => format!("{width}x{height}"),
        _ => "no size".to_owned(),
    };
    let sizes = cameras
        .iter()
        .flat_map(|camera| [&camera.rectified_size, &camera.size]);
    let mut sizes: Vec<String> = sizes.flatten().map(text).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let found = format!("cameras for images of {}", sizes.join(" and "));
    DatasetError::content(
        path,
        found,
        format!("{width}x{height}, the size of the images"),
    )
}

fn no_size(path: &Path) -> DatasetError {
    let found = "a KITTI projection matrix without the size of the images";
    DatasetError::content(path, found, "images beside it, to take the size from")
}

/// A projection matrix that does not say the size of its images.
fn alone(
    matrix: &[f64; 12],
    path: &Path,
    image_size: Option<(usize, usize)>,
) -> Result<Calibration, DatasetError> {
    let size = image_size.ok_or_else(|| no_size(path))?;
    let format = "KITTI calib.txt, first camera";
    let pinhole = projection(matrix);
    Ok(Calibration::draft(size, pinhole, Distortion::None, format))
}
