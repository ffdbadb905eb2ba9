//! The files that a recording is made of, and how they are read.

use crate::chunks::{Unpacker, unpacked_file};
use crate::error::BagError;
use crate::{magic, mcap};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Mcap,
    Db3,
    Ros1,
}

impl Format {
    fn of(head: &[u8]) -> Option<Self> {
        let formats = [
            (mcap::MAGIC, Self::Mcap),
            (magic::SQLITE, Self::Db3),
            (magic::ROS1, Self::Ros1),
        ];
        let mut formats = formats.into_iter();
        formats
            .find(|(magic, _)| head.starts_with(magic))
            .map(|found| found.1)
    }
}

/// A file of a recording.
#[derive(Clone, Debug)]
pub struct Part {
    pub path: PathBuf,
    pub format: Format,
    /// Whether all of it is compressed.
    is_packed: bool,
    /// What is in it, then: a file without a name, which is gone when nobody reads it any more.
    unpacked: Option<Arc<File>>,
}

impl Part {
    /// A file by its first bytes; `None` where it is no recording.
    fn at(path: &Path) -> io::Result<Option<Self>> {
        let mut head = Vec::new();
        File::open(path)?.take(16).read_to_end(&mut head)?;
        let is_packed = head.starts_with(magic::ZSTD);
        if is_packed {
            head = unpacked_head(path);
        }
        Ok(Format::of(&head).map(|format| Self {
            path: path.to_owned(),
            format,
            is_packed,
            unpacked: None,
        }))
    }

    /// Decompresses it, where that must be done once for all readers.
    pub fn prepare(&mut self) -> Result<(), BagError> {
        if self.is_packed && self.unpacked.is_none() {
            let file = File::open(&self.path).map_err(BagError::io(&self.path))?;
            let unpacked = unpacked_file(&file);
            let unpacked = unpacked.map_err(|reason| BagError::damaged(&self.path, reason))?;
            self.unpacked = Some(Arc::new(unpacked));
        }
        Ok(())
    }

    /// Its bytes, from the first one on.
    pub fn open(&self) -> Result<Input, BagError> {
        let file = match &self.unpacked {
            Some(file) => Arc::clone(file),
            None => Arc::new(File::open(&self.path).map_err(BagError::io(&self.path))?),
        };
        Ok(Input { file, at: 0 })
    }

    /// For what is compressed in it, which is bounded by the bytes that are stored.
    pub fn unpacker(&self) -> Unpacker {
        Unpacker::of_file(std::fs::metadata(&self.path).map_or(0, |file| file.len()))
    }

    /// The name without what numbers the part and says how it is stored: `drive` of
    /// `drive_2.db3.zstd`.
    fn stem(&self) -> String {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let name = name.split('.').next().unwrap_or_default();
        match name.rsplit_once('_') {
            Some((stem, number)) if number.bytes().all(|b| b.is_ascii_digit()) => stem.to_owned(),
            _ => name.to_owned(),
        }
    }
}

/// Whether a file begins as one that was compressed as a whole.
pub fn is_packed(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(4).read_to_end(&mut head));
    read.is_ok() && head == magic::ZSTD
}

/// The first bytes of what is compressed; none where that is nothing.
fn unpacked_head(path: &Path) -> Vec<u8> {
    let head = || {
        let file = io::BufReader::new(File::open(path).ok()?);
        let decoder = ruzstd::decoding::StreamingDecoder::new(file).ok()?;
        let mut head = Vec::new();
        decoder.take(16).read_to_end(&mut head).ok()?;
        Some(head)
    };
    head().unwrap_or_default()
}

/// A file that any number of readers read, each from its own place.
#[derive(Clone, Debug)]
pub struct Input {
    file: Arc<File>,
    at: u64,
}

impl Input {
    #[cfg(test)]
    pub fn of(file: File) -> Self {
        Self {
            file: Arc::new(file),
            at: 0,
        }
    }

    /// Bytes of all of it.
    pub fn length(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }
}

impl Read for Input {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        #[cfg(unix)]
        let read = std::os::unix::fs::FileExt::read_at(&*self.file, bytes, self.at)?;
        #[cfg(windows)]
        let read = std::os::windows::fs::FileExt::seek_read(&*self.file, bytes, self.at)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for Input {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        let at = match position {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.length()?.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

/// The files of a recording; none where it is something else.
pub fn parts_of(path: &Path) -> io::Result<Vec<Part>> {
    let kind = std::fs::metadata(path)?;
    // a camera or a pipe is not read to find out what it is
    if kind.is_file() {
        return Ok(Part::at(path)?.into_iter().collect());
    }
    if !kind.is_dir() {
        return Ok(Vec::new());
    }
    let (mut parts, mut has_others) = (Vec::new(), false);
    for entry in std::fs::read_dir(path)? {
        let file = entry?.path();
        match file.is_file().then(|| Part::at(&file)) {
            Some(Ok(Some(part))) => parts.push(part),
            _ => has_others |= !may_lie_beside(&file),
        }
    }
    let is_declared = path.join("metadata.yaml").is_file();
    let is_one = !has_others
        && parts
            .windows(2)
            .all(|pair| pair[0].stem() == pair[1].stem());
    if !is_declared && !is_one {
        return Ok(Vec::new());
    }
    // parts are numbered: name_2 comes before name_10
    parts.sort_by_key(|part| {
        let name = part.path.to_string_lossy().into_owned();
        (name.len(), name)
    });
    Ok(parts)
}

/// Whether a file may lie in the folder of a recording that nothing else says to be one.
fn may_lie_beside(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let endings = ["yaml", "yml", "txt", "md", "json", "log"];
    let ending = file.extension().unwrap_or_default().to_string_lossy();
    file.is_file()
        && (name.starts_with('.')
            || endings.contains(&ending.as_ref())
            || ending.starts_with("db3-"))
}
