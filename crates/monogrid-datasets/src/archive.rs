//! Sequences in an archive. Their files are read where they are: nothing is unpacked that could be
//! seen by others or left behind.
//!
//! While an [`Archive`] lives, paths lead through it as through a folder (`set.zip/rgb/1.png`): the
//! functions of [`crate::files`] know all archives that are open. A zip file says itself where its
//! files are, a tar file is looked through once. A gzipped tar file has no such places: it is
//! decompressed to a file without a name, which the system deletes when the program ends, however
//! it ends.

use crate::images::IMAGE_ENDINGS;
use crate::{DatasetError, open_file};
use flate2::read::{DeflateDecoder, GzDecoder};
use rawzip::{
    CompressionMethod, FileReader, RECOMMENDED_BUFFER_SIZE, ReaderAt, ZipArchive,
    ZipArchiveEntryWayfinder,
};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::ops::Bound;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Endings of the files of a sequence beside those of images; nothing else is listed.
const USEFUL: [&str; 9] = [
    "txt", "csv", "toml", "yaml", "yml", "cfg", "xml", "json", "md",
];

/// Bytes that may come out of one byte of an archive: images hardly shrink, lists by ten.
/// An archive that grows more holds no video.
const MAX_GROWTH: u64 = 100;

/// Entries of an archive at most: nine hours at 30 frames per second.
const MAX_ENTRIES: usize = 1_000_000;

/// Longest name of a file, and largest header that holds one, bytes.
const MAX_NAME_BYTES: u64 = 1 << 16;

/// Room that is left on a disk, bytes.
const SPARE_BYTES: u64 = 64 << 20;

/// An archive whose files can be read.
#[derive(Debug)]
pub(crate) struct Archive {
    path: PathBuf,
    container: Container,
    /// By their names, without `.` and `..`.
    files: BTreeMap<PathBuf, Place>,
    /// Length of the archive, bytes.
    stored_bytes: u64,
    /// Length of the file that a gzipped archive was decompressed to, bytes.
    decompressed_bytes: Option<u64>,
}

#[derive(Debug)]
enum Container {
    Zip(Box<ZipArchive<FileReader>>),
    Tar(FileReader),
}

/// Where a file is in its archive.
#[derive(Clone, Copy, Debug)]
enum Place {
    /// Entry, whether it is compressed, and the bytes that it claims.
    Zip(ZipArchiveEntryWayfinder, bool, u64),
    /// First byte and number of bytes.
    Tar(u64, u64),
}

/// All archives that are open. A list for the whole process: paths are all that readers of images
/// are given.
static OPEN: Mutex<Vec<Weak<Archive>>> = Mutex::new(Vec::new());

/// The archive that a path leads into, and the name in it; the name is empty for the archive
/// itself.
pub(crate) fn within(path: &Path) -> Option<(Arc<Archive>, PathBuf)> {
    let open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
    let mut living = open.iter().rev().filter_map(Weak::upgrade);
    living.find_map(|archive| {
        let name = plain(path.strip_prefix(&archive.path).ok()?)?;
        Some((archive, name))
    })
}

/// A name without `.` and `..`; `None` if it leads elsewhere.
fn plain(name: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for component in name.components() {
        match component {
            Component::Normal(part) => plain.push(part),
            Component::CurDir => {}
            Component::ParentDir if plain.pop() => {}
            _ => return None,
        }
    }
    Some(plain)
}

/// Whether a file is called like an archive that can be read.
pub(crate) fn is_archive(path: &Path) -> bool {
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
pub(crate) fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let lower = name.to_ascii_lowercase();
    let mut endings = KINDS.iter().map(|(ending, _)| ending);
    let stem = endings.find_map(|ending| lower.strip_suffix(ending));
    let length = stem.map_or(name.len(), str::len);
    name.get(..length).unwrap_or(&name).to_owned()
}

