//! A frame, and what is made of one.

use crate::colour::Colour;
use crate::error::VideoError;
use monogrid_datasets::decode_jpeg_luma;
use monogrid_image::Image;
use std::path::Path;

/// An 8-bit grey image.
pub type Grey = Image<u8>;

/// Most pixels of a frame: those of 8K, of which some are in memory at once; more is taken for
/// damage.
pub(crate) const MAX_PIXELS: usize = 1 << 25;

/// Pixels that a frame counts for at least: each takes its time, and a small file can hold a
/// million of them.
pub(crate) const MIN_FRAME_PIXELS: usize = 1 << 13;

/// One frame.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoFrame {
    /// Luma as the source has it (not stretched to the full range), upright.
    pub image: Grey,
    /// What it shows beside luma.
    pub colour: Colour,
    /// Time, nanoseconds: of the container for files, since the first frame for cameras and
    /// streams.
    pub timestamp_ns: i64,
}

/// What every decoder yields.
pub(crate) type Frames = Box<dyn Iterator<Item = Result<VideoFrame, VideoError>> + Send>;

/// The frame in a JPEG file, number `frame` of its video.
pub(crate) fn jpeg_frame(
    video: &str,
    frame: usize,
    jpeg: Vec<u8>,
    timestamp_ns: i64,
) -> Result<VideoFrame, VideoError> {
    let image = decode_jpeg_luma(&jpeg, MAX_PIXELS, Path::new(video));
    Ok(VideoFrame {
        image: image.map_err(|e| VideoError::frame(video, frame, e.to_string()))?,
        colour: Colour::Jpeg(jpeg),
        timestamp_ns,
    })
}

/// Time of a frame, nanoseconds, at so many frames per second: numerator and denominator.
pub(crate) fn time_at_rate(frame: usize, (numerator, denominator): (u64, u64)) -> i64 {
    let seconds_e9 = frame as u128 * u128::from(denominator) * 1_000_000_000;
    i64::try_from(seconds_e9 / u128::from(numerator)).unwrap_or(i64::MAX)
}
