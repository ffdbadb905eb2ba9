//! Videos: MP4 and MOV with H.264 and with what a camera wrote beside it, AVI with MJPEG,
//! YUV4MPEG2. A decoder ends, with frames of one frame's worth of memory or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_video::{Video, read_telemetry};
use std::io::Write;

/// Frames that are decoded at most.
const MAX_FRAMES: usize = 100;

fuzz_target!(|bytes: &[u8]| {
    // damage that leads to ffmpeg would only test ffmpeg, which is looked for in the usual places
    // where there is no PATH at all SAFETY: libFuzzer calls this from one thread, and no decoder of
    // an earlier call is left that could read the environment
    unsafe { std::env::set_var("PATH", "/dev/null") };
    let mut file = tempfile::NamedTempFile::new_in("/dev/shm").expect("a file in memory");
    file.write_all(bytes).expect("room in memory");
    let _ = read_telemetry(file.path());
    if let Ok(video) = Video::open(file.path()) {
        let size = video.size();
        for frame in video.take(MAX_FRAMES).flatten() {
            assert!(
                frame.image.width() > 0 && frame.image.height() > 0,
                "{size:?}"
            );
        }
    }
});
