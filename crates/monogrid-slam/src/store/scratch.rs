//! The file for values that have left memory.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Error, ErrorKind, Read, Seek, SeekFrom, Write};

/// A file of pieces; room that was given up is used again.
#[derive(Debug)]
pub(super) struct Scratch {
    file: File,
    end: u64,
    /// Length of each piece that is free, by its place. No two of them touch, and none touches the
    /// end.
    free: BTreeMap<u64, u64>,
}

/// Where a value is in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    at: u64,
    length: u64,
    /// CRC-32 of the bytes.
    checksum: u32,
}

impl Scratch {
    pub(super) fn new(file: File) -> Self {
        Self {
            file,
            end: 0,
            free: BTreeMap::new(),
        }
    }

    /// Bytes of the file.
    pub(super) fn bytes(&self) -> u64 {
        self.end
    }

    /// Writes a value to the first room that is large enough.
    pub(super) fn write(&mut self, bytes: &[u8]) -> std::io::Result<Place> {
        let length = bytes.len() as u64;
        let room = self.free.iter().find(|(_, room)| **room >= length);
        let room = room.map(|(at, room)| (*at, *room));
        let at = room.map_or(self.end, |(at, _)| at);
        self.file.seek(SeekFrom::Start(at))?;
        self.file.write_all(bytes)?;
        match room {
            Some((_, room)) => {
                self.free.remove(&at);
                if room > length {
                    self.free.insert(at + length, room - length);
                }
            }
            None => self.end += length,
        }
        Ok(Place {
            at,
            length,
            checksum: crc32fast::hash(bytes),
        })
    }

    /// Reads a value.
    pub(super) fn read(&mut self, place: &Place) -> std::io::Result<Vec<u8>> {
        let mut bytes = vec![0; place.length as usize];
        self.file.seek(SeekFrom::Start(place.at))?;
        self.file.read_exact(&mut bytes)?;
        if crc32fast::hash(&bytes) == place.checksum {
            Ok(bytes)
        } else {
            let what = "other bytes came back than were written";
            Err(Error::new(ErrorKind::InvalidData, what))
        }
    }

    /// Gives up the room of a value.
    pub(super) fn give_up(&mut self, place: &Place) {
        let (mut at, mut length) = (place.at, place.length);
        let before = self.free.range(..at).next_back().map(|(a, l)| (*a, *l));
        if let Some((a, l)) = before.filter(|(a, l)| a + l == at) {
            self.free.remove(&a);
            (at, length) = (a, l + length);
        }
        if let Some(l) = self.free.remove(&(at + length)) {
            length += l;
        }
        if at + length == self.end {
            self.end = at;
        } else {
            self.free.insert(at, length);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]
mod tests {
    use super::*;

    #[test]
    fn room_is_used_again_and_damage_is_noticed() {
        let mut scratch = Scratch::new(tempfile::tempfile().unwrap());
        let places: Vec<Place> = (0_u8..4)
            .map(|i| scratch.write(&[i; 100]).unwrap())
            .collect();
        scratch.give_up(&places[1]);
        scratch.give_up(&places[2]);
        let large = scratch.write(&[7; 150]).unwrap();
        assert_eq!((large.at, scratch.bytes()), (100, 400));
        let small = scratch.write(&[8; 50]).unwrap();
        assert_eq!((small.at, scratch.bytes()), (250, 400));
        assert_eq!(scratch.write(&[9; 10]).unwrap().at, 400);
        for (place, value) in [(places[0], [0; 100]), (places[3], [3; 100])] {
            assert_eq!(scratch.read(&place).unwrap(), value);
        }
        assert_eq!(scratch.read(&large).unwrap(), [7; 150]);
        scratch.file.seek(SeekFrom::Start(120)).unwrap();
        scratch.file.write_all(&[1]).unwrap();
        assert!(scratch.read(&large).is_err());
        scratch.file.set_len(300).unwrap();
        assert!(scratch.read(&places[3]).is_err());
    }

    #[test]
    fn what_is_given_up_at_the_end_makes_the_file_shorter() {
        let mut scratch = Scratch::new(tempfile::tempfile().unwrap());
        let places: Vec<Place> = (1_u8..4)
            .map(|i| scratch.write(&[i; 100]).unwrap())
            .collect();
        scratch.give_up(&places[1]);
        scratch.give_up(&places[2]);
        assert_eq!((scratch.bytes(), scratch.free.len()), (100, 0));
        scratch.give_up(&places[0]);
        assert_eq!(scratch.bytes(), 0);
    }
}
