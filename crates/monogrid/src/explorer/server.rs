//! Pages for the browser of this computer, and for nobody else.

use crate::failure::Failure;
use std::io::Cursor;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tiny_http::{Header, Method, Request, Response, StatusCode};

/// How long the server may take to notice that it is to end.
const PATIENCE: Duration = Duration::from_millis(200);

/// What is answered to a request.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Media type.
    pub kind: &'static str,
    /// The content.
    pub content: Arc<[u8]>,
}

impl Answer {
    /// A page.
    pub fn page(html: String) -> Self {
        Self {
            kind: "text/html; charset=utf-8",
            content: html.into_bytes().into(),
        }
    }
}

/// Listens on the loopback interface; it answers questions and takes nothing in.
pub struct Server {
    http: tiny_http::Server,
    address: SocketAddr,
}

impl Server {
    /// Begins to listen; port 0 is any that is free.
    pub fn listen(port: u16) -> Result<Self, Failure> {
        let http = tiny_http::Server::http((Ipv4Addr::LOCALHOST, port)).map_err(|error| {
            Failure::input(format!(
                "port {port} of this computer cannot be used ({error}); choose another with --port, or 0 for any that is free"
            ))
        })?;
        let address = http.server_addr().to_ip();
        let address = address.ok_or_else(|| Failure::running("the server has no address"))?;
        Ok(Self { http, address })
    }

    /// What to open in a browser.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Answers, one request after the other, until `stop` is set; `answer` gets the path, such as `/`.
    pub fn serve(&self, stop: &AtomicBool, answer: impl Fn(&str) -> Option<Answer>) {
        while !stop.load(Ordering::Relaxed) {
            match self.http.recv_timeout(PATIENCE) {
                Ok(Some(request)) => self.respond(request, &answer),
                Ok(None) => {}
                // a connection that broke; the next one may not
                Err(_) => std::thread::sleep(PATIENCE),
            }
        }
    }

    fn respond(&self, request: Request, answer: impl Fn(&str) -> Option<Answer>) {
        let path = request.url().split(['?', '#']).next().unwrap_or_default();
        let (status, found) = if !self.is_meant(&request) {
            (403, None)
        } else if *request.method() != Method::Get {
            (405, None)
        } else {
            answer(path).map_or((404, None), |found| (200, Some(found)))
        };
        let nothing = || Answer {
            kind: "text/plain",
            content: Arc::default(),
        };
        let Answer { kind, content } = found.unwrap_or_else(nothing);
        let length = content.len();
        let headers = [
            ("Content-Type", kind),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
        ];
        let headers = headers.iter().filter_map(|(name, value)| {
            let header: Result<Header, ()> = format!("{name}: {value}").parse();
            header.ok()
        });
        let response = Response::new(
            StatusCode(status),
            headers.collect(),
            Cursor::new(content),
            Some(length),
            None,
        );
        // whole, so that a browser knows how far it is
        let response = response.with_chunked_threshold(usize::MAX);
        // a browser that has gone does not matter
        let _ = request.respond(response);
    }

    /// Whether the browser asked for this computer by its own name: a page from elsewhere whose name leads here must not
    /// read maps.
    fn is_meant(&self, request: &Request) -> bool {
        let port = self.address.port();
        let hosts = request.headers().iter().filter(|h| h.field.equiv("Host"));
        let mut hosts = hosts.map(|header| header.value.as_str());
        let known = ["127.0.0.1", "localhost"].map(|name| format!("{name}:{port}"));
        hosts.any(|host| known.iter().any(|known| known == host))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpStream;

    fn ask(server: &Server, request: &str) -> String {
        let mut stream = TcpStream::connect(server.address).unwrap();
        let port = server.address.port();
        write!(stream, "{}", request.replace("PORT", &port.to_string())).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn only_this_computer_is_answered_and_only_questions() {
        let server = Server::listen(0).unwrap();
        assert!(server.url().starts_with("http://127.0.0.1:"));
        let stop = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                server.serve(&stop, |path| {
                    (path == "/").then(|| Answer::page("the page".into()))
                });
            });
            let request = |method: &str, path: &str, host: &str| {
                let text = format!(
                    "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
                );
                ask(&server, &text)
            };
            let page = request("GET", "/?a=b", "127.0.0.1:PORT");
            assert!(
                page.starts_with("HTTP/1.1 200") && page.ends_with("the page"),
                "{page}"
            );
            assert!(request("GET", "/", "localhost:PORT").starts_with("HTTP/1.1 200"));
            assert!(request("GET", "/other", "localhost:PORT").starts_with("HTTP/1.1 404"));
            assert!(request("POST", "/", "localhost:PORT").starts_with("HTTP/1.1 405"));
            assert!(request("GET", "/", "example.org:PORT").starts_with("HTTP/1.1 403"));
            stop.store(true, Ordering::Relaxed);
        });
    }
}
