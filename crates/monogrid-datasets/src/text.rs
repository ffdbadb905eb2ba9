//! Reading small text files line by line.

use crate::{DatasetError, read_file};
use std::path::Path;

/// Largest text file that is read: far beyond any list of frames or poses.
const MAX_TEXT_BYTES: u64 = 1 << 28;

/// The text of a regular file; invalid UTF-8 is replaced (comments may be in any encoding).
///
/// # Errors
/// When it cannot be read, is a folder, pipe or device, or holds more than 256 MB.
pub fn read_text(path: &Path) -> Result<String, DatasetError> {
    let bytes = read_file(path, MAX_TEXT_BYTES)?;
    let text = String::from_utf8_lossy(&bytes);
    Ok(text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned())
}

/// Lines with content, numbered from 1, without comments (`#` to the end of the line).
pub(crate) fn data_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().filter_map(|(i, line)| {
        let content = line.split('#').next().unwrap_or("").trim();
        (!content.is_empty()).then_some((i + 1, content))
    })
}

/// Numbers separated by blanks, commas or tabs; `None` when one of them is not a number.
pub(crate) fn numbers(line: &str) -> Option<Vec<f64>> {
    let fields = line.split([' ', '\t', ',', ';']).filter(|s| !s.is_empty());
    fields.map(|s| s.parse().ok()).collect()
}

/// What stands before the first blank or comma of a line, and the rest.
pub(crate) fn first_word(line: &str) -> (&str, &str) {
    let cut = line.split_once(|c: char| c.is_whitespace() || c == ',');
    cut.unwrap_or((line, ""))
}
