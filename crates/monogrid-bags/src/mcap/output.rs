//! A file that is only ever appended to.

use crc32fast::Hasher;
use std::io::{self, Write};

/// Counts what is written, so that nobody has to seek, and keeps its checksum.
pub struct Output<W> {
    out: W,
    position: u64,
    crc: Hasher,
}

impl<W: Write> Output<W> {
    pub fn new(out: W) -> Self {
        Self {
            out,
            position: 0,
            crc: Hasher::new(),
        }
    }

    /// Appends bytes; where they begin.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<u64> {
        self.out.write_all(bytes)?;
        self.crc.update(bytes);
        let start = self.position;
        self.position += bytes.len() as u64;
        Ok(start)
    }

    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Bytes from the beginning.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// CRC-32 of everything so far.
    pub fn crc(&self) -> u32 {
        self.crc.clone().finalize()
    }
}
