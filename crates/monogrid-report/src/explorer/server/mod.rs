//! Pages for the browser of this computer, and for nobody else unless that is asked for.
//!
//! Every program of this computer can connect, whoever started it. So the address holds a random
//! token, only requests without a body are answered, and what a connection may take is limited:
//! bytes, time, and a place among a fixed number. Each has a thread of its own; one that stalls
//! keeps neither others nor the end of the server waiting.

mod connection;
#[cfg(test)]
mod tests;

use crate::ReportError;
use connection::{Answers, Connection, Site};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{Builder, JoinHandle, sleep};
use std::time::{Duration, Instant};

/// Time between looks at what has come.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// How long the end waits for what is being answered.
const LAST_ANSWERS: Duration = Duration::from_millis(300);
/// How long the end waits for the server; then its thread is left alone.
const END_WITHIN: Duration = Duration::from_secs(1);

/// What a connection may take.
#[derive(Clone, Copy, Debug)]
struct Limits {
    /// Connections at a time.
    connections: usize,
    /// Time until the request is there.
    ask: Duration,
    /// Time until the answer is taken: a large page through a slow tunnel.
    answer: Duration,
    /// Time to close after the answer.
    close: Duration,
}

const LIMITS: Limits = Limits {
    connections: 32,
    ask: Duration::from_secs(5),
    answer: Duration::from_secs(60),
    close: Duration::from_millis(500),
};

/// What is answered to a request.
#[derive(Clone, Debug)]
pub struct Answer {
    status: &'static str,
    /// Media type.
    kind: &'static str,
    /// What a page may load.
    policy: &'static str,
    content: Arc<[u8]>,
}

impl Answer {
    /// A page that may load what the policy allows, whatever it says itself.
    pub fn page(html: String, policy: &'static str) -> Self {
        Self {
            status: "200 OK",
            kind: "text/html; charset=utf-8",
            policy,
            content: html.into_bytes().into(),
        }
    }

    /// Text for programs.
    pub fn text(text: String) -> Self {
        Self {
            status: "200 OK",
            kind: "text/plain; version=0.0.4; charset=utf-8",
            policy: "default-src 'none'",
            content: text.into_bytes().into(),
        }
    }

    /// Data for a page.
    pub fn json(json: Vec<u8>) -> Self {
        Self {
            status: "200 OK",
            kind: "application/json",
            policy: "default-src 'none'",
            content: json.into(),
        }
    }

    /// This answer with the status 503: the service is not available.
    #[must_use]
    pub fn unavailable(self) -> Self {
        let status = "503 Service Unavailable";
        Self { status, ..self }
    }

    /// The content.
    pub fn content(&self) -> &[u8] {
        &self.content
    }
}

/// Listens on the loopback interface, unless it is told otherwise; it answers questions and takes
/// nothing in.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    site: Site,
}

impl Server {
    /// Begins to listen; port 0 is any that is free.
    pub fn listen(port: u16) -> Result<Self, ReportError> {
        Self::listen_at((Ipv4Addr::LOCALHOST, port).into())
    }

    /// Begins to listen at an address, for all who reach it and know the token.
    pub fn listen_at(address: SocketAddr) -> Result<Self, ReportError> {
        Self::at(address, Some(token()?), LIMITS)
    }

    /// Begins to listen at an address, for everybody who reaches it: there is no token, and other
    /// names of this computer are taken too.
    pub fn listen_openly(address: SocketAddr) -> Result<Self, ReportError> {
        Self::at(address, None, LIMITS)
    }

    #[cfg(test)]
    fn limited(port: u16, limits: Limits) -> Result<Self, ReportError> {
        let address = (Ipv4Addr::LOCALHOST, port).into();
        Self::at(address, Some(token()?), limits)
    }

    fn at(address: SocketAddr, token: Option<String>, limits: Limits) -> Result<Self, ReportError> {
        let port = address.port();
        let listener =
            TcpListener::bind(address).map_err(|source| ReportError::Port { port, source })?;
        let ready = listener.set_nonblocking(true);
        ready.map_err(ReportError::Server)?;
        let address = listener.local_addr().map_err(ReportError::Server)?;
        let site = Site {
            address,
            token,
            limits,
        };
        Ok(Self { listener, site })
    }

