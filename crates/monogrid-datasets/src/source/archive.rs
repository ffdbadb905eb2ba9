//! Sequences in an archive: what they need is unpacked to a temporary folder, which goes with the data set.

use crate::{DatasetError, open_file};
use flate2::read::{DeflateDecoder, GzDecoder};
use rawzip::{CompressionMethod, FileReader, RECOMMENDED_BUFFER_SIZE, ZipArchive, ZipEntry};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};
use tempfile::TempDir;

/// Endings of the files of a sequence; nothing else is unpacked.
const USEFUL: [&str; 14] = [
    "png", "jpg", "jpeg", "pgm", "ppm", "pnm", "txt", "csv", "toml", "yaml", "yml", "cfg", "xml",
    "md",
];

/// Bytes that may come out of one byte of an archive: images hardly shrink, lists by ten. What grows more is no video.
const MAX_GROWTH: u64 = 100;

/// Files of an archive at most: nine hours at 30 frames per second.
const MAX_FILES: usize = 1_000_000;

/// An archive whose files were unpacked; they are deleted with it.
#[derive(Debug)]
pub(super) struct Unpacked {
    archive: PathBuf,
    folder: TempDir,
    num_files: usize,
    num_bytes: u64,
    max_bytes: u64,
}

/// Whether a file is called like an archive that can be unpacked.
pub(super) fn is_archive(path: &Path) -> bool {
    kind_of(path).is_some()
}

#[derive(Clone, Copy)]
enum Kind {
    Zip,
    Tar,
    TarGz,
}

/// What endings of names say.
const KINDS: [(&str, Kind); 4] = [
    (".zip", Kind::Zip),
    (".tar", Kind::Tar),
    (".tar.gz", Kind::TarGz),
    (".tgz", Kind::TarGz),
];

fn kind_of(path: &Path) -> Option<Kind> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let said = KINDS.iter().find(|(ending, _)| name.ends_with(ending));
    said.map(|(_, kind)| *kind)
}

/// Name of an archive without its ending.
pub(super) fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let lower = name.to_ascii_lowercase();
    let mut endings = KINDS.iter().map(|(ending, _)| ending);
    let stem = endings.find_map(|ending| lower.strip_suffix(ending));
    let length = stem.map_or(name.len(), str::len);
    name.get(..length).unwrap_or(&name).to_owned()
}

impl Unpacked {
    /// Unpacks the files of a sequence.
    ///
    /// # Errors
    /// When the archive cannot be read or is damaged, the disk is full, or much more comes out than images would be.
    pub(super) fn new(path: &Path) -> Result<Self, DatasetError> {
        let (file, length) = open_file(path)?;
        let folder = tempfile::tempdir().map_err(|e| DatasetError::io("write", path, e))?;
        let mut this = Self {
            archive: path.to_path_buf(),
            folder,
            num_files: 0,
            num_bytes: 0,
            max_bytes: length.saturating_mul(MAX_GROWTH),
        };
        match kind_of(path) {
            Some(Kind::Zip) => this.zip(file)?,
            Some(Kind::TarGz) => this.tar(GzDecoder::new(io::BufReader::new(file)))?,
            Some(Kind::Tar) | None => this.tar(file)?,
        }
        match this.num_files {
            0 => Err(this.refused("no images", "an archive of images")),
            _ => Ok(this),
        }
    }

    /// The folder of the sequence: the outermost one that holds more than another folder.
    pub(super) fn root(&self) -> PathBuf {
        let mut root = self.folder.path().to_path_buf();
        loop {
            let mut entries = fs::read_dir(&root).into_iter().flatten().flatten();
            match (entries.next(), entries.next()) {
                (Some(only), None) if only.path().is_dir() => root = only.path(),
                _ => return root,
            }
        }
    }

    /// What was done, in a sentence for people.
    pub(super) fn note(&self) -> String {
        format!(
            "{} files ({:.0} MB) were unpacked to a temporary folder; unpacked by hand they start faster",
            self.num_files,
            self.num_bytes as f64 / 1e6
        )
    }

    fn refused(&self, found: impl Into<String>, expected: impl Into<String>) -> DatasetError {
        DatasetError::content(&self.archive, found, expected)
    }

