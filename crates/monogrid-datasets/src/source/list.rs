//! A text file as source: `timestamp path` or one path per line.

use super::folder::timed_at_rate;
use super::{Dataset, Layout, Parts, SourceOptions, tum};
use crate::DatasetError;
use crate::text::{data_lines, read_text};
use crate::timestamp::parse_seconds;
use std::path::{Path, PathBuf};

/// Opens a list of images; anything else that is a file is refused.
pub(super) fn open_list(list: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    let extension = list
        .extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    if extension != "txt" {
        return Err(DatasetError::SourceKind {
            path: list.to_path_buf(),
            found: format!("a .{extension} file"),
            expected: "a folder of images, a dataset folder or a .txt list of images",
        });
    }
    let root = match list.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let text = read_text(list)?;
    let Some((_, first)) = data_lines(&text).next() else {
        return Err(DatasetError::NoFrames {
            path: list.to_path_buf(),
            found: "a list without lines".to_owned(),
            expected: "lines of `timestamp path`, or a path per line",
        });
    };
    let mut words = first.split_whitespace();
    if words.next().and_then(parse_seconds).is_some() && words.next().is_some() {
        return tum::open(&root, list, options);
    }
    let paths = data_lines(&text)
        .map(|(_, line)| root.join(line))
        .collect::<Vec<_>>();
    let mut warnings = Vec::new();
    let entries = timed_at_rate(paths, options, list, &mut warnings)?;
    Dataset::assemble(
        Parts {
            root,
            layout: Layout::Folder,
            list: list.to_path_buf(),
            entries,
            depths: Vec::new(),
            ground_truth: None,
            calibration_path: None,
            warnings,
            unpacked: None,
        },
        options,
    )
}
