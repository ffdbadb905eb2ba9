//! JPEG to luma or colour, refusing incomplete files.

use super::accepted::{MAX_SIDE, max_pixels_of};
use monogrid_image::luma_of_rgb;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Pixels of a decoded JPEG: width, height, one byte per pixel and component.
pub(super) type Decoded = (usize, usize, Vec<u8>);

/// Decodes to luma. A YCbCr image already carries ITU-601 luma as its first component: colour is
/// never computed. RGB and CMYK images are converted.
pub(super) fn decode_luma(bytes: &[u8], max_pixels: usize) -> Result<Decoded, String> {
    let components = components(bytes, max_pixels)?;
    let has_luma = matches!(components, Some(ColorSpace::YCbCr | ColorSpace::Luma));
    let (width, height, luma) = match has_luma {
        true => decode_as(bytes, ColorSpace::Luma)?,
        false => {
            let (width, height, rgb) = decode_as(bytes, ColorSpace::RGB)?;
            let pixels = rgb.as_chunks().0.iter().copied();
            (width, height, pixels.map(luma_of_rgb).collect())
        }
    };
    let num_pixels = luma.len();
    if width * height == 0 || num_pixels != width * height {
        return Err(format!("{num_pixels} pixels decoded for {width}x{height}"));
    }
    Ok((width, height, luma))
}

/// Decodes to red, green and blue; `None` for an image that has only luma.
pub(super) fn decode_rgb(bytes: &[u8], max_pixels: usize) -> Result<Option<Decoded>, String> {
    match components(bytes, max_pixels)? {
        Some(ColorSpace::Luma) => Ok(None),
        _ => decode_as(bytes, ColorSpace::RGB).map(Some),
    }
}

/// Strict: otherwise corrupt or missing blocks are painted grey and reported as success.
fn options() -> DecoderOptions {
    DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE)
        .set_max_height(MAX_SIDE)
}

/// What the components of a complete image of at most so many pixels are.
fn components(bytes: &[u8], max_pixels: usize) -> Result<Option<ColorSpace>, String> {
    if !is_complete(bytes) {
        return Err("the JPEG data end before its end marker (truncated file)".to_owned());
    }
    let mut header = JpegDecoder::new_with_options(ZCursor::new(bytes), options());
    header.decode_headers().map_err(|e| e.to_string())?;
    let max_pixels = max_pixels.min(max_pixels_of(bytes.len()));
    if let Some((width, height)) = header.dimensions()
        && width * height > max_pixels
    {
        return Err(format!(
            "{width}x{height} pixels, expected at most {max_pixels} in a file of {} bytes",
            bytes.len()
        ));
    }
    Ok(header.input_colorspace())
}

fn decode_as(bytes: &[u8], output: ColorSpace) -> Result<Decoded, String> {
    let options = options().jpeg_set_out_colorspace(output);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let pixels = decoder.decode().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions().ok_or("no image in the file")?;
    Ok((width, height, pixels))
}

/// Whether the end marker follows the (last) scan: walks over the segments, and inside scans from
/// marker to marker (a plain 0xFF in scan data is always followed by 0).
fn is_complete(bytes: &[u8]) -> bool {
    let mut position = 2;
    let mut in_scan = false;
    loop {
        let rest = bytes.get(position..).unwrap_or_default();
        let Some(offset) = rest.iter().position(|&b| b == 0xff) else {
            return false;
        };
        position += offset + 1;
        match bytes.get(position) {
            None => return false,
            // fill bytes: the next 0xFF starts the marker
            Some(0xff) => {}
            // stuffed zero, or restart, inside a scan; start of image, TEM: no length follows
            Some(0x00 | 0x01 | 0xd0..=0xd8) => position += 1,
            Some(0xd9) => return in_scan,
            Some(&marker) => {
                let Some(&[high, low]) = bytes.get(position + 1..position + 3) else {
                    return false;
                };
                in_scan |= marker == 0xda;
                position += 1 + usize::from(u16::from_be_bytes([high, low])).max(2);
            }
        }
    }
}