    /// What to open in a browser.
    pub fn url(&self) -> String {
        let Site { address, token, .. } = &self.site;
        let mut address = *address;
        if let (true, Some(own)) = (address.ip().is_unspecified(), own_address()) {
            address.set_ip(own);
        }
        let token = token
            .as_ref()
            .map_or_else(String::new, |token| format!("{token}/"));
        format!("http://{address}/{token}")
    }

    /// Begins to answer; `answer` gets the path below the address, such as `/`. One answer is made
    /// at a time, so that many who ask cost a run no more than one does.
    pub fn start(
        self,
        answer: impl FnMut(&str) -> Option<Answer> + Send + 'static,
    ) -> Result<Serving, ReportError> {
        let stop = Arc::new(AtomicBool::new(false));
        let answers: Arc<Answers> = Arc::new(Mutex::new(Box::new(answer)));
        let serve = {
            let stop = Arc::clone(&stop);
            move || self.serve(&stop, &answers)
        };
        let thread = Builder::new().name("viewer".to_owned()).spawn(serve);
        Ok(Serving {
            thread: thread.map_err(ReportError::Server)?,
            stop,
        })
    }

    fn serve(self, stop: &AtomicBool, answers: &Arc<Answers>) {
        let site = Arc::new(self.site);
        let mut open = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    make_room(&mut open, site.limits.connections, stop);
                    // without a thread for it, it is closed
                    open.extend(Connection::begin(stream, &site, answers).ok());
                }
                // nobody is there, or a connection that broke; the next one may not
                Err(_) => sleep(LOOK_EVERY),
            }
            take_out_ended(&mut open);
        }
        let begin = Instant::now();
        for connection in &open {
            connection.shut();
        }
        while !open.is_empty() && begin.elapsed() < LAST_ANSWERS {
            sleep(LOOK_EVERY);
            take_out_ended(&mut open);
        }
    }
}

/// Shuts connections until there is room for one more: first those that have not asked for a page
/// of this address, the oldest of them before others.
fn make_room(open: &mut Vec<Connection>, most: usize, stop: &AtomicBool) {
    while open.len() >= most && !stop.load(Ordering::Relaxed) {
        if !open.iter().any(Connection::is_shut)
            && let Some(last) = open.iter().min_by_key(|connection| connection.has_asked())
        {
            last.shut();
        }
        sleep(Duration::from_millis(1));
        take_out_ended(open);
    }
}

/// Takes out what has ended; a panic there is one of the server.
fn take_out_ended(open: &mut Vec<Connection>) {
    for connection in open.extract_if(.., |connection| connection.has_ended()) {
        if let Err(panic) = connection.join() {
            resume_unwind(panic);
        }
    }
}

/// A server that answers.
#[derive(Debug)]
pub struct Serving {
    thread: JoinHandle<()>,
    stop: Arc<AtomicBool>,
}

impl Serving {
    /// Whether its thread is gone, which only a panic can do.
    pub fn is_dead(&self) -> bool {
        self.thread.is_finished()
    }

    /// Ends it, within about a second whatever clients do.
    ///
    /// # Errors
    /// A panic in one of its threads, in a sentence.
    pub fn end(self) -> Result<(), &'static str> {
        self.stop.store(true, Ordering::Relaxed);
        let begin = Instant::now();
        while !self.thread.is_finished() {
            if begin.elapsed() > END_WITHIN {
                return Ok(());
            }
            sleep(LOOK_EVERY);
        }
        let end = self.thread.join();
        end.map_err(|_| "a thread that answers browsers has panicked; the message above says why")
    }
}

/// The address by which others of the network reach this computer: nothing is sent for it.
fn own_address() -> Option<IpAddr> {
    // where documents' examples live (RFC 5737), so never near
    const FAR: (Ipv4Addr, u16) = (Ipv4Addr::new(192, 0, 2, 1), 9);
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    socket.connect(FAR).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

/// A part of the address that nobody guesses, hexadecimal.
fn token() -> Result<String, ReportError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(ReportError::Address)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}
