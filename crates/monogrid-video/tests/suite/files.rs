//! Files come out as ffmpeg decodes them: pixels, order and times.
//!
//! `tests/data` was made with ffmpeg 5.1 from its test pattern:
//! `ffmpeg -f lavfi -i testsrc2=size=64x48:rate=30:duration=1 -c:v libx264 -bf 2 -g 12
//! reordered.mp4`, copies of it with `-metadata:s:v:0 rotate=90` (upright.mp4) and `-ss 0.3`
//! (cut.mp4), and the first 0.2 s in other codecs. Sums are those of
//! `ffmpeg -i FILE -vsync passthrough -vf format=yuv420p,extractplanes=y -f rawvideo -`.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "tests")]

use monogrid_geometry::ReadoutDirection;
use monogrid_video::{Colour, Video, VideoError, VideoFrame};
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data")
        .join(name)
}

/// All frames; panics where one cannot be decoded.
fn frames(path: &Path) -> Vec<VideoFrame> {
    Video::open(path).unwrap().map(Result::unwrap).collect()
}

fn sum_of_luma(frames: &[VideoFrame]) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    for frame in frames {
        sum.update(frame.image.as_slice());
    }
    sum.finalize()
}

#[test]
fn h264_with_reordered_frames() {
    let video = Video::open(data("reordered.mp4")).unwrap();
    assert_eq!((video.size(), video.length()), ((64, 48), Some(30)));
    assert!(!video.is_live());
    let frames = frames(&data("reordered.mp4"));
    assert_eq!(sum_of_luma(&frames), 0xfe37_f369);
    let times: Vec<i64> = frames.iter().map(|f| f.timestamp_ns).collect();
    let expected: Vec<i64> = (0..30).map(|i| i * 1_000_000_000 / 30).collect();
    assert_eq!(times, expected);
}

#[test]
fn filmed_upright() {
    let frames = frames(&data("upright.mp4"));
    assert_eq!(
        (frames[0].image.width(), frames[0].image.height()),
        (48, 64)
    );
    assert_eq!((frames.len(), sum_of_luma(&frames)), (30, 0xebff_01fc));
    let direction = |name| Video::open(data(name)).unwrap().readout_direction();
    assert_eq!(direction("upright.mp4"), ReadoutDirection::Right);
    assert_eq!(direction("reordered.mp4"), ReadoutDirection::Down);
}

/// What [`mean_colours`] is of the first frames.
const H264_COLOURS: [[f64; 3]; 2] = [[77.2, 59.8, 57.1], [157.1, 0.2, 1.7]];
const H265_COLOURS: [[f64; 3]; 2] = [[78.2, 60.2, 57.7], [158.5, 0.8, 2.0]];

/// Mean red, green and blue of a frame, and of a part of it that is red.
fn mean_colours(frame: &VideoFrame) -> [[f64; 3]; 2] {
    let (width, height) = (frame.image.width(), frame.image.height());
    let Colour::Chroma(chroma) = &frame.colour else {
        panic!("no colour");
    };
    let chroma_at_size = chroma.at_size((width, height));
    let mean = |from: (usize, usize), to: (usize, usize)| {
        let mut sum = [0.0; 3];
        for (x, y) in (from.0..to.0).flat_map(|x| (from.1..to.1).map(move |y| (x, y))) {
            let rgb = chroma
                .space()
                .rgb(frame.image.at(x, y), chroma_at_size.at(x, y));
            (0..3).for_each(|c| sum[c] += f64::from(rgb[c]));
        }
        sum.map(|sum| sum / ((to.0 - from.0) * (to.1 - from.1)) as f64)
    };
    [mean((0, 0), (width, height)), mean((2, 30), (12, 46))]
}

/// Colours as ffmpeg shows them (`-pix_fmt rgb24`).
fn assert_colours(frame: &VideoFrame, expected: [[f64; 3]; 2]) {
    let found = mean_colours(frame);
    let differences = found.iter().flatten().zip(expected.iter().flatten());
    for (found, expected) in differences {
        assert!((found - expected).abs() < 4.0, "{found} {expected}");
    }
}

#[test]
fn colours_of_h264() {
    assert_colours(&frames(&data("reordered.mp4"))[0], H264_COLOURS);
    let upright = &frames(&data("upright.mp4"))[0];
    let [whole, _] = mean_colours(upright);
    for (found, expected) in whole.iter().zip(H264_COLOURS[0]) {
        assert!((found - expected).abs() < 4.0, "{found} {expected}");
    }
}

#[test]
fn an_edit_list_leaves_frames_out() {
    let frames = frames(&data("cut.mp4"));
    assert_eq!((frames.len(), sum_of_luma(&frames)), (21, 0xcb49_02cf));
    assert_eq!(frames[0].timestamp_ns, 0);
    assert_eq!(frames[20].timestamp_ns, 666_666_666);
    assert_eq!(Video::open(data("cut.mp4")).unwrap().length(), Some(21));
}

