//! Sources that stall, vanish, or end as they should not: a run can be interrupted at any moment,
//! and says what happened.
#![cfg(unix)]

use crate::common::{WITHOUT_DENSE_DEPTH, code, monogrid, program, room, stderr};
use monogrid_datasets::{encode_jpeg, encode_png};
use monogrid_image::{Image, to_gray8};
use monogrid_worlds::SynthConfig;
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Frames that a source shows before it stalls.
const FRAMES: usize = 30;
/// How long an interrupted run may go on: 2 s on a computer that does nothing else.
const GENEROUS: Duration = Duration::from_secs(20);
/// How long anything may take that is waited for.
const FOREVER: Duration = Duration::from_secs(120);

/// Grey images of a camera that moves through a room.
fn images() -> &'static [Image<u8>] {
    static IMAGES: OnceLock<Vec<Image<u8>>> = OnceLock::new();
    IMAGES.get_or_init(|| {
        let sequence = room(SynthConfig::small()).shortened(FRAMES);
        let frames = (0..FRAMES).map(|index| sequence.frame(index).unwrap().image);
        frames.map(|image| image.map(to_gray8)).collect()
    })
}

/// These frames as a YUV4MPEG2 stream.
fn y4m(frames: usize) -> Vec<u8> {
    let (width, height) = (images()[0].width(), images()[0].height());
    let mut stream = format!("YUV4MPEG2 W{width} H{height} F30:1 Cmono\n").into_bytes();
    for image in &images()[..frames] {
        stream.extend_from_slice(b"FRAME\n");
        stream.extend_from_slice(image.as_slice());
    }
    stream
}

/// A run in a folder of its own.
struct Run {
    dir: tempfile::TempDir,
}

