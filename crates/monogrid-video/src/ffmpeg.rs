//! All other codecs and streams, through the program `ffmpeg`.
//!
//! It runs beside this process and writes luma as YUV4MPEG2 into a pipe; its filter `showinfo` says
//! on standard error when each frame is shown, which YUV4MPEG2 cannot carry. Both come in the order
//! of frames, so the n-th time belongs to the n-th frame.

use crate::VideoError;
use crate::frame::{MAX_PIXELS, VideoFrame};
use crate::opened::{Elsewhere, MIRRORED, Missing, Opened, stored_bytes};
use crate::program::Program;
use crate::turn::Turn;
use crate::y4m::Y4mReader;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;

/// Planes of 8 bits without stretching them, and the times.
const FILTER: &str =
    "format=pix_fmts=yuv420p|yuvj420p|yuv422p|yuvj422p|yuv444p|yuvj444p,showinfo=checksum=0";

/// Makes whole frames of those that are marked as made of fields, as many as there were. It holds
/// one frame back, which a stream that is followed as it comes cannot wait for.
const DEINTERLACE: &str = "bwdif=mode=send_frame:deint=interlaced";

/// Longest message that is kept, characters.
const MAX_MESSAGE: usize = 300;

/// What may be opened for a file: itself alone. A playlist would otherwise name other files of this
/// computer.
const PROTOCOLS_OF_FILES: &str = "file";

/// What may be opened for an address: others on the network, for playlists and what they point to,
/// and never a file.
const PROTOCOLS_OF_ADDRESSES: &str = "\
    http,https,httpproxy,tls,tcp,udp,udplite,rtp,srtp,rtmp,rtmps,rtmpt,rtmpts,srt,mmsh,mmst,ftp,\
    crypto,data";

/// Containers and coded streams as they are. Left out are all that name other files (playlists,
/// scripts, numbered images) or no file (devices, sources of filters).
const FORMATS: &str = "\
    mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,flv,live_flv,asf,asf_o,\
    ogg,mxf,gxf,nut,rm,ivf,obu,av1,h261,h263,h264,hevc,vvc,vc1,vc1test,dirac,cavsvideo,avs2,avs3,\
    mjpeg,mjpeg_2000,yuv4mpegpipe,dv,wtv,nsv,nuv,smjpeg,mpjpeg,gif,apng,webp_pipe,swf,dxa,fli,\
    roq,vivo,4xm,dhav,lmlm4,r3d,ffm,kux,xmv";

/// Those of streams, whose parts are named by what was fetched before.
const FORMATS_OF_ADDRESSES: &str = "rtsp,sdp,rtp,hls,applehttp,dash,aac,mp3,ac3,eac3,webvtt,sap";

/// Schemes whose connections take a limit of their own. RTSP has one under another name in each
/// version of ffmpeg; it ends with the thread that reads.
const LIMITED_SCHEMES: [&str; 6] = ["http", "https", "rtmp", "rtmps", "tcp", "tls"];

/// How long such a connection may be silent: longer than is usually waited for, which has the
/// better message.
const SILENCE_US: &str = "60000000";

/// Threads of a decoder, and of the filters: each holds pictures of its own, and memory for its
/// calls, so that on a large computer a small file would take gigabytes.
const THREADS: &str = "2";

/// Memory for data of ffmpeg: what any file may take, and more for each of its bytes. A stream may
/// ask for sixteen pictures of any size to be held: of 8K, which takes 450 MB with one, they would
/// be 1.3 GB. This process has up to 200 MB of such pictures beside it.
const ANY_BYTES: u64 = 224 << 20;
const MORE_BYTES: u64 = 64;

/// Pictures in a row for which there is no memory, after which the rest is not tried either: a
/// small file can have sixty thousand, each of which takes its time to fail.
const MAX_WITHOUT_ROOM: usize = 100;

/// Most memory for data that ffmpeg may take for a file.
fn most_bytes(name: &str, live: bool) -> Option<u64> {
    let stored = stored_bytes(Path::new(name)).filter(|_| !live);
    stored.map(|bytes| bytes.saturating_mul(MORE_BYTES).saturating_add(ANY_BYTES))
}

