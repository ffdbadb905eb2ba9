//! Calibration formats made of lines of numbers: one line, LSD-SLAM, DSO.

use super::{Images, colmap, fov, kitti, lens, pixel_count, radial_tangential, relative_or_pixels};
use crate::text::{data_lines, numbers};
use crate::{Calibration, DatasetError};
use monogrid_geometry::{Camera, Distortion, Pinhole};
use std::path::Path;

/// Recognises the format by its first lines.
pub(super) fn parse(
    text: &str,
    path: &Path,
    images: Images<'_>,
) -> Result<Calibration, DatasetError> {
    let (shutter, lines): (Vec<_>, Vec<_>) =
        data_lines(text).partition(|(_, line)| line.starts_with(ROLLING_SHUTTER));
    let readout_ms = shutter.first().map(|line| readout_ms(path, *line));
    Ok(Calibration {
        readout_ms: readout_ms.transpose()?,
        ..parse_camera(&lines, path, images)?
    })
}

/// Begins the line that says how long the camera reads an image.
const ROLLING_SHUTTER: &str = "rolling_shutter_ms";

fn readout_ms(path: &Path, (number, line): (usize, &str)) -> Result<f64, DatasetError> {
    let value = line[ROLLING_SHUTTER.len()..].trim().parse().ok();
    value.ok_or_else(|| {
        let expected = "rolling_shutter_ms and the milliseconds from the first row to the last";
        DatasetError::line(path, number, line, expected)
    })
}

fn parse_camera(
    lines: &[(usize, &str)],
    path: &Path,
    images: Images<'_>,
) -> Result<Calibration, DatasetError> {
    let Some(&first) = lines.first() else {
        let expected = "fx fy cx cy width height in pixels";
        return Err(DatasetError::content(path, "no numbers", expected));
    };
    let word = first.1.split_whitespace().next().unwrap_or("");
    if DSO_MODELS.iter().any(|m| m.eq_ignore_ascii_case(word)) {
        return parse_dso(word, lines, path);
    }
    if colmap::is_camera(first.1) {
        return colmap::parse(lines, path, images.size);
    }
    if let Some(kitti) = kitti::parse(lines, path, images) {
        return kitti;
    }
    let values = numbers(first.1).ok_or_else(|| unknown(path, first))?;
    let (pinhole, format) = match (values.as_slice(), lines.len()) {
        (&[fx, fy, cx, cy], 1) => (Some(Pinhole::new(fx, fy, cx, cy)), "fx fy cx cy"),
        _ => (intrinsic_matrix(lines), "matrix of the intrinsics"),
    };
    if let Some(pinhole) = pinhole {
        let size = images.size.ok_or_else(|| {
            let found = "intrinsics without the size of the images";
            DatasetError::content(path, found, "images beside it, to take the size from")
        })?;
        return Ok(Calibration::draft(size, pinhole, Distortion::None, format));
    }
    match (values.len(), lines.len()) {
        (5 | 8, 2..) => parse_lsd(&values, lines, path),
        (6 | 7 | 10 | 11, 1) => one_line(&values, path, first),
        _ => Err(unknown(path, first)),
    }
}

fn unknown(path: &Path, (number, line): (usize, &str)) -> DatasetError {
    let expected = "fx fy cx cy [omega | k1 k2 p1 p2 [k3]] width height in pixels, a file of \
        LSD-SLAM or DSO, COLMAP's cameras.txt, KITTI's calib.txt, or one of the other formats in \
        docs/formats.md";
    DatasetError::line(path, number, line, expected)
}

/// A checked camera from one line of numbers in pixels.
pub(crate) fn camera_from_numbers(
    values: &[f64],
    path: &Path,
    line: (usize, &str),
) -> Result<Camera, DatasetError> {
    let draft = one_line(values, path, line)?;
    Ok(draft.check(path)?.camera)
}

/// `fx fy cx cy [omega | k1 k2 p1 p2 [k3]] width height`, in pixels.
/// The camera of a matrix K, of three rows and columns or of four: `fx 0 cx`, `0 fy cy`, `0 0 1`.
/// An oblique one (`K[0][1]` is not 0) is none.
fn intrinsic_matrix(lines: &[(usize, &str)]) -> Option<Pinhole> {
    let size = lines.len();
    let rows: Vec<Vec<f64>> = lines.iter().filter_map(|(_, line)| numbers(line)).collect();
    let is_square = matches!(size, 3 | 4) && rows.len() == size;
    let is_square = is_square && rows.iter().all(|row| row.len() == size);
    let is_fixed = |(row, column)| !matches!((row, column), (0, 0 | 2) | (1, 1 | 2));
    let entries = (0..size).flat_map(|row| (0..size).map(move |column| (row, column)));
    let is_of_camera = |(row, column): (usize, usize)| {
        let expected = if row == column { 1.0 } else { 0.0 };
        (rows[row][column] - expected).abs() < 1e-9
    };
    let is_camera = is_square && entries.filter(|entry| is_fixed(*entry)).all(is_of_camera);
    is_camera.then(|| Pinhole::new(rows[0][0], rows[1][1], rows[0][2], rows[1][2]))
}

