//! Images.

use monogrid_datasets::decode_gray;
use monogrid_image::{GrayImage, luma_of_rgb};
use monogrid_messages::sensor_msgs::{CompressedImage, Image};
use std::path::Path;

/// Why an image message is no image.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// An encoding without grey values, or that nobody needed so far.
    #[error(
        "images in the encoding {found:?} are not supported; there are {}",
        ENCODINGS.map(|(name, ..)| name).join(", ")
    )]
    Encoding {
        /// What it is called.
        found: String,
    },
    /// The rows are not where the sizes say.
    #[error(
        "an image of {width}x{height} pixels in rows of {step} bytes has {bytes} bytes: rows are \
         too short, or some are missing"
    )]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes of a row.
        step: u32,
        /// All bytes.
        bytes: usize,
    },
    /// Depth, by what it says of itself.
    #[error(
        "images in the format {format:?} are depth (compressedDepth), expected pictures; name \
         another topic with --topic NAME"
    )]
    Depth {
        /// What it says.
        format: String,
    },
    /// A compressed image that cannot be decoded.
    #[error("{0}")]
    Compressed(#[from] monogrid_datasets::DatasetError),
}

/// Grey values of the bytes of a pixel.
type Grey = fn(&[u8]) -> f32;

/// What [`gray_image`] understands: name, bytes of a pixel, grey value; 16 bits are little endian.
const ENCODINGS: [(&str, usize, Grey); 23] = [
    ("mono8", 1, FIRST),
    ("8UC1", 1, FIRST),
    ("mono16", 2, MONO16),
    ("16UC1", 2, MONO16),
    ("bgr8", 3, BGR),
    ("8UC3", 3, BGR),
    ("rgb8", 3, RGB),
    ("bgra8", 4, BGR),
    ("8UC4", 4, BGR),
    ("rgba8", 4, RGB),
    ("yuv422", 2, SECOND),
    ("uyvy", 2, SECOND),
    ("yuv422_yuy2", 2, FIRST),
    ("yuyv", 2, FIRST),
    ("nv12", 1, FIRST),
    ("bayer_rggb8", 1, FIRST),
    ("bayer_bggr8", 1, FIRST),
    ("bayer_gbrg8", 1, FIRST),
    ("bayer_grbg8", 1, FIRST),
    ("bayer_rggb16", 2, MONO16),
    ("bayer_bggr16", 2, MONO16),
    ("bayer_gbrg16", 2, MONO16),
    ("bayer_grbg16", 2, MONO16),
];
const FIRST: Grey = |b| f32::from(b[0]);
const SECOND: Grey = |b| f32::from(b[1]);
// 65535 / 257 = 255
const MONO16: Grey = |b| f32::from(u16::from_le_bytes([b[0], b[1]])) / 257.0;
const MONO16_BIG: Grey = |b| f32::from(u16::from_be_bytes([b[0], b[1]])) / 257.0;
// ITU-601 luma
const RGB: Grey = |b| luma_of_rgb([b[0], b[1], b[2]]).into();
const BGR: Grey = |b| luma_of_rgb([b[2], b[1], b[0]]).into();

/// The grey image, 0 to 255, of a message; ITU-601 luma of colours.
///
/// # Errors
/// An encoding that is not supported, or rows that are missing.
pub fn gray_image(image: &Image) -> Result<GrayImage, ImageError> {
    let found = ENCODINGS.iter().find(|(name, ..)| *name == image.encoding);
    let (name, bytes, grey) = *found.ok_or_else(|| ImageError::Encoding {
        found: image.encoding.clone(),
    })?;
    let grey = match has_words(name) && image.is_bigendian != 0 {
        true => MONO16_BIG,
        false => grey,
    };
    let pixels = pixels(image, bytes, grey)?;
    Ok(match name.starts_with("bayer") {
        true => without_mosaic(&pixels),
        false => pixels,
    })
}

/// Whether grey values of this encoding have 16 bits, of which nothing says how many are used.
#[must_use]
pub fn has_words(encoding: &str) -> bool {
    encoding.ends_with("16") || encoding == "16UC1"
}

/// Whether a file has such values: a PNG of 16 bits.
#[must_use]
pub fn has_words_compressed(file: &[u8]) -> bool {
    file.starts_with(b"\x89PNG") && file.get(24) == Some(&16)
}

