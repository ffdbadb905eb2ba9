//! The list of what was written into a folder, kept in it while it is written.
//!
//! One line per file: CRC-32 (hexadecimal), size in bytes, name with `/`. A `+` after the size says
//! that the file grows: it begins with so many bytes of that sum. Later lines replace earlier ones,
//! so that lines are only ever appended, each *before* its file gets its name: a process that is
//! killed leaves no file that is not listed. A file that is written with the folder and lies
//! outside of it (`--mcap`) has its whole path for a name.

use monogrid_datasets::open_file;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Name of the manifest in its folder.
pub const MANIFEST: &str = "monogrid-manifest.txt";

const TITLE: &str =
    "# what monogrid wrote into this folder: CRC-32, size (+ where it may have grown), name";
/// Begins the line with the number of the process that writes.
const PROCESS: &str = "# process ";

/// Sum and size of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digest {
    crc: u32,
    len: u64,
}

/// Which part of a file is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// All of it.
    Whole,
    /// What it begins with.
    Begins,
}

/// A manifest that is open, and locked for as long as it is.
#[derive(Debug)]
pub struct Manifest {
    file: File,
}

/// What a manifest says.
#[derive(Debug, Default)]
pub struct Listed {
    files: BTreeMap<String, (Digest, Content)>,
    processes: Vec<String>,
}

/// Why a manifest cannot be opened.
#[derive(Debug)]
pub enum OpenError {
    /// Another process writes into the folder.
    Busy,
    /// There is a file of that name that is no manifest.
    Foreign,
    /// The file cannot be opened or read.
    Io(io::Error),
}

impl From<io::Error> for OpenError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl Manifest {
    /// Opens and locks the manifest of a folder, which is made where there is none, and reads it.
    pub fn open(folder: &Path) -> Result<(Self, Listed), OpenError> {
        let path = folder.join(MANIFEST);
        if std::fs::symlink_metadata(&path).is_ok_and(|metadata| !metadata.is_file()) {
            return Err(OpenError::Foreign);
        }
        let mut options = OpenOptions::new();
        let file = options.read(true).append(true).create(true).open(&path)?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => return Err(OpenError::Busy),
            // a file system without locks: two processes are then not kept apart
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        let this = Self { file };
        let listed = this.listed()?;
        Ok((this, listed))
    }

    /// What the manifest of a folder lists, also while somebody holds it; `None` where there is
    /// none.
    pub fn read(folder: &Path) -> Option<Listed> {
        let path = folder.join(MANIFEST);
        let file = path.is_file().then(|| File::open(&path).ok())??;
        Self { file }.listed().ok()
    }

    /// What was listed until now.
    pub fn listed(&self) -> Result<Listed, OpenError> {
        let mut file = &self.file;
        file.seek(SeekFrom::Start(0))?;
        let mut text = String::new();
        match file.read_to_string(&mut text) {
            Ok(_) if text.is_empty() || text.starts_with(TITLE) => Ok(Listed::parse(&text)),
            Ok(_) => Err(OpenError::Foreign),
            Err(error) if error.kind() == io::ErrorKind::InvalidData => Err(OpenError::Foreign),
            Err(error) => Err(error.into()),
        }
    }

    /// Forgets what was listed.
    pub fn clear(&self) -> io::Result<()> {
        self.file.set_len(0)
    }

    /// Says who writes from now on.
    pub fn begin(&self) -> io::Result<()> {
        let is_new = (&self.file).seek(SeekFrom::End(0))? == 0;
        if is_new {
            self.line(TITLE)?;
        }
        self.line(&format!("{PROCESS}{}", std::process::id()))
    }

    /// Lists a file.
    pub fn list(&self, name: &str, digest: Digest, content: Content) -> io::Result<()> {
        let more = match content {
            Content::Whole => "",
            Content::Begins => "+",
        };
        self.line(&format!("{:08x} {}{more} {name}", digest.crc, digest.len))
    }

    /// One write per line, so that lines of several threads do not mix.
    fn line(&self, line: &str) -> io::Result<()> {
        (&self.file).write_all(format!("{line}\n").as_bytes())
    }
}

impl Listed {
    fn parse(text: &str) -> Self {
        let mut listed = Self::default();
        for line in text.lines() {
            if let Some(process) = line.strip_prefix(PROCESS) {
                listed.processes.push(process.to_owned());
            } else if let Some((name, content)) = parse_line(line) {
                listed.files.insert(name.to_owned(), content);
            }
        }
        listed
    }

    /// Files that lie outside of the folder, by their whole paths, that are as they were written.
    pub fn beside(&self) -> impl Iterator<Item = (&str, Digest, Content)> {
        let outside = self.files.iter().filter(|(name, (digest, content))| {
            let path = Path::new(name);
            // whoever wrote the list may have named a pipe
            path.is_absolute() && path.is_file() && digest.is_of(*content, path)
        });
        outside.map(|(name, (digest, content))| (name.as_str(), *digest, *content))
    }

    /// Whether a file is one of ours, as it was written: listed, or the half of one that a killed
    /// process left.
    pub fn is_ours(&self, name: &str, path: &Path) -> bool {
        let file = name.rsplit_once('/').map_or(name, |(_, file)| file);
        let is_part =
            |process: &String| file.starts_with('.') && file.ends_with(&format!(".{process}.part"));
        match self.files.get(name) {
            Some((digest, content)) => digest.is_of(*content, path),
            None => self.processes.iter().any(is_part),
        }
    }
}

fn parse_line(line: &str) -> Option<(&str, (Digest, Content))> {
    let mut words = line.splitn(3, ' ');
    let crc = u32::from_str_radix(words.next()?, 16).ok()?;
    let size = words.next()?;
    let name = words.next()?;
    let (size, content) = match size.strip_suffix('+') {
        Some(size) => (size, Content::Begins),
        None => (size, Content::Whole),
    };
    let len = size.parse().ok()?;
    Some((name, (Digest { crc, len }, content)))
}

impl Digest {
    /// Whether it is that of a file, or of what the file begins with.
    fn is_of(self, content: Content, path: &Path) -> bool {
        // opening a pipe would wait for a writer
        let Ok((file, len)) = open_file(path) else {
            return false;
        };
        let may_be = match content {
            Content::Whole => len == self.len,
            Content::Begins => len >= self.len,
        };
        may_be && Self::of(file.take(self.len)).is_ok_and(|found| found == self)
    }
    /// Of everything that can be read.
    pub fn of(bytes: impl Read) -> io::Result<Self> {
        let mut sum = Summed::new(io::sink());
        io::copy(&mut BufReader::with_capacity(1 << 18, bytes), &mut sum)?;
        Ok(sum.digest())
    }
}

/// Passes bytes on and sums them up.
pub struct Summed<W> {
    inner: W,
    crc: crc32fast::Hasher,
    len: u64,
}

impl<W: Write> Summed<W> {
    /// Nothing passed on yet.
    pub fn new(inner: W) -> Self {
        Self {
            inner,
            crc: crc32fast::Hasher::new(),
            len: 0,
        }
    }

    /// Of all that was passed on.
    pub fn digest(self) -> Digest {
        Digest {
            crc: self.crc.finalize(),
            len: self.len,
        }
    }
}

impl<W: Write> Write for Summed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(bytes)?;
        self.crc.update(&bytes[..written]);
        self.len += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}
