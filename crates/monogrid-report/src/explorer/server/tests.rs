#![allow(clippy::too_many_lines, reason = "a test tells its story in one place")]

use super::*;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::atomic::AtomicUsize;

/// Larger than what sockets of both sides hold.
const LARGE: usize = 40 << 20;
/// No answer takes as long, on a busy computer either.
const SOON: Duration = Duration::from_secs(2);

/// A server with a small and a large page, and its clients.
struct Site {
    port: u16,
    token: String,
    serving: Serving,
    made: Arc<AtomicUsize>,
}

/// Nothing ends by itself while a test lasts.
const PATIENT: Limits = Limits {
    connections: 4,
    ask: Duration::from_secs(600),
    answer: Duration::from_secs(600),
    close: Duration::from_secs(600),
};

impl Site {
    fn new(limits: Limits) -> Self {
        let server = Server::limited(0, limits).unwrap();
        let port = server.site.address.port();
        let token = server.site.token.clone().unwrap();
        assert_eq!(server.url(), format!("http://127.0.0.1:{port}/{token}/"));
        let made = Arc::new(AtomicUsize::new(0));
        let answer = {
            let made = Arc::clone(&made);
            let large = Answer::page("x".repeat(LARGE), "default-src 'none'");
            move |path: &str| {
                made.fetch_add(1, Ordering::Relaxed);
                match path {
                    "/" => Some(Answer::page("the page".into(), "img-src data:")),
                    "/large" => Some(large.clone()),
                    "/live/1" => Some(Answer::json(b"{}".to_vec())),
                    "/panic" => panic!("a panic that a test wants"),
                    _ => None,
                }
            }
        };
        Self {
            port,
            token,
            serving: server.start(answer).unwrap(),
            made,
        }
    }

    fn fill(&self, text: &str) -> String {
        let text = text.replace("PORT", &self.port.to_string());
        text.replace("TOKEN", &self.token)
    }

    /// Sends this and keeps the connection; one that the server closes meanwhile is fine.
    fn send(&self, text: &str) -> TcpStream {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(SOON)).unwrap();
        let _ = stream.write_all(self.fill(text).as_bytes());
        stream
    }

    /// The head of the answer, which comes soon.
    fn status(&self, text: &str) -> String {
        head(&mut self.send(text))
    }

    /// Everybody else gets the page meanwhile.
    fn assert_answers(&self, while_what: &str) {
        let begin = Instant::now();
        let mut stream = self.send(&get("/TOKEN/?a=b"));
        let page = rest(&mut stream);
        assert!(
            page.starts_with("HTTP/1.1 200 OK\r\n"),
            "{while_what}: {page}"
        );
        assert!(page.ends_with("\r\n\r\nthe page"), "{while_what}: {page}");
        assert!(begin.elapsed() < SOON, "{while_what}");
    }

    fn end(self) {
        let begin = Instant::now();
        self.serving.end().unwrap();
        assert!(begin.elapsed() < END_WITHIN, "{:?}", begin.elapsed());
    }
}

fn get(path: &str) -> String {
    format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1:PORT\r\n\r\n")
}

/// Everything until the server has nothing more to say.
fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    String::from_utf8(bytes).unwrap()
}

/// The first line of the answer.
fn head(stream: &mut TcpStream) -> String {
    let mut bytes = [0; 64];
    let count = stream.read(&mut bytes).unwrap();
    let text = String::from_utf8_lossy(&bytes[..count]);
    text.lines().next().unwrap_or_default().to_owned()
}