impl Archive {
    /// Finds out where the files of a sequence are. Their paths can be read as long as what is
    /// returned lives.
    ///
    /// # Errors
    /// When the archive cannot be read or is damaged, it holds much more than images would need,
    /// or, of a gzipped one, the disk is full.
    pub(crate) fn open(path: &Path) -> Result<Arc<Self>, DatasetError> {
        let (file, length) = open_file(path)?;
        let of_archive = Listing {
            path,
            max_bytes: length.saturating_mul(MAX_GROWTH),
            num_bytes: 0,
            num_entries: 0,
            files: BTreeMap::new(),
        };
        let (container, files, decompressed_bytes) = match kind_of(path) {
            Some(Kind::Zip) => of_archive.zip(file)?,
            Some(Kind::TarGz) => of_archive.tar_gz(file, length)?,
            Some(Kind::Tar) | None => of_archive.tar(file, length, None)?,
        };
        if files.is_empty() {
            let (found, expected) = ("no images", "an archive of images");
            return Err(DatasetError::content(path, found, expected));
        }
        let archive = Arc::new(Self {
            path: path.to_path_buf(),
            container,
            files,
            stored_bytes: length,
            decompressed_bytes,
        });
        let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|other| other.strong_count() > 0);
        open.push(Arc::downgrade(&archive));
        Ok(archive)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of the archive itself, however many files share them.
    pub(crate) fn stored_bytes(&self) -> u64 {
        self.stored_bytes
    }

    /// The folder of the sequence: the outermost one that holds more than another folder.
    pub(crate) fn root(&self) -> PathBuf {
        // names are in order: what the first and the last have in common, all have
        let first = self.files.keys().next().and_then(|name| name.parent());
        let last = self.files.keys().next_back().and_then(|name| name.parent());
        let (first, last) = (
            first.unwrap_or(Path::new("")),
            last.unwrap_or(Path::new("")),
        );
        let common = first.components().zip(last.components());
        let common = common.take_while(|(one, other)| one == other);
        let root: PathBuf = common.map(|(folder, _)| folder).collect();
        self.path.join(root)
    }

    /// What reading it needs, in a sentence for people; `None` where that is nothing.
    pub(crate) fn note(&self) -> Option<String> {
        self.decompressed_bytes.map(|bytes| {
            format!(
                "{} was decompressed first ({:.0} MB in the folder for temporary files); a .zip or \
                 .tar file starts faster",
                self.path.display(),
                bytes as f64 / 1e6
            )
        })
    }

    pub(crate) fn is_file(&self, name: &Path) -> bool {
        self.files.contains_key(name)
    }

    pub(crate) fn is_folder(&self, name: &Path) -> bool {
        !self.is_file(name) && self.below(name).next().is_some()
    }

    /// Names of files and folders in a folder.
    pub(crate) fn names_in(&self, folder: &Path) -> Vec<PathBuf> {
        let rest = self.below(folder).filter_map(|name| {
            let first = name.strip_prefix(folder).ok()?.components().next()?;
            Some(PathBuf::from(first.as_os_str()))
        });
        let mut names: Vec<PathBuf> = rest.collect();
        names.dedup();
        names
    }

    /// Files in a folder and the folders in it; paths are ordered by their components.
    fn below(&self, folder: &Path) -> impl Iterator<Item = &Path> {
        let from = (Bound::Included(folder), Bound::Unbounded);
        let names = self.files.range::<Path, _>(from).map(|(name, _)| name);
        names
            .map(PathBuf::as_path)
            .take_while(move |name| name.starts_with(folder))
    }

    /// Reads at most `max_bytes` of a file, and whether there are no more. The bytes are those that
    /// were packed.
    pub(crate) fn read(&self, name: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
        let place = self.files.get(name).ok_or(io::ErrorKind::NotFound)?;
        let mut bytes = Vec::new();
        match (&self.container, *place) {
            (Container::Zip(zip), Place::Zip(entry, is_compressed, claimed)) => {
                let packed = zip.get_entry(entry).map_err(io::Error::other)?;
                let content: Box<dyn Read + '_> = match is_compressed {
                    true => Box::new(DeflateDecoder::new(packed.reader())),
                    false => Box::new(packed.reader()),
                };
                // one byte more than it claims: then the checksum is compared, or the claim found
                // wrong
                let most = max_bytes.min(claimed.saturating_add(1));
                let verified = packed.verifying_reader(content);
                verified.take(most).read_to_end(&mut bytes)?;
            }
            (Container::Tar(file), Place::Tar(first, length)) => {
                bytes.resize(length.min(max_bytes) as usize, 0);
                file.read_exact_at(&mut bytes, first)?;
            }
            _ => return Err(io::ErrorKind::NotFound.into()),
        }
        Ok(bytes)
    }
}

type Listed = (Container, BTreeMap<PathBuf, Place>, Option<u64>);

