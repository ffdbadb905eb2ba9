//! A keyframe in few bytes.

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
    /// Its camera, where it is not that of the session: fx, fy, cx, cy in px; the centre of the top-left pixel is (0, 0).
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
    /// [`PacketError::NoImage`]; [`PacketError::TooLarge`] for a side of 65,536 px.
    pub fn pack(record: &KeyframeRecord, jpeg_quality: u8) -> Result<Self, PacketError> {
        let image = record.image.as_ref();
        let image = image.ok_or(PacketError::NoImage(record.id))?;
        let side = |side: usize| u16::try_from(side).map_err(|_| PacketError::TooLarge);
        let size = (side(image.width())?, side(image.height())?);
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
        let (width, height) = (usize::from(self.size.0), usize::from(self.size.1));
        if !is_plausible(self.size, self.jpeg.len()) {
            let reason = "an image is larger than its bytes can tell";
            return Err(PacketError::Content(reason));
        }
        let no_image = PacketError::Content("an image is no JPEG file of its size");
        let image = decode_jpeg_luma(&self.jpeg, width * height, Path::new("packet"));
        let image = image.map_err(|_| no_image.clone())?;
        if (image.width(), image.height()) != (width, height) {
            return Err(no_image);
        }
        Ok(KeyframeRecord {
            id: self.id,
            frame_index: self.frame_index,
            timestamp_ns: self.timestamp_ns,
            camera: self.camera.map(|[fx, fy, cx, cy]| RecordedCamera {
                pinhole: Pinhole::new(fx, fy, cx, cy),
                width,
                height,
            }),
            image: Some(image),
            pixels: self.depth.unpack(self.size)?,
        })
    }
}
