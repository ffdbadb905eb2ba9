//! From the bytes of a camera's buffer to a grey image and its colour.

use crate::frame::{Grey, MAX_PIXELS};
use crate::turn::Turn;
use crate::{Chroma, Colour, ColourSpace};
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

/// The image in a buffer and its colour, or why there is none.
pub(crate) fn decoded(
    buffer: &[u8],
    layout: BufferLayout,
    name: &str,
) -> Result<(Grey, Colour), String> {
    let BufferLayout { width, height, .. } = layout;
    let bytes_per_pixel = match layout.format {
        PixelFormat::Mjpeg => {
            let image = decode_jpeg_luma(buffer, MAX_PIXELS, Path::new(name));
            let image = image.map_err(|e| e.to_string())?;
            return Ok((image, Colour::Jpeg(buffer.to_vec())));
        }
        PixelFormat::Yuyv => 2,
        PixelFormat::Grey => 1,
    };
    let stride = layout.stride.max(bytes_per_pixel * width);
    let (found, format) = (buffer.len(), layout.format);
    if width * height == 0 || found < stride * (height - 1) + bytes_per_pixel * width {
        return Err(format!(
            "{found} bytes for {width}x{height} pixels of {format:?}"
        ));
    }
    let image = Grey::from_fn(width, height, |x, y| {
        buffer[y * stride + bytes_per_pixel * x]
    });
    if format == PixelFormat::Grey {
        return Ok((image, Colour::Grey));
    }
    let rows = buffer.chunks(stride).take(height);
    // Y0 Cb Y1 Cr
    let plane = |at: usize| -> Vec<u8> {
        let row = |row: &'_ [u8]| {
            let pairs = row.as_chunks::<4>().0.iter().take(width / 2);
            pairs.map(move |pair| pair[at]).collect::<Vec<u8>>()
        };
        rows.clone().flat_map(row).collect()
    };
    let space = ColourSpace::usual(height, false);
    let size = (width / 2, height);
    let chroma = Chroma::new([&plane(1), &plane(3)], size, space, Turn::None);
    Ok((image, chroma.map_or(Colour::Grey, Colour::Chroma)))
}

#[cfg(test)]
mod tests {
    use super::{BufferLayout, PixelFormat, decoded};
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
        let yuyv = |buffer: &[u8]| decoded(buffer, layout(PixelFormat::Yuyv, 6), "camera");
        let (image, _) = yuyv(&buffer).unwrap();
        assert_eq!(image.as_slice(), [10, 20, 30, 40]);
        let grey = [10, 128, 20, 127, 99, 99, 30, 128, 40, 129, 99, 99];
        assert_eq!(yuyv(&grey).unwrap().1, Colour::Grey);
        let blue = [10, 200, 20, 90, 99, 99, 30, 200, 40, 90, 99, 99];
        let Colour::Chroma(chroma) = yuyv(&blue).unwrap().1 else {
            panic!("no colour");
        };
        assert_eq!(chroma.at_size((2, 2)).as_slice(), [[200, 90]; 4]);
        // the last row needs no padding
        assert!(yuyv(&buffer[..10]).is_ok() && yuyv(&buffer[..9]).is_err());
    }

    #[test]
    fn grey_without_a_stride() {
        let (image, colour) =
            decoded(&[1, 2, 3, 4], layout(PixelFormat::Grey, 0), "camera").unwrap();
        assert_eq!(
            (image.as_slice(), colour),
            (&[1, 2, 3, 4][..], Colour::Grey)
        );
    }

    #[test]
    fn a_broken_jpeg_is_an_error() {
        assert!(decoded(&[0xff, 0xd8, 0], layout(PixelFormat::Mjpeg, 0), "camera").is_err());
    }
}
