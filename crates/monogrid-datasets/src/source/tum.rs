//! TUM RGB-D layout: lists of time and relative path.

use super::{Dataset, DepthEntry, Layout, Parts, SourceOptions};
use crate::DatasetError;
use crate::text::{data_lines, read_text};
use crate::timestamp::parse_seconds;
use std::path::{Path, PathBuf};

/// Opens the sequence of `root` whose images are listed in `list`.
pub(super) fn open(
    root: &Path,
    list: &Path,
    options: SourceOptions,
) -> Result<Dataset, DatasetError> {
    let entries = read_list(root, list)?;
    if entries.is_empty() {
        return Err(DatasetError::NoFrames {
            path: list.to_path_buf(),
            found: "a list without lines".to_owned(),
            expected: "lines of `timestamp path`",
        });
    }
    assemble(root, list, entries, options)
}

/// Opens a folder that has `depth.txt` and no images.
pub(super) fn open_depth(root: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    assemble(root, &root.join("depth.txt"), Vec::new(), options)
}

fn assemble(
    root: &Path,
    list: &Path,
    entries: Vec<(i64, PathBuf)>,
    options: SourceOptions,
) -> Result<Dataset, DatasetError> {
    let depth_list = root.join("depth.txt");
    let depths = if depth_list.is_file() {
        read_list(root, &depth_list)?
            .into_iter()
            .map(|(timestamp_ns, path)| DepthEntry { timestamp_ns, path })
            .collect()
    } else {
        Vec::new()
    };
    Dataset::assemble(
        Parts {
            root: root.to_path_buf(),
            layout: Layout::Tum,
            list: list.to_path_buf(),
            entries,
            depths,
            ground_truth: None,
            calibration_path: None,
            warnings: Vec::new(),
            unpacked: None,
        },
        options,
    )
}

/// Lines of `timestamp path`; paths are relative to `root` and may contain blanks.
pub(super) fn read_list(root: &Path, list: &Path) -> Result<Vec<(i64, PathBuf)>, DatasetError> {
    let text = read_text(list)?;
    data_lines(&text)
        .map(|(number, line)| {
            let (time, path) = line
                .split_once(|c: char| c.is_whitespace() || c == ',')
                .unwrap_or((line, ""));
            let path = path.trim();
            match parse_seconds(time) {
                Some(timestamp_ns) if !path.is_empty() => Ok((timestamp_ns, root.join(path))),
                _ => Err(DatasetError::line(
                    list,
                    number,
                    line,
                    "a time in seconds and the path of an image",
                )),
            }
        })
        .collect()
}
