//! What a file is, by its first bytes and never by its name.

use std::fs::File;
use std::io::{Read, Result};
use std::path::Path;

/// Bytes that are looked at: some packets of a transport stream.
const SNIFFED_BYTES: u64 = 3 * 192 + 5;

/// Kinds of video files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// ISO base media: MP4, MOV, 3GP.
    Mp4,
    Avi,
    Y4m,
    /// Known, and never decoded here.
    Other,
}

/// Boxes that a file of the MP4 family may begin with.
const FIRST_BOXES: [&[u8; 4]; 12] = [
    b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"uuid", b"pnot", b"styp", b"sidx",
    b"moof", b"emsg",
];

/// Brands of still images, which are no videos.
const IMAGE_BRANDS: [&[u8; 4]; 6] = [b"heic", b"heix", b"mif1", b"avif", b"jxl ", b"jp2 "];

/// What other files begin with: Matroska and WebM; FLV; Ogg; ASF and WMV; MXF; MPEG program
/// streams, MPEG-1, MPEG-2 and MPEG-4 video; H.264 and H.265 with start codes; NUT; IVF; RealMedia.
const BEGINNINGS: [&[u8]; 14] = [
    b"\x1a\x45\xdf\xa3",
    b"FLV\x01",
    b"OggS",
    b"\x30\x26\xb2\x75\x8e\x66\xcf\x11",
    b"\x06\x0e\x2b\x34\x02\x05\x01\x01",
    b"\0\0\x01\xba",
    b"\0\0\x01\xb3",
    b"\0\0\x01\xb0",
    b"\0\0\0\x01\x67",
    b"\0\0\0\x01\x09",
    b"\0\0\0\x01\x40\x01",
    b"nut/multimedia container",
    b"DKIF",
    b".RMF",
];

impl Kind {
    /// The kind of a file that is read from its beginning; `None` where it is nothing that we know.
    pub(crate) fn of(file: &mut File) -> Result<Option<Self>> {
        let mut head = Vec::new();
        file.take(SNIFFED_BYTES).read_to_end(&mut head)?;
        Ok(Self::of_head(&head))
    }

    fn of_head(head: &[u8]) -> Option<Self> {
        if head.starts_with(crate::y4m::MAGIC) {
            return Some(Self::Y4m);
        }
        if head.starts_with(b"RIFF") && head.get(8..12) == Some(b"AVI ") {
            return Some(Self::Avi);
        }
        if BEGINNINGS.iter().any(|begin| head.starts_with(begin)) || is_transport_stream(head) {
            return Some(Self::Other);
        }
        let kind = head.get(4..8)?;
        let is_image =
            kind == b"ftyp" && IMAGE_BRANDS.iter().any(|b| head.get(8..12) == Some(&b[..]));
        let is_mp4 = FIRST_BOXES.iter().any(|first| kind == &first[..]);
        (is_mp4 && !is_image).then_some(Self::Mp4)
    }
}

/// Whether packets of 188 bytes begin with their mark, or of 192 as cameras write them.
fn is_transport_stream(head: &[u8]) -> bool {
    [(0, 188), (4, 192)]
        .iter()
        .any(|&(from, packet)| (0..3).all(|k| head.get(from + k * packet) == Some(&0x47)))
}

/// Whether a file is a video by its content.
#[must_use]
pub fn is_video_file(path: &Path) -> bool {
    let is_file = std::fs::metadata(path).is_ok_and(|metadata| metadata.is_file());
    let kind = || Kind::of(&mut File::open(path)?);
    is_file && kind().is_ok_and(|kind| kind.is_some())
}

#[cfg(test)]
mod tests {
    use super::Kind;

    #[test]
    fn files_are_known_by_their_first_bytes() {
        let boxed = |kind: &[u8]| [b"\0\0\0\x18", kind, b"isom"].concat();
        for kind in [b"ftyp", b"uuid", b"free", b"moof"] {
            assert_eq!(Kind::of_head(&boxed(kind)), Some(Kind::Mp4));
        }
        let image = [b"\0\0\0\x18ftyp".as_slice(), b"heic"].concat();
        assert_eq!(Kind::of_head(&image), None);
        assert_eq!(Kind::of_head(b"RIFF\0\0\0\0AVI LIST"), Some(Kind::Avi));
        assert_eq!(Kind::of_head(b"RIFF\0\0\0\0WEBPVP8 "), None);
        assert_eq!(Kind::of_head(b"YUV4MPEG2 W2 H2"), Some(Kind::Y4m));
        assert_eq!(Kind::of_head(b"\x1a\x45\xdf\xa3\x01"), Some(Kind::Other));
        let mut packets = vec![0; 600];
        for k in 0..3 {
            packets[4 + 192 * k] = 0x47;
        }
        assert_eq!(Kind::of_head(&packets), Some(Kind::Other));
        for other in [
            &b"GIF89a"[..],
            b"PK\x03\x04",
            b"{}",
            b"G",
            b"",
            b"\x89PNG\r\n\x1a\n",
        ] {
            assert_eq!(Kind::of_head(other), None, "{other:?}");
        }
    }
}
