//! Fields of records and messages, from the front of their bytes.

/// Little endian fields that follow each other without gaps; none where there are not enough bytes.
#[derive(Clone, Copy)]
pub struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    pub fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (bytes, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*bytes)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// So many bytes.
    pub fn slice(&mut self, length: u64) -> Option<&'a [u8]> {
        let length = usize::try_from(length).ok()?;
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(bytes)
    }

    /// Bytes behind their number.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.slice(u64::from(length))
    }

    /// A text behind the number of its bytes; none where it is not UTF-8.
    pub fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_follow_each_other_until_bytes_are_missing() {
        let bytes = [
            1, 2, 0, 3, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 97, 98,
        ];
        let mut fields = Fields(&bytes);
        assert_eq!((fields.u8(), fields.u16()), (Some(1), Some(2)));
        assert_eq!((fields.u32(), fields.u64()), (Some(3), Some(4)));
        let mut cut = Fields(&fields.0[..5]);
        assert_eq!((cut.text(), fields.text()), (None, Some("ab")));
        assert_eq!((fields.u8(), fields.0.len()), (None, 0));
        assert_eq!(Fields(&[1; 9]).slice(u64::MAX), None);
        assert_eq!(Fields(&[1, 0, 0, 0, 200]).text(), None);
    }
}
