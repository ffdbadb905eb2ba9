//! Trajectory files (TUM, EuRoC, KITTI) and Sim(3) files.

use crate::text::{data_lines, first_word, numbers, read_text};
use crate::timestamp::{TimeUnit, format_seconds};
use crate::{DatasetError, write_atomically};
use monogrid_geometry::nalgebra::{Matrix3, Quaternion, Rotation3};
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3};
use std::fmt::Write;
use std::path::Path;

/// A pose with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// Pose of the camera (or, in files of EuRoC, of the body) in the world of the file.
    pub world_from_camera: Se3,
}

/// Length by which a quaternion may differ from 1 through rounding in the file.
const QUATERNION_TOLERANCE: f64 = 0.1;
/// Norms closer to 1 than this are products of rounding.
const ROUNDING: f64 = 1e-14;

/// Reads a trajectory in TUM format (`timestamp tx ty tz qx qy qz qw`), EuRoC's CSV
/// (`nanoseconds,x,y,z,qw,qx,qy,qz,...`) or KITTI's matrices (12 numbers per line, the first at 0
/// s, one more second for each), recognised by content, sorted by time; of equal times the first
/// counts.
///
/// Times are seconds, milliseconds, microseconds or nanoseconds, whichever makes them dates of our
/// time, or their steps those of a camera.
///
/// # Errors
/// When the file cannot be read, has no pose, or a line is not a pose.
pub fn read_trajectory(path: &Path) -> Result<Vec<TimedPose>, DatasetError> {
    parse_trajectory(&read_text(path)?, path)
}

/// As [`read_trajectory`]; also positions alone (`time x y z`, as receivers and trackers of a prism
/// write them), all of which have the same orientation, then: nobody knows it.
///
/// # Errors
/// As [`read_trajectory`].
pub fn read_path(path: &Path) -> Result<Vec<TimedPose>, DatasetError> {
    parse_path(&read_text(path)?, path)
}

/// Whether a line names the columns of the lines below it, a time and a position at least.
fn are_column_names(line: &str) -> bool {
    let words = line.split(|c: char| c == ',' || c.is_whitespace());
    let num_words = words.filter(|word| !word.is_empty()).count();
    num_words >= 4 && !line.contains(|c: char| c.is_ascii_digit())
}

/// Parses a trajectory; `path` is only for messages.
///
/// # Errors
/// As [`read_trajectory`].
pub fn parse_trajectory(text: &str, path: &Path) -> Result<Vec<TimedPose>, DatasetError> {
    parse(text, path, false)
}

/// As [`read_path`].
pub(crate) fn parse_path(text: &str, path: &Path) -> Result<Vec<TimedPose>, DatasetError> {
    parse(text, path, true)
}

fn parse(
    text: &str,
    path: &Path,
    are_positions_enough: bool,
) -> Result<Vec<TimedPose>, DatasetError> {
    let is_kitti = |(_, line): (usize, &str)| numbers(line).is_some_and(|row| row.len() == 12);
    if data_lines(text).next().is_some_and(is_kitti) {
        let times: Vec<i64> = (0..data_lines(text).count() as i64)
            .map(|second| second * 1_000_000_000)
            .collect();
        return parse_kitti(text, &times, path);
    }
    let unit = TimeUnit::of(data_lines(text).map(|(_, line)| first_word(line).0));
    let is_w_first = is_w_first(text).unwrap_or_else(|| {
        let has_commas = |(_, line): (usize, &str)| line.contains(',');
        unit == TimeUnit::Nanoseconds && data_lines(text).next().is_some_and(has_commas)
    });
    let mut poses = Vec::new();
    for (at, (number, line)) in data_lines(text).enumerate() {
        if at == 0 && are_column_names(line) {
            continue;
        }
        let position = || parse_position(line, unit).filter(|_| are_positions_enough);
        poses.push(
            parse_line(line, unit, is_w_first)
                .or_else(position)
                .ok_or_else(|| {
                    let expected = "timestamp tx ty tz qx qy qz qw with a unit quaternion, EuRoC's \
                            nanoseconds,x,y,z,qw,qx,qy,qz, or 12 numbers of KITTI's matrices";
                    DatasetError::line(path, number, line, expected)
                })?,
        );
    }
    if poses.is_empty() {
        let expected = "lines of `timestamp tx ty tz qx qy qz qw`";
        return Err(DatasetError::content(path, "no poses", expected));
    }
    poses.sort_by_key(|p: &TimedPose| p.timestamp_ns);
    poses.dedup_by_key(|p| p.timestamp_ns);
    Ok(poses)
}

