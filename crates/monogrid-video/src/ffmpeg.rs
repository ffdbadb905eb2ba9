//! All other codecs and streams, through the program `ffmpeg`.
//!
//! It runs beside this process and writes luma as YUV4MPEG2 into a pipe; its filter `showinfo` says on
//! standard error when each frame is shown, which YUV4MPEG2 cannot carry. Both come in the order of
//! frames, so the n-th time belongs to the n-th frame.

use crate::program::Program;
use crate::turn::Turn;
use crate::y4m::Y4mReader;
use crate::{Opened, VideoError, VideoFrame};
use std::io::{BufRead, BufReader};
use std::process::{ChildStderr, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;

/// What installs ffmpeg on this system.
pub(crate) const INSTALL_COMMAND: &str = if cfg!(target_os = "macos") {
    "brew install ffmpeg"
} else if cfg!(windows) {
    "winget install ffmpeg"
} else {
    "sudo apt install ffmpeg"
};

/// Planes of 8 bits without stretching them, and the times.
const FILTER: &str =
    "format=pix_fmts=yuv420p|yuvj420p|yuv422p|yuvj422p|yuv444p|yuvj444p,showinfo=checksum=0";

/// Longest message that is kept, characters.
const MAX_MESSAGE: usize = 300;

/// What may be opened for a file: itself alone. A playlist would otherwise name other files of this computer.
const PROTOCOLS_OF_FILES: &str = "file";

/// What may be opened for an address: others on the network, for playlists and what they point to, and never a file.
const PROTOCOLS_OF_ADDRESSES: &str = "http,https,httpproxy,tls,tcp,udp,udplite,rtp,srtp,rtmp,rtmps,rtmpt,rtmpts,srt,mmsh,mmst,ftp,crypto,data";

/// Containers and coded streams as they are. Left out are all that name other files (playlists, scripts, numbered images) or no file
/// (devices, sources of filters).
const FORMATS: &str = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,flv,live_flv,asf,asf_o,ogg,mxf,gxf,nut,\
rm,ivf,obu,av1,h261,h263,h264,hevc,vvc,vc1,vc1test,dirac,cavsvideo,avs2,avs3,mjpeg,mjpeg_2000,yuv4mpegpipe,dv,wtv,nsv,nuv,smjpeg,\
mpjpeg,gif,apng,webp_pipe,swf,dxa,fli,roq,vivo,4xm,dhav,lmlm4,r3d,ffm,kux,xmv";

/// Those of streams, whose parts are named by what was fetched before.
const FORMATS_OF_ADDRESSES: &str = "rtsp,sdp,rtp,hls,applehttp,dash,aac,mp3,ac3,eac3,webvtt,sap";

/// Schemes whose connections take a limit of their own. RTSP has one under another name in each version of ffmpeg; it ends with
/// the thread that reads.
const LIMITED_SCHEMES: [&str; 6] = ["http", "https", "rtmp", "rtmps", "tcp", "tls"];

/// How long such a connection may be silent: longer than is usually waited for, which has the better message.
const SILENCE_US: &str = "60000000";

/// Starts ffmpeg on a file or address; `found` says why it is not decoded here.
pub(crate) fn open(name: &str, found: &str, program: &Program) -> Result<Opened, VideoError> {
    let live = name.contains("://");
    let pipes = program.start(&mut command(name, live), |child| {
        (child.stdout.take(), child.stderr.take())
    });
    let (stdout, stderr) = pipes.map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => VideoError::NeedsFfmpeg {
            video: name.to_owned(),
            found: found.to_owned(),
        },
        std::io::ErrorKind::Interrupted => VideoError::Interrupted {
            video: name.to_owned(),
        },
        _ => VideoError::io("ffmpeg", e),
    })?;
    let (messages, said) = listen(stderr)?;
    let mut process = Process {
        name: name.to_owned(),
        program: program.clone(),
        messages: Some(messages),
    };
    let stdout = stdout.ok_or_else(|| process.failure())?;
    let frames = Y4mReader::new(name, BufReader::with_capacity(1 << 20, stdout))
        .map_err(|_| process.failure())?;
    let (turn, first_ns) = before_the_first_frame(&said);
    Ok(Opened {
        description: format!("{found}, decoded by ffmpeg"),
        length: None,
        live,
        turn,
        frames: Box::new(FfmpegFrames {
            frames,
            num_frames: 0,
            first_ns,
            said,
            process,
        }),
    })
}

