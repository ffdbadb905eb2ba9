//! Questions to the page of a run on this computer.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// A run that does not answer within this time is gone.
const PATIENCE: Duration = Duration::from_secs(20);
/// An answer is no longer than this, bytes.
const MAX_ANSWER: u64 = 512 << 20;

/// The page of a run.
#[derive(Debug, PartialEq)]
pub struct Page {
    /// Name of the computer and port.
    host: String,
}

impl Page {
    /// The page at an address such as `http://127.0.0.1:8080/`.
    ///
    /// # Errors
    /// An address that is none, in a sentence.
    pub fn at(url: &str) -> Result<Self, String> {
        let host = url.strip_prefix("http://");
        let host = host.map(|rest| rest.trim_end_matches('/'));
        let host = host.filter(|host| host.contains(':') && !host.contains('/'));
        let host = host.map(|host| Self {
            host: host.to_owned(),
        });
        host.ok_or_else(|| {
            format!("{url} is no address of a run, expected http://127.0.0.1:PORT/ as `monogrid run --view` prints it")
        })
    }

    /// The answer to a question (`/live/...`).
    ///
    /// # Errors
    /// No connection, or another answer than the one that was asked for.
    pub fn ask(&self, path: &str) -> io::Result<Vec<u8>> {
        let mut stream = TcpStream::connect(&self.host)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let host = &self.host;
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        )?;
        let mut answer = Vec::new();
        stream.take(MAX_ANSWER).read_to_end(&mut answer)?;
        content(answer)
    }
}

/// The content of an answer.
fn content(mut answer: Vec<u8>) -> io::Result<Vec<u8>> {
    let refused = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
    let head = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n");
    let head = head.ok_or_else(|| refused("an answer without an end of its head"))?;
    let content = answer.split_off(head + 4);
    let head = String::from_utf8_lossy(&answer);
    let mut lines = head.lines();
    let status = lines.next().unwrap_or_default();
    if status.split_whitespace().nth(1) != Some("200") {
        return Err(refused(status));
    }
    let length = lines.find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("content-length")
            .then(|| value.trim().parse::<usize>().ok())?
    });
    match length {
        Some(length) if length != content.len() => Err(refused("an answer that is not whole")),
        _ => Ok(content),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_those_that_a_run_prints() {
        let page = Page::at("http://127.0.0.1:8080/");
        assert_eq!(
            page,
            Ok(Page {
                host: "127.0.0.1:8080".into()
            })
        );
        for wrong in [
            "",
            "video.mp4",
            "https://127.0.0.1:1/",
            "http://127.0.0.1/",
            "http://a:1/b",
        ] {
            assert!(
                Page::at(wrong).is_err_and(|said| said.contains("expected")),
                "{wrong}"
            );
        }
    }

    #[test]
    fn answers_are_whole_or_none() {
        let answer = |text: &str| content(text.as_bytes().to_vec());
        let head = "HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n";
        assert_eq!(answer(&format!("{head}{{}}")).unwrap(), b"{}");
        assert!(answer(&format!("{head}{{")).is_err(), "cut");
        assert!(answer("HTTP/1.1 404 Not Found\r\n\r\n").is_err());
        assert!(answer("HTTP/1.1 200 OK\r\n").is_err());
    }
}