/// The grey image, 0 to 255, of a JPEG or PNG file, where it is the mosaic of a sensor resolved.
///
/// # Errors
/// A file that cannot be decoded, or not completely, and depth.
pub fn gray_of_compressed(image: &CompressedImage) -> Result<GrayImage, ImageError> {
    if image.format.contains("compressedDepth") {
        return Err(ImageError::Depth {
            format: image.format.clone(),
        });
    }
    let grey = decode_gray(&image.data, Path::new("the compressed image"))?;
    Ok(match is_mosaic(&image.format) {
        true => without_mosaic(&grey),
        false => grey,
    })
}

/// Whether a file holds a mosaic as it was: image_transport says the encoding of the image, then
/// that of what it has compressed, as in `bayer_rggb8; jpeg compressed bgr8`; it leaves the latter
/// out where they are the same.
fn is_mosaic(format: &str) -> bool {
    let (from, packed) = format.split_once(';').unwrap_or((format, ""));
    let compressed = packed.split("compressed").nth(1).unwrap_or_default().trim();
    from.trim().starts_with("bayer_") && (compressed.is_empty() || compressed.starts_with("bayer_"))
}

/// The grey values of pixels of so many bytes.
fn pixels(image: &Image, bytes: usize, grey: Grey) -> Result<GrayImage, ImageError> {
    let size_error = || ImageError::Size {
        width: image.width,
        height: image.height,
        step: image.step,
        bytes: image.data.len(),
    };
    let (width, height) = (image.width as usize, image.height as usize);
    let step = image.step as usize;
    let row = width * bytes;
    // the last row may end with its last pixel
    let needed = height.saturating_sub(1).saturating_mul(step) + row;
    if row == 0 || step < row || image.data.len() < needed {
        return Err(size_error());
    }
    let rows = image.data.chunks(step).take(height);
    let values = rows.flat_map(|bytes_of_row| bytes_of_row[..row].chunks_exact(bytes).map(grey));
    GrayImage::from_vec(width, height, values.collect()).ok_or_else(size_error)
}