#[test]
fn a_page_is_for_those_who_know_its_address_and_who_ask_this_computer() {
    let site = Site::new(LIMITS);
    let ask = |path: &str, hosts: &[&str]| {
        let hosts = hosts.iter().map(|host| format!("{host}\r\n"));
        let hosts: String = hosts.collect();
        site.status(&format!("GET {path} HTTP/1.1\r\n{hosts}\r\n"))
    };
    let right = "Host: 127.0.0.1:PORT";
    for hosts in [right, "host:localhost:PORT"] {
        assert_eq!(ask("/TOKEN/", &[hosts]), "HTTP/1.1 200 OK");
        assert_eq!(ask("/TOKEN/live/1?", &[hosts]), "HTTP/1.1 200 OK");
    }
    for hosts in [
        vec![],
        vec!["Host: example.org:PORT"],
        vec!["Host: 127.0.0.1"],
        vec!["Host: 127.0.0.1:PORT.example.org"],
        vec![right, "Host: example.org"],
        vec!["Host: example.org", right],
        vec![right, right],
    ] {
        assert_eq!(
            ask("/TOKEN/", &hosts),
            "HTTP/1.1 403 Forbidden",
            "{hosts:?}"
        );
    }
    let wrong = "0".repeat(32);
    for path in [
        "/",
        "/live/1",
        "/TOKEN",
        "/TOKENa/",
        "//TOKEN/",
        "/TOKEN/other",
    ] {
        assert_eq!(ask(path, &[right]), "HTTP/1.1 404 Not Found", "{path}");
    }
    for path in [format!("/{wrong}/"), format!("/{wrong}/live/1")] {
        assert_eq!(ask(&path, &[right]), "HTTP/1.1 404 Not Found", "{path}");
    }
    for method in ["POST", "PUT", "HEAD", "OPTIONS", "CONNECT"] {
        let status = site.status(&get("/TOKEN/").replace("GET", method));
        assert_eq!(status, "HTTP/1.1 405 Method Not Allowed", "{method}");
    }
    site.end();
}

#[test]
fn no_two_servers_have_the_same_address() {
    let tokens = [(); 2].map(|()| Server::listen(0).unwrap().site.token.unwrap());
    assert_ne!(tokens[0], tokens[1]);
    for token in tokens {
        assert!(token.len() == 32 && token.bytes().all(|byte| byte.is_ascii_hexdigit()));
    }
}

#[test]
fn every_answer_says_what_its_page_may_load_and_is_kept_nowhere() {
    let site = Site::new(LIMITS);
    for (path, policy) in [
        ("/TOKEN/", "img-src data:;"),
        ("/TOKEN/live/1", "default-src 'none';"),
        ("/", "default-src 'none';"),
    ] {
        let answer = rest(&mut site.send(&get(path)));
        for line in [
            &format!(
                "Content-Security-Policy: {policy} base-uri 'none'; form-action 'none'; \
                 frame-ancestors 'none'"
            ),
            "X-Content-Type-Options: nosniff",
            "Referrer-Policy: no-referrer",
            "Cache-Control: no-store",
        ] {
            let times = answer.matches(&format!("\r\n{line}\r\n")).count();
            assert_eq!(times, 1, "{line}: {answer}");
        }
    }
    site.end();
}