/// The files of an archive while they are looked for.
struct Listing<'a> {
    path: &'a Path,
    /// Bytes that all files together may have, and those that they have so far.
    max_bytes: u64,
    num_bytes: u64,
    num_entries: usize,
    files: BTreeMap<PathBuf, Place>,
}

impl Listing<'_> {
    fn damaged(&self, error: &dyn std::fmt::Display) -> DatasetError {
        let found = format!("an archive that cannot be read ({error})");
        DatasetError::content(self.path, found, "a whole zip, tar or tar.gz file")
    }

    fn grows(&self) -> DatasetError {
        let found = format!("files of more than {} bytes", self.max_bytes);
        let expected = format!("at most {MAX_GROWTH} times the size of the archive");
        DatasetError::content(self.path, found, expected)
    }

    fn count(&mut self) -> Result<(), DatasetError> {
        self.num_entries += 1;
        if self.num_entries > MAX_ENTRIES {
            let found = format!("more than {MAX_ENTRIES} files");
            let expected = "the images of one sequence";
            return Err(DatasetError::content(self.path, found, expected));
        }
        Ok(())
    }

    /// Lists a file, if a sequence needs it; a name that leads elsewhere is left out, the first of
    /// two counts.
    fn add(&mut self, name: &Path, length: u64, place: Place) -> Result<(), DatasetError> {
        self.num_bytes = self.num_bytes.saturating_add(length);
        if self.num_bytes > self.max_bytes {
            return Err(self.grows());
        }
        let stays_inside = !name.components().any(|part| part == Component::ParentDir);
        if let Some(name) = plain(name).filter(|_| stays_inside) {
            self.files.entry(name).or_insert(place);
        }
        Ok(())
    }

    fn zip(mut self, file: File) -> Result<Listed, DatasetError> {
        let mut buffer = vec![0; RECOMMENDED_BUFFER_SIZE];
        let opened = ZipArchive::from_file(file, &mut buffer);
        let zip = opened.map_err(|error| self.damaged(&error))?;
        let mut entries = zip.entries(&mut buffer);
        loop {
            let entry = entries.next_entry();
            let Some(entry) = entry.map_err(|error| self.damaged(&error))? else {
                break;
            };
            self.count()?;
            let name = entry.file_path();
            let name = PathBuf::from(String::from_utf8_lossy(name.as_ref()).as_ref());
            if entry.is_dir() || entry.mode().is_symlink() || !is_useful(&name) {
                continue;
            }
            // who does not know the key sees noise
            if entry.flags().is_encrypted() {
                return Err(self.damaged(&"its files are encrypted"));
            }
            let is_compressed = match entry.compression_method() {
                CompressionMethod::STORE => false,
                CompressionMethod::DEFLATE => true,
                other => {
                    let what = format!("method {} of packing is not known", other.as_u16());
                    return Err(self.damaged(&what));
                }
            };
            let length = entry.uncompressed_size_hint();
            let place = Place::Zip(entry.wayfinder(), is_compressed, length);
            self.add(&name, length, place)?;
        }
        Ok((Container::Zip(Box::new(zip)), self.files, None))
    }

    /// Decompresses to a file without a name, which is private and goes with the process in every
    /// case.
    fn tar_gz(self, mut file: File, length: u64) -> Result<Listed, DatasetError> {
        let write = |error| DatasetError::io("decompress", self.path, error);
        // what comes out, by the end of the file: of 4 GB and more too few
        let mut size = [0; 4];
        file.seek(SeekFrom::Start(length.saturating_sub(4)))
            .and_then(|_| file.read_exact(&mut size))
            .and_then(|()| file.rewind())
            .map_err(|error| self.damaged(&error))?;
        let size = u64::from(u32::from_le_bytes(size)).min(self.max_bytes);
        let mut out = tempfile::tempfile().map_err(write)?;
        let needed = size.max(length) + SPARE_BYTES;
        if let Some(free) = free_bytes(&out).filter(|free| *free < needed) {
            let found = format!(
                "{free} bytes free in {} for what is in it",
                std::env::temp_dir().display()
            );
            let expected = format!("at least {needed}: set TMPDIR, or unpack it yourself");
            return Err(DatasetError::content(self.path, found, expected));
        }
        let bounded = GzDecoder::new(BufReader::new(file)).take(self.max_bytes + 1);
        let copied = io::copy(&mut { bounded }, &mut out);
        let num_bytes = copied.map_err(|error| match error.kind() {
            io::ErrorKind::StorageFull => write(error),
            _ => self.damaged(&error),
        })?;
        if num_bytes > self.max_bytes {
            return Err(self.grows());
        }
        out.rewind().map_err(write)?;
        self.tar(out, num_bytes, Some(num_bytes))
    }

    fn tar(
        mut self,
        file: File,
        length: u64,
        decompressed_bytes: Option<u64>,
    ) -> Result<Listed, DatasetError> {
        let mut tar = tar::Archive::new(&file);
        let entries = tar.entries_with_seek();
        let entries = entries.map_err(|error| self.damaged(&error))?;
        // of headers before a file
        let mut long_name = None;
        // raw: otherwise names and other headers of any length would be held in memory
        for entry in entries.raw(true) {
            let mut entry = entry.map_err(|error| self.damaged(&error))?;
            self.count()?;
            let (first, size) = (entry.raw_file_position(), entry.size());
            if first.saturating_add(size) > length {
                return Err(self.damaged(&"its last file is cut off"));
            }
            let kind = entry.header().entry_type();
            if kind.is_gnu_longname() || kind.is_pax_local_extensions() {
                if size > MAX_NAME_BYTES {
                    let what = format!("a name or header of {size} bytes");
                    return Err(self.damaged(&what));
                }
                let mut bytes = Vec::new();
                let read = entry.read_to_end(&mut bytes);
                read.map_err(|error| self.damaged(&error))?;
                let name = match kind.is_gnu_longname() {
                    true => bytes.split(|byte| *byte == 0).next().map(<[u8]>::to_vec),
                    false => self.pax_name(&bytes)?,
                };
                long_name = name.or(long_name);
                continue;
            }
            // names of links and headers for all files lie between
            if kind.is_gnu_longlink() || kind.is_pax_global_extensions() {
                continue;
            }
            let name = long_name.take();
            let name = name.unwrap_or_else(|| entry.path_bytes().into_owned());
            let name = PathBuf::from(String::from_utf8_lossy(&name).as_ref());
            if kind.is_file() && is_useful(&name) {
                self.add(&name, size, Place::Tar(first, size))?;
            }
        }
        let container = Container::Tar(FileReader::from(file));
        Ok((container, self.files, decompressed_bytes))
    }

    /// The name that a header of POSIX says, if it says one.
    fn pax_name(&self, header: &[u8]) -> Result<Option<Vec<u8>>, DatasetError> {
        let mut name = None;
        for extension in tar::PaxExtensions::new(header) {
            let extension = extension.map_err(|error| self.damaged(&error))?;
            match extension.key_bytes() {
                b"path" => name = Some(extension.value_bytes().to_vec()),
                // two readers that see different sizes see different files
                b"size" => return Err(self.damaged(&"a file of more than 8 GB")),
                _ => {}
            }
        }
        Ok(name)
    }
}

