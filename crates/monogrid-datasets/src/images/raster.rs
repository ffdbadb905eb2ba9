//! An image as a lossless file holds it: PNG, or PBM, PGM, PPM.

use super::accepted::{MAX_SIDE, max_pixels_of};
use std::io::Cursor;

/// Samples of all pixels, row by row.
#[derive(Debug, PartialEq)]
pub(super) enum Samples {
    Bytes(Vec<u8>),
    Words(Vec<u16>),
}

/// A decoded image, not converted.
#[derive(Debug, PartialEq)]
pub(super) struct Raster {
    pub width: usize,
    pub height: usize,
    /// 1: grey, 2: grey and opacity, 3: red, green, blue; 4: these and opacity.
    pub channels: usize,
    /// Value of white.
    pub white: u16,
    pub samples: Samples,
}

impl Raster {
    pub(super) fn has_colour(&self) -> bool {
        self.channels >= 3
    }

    /// What a function makes of the samples of each pixel; opacity is given, and meant to be
    /// ignored.
    pub(super) fn map<T>(&self, of_pixel: impl Fn(&[f32]) -> T) -> Vec<T> {
        match &self.samples {
            Samples::Bytes(samples) => map_pixels(samples, self.channels, of_pixel),
            Samples::Words(samples) => map_pixels(samples, self.channels, of_pixel),
        }
    }
}

fn map_pixels<S: Copy, T>(samples: &[S], channels: usize, of_pixel: impl Fn(&[f32]) -> T) -> Vec<T>
where
    f32: From<S>,
{
    match channels {
        1 => map_chunks::<1, _, _>(samples, of_pixel),
        2 => map_chunks::<2, _, _>(samples, of_pixel),
        3 => map_chunks::<3, _, _>(samples, of_pixel),
        _ => map_chunks::<4, _, _>(samples, of_pixel),
    }
}

/// As [`map_pixels`], with a number of channels that the compiler knows: the loop over them is
/// gone.
fn map_chunks<const N: usize, S: Copy, T>(samples: &[S], of_pixel: impl Fn(&[f32]) -> T) -> Vec<T>
where
    f32: From<S>,
{
    let (pixels, _) = samples.as_chunks::<N>();
    let pixels = pixels.iter();
    pixels
        .map(|pixel| of_pixel(&pixel.map(f32::from)))
        .collect()
}

/// Decodes a PNG of at most these sides, which takes at most so much memory. Palettes become
/// colours, fewer than eight bits become eight.
pub(super) fn decode_png(
    bytes: &[u8],
    max_sides: [usize; 2],
    max_bytes: usize,
) -> Result<Raster, String> {
    let said = |error: png::DecodingError| error.to_string();
    let limits = png::Limits { bytes: max_bytes };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(png::Transformations::EXPAND);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let (width, height) = decoder.read_header_info().map_err(said)?.size();
    let (width, height) = (width as usize, height as usize);
    check_size(width, height, max_sides, bytes.len())?;
    let mut reader = decoder.read_info().map_err(said)?;
    // four bytes for each: more only where fewer pixels take them
    let max_bytes = max_bytes.min(4 * max_pixels_of(bytes.len()));
    let size = reader.output_buffer_size().filter(|b| *b <= max_bytes);
    let mut samples = vec![0; size.ok_or("it needs too much memory")?];
    reader.next_frame(&mut samples).map_err(said)?;
    let (colour, depth) = reader.output_color_type();
    let is_wide = depth == png::BitDepth::Sixteen;
    let samples = if is_wide {
        Samples::Words(big_endian(&samples).collect())
    } else {
        Samples::Bytes(samples)
    };
    Ok(Raster {
        width,
        height,
        channels: colour.samples(),
        white: if is_wide { u16::MAX } else { 255 },
        samples,
    })
}