    fn zip(&mut self, file: File) -> Result<(), DatasetError> {
        let archive = self.archive.clone();
        let damaged = |e: rawzip::Error| damaged(&archive, &e);
        let mut buffer = vec![0; RECOMMENDED_BUFFER_SIZE];
        let zip = ZipArchive::from_file(file, &mut buffer).map_err(damaged)?;
        let mut entries = zip.entries(&mut buffer);
        while let Some(entry) = entries.next_entry().map_err(damaged)? {
            if entry.is_dir() || entry.mode().is_symlink() {
                continue;
            }
            let name = entry.file_path();
            let name = PathBuf::from(String::from_utf8_lossy(name.as_ref()).as_ref());
            // who does not know the key sees noise
            let method = match entry.flags().is_encrypted() {
                false => entry.compression_method(),
                true => return Err(self::damaged(&archive, &"its files are encrypted")),
            };
            let packed = zip.get_entry(entry.wayfinder()).map_err(damaged)?;
            self.packed_file(&name, &packed, method)?;
        }
        Ok(())
    }

    /// Unpacks one file of a zip file, whose bytes must be those that went in.
    fn packed_file(
        &mut self,
        name: &Path,
        packed: &ZipEntry<'_, FileReader>,
        method: CompressionMethod,
    ) -> Result<(), DatasetError> {
        let bytes = packed.reader();
        match method {
            CompressionMethod::STORE => self.file(name, &mut packed.verifying_reader(bytes)),
            CompressionMethod::DEFLATE => {
                let inflated = DeflateDecoder::new(bytes);
                self.file(name, &mut packed.verifying_reader(inflated))
            }
            other => {
                let what = format!("method {} of packing is not known", other.as_u16());
                Err(damaged(&self.archive, &what))
            }
        }
    }

    fn tar(&mut self, bytes: impl Read) -> Result<(), DatasetError> {
        let archive = self.archive.clone();
        let damaged = |e: io::Error| damaged(&archive, &e);
        // what is left out is read as well
        let bounded = bytes.take(self.max_bytes.saturating_add(1));
        let mut tar = tar::Archive::new(bounded);
        for entry in tar.entries().map_err(damaged)? {
            let mut entry = entry.map_err(damaged)?;
            let name = entry.path().map_err(damaged)?.into_owned();
            if entry.header().entry_type().is_file() {
                self.file(&name, &mut entry)?;
            }
        }
        Ok(())
    }

    /// Unpacks one file, if a sequence needs it; a name that leads elsewhere is left out, the first of two counts.
    fn file(&mut self, name: &Path, content: &mut impl Read) -> Result<(), DatasetError> {
        let ending = name.extension().unwrap_or_default().to_string_lossy();
        let is_useful = USEFUL.contains(&ending.to_ascii_lowercase().as_str());
        let is_inside = |part| matches!(part, Component::Normal(_) | Component::CurDir);
        let stays_inside = name.components().all(is_inside);
        let path = self.folder.path().join(name);
        if !is_useful || !stays_inside || path.exists() {
            return Ok(());
        }
        self.num_files += 1;
        let left = self.max_bytes - self.num_bytes;
        if self.num_files > MAX_FILES {
            let found = format!("more than {MAX_FILES} files");
            return Err(self.refused(found, "the images of one sequence"));
        }
        let write = |e| DatasetError::io("write", &path, e);
        fs::create_dir_all(path.parent().unwrap_or(&path)).map_err(write)?;
        let mut file = File::create_new(&path).map_err(write)?;
        let copied = io::copy(&mut content.take(left + 1), &mut file);
        let num_bytes = copied.map_err(|e| DatasetError::io("unpack", &self.archive, e))?;
        if num_bytes > left {
            let found = format!("files of more than {} bytes", self.max_bytes);
            let expected = format!("at most {MAX_GROWTH} times the size of the archive");
            return Err(self.refused(found, expected));
        }
        self.num_bytes += num_bytes;
        Ok(())
    }
}

fn damaged(archive: &Path, error: &dyn std::fmt::Display) -> DatasetError {
    let found = format!("an archive that cannot be read ({error})");
    DatasetError::content(archive, found, "a whole zip, tar or tar.gz file")
}
