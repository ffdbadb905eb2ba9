//! EuRoC MAV layout: `mav0/cam0/data.csv`, `sensor.yaml`, `state_groundtruth_estimate0`.

use super::{Dataset, Layout, Parts, SourceOptions};
use crate::DatasetError;
use crate::files::is_file;
use crate::text::{data_lines, read_text};
use std::path::{Path, PathBuf};

/// The `mav0` folder that `path` is or contains.
pub(super) fn find(path: &Path) -> Option<PathBuf> {
    [path.join("mav0"), path.to_path_buf()]
        .into_iter()
        .find(|p| is_file(&p.join("cam0/data.csv")))
}

/// Opens camera 0.
pub(super) fn open(
    path: &Path,
    mav0: &Path,
    options: SourceOptions,
) -> Result<Dataset, DatasetError> {
    let camera = mav0.join("cam0");
    let list = camera.join("data.csv");
    let text = read_text(&list)?;
    let mut entries = Vec::new();
    for (number, line) in data_lines(&text) {
        let (time, name) = line.split_once(',').unwrap_or((line, ""));
        let name = name.trim();
        match time.trim().parse::<i64>() {
            Ok(timestamp_ns) if !name.is_empty() => {
                entries.push((timestamp_ns, camera.join("data").join(name)));
            }
            _ => {
                let expected = "integer nanoseconds, a comma and the name of an image in cam0/data";
                return Err(DatasetError::line(&list, number, line, expected));
            }
        }
    }
    if entries.is_empty() {
        let (found, expected) = ("a list without lines", "lines of `nanoseconds,file name`");
        return Err(DatasetError::no_frames(&list, found, expected));
    }
    let existing = |p: PathBuf| is_file(&p).then_some(p);
    Dataset::assemble(
        Parts {
            root: path.to_path_buf(),
            layout: Layout::Euroc,
            list,
            entries,
            ground_truth: existing(mav0.join("state_groundtruth_estimate0/data.csv")),
            calibration_path: existing(camera.join("sensor.yaml")),
            ..Parts::default()
        },
        options,
    )
}
