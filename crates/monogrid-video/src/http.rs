//! MJPEG over HTTP (`multipart/x-mixed-replace`): what apps that make a phone a camera serve.

use crate::VideoError;
use crate::error::endless_header;
use crate::frame::{VideoFrame, jpeg_frame};
use crate::opened::Opened;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Instant;

/// Longest line of a header, bytes.
const MAX_LINE: u64 = 8192;

/// Most lines of a header.
const MAX_LINES: usize = 100;

/// Longest image, bytes: 32 MiB.
const MAX_IMAGE_BYTES: u64 = 1 << 25;

/// Asks for a stream; `None` when the server answers with something else than MJPEG.
pub(crate) fn open(address: &str) -> Result<Option<Opened>, VideoError> {
    let io = |e| VideoError::Io {
        video: address.to_owned(),
        source: e,
    };
    let rest = address.strip_prefix("http://").unwrap_or(address);
    let (authority, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
    let host = authority.rsplit('@').next().unwrap_or(authority);
    if host.len() < authority.len() {
        return Ok(None); // a password: left to ffmpeg
    }
    let target = if host.contains(':') {
        host.to_owned()
    } else {
        format!("{host}:80")
    };
    // how long it may take is for those to say who wait for its frames
    let mut stream = TcpStream::connect(&target).map_err(io)?;
    let path = if path.is_empty() { "/" } else { path };
    // 1.0: the answer may not come in chunks
    let request = format!(
        "GET {path} HTTP/1.0\r\nHost: {host}\r\nUser-Agent: monogrid\r\nAccept: */*\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).map_err(io)?;
    let mut reader = BufReader::with_capacity(1 << 16, stream);
    let header = read_header(&mut reader).map_err(io)?;
    let status = header.first().map(String::as_str).unwrap_or_default();
    if status.split_whitespace().nth(1) != Some("200") {
        let found = format!("the answer {status:?}");
        let expected = "200 and images";
        return Err(VideoError::content(address, "stream", found, expected));
    }
    if !value(&header, "content-type").is_some_and(|v| v.starts_with("multipart/")) {
        return Ok(None);
    }
    let frames = MjpegFrames {
        name: address.to_owned(),
        reader,
        begin: Instant::now(),
        frame: 0,
    };
    Ok(Some(Opened {
        live: true,
        ..Opened::new("MJPEG over HTTP", Box::new(frames))
    }))
}

/// The lines up to the first empty one.
fn read_header(reader: &mut impl BufRead) -> std::io::Result<Vec<String>> {
    let mut lines = Vec::new();
    while lines.len() < MAX_LINES {
        let (line, is_whole) = read_line(reader)?;
        if !is_whole {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        if line.is_empty() {
            return Ok(lines);
        }
        lines.push(line);
    }
    Err(endless_header())
}

/// A line without the space around it, or the beginning of a very long one; and whether the stream
/// goes on after it.
fn read_line(reader: &mut impl BufRead) -> std::io::Result<(String, bool)> {
    let mut line = Vec::new();
    reader.take(MAX_LINE).read_until(b'\n', &mut line)?;
    let is_whole = line.ends_with(b"\n") || line.len() as u64 == MAX_LINE;
    Ok((String::from_utf8_lossy(&line).trim().to_owned(), is_whole))
}

/// The value of a header line, in lower case.
fn value(header: &[String], key: &str) -> Option<String> {
    header.iter().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        (name.trim().eq_ignore_ascii_case(key)).then(|| value.trim().to_ascii_lowercase())
    })
}

struct MjpegFrames<R> {
    name: String,
    reader: R,
    begin: Instant,
    frame: usize,
}

/// What follows in a stream.
enum Next {
    Image(Vec<u8>),
    /// The server has closed the stream between two images.
    End,
    /// Why there can be no more.
    Broken(String),
}

impl Next {
    fn cut() -> Self {
        let reason = "the connection was cut within an image, expected an end between two images";
        Self::Broken(reason.to_owned())
    }

    fn too_large(found: &str) -> Self {
        Self::Broken(format!(
            "found an image of {found} bytes, expected at most {MAX_IMAGE_BYTES} (32 MiB)"
        ))
    }
}

impl<R: BufRead> MjpegFrames<R> {
    /// The bytes of the next image: of the length in its header, or up to the JPEG's end marker.
    fn next_image(&mut self) -> std::io::Result<Next> {
        let Some(header) = self.part_header()? else {
            return Ok(Next::End);
        };
        let mut image = Vec::new();
        let length = value(&header, "content-length");
        let is_number = |text: &String| text.bytes().all(|b| b.is_ascii_digit());
        match length.filter(|text| !text.is_empty() && is_number(text)) {
            Some(length) => match length.parse() {
                Ok(bytes @ 0..=MAX_IMAGE_BYTES) => {
                    self.reader.by_ref().take(bytes).read_to_end(&mut image)?;
                    if (image.len() as u64) < bytes {
                        return Ok(Next::cut());
                    }
                }
                _ => return Ok(Next::too_large(&length)),
            },
            None => {
                while !image.ends_with(&[0xff, 0xd9]) {
                    let left = MAX_IMAGE_BYTES.saturating_sub(image.len() as u64);
                    if left == 0 {
                        return Ok(Next::too_large(&format!("more than {MAX_IMAGE_BYTES}")));
                    }
                    if self
                        .reader
                        .by_ref()
                        .take(left)
                        .read_until(0xd9, &mut image)?
                        == 0
                    {
                        return Ok(Next::cut());
                    }
                }
            }
        }
        Ok(Next::Image(image))
    }

    /// The header of the next image; `None` where the stream ends before one has begun. The
    /// boundary may stand alone, before empty lines or as the first line of a header; all lines
    /// together are counted.
    fn part_header(&mut self) -> std::io::Result<Option<Vec<String>>> {
        let mut header = Vec::new();
        for _ in 0..MAX_LINES {
            let (line, is_whole) = read_line(&mut self.reader)?;
            if !is_whole {
                // after the boundary alone no image has begun
                let is_field = |line: &String| line.contains(':');
                if header.iter().any(is_field) || is_field(&line) {
                    return Err(ErrorKind::UnexpectedEof.into());
                }
                return Ok(None);
            }
            if line.is_empty() && value(&header, "content-type").is_some() {
                return Ok(Some(header));
            }
            header.push(line);
        }
        Err(endless_header())
    }
}

impl<R: BufRead> Iterator for MjpegFrames<R> {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.next_image();
        let broken = |reason| VideoError::BrokeOff {
            video: self.name.clone(),
            frames: self.frame,
            reason,
        };
        let jpeg = match next {
            Ok(Next::Image(jpeg)) => jpeg,
            Ok(Next::End) => return None,
            Ok(Next::Broken(reason)) => return Some(Err(broken(reason))),
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => {
                let reason =
                    "the connection was cut within a header, expected an end between two images";
                return Some(Err(broken(reason.to_owned())));
            }
            Err(e) => return Some(Err(broken(e.to_string()))),
        };
        let arrival_ns = i64::try_from(self.begin.elapsed().as_nanos()).unwrap_or(i64::MAX);
        self.frame += 1;
        Some(jpeg_frame(&self.name, self.frame - 1, jpeg, arrival_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_of_an_answer_has_so_many_lines_and_no_more() {
        let head = |lines: usize| "A: b\r\n".repeat(lines) + "\r\n";
        let most = read_header(&mut head(99).as_bytes());
        assert_eq!(most.map(|lines| lines.len()).ok(), Some(99));
        let error = read_header(&mut head(100).as_bytes()).err();
        assert_eq!(
            error.map(|error| error.to_string()),
            Some(endless_header().to_string())
        );
    }
}