#[test]
fn mjpeg_in_avi() {
    let video = Video::open(data("mjpeg.avi")).unwrap();
    assert_eq!(video.length(), Some(6));
    let frames = frames(&data("mjpeg.avi"));
    let source = self::frames(&data("reordered.mp4"));
    assert_eq!(frames.len(), 6);
    let is_jpeg =
        |colour: &Colour| matches!(colour, Colour::Jpeg(b) if b.starts_with(&[0xff, 0xd8]));
    assert!(frames.iter().all(|frame| is_jpeg(&frame.colour)));
    for (frame, source) in frames.iter().zip(&source) {
        let (a, b) = (frame.image.as_slice(), source.image.as_slice());
        // MJPEG has the full range, H.264 that of television
        let full = |v: u8| (f64::from(v) - 16.0) * 255.0 / 219.0;
        let difference = |(a, b): (&u8, &u8)| (f64::from(*a) - full(*b).clamp(0.0, 255.0)).abs();
        let mean = a.iter().zip(b).map(difference).sum::<f64>() / a.len() as f64;
        assert!(mean < 3.0, "{mean}");
        assert!(source.timestamp_ns.abs_diff(frame.timestamp_ns) < 2);
    }
}

/// A recording below the folder that MONOGRID_DATA names.
fn recording(name: &str) -> PathBuf {
    let folder = std::env::var_os("MONOGRID_DATA");
    let folder = folder.expect("MONOGRID_DATA names the folder of recorded sequences");
    let path = PathBuf::from(folder).join(name);
    assert!(path.exists(), "{} is absent", path.display());
    path
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn a_phone_video_of_real_data() {
    let path = recording("phone-desk/video.mp4");
    let mut video = Video::open(&path).unwrap();
    assert_eq!((video.size(), video.length()), ((364, 674), Some(1400)));
    let mut sum = crc32fast::Hasher::new();
    let mut times = Vec::new();
    for frame in video.by_ref() {
        let frame = frame.unwrap();
        sum.update(frame.image.as_slice());
        times.push(frame.timestamp_ns);
    }
    assert_eq!((times.len(), sum.finalize()), (1400, 0x8b9c_f2b2));
    assert!(times.is_sorted_by(|a, b| a < b));
    assert_eq!((times[0], times[1399]), (0, 22_865_000_000));
    // its editor swapped the times of some frames of the beginning by microseconds
    assert_eq!(video.repaired_times(), 14);
    // which is no reason to warn
    assert!(video.faults().is_empty(), "{:?}", video.faults());
}

fn ffmpeg_is_there() -> bool {
    let there = std::process::Command::new("ffmpeg")
        .arg("-version")
        .output()
        .is_ok_and(|output| output.status.success());
    if !there {
        eprintln!("SKIPPED: ffmpeg is not installed");
    }
    there
}

#[test]
fn other_codecs_through_ffmpeg() {
    if !ffmpeg_is_there() {
        return;
    }
    let video = Video::open(data("h265.mp4")).unwrap();
    assert_eq!(video.description(), "H.265 (HEVC), decoded by ffmpeg");
    let frames: Vec<VideoFrame> = video.map(Result::unwrap).collect();
    assert_eq!((frames.len(), sum_of_luma(&frames)), (6, 0xcaac_5b40));
    assert!(frames[5].timestamp_ns.abs_diff(166_666_667) < 1000);
    assert_colours(&frames[0], H265_COLOURS);
    // the turn is in the container
    let folder = tempfile::tempdir().unwrap();
    let turned = folder.path().join("turned.mp4");
    let made = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(data("h265.mp4"))
        .args(["-c", "copy", "-metadata:s:v:0", "rotate=90"])
        .arg(&turned)
        .status();
    assert!(made.unwrap().success());
    let video = Video::open(&turned).unwrap();
    // ffmpeg 6 and later ignore this way of saying it
    if video.size() == (48, 64) {
        assert_eq!(video.readout_direction(), ReadoutDirection::Right);
    }
}

#[test]
fn a_file_that_ffmpeg_does_not_know_either() {
    if !ffmpeg_is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a:b.mkv");
    std::fs::write(&path, "this is no video at all, whatever its name says").unwrap();
    let error = Video::open(&path).unwrap_err();
    assert!(matches!(error, VideoError::Ffmpeg { .. }), "{error}");
    assert!(error.to_string().contains("Invalid data"), "{error}");
}

#[test]
fn what_is_no_video() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(
        Video::open(folder.path().join("none.mp4")),
        Err(VideoError::Missing { .. })
    ));
    let empty = folder.path().join("empty.mp4");
    std::fs::write(&empty, "").unwrap();
    assert!(matches!(
        Video::open(&empty),
        Err(VideoError::Content { .. })
    ));
    assert!(matches!(
        Video::open(folder.path()),
        Err(VideoError::Content { .. })
    ));
    let cut = folder.path().join("cut.mp4");
    std::fs::write(&cut, &std::fs::read(data("reordered.mp4")).unwrap()[..2000]).unwrap();
    let error = Video::open(&cut).unwrap_err().to_string();
    assert!(error.contains("was not finished"), "{error}");
    assert!(matches!(
        Video::open("/dev/video999"),
        Err(VideoError::Missing { .. })
    ));
}
