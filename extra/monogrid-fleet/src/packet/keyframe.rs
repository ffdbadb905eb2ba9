//! A keyframe in few bytes.

use super::bounds::{check_camera, check_size, check_time};
use super::{PackedDepth, PacketError, is_plausible};
use monogrid_datasets::{KeyframeRecord, RecordedCamera, decode_jpeg_luma, encode_jpeg};
use monogrid_geometry::Pinhole;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A new keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PackedKeyframe {
    /// As in the recording.
    pub id: u32,
    /// Index of its frame in the source.
    pub frame_index: u64,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// Its camera, where it is not that of the session: fx, fy, cx, cy in px; the centre of the
    /// top-left pixel is (0, 0).
    pub camera: Option<[f64; 4]>,
    /// Width and height of the image, px.
    pub size: (u16, u16),
    /// The undistorted image, a grey JPEG file.
    pub jpeg: Vec<u8>,
    /// Its depth.
    pub depth: PackedDepth,
}

impl PackedKeyframe {
    /// A keyframe with its image as JPEG of this quality (1 to 100).
    ///
    /// # Errors
    /// [`PacketError::NoImage`]; [`PacketError::TooLarge`] and [`PacketError::Beyond`] for an image
    /// that no server takes.
    pub fn pack(record: &KeyframeRecord, jpeg_quality: u8) -> Result<Self, PacketError> {
        let image = record.image.as_ref();
        let image = image.ok_or(PacketError::NoImage(record.id))?;
        let side = |side: usize| u16::try_from(side).map_err(|_| PacketError::TooLarge);
        let size = (side(image.width())?, side(image.height())?);
        check_size(size)?;
        Ok(Self {
            id: record.id,
            frame_index: record.frame_index,
            timestamp_ns: record.timestamp_ns,
            camera: record.camera.map(|camera| {
                let Pinhole { fx, fy, cx, cy } = camera.pinhole;
                [fx, fy, cx, cy]
            }),
            size,
            jpeg: encode_jpeg(image, jpeg_quality),
            depth: PackedDepth::pack(&record.pixels, size),
        })
    }

    /// The keyframe.
    ///
    /// # Errors
    /// [`PacketError::Content`].
    pub fn unpack(&self) -> Result<KeyframeRecord, PacketError> {
        check_size(self.size)?;
        check_time(self.timestamp_ns)?;
        let (width, height) = (usize::from(self.size.0), usize::from(self.size.1));
        let camera = self.camera.map(|[fx, fy, cx, cy]| RecordedCamera {
            pinhole: Pinhole::new(fx, fy, cx, cy),
            width,
            height,
        });
        camera.as_ref().map_or(Ok(()), check_camera)?;
        if !is_plausible(self.size, self.jpeg.len()) {
            let reason = "an image is larger than its bytes can tell";
            return Err(PacketError::Content(reason));
        }
        let no_image = PacketError::Content("an image is no grey JPEG file of its size");
        // nothing but what agents write gets as far as the decoder
        if simple_jpeg_size(&self.jpeg) != Some(self.size) {
            return Err(no_image);
        }
        let image = decode_jpeg_luma(&self.jpeg, width * height, Path::new("packet"));
        let image = image.map_err(|_| no_image.clone())?;
        if (image.width(), image.height()) != (width, height) {
            return Err(no_image);
        }
        Ok(KeyframeRecord {
            id: self.id,
            frame_index: self.frame_index,
            timestamp_ns: self.timestamp_ns,
            camera,
            image: Some(image),
            pixels: self.depth.unpack(self.size)?,
        })
    }
}

/// Width and height, px, of a JPEG file with one component and one scan, Huffman-coded: of others a
/// few bytes can hold scans of the whole image by the thousand, each of which takes time. `None`
/// for them, and for what is no JPEG file.
fn simple_jpeg_size(bytes: &[u8]) -> Option<(u16, u16)> {
    let word = |at: usize| Some(u16::from_be_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]));
    (word(0)? == 0xffd8).then_some(())?;
    let (mut at, mut size) = (2, None);
    loop {
        let marker = word(at)?;
        match marker {
            // baseline, or more bits of precision
            0xffc0 | 0xffc1 if size.is_none() && *bytes.get(at + 9)? == 1 => {
                size = Some((word(at + 7)?, word(at + 5)?));
            }
            // the scan, behind which nothing else is
            0xffda => break,
            // tables, and what programs say; no other kind of frame
            0xffc4 | 0xffdb | 0xffdd | 0xffe0..=0xffef | 0xfffe => {}
            _ => return None,
        }
        at += 2 + usize::from(word(at + 2)?);
    }
    let scans = bytes.windows(2).skip(at + 2).filter(|m| *m == [0xff, 0xda]);
    size.filter(|_| scans.count() == 0)
}
