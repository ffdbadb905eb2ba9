//! Pictures: colour scales, views of keyframes and maps, PNG and data URLs.

pub mod colour;
pub mod keyframe;
pub mod voxels;

use image::{ExtendedColorType, ImageEncoder, codecs::png};
use monogrid_image::Image;

/// A colour picture.
pub type Picture = Image<[u8; 3]>;

/// A picture as a PNG file.
pub fn encode_png(picture: &Picture) -> Result<Vec<u8>, image::ImageError> {
    let bytes: Vec<u8> = picture.as_slice().iter().flatten().copied().collect();
    write_png(
        &bytes,
        picture.width(),
        picture.height(),
        ExtendedColorType::Rgb8,
    )
}

/// A grey image as a PNG file.
pub fn encode_grey_png(grey: &Image<u8>) -> Result<Vec<u8>, image::ImageError> {
    write_png(
        grey.as_slice(),
        grey.width(),
        grey.height(),
        ExtendedColorType::L8,
    )
}

fn write_png(
    bytes: &[u8],
    width: usize,
    height: usize,
    colour: ExtendedColorType,
) -> Result<Vec<u8>, image::ImageError> {
    let mut out = Vec::new();
    png::PngEncoder::new_with_quality(
        &mut out,
        png::CompressionType::Default,
        png::FilterType::Adaptive,
    )
    .write_image(bytes, width as u32, height as u32, colour)?;
    Ok(out)
}

/// A PNG file as a data URL, for pages without other files.
pub fn data_url(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64(png))
}

/// RFC 4648 base64 with padding.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = chunk
            .iter()
            .chain(std::iter::repeat(&0))
            .take(3)
            .fold(0u32, |word, &byte| (word << 8) | u32::from(byte));
        for i in 0..4 {
            if i <= chunk.len() {
                let six_bits = (word >> (18 - 6 * i)) & 63;
                out.push(char::from(ALPHABET[six_bits as usize]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

/// Averages blocks of `factor` x `factor` pixels.
pub fn shrink(picture: &Picture, factor: usize) -> Picture {
    let count = (factor * factor) as u32;
    Picture::from_fn(
        picture.width() / factor,
        picture.height() / factor,
        |x, y| {
            let mut sum = [0u32; 3];
            for dy in 0..factor {
                for dx in 0..factor {
                    let pixel = picture.at(x * factor + dx, y * factor + dy);
                    for (sum, value) in sum.iter_mut().zip(pixel) {
                        *sum += u32::from(value);
                    }
                }
            }
            sum.map(|value| (value / count) as u8)
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_agrees_with_the_test_vectors_of_rfc_4648() {
        for (plain, encoded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
    }

    #[test]
    fn png_files_hold_the_pixels() {
        let picture = Picture::from_fn(5, 3, |x, y| [x as u8 * 40, y as u8 * 80, 7]);
        let decoded = image::load_from_memory(&encode_png(&picture).unwrap())
            .unwrap()
            .to_rgb8();
        assert_eq!(decoded.dimensions(), (5, 3));
        assert_eq!(decoded.get_pixel(4, 2).0, [160, 160, 7]);
    }
}