/// What one of whom nothing good is to be expected sends, and what is said; nothing where that is
/// to wait.
#[allow(clippy::too_many_lines, reason = "a table of requests")]
fn hostile() -> Vec<(&'static str, String, &'static str)> {
    let post = |headers: &str| {
        format!("POST /TOKEN/ HTTP/1.1\r\nHost: 127.0.0.1:PORT\r\n{headers}\r\n\r\n")
    };
    let of_length = |length: &str| post(&format!("Content-Length: {length}"));
    let many = "A: b\r\n".repeat(200);
    vec![
        (
            "a body of 2^64 - 1 bytes",
            of_length("18446744073709551615"),
            "405",
        ),
        ("a body of 70 TB", of_length("70368744177664"), "405"),
        ("a body that is promised", of_length("5000"), "405"),
        (
            "a body longer than any number",
            of_length("99999999999999999999999"),
            "405",
        ),
        ("a body of a negative length", of_length("-1"), "405"),
        (
            "a body in parts",
            post("Transfer-Encoding: chunked") + "FFFFFFFFFFFFFFFF\r\n",
            "405",
        ),
        (
            "a body of another site",
            of_length("70368744177664").replace("127.0.0.1", "evil"),
            "403",
        ),
        (
            "a body that comes",
            of_length("5000000") + &"x".repeat(5_000_000),
            "405",
        ),
        (
            "a question with a body",
            get("/TOKEN/").replace("\r\n\r\n", "\r\nContent-Length: 5000\r\n\r\n"),
            "200",
        ),
        (
            "one that waits to be told to go on",
            post("Content-Length: 9\r\nExpect: 100-continue"),
            "405",
        ),
        (
            "too many headers",
            get("/TOKEN/").replace("Host", &format!("{many}Host")),
            "431",
        ),
        (
            "a long header",
            get("/TOKEN/").replace("Host", &format!("A: {}\r\nHost", "x".repeat(9000))),
            "431",
        ),
        (
            "a long address",
            get(&format!("/TOKEN/{}", "x".repeat(9000))),
            "431",
        ),
        (
            "a line without an end",
            "GET /".to_owned() + &"x".repeat(1 << 20),
            "431",
        ),
        (
            "another protocol",
            "\x16\x03\x01\x02\0\x01\0\x01\r\n\r\n".to_owned(),
            "400",
        ),
        (
            "garbage",
            "\u{1}\u{2}\u{3} \u{7f}\r\n\r\n".to_owned(),
            "400",
        ),
        (
            "another version",
            get("/TOKEN/").replace("HTTP/1.1", "HTTP/9.9"),
            "400",
        ),
        ("questions in a row", get("/TOKEN/").repeat(400), "200"),
        ("nothing", String::new(), ""),
        ("half a line", "GET /TOKEN/ HT".to_owned(), ""),
        (
            "a header without an end",
            get("/TOKEN/").trim_end().to_owned(),
            "",
        ),
        ("a large page that is not read", get("/TOKEN/large"), ""),
    ]
}

#[test]
fn no_client_keeps_others_or_the_end_waiting() {
    for (what, text, status) in hostile() {
        let site = Site::new(PATIENT);
        // fewer than there are places: nothing is to make room for
        let mut held: Vec<TcpStream> = (0..3).map(|_| site.send(&text)).collect();
        for stream in held.iter_mut().filter(|_| !status.is_empty()) {
            let said = head(stream);
            assert!(
                said.starts_with(&format!("HTTP/1.1 {status} ")),
                "{what}: {said}"
            );
        }
        site.assert_answers(what);
        assert!(!site.serving.is_dead(), "{what}");
        site.end();
        drop(held);
    }
}

#[test]
fn no_more_connections_are_open_than_may_be() {
    let site = Site::new(PATIENT);
    let mut held: Vec<TcpStream> = (0..12).map(|_| site.send("")).collect();
    site.assert_answers("many connections");
    // the oldest were closed; a connection that is open has nothing to say
    for (number, stream) in held.iter_mut().enumerate().take(8) {
        let said = stream.read(&mut [0; 1]);
        let is_closed = match &said {
            Ok(count) => *count == 0,
            Err(error) => error.kind() == std::io::ErrorKind::ConnectionReset,
        };
        assert!(is_closed, "{number}: {said:?}");
    }
    site.end();
}

/// The tests above have limits of their own.
#[test]
fn limits_of_the_program_are_small() {
    assert!((8..=64).contains(&LIMITS.connections));
    assert!(LIMITS.ask <= Duration::from_secs(10));
    assert!(LIMITS.answer <= Duration::from_secs(120));
    assert!(LIMITS.close <= Duration::from_secs(1));
    assert!(LAST_ANSWERS < END_WITHIN && END_WITHIN <= Duration::from_secs(1));
}

#[test]
fn of_questions_in_a_row_one_is_answered() {
    let site = Site::new(LIMITS);
    let answers = rest(&mut site.send(&get("/TOKEN/").repeat(60)));
    assert_eq!(answers.matches("HTTP/1.1 200").count(), 1);
    assert_eq!(site.made.load(Ordering::Relaxed), 1);
    site.end();
}

