//! TIFF, WebP and BMP.

use super::accepted::{MAX_DECODE_BYTES, MAX_SIDE};
use super::raster::{Raster, Samples, check_size};
use image_webp::WebPDecoder;
use std::io::Cursor;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::{ColorType, TiffError};
use zune_bmp::{BmpDecoder, BmpDecoderErrors};
use zune_core::bytestream::ZCursor;
use zune_core::options::DecoderOptions;

/// Decodes the first image of a TIFF: grey or colour of 8 or 16 bits.
pub(super) fn decode_tiff(bytes: &[u8]) -> Result<Raster, String> {
    let said = |error: TiffError| error.to_string();
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_DECODE_BYTES;
    let decoder = Decoder::new(Cursor::new(bytes)).map_err(said)?;
    let mut decoder = decoder.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(said)?;
    let (width, height) = (width as usize, height as usize);
    check_size(width, height, [MAX_SIDE; 2], bytes.len())?;
    let colour = decoder.colortype().map_err(said)?;
    let channels = match colour {
        ColorType::Gray(_) => 1,
        ColorType::GrayA(_) => 2,
        ColorType::RGB(_) => 3,
        ColorType::RGBA(_) => 4,
        _ => {
            return Err(format!(
                "its pixels are {colour:?}, not grey, nor red, green and blue"
            ));
        }
    };
    let (samples, white, length) = match decoder.read_image().map_err(said)? {
        DecodingResult::U8(samples) => {
            let length = samples.len();
            (Samples::Bytes(samples), 255, length)
        }
        DecodingResult::U16(samples) => {
            let length = samples.len();
            (Samples::Words(samples), u16::MAX, length)
        }
        _ => return Err("its samples are not whole numbers of 8 or 16 bits".to_owned()),
    };
    // less where each colour has an image of its own, or where samples of fewer bits are packed
    if length != width * height * channels {
        return Err("its samples are packed in a way that is not understood".to_owned());
    }
    Ok(Raster {
        width,
        height,
        channels,
        white,
        samples,
    })
}

/// Decodes a WebP; the first image of an animation.
pub(super) fn decode_webp(bytes: &[u8]) -> Result<Raster, String> {
    let said = |error: image_webp::DecodingError| error.to_string();
    let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(said)?;
    decoder.set_memory_limit(MAX_DECODE_BYTES);
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    check_size(width, height, [MAX_SIDE; 2], bytes.len())?;
    let size = decoder.output_buffer_size();
    let mut samples = vec![0; size.ok_or("it needs too much memory")?];
    decoder.read_image(&mut samples).map_err(said)?;
    Ok(Raster {
        width,
        height,
        channels: if decoder.has_alpha() { 4 } else { 3 },
        white: 255,
        samples: Samples::Bytes(samples),
    })
}

/// Decodes a BMP whose pixels are not compressed; palettes become colours.
pub(super) fn decode_bmp(bytes: &[u8]) -> Result<Raster, String> {
    check_bmp_is_whole(bytes)?;
    let said = |error: BmpDecoderErrors| format!("{error:?}");
    let options = DecoderOptions::new_fast()
        .set_max_width(MAX_SIDE)
        .set_max_height(MAX_SIDE);
    let mut decoder = BmpDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(said)?;
    let (width, height) = decoder.dimensions().ok_or("it has no size")?;
    check_size(width, height, [MAX_SIDE; 2], bytes.len())?;
    let colours = decoder.colorspace().ok_or("it has no pixels")?;
    Ok(Raster {
        width,
        height,
        channels: colours.num_components(),
        white: 255,
        samples: Samples::Bytes(decoder.decode().map_err(said)?),
    })
}

/// The decoder takes what is missing at the end for black.
fn check_bmp_is_whole(bytes: &[u8]) -> Result<(), String> {
    let number = |at: usize, length: usize| {
        let field = bytes.get(at..at + length)?;
        let digits = field.iter().rev();
        Some(digits.fold(0, |number, byte| number << 8 | u64::from(*byte)))
    };
    let needed = || {
        let (begin, header) = (number(10, 4)?, number(14, 4)?);
        let (width, height, bits, compression) = match header {
            12 => (number(18, 2)?, number(20, 2)?, number(24, 2)?, 0),
            _ => {
                // rows from the top down have a negative height
                let height = u64::from((number(22, 4)? as u32 as i32).unsigned_abs());
                (number(18, 4)?, height, number(28, 2)?, number(30, 4)?)
            }
        };
        let row = (width * bits).div_ceil(32) * 4;
        Some((
            begin.saturating_add(row.saturating_mul(height)),
            compression,
        ))
    };
    match needed() {
        // 3 and 6: the bits of the colours are named
        Some((end, 0 | 3 | 6)) if end <= bytes.len() as u64 => Ok(()),
        Some((_, 0 | 3 | 6)) | None => Err("the file ends before its last pixel".to_owned()),
        Some(_) => Err("a BMP whose pixels are compressed, which is not read; PNG is".to_owned()),
    }
}
