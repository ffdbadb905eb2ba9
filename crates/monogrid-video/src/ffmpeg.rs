//! All other codecs and streams, through the program `ffmpeg`.
//!
//! It runs beside this process and writes luma as YUV4MPEG2 into a pipe; its filter `showinfo` says on
//! standard error when each frame is shown, which YUV4MPEG2 cannot carry. Both come in the order of
//! frames, so the n-th time belongs to the n-th frame.

use crate::turn::Turn;
use crate::y4m::Y4mReader;
use crate::{Opened, VideoError, VideoFrame};
use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
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

/// Starts ffmpeg on a file or address; `found` says why it is not decoded here.
pub(crate) fn open(name: &str, found: &str) -> Result<Opened, VideoError> {
    let live = name.contains("://");
    let mut child = command(name, live).spawn().map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => VideoError::NeedsFfmpeg {
            video: name.to_owned(),
            found: found.to_owned(),
        },
        _ => VideoError::io("ffmpeg", e),
    })?;
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let (messages, said) = listen(stderr)?;
    let mut process = Process {
        name: name.to_owned(),
        child,
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
            first_ns,
            said,
            process,
        }),
    })
}

fn command(name: &str, live: bool) -> Command {
    let mut command = Command::new("ffmpeg");
    command.args(["-hide_banner", "-nostats", "-loglevel", "info", "-nostdin"]);
    if name.starts_with("rtsp://") {
        command.args(["-rtsp_transport", "tcp"]);
    }
    if live {
        command.args(["-fflags", "nobuffer", "-flags", "low_delay"]);
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
        let mut last_words = String::new();
        let lines = stderr.into_iter().flat_map(|e| BufReader::new(e).lines());
        for line in lines.map_while(Result::ok) {
            match Said::of(&line) {
                // nobody listens any more: the rest is still read, or ffmpeg would wait
                Some(said) => drop(sender.send(said)),
                None if !line.contains("showinfo") => last_words = line,
                None => {}
            }
        }
        last_words.chars().take(MAX_MESSAGE).collect()
    };
    let thread = std::thread::Builder::new().name("ffmpeg messages".into());
    let messages = thread
        .spawn(read)
        .map_err(|e| VideoError::io("ffmpeg", e))?;
    Ok((messages, said))
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
    child: Child,
    messages: Option<JoinHandle<String>>,
}

impl Process {
    /// Why it ended, in its own words.
    fn failure(&mut self) -> VideoError {
        drop(self.child.kill());
        let message = self.messages.take().and_then(|m| m.join().ok());
        let message = message.filter(|message| !message.is_empty());
        VideoError::Ffmpeg {
            video: self.name.clone(),
            message: message.unwrap_or_else(|| "it wrote no frame".to_owned()),
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

struct FfmpegFrames {
    frames: Y4mReader<BufReader<ChildStdout>>,
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
        // no time where ffmpeg has ended
        if let Ok(frame) = self.frames.next()?
            && let Some(timestamp_ns) = self.first_ns.take().or_else(next_ns)
        {
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
    use super::{Said, before_the_first_frame, shown_ns};
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
