//! YUV4MPEG2 (`.y4m`, or a pipe): uncompressed planes behind one line of text each.
//!
//! The reader is our own because a pipe may end within a frame, which must be told
//! from the end, and because the size in the header comes from outside.

use crate::error::endless_header;
use crate::frame::{Grey, MAX_PIXELS, VideoFrame, time_at_rate};
use crate::pixels::PixelShape;
use crate::turn::Turn;
use crate::{Chroma, Colour, ColourSpace, VideoError};
use std::io::{BufRead, Read};

/// First bytes of every such stream.
pub(crate) const MAGIC: &[u8] = b"YUV4MPEG2";

/// Longest header of a stream or frame, bytes.
const MAX_LINE: u64 = 4096;

/// How the samples of one frame lie in the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Layout {
    width: usize,
    height: usize,
    planes: Planes,
    has_full_range: bool,
    /// Frames per second: numerator and denominator.
    rate: (u64, u64),
    pixels: PixelShape,
    fields: Fields,
}

/// Whether a frame is made of two fields, taken one after the other.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fields {
    None,
    /// The first one has the first, third ... row.
    TopFirst,
    BottomFirst,
    /// Each frame says it.
    Mixed,
}

impl Fields {
    /// As the header of a stream, or the first letter of a frame's, says it.
    fn of(word: &str) -> Self {
        match word.as_bytes().first() {
            Some(b't' | b'T') => Self::TopFirst,
            Some(b'b' | b'B') => Self::BottomFirst,
            Some(b'm') => Self::Mixed,
            _ => Self::None,
        }
    }

    /// Those of one frame, by its line.
    fn of_frame(self, line: &[u8]) -> Self {
        if self != Self::Mixed {
            return self;
        }
        let text = String::from_utf8_lossy(line);
        let own = text.split(' ').find_map(|word| word.strip_prefix('I'));
        own.map_or(Self::None, Self::of)
    }

    /// The first field alone, with rows between its own: the second was taken later.
    fn first(self, mut image: Grey) -> Grey {
        let from = match self {
            Self::None | Self::Mixed => return image,
            Self::TopFirst => 1,
            Self::BottomFirst => 0,
        };
        let height = image.height();
        for y in (from..height).step_by(2) {
            let above = if y == 0 { 1.min(height - 1) } else { y - 1 };
            let below = if y + 1 < height { y + 1 } else { above };
            for x in 0..image.width() {
                let mean = u16::from(image.at(x, above)).midpoint(image.at(x, below).into());
                image.set(x, y, mean as u8);
            }
        }
        image
    }
}

/// What samples a frame has.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Planes {
    /// Bits of a sample; more than 8 take two bytes, little endian.
    bits: u32,
    /// Width and height of the two planes of colour differences, where there are any.
    chroma: Option<(usize, usize)>,
    /// Whether one more plane of the size of luma follows.
    has_alpha: bool,
}

/// Frames of a YUV4MPEG2 stream, up to the first error.
pub(crate) struct Y4mReader<R> {
    name: String,
    reader: R,
    layout: Layout,
    frame: usize,
}

impl<R: BufRead> Y4mReader<R> {
    /// Reads the header.
    pub(crate) fn new(name: &str, mut reader: R) -> Result<Self, VideoError> {
        let line = read_line(&mut reader)
            .map_err(|e| VideoError::io(name, e))?
            .ok_or_else(|| content(name, "an empty stream"))?;
        let layout = parse_header(&line).map_err(|found| content(name, found))?;
        Ok(Self {
            name: name.to_owned(),
            reader,
            layout,
            frame: 0,
        })
    }

    fn read_frame(&mut self) -> Result<Option<VideoFrame>, VideoError> {
        let io = |e| VideoError::io(&self.name, e);
        let Some(line) = read_line(&mut self.reader).map_err(io)? else {
            return Ok(None);
        };
        if !line.starts_with(b"FRAME") {
            return Err(content(&self.name, "a frame without FRAME in front"));
        }
        let fields = self.layout.fields.of_frame(&line);
        let planes = self.read_planes().map_err(|e| match e.kind() {
            std::io::ErrorKind::UnexpectedEof => {
                content(&self.name, format!("an end within frame {}", self.frame))
            }
            _ => VideoError::io(&self.name, e),
        });
        let (image, colour) = planes?;
        let timestamp_ns = time_at_rate(self.frame, self.layout.rate);
        self.frame += 1;
        Ok(Some(VideoFrame {
            image: fields.first(image),
            colour,
            timestamp_ns,
        }))
    }

    /// Takes frames as they are, whatever the header says: for who has deinterlaced them.
    pub(crate) fn with_whole_frames(mut self) -> Self {
        self.layout.fields = Fields::None;
        self
    }

    /// The shape of the pixels.
    pub(crate) fn pixels(&self) -> PixelShape {
        self.layout.pixels
    }

    /// What is done about the way the frames were taken, for people.
    pub(crate) fn note(&self) -> Option<String> {
        let is_interlaced = self.layout.fields != Fields::None;
        is_interlaced.then(|| {
            "the stream is interlaced: of each frame the first field is used, with rows between \
             its own"
                .to_owned()
        })
    }

