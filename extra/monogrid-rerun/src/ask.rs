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
    /// What paths of this run begin with: a slash and a word that only those know who may see it.
    token: String,
}

impl Page {
    /// The page at an address such as `http://127.0.0.1:8080/0a1b2c/`.
    ///
    /// # Errors
    /// An address that is none, in a sentence.
    pub fn at(url: &str) -> Result<Self, String> {
        let rest = url.strip_prefix("http://");
        let parts = rest.and_then(|rest| rest.trim_end_matches('/').split_once('/'));
        let parts = parts.filter(|(host, token)| {
            host.contains(':')
                && !token.is_empty()
                && token.bytes().all(|byte| byte.is_ascii_hexdigit())
        });
        let page = parts.map(|(host, token)| Self {
            host: host.to_owned(),
            token: format!("/{token}"),
        });
        page.ok_or_else(|| {
            format!("{url} is no address of a run, expected http://127.0.0.1:PORT/TOKEN/ as \
                `monogrid run --view` prints it")
        })
    }

    /// The answer to a question (`/live/...`).
    ///
    /// # Errors
    /// No connection, or another answer than the one that was asked for.
    pub fn ask(&self, path: &str) -> io::Result<Vec<u8>> {
        let mut stream = TcpStream::connect(&self.host)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        let Self { host, token } = self;
        write!(
            stream,
            "GET {token}{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
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
        let page = Page::at("http://127.0.0.1:8080/0a1b/");
        assert_eq!(
            page,
            Ok(Page {
                host: "127.0.0.1:8080".into(),
                token: "/0a1b".into(),
            })
        );
        for wrong in [
            "",
            "video.mp4",
            "https://127.0.0.1:1/",
            "http://127.0.0.1:1/",
            "http://127.0.0.1:1//",
            "http://127.0.0.1/0a1b/",
            "http://127.0.0.1:1/0a1b/live/",
            "http://127.0.0.1:1/a b/",
        ] {
            assert!(
                Page::at(wrong).is_err_and(|said| said.contains("expected")),
                "{wrong}"
            );
        }
    }

    #[test]
    fn questions_go_below_the_token_of_the_run() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let page = Page::at(&format!("http://{address}/0a1b/")).unwrap();
        let run = std::thread::spawn(move || {
            let mut stream = listener.accept().unwrap().0;
            let mut asked = [0; 200];
            let count = stream.read(&mut asked).unwrap();
            stream
                .write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}")
                .unwrap();
            String::from_utf8_lossy(&asked[..count]).into_owned()
        });
        assert_eq!(page.ask("/live/0/0/1").unwrap(), b"{}");
        let asked = run.join().unwrap();
        let expected = format!("GET /0a1b/live/0/0/1 HTTP/1.1\r\nHost: {address}\r\n");
        assert!(asked.starts_with(&expected), "{asked}");
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
