//! One connection: one request, one answer, and the end.

use super::{Answer, Limits};
use httparse::{EMPTY_HEADER, Error, Request, Status};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Bytes of a request at most; what a browser sends for a page of this computer is a tenth of it.
const MAX_HEAD: usize = 8 << 10;
/// Header lines of a request at most.
const MAX_HEADERS: usize = 64;
/// Bytes that are written at once: the time that is left is looked at in between.
const PIECE: usize = 64 << 10;

/// Makes answers, from the path below the address.
pub type Answers = Mutex<Box<dyn FnMut(&str) -> Option<Answer> + Send>>;

/// What is served, and to whom.
#[derive(Debug)]
pub struct Site {
    pub address: SocketAddr,
    /// What the path of a request begins with; `None` where everybody may ask.
    pub token: Option<String>,
    pub limits: Limits,
}

/// What the server and the thread of a connection share.
#[derive(Debug)]
struct Line {
    stream: TcpStream,
    /// Whether it is of somebody who knows the address.
    has_asked: AtomicBool,
    is_shut: AtomicBool,
}

/// A connection, as the server sees it.
#[derive(Debug)]
pub struct Connection {
    line: Arc<Line>,
    thread: JoinHandle<()>,
}

impl Connection {
    /// Begins to talk on a thread of its own.
    pub fn begin(stream: TcpStream, site: &Arc<Site>, answers: &Arc<Answers>) -> io::Result<Self> {
        // on some systems a connection inherits from its listener that nobody waits for it
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        let line = Arc::new(Line {
            stream,
            has_asked: AtomicBool::new(false),
            is_shut: AtomicBool::new(false),
        });
        let talk = {
            let (line, site, answers) = (Arc::clone(&line), Arc::clone(site), Arc::clone(answers));
            // a client that has gone or takes too long does not matter
            move || drop(line.talk(&site, &answers))
        };
        let thread = Builder::new()
            .name("viewer-client".to_owned())
            .spawn(talk)?;
        Ok(Self { line, thread })
    }

    /// Whether a request of somebody who knows the address has come.
    pub fn has_asked(&self) -> bool {
        self.line.has_asked.load(Ordering::Relaxed)
    }

    /// Ends it as soon as its thread looks; that does not wait for the client.
    pub fn shut(&self) {
        self.line.is_shut.store(true, Ordering::Relaxed);
        let _ = self.line.stream.shutdown(Shutdown::Both);
    }

    pub fn is_shut(&self) -> bool {
        self.line.is_shut.load(Ordering::Relaxed)
    }

    pub fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Waits for its thread.
    pub fn join(self) -> thread::Result<()> {
        self.thread.join()
    }
}

impl Line {
    fn talk(&self, site: &Site, answers: &Answers) -> io::Result<()> {
        let until = |limit| Timed {
            stream: &self.stream,
            end: Instant::now() + limit,
        };
        let limits = &site.limits;
        let answer = match self.question(site, until(limits.ask))? {
            Ok(path) => self.answer(answers, &path).ok_or("404 Not Found"),
            Err(status) => Err(status),
        };
        let answer = answer.unwrap_or_else(Answer::nothing);
        answer.write(&mut until(limits.answer))?;
        self.stream.shutdown(Shutdown::Write)?;
        // A connection that is closed with bytes unread is reset, and the answer may be lost. What
        // still comes goes into a small buffer and nowhere else.
        let (mut rest, mut unread) = (until(limits.close), [0; 4 << 10]);
        while rest.read(&mut unread)? > 0 {}
        Ok(())
    }

    /// The path that is asked for, or the status of a refusal.
    fn question(&self, site: &Site, mut timed: Timed) -> io::Result<Result<String, &'static str>> {
        let (mut head, mut filled) = ([0; MAX_HEAD], 0);
        loop {
            match timed.read(&mut head[filled..]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => filled += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            }
            if let Some(question) = site.question(&head[..filled]) {
                self.has_asked.store(question.is_ok(), Ordering::Relaxed);
                return Ok(question);
            }
            if filled == MAX_HEAD {
                return Ok(Err(TOO_LARGE));
            }
        }
    }

    /// Waits for its turn; nobody needs the answer to a connection that was shut meanwhile.
    fn answer(&self, answers: &Answers, path: &str) -> Option<Answer> {
        let mut answers = answers.lock().unwrap_or_else(PoisonError::into_inner);
        let is_shut = self.is_shut.load(Ordering::Relaxed);
        if is_shut { None } else { answers(path) }
    }
}

