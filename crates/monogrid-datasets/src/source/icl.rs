//! ICL-NUIM (`[HANDA14]`) as it is downloaded: `associations.txt` pairs colour and depth by the
//! number of the frame, `NAME.gt.freiburg` has the poses by that number.

use super::{Dataset, DepthEntry, Layout, Parts, SourceOptions, folder};
use crate::files::{is_file, paths_in};
use crate::text::{data_lines, read_text};
use crate::{DatasetError, TimedPose};
use monogrid_geometry::nalgebra::Quaternion;
use monogrid_geometry::{Rotation, Se3, Vec3};
use std::path::{Path, PathBuf};

const LIST: &str = "associations.txt";

/// The camera of all its sequences: fx fy cx cy width height. Its own files have fy = -480, since
/// their y axis points up; the rows of the images run downwards all the same.
pub(super) const CALIBRATION: &str = "481.2 480 319.5 239.5 640 480";
/// Size of its images, pixels.
pub(super) const SIZE: (usize, usize) = (640, 480);

/// A line of the list: the numbers of the depth and of the colour image, and where they are.
struct Pair {
    depth: (u32, PathBuf),
    colour: (u32, PathBuf),
}

/// Opens a folder of this layout.
pub(super) fn read(root: &Path, options: SourceOptions) -> Option<Result<Dataset, DatasetError>> {
    list_of(root).map(|list| open(root, &list, options))
}

/// The list of a sequence in this layout: pairs of whole numbers and paths.
fn list_of(root: &Path) -> Option<PathBuf> {
    let list = root.join(LIST);
    let text = is_file(&list).then(|| read_text(&list).ok())??;
    let (_, first) = data_lines(&text).next()?;
    pair(root, first).map(|_| list)
}

/// Opens a sequence by its list; the rate is 30 Hz where nobody gave one.
fn open(root: &Path, list: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    let (text, fps) = (read_text(list)?, folder::rate(options, list)?);
    let (mut entries, mut depths) = (Vec::new(), Vec::new());
    for (number, line) in data_lines(&text) {
        let expected = "the number and the path of a depth image and of a colour image";
        let pair = pair(root, line);
        let pair = pair.ok_or_else(|| DatasetError::line(list, number, line, expected))?;
        entries.push((time_ns(pair.colour.0, fps), pair.colour.1));
        depths.push(DepthEntry {
            timestamp_ns: time_ns(pair.depth.0, fps),
            path: pair.depth.1,
        });
    }
    Dataset::assemble(
        Parts {
            root: root.to_path_buf(),
            layout: Layout::IclNuim,
            list: list.to_path_buf(),
            entries,
            is_at_rate: true,
            depths,
            ground_truth: poses_in(root),
            ..Parts::default()
        },
        options,
    )
}

/// When a frame was taken.
fn time_ns(number: u32, fps: f64) -> i64 {
    (f64::from(number) * 1e9 / fps).round() as i64
}

/// A line `NUMBER PATH NUMBER PATH`, the depth image first, as the data set has it, or second.
fn pair(root: &Path, line: &str) -> Option<Pair> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[first, first_path, second, second_path] = words.as_slice() else {
        return None;
    };
    let entry = |number: &str, path: &str| Some((number.parse().ok()?, root.join(path)));
    let (first, second) = (entry(first, first_path)?, entry(second, second_path)?);
    let (depth, colour) = match second_path.contains("depth") {
        true => (second, first),
        false => (first, second),
    };
    Some(Pair { depth, colour })
}

/// The poses that lie beside the list.
fn poses_in(root: &Path) -> Option<PathBuf> {
    let name = |path: &PathBuf| path.to_str().is_some_and(|p| p.ends_with(".gt.freiburg"));
    let mut paths: Vec<PathBuf> = paths_in(root).ok()?.into_iter().filter(name).collect();
    paths.sort();
    paths.into_iter().next()
}

/// Poses with numbers of frames for times (as seconds) in a world and a camera whose y axes point
/// up, as poses at the times of the frames with y down.
pub(super) fn poses_of(numbered: Vec<TimedPose>, fps: f64) -> Vec<TimedPose> {
    let pose = |numbered: TimedPose| {
        let number = u32::try_from(numbered.timestamp_ns / 1_000_000_000).unwrap_or_default();
        let Se3 {
            rotation,
            translation: t,
        } = numbered.world_from_camera;
        // with M = diag(1, -1, 1): M R M and M t
        let mirrored = Quaternion::new(rotation.w, -rotation.i, rotation.j, -rotation.k);
        TimedPose {
            timestamp_ns: time_ns(number, fps),
            world_from_camera: Se3::new(
                Rotation::new_normalize(mirrored),
                Vec3::new(t.x, -t.y, t.z),
            ),
        }
    };
    numbered.into_iter().map(pose).collect()
}
