//! COLMAP's `cameras.txt`: `CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS...` in pixels, the corner of
//! the top-left pixel at (0, 0); and `cameras.bin`, which says the same in little-endian numbers.

use super::{lens, pixel_count};
use crate::bytes::Input;
use crate::{Calibration, DatasetError, read_file};
use monogrid_geometry::Pinhole;
use std::path::Path;

/// The models of COLMAP that are understood, with their parameters.
const MODELS: &str = "SIMPLE_PINHOLE (3 parameters), PINHOLE (4), SIMPLE_RADIAL (4), RADIAL (5), \
    OPENCV (8), FULL_OPENCV (12), OPENCV_FISHEYE (8), SIMPLE_RADIAL_FISHEYE (4), RADIAL_FISHEYE \
    (5) or FOV (5)";

/// Models by their numbers in binary files, with how many parameters they have.
const NUMBERED: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

/// Largest binary file that is read: a camera takes some hundred bytes.
const MAX_BINARY_BYTES: u64 = 1 << 24;

/// The cameras of a `cameras.bin` as their lines in `cameras.txt` would be.
pub(super) fn read_binary(path: &Path) -> Result<String, DatasetError> {
    let bytes = read_file(path, MAX_BINARY_BYTES)?;
    let lines = binary_cameras(&bytes);
    let lines = lines.filter(|lines| !lines.is_empty());
    lines.ok_or_else(|| DatasetError::content(path, "no binary cameras", MODELS))
}

/// Number of cameras (u64); of each its number (u32), model (i32), width, height (u64) and
/// parameters (f64).
fn binary_cameras(bytes: &[u8]) -> Option<String> {
    let mut input = Input::new(bytes);
    let num_cameras = input.u64()?;
    let mut lines = String::new();
    for _ in 0..num_cameras {
        let (id, model) = (input.u32()?, input.u32()?);
        let (model, num_parameters) = NUMBERED.get(model as usize)?;
        let (width, height) = (input.u64()?, input.u64()?);
        lines.push_str(&format!("{id} {model} {width} {height}"));
        for _ in 0..*num_parameters {
            lines.push_str(&format!(" {:?}", input.f64()?));
        }
        lines.push('\n');
    }
    Some(lines)
}

/// Whether a line looks like a camera of COLMAP.
pub(super) fn is_camera(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let has_number = words.next().is_some_and(|id| id.parse::<u64>().is_ok());
    let is_model = |word: &str| word.starts_with(|c: char| c.is_ascii_uppercase());
    has_number && words.next().is_some_and(is_model)
}

/// The camera whose images have this size, the first where several or none have; a model that is
/// not supported matters only in that one.
pub(super) fn parse(
    lines: &[(usize, &str)],
    path: &Path,
    image_size: Option<(usize, usize)>,
) -> Result<Calibration, DatasetError> {
    let Some(&first) = lines.first() else {
        return Err(DatasetError::content(path, "no camera", MODELS));
    };
    let fits = |(_, line): &&(usize, &str)| image_size.is_some() && size_in(line) == image_size;
    let fitting: Vec<&(usize, &str)> = lines.iter().filter(fits).collect();
    let chosen = fitting.first().copied().copied().unwrap_or(first);
    let mut draft = parse_line(chosen, path)?;
    draft.note("half a pixel was subtracted from the principal point");
    let all = lines.len();
    if all > 1 {
        let id = chosen.1.split_whitespace().next().unwrap_or_default();
        draft.note(match fitting.len() {
            0 => format!("camera {id} is used, the first of {all}"),
            1 => format!("camera {id} is used, the only one of {all} for images of this size"),
            n => format!("camera {id} is used, the first of {n} for images of this size"),
        });
    }
    Ok(draft)
}

/// Width and height in a line.
fn size_in(line: &str) -> Option<(usize, usize)> {
    let mut words = line.split_whitespace().skip(2);
    let mut side = || words.next()?.parse().ok().and_then(pixel_count);
    Some((side()?, side()?))
}

fn parse_line((number, line): (usize, &str), path: &Path) -> Result<Calibration, DatasetError> {
    let wrong = || DatasetError::line(path, number, line, MODELS);
    let words: Vec<&str> = line.split_whitespace().collect();
    let [_, model, _, _, parameters @ ..] = words.as_slice() else {
        return Err(wrong());
    };
    if !MODELS.split([' ', ',']).any(|name| name == *model) {
        lens(model, &[], path)?;
    }
    let size = size_in(line).ok_or_else(wrong)?;
    let parameters: Option<Vec<f64>> = parameters.iter().map(|p| p.parse().ok()).collect();
    let (pinhole, name, coefficients) = parameters
        .and_then(|parameters| camera(model, &parameters))
        .ok_or_else(wrong)?;
    let distortion = lens(name, &coefficients, path)?;
    Ok(Calibration::draft(
        size,
        pinhole,
        distortion,
        "COLMAP cameras.txt",
    ))
}

/// The pinhole of a model with these parameters, our name of its lens, and the coefficients of
/// that.
fn camera(model: &str, parameters: &[f64]) -> Option<(Pinhole, &'static str, Vec<f64>)> {
    let has_one_focal = model.starts_with("SIMPLE_") || model.starts_with("RADIAL");
    let (fx, parameters) = parameters.split_first()?;
    let (fy, parameters) = match has_one_focal {
        true => (fx, parameters),
        false => parameters.split_first()?,
    };
    let (&[cx, cy], lens) = parameters.split_first_chunk()?;
    let padded = |length: usize| {
        let mut lens = lens.to_vec();
        lens.resize(length, 0.0);
        lens
    };
    let (name, coefficients) = match (model, lens.len()) {
        ("SIMPLE_PINHOLE" | "PINHOLE", 0) => ("pinhole", Vec::new()),
        ("SIMPLE_RADIAL", 1) | ("RADIAL", 2) => ("opencv", padded(4)),
        ("OPENCV", 4) | ("FULL_OPENCV", 8) => ("opencv", lens.to_vec()),
        ("OPENCV_FISHEYE", 4) | ("SIMPLE_RADIAL_FISHEYE", 1) | ("RADIAL_FISHEYE", 2) => {
            ("fisheye", padded(4))
        }
        ("FOV", 1) => ("fov", lens.to_vec()),
        _ => return None,
    };
    Some((
        Pinhole::new(*fx, *fy, cx - 0.5, cy - 0.5),
        name,
        coefficients,
    ))
}
