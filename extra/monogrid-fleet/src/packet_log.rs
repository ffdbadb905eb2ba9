//! Packets in a file, one behind the other: the number of a packet is its place in it, from 0.

use crate::packet::{HEADER_BYTES, packet_bytes};
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result, Seek, SeekFrom, Write};
use std::path::Path;

/// A file of packets that only grows.
#[derive(Debug)]
pub struct PacketLog {
    file: File,
    /// Where the packets begin, and where the last one ends.
    starts: Vec<u64>,
}

impl PacketLog {
    /// An empty one, in a file that is gone when the log is.
    ///
    /// # Errors
    /// When no temporary file can be made.
    pub fn temporary() -> Result<Self> {
        Ok(Self {
            file: tempfile::tempfile()?,
            starts: vec![0],
        })
    }

    /// Opens a file, or makes it. A last packet that is cut off, as after a kill, is taken away.
    ///
    /// # Errors
    /// When the file cannot be read or written, or does not hold packets.
    pub fn open(path: &Path) -> Result<Self> {
        let mut options = OpenOptions::new();
        let options = options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(path)?;
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
        let log = Self { file, starts };
        log.file.set_len(log.end())?;
        Ok(log)
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
        self.file.seek(SeekFrom::Start(self.end()))?;
        if let Err(error) = self.file.write_all(packet) {
            let _ = self.file.set_len(self.end());
            return Err(error);
        }
        self.starts.push(self.end() + packet.len() as u64);
        Ok(number)
    }

    /// The bytes of a packet; `None` where there is none of this number.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read(&mut self, number: u64) -> Result<Option<Vec<u8>>> {
        let at = usize::try_from(number).unwrap_or(usize::MAX);
        let (Some(start), Some(end)) = (self.starts.get(at), self.starts.get(at.saturating_add(1)))
        else {
            return Ok(None);
        };
        let mut bytes = vec![0; (end - start) as usize];
        self.file.seek(SeekFrom::Start(*start))?;
        self.file.read_exact(&mut bytes)?;
        Ok(Some(bytes))
    }
}
