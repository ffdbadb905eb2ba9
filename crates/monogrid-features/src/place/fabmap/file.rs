//! The file of a vocabulary.
//!
//! Little endian: magic `MGVOCAB\0`, version `u32`, pattern of the descriptors `u64`, number of
//! words `u32`, number of samples `u32`; per word its 256 bits (four `u64`), its parent (`u32`,
//! `u32::MAX` at the root) and three probabilities (`f32`); per sample the number of words (`u32`)
//! and the words (`u16`, ascending); CRC-32 of all that (`u32`).

use super::PlaceVocabulary;
use super::tree::Node;
use crate::Descriptor;
use crate::describe::PATTERN_SEED;
use thiserror::Error;

const MAGIC: &[u8; 8] = b"MGVOCAB\0";
const VERSION: u32 = 1;
const NO_PARENT: u32 = u32::MAX;

/// Why bytes are not a usable vocabulary.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum VocabularyError {
    /// Something else.
    #[error(
        "not a vocabulary: the file does not begin with MGVOCAB; make one with `monogrid thesis \
         vocabulary`"
    )]
    Magic,
    /// Another version.
    #[error("vocabulary of version {found}, expected {VERSION}; train it again")]
    Version {
        /// As the file says.
        found: u32,
    },
    /// Words of other descriptors.
    #[error(
        "vocabulary of descriptors with pattern {found:#x}, expected {PATTERN_SEED:#x}; train it \
         again"
    )]
    Pattern {
        /// As the file says.
        found: u64,
    },
    /// The file ends too early or is too long.
    #[error("vocabulary of {found} bytes does not hold what its header says; copy it again")]
    Length {
        /// Length of the file.
        found: usize,
    },
    /// Bits have changed.
    #[error(
        "vocabulary with checksum {found:#010x}, expected {expected:#010x}: it is damaged, copy it \
         again"
    )]
    Checksum {
        /// Of the bytes.
        found: u32,
        /// As the file says.
        expected: u32,
    },
    /// Sound in form, but not in content.
    #[error("vocabulary with an impossible {what} at word or sample {index}; train it again")]
    Content {
        /// What is wrong.
        what: &'static str,
        /// Where.
        index: usize,
    },
}

impl PlaceVocabulary {
    /// As a file.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(PATTERN_SEED.to_le_bytes());
        bytes.extend((self.words.len() as u32).to_le_bytes());
        bytes.extend((self.samples.len() as u32).to_le_bytes());
        for (word, node) in self.words.iter().zip(&self.nodes) {
            bytes.extend(word.0.iter().flat_map(|part| part.to_le_bytes()));
            let parent = node.parent.map_or(NO_PARENT, |parent| parent as u32);
            bytes.extend(parent.to_le_bytes());
            let [absent, there] = node.p_given_parent;
            let numbers = [node.p, absent, there].map(|p| (p as f32).to_le_bytes());
            bytes.extend(numbers.iter().flatten());
        }
        for sample in &self.samples {
            bytes.extend((sample.len() as u32).to_le_bytes());
            bytes.extend(sample.iter().flat_map(|word| word.to_le_bytes()));
        }
        let checksum = crc32(&bytes);
        bytes.extend(checksum.to_le_bytes());
        bytes
    }

    /// From the bytes of a file.
    ///
    /// # Errors
    /// When they are something else, of another version or for other descriptors, damaged, or not
    /// possible.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, VocabularyError> {
        if !bytes.starts_with(MAGIC) {
            return Err(VocabularyError::Magic);
        }
        let mut reader = Reader {
            left: &bytes[MAGIC.len()..],
            length: bytes.len(),
        };
        let version = reader.u32()?;
        if version != VERSION {
            return Err(VocabularyError::Version { found: version });
        }
        let (content, checksum) = bytes.split_at(bytes.len() - 4);
        let found = crc32(content);
        let expected = u32::from_le_bytes(checksum.try_into().unwrap_or_default());
        if found != expected {
            return Err(VocabularyError::Checksum { found, expected });
        }
        let pattern = reader.u64()?;
        if pattern != PATTERN_SEED {
            return Err(VocabularyError::Pattern { found: pattern });
        }
        let (num_words, num_samples) = (reader.u32()? as usize, reader.u32()? as usize);
        let mut vocabulary = Self {
            words: Vec::new(),
            nodes: Vec::new(),
            samples: Vec::new(),
        };
        for _ in 0..num_words {
            let mut word = Descriptor::default();
            for part in &mut word.0 {
                *part = reader.u64()?;
            }
            vocabulary.words.push(word);
            let parent = reader.u32()?;
            vocabulary.nodes.push(Node {
                parent: (parent != NO_PARENT).then_some(parent as usize),
                p: reader.f32()?,
                p_given_parent: [reader.f32()?, reader.f32()?],
            });
        }
        for _ in 0..num_samples {
            let length = reader.u32()?;
            let words: Result<Vec<u16>, _> = (0..length).map(|_| reader.u16()).collect();
            vocabulary.samples.push(words?);
        }
        if reader.left.len() != 4 {
            return Err(VocabularyError::Length { found: bytes.len() });
        }
        vocabulary.check()?;
        Ok(vocabulary)
    }

    /// Whether indices and probabilities are possible.
    fn check(&self) -> Result<(), VocabularyError> {
        let num_words = self.words.len();
        for (index, node) in self.nodes.iter().enumerate() {
            let [absent, there] = node.p_given_parent;
            // rejects NaN too
            if [node.p, absent, there]
                .iter()
                .any(|p| !(*p > 0.0 && *p < 1.0))
            {
                let what = "probability";
                return Err(VocabularyError::Content { what, index });
            }
            if node.parent.is_some_and(|p| p >= num_words || p == index) {
                let what = "parent";
                return Err(VocabularyError::Content { what, index });
            }
        }
        for (index, sample) in self.samples.iter().enumerate() {
            let is_ascending = sample.windows(2).all(|w| w[0] < w[1]);
            if !is_ascending || sample.last().is_some_and(|w| usize::from(*w) >= num_words) {
                let what = "list of words";
                return Err(VocabularyError::Content { what, index });
            }
        }
        Ok(())
    }
}

/// The bytes that were not read yet.
struct Reader<'a> {
    left: &'a [u8],
    length: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], VocabularyError> {
        let length = self.length;
        let (first, rest) = self
            .left
            .split_first_chunk::<N>()
            .ok_or(VocabularyError::Length { found: length })?;
        self.left = rest;
        Ok(*first)
    }

    fn u16(&mut self) -> Result<u16, VocabularyError> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, VocabularyError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, VocabularyError> {
        self.take().map(u64::from_le_bytes)
    }

    fn f32(&mut self) -> Result<f64, VocabularyError> {
        self.take()
            .map(|bytes| f64::from(f32::from_le_bytes(bytes)))
    }
}

/// CRC-32 as in Ethernet and PNG (polynomial 0xEDB88320, reflected).
fn crc32(bytes: &[u8]) -> u32 {
    let shifted = |crc: u32, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg());
    let with_byte = |crc, byte: &u8| (0..8).fold(crc ^ u32::from(*byte), shifted);
    !bytes.iter().fold(u32::MAX, with_byte)
}