/// The mosaic of a sensor with one colour per pixel (Bayer), as grey: weights 1 2 1 in both
/// directions give every pixel one quarter of red, half of green and one quarter of blue, whichever
/// colour it has itself.
fn without_mosaic(mosaic: &GrayImage) -> GrayImage {
    let (width, height) = (mosaic.width(), mosaic.height());
    // mirrored at the border, so that colours keep their places
    let neighbours = |k: usize, size: usize| {
        let before = if k == 0 { 1.min(size - 1) } else { k - 1 };
        let after = match k + 1 {
            after if after < size => after,
            _ => size.saturating_sub(2),
        };
        [before, k, after]
    };
    GrayImage::from_fn(width, height, |x, y| {
        let columns = neighbours(x, width);
        let along = |y: usize| {
            let [a, b, c] = columns.map(|x| mosaic.at(x, y));
            a + 2.0 * b + c
        };
        let [a, b, c] = neighbours(y, height).map(along);
        (a + 2.0 * b + c) / 16.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(encoding: &str, width: u32, step: u32, data: &[u8]) -> Image {
        Image {
            height: data.len() as u32 / step,
            width,
            encoding: encoding.into(),
            step,
            data: data.to_vec(),
            ..Image::default()
        }
    }

    fn grey(message: &Image) -> Vec<f32> {
        let image = gray_image(message).unwrap();
        let values = image.as_slice().iter();
        values.map(|v| (v * 1000.0).round() / 1000.0).collect()
    }

    #[test]
    fn encodings_by_hand() {
        // two rows of two pixels; bytes behind the pixels are no pixels
        assert_eq!(
            grey(&image("mono8", 2, 3, &[1, 2, 99, 3, 255, 99])),
            [1.0, 2.0, 3.0, 255.0]
        );
        assert_eq!(grey(&image("rgb8", 1, 3, &[100, 0, 0])), [30.0]);
        assert_eq!(grey(&image("bgr8", 1, 3, &[100, 0, 0])), [11.0]);
        assert_eq!(grey(&image("rgba8", 1, 4, &[0, 100, 0, 7])), [59.0]);
        assert_eq!(grey(&image("bgra8", 1, 4, &[0, 0, 100, 7])), [30.0]);
        assert_eq!(
            grey(&image("mono16", 2, 4, &[0xff, 0xff, 1, 1])),
            [255.0, 1.0]
        );
        let mut big = image("16UC1", 1, 2, &[0x02, 0x02]);
        assert_eq!(grey(&big), [2.0]);
        (big.data, big.is_bigendian) = (vec![0x01, 0x00], 1);
        assert_eq!(grey(&big), [(256.0_f32 / 257.0 * 1000.0).round() / 1000.0]);
        assert_eq!(
            grey(&image("yuv422", 2, 4, &[128, 10, 128, 20])),
            [10.0, 20.0]
        );
        assert_eq!(
            grey(&image("yuv422_yuy2", 2, 4, &[10, 128, 20, 128])),
            [10.0, 20.0]
        );
    }

    #[test]
    fn nv12_begins_with_its_grey_rows() {
        let mut nv12 = image("nv12", 2, 2, &[1, 2, 3, 4, 128, 128]);
        nv12.height = 2;
        assert_eq!(grey(&nv12), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn a_mosaic_of_one_colour_is_even() {
        // red 40, green 80, blue 120: 10 + 40 + 30
        let rows = [40, 80, 40, 80, 80, 120, 80, 120].repeat(2);
        for encoding in ["bayer_rggb8", "bayer_grbg8"] {
            let message = image(encoding, 4, 4, &rows);
            assert!(grey(&message).iter().all(|value| *value == 80.0));
        }
    }

    #[test]
    fn a_file_of_a_mosaic_is_resolved_where_it_says_so() {
        let rows = [40, 80, 40, 80, 80, 120, 80, 120].repeat(2);
        let file = monogrid_datasets::encode_png(
            &monogrid_image::Image::from_vec(4, 4, rows.clone()).unwrap(),
        );
        let grey = |format: &str| {
            let message = CompressedImage {
                format: format.into(),
                data: file.clone(),
                ..CompressedImage::default()
            };
            gray_of_compressed(&message).unwrap().as_slice().to_vec()
        };
        for mosaic in [
            "bayer_rggb8; jpeg compressed ",
            "bayer_rggb8;png compressed bayer_rggb8",
            "bayer_gbrg8",
        ] {
            assert!(grey(mosaic).iter().all(|value| *value == 80.0), "{mosaic}");
        }
        for resolved in [
            "bayer_rggb8; jpeg compressed bgr8",
            "mono8; jpeg compressed ",
            "jpeg",
        ] {
            let expected: Vec<f32> = rows.iter().map(|v| f32::from(*v)).collect();
            assert_eq!(grey(resolved), expected, "{resolved}");
        }
    }

    #[test]
    fn compressed_depth_is_named() {
        let depth = CompressedImage {
            format: "16UC1; compressedDepth png".into(),
            data: vec![0; 12],
            ..CompressedImage::default()
        };
        let error = gray_of_compressed(&depth).unwrap_err().to_string();
        assert!(
            error.contains("depth") && error.contains("--topic"),
            "{error}"
        );
    }

    #[test]
    fn what_is_no_image_is_refused() {
        let depth = gray_image(&image("32FC1", 1, 4, &[0; 4])).unwrap_err();
        assert!(depth.to_string().contains("\"32FC1\"") && depth.to_string().contains("bgr8"));
        let mut short = image("mono8", 2, 2, &[1, 2, 3, 4]);
        short.height = 3;
        assert!(matches!(gray_image(&short), Err(ImageError::Size { .. })));
        for (width, step) in [(3, 2), (0, 2), (u32::MAX, u32::MAX)] {
            let mut wrong = image("rgb8", 1, 4, &[0; 4]);
            (wrong.width, wrong.step) = (width, step);
            assert!(matches!(gray_image(&wrong), Err(ImageError::Size { .. })));
        }
        let text = CompressedImage {
            format: "jpeg".into(),
            data: b"no image".to_vec(),
            ..CompressedImage::default()
        };
        assert!(gray_of_compressed(&text).is_err());
    }

    #[test]
    fn encodings_that_are_listed_are_understood() {
        for (encoding, ..) in ENCODINGS {
            let message = image(encoding, 2, 8, &[7; 16]);
            let values = grey(&message);
            let mut big = message.clone();
            big.is_bigendian = 1;
            assert_eq!(grey(&big), values);
            assert!(values.len() == 4 && values.iter().all(|v| (v - 7.0).abs() < 0.01));
        }
    }
}
