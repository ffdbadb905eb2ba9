//! MJPEG over HTTP (`multipart/x-mixed-replace`): what apps that make a phone a camera serve.

use crate::error::endless_header;
use crate::turn::Turn;
use crate::{Opened, VideoError, VideoFrame, jpeg_frame};
use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// How long a server may be silent.
const TIMEOUT: Duration = Duration::from_secs(10);

/// Longest line of a header, bytes.
const MAX_LINE: u64 = 8192;

/// Most lines of a header.
const MAX_LINES: usize = 100;

/// Longest image, bytes.
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
    let mut stream = connect(&target).map_err(io)?;
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
    Ok(Some(Opened {
        description: "MJPEG over HTTP".to_owned(),
        length: None,
        live: true,
        turn: Turn::None,
        frames: Box::new(MjpegFrames {
            name: address.to_owned(),
            reader,
            begin: Instant::now(),
            frame: 0,
        }),
    }))
}

fn connect(target: &str) -> std::io::Result<TcpStream> {
    let no_host = || Error::new(ErrorKind::AddrNotAvailable, "no such host");
    let address = target.to_socket_addrs()?.next().ok_or_else(no_host)?;
    let stream = TcpStream::connect_timeout(&address, TIMEOUT)?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.set_write_timeout(Some(TIMEOUT))?;
    Ok(stream)
}

/// The lines up to the first empty one.
fn read_header(reader: &mut impl BufRead) -> std::io::Result<Vec<String>> {
    let mut lines = Vec::new();
    while lines.len() < MAX_LINES {
        let mut line = Vec::new();
        let mut limited = reader.by_ref().take(MAX_LINE);
        if limited.read_until(b'\n', &mut line)? == 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        let line = String::from_utf8_lossy(&line).trim().to_owned();
        if line.is_empty() {
            return Ok(lines);
        }
        lines.push(line);
    }
    Err(endless_header())
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

impl<R: BufRead> MjpegFrames<R> {
    /// The bytes of the next image: of the length in its header, or up to the JPEG's end marker.
    fn next_image(&mut self) -> std::io::Result<Vec<u8>> {
        // the boundary may stand alone or as the first line of a header
        let mut header = read_header(&mut self.reader)?;
        while value(&header, "content-type").is_none() {
            header = read_header(&mut self.reader)?;
        }
        let mut image = Vec::new();
        let length: Option<u64> = value(&header, "content-length").and_then(|v| v.parse().ok());
        match length {
            Some(bytes) if bytes <= MAX_IMAGE_BYTES => {
                self.reader.by_ref().take(bytes).read_to_end(&mut image)?;
                if (image.len() as u64) < bytes {
                    return Err(ErrorKind::UnexpectedEof.into());
                }
            }
            _ => self.read_to_end_marker(&mut image)?,
        }
        Ok(image)
    }

    fn read_to_end_marker(&mut self, image: &mut Vec<u8>) -> std::io::Result<()> {
        while !image.ends_with(&[0xff, 0xd9]) {
            let left = MAX_IMAGE_BYTES.saturating_sub(image.len() as u64);
            if self.reader.by_ref().take(left).read_until(0xd9, image)? == 0 {
                return Err(ErrorKind::UnexpectedEof.into());
            }
        }
        Ok(())
    }
}

impl<R: BufRead> Iterator for MjpegFrames<R> {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        let jpeg = match self.next_image() {
            Ok(jpeg) => jpeg,
            // the server has closed the stream
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => return None,
            Err(e) => return Some(Err(VideoError::io(&self.name, e))),
        };
        let arrival_ns = i64::try_from(self.begin.elapsed().as_nanos()).unwrap_or(i64::MAX);
        self.frame += 1;
        Some(jpeg_frame(&self.name, self.frame - 1, jpeg, arrival_ns))
    }
}
