//! Images recognised by content: PNG, JPEG, PBM/PGM/PPM, TIFF, WebP, BMP; 8 and 16 bits; grey or
//! colour.

use super::accepted::{MAX_DECODE_BYTES, MAX_PIXELS, MAX_SIDE};
use super::levels::Levels;
use super::raster::{Raster, Samples, decode_png, decode_pnm};
use super::{jpeg, others};
use crate::{DatasetError, read_file};
use monogrid_image::{GrayImage, Image, Mask};
use std::path::Path;

/// What the first bytes of an image announce.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Jpeg,
    Png,
    Pnm,
    Tiff,
    WebP,
    Bmp,
}

/// Reads an image as ITU-601 luma in [0, 255].
///
/// # Errors
/// When the file cannot be read, is not a PNG, JPEG, PBM, PGM, PPM, TIFF, WebP or BMP, or is
/// not complete and undamaged (a partly decoded image is never returned).
pub fn read_gray(path: &Path) -> Result<GrayImage, DatasetError> {
    read_gray_in(path, Levels::ALL)
}

/// Reads an image of a sequence that uses so much of its 16 bits, if it has as many.
///
/// # Errors
/// As [`read_gray`].
pub fn read_gray_in(path: &Path, levels: Levels) -> Result<GrayImage, DatasetError> {
    decode_gray_in(&read_image_file(path)?, levels, path)
}

/// Decodes an image as ITU-601 luma in [0, 255]; `path` is only for messages.
///
/// # Errors
/// As [`read_gray`].
pub fn decode_gray(bytes: &[u8], path: &Path) -> Result<GrayImage, DatasetError> {
    decode_gray_in(bytes, Levels::ALL, path)
}

fn decode_gray_in(bytes: &[u8], levels: Levels, path: &Path) -> Result<GrayImage, DatasetError> {
    if sniff(bytes, path)? == Format::Jpeg {
        return Ok(decode_jpeg_luma(bytes, MAX_PIXELS, path)?.map(f32::from));
    }
    to_gray(&decode_raster(bytes, path)?, levels, path)
}

/// Decodes a JPEG image to its 8-bit luma (ITU-601); `path` is only for messages.
///
/// Images without Huffman tables, as in MJPEG streams, are understood.
///
/// # Errors
/// When it is no complete JPEG image, or has more than `max_pixels`.
pub fn decode_jpeg_luma(
    bytes: &[u8],
    max_pixels: usize,
    path: &Path,
) -> Result<Image<u8>, DatasetError> {
    let decoded = jpeg::decode_luma(bytes, max_pixels);
    let (width, height, luma) = decoded.map_err(|e| DatasetError::image(path, e))?;
    image_of(width, height, luma, path)
}

/// An image of pixels that must be there.
pub(super) fn image_of<T: Copy>(
    width: usize,
    height: usize,
    pixels: Vec<T>,
    path: &Path,
) -> Result<Image<T>, DatasetError> {
    let image = Image::from_vec(width, height, pixels);
    image.ok_or_else(|| DatasetError::image(path, "the image has no pixels"))
}

/// Reads an image in colour; `None` where it has none: a grey file, or one whose pixels are all
/// grey.
///
/// # Errors
/// As [`read_gray`].
pub fn read_rgb(path: &Path) -> Result<Option<Image<[u8; 3]>>, DatasetError> {
    read_rgb_in(path, Levels::ALL)
}

/// Reads an image in colour of a sequence that uses so much of its 16 bits, if it has as many.
///
/// # Errors
/// As [`read_gray`].
pub fn read_rgb_in(path: &Path, levels: Levels) -> Result<Option<Image<[u8; 3]>>, DatasetError> {
    let bytes = read_image_file(path)?;
    let image = if sniff(&bytes, path)? == Format::Jpeg {
        decode_jpeg_rgb(&bytes, MAX_PIXELS, path)?
    } else {
        let raster = decode_raster(&bytes, path)?;
        let show = to_byte(&raster, levels);
        let rgb = |pixel: &[f32]| [0, 1, 2].map(|k| show(pixel[k]).round() as u8);
        let image = || Image::from_vec(raster.width, raster.height, raster.map(rgb));
        raster.has_colour().then(image).flatten()
    };
    Ok(image.filter(has_colour))
}

