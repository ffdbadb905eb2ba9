//! COLMAP's `cameras.txt`: `CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS...` in pixels, the corner of the
//! top-left pixel at (0, 0); and `cameras.bin`, which says the same in little-endian numbers.

use super::{Draft, fov, pixel_count, radial_tangential};
use crate::bytes::Input;
use crate::{DatasetError, read_file};
use monogrid_geometry::{Distortion, Pinhole};
use std::path::Path;

/// The models of COLMAP that are understood, with their parameters.
const MODELS: &str = "SIMPLE_PINHOLE (3 parameters), PINHOLE (4), SIMPLE_RADIAL (4), RADIAL (5), OPENCV (8), \
                      FULL_OPENCV (12, the last three 0), OPENCV_FISHEYE (8) or FOV (5)";

/// Models by their numbers in binary files, with how many parameters they have.
const NUMBERED: [(&str, usize); 8] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
];

/// Largest binary file that is read: a camera takes some hundred bytes.
const MAX_BINARY_BYTES: u64 = 1 << 24;

/// The first camera of a `cameras.bin` as its line in `cameras.txt` would be.
pub(super) fn read_binary(path: &Path) -> Result<String, DatasetError> {
    let bytes = read_file(path, MAX_BINARY_BYTES)?;
    first_camera(&bytes).ok_or_else(|| DatasetError::content(path, "no binary camera", MODELS))
}

/// Number of cameras (u64); of the first its number (u32), model (i32), width, height (u64) and parameters (f64).
fn first_camera(bytes: &[u8]) -> Option<String> {
    let mut input = Input::new(bytes);
    let _num_cameras = input.u64()?;
    let (id, model) = (input.u32()?, input.u32()?);
    let (model, num_parameters) = NUMBERED.get(model as usize)?;
    let (width, height) = (input.u64()?, input.u64()?);
    let mut line = format!("{id} {model} {width} {height}");
    for _ in 0..*num_parameters {
        line.push_str(&format!(" {:?}", input.f64()?));
    }
    Some(line)
}

/// Whether a line looks like a camera of COLMAP.
pub(super) fn is_camera(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let has_number = words.next().is_some_and(|id| id.parse::<u64>().is_ok());
    has_number
        && words
            .next()
            .is_some_and(|model| model.starts_with(|c: char| c.is_ascii_uppercase()))
}

/// The first camera of the file.
pub(super) fn parse(lines: &[(usize, &str)], path: &Path) -> Result<Draft, DatasetError> {
    let Some(&(number, line)) = lines.first() else {
        return Err(DatasetError::content(path, "no camera", MODELS));
    };
    let wrong = || DatasetError::line(path, number, line, MODELS);
    let words: Vec<&str> = line.split_whitespace().collect();
    let [_, model, width, height, parameters @ ..] = words.as_slice() else {
        return Err(wrong());
    };
    let size = |text: &str| text.parse().ok().and_then(pixel_count);
    let (width, height) = size(width).zip(size(height)).ok_or_else(wrong)?;
    let parameters: Option<Vec<f64>> = parameters.iter().map(|p| p.parse().ok()).collect();
    let (pinhole, distortion) = parameters
        .and_then(|parameters| camera(model, &parameters))
        .ok_or_else(wrong)?;
    let mut draft = Draft::new((width, height), pinhole, distortion, "COLMAP cameras.txt");
    draft
        .notes
        .push("half a pixel was subtracted from the principal point".to_owned());
    if lines.len() > 1 {
        draft
            .notes
            .push(format!("the first of {} cameras is used", lines.len()));
    }
    Ok(draft)
}

/// Camera of a model with these parameters.
fn camera(model: &str, parameters: &[f64]) -> Option<(Pinhole, Distortion)> {
    let pinhole = |fx, fy, cx: f64, cy: f64| Pinhole::new(fx, fy, cx - 0.5, cy - 0.5);
    Some(match (model, parameters) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => (pinhole(f, f, cx, cy), Distortion::None),
        ("PINHOLE", &[fx, fy, cx, cy]) => (pinhole(fx, fy, cx, cy), Distortion::None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => (
            pinhole(f, f, cx, cy),
            radial_tangential([k1, 0.0, 0.0, 0.0, 0.0]),
        ),
        ("RADIAL", &[f, cx, cy, k1, k2]) => (
            pinhole(f, f, cx, cy),
            radial_tangential([k1, k2, 0.0, 0.0, 0.0]),
        ),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => (
            pinhole(fx, fy, cx, cy),
            radial_tangential([k1, k2, p1, p2, 0.0]),
        ),
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6])
            if [k4, k5, k6] == [0.0; 3] =>
        {
            (
                pinhole(fx, fy, cx, cy),
                radial_tangential([k1, k2, p1, p2, k3]),
            )
        }
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => (
            pinhole(fx, fy, cx, cy),
            Distortion::Equidistant {
                k: [k1, k2, k3, k4],
            },
        ),
        ("FOV", &[fx, fy, cx, cy, omega]) => (pinhole(fx, fy, cx, cy), fov(omega)),
        _ => return None,
    })
}
