//! Encoding of images as PNG and JPEG, in memory.

use jpeg_encoder::{ColorType as JpegColor, SamplingFactor};
use monogrid_image::Image;
use png::BitDepth::{Eight, Sixteen};
use png::{BitDepth, ColorType};

/// An 8-bit grey PNG.
#[must_use]
pub fn encode_png(image: &Image<u8>) -> Vec<u8> {
    encode(image, image.as_slice(), ColorType::Grayscale, Eight)
}

/// An 8-bit grey JPEG; `quality` is 1 to 100. Sides up to 65,535 px.
#[must_use]
pub fn encode_jpeg(image: &Image<u8>, quality: u8) -> Vec<u8> {
    encode_lossy(image, image.as_slice(), JpegColor::Luma, quality)
}

/// An 8-bit colour JPEG; `quality` is 1 to 100. Sides up to 65,535 px.
#[must_use]
pub fn encode_jpeg_rgb(image: &Image<[u8; 3]>, quality: u8) -> Vec<u8> {
    let bytes = image.as_slice().as_flattened();
    encode_lossy(image, bytes, JpegColor::Rgb, quality)
}

fn encode_lossy<T: Copy>(image: &Image<T>, bytes: &[u8], color: JpegColor, quality: u8) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() / 4 + 1024);
    let mut encoder = jpeg_encoder::Encoder::new(&mut out, quality);
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    let (width, height) = (image.width() as u16, image.height() as u16);
    let written = encoder.encode(bytes, width, height, color);
    debug_assert!(written.is_ok(), "writing into memory failed: {written:?}");
    out
}

/// A 16-bit grey PNG, for depth.
#[must_use]
pub fn encode_png_16(image: &Image<u16>) -> Vec<u8> {
    let bytes = image.as_slice().iter().flat_map(|v| v.to_be_bytes());
    let bytes: Vec<u8> = bytes.collect();
    encode(image, &bytes, ColorType::Grayscale, Sixteen)
}

/// An 8-bit colour PNG.
#[must_use]
pub fn encode_png_rgb(image: &Image<[u8; 3]>) -> Vec<u8> {
    let bytes = image.as_slice().as_flattened();
    encode(image, bytes, ColorType::Rgb, Eight)
}

fn encode<T: Copy>(image: &Image<T>, bytes: &[u8], colour: ColorType, depth: BitDepth) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() / 2 + 1024);
    let (width, height) = (image.width() as u32, image.height() as u32);
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::Filter::Adaptive);
    let header = encoder.write_header();
    let written = header.and_then(|mut writer| writer.write_image_data(bytes));
    debug_assert!(written.is_ok(), "writing into memory failed: {written:?}");
    out
}