/// Starts ffmpeg on a file or address.
pub(crate) fn open(
    name: &str,
    elsewhere: &Elsewhere,
    program: &Program,
) -> Result<Opened, VideoError> {
    let live = name.contains("://");
    let found = &elsewhere.found;
    let mut command = command(name, live, elsewhere.is_mirrored);
    let pipes = program.start(&mut command, most_bytes(name, live), |child| {
        (child.stdout.take(), child.stderr.take())
    });
    let (stdout, stderr) = pipes.map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => VideoError::NeedsFfmpeg {
            video: name.to_owned(),
            found: found.clone(),
        },
        std::io::ErrorKind::Interrupted => VideoError::Interrupted {
            video: name.to_owned(),
        },
        _ => VideoError::io("ffmpeg", e),
    })?;
    let missing = Missing::default();
    let (messages, said) = listen(stderr, missing.clone(), program.clone())?;
    let mut process = Process {
        name: name.to_owned(),
        program: program.clone(),
        messages: Some(messages),
    };
    let stdout = stdout.ok_or_else(|| process.failure())?;
    let frames = Y4mReader::new(name, BufReader::with_capacity(1 << 20, stdout))
        .map_err(|_| process.failure())?
        .with_whole_frames();
    let before = Before::the_first_frame(&said);
    let is_mirrored = elsewhere.is_mirrored.then(|| MIRRORED.to_owned());
    let interlaced = before.is_interlaced.then(|| interlaced(live).to_owned());
    Ok(Opened {
        live,
        turn: before.turn,
        pixels: frames.pixels(),
        notes: is_mirrored.into_iter().chain(interlaced).collect(),
        missing,
        ..Opened::new(
            format!("{found}, decoded by ffmpeg"),
            Box::new(FfmpegFrames {
                frames,
                num_frames: 0,
                first_ns: before.first_ns,
                said,
                process,
            }),
        )
    })
}

/// What is said of a source that is made of fields.
fn interlaced(live: bool) -> &'static str {
    match live {
        true => {
            "the stream is interlaced and is not deinterlaced while it comes: set the camera to \
             progressive, or record it first"
        }
        false => "the video is interlaced: ffmpeg makes whole frames of its fields (bwdif)",
    }
}