    fn read_planes(&mut self) -> std::io::Result<(Grey, Colour)> {
        let Layout { width, height, .. } = self.layout;
        let luma = self.read_plane((width, height))?;
        let mut colour = Colour::Grey;
        if let Some(size) = self.layout.planes.chroma {
            let space = ColourSpace::usual(height, self.layout.has_full_range);
            let planes = [self.read_plane(size)?, self.read_plane(size)?];
            let planes = planes.each_ref().map(Vec::as_slice);
            let chroma = Chroma::new(planes, size, space, Turn::None);
            colour = chroma.map_or(Colour::Grey, Colour::Chroma);
        }
        if self.layout.planes.has_alpha {
            self.read_plane((width, height))?;
        }
        let image = Grey::from_vec(width, height, luma);
        Ok((image.ok_or(std::io::ErrorKind::InvalidData)?, colour))
    }

    /// A plane of this size in 8 bits.
    fn read_plane(&mut self, (width, height): (usize, usize)) -> std::io::Result<Vec<u8>> {
        let bits = self.layout.planes.bits;
        let mut data = vec![0; width * height * if bits > 8 { 2 } else { 1 }];
        self.reader.read_exact(&mut data)?;
        Ok(in_bytes(data, bits))
    }
}

/// Samples in 8 bits; those of more are two bytes each (little endian).
pub(crate) fn in_bytes(samples: Vec<u8>, bits: u32) -> Vec<u8> {
    if bits == 8 {
        return samples;
    }
    let sample = |pair: &[u8]| u16::from_le_bytes([pair[0], pair[1]]) >> (bits - 8);
    let pairs = samples.chunks_exact(2);
    pairs.map(|pair| sample(pair).min(255) as u8).collect()
}

impl<R: BufRead> Iterator for Y4mReader<R> {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read_frame().transpose()
    }
}

fn content(name: &str, found: impl Into<String>) -> VideoError {
    VideoError::content(
        name,
        "YUV4MPEG2 stream",
        found,
        "what `ffmpeg -i VIDEO -f yuv4mpegpipe -` writes",
    )
}

/// One line without its end; `None` at the end of the stream.
fn read_line(reader: &mut impl BufRead) -> std::io::Result<Option<Vec<u8>>> {
    let mut line = Vec::new();
    if reader.take(MAX_LINE).read_until(b'\n', &mut line)? == 0 {
        return Ok(None);
    }
    if line.pop() != Some(b'\n') {
        return Err(endless_header());
    }
    Ok(Some(line))
}

/// Parses `YUV4MPEG2 W640 H480 F30:1 C420jpeg ...`.
fn parse_header(line: &[u8]) -> Result<Layout, String> {
    let text = String::from_utf8_lossy(line);
    let mut words = text.split(' ').filter(|w| !w.is_empty());
    if words.next().map(str::as_bytes) != Some(MAGIC) {
        return Err("another beginning".to_owned());
    }
    let (mut width, mut height, mut rate, mut colour) = (0, 0, (25, 1), "420");
    let mut has_full_range = false;
    let (mut pixels, mut fields) = (PixelShape::SQUARE, Fields::None);
    for word in words {
        let Some(value) = word.get(1..) else { continue };
        match word.as_bytes()[0] {
            b'W' => width = value.parse().unwrap_or(0),
            b'H' => height = value.parse().unwrap_or(0),
            b'F' => rate = parse_rate(value).ok_or_else(|| format!("frame rate {value}"))?,
            b'C' => colour = value,
            b'A' => pixels = PixelShape::parse(value).unwrap_or(pixels),
            b'I' => fields = Fields::of(value),
            b'X' if value == "COLORRANGE=FULL" => has_full_range = true,
            _ => {}
        }
    }
    let area = usize::checked_mul(width, height).unwrap_or(usize::MAX);
    if area == 0 || area > MAX_PIXELS {
        return Err(format!("frames of {width}x{height} pixels"));
    }
    let planes =
        Planes::of(colour, width, height).ok_or_else(|| format!("colour space {colour}"))?;
    Ok(Layout {
        width,
        height,
        planes,
        has_full_range,
        rate,
        pixels,
        fields,
    })
}

/// Frames per second as written (`30000:1001`).
fn parse_rate(text: &str) -> Option<(u64, u64)> {
    let (numerator, denominator) = text.split_once(':')?;
    let rate: (u64, u64) = (numerator.parse().ok()?, denominator.parse().ok()?);
    (rate.0 > 0 && rate.1 > 0).then_some(rate)
}

