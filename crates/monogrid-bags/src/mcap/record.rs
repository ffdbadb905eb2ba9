//! The bytes of a record, and the file to which they are appended.

use crc32fast::Hasher;
use std::io::{self, Write};

/// Bytes before the fields: opcode and length.
const HEAD_BYTES: usize = 9;

/// A record that is filled field by field.
pub struct Record(Vec<u8>);

impl Record {
    pub fn new(opcode: u8) -> Self {
        Self(vec![opcode, 0, 0, 0, 0, 0, 0, 0, 0])
    }

    /// As they are, without a length.
    pub fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    pub fn u8(self, value: u8) -> Self {
        self.raw(&[value])
    }

    pub fn u16(self, value: u16) -> Self {
        self.raw(&value.to_le_bytes())
    }

    pub fn u32(self, value: u32) -> Self {
        self.raw(&value.to_le_bytes())
    }

    pub fn u64(self, value: u64) -> Self {
        self.raw(&value.to_le_bytes())
    }

    pub fn bytes(self, bytes: &[u8]) -> Self {
        // not cut: no part of a record is longer than the whole, of which `finish` says whether it
        // is too long
        self.u32(bytes.len() as u32).raw(bytes)
    }

    pub fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    /// Entries behind their length in bytes.
    pub fn list<T>(
        self,
        entries: impl IntoIterator<Item = T>,
        add: impl Fn(Self, T) -> Self,
    ) -> Self {
        let Self(entries) = entries.into_iter().fold(Self(Vec::new()), add);
        self.bytes(&entries)
    }

    /// The whole record.
    ///
    /// # Errors
    /// When it is longer than the lengths of its fields can say.
    pub fn finish(mut self) -> io::Result<Vec<u8>> {
        let length = self.0.len() - HEAD_BYTES;
        if u32::try_from(length).is_err() {
            let reason = format!("a record of {length} bytes is too long, expected at most 4 GiB");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
        }
        self.0[1..HEAD_BYTES].copy_from_slice(&(length as u64).to_le_bytes());
        Ok(self.0)
    }
}

/// A file that is only ever appended to: counts what is written, so that nobody has to seek, and
/// keeps its checksum.
pub struct Output<W> {
    pub out: W,
    /// Bytes from the beginning.
    pub position: u64,
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

    /// CRC-32 of everything so far.
    pub fn crc(&self) -> u32 {
        self.crc.clone().finalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_little_endian_behind_opcode_and_length() {
        let record = Record::new(7).u8(1).u16(2).u32(3).u64(4).raw(&[5]);
        let expected = [
            7, 16, 0, 0, 0, 0, 0, 0, 0, 1, 2, 0, 3, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 5,
        ];
        assert_eq!(record.finish().unwrap(), expected);
        let record = Record::new(1).text("ab").list([1, 2], Record::u16);
        let expected = [
            1, 14, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 97, 98, 4, 0, 0, 0, 1, 0, 2, 0,
        ];
        assert_eq!(record.finish().unwrap(), expected);
    }
}