fn command(name: &str, live: bool) -> Command {
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
    // `file:` so that a name with a colon is not taken for an address
    let input = if live {
        name.to_owned()
    } else {
        format!("file:{name}")
    };
    command
        .args(["-i", &input, "-map", "0:v:0", "-vsync", "passthrough"])
        .args(["-vf", FILTER, "-f", "yuv4mpegpipe", "-strict", "-1", "-"])
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
    /// Time of a frame, ns.
    Shown(i64),
}

impl Said {
    fn of(line: &str) -> Option<Self> {
        shown_ns(line)
            .map(Self::Shown)
            .or_else(|| turned_degrees(line).map(Self::Turned))
    }
}

/// How frames are turned, and the time of the first one.
fn before_the_first_frame(said: &Receiver<Said>) -> (Turn, Option<i64>) {
    let mut turn = None;
    for said in said {
        match said {
            // the first is the input's, the second what is left in the output
            Said::Turned(degrees) => turn = turn.or(Some(degrees)),
            Said::Shown(first_ns) => {
                let turn = turn.and_then(Turn::from_degrees);
                return (turn.unwrap_or_default(), Some(first_ns));
            }
        }
    }
    (Turn::None, None)
}

/// Reads what ffmpeg says: of the video and its frames as they come, its last words at the end.
fn listen(stderr: Option<ChildStderr>) -> Result<(JoinHandle<String>, Receiver<Said>), VideoError> {
    let (sender, said) = channel();
    let read = move || {
        let (mut last_words, mut refused) = (String::new(), None);
        let lines = stderr.into_iter().flat_map(|e| BufReader::new(e).lines());
        for line in lines.map_while(Result::ok) {
            match Said::of(&line) {
                // nobody listens any more: the rest is still read, or ffmpeg would wait
                Some(said) => drop(sender.send(said)),
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

/// What a line says that tells of a format or protocol that is not allowed: `[hls @ 0x55] Format not on whitelist 'mov,...'`.
fn refusal(line: &str) -> String {
    let what = line.trim_start_matches('[').split([' ', ']']).next();
    let what = what.unwrap_or_default();
    format!(
        "found {what}, which may name other files (a playlist, a script, a device), expected a single video"
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

/// How far frames are turned by a line of the description of the input: `displaymatrix: rotation of -90.00 degrees`.
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

    /// What there is to say when it writes no more, after so many frames: nothing where it ended as it should.
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
            Said::Shown(time_ns) => Some(time_ns),
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
    use super::{Said, before_the_first_frame, refusal, shown_ns};
    use crate::turn::Turn;
    use std::sync::mpsc::channel;

    #[test]
    fn the_turn_of_the_input() {
        let lines = [
            "Input #0, mov,mp4,m4a,3gp,3g2,mj2, from 'video.mp4':",
            "      displaymatrix: rotation of -90.00 degrees",
            "      displaymatrix: rotation of -0.00 degrees",
            "[Parsed_showinfo_1 @ 0x55] n:   0 pts:   1501 pts_time:0.5 duration: 500",
            "[Parsed_showinfo_1 @ 0x55] n:   1 pts:   1501 pts_time:0.6 duration: 500",
        ];
        let (sender, said) = channel();
        for said in lines.into_iter().filter_map(Said::of) {
            sender.send(said).unwrap();
        }
        drop(sender);
        let before = before_the_first_frame(&said);
        assert_eq!(before, (Turn::Quarter, Some(500_000_000)));
        assert_eq!(said.recv(), Ok(Said::Shown(600_000_000)));
        assert_eq!(before_the_first_frame(&said), (Turn::None, None));
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