#[test]
fn a_header_that_drips_has_a_time_in_all() {
    let limits = Limits {
        ask: Duration::from_millis(300),
        ..PATIENT
    };
    let site = Site::new(limits);
    let mut stream = site.send("GET /");
    let begin = Instant::now();
    // each byte is well within the time, all of them are not
    while stream.write_all(b"x").is_ok() {
        assert!(begin.elapsed() < SOON, "it may drip for ever");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(begin.elapsed() >= limits.ask);
    site.end();
}

#[test]
fn an_answer_that_is_taken_in_drops_has_a_time_in_all() {
    let limits = Limits {
        answer: Duration::from_millis(300),
        ..PATIENT
    };
    let site = Site::new(limits);
    let mut stream = site.send(&get("/TOKEN/large"));
    let (begin, mut taken, mut drop) = (Instant::now(), 0, [0; 1 << 10]);
    while begin.elapsed() < 2 * limits.answer {
        taken += stream.read(&mut drop).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
    // what was on the way is still there, and then nothing
    let mut rest = Vec::new();
    let _ = stream.read_to_end(&mut rest);
    assert!(taken + rest.len() < LARGE, "the whole page was sent");
    site.end();
}

#[test]
fn a_connection_that_stays_open_after_its_answer_is_closed() {
    let limits = Limits {
        close: Duration::from_millis(100),
        ..PATIENT
    };
    let site = Site::new(limits);
    let mut stream = site.send(&get("/TOKEN/"));
    rest(&mut stream);
    let begin = Instant::now();
    while stream.write_all(b"x").is_ok() {
        assert!(begin.elapsed() < SOON, "it is never closed");
        std::thread::sleep(Duration::from_millis(20));
    }
    site.end();
}

#[test]
fn one_more_than_there_are_places_takes_that_of_the_oldest() {
    for text in [String::new(), get("/TOKEN/large"), get("/TOKEN/")] {
        let site = Site::new(PATIENT);
        let held: Vec<TcpStream> = (0..50).map(|_| site.send(&text)).collect();
        for _ in 0..5 {
            site.assert_answers("all places are taken");
        }
        drop(held);
        site.end();
    }
}

#[test]
fn those_who_do_not_know_the_address_push_out_nobody_who_does() {
    let site = Site::new(PATIENT);
    let mut page = site.send(&get("/TOKEN/large"));
    assert!(head(&mut page).starts_with("HTTP/1.1 200"));
    let held: Vec<TcpStream> = (0..50).map(|_| site.send("GET /")).collect();
    site.assert_answers("all places are taken");
    let mut page_bytes = Vec::new();
    page.read_to_end(&mut page_bytes).unwrap();
    assert!(page_bytes.len() >= LARGE, "{}", page_bytes.len());
    drop(held);
    site.end();
}

#[test]
fn many_browsers_are_answered_at_once() {
    let site = Site::new(LIMITS);
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                for _ in 0..10 {
                    site.assert_answers("others ask too");
                }
            });
        }
    });
    assert_eq!(site.made.load(Ordering::Relaxed), 80);
    site.end();
}

#[test]
fn a_client_that_goes_away_takes_nothing_with_it() {
    let site = Site::new(PATIENT);
    for how in [Shutdown::Both, Shutdown::Write, Shutdown::Read] {
        for text in [get("/TOKEN/large"), "GET /".to_owned(), String::new()] {
            let stream = site.send(&text);
            let _ = stream.shutdown(how);
            drop(stream);
            site.assert_answers("one has gone");
        }
    }
    site.end();
}

#[test]
fn a_panic_is_not_kept_quiet() {
    let site = Site::new(LIMITS);
    site.send(&get("/TOKEN/panic"));
    let begin = Instant::now();
    while !site.serving.is_dead() {
        assert!(begin.elapsed() < SOON, "nobody notices");
        std::thread::sleep(LOOK_EVERY);
    }
    let said = site.serving.end().unwrap_err();
    assert!(said.contains("panicked"), "{said}");
}

#[test]
fn an_answer_that_takes_long_does_not_hold_up_the_end() {
    let server = Server::limited(0, PATIENT).unwrap();
    let address = server.site.address;
    let path = server.site.token.clone().unwrap();
    let (begun, begins) = std::sync::mpsc::channel();
    let serving = server.start(move |_| {
        begun.send(()).unwrap();
        std::thread::sleep(Duration::from_secs(20));
        None
    });
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET /{path}/ HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    begins.recv().unwrap();
    let begin = Instant::now();
    serving.unwrap().end().unwrap();
    assert!(begin.elapsed() < SOON, "{:?}", begin.elapsed());
}