/// Parses KITTI's poses (12 numbers of a 3x4 matrix per line), the i-th at the i-th of `times_ns`;
/// `path` is only for messages.
///
/// # Errors
/// When a line is not a rigid transform, or there are more poses than times.
pub fn parse_kitti(
    text: &str,
    times_ns: &[i64],
    path: &Path,
) -> Result<Vec<TimedPose>, DatasetError> {
    let mut poses = Vec::new();
    for (number, line) in data_lines(text) {
        let timestamp_ns = times_ns.get(poses.len()).copied().ok_or_else(|| {
            let found = format!("more poses than the {} frames", times_ns.len());
            DatasetError::content(path, found, "one pose per frame")
        })?;
        let pose = numbers(line).and_then(|values| pose_from_matrix(&values));
        let wrong =
            || DatasetError::line(path, number, line, "12 numbers, rows of a rigid 3x4 matrix");
        poses.push(TimedPose {
            timestamp_ns,
            world_from_camera: pose.ok_or_else(wrong)?,
        });
    }
    Ok(poses)
}

/// A pose from a 3x4 or 4x4 matrix, row by row; `None` unless finite with a rotation (within 0.1
/// %).
pub(crate) fn pose_from_matrix(values: &[f64]) -> Option<Se3> {
    let &[a, b, c, x, d, e, f, y, g, h, i, z, ..] = values else {
        return None;
    };
    let matrix = Matrix3::new(a, b, c, d, e, f, g, h, i);
    let is_rotation = (matrix * matrix.transpose() - Matrix3::identity()).norm() < 1e-3
        && matrix.determinant() > 0.0;
    if !is_rotation {
        return None;
    }
    let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix(&matrix));
    let pose = Se3::new(rotation, Vec3::new(x, y, z));
    pose.is_finite().then_some(pose)
}

/// Whether quaternions begin with w, by the names of the columns in the first line: EuRoC's do, and
/// those of others, with commas too, have it last. `None` where nothing names them.
fn is_w_first(text: &str) -> Option<bool> {
    let first = text.lines().find(|line| !line.trim().is_empty())?;
    let names = first
        .trim_start_matches(['\u{feff}', '#', ' '])
        .to_lowercase();
    let names = names.split(|c: char| matches!(c, ',' | ';') || c.is_whitespace());
    let quaternion = names.filter(|name| name.starts_with('q') || name.contains("orientation"));
    let ends: Vec<Option<char>> = quaternion.map(|name| name.chars().last()).collect();
    let place = |axis: char| ends.iter().position(|end| *end == Some(axis));
    Some(place('w')? < place('x')?)
}

/// A line of TUM's format (behind the pose may be the 12 covariances of OpenVINS) or, with the w of
/// quaternions before x, of EuRoC's; with commas there may be anything behind.
fn parse_line(line: &str, unit: TimeUnit, is_w_first: bool) -> Option<TimedPose> {
    let (time, rest) = first_word(line);
    let values = numbers(rest)?;
    let &[x, y, z, a, b, c, d, ..] = values.as_slice() else {
        return None;
    };
    if !line.contains(',') && !matches!(values.len(), 7 | 19) {
        return None;
    }
    let pose = match is_w_first {
        true => [x, y, z, b, c, d, a],
        false => [x, y, z, a, b, c, d],
    };
    Some(TimedPose {
        timestamp_ns: unit.parse(time)?,
        world_from_camera: pose_from_numbers(&pose)?,
    })
}

/// A line with a time and a position.
fn parse_position(line: &str, unit: TimeUnit) -> Option<TimedPose> {
    let (time, rest) = first_word(line);
    let &[x, y, z] = numbers(rest)?.as_slice() else {
        return None;
    };
    let pose = Se3::new(Rotation::identity(), Vec3::new(x, y, z));
    pose.is_finite().then_some(TimedPose {
        timestamp_ns: unit.parse(time)?,
        world_from_camera: pose,
    })
}

/// A pose from `tx ty tz qx qy qz qw`; `None` unless finite with a unit quaternion (within 10 %).
pub(crate) fn pose_from_numbers(values: &[f64]) -> Option<Se3> {
    let &[tx, ty, tz, qx, qy, qz, qw] = values else {
        return None;
    };
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let error = (quaternion.norm() - 1.0).abs();
    let is_unit = error <= QUATERNION_TOLERANCE;
    // what was written from memory comes back to the last bit, so that what is made of it does too
    let rotation = match error <= ROUNDING {
        true => Rotation::new_unchecked(quaternion),
        false => Rotation::new_normalize(quaternion),
    };
    let pose = Se3::new(rotation, Vec3::new(tx, ty, tz));
    (is_unit && pose.is_finite()).then_some(pose)
}

