//! Packets in a file, one behind the other: the number of a packet is its place in it, from 0.

use crate::packet::{HEADER_BYTES, packet_bytes};
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A file of packets that only grows.
#[derive(Debug)]
pub struct PacketLog {
    place: Place,
    /// Where the packets begin, and where the last one ends.
    starts: Vec<u64>,
}

/// Where the packets are.
#[derive(Debug)]
enum Place {
    /// In a file that has no name any more.
    Nameless(File),
    /// In a file that is open only while it is used: a server has many, and a process few handles.
    Named(PathBuf),
}

impl PacketLog {
    /// An empty one, in a file that is gone when the log is.
    ///
    /// # Errors
    /// When no temporary file can be made.
    pub fn temporary() -> Result<Self> {
        Ok(Self {
            place: Place::Nameless(tempfile::tempfile()?),
            starts: vec![0],
        })
    }

    /// Opens a file, or makes it. A last packet that is cut off, as after a kill, is taken away.
    ///
    /// # Errors
    /// When the file cannot be read or written, or does not hold packets.
    pub fn open(path: &Path) -> Result<Self> {
        let mut file = open_or_make(path)?;
        let length = file.metadata()?.len();
        let mut starts = vec![0];
        let mut at = 0;
        while at + HEADER_BYTES as u64 <= length {
            let mut header = [0; HEADER_BYTES];
            file.seek(SeekFrom::Start(at))?;
            file.read_exact(&mut header)?;
            let bytes = packet_bytes(&header).ok_or_else(|| {
                let path = path.display();
                let text = format!(
                    "{path}: found other bytes at {at}, expected a packet: the file is damaged"
                );
                Error::new(ErrorKind::InvalidData, text)
            })?;
            at += bytes as u64;
            if at <= length {
                starts.push(at);
            }
        }
        let place = Place::Named(path.to_owned());
        let log = Self { place, starts };
        file.set_len(log.end())?;
        Ok(log)
    }

    fn file(&self) -> Result<File> {
        match &self.place {
            Place::Nameless(file) => file.try_clone(),
            Place::Named(path) => open_or_make(path),
        }
    }

    /// Number of packets, which is that of the next one.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.starts.len() as u64 - 1
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn end(&self) -> u64 {
        self.starts.last().copied().unwrap_or(0)
    }

    /// Appends the bytes of a packet; its number.
    ///
    /// # Errors
    /// When the disk is full; the log is then as it was.
    pub fn append(&mut self, packet: &[u8]) -> Result<u64> {
        let number = self.len();
        append_at(&mut self.file()?, self.end(), packet)?;
        self.starts.push(self.end() + packet.len() as u64);
        Ok(number)
    }

    /// Takes away all packets from this number on.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn truncate(&mut self, number: u64) -> Result<()> {
        let keep = usize::try_from(number).map_or(usize::MAX, |n| n.saturating_add(1));
        self.starts.truncate(keep);
        self.file()?.set_len(self.end())
    }

    /// The bytes of a packet; `None` where there is none of this number.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read(&self, number: u64) -> Result<Option<Vec<u8>>> {
        let at = usize::try_from(number).unwrap_or(usize::MAX);
        let (Some(start), Some(end)) = (self.starts.get(at), self.starts.get(at.saturating_add(1)))
        else {
            return Ok(None);
        };
        let mut bytes = vec![0; (end - start) as usize];
        let mut file = self.file()?;
        file.seek(SeekFrom::Start(*start))?;
        file.read_exact(&mut bytes)?;
        Ok(Some(bytes))
    }
}

fn open_or_make(path: &Path) -> Result<File> {
    let mut options = OpenOptions::new();
    let options = options.read(true).write(true).create(true);
    options.truncate(false).open(path)
}

/// Writes bytes behind those that there are; the file is as before when that fails.
pub(crate) fn append_at(file: &mut File, end: u64, bytes: &[u8]) -> Result<()> {
    file.seek(SeekFrom::Start(end))?;
    file.write_all(bytes).inspect_err(|_| {
        // what is left is written over by the next one
        let _ = file.set_len(end);
    })
}