/// Decodes a PBM, PGM or PPM, as text or binary (netpbm's description of these formats). Binary
/// samples above white are white.
pub(super) fn decode_pnm(bytes: &[u8]) -> Result<Raster, String> {
    let mut words = Words { rest: bytes };
    let kind = *bytes.get(1).ok_or("the header is cut off")?;
    words.rest = &bytes[2..];
    let mut number = || words.number().ok_or("the header is damaged or cut off");
    let (width, height) = (number()?, number()?);
    check_size(width, height, [MAX_SIDE; 2], bytes.len())?;
    let is_bitmap = matches!(kind, b'1' | b'4');
    let white = if is_bitmap { 1 } else { number()? };
    let white = u16::try_from(white).ok().filter(|white| *white > 0);
    let white = white.ok_or("the value of white must be 1 to 65535")?;
    let channels = if matches!(kind, b'3' | b'6') { 3 } else { 1 };
    let count = width * height * channels;
    let samples = match kind {
        b'1' => words.digits(count).map(Samples::Bytes),
        b'2' | b'3' => words.samples(count, white),
        b'4' => words.binary().and_then(|bytes| bits(bytes, width, height)),
        _ => words
            .binary()
            .and_then(|bytes| limited(bytes, count, white)),
    };
    Ok(Raster {
        width,
        height,
        channels,
        white,
        samples: samples.ok_or("pixels are missing or damaged")?,
    })
}

/// Refuses what a damaged header says.
pub(super) fn check_size(
    width: usize,
    height: usize,
    [widest, highest]: [usize; 2],
    num_bytes: usize,
) -> Result<(), String> {
    if width == 0 || height == 0 {
        return Err("the image has no pixels".into());
    }
    if width > widest || height > highest {
        return Err(format!("{width}x{height} pixels are too many"));
    }
    let most = max_pixels_of(num_bytes);
    if width * height > most {
        return Err(format!(
            "{width}x{height} pixels are too many for a file of {num_bytes} bytes, at most {most} \
             are read"
        ));
    }
    Ok(())
}

/// Samples of one byte or of two, by the value of white; more than that is white.
fn limited(bytes: &[u8], count: usize, white: u16) -> Option<Samples> {
    Some(if let Ok(white) = u8::try_from(white) {
        let samples = bytes.get(..count)?.iter();
        Samples::Bytes(samples.map(|sample| (*sample).min(white)).collect())
    } else {
        let samples = big_endian(bytes.get(..2 * count)?);
        Samples::Words(samples.map(|sample| sample.min(white)).collect())
    })
}

fn big_endian(bytes: &[u8]) -> impl Iterator<Item = u16> {
    let pairs = bytes.as_chunks().0.iter();
    pairs.map(|pair| u16::from_be_bytes(*pair))
}

/// Samples of one bit: a row begins with a byte of its own, and one is black.
fn bits(bytes: &[u8], width: usize, height: usize) -> Option<Samples> {
    let stride = width.div_ceil(8);
    let rows = bytes.get(..stride * height)?.chunks_exact(stride);
    let white = |row: &[u8], x: usize| 1 - ((row[x / 8] >> (7 - x % 8)) & 1);
    let samples = rows.flat_map(|row| (0..width).map(move |x| white(row, x)));
    Some(Samples::Bytes(samples.collect()))
}

/// Words between spaces; a comment goes from `#` to the end of its line.
struct Words<'a> {
    rest: &'a [u8],
}

impl<'a> Words<'a> {
    fn skip_spaces(&mut self) {
        while let Some((first, rest)) = self.rest.split_first() {
            match first {
                b'#' => {
                    let end = rest.iter().position(|c| matches!(c, b'\n' | b'\r'));
                    self.rest = &rest[end.unwrap_or(rest.len())..];
                }
                c if c.is_ascii_whitespace() => self.rest = rest,
                _ => break,
            }
        }
    }