/// The trajectory in TUM format, times with nine decimals.
#[must_use]
pub fn format_tum(poses: &[TimedPose]) -> String {
    let mut text = String::with_capacity(poses.len() * 120);
    text.push_str("# timestamp tx ty tz qx qy qz qw\n");
    for pose in poses {
        let [tx, ty, tz, qx, qy, qz, qw] = pose_to_numbers(&pose.world_from_camera);
        // writing into a string cannot fail
        let _ = writeln!(
            text,
            "{} {tx:.9} {ty:.9} {tz:.9} {qx:.10} {qy:.10} {qz:.10} {qw:.10}",
            format_seconds(pose.timestamp_ns)
        );
    }
    text
}

/// Writes a trajectory in TUM format, atomically.
///
/// # Errors
/// When the file cannot be written.
pub fn write_tum(path: &Path, poses: &[TimedPose]) -> Result<(), DatasetError> {
    write_atomically(path, format_tum(poses).as_bytes())
}

/// `tx ty tz qx qy qz qw`, with `qw >= 0` so that equal rotations are equal text.
fn pose_to_numbers(pose: &Se3) -> [f64; 7] {
    let q = pose.rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let (t, [i, j, k, w]) = (pose.translation, [q.i, q.j, q.k, q.w].map(|v| sign * v));
    // adding zero turns -0 into 0
    [t.x, t.y, t.z, i, j, k, w].map(|v| v + 0.0)
}

/// Reads a Sim(3) file: one line `scale tx ty tz qx qy qz qw` (target_from_source).
///
/// # Errors
/// When the file cannot be read or is not of this form, or the scale is not positive.
pub fn read_sim3(path: &Path) -> Result<Sim3, DatasetError> {
    let text = read_text(path)?;
    let lines: Vec<(usize, &str)> = data_lines(&text).collect();
    let sim3 = match lines.as_slice() {
        [(_, line)] => numbers(line).and_then(|values| {
            let (scale, pose) = values.split_first()?;
            let sim3 = pose_from_numbers(pose)?.with_scale(*scale);
            sim3.is_finite().then_some(sim3)
        }),
        _ => None,
    };
    sim3.ok_or_else(|| {
        let (number, line) = lines.first().copied().unwrap_or((1, ""));
        let expected =
            "one line `scale tx ty tz qx qy qz qw` with a positive scale and a unit quaternion";
        DatasetError::line(path, number, line, expected)
    })
}

/// Reads a file that holds one rigid transform (target_from_source): `tx ty tz qx qy qz qw`, or a
/// 3x4 or 4x4 matrix row by row.
///
/// # Errors
/// When the file cannot be read or is not of this form.
pub fn read_transform(path: &Path) -> Result<Se3, DatasetError> {
    let text = read_text(path)?;
    let all: Option<Vec<Vec<f64>>> = data_lines(&text).map(|(_, line)| numbers(line)).collect();
    let values = all.unwrap_or_default().concat();
    let transform = match values.len() {
        7 => pose_from_numbers(&values),
        12 | 16 => pose_from_matrix(&values),
        _ => None,
    };
    transform.ok_or_else(|| {
        let found = format!("{} numbers that are no rigid transform", values.len());
        let expected =
            "tx ty tz qx qy qz qw with a unit quaternion, or a 3x4 or 4x4 matrix with a rotation";
        DatasetError::content(path, found, expected)
    })
}

/// The content of a Sim(3) file.
#[must_use]
pub fn format_sim3(target_from_source: &Sim3) -> String {
    let [tx, ty, tz, qx, qy, qz, qw] = pose_to_numbers(&target_from_source.to_se3());
    format!(
        "# scale tx ty tz qx qy qz qw (target_from_source)\n{:.17e} {tx:.17e} {ty:.17e} {tz:.17e} \
         {qx:.17e} {qy:.17e} {qz:.17e} {qw:.17e}\n",
        target_from_source.scale
    )
}

/// Writes a Sim(3) file, atomically.
///
/// # Errors
/// When the file cannot be written.
pub fn write_sim3(path: &Path, target_from_source: &Sim3) -> Result<(), DatasetError> {
    write_atomically(path, format_sim3(target_from_source).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_come_back_to_the_last_bit() {
        for i in 0..1000 {
            let angle = f64::from(i) * 0.37;
            let axis = Vec3::new(angle.sin(), (1.7 * angle).cos(), (0.3 * angle).sin());
            let pose = Se3::new(Rotation::from_scaled_axis(axis * angle), axis);
            assert_eq!(pose_from_numbers(&pose_to_numbers(&pose)), Some(pose));
        }
    }
}