fn command(name: &str, live: bool, is_mirrored: bool) -> Command {
    let mut command = Command::new("ffmpeg");
    command.args(["-hide_banner", "-nostats", "-loglevel", "info", "-nostdin"]);
    let scheme = name.split("://").next().unwrap_or_default();
    if scheme == "rtsp" {
        command.args(["-rtsp_transport", "tcp"]);
    }
    if live && LIMITED_SCHEMES.contains(&scheme) {
        command.args(["-rw_timeout", SILENCE_US]);
    }
    if live {
        command.args(["-fflags", "nobuffer", "-flags", "low_delay"]);
        command.args(["-protocol_whitelist", PROTOCOLS_OF_ADDRESSES]);
        let formats = format!("{FORMATS},{FORMATS_OF_ADDRESSES}");
        command.args(["-format_whitelist", &formats]);
    } else {
        command.args(["-protocol_whitelist", PROTOCOLS_OF_FILES]);
        command.args(["-format_whitelist", FORMATS]);
    }
    if is_mirrored {
        command.arg("-noautorotate");
    }
    let filter = match live {
        true => FILTER.to_owned(),
        false => format!("{FILTER},{DEINTERLACE}"),
    };
    // `file:` so that a name with a colon is not taken for an address
    let input = if live {
        name.to_owned()
    } else {
        format!("file:{name}")
    };
    command
        .args(["-filter_threads", THREADS, "-threads", THREADS])
        .args(["-max_pixels", &MAX_PIXELS.to_string()])
        .args(["-i", &input, "-map", "0:v:0", "-vsync", "passthrough"])
        .args(["-vf", &filter, "-f", "yuv4mpegpipe", "-strict", "-1", "-"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// What ffmpeg says of a video.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Said {
    /// How far it turns frames, degrees anticlockwise.
    Turned(f64),
    /// Time of a frame, ns, and whether it is made of fields.
    Shown(i64, bool),
}

impl Said {
    fn of(line: &str) -> Option<Self> {
        shown_ns(line)
            .map(|time_ns| Self::Shown(time_ns, is_interlaced(line)))
            .or_else(|| turned_degrees(line).map(Self::Turned))
    }
}

/// What ffmpeg says up to the first frame.
#[derive(Debug, Default, PartialEq)]
struct Before {
    turn: Turn,
    first_ns: Option<i64>,
    is_interlaced: bool,
}

impl Before {
    fn the_first_frame(said: &Receiver<Said>) -> Self {
        let mut turn = None;
        for said in said {
            match said {
                // the first is the input's, the second what is left in the output
                Said::Turned(degrees) => turn = turn.or(Some(degrees)),
                Said::Shown(first_ns, is_interlaced) => {
                    return Self {
                        turn: turn.and_then(Turn::from_degrees).unwrap_or_default(),
                        first_ns: Some(first_ns),
                        is_interlaced,
                    };
                }
            }
        }
        Self::default()
    }
}

/// Reads what ffmpeg says: of the video and its frames as they come, its last words at the end.
/// Frames that it cannot decode are counted; where there is no memory for any, it is ended.
fn listen(
    stderr: Option<impl Read + Send + 'static>,
    missing: Missing,
    program: Program,
) -> Result<(JoinHandle<String>, Receiver<Said>), VideoError> {
    let (sender, said) = channel();
    let read = move || {
        let (mut last_words, mut refused) = (String::new(), None);
        let mut without_room = 0;
        let lines = stderr.into_iter().flat_map(|e| BufReader::new(e).lines());
        for line in lines.map_while(Result::ok) {
            missing.add(usize::from(is_undecoded(&line)));
            match Said::of(&line) {
                // nobody listens any more: the rest is still read, or ffmpeg would wait
                Some(said) => {
                    without_room = 0;
                    let _ = sender.send(said);
                }
                None if line.ends_with(" get_buffer() failed") => {
                    without_room += 1;
                    if without_room == MAX_WITHOUT_ROOM {
                        refused = Some(NO_ROOM.to_owned());
                        program.end();
                    }
                }
                None if line.contains("on whitelist") => refused = Some(refusal(&line)),
                None if !line.contains("showinfo") => last_words = line,
                None => {}
            }
        }
        let message = refused.unwrap_or(last_words);
        message.chars().take(MAX_MESSAGE).collect()
    };
    let thread = std::thread::Builder::new().name("ffmpeg messages".into());
    let messages = thread
        .spawn(read)
        .map_err(|e| VideoError::io("ffmpeg", e))?;
    Ok((messages, said))
}

const NO_ROOM: &str = "found pictures that take more memory than a file of its size may";

/// What a line says that tells of a format or protocol that is not allowed:
/// `[hls @ 0x55] Format not on whitelist 'mov,...'`.
fn refusal(line: &str) -> String {
    let what = line.trim_start_matches('[').split([' ', ']']).next();
    let what = what.unwrap_or_default();
    format!(
        "found {what}, which may name other files (a playlist, a script, a device), expected a \
         single video"
    )
}

/// The time in a line of `showinfo`, nanoseconds: `... n:   3 pts:   1501 pts_time:0.0500333 ...`.
fn shown_ns(line: &str) -> Option<i64> {
    if !line.contains("showinfo") {
        return None;
    }
    let word = line.split("pts_time:").nth(1)?.split_whitespace().next()?;
    let seconds: f64 = word.parse().ok()?;
    (seconds.abs() < 1e9).then(|| (seconds * 1e9).round() as i64)
}

/// Whether a line of `showinfo` is of a frame made of fields: `... i:T iskey:1 ...` where whole
/// ones have `i:P`.
fn is_interlaced(line: &str) -> bool {
    let mut words = line.split_whitespace();
    words.any(|word| matches!(word, "i:T" | "i:B"))
}

/// Whether a line says that a frame could not be decoded, or not as a whole.
fn is_undecoded(line: &str) -> bool {
    [
        "Error while decoding stream",
        "Error submitting packet to decoder",
        "corrupt decoded frame",
    ]
    .iter()
    .any(|said| line.contains(said))
}

/// How far frames are turned by a line of the description of the input:
/// `displaymatrix: rotation of -90.00 degrees`.
fn turned_degrees(line: &str) -> Option<f64> {
    let word = line.split("displaymatrix: rotation of ").nth(1)?;
    word.split_whitespace().next()?.parse().ok()
}

/// The running program; it is ended when this is dropped.
struct Process {
    name: String,
    program: Program,
    messages: Option<JoinHandle<String>>,
}

impl Process {
    /// Why it ended, in its own words.
    fn failure(&mut self) -> VideoError {
        self.program.finish();
        let message = self.messages.take().and_then(|m| m.join().ok());
        let message = message.filter(|message| !message.is_empty());
        VideoError::Ffmpeg {
            video: self.name.clone(),
            message: message.unwrap_or_else(|| "it wrote no frame".to_owned()),
        }
    }

    /// What there is to say when it writes no more, after so many frames: nothing where it ended as
    /// it should.
    fn end(&mut self, num_frames: usize) -> Option<VideoError> {
        let status = self.program.wait();
        if status.is_none_or(|status| status.success()) {
            return None;
        }
        Some(VideoError::BrokeOff {
            video: self.name.clone(),
            frames: num_frames,
            reason: self.failure().to_string(),
        })
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.program.finish();
    }
}

struct FfmpegFrames {
    frames: Y4mReader<BufReader<ChildStdout>>,
    num_frames: usize,
    /// Time of the first frame until it is read.
    first_ns: Option<i64>,
    said: Receiver<Said>,
    process: Process,
}

impl Iterator for FfmpegFrames {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        let shown = |said| match said {
            Said::Shown(time_ns, _) => Some(time_ns),
            Said::Turned(_) => None,
        };
        let next_ns = || self.said.iter().find_map(shown);
        let Some(frame) = self.frames.next() else {
            return self.process.end(self.num_frames).map(Err);
        };
        // no time where ffmpeg has ended
        if let Ok(frame) = frame
            && let Some(timestamp_ns) = self.first_ns.take().or_else(next_ns)
        {
            self.num_frames += 1;
            return Some(Ok(VideoFrame {
                timestamp_ns,
                ..frame
            }));
        }
        Some(Err(self.process.failure()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::OsStr;
    #[cfg(unix)]
    use std::os::unix::process::ExitStatusExt;

    /// What is said of a program that says this, and the signal that it was ended by.
    #[cfg(unix)]
    fn heard(lines: &[(&str, usize)]) -> (String, Option<i32>) {
        let program = Program::default();
        let mut waits = Command::new("sh");
        waits.args(["-c", "read line"]).stdin(Stdio::piped());
        let input = program.start(&mut waits, None, |child| child.stdin.take());
        let said: String = lines
            .iter()
            .map(|(line, times)| line.repeat(*times))
            .collect();
        let said = std::io::Cursor::new(said);
        let (messages, _said) = listen(Some(said), Missing::default(), program.clone()).unwrap();
        let message = messages.join().unwrap();
        drop(input.unwrap());
        (message, program.wait().unwrap().signal())
    }

    #[cfg(unix)]
    #[test]
    fn what_finds_no_memory_for_any_picture_is_ended() {
        let failed = "[h264 @ 0x1] get_buffer() failed\n";
        let shown = "[Parsed_showinfo_2 @ 0x55] n: 0 pts: 0 pts_time:0.5\n";
        let last = "Conversion failed!\n";
        let (message, signal) = heard(&[(failed, 100), (last, 1)]);
        assert_eq!((message.as_str(), signal), (NO_ROOM, Some(9)));
        // some are too large, and others are not
        let (message, signal) = heard(&[(failed, 99), (shown, 1), (failed, 99), (last, 1)]);
        assert_eq!((message.as_str(), signal), (last.trim(), None));
    }

    /// The value of an option, which must stand in front of the input that it is of.
    fn value(name: &str, option: &str) -> String {
        let command = command(name, name.contains("://"), false);
        let words: Vec<&str> = command.get_args().filter_map(OsStr::to_str).collect();
        let input = words.iter().position(|word| *word == "-i").unwrap();
        let at = words[..input].iter().position(|word| *word == option);
        words[at.expect(option) + 1].to_owned()
    }

    #[test]
    fn a_source_may_open_and_hold_only_so_much() {
        for name in ["a.mkv", "rtsp://camera/x"] {
            for option in ["-threads", "-filter_threads"] {
                assert_eq!(value(name, option), "2", "on any computer");
            }
            assert_eq!(value(name, "-max_pixels"), "33554432");
            let formats = value(name, "-format_whitelist");
            let formats: Vec<&str> = formats.split(',').collect();
            let refused = ["concat", "lavfi", "image2", "v4l2", "ffmetadata"];
            assert!(refused.iter().all(|format| !formats.contains(format)));
            assert_eq!(formats.contains(&"hls"), name.contains("://"));
        }
        assert_eq!(value("a.mkv", "-protocol_whitelist"), "file");
        let protocols = value("rtsp://camera/x", "-protocol_whitelist");
        let mut protocols = protocols.split(',');
        assert!(
            protocols.all(|protocol| !["file", "pipe", "concat", "subfile"].contains(&protocol))
        );
    }

    #[test]
    fn memory_is_bounded_by_the_bytes_of_a_file() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
        let bytes = std::fs::metadata(file).unwrap().len();
        let most = most_bytes(file, false).unwrap();
        assert_eq!(most, (224 << 20) + 64 * bytes);
        assert_eq!(most_bytes("rtsp://camera/x", true), None, "has no size");
    }

    #[test]
    fn the_turn_of_the_input() {
        let lines = [
            "Input #0, mov,mp4,m4a,3gp,3g2,mj2, from 'video.mp4':",
            "      displaymatrix: rotation of -90.00 degrees",
            "      displaymatrix: rotation of -0.00 degrees",
            "[Parsed_showinfo_1 @ 0x55] n:   0 pts:   1501 pts_time:0.5 duration: 500 i:P iskey:1",
            "[Parsed_showinfo_1 @ 0x55] n:   1 pts:   1501 pts_time:0.6 duration: 500 i:T iskey:0",
        ];
        let (sender, said) = channel();
        for said in lines.into_iter().filter_map(Said::of) {
            sender.send(said).unwrap();
        }
        drop(sender);
        let before = Before::the_first_frame(&said);
        let expected = Before {
            turn: Turn::Quarter,
            first_ns: Some(500_000_000),
            is_interlaced: false,
        };
        assert_eq!(before, expected);
        assert_eq!(said.recv(), Ok(Said::Shown(600_000_000, true)));
        assert_eq!(Before::the_first_frame(&said), Before::default());
    }

    #[test]
    fn frames_that_could_not_be_decoded_are_counted() {
        assert!(is_undecoded(
            "Error while decoding stream #0:0: Invalid data found when processing input"
        ));
        assert!(is_undecoded("video.mkv: corrupt decoded frame in stream 0"));
        assert!(!is_undecoded("[h264 @ 0x1] mmco: unref short failure"));
    }

    #[test]
    fn what_is_refused_is_named() {
        let said = refusal("[hls @ 0x55] Format not on whitelist 'mov,mp4'");
        assert!(said.starts_with("found hls, which"), "{said}");
    }

    #[test]
    fn times_of_showinfo() {
        let line = "[Parsed_showinfo_2 @ 0x55] n:   3 pts:   1501 pts_time:0.0500333 duration: 500";
        assert_eq!(shown_ns(line), Some(50_033_300));
        assert_eq!(
            shown_ns("[Parsed_showinfo_2 @ 0x55] config in time_base: 1/1000"),
            None
        );
        assert_eq!(shown_ns("Input #0, mov, from 'pts_time:3': "), None);
        assert_eq!(
            shown_ns("[Parsed_showinfo_2 @ 0] n: 0 pts: NOPTS pts_time:NOPTS"),
            None
        );
    }
}
