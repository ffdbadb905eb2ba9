//! Images recognised by content: PNG, JPEG, PGM/PPM; 8 and 16 bits; grey or colour.

use super::jpeg;
use crate::{DatasetError, read_file};
use image::{DynamicImage, ImageFormat};
use monogrid_image::{GrayImage, Image, Mask};
use std::io::Cursor;
use std::path::Path;

/// Longest side that is decoded, px: a header that claims more is taken for corruption.
pub(super) const MAX_SIDE: usize = 16384;

/// Most pixels that are decoded: twice those of an 8K video.
const MAX_PIXELS: usize = 1 << 26;

/// Most memory that a decoder may ask for, bytes.
const MAX_DECODE_BYTES: u64 = 4 * MAX_PIXELS as u64;

/// Reads an image as ITU-601 luma in [0, 255].
///
/// # Errors
/// When the file cannot be read, is not a PNG, JPEG, PGM or PPM, or is not complete and undamaged
/// (a partly decoded image is never returned).
pub fn read_gray(path: &Path) -> Result<GrayImage, DatasetError> {
    decode_gray(&read_image_file(path)?, path)
}

/// Decodes an image as ITU-601 luma in [0, 255]; `path` is only for messages.
///
/// # Errors
/// As [`read_gray`].
pub fn decode_gray(bytes: &[u8], path: &Path) -> Result<GrayImage, DatasetError> {
    if sniff(bytes, path)? == ImageFormat::Jpeg {
        return Ok(decode_jpeg_luma(bytes, MAX_PIXELS, path)?.map(f32::from));
    }
    to_gray(&decode_dynamic(bytes, path)?, path)
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
    let (width, height, luma) =
        jpeg::decode_luma(bytes, max_pixels).map_err(|e| DatasetError::image(path, e))?;
    Image::from_vec(width, height, luma)
        .ok_or_else(|| DatasetError::image(path, "the image has no pixels"))
}

/// Reads an image in colour; `None` where it has none: a grey file, or one whose pixels are all grey.
///
/// # Errors
/// As [`read_gray`].
pub fn read_rgb(path: &Path) -> Result<Option<Image<[u8; 3]>>, DatasetError> {
    let bytes = read_image_file(path)?;
    let image = if sniff(&bytes, path)? == ImageFormat::Jpeg {
        decode_jpeg_rgb(&bytes, MAX_PIXELS, path)?
    } else {
        match decode_dynamic(&bytes, path)? {
            image if !image.color().has_color() => None,
            image => {
                let (width, height) = (image.width() as usize, image.height() as usize);
                Image::from_vec(width, height, triples(&image.into_rgb8().into_raw()))
            }
        }
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
    Ok(decoded.and_then(|(width, height, rgb)| Image::from_vec(width, height, triples(&rgb))))
}

fn triples(rgb: &[u8]) -> Vec<[u8; 3]> {
    rgb.as_chunks().0.to_vec()
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

/// Largest image file: no complete image has more bytes than its pixels would need without compression.
const MAX_FILE_BYTES: u64 = 8 * MAX_PIXELS as u64;

pub(super) fn read_image_file(path: &Path) -> Result<Vec<u8>, DatasetError> {
    read_file(path, MAX_FILE_BYTES)
}

/// The format that the first bytes announce.
fn sniff(bytes: &[u8], path: &Path) -> Result<ImageFormat, DatasetError> {
    let format = match bytes {
        [] => return Err(DatasetError::image(path, "the file is empty")),
        [0xff, 0xd8, ..] => ImageFormat::Jpeg,
        [0x89, b'P', b'N', b'G', ..] => ImageFormat::Png,
        [b'P', b'1'..=b'7', ..] => ImageFormat::Pnm,
        _ => {
            return Err(DatasetError::image(
                path,
                "its content is no format that we know",
            ));
        }
    };
    Ok(format)
}

/// Decodes anything but JPEG without converting it.
pub(super) fn decode_dynamic(bytes: &[u8], path: &Path) -> Result<DynamicImage, DatasetError> {
    let format = sniff(bytes, path)?;
    decode_within(bytes, format, [MAX_SIDE; 2], MAX_DECODE_BYTES)
        .map_err(|e| DatasetError::image(path, e.to_string()))
}

/// An 8-bit grey PNG of the given size; `None` for anything else, for which nothing is allocated.
pub(crate) fn decode_png_luma8(bytes: &[u8], width: usize, height: usize) -> Option<Image<u8>> {
    // the decoder wants some rows beside the image
    let max_bytes = 2 * width.checked_mul(height)? as u64 + (1 << 20);
    match decode_within(bytes, ImageFormat::Png, [width, height], max_bytes).ok()? {
        DynamicImage::ImageLuma8(image) if image.height() as usize == height => {
            Image::from_vec(width, height, image.into_raw())
        }
        _ => None,
    }
}

/// Decodes unless an image claims to be larger, or the decoder would need more memory.
fn decode_within(
    bytes: &[u8],
    format: ImageFormat,
    [max_width, max_height]: [usize; 2],
    max_bytes: u64,
) -> image::ImageResult<DynamicImage> {
    let mut reader = image::ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = image::Limits::default();
    limits.max_image_width = u32::try_from(max_width).ok();
    limits.max_image_height = u32::try_from(max_height).ok();
    limits.max_alloc = Some(max_bytes);
    reader.limits(limits);
    reader.decode()
}

/// Luma of every pixel type; transparency is ignored.
fn to_gray(image: &DynamicImage, path: &Path) -> Result<GrayImage, DatasetError> {
    // 65535 / 257 = 255
    const FROM_16_BIT: f32 = 1.0 / 257.0;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let data: Vec<f32> = match image {
        DynamicImage::ImageLuma8(i) => i.as_raw().iter().map(|&v| f32::from(v)).collect(),
        DynamicImage::ImageLumaA8(i) => i.pixels().map(|p| f32::from(p.0[0])).collect(),
        DynamicImage::ImageRgb8(i) => i.pixels().map(|p| luma(p.0.map(f32::from))).collect(),
        DynamicImage::ImageRgba8(i) => i
            .pixels()
            .map(|p| luma([p.0[0], p.0[1], p.0[2]].map(f32::from)))
            .collect(),
        DynamicImage::ImageLuma16(i) => i
            .as_raw()
            .iter()
            .map(|&v| f32::from(v) * FROM_16_BIT)
            .collect(),
        DynamicImage::ImageLumaA16(i) => i
            .pixels()
            .map(|p| f32::from(p.0[0]) * FROM_16_BIT)
            .collect(),
        other => other
            .to_rgb16()
            .pixels()
            .map(|p| luma(p.0.map(f32::from)) * FROM_16_BIT)
            .collect(),
    };
    pixels(width, height, data, path)
}

/// ITU-601 luma.
fn luma([r, g, b]: [f32; 3]) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}

fn pixels(
    width: usize,
    height: usize,
    data: Vec<f32>,
    path: &Path,
) -> Result<GrayImage, DatasetError> {
    Image::from_vec(width, height, data)
        .filter(|i| !i.as_slice().is_empty())
        .ok_or_else(|| DatasetError::image(path, "the image has no pixels"))
}