const TOO_LARGE: &str = "431 Request Header Fields Too Large";

impl Site {
    /// The path that is asked for, or the status of a refusal; nothing before the head of the
    /// request is whole.
    fn question(&self, bytes: &[u8]) -> Option<Result<String, &'static str>> {
        let mut headers = [EMPTY_HEADER; MAX_HEADERS];
        let mut request = Request::new(&mut headers);
        match request.parse(bytes) {
            Ok(Status::Complete(_)) => Some(self.judge(&request)),
            Ok(Status::Partial) => None,
            Err(Error::TooManyHeaders) => Some(Err(TOO_LARGE)),
            Err(_) => Some(Err("400 Bad Request")),
        }
    }

    fn judge(&self, request: &Request) -> Result<String, &'static str> {
        if self.token.is_some() && !self.is_meant(request) {
            return Err("403 Forbidden");
        }
        let path = request.path.unwrap_or_default();
        let path = self.below(path).ok_or("404 Not Found")?;
        match request.method {
            Some("GET") => Ok(path.to_owned()),
            _ => Err("405 Method Not Allowed"),
        }
    }

    /// Whether the browser asked for this computer by its own name, and by nothing else: a page
    /// from elsewhere whose name leads here must not read maps. Where others may look, a number is
    /// as good.
    fn is_meant(&self, request: &Request) -> bool {
        let port = self.address.port();
        let is_known = |host: &str| {
            let number: Option<SocketAddr> = host.parse().ok();
            let is_own = number.is_some_and(|number| {
                let is_here = number.ip() == Ipv4Addr::LOCALHOST;
                number.port() == port && (is_here || !self.address.ip().is_loopback())
            });
            is_own || host.strip_prefix("localhost:") == Some(&port.to_string())
        };
        let headers = request.headers.iter();
        let mut hosts = headers.filter(|header| header.name.eq_ignore_ascii_case("Host"));
        let host = hosts.next().map(|host| std::str::from_utf8(host.value));
        matches!(host, Some(Ok(host)) if is_known(host)) && hosts.next().is_none()
    }

    /// The path below the address of this site.
    fn below<'a>(&self, path: &'a str) -> Option<&'a str> {
        let path = path.split('?').next()?;
        let Some(known) = &self.token else {
            return Some(path);
        };
        let (token, rest) = path.strip_prefix('/')?.split_at_checked(known.len())?;
        // takes the same time wherever they differ
        let differs = token.bytes().zip(known.bytes());
        let differs = differs.fold(0, |differs, (given, known)| differs | (given ^ known));
        (differs == 0 && rest.starts_with('/')).then_some(rest)
    }
}

impl Answer {
    /// The content of a refusal.
    fn nothing(status: &'static str) -> Self {
        Self {
            status,
            kind: "text/plain",
            policy: "default-src 'none'",
            content: Arc::default(),
        }
    }

    fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let Self {
            status,
            kind,
            policy,
            content,
        } = self;
        let length = content.len();
        let head = format!(
            "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: \
             close\r\nCache-Control: no-store\r\nContent-Security-Policy: {policy}; base-uri \
             'none'; form-action 'none'; frame-ancestors 'none'\r\nCross-Origin-Resource-Policy: \
             same-origin\r\nReferrer-Policy: no-referrer\r\nX-Content-Type-Options: nosniff\r\n\
             X-Frame-Options: DENY\r\n\r\n"
        );
        out.write_all(head.as_bytes())?;
        out.write_all(content)
    }
}

/// A stream until an end in time, however the bytes trickle.
struct Timed<'a> {
    stream: &'a TcpStream,
    end: Instant,
}

impl Timed<'_> {
    /// Time that is left.
    fn left(&self) -> io::Result<Duration> {
        let left = self.end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        Ok(left)
    }
}

impl Read for Timed<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(self.left()?))?;
        self.stream.read(into)
    }
}

impl Write for Timed<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(self.left()?))?;
        self.stream.write(&bytes[..bytes.len().min(PIECE)])
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
