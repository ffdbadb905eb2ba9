//! Mutated files for every reader, checksums put right again where there are any.

use super::limits::{limited, run};
use super::seeds::Seeds;
use crate::{from_environment, row};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

/// A kind of file: which seed it begins from, and what the program is to do with it.
#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    seed: &'static str,
    /// Name of the mutated file, in a folder of its own.
    file: &'static str,
    /// Arguments; `@` is the mutated file, `%` the folder of the seeds, `!` a folder for results.
    args: &'static [&'static str],
    repair: fn(&mut [u8]),
    /// One more limit of the shell; empty for none.
    limit: &'static str,
}

fn as_it_is(_: &mut [u8]) {}

const KINDS: &[Kind] = &[
    kind(
        "recording, map",
        "run/recording.mgk",
        "r.mgk",
        &["map", "@", "--out", "!/m.ot"],
        repair_mgk,
    ),
    kind(
        "recording, continue",
        "run/recording.mgk",
        "recording.mgk",
        &[
            "run",
            "%/video/few.txt",
            "--calibration",
            "%/video/calibration.txt",
            "--continue",
            "@",
            "--out",
            "!/run",
            "--threads",
            "2",
        ],
        repair_mgk,
    ),
    kind(
        "recording, evaluate",
        "run/recording.mgk",
        "r.mgk",
        &["evaluate", "depth", "@", "%/video"],
        repair_mgk,
    ),
    kind(
        "submap .mgs",
        "first.mgs",
        "first.mgs",
        &["map", "@", "--out", "!/m.ot"],
        as_it_is,
    ),
    kind(
        "submaps.json",
        "run/submaps/submaps.json",
        "submaps.json",
        &["info", "@"],
        as_it_is,
    ),
    kind(
        "inertial readings",
        "imu.csv",
        "imu.csv",
        &[
            "run",
            "%/video/few.txt",
            "--calibration",
            "%/video/calibration.txt",
            "--imu",
            "@",
            "--imu-from-camera",
            "%/identity.txt",
            "--out",
            "!/run",
        ],
        as_it_is,
    ),
    kind(
        "map .ot",
        "run/global.ot",
        "m.ot",
        &["convert", "@", "!/m.bt"],
        as_it_is,
    ),
    kind(
        "map .bt",
        "map.bt",
        "m.bt",
        &["convert", "@", "!/m.ot"],
        as_it_is,
    ),
    kind("map .mgo", "map.mgo", "m.mgo", &["info", "@"], as_it_is),
    kind(
        "scans",
        "scans.scans",
        "s.scans",
        &["map", "@", "--out", "!/m.ot"],
        as_it_is,
    ),
    kind(
        "mesh .ply",
        "mesh.ply",
        "m.ply",
        &[
            "truth",
            "@",
            "--trajectory",
            "%/video/groundtruth.txt",
            "--out",
            "!/m.ot",
        ],
        as_it_is,
    ),
    kind(
        "cloud .ply",
        "cloud.ply",
        "c.ply",
        &[
            "truth",
            "@",
            "--trajectory",
            "%/video/groundtruth.txt",
            "--out",
            "!/m.ot",
        ],
        as_it_is,
    ),
    kind(
        "mesh .obj",
        "mesh.obj",
        "m.obj",
        &[
            "truth",
            "@",
            "--trajectory",
            "%/video/groundtruth.txt",
            "--out",
            "!/m.ot",
        ],
        as_it_is,
    ),
    kind(
        "calibration",
        "video/calibration.txt",
        "c.txt",
        &[
            "run",
            "%/video/few.txt",
            "--calibration",
            "@",
            "--max-frames",
            "3",
            "--out",
            "!/run",
        ],
        as_it_is,
    ),
    kind(
        "trajectory",
        "video/groundtruth.txt",
        "t.txt",
        &["evaluate", "trajectory", "@", "%/video/groundtruth.txt"],
        as_it_is,
    ),
    kind(
        "truth",
        "video/groundtruth.txt",
        "t.txt",
        &["evaluate", "trajectory", "%/run/trajectory.txt", "@"],
        as_it_is,
    ),
    kind(
        "list",
        "video/few.txt",
        "l.txt",
        &["check", "@", "--calibration", "%/video/calibration.txt"],
        as_it_is,
    ),
    kind(
        "image .png",
        "video/mask.png",
        "i.png",
        &[
            "check",
            "%/video/few.txt",
            "--mask",
            "@",
            "--calibration",
            "%/video/calibration.txt",
        ],
        repair_png,
    ),
    kind(
        "image .pgm",
        "gray.pgm",
        "i.pgm",
        &[
            "check",
            "%/video/few.txt",
            "--mask",
            "@",
            "--calibration",
            "%/video/calibration.txt",
        ],
        as_it_is,
    ),
    kind(
        "settings",
        "run/config.toml",
        "c.toml",
        &[
            "run",
            "%/video/few.txt",
            "--calibration",
            "%/video/calibration.txt",
            "--config",
            "@",
            "--max-frames",
            "3",
            "--out",
            "!/run",
        ],
        as_it_is,
    ),
    kind(
        "vocabulary",
        "places.vocabulary",
        "p.vocabulary",
        &[
            "run",
            "%/video/few.txt",
            "--calibration",
            "%/video/calibration.txt",
            "--profile",
            "thesis",
            "--max-frames",
            "3",
            "--out",
            "!/run",
            "--set",
            "slam.graph.places.vocabulary=@",
        ],
        as_it_is,
    ),
    kind(
        "Sim(3)",
        "run/map_from_world.txt",
        "s.txt",
        &[
            "map",
            "%/run/recording.mgk",
            "--align",
            "sim3:@",
            "--out",
            "!/m.ot",
        ],
        as_it_is,
    ),
];