    fn number(&mut self) -> Option<usize> {
        self.skip_spaces();
        let end = self.rest.iter().position(|c| !c.is_ascii_digit());
        let (digits, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        self.rest = rest;
        std::str::from_utf8(digits).ok()?.parse().ok()
    }

    /// Samples as numbers. Behind the last there must be something: otherwise a digit of it may be
    /// missing.
    fn samples(&mut self, count: usize, white: u16) -> Option<Samples> {
        let mut next = || {
            let value = u16::try_from(self.number()?).ok()?;
            (value <= white && !self.rest.is_empty()).then_some(value)
        };
        let words = (0..count).map(|_| next()).collect::<Option<Vec<u16>>>()?;
        if white > 255 {
            return Some(Samples::Words(words));
        }
        Some(Samples::Bytes(words.iter().map(|w| *w as u8).collect()))
    }

    /// Samples of one digit each, with or without spaces; one is black.
    fn digits(&mut self, count: usize) -> Option<Vec<u8>> {
        let mut next = || {
            self.skip_spaces();
            let (first, rest) = self.rest.split_first()?;
            self.rest = rest;
            match first {
                b'0' => Some(1),
                b'1' => Some(0),
                _ => None,
            }
        };
        (0..count).map(|_| next()).collect()
    }

    /// What follows the one space behind the header.
    fn binary(&self) -> Option<&'a [u8]> {
        let (first, rest) = self.rest.split_first()?;
        first.is_ascii_whitespace().then_some(rest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn white_and_samples(bytes: &[u8]) -> (usize, u16, Samples) {
        let raster = decode_pnm(bytes).expect("an image");
        assert_eq!((raster.width, raster.height), (3, 2));
        (raster.channels, raster.white, raster.samples)
    }

    #[test]
    fn every_kind_of_pnm_is_read() {
        let bits = || Samples::Bytes(vec![1, 0, 1, 0, 0, 1]);
        assert_eq!(white_and_samples(b"P1 3 2 010\n1 1 0"), (1, 1, bits()));
        assert_eq!(white_and_samples(b"P4\n3 2\n\x5f\xc0"), (1, 1, bits()));
        let grey = || Samples::Bytes(vec![1, 2, 3, 4, 5, 7]);
        assert_eq!(
            white_and_samples(b"P2 3 2 7 1 2 3#x\n4 5 7\n"),
            (1, 7, grey())
        );
        let binary = b"P5 # a comment\n3 2\r\n#another\n7\n\x01\x02\x03\x04\x05\x07";
        assert_eq!(white_and_samples(binary), (1, 7, grey()));
        let wide = || Samples::Words(vec![1, 2, 3, 4, 5, 700]);
        assert_eq!(
            white_and_samples(b"P2 3 2 700 1 2 3 4 5 700 "),
            (1, 700, wide())
        );
        let binary = b"P5 3 2 700 \0\x01\0\x02\0\x03\0\x04\0\x05\x02\xbc";
        assert_eq!(white_and_samples(binary), (1, 700, wide()));
        assert_eq!(
            white_and_samples(b"P5 3 2 7 \x01\x02\x03\x04\x05\xff"),
            (1, 7, grey())
        );
        let colours = || Samples::Bytes((0..18).collect());
        let text: String = (0..18).map(|k| format!("{k} ")).collect();
        let text = format!("P3 3 2 20 {text}");
        assert_eq!(white_and_samples(text.as_bytes()), (3, 20, colours()));
        let binary: Vec<u8> = b"P6 3 2 20 ".iter().copied().chain(0..18).collect();
        assert_eq!(white_and_samples(&binary), (3, 20, colours()));
    }

    #[test]
    fn pnm_that_is_cut_or_damaged_is_refused() {
        for bytes in [
            &b"P"[..],
            b"P2",
            b"P2 3",
            b"P2 3 2 0 0 0 0 0 0 0 ",
            b"P2 3 2 70000 0 0 0 0 0 0 ",
            b"P2 3 2 7 1 2 3 4 5 8 ",
            b"P2 3 2 7 1 2 3 4 5 7",
            b"P2 3 2 7 1 2 x 4 5 7 ",
            b"P1 3 2 01011",
            b"P1 3 2 010112",
            b"P4 3 2 \x5f",
            b"P5 3 2 7 \x01\x02\x03\x04\x05",
            b"P5 3 2 7",
            b"P5 3 2 700 \0\x01\0\x02\0\x03\0\x04\0\x05\x02",
        ] {
            assert!(decode_pnm(bytes).is_err(), "{}", bytes.escape_ascii());
        }
    }
}
