//! Pictures: colour scales, views of keyframes and maps, PNG and data URLs.

pub mod colour;
pub mod keyframe;
pub mod plan;
pub mod slice;
pub mod voxels;

use monogrid_image::Image;

/// A colour picture.
pub type Picture = Image<[u8; 3]>;

/// A PNG file as a data URL, for pages without other files.
pub fn data_url(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64(png))
}

/// RFC 4648 base64 with padding.
pub fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let bytes = chunk.iter().chain(&[0; 2]).take(3);
        let word = bytes.fold(0u32, |word, &byte| (word << 8) | u32::from(byte));
        for i in 0..4 {
            let six_bits = (word >> (18 - 6 * i)) & 63;
            out.push(match i <= chunk.len() {
                true => char::from(ALPHABET[six_bits as usize]),
                false => '=',
            });
        }
    }
    out
}

/// Averages the channels of blocks of `factor` x `factor` pixels.
pub fn shrink<T: Copy, const N: usize>(
    image: &Image<T>,
    factor: usize,
    channels: impl Fn(T) -> [u8; N],
) -> Image<[u8; N]> {
    let count = (factor * factor) as u32;
    let [width, height] = [image.width(), image.height()].map(|side| side / factor);
    Image::from_fn(width, height, |x, y| {
        let mut sums = [0u32; N];
        for dy in 0..factor {
            for dx in 0..factor {
                let pixel = image.at(x * factor + dx, y * factor + dy);
                for (sum, value) in sums.iter_mut().zip(channels(pixel)) {
                    *sum += u32::from(value);
                }
            }
        }
        sums.map(|sum| (sum / count) as u8)
    })
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
}
