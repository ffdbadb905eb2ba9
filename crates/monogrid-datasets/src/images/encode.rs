//! Encoding of images as PNG and JPEG, in memory.

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use monogrid_image::Image;

/// An 8-bit grey PNG.
#[must_use]
pub fn encode_png(image: &Image<u8>) -> Vec<u8> {
    encode(
        image.as_slice(),
        image.width(),
        image.height(),
        ExtendedColorType::L8,
    )
}

/// An 8-bit grey JPEG; `quality` is 1 to 100. Sides up to 65,535 px.
#[must_use]
pub fn encode_jpeg(image: &Image<u8>, quality: u8) -> Vec<u8> {
    let size = (image.width(), image.height());
    encode_lossy(image.as_slice(), size, ExtendedColorType::L8, quality)
}

/// An 8-bit colour JPEG; `quality` is 1 to 100. Sides up to 65,535 px.
#[must_use]
pub fn encode_jpeg_rgb(image: &Image<[u8; 3]>, quality: u8) -> Vec<u8> {
    let bytes = image.as_slice().as_flattened();
    let size = (image.width(), image.height());
    encode_lossy(bytes, size, ExtendedColorType::Rgb8, quality)
}

fn encode_lossy(
    bytes: &[u8],
    (width, height): (usize, usize),
    color: ExtendedColorType,
    quality: u8,
) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() / 4 + 1024);
    let encoder = JpegEncoder::new_with_quality(&mut out, quality);
    let written = encoder.write_image(bytes, width as u32, height as u32, color);
    debug_assert!(written.is_ok(), "writing into memory failed: {written:?}");
    out
}

/// A 16-bit grey PNG, for depth.
#[must_use]
pub fn encode_png_16(image: &Image<u16>) -> Vec<u8> {
    // the encoder expects samples in native byte order
    let bytes: Vec<u8> = image
        .as_slice()
        .iter()
        .flat_map(|v| v.to_ne_bytes())
        .collect();
    encode(
        &bytes,
        image.width(),
        image.height(),
        ExtendedColorType::L16,
    )
}

/// An 8-bit colour PNG.
#[must_use]
pub fn encode_png_rgb(image: &Image<[u8; 3]>) -> Vec<u8> {
    encode(
        image.as_slice().as_flattened(),
        image.width(),
        image.height(),
        ExtendedColorType::Rgb8,
    )
}

fn encode(bytes: &[u8], width: usize, height: usize, color: ExtendedColorType) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() / 2 + 1024);
    let encoder =
        PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Adaptive);
    let written = encoder.write_image(bytes, width as u32, height as u32, color);
    debug_assert!(written.is_ok(), "writing into memory failed: {written:?}");
    out
}
