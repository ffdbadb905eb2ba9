//! COLMAP's `cameras.txt`: `CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS...` in pixels, the corner of the
//! top-left pixel at (0, 0); and `cameras.bin`, which says the same in little-endian numbers.

use super::{equidistant, fov, pixel_count, radial_tangential};
use crate::bytes::Input;
use crate::{Calibration, DatasetError, read_file};
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
    let is_model = |word: &str| word.starts_with(|c: char| c.is_ascii_uppercase());
    has_number && words.next().is_some_and(is_model)
}

/// The first camera of the file.
pub(super) fn parse(lines: &[(usize, &str)], path: &Path) -> Result<Calibration, DatasetError> {
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
    let camera = parameters.and_then(|parameters| camera(model, &parameters));
    let (pinhole, distortion) = camera.ok_or_else(wrong)?;
    let mut draft = Calibration::draft((width, height), pinhole, distortion, "COLMAP cameras.txt");
    draft.note("half a pixel was subtracted from the principal point");
    if lines.len() > 1 {
        draft.note(format!("the first of {} cameras is used", lines.len()));
    }
    Ok(draft)
}

/// Camera of a model with these parameters.
fn camera(model: &str, parameters: &[f64]) -> Option<(Pinhole, Distortion)> {
    let has_one_focal = matches!(model, "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL");
    let (fx, parameters) = parameters.split_first()?;
    let (fy, parameters) = match has_one_focal {
        true => (fx, parameters),
        false => parameters.split_first()?,
    };
    let (&[cx, cy], lens) = parameters.split_first_chunk()?;
    let distortion = match (model, lens) {
        ("SIMPLE_PINHOLE" | "PINHOLE", []) => Distortion::None,
        ("SIMPLE_RADIAL", [_]) | ("RADIAL", [_, _]) | ("OPENCV", [_, _, _, _]) => {
            radial_tangential(lens)
        }
        ("FULL_OPENCV", [_, _, _, _, _, rest @ ..]) if rest == [0.0; 3] => radial_tangential(lens),
        ("OPENCV_FISHEYE", &[k1, k2, k3, k4]) => equidistant([k1, k2, k3, k4]),
        ("FOV", &[omega]) => fov(omega),
        _ => return None,
    };
    Some((Pinhole::new(*fx, *fy, cx - 0.5, cy - 0.5), distortion))
}