impl Run {
    fn new() -> Self {
        Self {
            dir: tempfile::tempdir().unwrap(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn command(&self, source: &str, more: &[&str]) -> Command {
        let mut command = program();
        command.args(["run", source]).args(WITHOUT_DENSE_DEPTH);
        command.args(more).arg("--out").arg(self.path("out"));
        command.current_dir(self.dir.path());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// A program `ffmpeg` that is first in the path: it notes its number and does what the script
    /// says.
    fn with_ffmpeg(&self, command: &mut Command, script: &str) {
        let bin = self.path("bin");
        fs::create_dir(&bin).unwrap();
        let ffmpeg = bin.join("ffmpeg");
        let pid = self.path("pid");
        let text = format!("#!/bin/sh\necho $$ >> '{}'\n{script}\n", pid.display());
        fs::write(&ffmpeg, text).unwrap();
        fs::set_permissions(&ffmpeg, fs::Permissions::from_mode(0o755)).unwrap();
        let path = std::env::var("PATH").unwrap();
        command.env("PATH", format!("{}:{path}", bin.display()));
    }

    /// A script that writes so many frames as ffmpeg does, and what follows.
    fn frames_then(&self, frames: usize, then: &str) -> String {
        let stream = self.path("stream.y4m");
        fs::write(&stream, y4m(frames)).unwrap();
        let times: String = (0..frames)
            .map(|k| {
                format!(
                    "echo '[Parsed_showinfo_1 @ 0x1] n: {k} pts_time:{}' >&2\n",
                    k as f64 / 30.0
                )
            })
            .collect();
        format!("{times}cat '{}'\n{then}", stream.display())
    }

    /// Numbers of the programs `ffmpeg` that were started.
    fn ffmpegs(&self) -> Vec<String> {
        let text = fs::read_to_string(self.path("pid")).unwrap_or_default();
        text.lines().map(str::to_owned).collect()
    }

    /// Waits until they are gone.
    fn assert_no_ffmpeg(&self) {
        let pids = self.ffmpegs();
        assert!(!pids.is_empty(), "none was started");
        for pid in pids {
            wait_until("ffmpeg to be gone", || !is_alive(&pid));
        }
    }

    fn summary(&self) -> serde_json::Value {
        serde_json::from_slice(&fs::read(self.path("out/summary.json")).unwrap()).unwrap()
    }
}

/// Whether a process runs; one that only waits to be asked how it ended does not.
fn is_alive(pid: &str) -> bool {
    let output = Command::new("ps").args(["-o", "stat=", "-p", pid]).output();
    let state = String::from_utf8(output.unwrap().stdout).unwrap();
    !state.trim().is_empty() && !state.trim().starts_with('Z')
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !is_so() {
        assert!(begin.elapsed() < FOREVER, "waited for {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill")
        .args([name, &child.id().to_string()])
        .status();
    assert!(sent.unwrap().success());
}

/// Interrupts a run and expects that it saves at once.
fn interrupt(mut child: Child) -> Output {
    signal(&child, "-INT");
    let begin = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begin.elapsed() > GENEROUS {
            child.kill().unwrap();
            let output = child.wait_with_output().unwrap();
            panic!("it goes on: {}", stderr(&output));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(code(&output), 4, "{}", stderr(&output));
    output
}

/// Waits until everything that a stalled source has shown is tracked: the run has a folder by then,
/// and computes no more.
fn wait_for_frames(run: &Run, child: &Child) {
    wait_until("the run to begin", || run.path("out/config.toml").exists());
    let (mut cpu, mut since) = (cpu_secs(child), Instant::now());
    wait_until("the run to wait for frames", || {
        let now = cpu_secs(child);
        if now != cpu {
            (cpu, since) = (now, Instant::now());
        }
        since.elapsed() > Duration::from_secs(3)
    });
}

/// CPU time that a process has used, in whole seconds, as `ps` says it.
fn cpu_secs(child: &Child) -> String {
    let pid = child.id().to_string();
    let output = Command::new("ps")
        .args(["-o", "time=", "-p", &pid])
        .output();
    String::from_utf8(output.unwrap().stdout).unwrap()
}

/// What is saved of a run that was interrupted when it had seen all frames.
fn assert_saved(run: &Run) {
    let summary = run.summary();
    assert_eq!(summary["status"], "interrupted", "{summary}");
    assert_eq!(summary["frames"], FRAMES, "{summary}");
    for name in ["trajectory.txt", "report.html", "recording.mgk"] {
        assert!(run.path("out").join(name).exists(), "{name}");
    }
}

/// A server that answers with images of a camera, then with these bytes again and again, slowly.
fn mjpeg(frames: usize, then: &'static [u8]) -> String {
    let mut answer =
        b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n".to_vec();
    for image in &images()[..frames] {
        answer.extend_from_slice(b"--b\r\nContent-Type: image/jpeg\r\n\r\n");
        answer.extend(encode_jpeg(image, 95));
        answer.extend_from_slice(b"\r\n");
    }
    serve(move |stream| {
        stream.write_all(&answer)?;
        loop {
            std::thread::sleep(Duration::from_millis(300));
            stream.write_all(then)?;
        }
    })
}

/// A server that does this with each connection; its address.
fn serve(answer: impl Fn(&mut TcpStream) -> std::io::Result<()> + Send + Sync + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let mut request = [0; 4096];
            drop(stream.read(&mut request));
            // the client has gone
            drop(answer(&mut stream));
        }
    });
    address
}

#[test]
fn standard_input_that_stalls_is_interrupted() {
    for (frames, is_cut) in [(FRAMES, false), (FRAMES, true), (0, false)] {
        let run = Run::new();
        let mut command = run.command("-", &["--fov", "60"]);
        let mut child = command.stdin(Stdio::piped()).spawn().unwrap();
        let mut stdin = child.stdin.take().unwrap();
        stdin.write_all(&y4m(frames)).unwrap();
        if is_cut {
            stdin.write_all(b"FRAME\nhalf a").unwrap();
        }
        stdin.flush().unwrap();
        if frames > 0 {
            wait_for_frames(&run, &child);
            interrupt(child);
            assert_saved(&run);
        } else {
            std::thread::sleep(Duration::from_secs(1));
            let said = stderr(&interrupt(child));
            assert!(said.contains("nothing to save"), "{said}");
        }
        drop(stdin);
    }
}

#[test]
fn a_named_pipe_is_read_and_interrupted() {
    let run = Run::new();
    let pipe = run.path("camera.y4m");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    // nobody writes
    let child = run.command("camera.y4m", &["--fov", "60"]).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(1));
    interrupt(child);
    let child = run.command("camera.y4m", &["--fov", "60"]).spawn().unwrap();
    let mut writer = fs::OpenOptions::new().write(true).open(&pipe).unwrap();
    writer.write_all(&y4m(FRAMES)).unwrap();
    wait_for_frames(&run, &child);
    interrupt(child);
    assert_saved(&run);
    drop(writer);
}

#[test]
fn http_that_drips_is_interrupted_in_every_state() {
    for (frames, then) in [
        (FRAMES, b"\r\n".as_slice()),
        (FRAMES, b"x"),
        (0, b"x"),
        (0, b"\r\n"),
    ] {
        let run = Run::new();
        let address = format!("http://{}/video", mjpeg(frames, then));
        // empty lines would be an error before long
        let child = run.command(&address, &["--fov", "60", "--source-timeout", "0"]);
        let child = { child }.spawn().unwrap();
        if frames > 0 {
            wait_for_frames(&run, &child);
            interrupt(child);
            assert_saved(&run);
        } else {
            std::thread::sleep(Duration::from_secs(1));
            interrupt(child);
        }
    }
}

#[test]
fn a_silent_source_is_given_up_and_what_was_seen_is_saved() {
    let more = ["--fov", "60", "--source-timeout", "2"];
    let run = Run::new();
    let address = format!("http://{}/video", mjpeg(FRAMES, b"x"));
    let output = run.command(&address, &more).output().unwrap();
    let said = stderr(&output);
    assert_eq!(code(&output), 1, "{said}");
    assert!(said.contains("no whole frame for 2 s"), "{said}");
    let summary = run.summary();
    assert_eq!(summary["status"], "broke_off", "{summary}");
    assert_eq!(summary["frames"], FRAMES, "{summary}");
    // before the first frame, and not only with --fov
    let silent = serve(|_| {
        loop {
            std::thread::sleep(Duration::from_secs(1));
        }
    });
    let silent = format!("http://{silent}/video");
    let output = Run::new().command(&silent, &more).output().unwrap();
    assert_eq!(code(&output), 1, "{}", stderr(&output));
    assert!(stderr(&output).contains("no whole frame for 2 s"));
    let check = monogrid(["check", &silent, "--source-timeout", "1"]);
    assert_eq!(code(&check), 1, "{}", stderr(&check));
}

#[test]
fn ffmpeg_that_hangs_is_interrupted_and_ended() {
    // a child of its own, as a wrapper has
    let hang = "sleep 300";
    let cases = [
        ("rtsp://127.0.0.1:9/x", FRAMES, true),
        ("rtsp://127.0.0.1:9/x", 0, true),
        // the first pass, which finds the camera
        ("film.mkv", FRAMES, false),
        ("film.mkv", FRAMES, true),
        ("film.mkv", 0, false),
    ];
    for (source, frames, has_camera) in cases {
        let run = Run::new();
        fs::write(run.path("film.mkv"), [0x1a, 0x45, 0xdf, 0xa3]).unwrap();
        let more: &[&str] = match has_camera {
            true => &["--fov", "60", "--source-timeout", "0"],
            false => &[],
        };
        let mut command = run.command(source, more);
        let script = match frames {
            0 => hang.to_owned(),
            _ => run.frames_then(frames, hang),
        };
        run.with_ffmpeg(&mut command, &script);
        let child = command.spawn().unwrap();
        wait_until("ffmpeg", || !run.ffmpegs().is_empty());
        std::thread::sleep(Duration::from_secs(3));
        interrupt(child);
        run.assert_no_ffmpeg();
        if frames > 0 {
            assert_eq!(run.summary()["status"], "interrupted");
        }
        // a file is looked at before it is tracked
        if frames > 0 && source != "film.mkv" {
            assert_saved(&run);
        }
    }
}

#[test]
fn ffmpeg_does_not_outlive_a_run_that_is_killed() {
    if !cfg!(target_os = "linux") {
        return;
    }
    let run = Run::new();
    let mut command = run.command("rtsp://127.0.0.1:9/x", &["--fov", "60"]);
    run.with_ffmpeg(&mut command, "exec sleep 300");
    let mut child = command.spawn().unwrap();
    wait_until("ffmpeg", || !run.ffmpegs().is_empty());
    std::thread::sleep(Duration::from_millis(300));
    signal(&child, "-KILL");
    child.wait().unwrap();
    run.assert_no_ffmpeg();
}

#[test]
fn ffmpeg_that_fails_or_is_killed_on_the_way_is_no_end() {
    for then in ["exit 1", "kill -9 $$", "printf 'FRAME\\nhalf'; exit 0"] {
        let run = Run::new();
        fs::write(run.path("film.mkv"), [0x1a, 0x45, 0xdf, 0xa3]).unwrap();
        let mut command = run.command("film.mkv", &["--fov", "60"]);
        let script = run.frames_then(FRAMES, then);
        run.with_ffmpeg(&mut command, &script);
        let output = command.output().unwrap();
        assert_eq!(code(&output), 1, "{then}: {}", stderr(&output));
        let summary = run.summary();
        assert_eq!(summary["status"], "broke_off", "{summary}");
        assert_eq!(summary["frames"], FRAMES, "{summary}");
    }
}

#[test]
fn ffmpeg_is_told_what_it_may_open() {
    for (source, is_file) in [("film.mkv", true), ("rtsp://127.0.0.1:9/x", false)] {
        let run = Run::new();
        fs::write(run.path("film.mkv"), [0x1a, 0x45, 0xdf, 0xa3]).unwrap();
        let mut command = run.command(source, &["--fov", "60"]);
        run.with_ffmpeg(
            &mut command,
            "for a in \"$@\"; do echo \"$a\"; done > args; exit 1",
        );
        assert_ne!(code(&command.output().unwrap()), 0);
        let args = fs::read_to_string(run.path("args")).unwrap();
        let args: Vec<&str> = args.lines().collect();
        let list = |name: &str| -> Vec<&str> {
            let at = args.iter().position(|arg| *arg == name).unwrap();
            // options of the input stand before it
            assert!(at < args.iter().position(|arg| *arg == "-i").unwrap());
            args[at + 1].split(',').collect()
        };
        let protocols = list("-protocol_whitelist");
        assert_eq!(protocols == ["file"], is_file, "{protocols:?}");
        assert_eq!(protocols.contains(&"file"), is_file, "{protocols:?}");
        let formats = list("-format_whitelist");
        for never in ["concat", "image2", "lavfi", "imf", "tee", "avisynth"] {
            assert!(!formats.contains(&never), "{never}");
        }
        for network in ["hls", "dash", "sdp", "rtp", "rtsp"] {
            assert_eq!(formats.contains(&network), !is_file, "{network}");
        }
        assert!(formats.contains(&"matroska"));
    }
}

/// With the real ffmpeg, where there is one.
#[test]
fn a_playlist_is_no_video() {
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        return;
    }
    let run = Run::new();
    fs::write(run.path("secret.y4m"), y4m(20)).unwrap();
    let secret = run.path("secret.y4m").display().to_string();
    let playlists = [
        format!("#EXTM3U\n#EXT-X-TARGETDURATION:5\n#EXTINF:5,\nfile://{secret}\n#EXT-X-ENDLIST\n"),
        format!("ffconcat version 1.0\nfile {secret}\n"),
        "ffconcat version 1.0\nfile secret.y4m\n".to_owned(),
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 26\n"
            .to_owned(),
    ];
    for playlist in playlists {
        fs::write(run.path("evil.mp4"), &playlist).unwrap();
        let mut command = program();
        command.args(["check", "evil.mp4", "--fov", "60"]);
        let output = command.current_dir(run.dir.path()).output().unwrap();
        let said = stderr(&output);
        assert_eq!(code(&output), 2, "{playlist}: {said}");
        assert!(said.contains("which may name other files"), "{said}");
    }
}

/// Has the camera refined by a first pass over the source, and does this before the second one.
fn changed_between_passes(run: &Run, source: &str, change: impl FnOnce()) -> Output {
    let more = ["--fov", "60", "--refine-calibration"];
    let mut child = run.command(source, &more).spawn().unwrap();
    let mut said = String::new();
    let mut pipe = child.stderr.take().unwrap();
    while !said.contains("a first pass") {
        let mut byte = [0];
        assert_eq!(pipe.read(&mut byte).unwrap(), 1, "{said}");
        said.push(byte[0] as char);
    }
    change();
    let mut rest = Vec::new();
    pipe.read_to_end(&mut rest).unwrap();
    let mut output = child.wait_with_output().unwrap();
    output.stderr = [said.as_bytes(), &rest].concat();
    output
}

#[test]
fn a_video_that_vanishes_between_the_passes_is_a_failure() {
    let run = Run::new();
    let video = run.path("film.y4m");
    fs::write(&video, y4m(FRAMES)).unwrap();
    let output = changed_between_passes(&run, "film.y4m", || fs::remove_file(&video).unwrap());
    let said = stderr(&output);
    assert_eq!(code(&output), 1, "{said}");
    assert!(said.contains("no video at \"film.y4m\""), "{said}");
    assert!(!said.contains("never started"), "{said}");
    let summary = run.summary();
    assert_eq!(summary["status"], "broke_off", "{summary}");
    assert_eq!(summary["frames"], 0, "{summary}");
}

#[test]
fn a_video_that_is_cut_between_the_passes_is_a_failure() {
    let run = Run::new();
    let video = run.path("film.y4m");
    let whole = y4m(FRAMES);
    fs::write(&video, &whole).unwrap();
    let cut = whole.len() / 2 + 99;
    let output = changed_between_passes(&run, "film.y4m", || {
        let file = fs::OpenOptions::new().write(true).open(&video).unwrap();
        file.set_len(cut as u64).unwrap();
    });
    let said = stderr(&output);
    assert_eq!(code(&output), 1, "{said}");
    assert!(said.contains("an end within frame"), "{said}");
    assert_eq!(run.summary()["status"], "broke_off");
}

fn folder_of_images(folder: &Path, count: usize) {
    fs::create_dir(folder).unwrap();
    for (index, image) in images().iter().take(count).enumerate() {
        let file = folder.join(format!("{index:03}.png"));
        fs::write(file, encode_png(image)).unwrap();
    }
}

#[test]
fn a_folder_that_vanishes_between_the_passes_is_a_failure() {
    // fewer than are given up after, too
    for count in [FRAMES, 8] {
        let run = Run::new();
        let folder = run.path("images");
        folder_of_images(&folder, count);
        let output =
            changed_between_passes(&run, "images", || fs::remove_dir_all(&folder).unwrap());
        let said = stderr(&output);
        assert_eq!(code(&output), 1, "{said}");
        let number = count.min(10);
        let expected = format!("{number} images in a row cannot be used");
        assert!(said.contains(&expected), "{said}");
        assert_eq!(run.summary()["status"], "unreadable");
    }
}
