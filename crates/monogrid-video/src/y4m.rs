//! YUV4MPEG2 (`.y4m`, or a pipe): uncompressed planes behind one line of text each.
//!
//! Only luma is kept. The reader is our own because a pipe may end within a frame, which must be told
//! from the end, and because the size in the header comes from outside.

use crate::{Grey, MAX_PIXELS, VideoError, VideoFrame};
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
    /// Bits of a sample; more than 8 take two bytes, little endian.
    bits: u32,
    /// Bytes of the planes that follow luma.
    rest_bytes: u64,
    /// Frames per second: numerator and denominator.
    rate: (u64, u64),
}

/// Frames of a YUV4MPEG2 stream.
pub(crate) struct Y4mReader<R> {
    name: String,
    reader: R,
    layout: Layout,
    frame: usize,
    ended: bool,
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
            ended: false,
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
        let luma = self.read_luma().map_err(|e| match e.kind() {
            std::io::ErrorKind::UnexpectedEof => {
                content(&self.name, format!("an end within frame {}", self.frame))
            }
            _ => VideoError::io(&self.name, e),
        })?;
        let (numerator, denominator) = self.layout.rate;
        let nanoseconds =
            self.frame as u128 * u128::from(denominator) * 1_000_000_000 / u128::from(numerator);
        self.frame += 1;
        Ok(Some(VideoFrame {
            image: luma,
            timestamp_ns: i64::try_from(nanoseconds).unwrap_or(i64::MAX),
        }))
    }

    fn read_luma(&mut self) -> std::io::Result<Grey> {
        let Layout {
            width,
            height,
            bits,
            rest_bytes,
            ..
        } = self.layout;
        let mut data = vec![0; width * height * if bits > 8 { 2 } else { 1 }];
        self.reader.read_exact(&mut data)?;
        let skipped = std::io::copy(
            &mut (&mut self.reader).take(rest_bytes),
            &mut std::io::sink(),
        )?;
        if skipped < rest_bytes {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        if bits > 8 {
            data = data
                .chunks_exact(2)
                .map(|pair| (u16::from_le_bytes([pair[0], pair[1]]) >> (bits - 8)).min(255) as u8)
                .collect();
        }
        Grey::from_vec(width, height, data).ok_or_else(|| std::io::ErrorKind::InvalidData.into())
    }
}

impl<R: BufRead> Iterator for Y4mReader<R> {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let outcome = self.read_frame();
        self.ended = !matches!(outcome, Ok(Some(_)));
        outcome.transpose()
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
        return Err(std::io::Error::new(
            std::io::ErrorKind::InvalidData,
            "a header that does not end",
        ));
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
    for word in words {
        let Some(value) = word.get(1..) else { continue };
        match word.as_bytes()[0] {
            b'W' => width = value.parse().unwrap_or(0),
            b'H' => height = value.parse().unwrap_or(0),
            b'F' => rate = parse_rate(value).ok_or_else(|| format!("frame rate {value}"))?,
            b'C' => colour = value,
            _ => {}
        }
    }
    let pixels = usize::checked_mul(width, height).unwrap_or(usize::MAX);
    if pixels == 0 || pixels > MAX_PIXELS {
        return Err(format!("frames of {width}x{height} pixels"));
    }
    let (bits, rest_samples) =
        planes(colour, width, height).ok_or_else(|| format!("colour space {colour}"))?;
    Ok(Layout {
        width,
        height,
        bits,
        rest_bytes: (rest_samples * if bits > 8 { 2 } else { 1 }) as u64,
        rate,
    })
}

/// Frames per second as written (`30000:1001`).
fn parse_rate(text: &str) -> Option<(u64, u64)> {
    let (numerator, denominator) = text.split_once(':')?;
    let rate: (u64, u64) = (numerator.parse().ok()?, denominator.parse().ok()?);
    (rate.0 > 0 && rate.1 > 0).then_some(rate)
}

/// Bits of a sample, and the samples that follow luma, for a colour space as its name is written.
fn planes(colour: &str, width: usize, height: usize) -> Option<(u32, usize)> {
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let subsampling = [
        ("mono", 0),
        ("420", 2 * half_width * half_height),
        ("422", 2 * half_width * height),
        ("444alpha", 3 * width * height),
        ("444", 2 * width * height),
        ("411", 2 * width.div_ceil(4) * height),
    ];
    let (name, rest) = subsampling
        .into_iter()
        .find(|(name, _)| colour.starts_with(name))?;
    let suffix = &colour[name.len()..];
    let bits = match suffix.strip_prefix('p').unwrap_or(suffix) {
        "" | "jpeg" | "mpeg2" | "aldv" => 8,
        depth => depth.parse().ok().filter(|bits| (9..=16).contains(bits))?,
    };
    Some((bits, rest))
}

#[cfg(test)]
mod tests {
    use super::{Y4mReader, parse_header, planes};

    #[test]
    fn colour_spaces_as_ffmpeg_names_them() {
        assert_eq!(planes("420jpeg", 5, 3), Some((8, 12)));
        assert_eq!(planes("420paldv", 4, 4), Some((8, 8)));
        assert_eq!(planes("422p10", 5, 3), Some((10, 18)));
        assert_eq!(planes("mono", 5, 3), Some((8, 0)));
        assert_eq!(planes("mono16", 5, 3), Some((16, 0)));
        assert_eq!(planes("444alpha", 2, 2), Some((8, 12)));
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
    fn an_end_within_a_frame_is_not_the_end() {
        let stream = b"YUV4MPEG2 W2 H2 F1:1 Cmono\nFRAME\nabcdFRAME\nab";
        let mut reader = Y4mReader::new("-", stream.as_slice()).unwrap();
        assert_eq!(reader.next().unwrap().unwrap().image.as_slice(), b"abcd");
        assert!(reader.next().unwrap().is_err());
        assert!(reader.next().is_none());
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
