//! Pixels with depth in the types of the libraries, which do not know each other.

use monogrid_datasets::DepthPixel as RecordedPixel;
use monogrid_evaluation::DepthEstimate;
use monogrid_slam::DepthPixel;

/// As a recording holds them.
pub fn to_recorded(pixels: &[DepthPixel]) -> Vec<RecordedPixel> {
    let recorded = |pixel: &DepthPixel| RecordedPixel {
        x: pixel.x,
        y: pixel.y,
        idepth: pixel.idepth,
        idepth_var: pixel.idepth_var,
    };
    pixels.iter().map(recorded).collect()
}

/// Out of a recording.
pub fn from_recorded(pixels: &[RecordedPixel]) -> Vec<DepthPixel> {
    let read = |pixel: &RecordedPixel| DepthPixel {
        x: pixel.x,
        y: pixel.y,
        idepth: pixel.idepth,
        idepth_var: pixel.idepth_var,
    };
    pixels.iter().map(read).collect()
}

/// As the evaluation compares them.
pub fn to_estimates(pixels: &[DepthPixel]) -> Vec<DepthEstimate> {
    let estimate = |pixel: &DepthPixel| DepthEstimate {
        x_px: u32::from(pixel.x),
        y_px: u32::from(pixel.y),
        idepth: pixel.idepth,
        idepth_var: pixel.idepth_var,
    };
    pixels.iter().map(estimate).collect()
}
