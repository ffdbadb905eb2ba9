//! Calibration formats made of lines of numbers: one line, LSD-SLAM, DSO, KITTI.

use super::{Draft, colmap, fov, pixel_count, radial_tangential, relative_or_pixels};
use crate::DatasetError;
use crate::text::{data_lines, numbers};
use monogrid_geometry::{Camera, Distortion, Pinhole};
use std::path::Path;

/// Recognises the format by its first lines.
pub(super) fn parse(
    text: &str,
    path: &Path,
    image_size: Option<(usize, usize)>,
) -> Result<Draft, DatasetError> {
    let (shutter, lines): (Vec<_>, Vec<_>) =
        data_lines(text).partition(|(_, line)| line.starts_with(ROLLING_SHUTTER));
    let readout_ms = shutter.first().map(|line| readout_ms(path, *line));
    Ok(Draft {
        readout_ms: readout_ms.transpose()?,
        ..parse_camera(&lines, path, image_size)?
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
    image_size: Option<(usize, usize)>,
) -> Result<Draft, DatasetError> {
    let Some(&first) = lines.first() else {
        return Err(DatasetError::content(
            path,
            "no numbers",
            "fx fy cx cy width height in pixels",
        ));
    };
    let word = first.1.split_whitespace().next().unwrap_or("");
    if DSO_MODELS.iter().any(|m| m.eq_ignore_ascii_case(word)) {
        return parse_dso(word, lines, path);
    }
    if colmap::is_camera(first.1) {
        return colmap::parse(lines, path);
    }
    if let Some(matrix) = kitti_matrix(lines) {
        return kitti(&matrix, path, image_size);
    }
    let values = numbers(first.1).ok_or_else(|| unknown(path, first))?;
    match (values.len(), lines.len()) {
        (5 | 8, 2..) => parse_lsd(&values, lines, path),
        (6 | 7 | 10 | 11, 1) => one_line(&values, path, first),
        _ => Err(unknown(path, first)),
    }
}

fn unknown(path: &Path, (number, line): (usize, &str)) -> DatasetError {
    DatasetError::line(
        path,
        number,
        line,
        "fx fy cx cy [omega | k1 k2 p1 p2 [k3]] width height in pixels, a file of LSD-SLAM or DSO, or \
         KITTI's calib.txt",
    )
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
fn one_line(values: &[f64], path: &Path, line: (usize, &str)) -> Result<Draft, DatasetError> {
    let (intrinsics, size) = values.split_at(values.len().saturating_sub(2));
    let [width, height] = size else {
        return Err(unknown(path, line));
    };
    let size = image_size(*width, *height).ok_or_else(|| {
        DatasetError::line(
            path,
            line.0,
            line.1,
            "the width and height of the image in pixels as the last two numbers",
        )
    })?;
    let (pinhole, distortion) = match *intrinsics {
        [fx, fy, cx, cy] => (Pinhole::new(fx, fy, cx, cy), Distortion::None),
        [fx, fy, cx, cy, omega] => (Pinhole::new(fx, fy, cx, cy), fov(omega)),
        [fx, fy, cx, cy, k1, k2, p1, p2] => (
            Pinhole::new(fx, fy, cx, cy),
            radial_tangential([k1, k2, p1, p2, 0.0]),
        ),
        [fx, fy, cx, cy, k1, k2, p1, p2, k3] => (
            Pinhole::new(fx, fy, cx, cy),
            radial_tangential([k1, k2, p1, p2, k3]),
        ),
        _ => return Err(unknown(path, line)),
    };
    Ok(Draft::new(
        size,
        pinhole,
        distortion,
        "line of numbers in pixels",
    ))
}

fn image_size(width: f64, height: f64) -> Option<(usize, usize)> {
    Some((pixel_count(width)?, pixel_count(height)?))
}

/// The second line of LSD-SLAM's and DSO's files: `width height`.
fn size_line(lines: &[(usize, &str)], path: &Path) -> Result<(usize, usize), DatasetError> {
    let Some(&(number, line)) = lines.get(1) else {
        return Err(DatasetError::content(
            path,
            "one line",
            "a second line with the width and height of the images",
        ));
    };
    match numbers(line).as_deref() {
        Some([width, height]) => image_size(*width, *height),
        _ => None,
    }
    .ok_or_else(|| DatasetError::line(path, number, line, "width and height in pixels"))
}

/// Says what happens to the remaining lines of LSD-SLAM's and DSO's files.
fn output_note(lines: &[(usize, &str)]) -> Option<String> {
    (lines.len() > 2).then(|| {
        "the rectification mode and output size in the file are not used (the working size is chosen \
         by --size)"
            .to_owned()
    })
}

fn note_units(draft: &mut Draft, relative: bool, lines: &[(usize, &str)]) {
    draft.notes.push(if relative {
        "values are relative to the image size; half a pixel was subtracted from the principal point"
            .to_owned()
    } else {
        "values are in pixels".to_owned()
    });
    draft.notes.extend(output_note(lines));
}

/// LSD-SLAM and PTAM: 5 numbers (FOV model) or 8 (OpenCV), then the size.
fn parse_lsd(values: &[f64], lines: &[(usize, &str)], path: &Path) -> Result<Draft, DatasetError> {
    let size = size_line(lines, path)?;
    let intrinsics = [values[0], values[1], values[2], values[3]];
    let (pinhole, relative) = relative_or_pixels(intrinsics, size);
    let (distortion, format) = match values[4..] {
        [omega] => (fov(omega), "LSD-SLAM file, FOV (ATAN) model"),
        [k1, k2, p1, p2] => (
            radial_tangential([k1, k2, p1, p2, 0.0]),
            "LSD-SLAM file, OpenCV model",
        ),
        _ => return Err(unknown(path, lines[0])),
    };
    let mut draft = Draft::new(size, pinhole, distortion, format);
    note_units(&mut draft, relative, lines);
    Ok(draft)
}

/// Names of DSO's models.
const DSO_MODELS: [&str; 5] = ["Pinhole", "FOV", "RadTan", "EquiDistant", "KannalaBrandt"];

/// DSO: a model name and its numbers, then the size.
fn parse_dso(model: &str, lines: &[(usize, &str)], path: &Path) -> Result<Draft, DatasetError> {
    let (number, line) = lines[0];
    let size = size_line(lines, path)?;
    let values = numbers(line[model.len()..].trim()).unwrap_or_default();
    let wrong = || {
        DatasetError::line(
            path,
            number,
            line,
            "Pinhole fx fy cx cy 0, FOV fx fy cx cy omega, or RadTan, EquiDistant or KannalaBrandt with \
             fx fy cx cy and four coefficients",
        )
    };
    let &[fx, fy, cx, cy, ref rest @ ..] = values.as_slice() else {
        return Err(wrong());
    };
    let (pinhole, relative) = relative_or_pixels([fx, fy, cx, cy], size);
    let (distortion, format) = match (model.to_ascii_lowercase().as_str(), rest) {
        ("pinhole", [] | [_]) => (Distortion::None, "DSO file, Pinhole"),
        ("fov", &[omega]) => (fov(omega), "DSO file, FOV model"),
        ("radtan", &[k1, k2, p1, p2]) => (
            radial_tangential([k1, k2, p1, p2, 0.0]),
            "DSO file, RadTan model",
        ),
        ("equidistant" | "kannalabrandt", &[k1, k2, k3, k4]) => (
            Distortion::Equidistant {
                k: [k1, k2, k3, k4],
            },
            "DSO file, equidistant (Kannala-Brandt) model",
        ),
        _ => return Err(wrong()),
    };
    let mut draft = Draft::new(size, pinhole, distortion, format);
    note_units(&mut draft, relative, lines);
    Ok(draft)
}

/// The first projection matrix of KITTI's `calib.txt`, with or without `P0:` in front.
fn kitti_matrix(lines: &[(usize, &str)]) -> Option<[f64; 12]> {
    let labelled = ["P0:", "P_rect_00:"]
        .iter()
        .find_map(|label| lines.iter().find_map(|(_, line)| line.strip_prefix(label)));
    let line = labelled.or_else(|| lines.first().map(|l| l.1))?;
    numbers(line)?.try_into().ok()
}

fn kitti(
    matrix: &[f64; 12],
    path: &Path,
    image_size: Option<(usize, usize)>,
) -> Result<Draft, DatasetError> {
    let size = image_size.ok_or_else(|| {
        DatasetError::content(
            path,
            "a KITTI projection matrix without the size of the images",
            "images beside it, to take the size from",
        )
    })?;
    let pinhole = Pinhole::new(matrix[0], matrix[5], matrix[2], matrix[6]);
    Ok(Draft::new(
        size,
        pinhole,
        Distortion::None,
        "KITTI calib.txt, first camera",
    ))
}
