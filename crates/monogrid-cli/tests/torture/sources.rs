//! Sources that send anything, stall and vanish.

use super::limits::{Ended, limited, wait};
use super::mutations::{mutated, wanted};
use super::seeds::Seeds;
use crate::common::interrupt;
use crate::{Outcomes, from_environment};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// After this a source that stalls is given up, seconds.
const TIMEOUT: &str = "1";

/// How long it may take to end then, or after an interrupt.
const SOON: Duration = Duration::from_secs(15);

/// Runs a source that is served by `serve`; how it ended.
fn run_of(seeds: &Seeds, source: &str, serve: impl FnOnce(&mut Child)) -> Ended {
    let out = tempfile::tempdir_in(seeds.root()).unwrap();
    let said = out.path().join("stderr");
    let to = out.path().join("out").display().to_string();
    let args = [
        "run",
        source,
        "--fov",
        "60",
        "--max-frames",
        "8",
        "--threads",
        "2",
        "--source-timeout",
        TIMEOUT,
        "--out",
        &to,
    ];
    let mut command = limited("ulimit -v 1400000;", args);
    command.stdin(Stdio::piped()).stdout(Stdio::null());
    command.stderr(fs::File::create(&said).unwrap());
    let begin = Instant::now();
    let mut child = command.spawn().unwrap();
    serve(&mut child);
    let code = wait(&mut child, SOON);
    Ended {
        code,
        said: String::from_utf8_lossy(&fs::read(said).unwrap()).into_owned(),
        took: begin.elapsed(),
    }
}

/// An answer with some images, one after the other.
fn mjpeg() -> Vec<u8> {
    let image = monogrid_image::Image::from_fn(64, 48, |x, y| (x * 5 + y * 3) as u8);
    let jpeg = monogrid_datasets::encode_jpeg(&image, 90);
    let mut answer =
        b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n".to_vec();
    for _ in 0..4 {
        answer.extend(
            format!(
                "--b\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
                jpeg.len()
            )
            .bytes(),
        );
        answer.extend(&jpeg);
        answer.extend(b"\r\n");
    }
    answer
}

/// Counts a run of a source; those that do not end are harm.
fn count(outcomes: &mut Outcomes, what: &str, ended: &Ended) {
    let harms: Vec<String> = ended.harm().into_iter().collect();
    outcomes.count(what, ended, &harms);
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn servers_of_images() {
    let seeds = Seeds::new();
    let (mut outcomes, first) = (Outcomes::default(), from_environment("TORTURE_SEED", 1));
    let seed = mjpeg();
    let (begin, mut runs) = (Instant::now(), 0);
    while wanted(runs, begin) {
        let mut rng = SmallRng::seed_from_u64(first + runs as u64);
        let answer = mutated(&seed, &mut rng);
        let then = rng.random_range(0..3);
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let source = format!("http://{}/", listener.local_addr().unwrap());
        // ends with the connection, or when nobody ever asks
        std::thread::spawn(move || {
            listener.set_nonblocking(true).unwrap();
            let begin = Instant::now();
            while begin.elapsed() < SOON {
                if let Ok((stream, _)) = listener.accept() {
                    serve(stream, &answer, then);
                }
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        let ended = run_of(&seeds, &source, |_| {});
        count(&mut outcomes, &format!("answer {runs}"), &ended);
        runs += 1;
    }
    outcomes.conclude("servers of images");
}

/// Answers, then ends, says nothing more, or goes on byte by byte.
fn serve(mut stream: TcpStream, answer: &[u8], then: u32) {
    stream.set_nonblocking(false).unwrap();
    stream.set_write_timeout(Some(SOON)).unwrap();
    let mut asked = [0; 1000];
    let _ = stream.read(&mut asked);
    let mut goes_on = stream.write_all(answer).is_ok() && then > 0;
    let begin = Instant::now();
    while goes_on && begin.elapsed() < SOON {
        std::thread::sleep(Duration::from_millis(200));
        goes_on = then == 1 || stream.write_all(b"\n").is_ok();
    }
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn pipes_that_stall_and_are_interrupted() {
    let seeds = Seeds::new();
    let (mut outcomes, first) = (Outcomes::default(), from_environment("TORTURE_SEED", 1));
    let seed = fs::read(seeds.path("gray.y4m")).unwrap();
    let (begin, mut runs) = (Instant::now(), 0);
    while wanted(runs, begin) {
        let mut rng = SmallRng::seed_from_u64(first + runs as u64);
        let stream = mutated(&seed, &mut rng);
        let pause = Duration::from_millis(rng.random_range(0..600));
        let mut pipe = None;
        let ended = run_of(&seeds, "-", |child| {
            let mut stdin = child.stdin.take().unwrap();
            let _ = stdin.write_all(&stream);
            pipe = Some(stdin);
            std::thread::sleep(pause);
            if child.try_wait().unwrap().is_none() {
                interrupt(child);
            }
        });
        drop(pipe);
        // before the program listens, it ends by the signal itself
        let is_early = ended.code.is_none() && ended.took < SOON;
        let harm = ended.harm().filter(|_| !is_early);
        outcomes.count(&format!("pipe {runs}"), &ended, harm.as_slice());
        runs += 1;
    }
    outcomes.conclude("pipes that stall");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn files_that_vanish_or_change() {
    let seeds = Seeds::new();
    let (mut outcomes, first) = (Outcomes::default(), from_environment("TORTURE_SEED", 1));
    let files = [
        "reordered.mp4",
        "mjpeg.avi",
        "images.zip",
        "images.tar",
        "plain.mcap",
    ];
    let (begin, mut runs) = (Instant::now(), 0);
    while wanted(runs, begin) {
        let mut rng = SmallRng::seed_from_u64(first + runs as u64);
        let name = files[runs % files.len()];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let bytes = fs::read(seeds.path(name)).unwrap();
        fs::write(&path, &bytes).unwrap();
        let pause = Duration::from_millis(rng.random_range(0..150));
        let source = path.display().to_string();
        let ended = run_of(&seeds, &source, |_| {
            std::thread::sleep(pause);
            match rng.random_range(0..3) {
                0 => fs::remove_file(&path).unwrap(),
                1 => fs::write(&path, &bytes[..rng.random_range(0..bytes.len())]).unwrap(),
                _ => fs::write(&path, mutated(&bytes, &mut rng)).unwrap(),
            }
        });
        count(&mut outcomes, &format!("{name}, {runs}"), &ended);
        runs += 1;
    }
    outcomes.conclude("files that vanish");
}
