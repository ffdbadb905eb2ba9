//! Damaged files: no panic, no hang, no memory without bounds. `MUTATION_COPIES` and
//! `MUTATION_SEED` make more and other ones.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "tests")]

use monogrid_video::Video;
use std::path::Path;
use std::time::{Duration, Instant};

/// Damaged copies of each file, unless the environment says another number.
const COPIES: usize = 400;

/// Seed of the damage, unless the environment says another one.
const SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// A number from the environment.
fn from_environment<T: std::str::FromStr>(name: &str) -> Option<T> {
    std::env::var(name).ok()?.parse().ok()
}

/// No copy takes so long, however busy the machine: a decoder that hangs takes for ever.
const LIMIT: Duration = Duration::from_secs(120);

/// Most memory of the whole test program, kilobytes.
const MAX_MEMORY_KB: u64 = 1 << 20;

/// A generator for tests (xorshift): the same damage on every machine.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % bound.max(1)
    }
}

/// Changes bytes, writes extreme numbers, cuts, doubles or removes pieces.
fn damage(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(6) {
        let at = random.below(bytes.len());
        let length = random.below(64).min(bytes.len() - at);
        match random.below(7) {
            0 => bytes[at] = random.below(256) as u8,
            1 => bytes[at] ^= 1 << random.below(8),
            2 => bytes[at..at + length.min(4)].fill(0xff),
            3 => bytes[at..at + length.min(4)].fill(0),
            4 => bytes.truncate(at.max(8)),
            5 => drop(bytes.drain(at..at + length)),
            _ => {
                let piece = bytes[at..at + length].to_vec();
                bytes.splice(at..at, piece);
            }
        }
        if bytes.is_empty() {
            return;
        }
    }
}

/// Decodes up to 100 items of damaged copies of a file.
fn survive(name: &str, original: &[u8], marker: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let copies = from_environment("MUTATION_COPIES").unwrap_or(COPIES);
    let seed = from_environment("MUTATION_SEED").unwrap_or(SEED);
    let mut random = Random(seed.max(1));
    let mut opened = 0;
    for copy in 0..copies {
        let mut bytes = original.to_vec();
        damage(&mut bytes, &mut random);
        // what is no longer of the format would only test ffmpeg
        if !bytes.windows(marker.len()).take(16).any(|w| w == marker) {
            continue;
        }
        std::fs::write(&path, &bytes).unwrap();
        let begin = Instant::now();
        if let Ok(video) = Video::open(&path) {
            opened += 1;
            video.take(100).for_each(drop);
        }
        let time = begin.elapsed();
        assert!(time < LIMIT, "{name}, copy {copy}: {time:?}");
    }
    assert!(
        opened > copies / 10,
        "{name}: only {opened} could be opened"
    );
    if let Some(kilobytes) = peak_memory_kb() {
        assert!(kilobytes < MAX_MEMORY_KB, "{name}: {kilobytes} kB");
    }
}

/// Most memory that this process had so far (Linux).
fn peak_memory_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

fn file(name: &str) -> Vec<u8> {
    std::fs::read(
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/data")
            .join(name),
    )
    .unwrap()
}

#[test]
fn mp4() {
    survive("damaged.mp4", &file("cut.mp4"), b"ftyp");
}

#[test]
fn avi() {
    survive("damaged.avi", &file("mjpeg.avi"), b"AVI ");
}

#[test]
fn y4m() {
    let mut stream = b"YUV4MPEG2 W16 H8 F30:1 C420jpeg\n".to_vec();
    for level in 0..8u8 {
        stream.extend_from_slice(b"FRAME\n");
        stream.extend_from_slice(&[level; 16 * 8 * 3 / 2]);
    }
    survive("damaged.y4m", &stream, b"YUV4MPEG2");
}
