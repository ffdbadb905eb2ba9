//! What files hold: SHA-256 of their content, and a quicker stamp of names, sizes and times.

use super::outputs::Written;
use super::sha256::{sha256_of, sha256_of_file};
use super::task::Task;
use monogrid_app::output::{changed_ns, resolved};
use monogrid_datasets::{Dataset, SourceOptions};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Folders in folders of a source that are looked into.
const MAX_DEPTH: usize = 16;

/// What a task reads.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputRecord {
    /// Files.
    pub files: usize,
    /// Bytes of all of them.
    pub bytes: u64,
    /// SHA-256 of the lines `HASH  NAME`, as `sha256sum` prints them, of all files; of the source
    /// first.
    pub sha256: String,
    /// Hash of names, sizes and times of change: as long as it stays, the content is not read
    /// again.
    pub stamp: String,
}

/// A file that came out of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputRecord {
    /// Its size.
    pub bytes: u64,
    /// Its content.
    pub sha256: String,
}

impl OutputRecord {
    /// Of a file.
    pub fn of(path: &Path) -> io::Result<Self> {
        let bytes = fs::metadata(path)?.len();
        let sha256 = sha256_of_file(path)?;
        Ok(Self { bytes, sha256 })
    }
}

/// The files that a task of a batch that writes these reads: those of its source by their names in
/// it, then those of its options.
fn files_of(task: &Task, written: &Written) -> io::Result<Vec<(String, PathBuf)>> {
    let source = &task.source;
    let mut files = Vec::new();
    if fs::metadata(source)?.is_dir() {
        collect(source, Path::new(""), 0, &mut files)?;
    } else {
        let name = source.file_name().unwrap_or_default();
        files.push((name.to_string_lossy().into_owned(), source.clone()));
        files.extend(images_of_list(source));
    }
    // what is written into the folder of a recording is nothing that is read
    let root = resolved(source);
    let written: Vec<&Path> = written.below(&root).collect();
    let is_read = |path: &Path| {
        let name = path.strip_prefix(source).unwrap_or(path);
        !written.iter().any(|at| name.starts_with(at))
    };
    files.retain(|(_, path): &(String, PathBuf)| is_read(path));
    for path in &task.option_files {
        files.push((path.to_string_lossy().into_owned(), path.clone()));
    }
    Ok(files)
}

/// The files that a list of images names.
fn images_of_list(source: &Path) -> Vec<(String, PathBuf)> {
    if source.extension().is_none_or(|ending| ending != "txt") {
        return Vec::new();
    }
    let dataset = Dataset::open(source, SourceOptions::default());
    let frames = dataset.into_iter().flat_map(|dataset| dataset.frames);
    let named = frames.map(|frame| (frame.path.to_string_lossy().into_owned(), frame.path));
    named.collect()
}

/// All files below a folder, in the order of their names; links to files are followed, those to
/// folders are not.
fn collect(
    root: &Path,
    below: &Path,
    depth: usize,
    files: &mut Vec<(String, PathBuf)>,
) -> io::Result<()> {
    let mut entries = fs::read_dir(root.join(below))?.collect::<io::Result<Vec<_>>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let name = below.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            if depth < MAX_DEPTH {
                collect(root, &name, depth + 1, files)?;
            }
        } else if entry.path().is_file() {
            files.push((name.to_string_lossy().into_owned(), entry.path()));
        }
    }
    Ok(())
}

/// Names, sizes and times of what a task reads.
pub fn stamp(task: &Task, written: &Written) -> io::Result<String> {
    let mut text = String::new();
    for (name, path) in files_of(task, written)? {
        let metadata = fs::metadata(&path)?;
        let (length, changed) = (metadata.len(), changed_ns(&metadata));
        let _ = writeln!(text, "{name}\t{length}\t{changed}");
    }
    Ok(sha256_of(text.as_bytes()))
}

/// What a task reads, content included.
pub fn read_inputs(task: &Task, written: &Written) -> io::Result<InputRecord> {
    let mut lines = String::new();
    let mut record = InputRecord {
        stamp: stamp(task, written)?,
        ..InputRecord::default()
    };
    for (name, path) in files_of(task, written)? {
        let _ = writeln!(lines, "{}  {name}", sha256_of_file(&path)?);
        record.files += 1;
        record.bytes += fs::metadata(&path)?.len();
    }
    record.sha256 = sha256_of(lines.as_bytes());
    Ok(record)
}

/// All files below the folder of a run, with their content.
pub fn read_outputs(folder: &Path) -> io::Result<Vec<(String, OutputRecord)>> {
    let mut files = Vec::new();
    if folder.is_dir() {
        collect(folder, Path::new(""), 0, &mut files)?;
    }
    let of_file =
        |(name, path): (String, PathBuf)| Ok((name.replace('\\', "/"), OutputRecord::of(&path)?));
    files.into_iter().map(of_file).collect()
}
