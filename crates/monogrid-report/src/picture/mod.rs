//! Pictures: colour scales, views of keyframes and maps, PNG and data URLs.

pub mod colour;
pub mod keyframe;
pub mod plan;
pub mod slice;
pub mod voxels;

use monogrid_image::Image;
use std::ops::Range;

/// A colour picture.
pub type Picture = Image<[u8; 3]>;

/// A PNG or JPEG file as a data URL, for pages without other files.
pub fn data_url(picture: &[u8]) -> String {
    let kind = if picture.starts_with(&[0xff, 0xd8]) {
        "jpeg"
    } else {
        "png"
    };
    format!("data:image/{kind};base64,{}", base64(picture))
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

/// Columns and rows of an image of this size that a triangle may have pixels in.
fn box_around([a, b, c]: [[f64; 2]; 3], size: [usize; 2]) -> [Range<usize>; 2] {
    [0, 1].map(|axis| {
        let values = [a[axis], b[axis], c[axis]];
        let low = values.into_iter().fold(f64::INFINITY, f64::min);
        let high = values.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let most = size[axis] as f64;
        let low = low.ceil().clamp(0.0, most) as usize;
        low..((high.floor() + 1.0).clamp(0.0, most) as usize).max(low)
    })
}

/// Visits the pixels of an image of this size whose centres lie in a triangle, with the shares of
/// its corners there.
pub fn over_triangle(
    [a, b, c]: [[f64; 2]; 3],
    size: [usize; 2],
    mut visit: impl FnMut(usize, usize, [f64; 3]),
) {
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let [columns, rows] = box_around([a, b, c], size);
    for y in rows {
        for x in columns.clone() {
            let share = |from: [f64; 2], to: [f64; 2]| {
                let (dx, dy) = (x as f64 - from[0], y as f64 - from[1]);
                ((to[0] - from[0]) * dy - (to[1] - from[1]) * dx) / area
            };
            let shares = [share(b, c), share(c, a), share(a, b)];
            // a triangle without area has no pixels
            if shares.iter().all(|share| *share >= 0.0) {
                visit(x, y, shares);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_has_the_pixels_in_it() {
        let mut found = Vec::new();
        let corners = [[-1.0, 0.0], [2.0, 0.0], [2.0, 3.0]];
        over_triangle(corners, [9, 2], |x, y, shares| {
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            found.push([x, y]);
        });
        assert_eq!(found, [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]]);
        over_triangle([[1.0, 1.0]; 3], [9, 9], |_, _, _| panic!("it has no area"));
    }

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