/// Decodes a JPEG image in colour; `None` for a grey one. `path` is only for messages.
///
/// # Errors
/// When it is no complete JPEG image, or has more than `max_pixels`.
pub fn decode_jpeg_rgb(
    bytes: &[u8],
    max_pixels: usize,
    path: &Path,
) -> Result<Option<Image<[u8; 3]>>, DatasetError> {
    let decoded = jpeg::decode_rgb(bytes, max_pixels).map_err(|e| DatasetError::image(path, e))?;
    let image = |(width, height, rgb): (_, _, Vec<u8>)| {
        Image::from_vec(width, height, rgb.as_chunks::<3>().0.to_vec())
    };
    Ok(decoded.and_then(image))
}

fn has_colour(image: &Image<[u8; 3]>) -> bool {
    image.as_slice().iter().any(|[r, g, b]| r != g || g != b)
}

/// Reads a mask: black (below 128) pixels are not used.
///
/// # Errors
/// As [`read_gray`].
pub fn read_mask(path: &Path) -> Result<Mask, DatasetError> {
    Ok(read_gray(path)?.map(|v| if v < 128.0 { 0 } else { 255 }))
}

/// Largest image file: no complete image has more bytes than its pixels would need without
/// compression.
const MAX_FILE_BYTES: u64 = 8 * MAX_PIXELS as u64;

pub(super) fn read_image_file(path: &Path) -> Result<Vec<u8>, DatasetError> {
    read_file(path, MAX_FILE_BYTES)
}

/// The format that the first bytes announce.
pub(super) fn sniff(bytes: &[u8], path: &Path) -> Result<Format, DatasetError> {
    match bytes {
        [] => Err(DatasetError::image(path, "the file is empty")),
        [0xff, 0xd8, ..] => Ok(Format::Jpeg),
        [0x89, b'P', b'N', b'G', ..] => Ok(Format::Png),
        [b'P', b'1'..=b'6', ..] => Ok(Format::Pnm),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Ok(Format::Tiff),
        [
            b'R',
            b'I',
            b'F',
            b'F',
            _,
            _,
            _,
            _,
            b'W',
            b'E',
            b'B',
            b'P',
            ..,
        ] => Ok(Format::WebP),
        [b'B', b'M', ..] => Ok(Format::Bmp),
        _ => {
            let reason = "its content is no format that we know";
            Err(DatasetError::image(path, reason))
        }
    }
}

/// Decodes anything but JPEG without converting it.
pub(super) fn decode_raster(bytes: &[u8], path: &Path) -> Result<Raster, DatasetError> {
    let decoded = match sniff(bytes, path)? {
        Format::Pnm => decode_pnm(bytes),
        Format::Tiff => others::decode_tiff(bytes),
        Format::WebP => others::decode_webp(bytes),
        Format::Bmp => others::decode_bmp(bytes),
        Format::Png | Format::Jpeg => decode_png(bytes, [MAX_SIDE; 2], MAX_DECODE_BYTES),
    };
    decoded.map_err(|e| DatasetError::image(path, e))
}

/// An 8-bit grey PNG of the given size; `None` for anything else, for which nothing is allocated.
pub(crate) fn decode_png_luma8(bytes: &[u8], width: usize, height: usize) -> Option<Image<u8>> {
    // the decoder wants some rows beside the image
    let max_bytes = 2 * width.checked_mul(height)? + (1 << 20);
    let raster = decode_png(bytes, [width, height], max_bytes).ok()?;
    match raster.samples {
        Samples::Bytes(samples) if raster.channels == 1 && raster.height == height => {
            Image::from_vec(raster.width, height, samples)
        }
        _ => None,
    }
}

/// Luma of every pixel type; transparency is ignored.
fn to_gray(raster: &Raster, levels: Levels, path: &Path) -> Result<GrayImage, DatasetError> {
    let show = to_byte(raster, levels);
    let data = raster.map(|pixel| show(luma_of(pixel)));
    image_of(raster.width, raster.height, data, path)
}

/// How a sample of an image becomes one of [0, 255]: the levels are those of 16 bits of which
/// nothing says how many are used.
fn to_byte(raster: &Raster, levels: Levels) -> impl Fn(f32) -> f32 + use<> {
    let to_byte = 255.0 / f32::from(raster.white);
    let own = (raster.has_all_words() && levels != Levels::ALL).then_some(levels);
    move |value| own.map_or(value * to_byte, |levels| levels.show(value))
}

/// Luma of a pixel with or without colour and opacity.
pub(super) fn luma_of(pixel: &[f32]) -> f32 {
    match *pixel {
        [r, g, b, ..] => luma([r, g, b]),
        [grey, ..] => grey,
        [] => 0.0,
    }
}

/// ITU-601 luma.
fn luma([r, g, b]: [f32; 3]) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}