/// Kinds that hold images: each is decoded to the end, or to its eighth image.
const MEDIA: &[(&str, &str, &str)] = &[
    ("video .mp4", "reordered.mp4", "v.mp4"),
    ("video .avi", "mjpeg.avi", "v.avi"),
    ("video .y4m", "gray.y4m", "v.y4m"),
    ("archive .zip", "images.zip", "a.zip"),
    ("archive .tar", "images.tar", "a.tar"),
    ("archive .tar.gz", "images.tar.gz", "a.tar.gz"),
    ("bag .db3", "plain.db3", "b.db3"),
    ("bag .mcap", "plain.mcap", "b.mcap"),
    ("bag .mcap, zstd", "zstd.mcap", "b.mcap"),
    ("bag .bag, lz4", "lz4.bag", "b.bag"),
    ("bag .bag, bz2", "bz2.bag", "b.bag"),
];

const MEDIA_ARGS: &[&str] = &[
    "run",
    "@",
    "--fov",
    "60",
    "--max-frames",
    "8",
    "--threads",
    "2",
    "--out",
    "!/run",
];

/// Calibrations as other programs write them.
const CALIBRATIONS: &[(&str, &str, &str)] = &[
    ("calibration of ROS", "ros.yaml", "c.yaml"),
    ("calibration of Kalibr", "kalibr.yaml", "c.yaml"),
    ("calibration of ORB-SLAM", "orb.yaml", "c.yaml"),
    ("calibration of COLMAP", "colmap.txt", "cameras.txt"),
    ("calibration .toml", "own.toml", "c.toml"),
];

const CALIBRATION_ARGS: &[&str] = &["check", "%/video/few.txt", "--calibration", "@"];

/// All kinds; images and calibrations come from anywhere, so that they may not take more than 1 GB.
fn kinds() -> Vec<Kind> {
    let mut kinds = KINDS.to_vec();
    for (table, args) in [(MEDIA, MEDIA_ARGS), (CALIBRATIONS, CALIBRATION_ARGS)] {
        kinds.extend(table.iter().map(|&(name, seed, file)| Kind {
            limit: "ulimit -v 1400000;",
            ..kind(name, seed, file, args, as_it_is)
        }));
    }
    kinds
}

const fn kind(
    name: &'static str,
    seed: &'static str,
    file: &'static str,
    args: &'static [&'static str],
    repair: fn(&mut [u8]),
) -> Kind {
    Kind {
        name,
        seed,
        file,
        args,
        repair,
        limit: "",
    }
}

const WORDS: [&[u8]; 12] = [
    b"nan",
    b"-inf",
    b"1e999",
    b"1e-320",
    b"4294967295",
    b"-1",
    b"0",
    b"\n",
    b" ",
    b"99999999999999999999",
    b"\xff\xfe",
    b"[[",
];
const NUMBERS: [u64; 8] = [
    0,
    1,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    60_000,
    u64::MAX,
    0x7ff8_0000_0000_0000,
];

/// A damaged copy: changed bits, bytes and numbers, cuts, repeated and removed stretches, words
/// that are numbers and should not be.
pub fn mutated(seed: &[u8], rng: &mut SmallRng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=rng.random_range(0..4) {
        if bytes.is_empty() {
            break;
        }
        // mostly near the beginning, where headers are
        let reach = if rng.random_bool(0.5) {
            bytes.len().min(200)
        } else {
            bytes.len()
        };
        let at = rng.random_range(0..reach);
        let end = (at + rng.random_range(1..40)).min(bytes.len());
        match rng.random_range(0..9) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes[at] = rng.random(),
            2 | 3 => {
                let number = NUMBERS[rng.random_range(0..NUMBERS.len())].to_le_bytes();
                let width = [1, 2, 4, 8][rng.random_range(0..4)].min(bytes.len() - at);
                bytes[at..at + width].copy_from_slice(&number[..width]);
            }
            4 => drop(bytes.drain(at..end)),
            5 => bytes.truncate(at),
            6 => drop(bytes.splice(
                at..end,
                WORDS[rng.random_range(0..WORDS.len())].iter().copied(),
            )),
            7 => {
                let stretch = bytes[at..end].to_vec();
                let stretch = stretch.repeat(rng.random_range(1..2000));
                bytes.splice(at..at, stretch);
            }
            _ => {
                let from = rng.random_range(0..bytes.len());
                let stretch = bytes[from..(from + 200).min(bytes.len())].to_vec();
                bytes.splice(at..at, stretch);
            }
        }
    }
    bytes
}