/// Whether a sequence may need a file of this name.
fn is_useful(name: &Path) -> bool {
    let ending = name.extension().unwrap_or_default().to_string_lossy();
    let ending = ending.to_ascii_lowercase();
    USEFUL.contains(&ending.as_str()) || IMAGE_ENDINGS.contains(&ending.as_str())
}

/// What the disk of a file has left; `None` where the system does not say.
fn free_bytes(file: &File) -> Option<u64> {
    #[cfg(unix)]
    return rustix::fs::fstatvfs(file)
        .ok()
        .map(|disk| disk.f_bavail.saturating_mul(disk.f_frsize));
    #[cfg(not(unix))]
    return {
        let _ = file;
        None
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_has_so_many_entries_and_no_more() {
        let mut listing = Listing {
            path: Path::new("a.zip"),
            max_bytes: 100,
            num_bytes: 0,
            num_entries: MAX_ENTRIES - 1,
            files: BTreeMap::new(),
        };
        assert!(listing.count().is_ok());
        let error = listing.count().expect_err("one too many").to_string();
        assert!(error.contains("more than 1000000 files"), "{error}");
        // nor more bytes, whatever their number
        let place = Place::Tar(0, 0);
        assert!(listing.add(Path::new("1.png"), 100, place).is_ok());
        let error = listing.add(Path::new("2.png"), u64::MAX, place);
        let error = error.expect_err("too much").to_string();
        assert!(error.contains("more than 100 bytes"), "{error}");
    }
}
