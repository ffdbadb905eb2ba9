//! Helpers of the tests that run the program.
#![allow(dead_code, reason = "every test file uses a part")]

use monogrid_worlds::{
    Carrier, EffectsConfig, LightingConfig, SynthConfig, SynthSequence, World, WriteConfig,
    usual_frames, write_tum_layout,
};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::sync::{Arc, OnceLock};

/// The program.
pub fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_monogrid"))
}

/// Runs the program with these arguments.
pub fn monogrid<A: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = A>) -> Output {
    program().args(args).output().expect("the program starts")
}

/// A recording below the folder that MONOGRID_DATA names.
pub fn data(name: &str) -> PathBuf {
    let folder = std::env::var_os("MONOGRID_DATA");
    let folder = folder.expect("MONOGRID_DATA names the folder of recorded sequences");
    let path = PathBuf::from(folder).join(name);
    assert!(path.exists(), "{} is absent", path.display());
    path
}

/// Options of runs whose subject is no map: dense depth takes a third of the time of a short one.
pub const WITHOUT_DENSE_DEPTH: [&str; 2] = ["--set", "mapping.quality=fast"];

/// Exit code; a panic or a signal gives -1.
pub fn code(output: &Output) -> i32 {
    output.status.code().unwrap_or(-1)
}

/// Standard error as text.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Asserts exit code and that the message holds every one of `parts`, and nothing that looks like a
/// panic.
pub fn assert_fails(output: &Output, expected: i32, parts: &[&str]) {
    let text = stderr(output);
    assert_eq!(code(output), expected, "{text}");
    assert!(!text.contains("panicked"), "{text}");
    for part in parts {
        assert!(text.contains(part), "expected {part:?} in: {text}");
    }
}

/// JSON on standard output.
pub fn json(output: &Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!(
            "{error}: {} {}",
            String::from_utf8_lossy(&output.stdout),
            stderr(output)
        )
    })
}

/// Frames of the small sequence: enough for a start and some keyframes.
pub const SMALL_FRAMES: usize = 150;

/// The way of a hand through the built-in room, which is made once per test program.
pub fn room(config: SynthConfig) -> SynthSequence {
    static WORLD: OnceLock<Arc<World>> = OnceLock::new();
    let name = "living-room";
    let quick = LightingConfig::quick();
    let world = WORLD.get_or_init(|| Arc::new(World::by_name_with(name, &quick).unwrap()));
    let path = SynthSequence::path_for(name, Carrier::Hand.into(), &config).unwrap();
    SynthSequence::new(Arc::clone(world), path, config).unwrap()
}

/// The beginning of a slower way, in images and their times.
pub fn render(folder: &Path, effects: EffectsConfig, frames: usize) {
    let config = SynthConfig {
        frames: usual_frames("living-room"),
        effects,
        ..SynthConfig::small()
    };
    write_images(&room(config).shortened(frames), folder);
}

/// Images and their times, without any depth.
pub fn write_images(sequence: &SynthSequence, folder: &Path) {
    let config = WriteConfig {
        depth_every: 0,
        with_mesh: false,
        ..WriteConfig::default()
    };
    write_tum_layout(sequence, folder, &config, |_| {}).unwrap();
}

/// A short video of the built-in room at 320x240 with exact truth, written once per test program.
pub fn small_sequence() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = std::env::temp_dir().join(format!("monogrid-small-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let sequence = room(SynthConfig::small()).shortened(SMALL_FRAMES);
        let config = WriteConfig {
            depth_every: 5,
            with_mesh: false,
            ..WriteConfig::default()
        };
        write_tum_layout(&sequence, &folder, &config, |_| {}).unwrap();
        folder
    })
}

/// A private copy of the small sequence, to be damaged.
pub fn copy_of_small_sequence(to: &Path) {
    fn copy(from: &Path, to: &Path) {
        std::fs::create_dir_all(to).unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let entry = entry.unwrap();
            let target = to.join(entry.file_name());
            if entry.file_type().unwrap().is_dir() {
                copy(&entry.path(), &target);
            } else {
                std::fs::copy(entry.path(), target).unwrap();
            }
        }
    }
    copy(small_sequence(), to);
}

/// Every file below a folder with its content, names relative and sorted.
pub fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    fn collect(root: &Path, folder: &Path, out: &mut Vec<(String, Vec<u8>)>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                collect(root, &path, out);
            } else {
                let name = path
                    .strip_prefix(root)
                    .unwrap()
                    .to_string_lossy()
                    .into_owned();
                out.push((name, std::fs::read(&path).unwrap()));
            }
        }
    }
    let mut out = Vec::new();
    collect(folder, folder, &mut out);
    out.sort();
    out
}

/// A scan file with a wall of points two metres ahead of a sensor one metre above the origin.
pub fn write_scans(path: &Path) {
    let mut out = Vec::new();
    out.extend(0x4f47_4d31_u32.to_le_bytes());
    out.extend(1_u32.to_le_bytes());
    // world_from_sensor: sensor z is world x, sensor x is world -y, sensor y is world -z
    let pose: [f64; 12] = [0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0];
    for value in pose {
        out.extend(value.to_le_bytes());
    }
    let points: Vec<[f32; 4]> = (-40..=40)
        .flat_map(|x| (-40..=40).map(move |y| (x, y)))
        .map(|(x, y)| [x as f32 * 0.02, y as f32 * 0.02, 2.02, 0.02])
        .collect();
    out.extend((points.len() as u32).to_le_bytes());
    for value in points.into_iter().flatten() {
        out.extend(value.to_le_bytes());
    }
    std::fs::write(path, out).unwrap();
}

/// Clients of the page at this address that nobody wants, held open: one promises a body, one a
/// body of 70 TB, one does not read what it asks for, one begins a request and leaves it at that.
pub fn hostile_clients(url: &str) -> Vec<TcpStream> {
    let (host, path) = parts_of_url(url);
    let rest = format!("{path} HTTP/1.1\r\nHost: {host}\r\n");
    let requests = [
        format!("POST {rest}Content-Length: 5000\r\n\r\n"),
        format!("POST {rest}Content-Length: 70368744177664\r\n\r\n"),
        format!("GET {rest}\r\n").repeat(60),
        format!("GET {rest}"),
    ];
    let send = |request: &String| {
        let mut stream = TcpStream::connect(host).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream
    };
    requests.iter().map(send).collect()
}

/// Everything that is answered to a request for the page at this address.
pub fn get(url: &str) -> Vec<u8> {
    get_below(url, "")
}

/// What is answered below the address of a page.
pub fn get_below(url: &str, name: &str) -> Vec<u8> {
    let (host, path) = parts_of_url(url);
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET {path}{name} HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    answer
}

/// `127.0.0.1:8080` and `/0a1b/`.
fn parts_of_url(url: &str) -> (&str, &str) {
    let rest = url.strip_prefix("http://127.0.0.1:").unwrap();
    let (_, path) = rest.split_once('/').unwrap();
    assert!(path.len() == 33 && path.ends_with('/'), "a token: {url}");
    let host = "http://".len()..url.len() - path.len() - 1;
    (&url[host], &url[url.len() - path.len() - 1..])
}

/// Interrupts a program as Ctrl-C does.
pub fn interrupt(child: &Child) {
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &id]).status();
    assert!(sent.unwrap().success());
}