/// Puts the checksums of a recording right, record by record, as far as its lengths go.
fn repair_mgk(bytes: &mut [u8]) {
    let mut at = 16;
    while let Some(header) = bytes.get(at..at + 20) {
        let length = u32::from_le_bytes(header[8..12].try_into().unwrap()) as usize;
        let end = (at + 20).saturating_add(length).min(bytes.len());
        let payload_bytes = (end - at - 20) as u32;
        let payload = crc32fast::hash(&bytes[at + 20..end]);
        bytes[at..at + 4].copy_from_slice(b"RMGK");
        bytes[at + 8..at + 12].copy_from_slice(&payload_bytes.to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&payload.to_le_bytes());
        let header = crc32fast::hash(&bytes[at..at + 16]);
        bytes[at + 16..at + 20].copy_from_slice(&header.to_le_bytes());
        at = end;
    }
}

/// Puts the checksums of a PNG right, chunk by chunk, as far as its lengths go.
fn repair_png(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(header) = bytes.get(at..at + 8) {
        let length = u32::from_be_bytes(header[..4].try_into().unwrap()) as usize;
        let end = (at + 8).saturating_add(length);
        if end.saturating_add(4) > bytes.len() {
            return;
        }
        let checksum = crc32fast::hash(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&checksum.to_be_bytes());
        at = end + 4;
    }
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn mutated_files_of_every_kind() {
    let only = std::env::var("TORTURE_ONLY").unwrap_or_default();
    let seeds = Seeds::new();
    let mask = fs::read(seeds.path("gray.pgm")).unwrap();
    let mask = monogrid_datasets::decode_gray(&mask, Path::new("gray.pgm")).unwrap();
    let png = monogrid_datasets::encode_png(&mask.map(|v| v as u8));
    fs::write(seeds.path("video/mask.png"), png).unwrap();
    println!("| mutated file | runs | accepted | slowest | harm |\n|---|---|---|---|---|");
    let mut harmed = 0;
    for kind in kinds().iter().filter(|kind| kind.name.contains(&only)) {
        harmed += torture(kind, &seeds);
    }
    assert_eq!(harmed, 0, "see above");
}

/// Whether a kind that has had so many mutants since `begin` gets one more: by their number where
/// one is asked for, else by the time.
pub fn wanted(runs: usize, begin: Instant) -> bool {
    match from_environment("TORTURE_MUTANTS", 0) {
        0 => begin.elapsed().as_secs() < from_environment("TORTURE_SECONDS", 10),
        mutants => (runs as u64) < mutants,
    }
}

/// Tries mutations; the number of those that did harm.
fn torture(kind: &Kind, seeds: &Seeds) -> usize {
    let seed = fs::read(seeds.path(kind.seed)).unwrap();
    let first = from_environment("TORTURE_SEED", 1);
    let begin = Instant::now();
    let (mut runs, mut accepted, mut harmed, mut slowest) = (0_usize, 0_usize, 0, Duration::ZERO);
    while wanted(runs, begin) {
        let number = first + runs as u64;
        let mut rng = SmallRng::seed_from_u64(number);
        let mut bytes = mutated(&seed, &mut rng);
        (kind.repair)(&mut bytes);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(kind.file);
        fs::write(&file, &bytes).unwrap();
        let results = folder.path().join("results");
        fs::create_dir(&results).unwrap();
        let args = kind.args.iter().map(|arg| {
            arg.replace('@', &file.display().to_string())
                .replace('%', &seeds.root().display().to_string())
                .replace('!', &results.display().to_string())
        });
        let ended = run(limited(kind.limit, args), folder.path());
        runs += 1;
        accepted += usize::from(matches!(ended.code, Some(0 | 3)));
        slowest = slowest.max(ended.took);
        if let Some(harm) = ended.harm() {
            harmed += 1;
            println!("  {} number {number}: {harm}", kind.name);
            if let Ok(keep) = std::env::var("TORTURE_KEEP") {
                fs::copy(
                    &file,
                    Path::new(&keep).join(format!("{number}-{}", kind.file)),
                )
                .unwrap();
            }
        }
    }
    row(kind.name, runs, &accepted.to_string(), slowest, harmed);
    harmed
}
