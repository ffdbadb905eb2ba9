//! TUM RGB-D layout: lists of time and relative path.

use super::{Dataset, DepthEntry, Layout, Parts, SourceOptions, note_unit};
use crate::DatasetError;
use crate::files::is_file;
use crate::text::{data_lines, first_word, read_text};
use crate::timestamp::TimeUnit;
use std::path::{Path, PathBuf};

/// Opens a folder of this layout.
pub(super) fn read(root: &Path, options: SourceOptions) -> Option<Result<Dataset, DatasetError>> {
    let mut lists = ["rgb.txt", "gray.txt"].into_iter();
    let list = lists.find_map(|name| Some(root.join(name)).filter(|list| is_file(list)))?;
    Some(open(root, &list, options))
}

/// Opens the sequence of `root` whose images are listed in `list`.
pub(super) fn open(
    root: &Path,
    list: &Path,
    options: SourceOptions,
) -> Result<Dataset, DatasetError> {
    let mut warnings = Vec::new();
    let entries = read_list(root, list, &mut warnings)?;
    if entries.is_empty() {
        let (found, expected) = ("a list without lines", "lines of `timestamp path`");
        return Err(DatasetError::no_frames(list, found, expected));
    }
    assemble(root, list, (entries, warnings), options)
}

/// Opens a folder that has `depth.txt` and no images.
pub(super) fn open_depth(root: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    assemble(root, &root.join("depth.txt"), Default::default(), options)
}

fn assemble(
    root: &Path,
    list: &Path,
    (entries, mut warnings): (Vec<(i64, PathBuf)>, Vec<String>),
    options: SourceOptions,
) -> Result<Dataset, DatasetError> {
    let depth_list = root.join("depth.txt");
    let depths = match is_file(&depth_list) {
        true => read_list(root, &depth_list, &mut warnings)?,
        false => Vec::new(),
    };
    let depth = |(timestamp_ns, path)| DepthEntry { timestamp_ns, path };
    Dataset::assemble(
        Parts {
            root: root.to_path_buf(),
            layout: match is_file(&root.join("associated.txt")) {
                true => Layout::Eth3d,
                false => Layout::Tum,
            },
            list: list.to_path_buf(),
            entries,
            depths: depths.into_iter().map(depth).collect(),
            warnings,
            ..Parts::default()
        },
        options,
    )
}

/// Whether it may be a path: no file has one of more bytes.
pub(super) fn is_path(text: &str) -> bool {
    (1..=4096).contains(&text.len())
}

/// Lines of `timestamp path`; paths are relative to `root` and may contain blanks.
fn read_list(
    root: &Path,
    list: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<(i64, PathBuf)>, DatasetError> {
    let text = read_text(list)?;
    let unit = TimeUnit::of(data_lines(&text).map(|(_, line)| first_word(line).0));
    note_unit(list, unit, TimeUnit::Seconds, warnings);
    let entry = |(number, line): (usize, &str)| {
        let (time, path) = first_word(line);
        let path = path.trim();
        match unit.parse(time) {
            Some(timestamp_ns) if is_path(path) => Ok((timestamp_ns, root.join(path))),
            _ => {
                let expected = "a time in seconds and the path of an image";
                Err(DatasetError::line(list, number, line, expected))
            }
        }
    };
    data_lines(&text).map(entry).collect()
}
