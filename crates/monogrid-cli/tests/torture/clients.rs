//! Clients of the pages of `view` and of a run with `--view` that send anything, and do anything
//! afterwards.

use super::limits::{Ended, limited, wait};
use super::mutations::{mutated, wanted};
use super::seeds::Seeds;
use crate::common::{get, hostile_clients, interrupt};
use crate::{MAX_SECONDS, Outcomes, from_environment};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Connections that are held open at once.
const HELD: usize = 100;

/// How long one client waits for its answer.
const PATIENCE: Duration = Duration::from_millis(50);

/// A program with a page, what it says so far, and the address of the page.
fn started(args: &[&str]) -> (Child, String) {
    // the address of a map that is viewed is said on standard output
    let mut command = limited("exec 1>&2;", args);
    let mut child = command
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let url = said.find_map(|line| {
        let line = line.unwrap();
        let rest = &line[line.find("http://127.0.0.1:")?..];
        Some(rest.split_whitespace().next()?.to_owned())
    });
    // a program that cannot say anything fails
    std::thread::spawn(move || said.for_each(drop));
    (child, url.expect("an address"))
}

/// Requests to begin from, for the page at this address.
fn requests(url: &str) -> Vec<String> {
    let rest = url.strip_prefix("http://").unwrap();
    let (host, path) = rest.split_once('/').unwrap();
    let head = format!(" HTTP/1.1\r\nHost: {host}\r\n");
    [
        format!("GET /{path}{head}\r\n"),
        format!("GET /{path}live/0/0/1{head}Connection: keep-alive\r\n\r\n"),
        format!("HEAD /{path}{head}Range: bytes=0-99\r\n\r\n"),
        format!("POST /{path}{head}Content-Length: 20\r\n\r\n01234567890123456789"),
        format!("POST /{path}{head}Transfer-Encoding: chunked\r\n\r\nffffffff\r\n"),
        format!("GET /{path}{head}Expect: 100-continue\r\nUpgrade: websocket\r\n\r\n"),
    ]
    .into()
}

/// What one client does; a connection that it leaves open.
fn attack(url: &str, number: u64) -> Option<TcpStream> {
    let mut rng = SmallRng::seed_from_u64(number);
    let requests = requests(url);
    let request = &requests[rng.random_range(0..requests.len())];
    let bytes = mutated(request.as_bytes(), &mut rng);
    let host = url.strip_prefix("http://").unwrap();
    let mut stream = TcpStream::connect(host.split('/').next().unwrap()).ok()?;
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.set_write_timeout(Some(PATIENCE)).unwrap();
    // who is refused is told so before everything is sent
    let _ = stream.write_all(&bytes);
    match rng.random_range(0..4) {
        0 => {}
        1 => return Some(stream),
        2 => drop(stream.shutdown(Shutdown::Write)),
        _ => drop(stream.read(&mut [0; 4096])),
    }
    None
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn clients_of_a_map_that_is_viewed() {
    let seeds = Seeds::new();
    let map = seeds.path("run/global.ot").display().to_string();
    let (mut child, url) = started(&["view", &map]);
    let mut held = std::collections::VecDeque::new();
    let (mut outcomes, first) = (Outcomes::default(), from_environment("TORTURE_SEED", 1));
    let begin = Instant::now();
    let mut runs = 0;
    while wanted(runs, begin) {
        held.extend(attack(&url, first + runs as u64));
        while held.len() > HELD {
            held.pop_front();
        }
        runs += 1;
        let asked = Instant::now();
        let mut harms = Vec::new();
        if runs % 50 == 0 && !get(&url).starts_with(b"HTTP/1.1 200") {
            harms.push("the page is no longer shown".to_owned());
        }
        if let Some(status) = child.try_wait().unwrap() {
            harms.push(format!("it ended: {status}"));
        }
        let ended = Ended {
            code: Some(0),
            said: String::new(),
            took: asked.elapsed(),
        };
        outcomes.count(&format!("client {runs}"), &ended, &harms);
        if !harms.is_empty() {
            break;
        }
    }
    interrupt(&child);
    let code = wait(&mut child, Duration::from_secs(5));
    assert_eq!(code, Some(0), "it does not end");
    outcomes.conclude("clients of view");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn clients_of_a_run() {
    let seeds = Seeds::new();
    let video = seeds.path("video").display().to_string();
    let out = seeds.path("seen").display().to_string();
    let (mut outcomes, first) = (Outcomes::default(), from_environment("TORTURE_SEED", 1));
    let args = [
        "run",
        &video,
        "--out",
        &out,
        "--force",
        "--threads",
        "2",
        "--view",
    ];
    for number in 0..3 {
        let begin = Instant::now();
        let (mut child, url) = started(&args);
        let mut held = hostile_clients(&url);
        let mut clients = first + number * 1_000_000;
        while child.try_wait().unwrap().is_none() && begin.elapsed().as_secs() < MAX_SECONDS {
            held.extend(attack(&url, clients));
            held.truncate(HELD);
            clients += 1;
        }
        let ended = Ended {
            code: wait(&mut child, Duration::ZERO),
            said: String::new(),
            took: begin.elapsed(),
        };
        let failed = ended.code != Some(0) || !seeds.path("seen/global.ot").is_file();
        let harms = failed.then(|| format!("it ended with {:?}", ended.code));
        outcomes.count(&format!("run {number}"), &ended, harms.as_slice());
    }
    outcomes.conclude("clients of a run");
}