#[test]
fn nothing_is_made_for_those_who_waited_when_the_server_ended() {
    let server = Server::limited(0, PATIENT).unwrap();
    let address = server.site.address;
    let path = server.site.token.clone().unwrap();
    let (begun, begins) = std::sync::mpsc::channel();
    let (go_on, goes_on) = std::sync::mpsc::channel::<()>();
    let made = Arc::new(AtomicUsize::new(0));
    let makes = Arc::clone(&made);
    let serving = server.start(move |_| {
        makes.fetch_add(1, Ordering::Relaxed);
        let _ = (begun.send(()), goes_on.recv());
        None
    });
    let ask = |_| {
        let mut stream = TcpStream::connect(address).unwrap();
        write!(stream, "GET /{path}/ HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
        stream
    };
    let first = ask(0);
    begins.recv().unwrap();
    let waiting: Vec<TcpStream> = (1..3).map(ask).collect();
    // until they wait for their turn
    std::thread::sleep(Duration::from_millis(200));
    serving.unwrap().end().unwrap();
    drop(go_on);
    // what makes answers is gone with the last thread that could ask for one
    let begin = Instant::now();
    while Arc::strong_count(&made) > 1 {
        assert!(begin.elapsed() < SOON, "a thread goes on");
        std::thread::sleep(LOOK_EVERY);
    }
    assert_eq!(made.load(Ordering::Relaxed), 1);
    drop((first, waiting));
}

#[test]
fn a_thread_that_does_not_end_is_left_alone() {
    let (hold, held) = std::sync::mpsc::channel::<()>();
    let serving = Serving {
        thread: std::thread::spawn(move || {
            let _ = held.recv();
        }),
        stop: Arc::default(),
    };
    let begin = Instant::now();
    assert_eq!(serving.end(), Ok(()));
    assert!(begin.elapsed() < 4 * END_WITHIN);
    drop(hold);
}

#[test]
fn an_open_server_answers_everybody_and_takes_nothing_in() {
    let server = Server::listen_openly((Ipv4Addr::LOCALHOST, 0).into()).unwrap();
    let address = server.site.address;
    assert_eq!(server.url(), format!("http://{address}/"));
    let serving = server.start(|path| match path {
        "/metrics" => Some(Answer::text("a 1\n".to_owned())),
        _ => None,
    });
    let ask = |request: &str| {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        rest(&mut stream)
    };
    let answer = ask("GET /metrics?x HTTP/1.1\r\nHost: robots.example:9\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 200 OK") && answer.ends_with("\r\n\r\na 1\n"));
    assert!(answer.contains("Content-Type: text/plain; version=0.0.4"));
    assert!(ask("GET / HTTP/1.1\r\n\r\n").starts_with("HTTP/1.1 404"));
    assert!(ask("POST /metrics HTTP/1.1\r\n\r\n").starts_with("HTTP/1.1 405"));
    serving.unwrap().end().unwrap();
}

#[test]
fn whoever_may_look_from_elsewhere_knows_the_token_and_asks_for_a_number() {
    let server = Server::listen_at((Ipv4Addr::UNSPECIFIED, 0).into()).unwrap();
    let url = server.url();
    let port = server.site.address.port();
    let path = url.split_once(&format!(":{port}")).unwrap().1.to_owned();
    assert!(!url.contains("//0.0.0.0"), "{url}");
    let serving = server.start(|_| Some(Answer::json(b"map".to_vec())));
    let asked = |host: &str, path: &str| {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer[9..12].to_owned()
    };
    assert_eq!(asked("192.168.7.7", &path), "200");
    assert_eq!(asked("192.168.7.7", "/"), "404");
    assert_eq!(asked("evil.example", &path), "403");
    serving.unwrap().end().unwrap();
}
