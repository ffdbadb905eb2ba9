//! AVI with MJPEG: what many webcams and microscopes record.
//!
//! The frames are the chunks `##dc` and `##db` of the video stream in the lists `movi` (several
//! RIFF parts where the file is longer than 1 GiB), each a JPEG image. An empty chunk says that the
//! frame before is shown again; it only counts for the time.

use crate::VideoError;
use crate::frame::{VideoFrame, jpeg_frame, time_at_rate};
use crate::opened::{Elsewhere, Here, Opened};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

/// Longest header list and longest frame that are read, bytes.
const MAX_CHUNK_BYTES: u32 = 1 << 26;

/// Chunks without a frame in a row after which the file is taken for damaged.
const MAX_OTHER_CHUNKS: usize = 100_000;

/// What the headers say about the video stream.
#[derive(Debug, PartialEq)]
struct Stream {
    number: u8,
    codec: [u8; 4],
    /// Frames per second: numerator and denominator.
    rate: (u64, u64),
    frames: u32,
}

pub(crate) fn open(name: &str, file: File) -> Result<Here, VideoError> {
    let mut reader = BufReader::new(file);
    let io = |e| VideoError::io(name, e);
    reader.seek(SeekFrom::Start(12)).map_err(io)?;
    let damaged = |found: &str| VideoError::content(name, "AVI", found, "a complete file");
    let (kind, bytes) = read_head(&mut reader)
        .map_err(io)?
        .ok_or_else(|| damaged("no headers"))?;
    if &kind != b"LIST" || bytes > MAX_CHUNK_BYTES {
        return Err(damaged("no list of headers"));
    }
    let mut headers = Vec::new();
    (&mut reader)
        .take(padded(bytes))
        .read_to_end(&mut headers)
        .map_err(io)?;
    let stream = find_stream(&headers).ok_or_else(|| damaged("no video stream"))?;
    if !stream.codec.eq_ignore_ascii_case(b"MJPG") {
        let codec = String::from_utf8_lossy(&stream.codec).into_owned();
        return Ok(Err(Elsewhere::new(format!("AVI, codec {codec:?}"))));
    }
    let length = Some(stream.frames as usize).filter(|&frames| frames > 0);
    let frames = AviFrames {
        name: name.to_owned(),
        reader,
        stream,
        frame: 0,
    };
    Ok(Ok(Opened {
        length,
        ..Opened::new("AVI, MJPEG", Box::new(frames))
    }))
}

/// Kind and length of the next chunk; `None` at the end of the file.
fn read_head(reader: &mut impl Read) -> std::io::Result<Option<([u8; 4], u32)>> {
    let mut head = [0; 8];
    match reader.read_exact(&mut head) {
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Ok(None),
        Err(e) => Err(e),
        Ok(()) => Ok(split_head(&head).map(|(kind, bytes, _)| (kind, bytes))),
    }
}

/// Kind, length and what follows.
fn split_head(bytes: &[u8]) -> Option<([u8; 4], u32, &[u8])> {
    let (kind, rest) = bytes.split_first_chunk::<4>()?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    Some((*kind, u32::from_le_bytes(*length), rest))
}

/// Chunks begin at even positions.
fn padded(bytes: u32) -> u64 {
    u64::from(bytes) + u64::from(bytes % 2)
}

/// The chunks in the content of a list.
fn chunks(mut content: &[u8]) -> impl Iterator<Item = ([u8; 4], &[u8])> {
    std::iter::from_fn(move || {
        let (kind, bytes, rest) = split_head(content)?;
        let payload = rest.get(..bytes as usize)?;
        content = rest.get(padded(bytes) as usize..).unwrap_or(&[]);
        Some((kind, payload))
    })
}

/// The first video stream in `hdrl`: a list `strl` with `strh` (kind, codec, rate) and `strf`
/// (bitmap).
fn find_stream(headers: &[u8]) -> Option<Stream> {
    let lists = chunks(headers.strip_prefix(b"hdrl")?)
        .filter(|(kind, _)| kind == b"LIST")
        .filter_map(|(_, list)| list.strip_prefix(b"strl"));
    let video = |(number, list): (usize, _)| {
        let find = |wanted| chunks(list).find(|(kind, _)| kind == wanted).map(|c| c.1);
        let (header, bitmap) = (find(b"strh")?, find(b"strf")?);
        header
            .starts_with(b"vids")
            .then_some((number, header, bitmap))
    };
    let (number, header, bitmap) = lists.enumerate().find_map(video)?;
    let number_at = |offset: usize| {
        let bytes = header.get(offset..offset + 4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    };
    let (scale, rate) = (number_at(20)?, number_at(24)?);
    let stream = Stream {
        number: u8::try_from(number).ok()?,
        codec: bitmap.get(16..20)?.try_into().ok()?,
        rate: (u64::from(rate), u64::from(scale)),
        frames: number_at(32)?,
    };
    (scale > 0 && rate > 0).then_some(stream)
}

struct AviFrames {
    name: String,
    reader: BufReader<File>,
    stream: Stream,
    /// Frames so far, empty ones too.
    frame: usize,
}

impl AviFrames {
    /// The next chunk of the stream; enters lists, skips the rest.
    fn next_chunk(&mut self) -> std::io::Result<Option<Vec<u8>>> {
        for _ in 0..MAX_OTHER_CHUNKS {
            let Some((kind, bytes)) = read_head(&mut self.reader)? else {
                return Ok(None);
            };
            if matches!(&kind, b"RIFF" | b"LIST") {
                let mut list = [0; 4];
                self.reader.read_exact(&mut list)?;
                if !matches!(&list, b"AVIX" | b"movi" | b"rec ") {
                    self.reader
                        .seek_relative(padded(bytes).saturating_sub(4) as i64)?;
                }
            } else if self.is_frame(kind) && bytes > 0 && bytes <= MAX_CHUNK_BYTES {
                let mut content = Vec::new();
                (&mut self.reader)
                    .take(padded(bytes))
                    .read_to_end(&mut content)?;
                content.truncate(bytes as usize);
                return Ok(Some(content));
            } else {
                self.frame += usize::from(self.is_frame(kind));
                self.reader.seek_relative(padded(bytes) as i64)?;
            }
        }
        Ok(None)
    }

    fn is_frame(&self, kind: [u8; 4]) -> bool {
        let number = self.stream.number;
        kind[..2] == [b'0' + number / 10, b'0' + number % 10] && matches!(&kind[2..], b"dc" | b"db")
    }
}

impl Iterator for AviFrames {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.next_chunk() {
            Ok(content) => content.map(|content| {
                let number = self.frame;
                self.frame += 1;
                let time_ns = time_at_rate(number, self.stream.rate);
                jpeg_frame(&self.name, number, content, time_ns)
            }),
            // a file that was cut short ends there
            Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => None,
            Err(e) => Some(Err(VideoError::io(&self.name, e))),
        }
    }
}
