//! Capturing from a V4L2 camera.

use super::CameraInfo;
use super::convert::{BufferLayout, FORMATS, PixelFormat, decoded};
use crate::VideoError;
use crate::frame::VideoFrame;
use crate::opened::Opened;
use moq_v4l::buffer::Type;
use moq_v4l::control::{Control, Value};
use moq_v4l::framesize::FrameSizeEnum;
use moq_v4l::io::mmap::Stream;
use moq_v4l::io::traits::CaptureStream;
use moq_v4l::video::Capture;
use moq_v4l::{Device, Format, FourCC};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Size that is asked for, px: what tracking works at.
const WANTED_SIZE: (u32, u32) = (640, 480);

/// Buffers that the driver fills: a late reader loses frames, not the stream.
const BUFFERS: u32 = 4;

/// How long a camera may deliver nothing.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Controls that keep brightness and sharpness as they are: identifier (`linux/v4l2-controls.h`),
/// value and what it locks. Cameras without one of them refuse it, which changes nothing.
const LOCKS: [(u32, i64, &str); 3] = [
    (0x009a_0901, 1, "exposure"), // V4L2_CID_EXPOSURE_AUTO: manual
    (0x009a_090c, 0, "focus"),    // V4L2_CID_FOCUS_AUTO: off
    (0x0098_0912, 0, "gain"),     // V4L2_CID_AUTOGAIN: off
];

/// The cameras whose device files lie in a folder.
pub(super) fn list(folder: &Path) -> Vec<CameraInfo> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let numbered = entries.filter_map(|entry| {
        let name = entry.file_name();
        let number = name.to_str()?.strip_prefix("video")?.parse().ok()?;
        Some((number, entry.path()))
    });
    let mut paths: Vec<(u32, PathBuf)> = numbered.collect();
    paths.sort();
    let paths = paths.into_iter();
    paths.filter_map(|(_, path)| describe(path)).collect()
}

/// `None` for devices that are no cameras, or have no format that can be used.
fn describe(path: PathBuf) -> Option<CameraInfo> {
    let device = Device::with_path(&path).ok()?;
    let name = device.query_caps().ok()?.card;
    let mut modes = Vec::new();
    for (_, code) in usable_formats(&device) {
        let label = String::from_utf8_lossy(&code).into_owned();
        let sizes = device.enum_framesizes(FourCC::new(&code));
        for size in sizes.unwrap_or_default() {
            modes.push(match size.size {
                FrameSizeEnum::Discrete(s) => format!("{}x{} {label}", s.width, s.height),
                FrameSizeEnum::Stepwise(s) => {
                    format!("up to {}x{} {label}", s.max_width, s.max_height)
                }
            });
        }
    }
    (!modes.is_empty()).then_some(CameraInfo { path, name, modes })
}

/// The formats of a camera that can be used, best first.
fn usable_formats(device: &Device) -> Vec<(PixelFormat, [u8; 4])> {
    let offered = device.enum_formats().unwrap_or_default();
    FORMATS
        .into_iter()
        .filter(|(_, code)| offered.iter().any(|format| &format.fourcc.repr == code))
        .collect()
}

/// Opens a camera, locks exposure and focus where it can, and starts the stream.
pub(super) fn open(path: &Path) -> Result<Opened, VideoError> {
    let name = path.to_string_lossy().into_owned();
    let refused = |reason: String| VideoError::Camera {
        camera: name.clone(),
        reason,
    };
    let device = Device::with_path(path).map_err(|e| VideoError::io(&name, e))?;
    let (format, code) = *usable_formats(&device).first().ok_or_else(|| {
        refused("no format that can be used; expected GREY, YUYV or MJPG".to_owned())
    })?;
    let (width, height) = WANTED_SIZE;
    let set = device
        .set_format(&Format::new(width, height, FourCC::new(&code)))
        .map_err(|e| refused(format!("cannot set {width}x{height}: {e}")))?;
    if set.fourcc.repr != code {
        return Err(refused(format!("it delivers {} instead", set.fourcc)));
    }
    let mut stream = Stream::with_buffers(&device, Type::VideoCapture, BUFFERS)
        .map_err(|e| refused(format!("cannot capture: {e}")))?;
    stream.set_timeout(TIMEOUT);
    let locked = lock(&device);
    let label = String::from_utf8_lossy(&code).into_owned();
    let frames = CameraFrames {
        name,
        stream,
        layout: BufferLayout {
            format,
            width: set.width as usize,
            height: set.height as usize,
            stride: set.stride as usize,
        },
        begin: None,
        frame: 0,
    };
    let description = format!("V4L2 camera, {label}, locked: {locked}");
    Ok(Opened {
        live: true,
        ..Opened::new(description, Box::new(frames))
    })
}

/// Locks what can be locked, and says what was.
fn lock(device: &Device) -> String {
    let locked: Vec<&str> = LOCKS
        .into_iter()
        .filter(|&(id, value, _)| {
            let value = Value::Integer(value);
            device.set_control(Control { id, value }).is_ok()
        })
        .map(|(_, _, what)| what)
        .collect();
    if locked.is_empty() {
        "nothing".to_owned()
    } else {
        locked.join(", ")
    }
}

struct CameraFrames {
    name: String,
    stream: Stream<'static>,
    layout: BufferLayout,
    /// When the driver filled the first buffer, microseconds of its clock.
    begin: Option<i64>,
    frame: usize,
}

impl Iterator for CameraFrames {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        let (buffer, metadata) = match self.stream.next() {
            Ok(filled) => filled,
            Err(e) => return Some(Err(VideoError::io(&self.name, e))),
        };
        let time = metadata.timestamp;
        let now_us = time.sec.saturating_mul(1_000_000).saturating_add(time.usec);
        let begin_us = *self.begin.get_or_insert(now_us);
        let number = self.frame;
        self.frame += 1;
        let filled = match self.layout.format {
            PixelFormat::Mjpeg => buffer.get(..metadata.bytesused as usize).unwrap_or(buffer),
            PixelFormat::Yuyv | PixelFormat::Grey => buffer,
        };
        let decoded = decoded(filled, self.layout, &self.name);
        let frame = decoded.map(|(image, colour)| VideoFrame {
            image,
            colour,
            timestamp_ns: now_us.saturating_sub(begin_us).saturating_mul(1000),
        });
        Some(frame.map_err(|reason| VideoError::frame(&self.name, number, reason)))
    }
}

#[cfg(test)]
mod tests {
    use super::list;

    #[test]
    fn files_that_are_no_cameras_are_not_listed() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(list(folder.path()), []);
        std::fs::write(folder.path().join("video0"), "no device").unwrap();
        std::fs::write(folder.path().join("videos"), "").unwrap();
        assert_eq!(list(folder.path()), []);
        assert_eq!(list(&folder.path().join("nowhere")), []);
    }
}
