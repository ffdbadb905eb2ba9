//! EuRoC MAV layout: `mav0/cam0/data.csv`, `sensor.yaml`, `state_groundtruth_estimate0`; TUM-VI has
//! `dso/camchain.yaml` and `mav0/mocap0` in their place.

use super::{Dataset, Layout, Parts, SourceOptions, folder, note_unit};
use crate::DatasetError;
use crate::files::{is_file, is_folder};
use crate::text::{data_lines, read_text};
use crate::timestamp::TimeUnit;
use std::path::{Path, PathBuf};

/// Opens a folder of this layout.
pub(super) fn read(path: &Path, options: SourceOptions) -> Option<Result<Dataset, DatasetError>> {
    find(path).map(|camera| open(path, &camera, options))
}

/// The folder of camera 0 that `path` contains, or is.
fn find(path: &Path) -> Option<PathBuf> {
    let has_data = |camera: &PathBuf| is_folder(&camera.join("data"));
    let has_list = |camera: &PathBuf| has_data(camera) && is_file(&camera.join("data.csv"));
    let below = [path.join("mav0/cam0"), path.join("cam0")];
    let listed = below
        .iter()
        .cloned()
        .chain([path.to_path_buf()])
        .find(has_list);
    listed.or_else(|| below.into_iter().find(has_data))
}

/// Opens a camera's folder; without `data.csv` the names of its images are its times.
fn open(path: &Path, camera: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    let list = camera.join("data.csv");
    let mut warnings = Vec::new();
    let entries = match is_file(&list) {
        true => read_list(&list, camera, &mut warnings)?,
        false => folder::timed_by_name(&camera.join("data"), options, &mut warnings)?,
    };
    if entries.is_empty() {
        let (found, expected) = ("a list without lines", "lines of `nanoseconds,file name`");
        return Err(DatasetError::no_frames(&list, found, expected));
    }
    let existing = |p: PathBuf| is_file(&p).then_some(p);
    let mav0 = camera.parent().unwrap_or(camera);
    let dso = mav0.parent().unwrap_or(mav0).join("dso");
    let truths = ["state_groundtruth_estimate0", "mocap0"];
    let truth = truths.map(|name| mav0.join(name).join("data.csv"));
    let is_tum_vi = is_folder(&dso) || is_folder(&mav0.join("mocap0"));
    Dataset::assemble(
        Parts {
            root: path.to_path_buf(),
            layout: match is_tum_vi {
                true => Layout::TumVi,
                false => Layout::Euroc,
            },
            is_at_rate: !is_file(&list),
            list,
            entries,
            ground_truth: truth.into_iter().find_map(existing),
            calibration_path: existing(camera.join("sensor.yaml"))
                .or_else(|| existing(dso.join("camchain.yaml"))),
            warnings,
            ..Parts::default()
        },
        options,
    )
}

fn read_list(
    list: &Path,
    camera: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<(i64, PathBuf)>, DatasetError> {
    let text = read_text(list)?;
    let times = data_lines(&text).map(|(_, line)| line.split(',').next().unwrap_or_default());
    let unit = TimeUnit::of(times);
    note_unit(list, unit, TimeUnit::Nanoseconds, warnings);
    let entry = |(number, line): (usize, &str)| {
        let (time, name) = line.split_once(',').unwrap_or((line, ""));
        let name = name.trim();
        match unit.parse(time) {
            Some(timestamp_ns) if !name.is_empty() => {
                Ok((timestamp_ns, camera.join("data").join(name)))
            }
            _ => {
                let expected = "integer nanoseconds, a comma and the name of an image in cam0/data";
                Err(DatasetError::line(list, number, line, expected))
            }
        }
    };
    data_lines(&text).map(entry).collect()
}