fn one_line(values: &[f64], path: &Path, line: (usize, &str)) -> Result<Calibration, DatasetError> {
    let &[ref intrinsics @ .., width, height] = values else {
        return Err(unknown(path, line));
    };
    let size = image_size(width, height).ok_or_else(|| {
        let expected = "the width and height of the image in pixels as the last two numbers";
        DatasetError::line(path, line.0, line.1, expected)
    })?;
    let &[fx, fy, cx, cy, ref lens @ ..] = intrinsics else {
        return Err(unknown(path, line));
    };
    let distortion = match lens {
        [omega] => fov(*omega),
        [] | [_, _, _, _] | [_, _, _, _, _] => radial_tangential(lens),
        _ => return Err(unknown(path, line)),
    };
    let pinhole = Pinhole::new(fx, fy, cx, cy);
    let format = "line of numbers in pixels";
    Ok(Calibration::draft(size, pinhole, distortion, format))
}

fn image_size(width: f64, height: f64) -> Option<(usize, usize)> {
    Some((pixel_count(width)?, pixel_count(height)?))
}

/// The second line of LSD-SLAM's and DSO's files: `width height`.
fn size_line(lines: &[(usize, &str)], path: &Path) -> Result<(usize, usize), DatasetError> {
    let Some(&(number, line)) = lines.get(1) else {
        let expected = "a second line with the width and height of the images";
        return Err(DatasetError::content(path, "one line", expected));
    };
    let size = match numbers(line).as_deref() {
        Some([width, height]) => image_size(*width, *height),
        _ => None,
    };
    size.ok_or_else(|| DatasetError::line(path, number, line, "width and height in pixels"))
}

/// Says how the numbers of LSD-SLAM's and DSO's files are meant, and what happens to their
/// remaining lines.
fn note_units(draft: &mut Calibration, relative: bool, lines: &[(usize, &str)]) {
    draft.note(match relative {
        true => {
            "values are relative to the image size; half a pixel was subtracted from the \
            principal point"
        }
        false => "values are in pixels",
    });
    if lines.len() > 2 {
        draft.note(
            "the rectification mode and output size in the file are not used (the working size is \
             chosen by --size)",
        );
    }
}

/// LSD-SLAM and PTAM: 5 numbers (FOV model) or 8 (OpenCV), then the size.
fn parse_lsd(
    values: &[f64],
    lines: &[(usize, &str)],
    path: &Path,
) -> Result<Calibration, DatasetError> {
    let size = size_line(lines, path)?;
    let intrinsics = [values[0], values[1], values[2], values[3]];
    let (pinhole, relative) = relative_or_pixels(intrinsics, size);
    let (distortion, format) = match &values[4..] {
        [omega] => (fov(*omega), "LSD-SLAM file, FOV (ATAN) model"),
        lens => (radial_tangential(lens), "LSD-SLAM file, OpenCV model"),
    };
    let mut draft = Calibration::draft(size, pinhole, distortion, format);
    note_units(&mut draft, relative, lines);
    Ok(draft)
}

/// Names of DSO's models.
const DSO_MODELS: [&str; 5] = ["Pinhole", "FOV", "RadTan", "EquiDistant", "KannalaBrandt"];

/// DSO: a model name and its numbers, then the size.
fn parse_dso(
    model: &str,
    lines: &[(usize, &str)],
    path: &Path,
) -> Result<Calibration, DatasetError> {
    let (number, line) = lines[0];
    let size = size_line(lines, path)?;
    let values = numbers(line[model.len()..].trim()).unwrap_or_default();
    let wrong = || {
        let expected = "Pinhole fx fy cx cy 0, FOV fx fy cx cy omega, or RadTan, EquiDistant or \
            KannalaBrandt with fx fy cx cy and four coefficients";
        DatasetError::line(path, number, line, expected)
    };
    let &[fx, fy, cx, cy, ref rest @ ..] = values.as_slice() else {
        return Err(wrong());
    };
    let (pinhole, relative) = relative_or_pixels([fx, fy, cx, cy], size);
    let (distortion, format) = match (model.to_ascii_lowercase().as_str(), rest) {
        ("pinhole", [] | [_]) => (Distortion::None, "DSO file, Pinhole"),
        ("fov", &[omega]) => (fov(omega), "DSO file, FOV model"),
        ("radtan", [_, _, _, _]) => (radial_tangential(rest), "DSO file, RadTan model"),
        ("equidistant" | "kannalabrandt", [_, _, _, _]) => {
            let format = "DSO file, equidistant (Kannala-Brandt) model";
            (lens(model, rest, path)?, format)
        }
        _ => return Err(wrong()),
    };
    let mut draft = Calibration::draft(size, pinhole, distortion, format);
    note_units(&mut draft, relative, lines);
    Ok(draft)
}