impl Planes {
    /// Those of a colour space as its name is written.
    fn of(colour: &str, width: usize, height: usize) -> Option<Self> {
        let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
        let subsampling = [
            ("mono", None),
            ("420", Some((half_width, half_height))),
            ("422", Some((half_width, height))),
            ("444alpha", Some((width, height))),
            ("444", Some((width, height))),
            ("411", Some((width.div_ceil(4), height))),
        ];
        let (name, chroma) = subsampling
            .into_iter()
            .find(|(name, _)| colour.starts_with(name))?;
        let suffix = &colour[name.len()..];
        let bits = match suffix.strip_prefix('p').unwrap_or(suffix) {
            "" | "jpeg" | "mpeg2" | "aldv" => 8,
            depth => depth.parse().ok().filter(|bits| (9..=16).contains(bits))?,
        };
        Some(Self {
            bits,
            chroma,
            has_alpha: name == "444alpha",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Planes, Y4mReader, parse_header};
    use crate::pixels::PixelShape;

    #[test]
    fn colour_spaces_as_ffmpeg_names_them() {
        let planes = |name, width, height| {
            let planes = Planes::of(name, width, height)?;
            Some((planes.bits, planes.chroma, planes.has_alpha))
        };
        assert_eq!(planes("420jpeg", 5, 3), Some((8, Some((3, 2)), false)));
        assert_eq!(planes("420paldv", 4, 4), Some((8, Some((2, 2)), false)));
        assert_eq!(planes("422p10", 5, 3), Some((10, Some((3, 3)), false)));
        assert_eq!(planes("mono", 5, 3), Some((8, None, false)));
        assert_eq!(planes("mono16", 5, 3), Some((16, None, false)));
        assert_eq!(planes("444alpha", 2, 2), Some((8, Some((2, 2)), true)));
        assert_eq!(planes("rgb", 2, 2), None);
    }

    #[test]
    fn luma_and_times() {
        let mut stream = b"YUV4MPEG2 W2 H2 F30000:1001 Ip A1:1 C420p10\n".to_vec();
        for first in [4u16, 1023] {
            stream.extend_from_slice(b"FRAME\n");
            for sample in [first, 8, 12, 16, 512, 512] {
                stream.extend_from_slice(&sample.to_le_bytes());
            }
        }
        let frames: Vec<_> = Y4mReader::new("-", stream.as_slice())
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(frames.len(), 2);
        assert_eq!(frames[0].image.as_slice(), [1, 2, 3, 4]);
        assert_eq!(frames[1].image.as_slice(), [255, 2, 3, 4]);
        assert_eq!(frames[1].timestamp_ns, 33_366_666);
    }

    #[test]
    fn of_two_fields_the_first_is_used() {
        let image = |header: &str, frame: &str| {
            let stream = format!("YUV4MPEG2 W1 H5 F1:1 {header} Cmono\nFRAME{frame}\nabcde");
            let mut reader = Y4mReader::new("-", stream.as_bytes()).unwrap();
            let is_said = reader.note().is_some();
            let image = reader.next().unwrap().unwrap().image;
            (
                String::from_utf8(image.as_slice().to_vec()).unwrap(),
                is_said,
            )
        };
        assert_eq!(image("Ip", ""), ("abcde".to_owned(), false));
        assert_eq!(image("", ""), ("abcde".to_owned(), false));
        assert_eq!(image("It", ""), ("abcde".to_owned(), true));
        assert_eq!(image("Ib", ""), ("bbcdd".to_owned(), true));
        assert_eq!(image("Im", " Ipp"), ("abcde".to_owned(), true));
        assert_eq!(image("Im", " Ibi"), ("bbcdd".to_owned(), true));
        // rows of the second field are the means of those around them
        let stream = b"YUV4MPEG2 W1 H4 F1:1 It Cmono\nFRAME\n\x0a\xff\x14\xff";
        let mut reader = Y4mReader::new("-", stream.as_slice()).unwrap();
        assert_eq!(
            reader.next().unwrap().unwrap().image.as_slice(),
            [10, 15, 20, 20]
        );
    }

    #[test]
    fn the_shape_of_pixels_is_read() {
        let pixels = |header: &str| parse_header(header.as_bytes()).unwrap().pixels;
        assert_eq!(pixels("YUV4MPEG2 W4 H4 A4:3"), PixelShape::new(4, 3));
        assert_eq!(pixels("YUV4MPEG2 W4 H4 A0:0"), PixelShape::SQUARE);
        assert_eq!(pixels("YUV4MPEG2 W4 H4"), PixelShape::SQUARE);
    }

    #[test]
    fn an_end_within_a_frame_is_not_the_end() {
        let stream = b"YUV4MPEG2 W2 H2 F1:1 Cmono\nFRAME\nabcdFRAME\nab";
        let mut reader = Y4mReader::new("-", stream.as_slice()).unwrap();
        assert_eq!(reader.next().unwrap().unwrap().image.as_slice(), b"abcd");
        assert!(reader.next().unwrap().is_err());
    }

    #[test]
    fn sizes_that_cannot_be() {
        for header in [
            "YUV4MPEG2 W0 H2",
            "YUV4MPEG2 W18446744073709551615 H2",
            "YUV4MPEG2 W4294967296 H4294967296",
            "YUV4MPEG2 W2 H2 F0:1",
            "YUV4MPEG3 W2 H2",
        ] {
            assert!(parse_header(header.as_bytes()).is_err(), "{header}");
        }
    }
}
