//! Cameras of this computer (V4L2, Linux).

#[cfg(target_os = "linux")]
mod v4l2;

#[cfg(any(target_os = "linux", test))]
mod convert;

use crate::VideoError;
use crate::opened::Opened;
use std::path::{Path, PathBuf};

/// A camera that this computer has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraInfo {
    /// Its device file: what [`crate::Video::open`] takes.
    pub path: PathBuf,
    /// As its maker calls it.
    pub name: String,
    /// Sizes and formats that it offers, for people (`640x480 YUYV`); only those that can be used.
    pub modes: Vec<String>,
}

/// The cameras of this computer that deliver YUYV, MJPEG or grey, in the order of their device
/// files.
#[must_use]
pub fn list_cameras() -> Vec<CameraInfo> {
    #[cfg(target_os = "linux")]
    return v4l2::list(Path::new("/dev"));
    #[cfg(not(target_os = "linux"))]
    Vec::new()
}

/// Whether a path names a camera.
pub(crate) fn is_camera(path: &Path) -> bool {
    path.parent() == Some(Path::new("/dev"))
        && (path.file_name()).is_some_and(|name| name.to_string_lossy().starts_with("video"))
}

/// Opens a camera.
pub(crate) fn open(path: &Path) -> Result<Opened, VideoError> {
    #[cfg(target_os = "linux")]
    return v4l2::open(path);
    #[cfg(not(target_os = "linux"))]
    Err(VideoError::Camera {
        camera: path.to_string_lossy().into_owned(),
        reason: "cameras are read on Linux only; on other systems pipe one with `ffmpeg ... -f \
                 yuv4mpegpipe - | monogrid run -`"
            .to_owned(),
    })
}
