//! A text file as source: `timestamp path` or one path per line.

use super::folder::timed_at_rate;
use super::{Dataset, Parts, SourceOptions, tum};
use crate::DatasetError;
use crate::text::{data_lines, read_text};
use crate::timestamp::parse_seconds;
use std::path::{Path, PathBuf};

/// Opens a list of images; anything else that is a file is refused.
pub(super) fn open_list(list: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    let extension = list.extension().unwrap_or_default();
    let extension = extension.to_string_lossy().to_ascii_lowercase();
    if extension != "txt" {
        return Err(DatasetError::SourceKind {
            path: list.to_path_buf(),
            found: match extension.is_empty() {
                true => "a file of no kind that we know".to_owned(),
                false => format!("a .{extension} file"),
            },
            expected: "a folder of images, a dataset folder or a .txt list of images",
        });
    }
    let root = match list.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
        _ => PathBuf::from("."),
    };
    let text = read_text(list)?;
    let Some((_, first)) = data_lines(&text).next() else {
        let (found, expected) = (
            "a list without lines",
            "lines of `timestamp path`, or a path per line",
        );
        return Err(DatasetError::no_frames(list, found, expected));
    };
    let mut words = first.split_whitespace();
    if words.next().and_then(parse_seconds).is_some() && words.next().is_some() {
        return tum::open(&root, list, options);
    }
    let path = |(number, line): (usize, &str)| match tum::is_path(line) {
        true => Ok(root.join(line)),
        false => {
            let expected = "a time in seconds and the path of an image, or a path";
            Err(DatasetError::line(list, number, line, expected))
        }
    };
    let paths = data_lines(&text).map(path).collect::<Result<_, _>>()?;
    let mut warnings = Vec::new();
    let entries = timed_at_rate(paths, options, list, &mut warnings)?;
    Dataset::assemble(
        Parts {
            root,
            list: list.to_path_buf(),
            entries,
            is_at_rate: true,
            warnings,
            ..Parts::default()
        },
        options,
    )
}
