//! Names that follow from content.

use super::ENDING;
use std::fmt;

/// The SHA-256 of a submap's directory, which holds the SHA-256 of each of its blocks: one name for
/// all that is in it, which can be checked block by block.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SubmapId(pub(super) Hash);

/// A SHA-256.
pub(super) type Hash = [u8; 32];

pub(super) fn hash_of(bytes: &[u8]) -> Hash {
    hmac_sha256::Hash::hash(bytes)
}

impl SubmapId {
    /// The name of the file: 64 hexadecimal digits and `.mgs`.
    #[must_use]
    pub fn file_name(&self) -> String {
        format!("{self}.{ENDING}")
    }

    /// The submap that a file of this name holds; `None` where this is no such name.
    #[must_use]
    pub fn of_file_name(name: &str) -> Option<Self> {
        let digits = name.strip_suffix(ENDING)?.strip_suffix('.')?.as_bytes();
        let is_ours = |digit: &u8| matches!(digit, b'0'..=b'9' | b'a'..=b'f');
        if digits.len() != 64 || !digits.iter().all(is_ours) {
            return None;
        }
        let value = |digit: u8| (digit as char).to_digit(16).map(|value| value as u8);
        let mut hash = [0; 32];
        for (byte, pair) in hash.iter_mut().zip(digits.as_chunks::<2>().0) {
            *byte = value(pair[0])? << 4 | value(pair[1])?;
        }
        Some(Self(hash))
    }
}

impl fmt::Display for SubmapId {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for SubmapId {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_read_back_and_nothing_else_is_one() {
        let id = SubmapId(hash_of(b""));
        let name = id.file_name();
        assert_eq!(
            name,
            "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855.mgs"
        );
        assert_eq!(SubmapId::of_file_name(&name), Some(id));
        for wrong in [
            &name[1..],
            &name[..64],
            &format!("../{}", &name[3..]),
            &name.to_uppercase(),
        ] {
            assert_eq!(SubmapId::of_file_name(wrong), None, "{wrong}");
        }
    }
}
