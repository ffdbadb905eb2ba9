//! From the bytes of a camera's buffer to a grey image and its colour.

use crate::turn::Turn;
use crate::{Chroma, Colour, ColourSpace, Grey, MAX_PIXELS};
use monogrid_datasets::decode_jpeg_luma;
use std::path::Path;

/// What a camera's buffers hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PixelFormat {
    /// 4:2:2, luma in every second byte.
    Yuyv,
    /// A JPEG image.
    Mjpeg,
    /// 8-bit grey.
    Grey,
}

/// Formats that can be used, best first: grey and YUYV are not compressed.
pub(crate) const FORMATS: [(PixelFormat, [u8; 4]); 4] = [
    (PixelFormat::Grey, *b"GREY"),
    (PixelFormat::Yuyv, *b"YUYV"),
    (PixelFormat::Mjpeg, *b"MJPG"),
    (PixelFormat::Mjpeg, *b"JPEG"),
];

/// How an image lies in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BufferLayout {
    pub(crate) format: PixelFormat,
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Bytes from row to row; 0 where the driver does not say it.
    pub(crate) stride: usize,
}

/// The image in a buffer, or why there is none.
pub(crate) fn grey_image(buffer: &[u8], layout: BufferLayout, name: &str) -> Result<Grey, String> {
    let BufferLayout {
        format,
        width,
        height,
        stride,
    } = layout;
    let bytes_per_pixel = match format {
        PixelFormat::Mjpeg => {
            let image = decode_jpeg_luma(buffer, MAX_PIXELS, Path::new(name));
            return image.map_err(|e| e.to_string());
        }
        PixelFormat::Yuyv => 2,
        PixelFormat::Grey => 1,
    };
    let stride = stride.max(bytes_per_pixel * width);
    if width * height == 0 || buffer.len() < stride * (height - 1) + bytes_per_pixel * width {
        return Err(format!(
            "{} bytes for {width}x{height} pixels of {format:?}",
            buffer.len()
        ));
    }
    Ok(Grey::from_fn(width, height, |x, y| {
        buffer[y * stride + bytes_per_pixel * x]
    }))
}

/// The colour in a buffer of which the [`grey_image`] can be made.
pub(crate) fn colour(buffer: &[u8], layout: BufferLayout) -> Colour {
    match layout.format {
        PixelFormat::Grey => Colour::Grey,
        PixelFormat::Mjpeg => Colour::Jpeg(buffer.to_vec()),
        PixelFormat::Yuyv => {
            let (width, height) = (layout.width / 2, layout.height);
            let rows = buffer.chunks(layout.stride.max(2 * layout.width));
            // Y0 Cb Y1 Cr
            let plane = |at: usize| -> Vec<u8> {
                let row = |row: &'_ [u8]| {
                    let pairs = row.as_chunks::<4>().0.iter().take(width);
                    pairs.map(move |pair| pair[at]).collect::<Vec<u8>>()
                };
                rows.clone().take(height).flat_map(row).collect()
            };
            let space = ColourSpace::usual(height, false);
            let chroma = Chroma::new([&plane(1), &plane(3)], (width, height), space, Turn::None);
            chroma.map_or(Colour::Grey, Colour::Chroma)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{BufferLayout, PixelFormat, colour, grey_image};
    use crate::Colour;

    const fn layout(format: PixelFormat, stride: usize) -> BufferLayout {
        BufferLayout {
            format,
            width: 2,
            height: 2,
            stride,
        }
    }

    #[test]
    fn luma_of_yuyv_with_padded_rows() {
        let buffer = [10, 0, 20, 0, 99, 99, 30, 0, 40, 0, 99, 99];
        let image = grey_image(&buffer, layout(PixelFormat::Yuyv, 6), "camera").unwrap();
        assert_eq!(image.as_slice(), [10, 20, 30, 40]);
        let grey = [10, 128, 20, 127, 99, 99, 30, 128, 40, 129, 99, 99];
        assert_eq!(colour(&grey, layout(PixelFormat::Yuyv, 6)), Colour::Grey);
        let blue = [10, 200, 20, 90, 99, 99, 30, 200, 40, 90, 99, 99];
        let Colour::Chroma(chroma) = colour(&blue, layout(PixelFormat::Yuyv, 6)) else {
            panic!("no colour");
        };
        assert_eq!(chroma.at_size((2, 2)).as_slice(), [[200, 90]; 4]);
        // the last row needs no padding
        assert!(grey_image(&buffer[..10], layout(PixelFormat::Yuyv, 6), "camera").is_ok());
        assert!(grey_image(&buffer[..9], layout(PixelFormat::Yuyv, 6), "camera").is_err());
    }

    #[test]
    fn grey_without_a_stride() {
        let image = grey_image(&[1, 2, 3, 4], layout(PixelFormat::Grey, 0), "camera").unwrap();
        assert_eq!(image.as_slice(), [1, 2, 3, 4]);
    }

    #[test]
    fn a_broken_jpeg_is_an_error() {
        assert!(grey_image(&[0xff, 0xd8, 0], layout(PixelFormat::Mjpeg, 0), "camera").is_err());
    }
}
