//! Recordings that were made to harm: right checksums, and numbers that are not.

use super::recording::{file_of_size, record_bytes};
use monogrid_datasets::{
    Continuation, DatasetError, DepthPixel, KeyframeLink, KeyframeRecord, PoseSnapshot,
    ReadOptions, Record, RecordedEdge, RecordedFrame, RecordedPoint, RecordedSession, Recording,
    RecordingReader,
};
use monogrid_geometry::{Se3, Sim3};
use monogrid_image::Image;
use std::cell::Cell;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;
use std::rc::Rc;

/// Counts the bytes that are read.
struct Counted {
    file: Cursor<Vec<u8>>,
    bytes_read: Rc<Cell<usize>>,
}

impl Read for Counted {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read(out)?;
        self.bytes_read.set(self.bytes_read.get() + count);
        Ok(count)
    }
}

impl Seek for Counted {
    fn seek(&mut self, position: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(position)
    }
}

/// Number of records of a file, and how often its bytes were read.
fn records_and_passes(file: Vec<u8>) -> (usize, f64) {
    let bytes = file.len();
    let bytes_read = Rc::new(Cell::new(0));
    let input = Counted {
        file: Cursor::new(file),
        bytes_read: Rc::clone(&bytes_read),
    };
    let path = Path::new("crafted.mgk");
    let reader = RecordingReader::new(input, path, ReadOptions::default()).expect("a recording");
    let records: Vec<_> = reader.collect::<Result<_, _>>().expect("no read error");
    (records.len(), bytes_read.get() as f64 / bytes as f64)
}

fn read(file: &[u8]) -> Result<Recording, DatasetError> {
    let path = Path::new("crafted.mgk");
    let reader = RecordingReader::new(Cursor::new(file), path, ReadOptions::default())?;
    Recording::collect(reader, path)
}

#[test]
fn the_next_record_is_found_in_linear_time() {
    const BYTES: usize = 4 << 20;
    let whole = file_of_size(64, 48, &[]);
    // nothing but marks
    let mut marks = whole.clone();
    marks.extend(b"RMGK".repeat(BYTES / 4));
    marks.extend(record_bytes(77, b""));
    let (records, passes) = records_and_passes(marks);
    assert_eq!(records, 1);
    assert!(passes < 2.0, "{passes}");
    // headers that are right, of records that reach to the end and are not
    for last in [0, 7] {
        let mut headers = whole.clone();
        let end = whole.len() + BYTES;
        while headers.len() + 20 + last <= end {
            let payload_bytes = (end - headers.len() - 20 - last) as u32;
            let start = headers.len();
            headers.extend(b"RMGK");
            headers.extend(2_u32.to_le_bytes());
            headers.extend(payload_bytes.to_le_bytes());
            headers.extend(0_u32.to_le_bytes());
            let checksum = crc32fast::hash(&headers[start..]);
            headers.extend(checksum.to_le_bytes());
        }
        headers.resize(end, 0);
        let (records, passes) = records_and_passes(headers);
        assert_eq!(records, 1);
        assert!(passes < 4.0, "{passes}");
    }
}

#[test]
fn records_between_much_damage_are_still_found() {
    let keyframe = |id| Record::Keyframe(keyframe(id, Some(Image::filled(64, 48, 9))));
    let records: Vec<Record> = (0..200).map(keyframe).collect();
    let mut file = file_of_size(64, 48, &records);
    let first = file_of_size(64, 48, &[]).len();
    let record = (file.len() - first) / 200;
    // every second payload is damaged
    for damaged in (0..200).step_by(2) {
        file[first + damaged * record + record / 2] ^= 1;
    }
    assert_eq!(read(&file).expect("a session").keyframes.len(), 100);
}

fn keyframe(id: u32, image: Option<Image<u8>>) -> KeyframeRecord {
    KeyframeRecord {
        id,
        frame_index: u64::from(id),
        timestamp_ns: i64::from(id),
        camera: None,
        image,
        pixels: Vec::new(),
    }
}

/// A keyframe record of any numbers.
fn keyframe_bytes(encoding: u8, size: (u32, u32), image: &[u8], num_pixels: u32) -> Vec<u8> {
    let mut payload = vec![0; 20];
    payload.push(encoding);
    payload.extend(size.0.to_le_bytes());
    payload.extend(size.1.to_le_bytes());
    payload.extend((image.len() as u32).to_le_bytes());
    payload.extend(image);
    payload.extend(num_pixels.to_le_bytes());
    record_bytes(2, &payload)
}

#[test]
fn an_image_costs_no_more_than_its_bytes_allow() {
    let mut bomb = Vec::new();
    let mut encoder = png::Encoder::new(&mut bomb, 8192, 8192);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_compression(png::Compression::High);
    encoder.set_filter(png::Filter::NoFilter);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&vec![0; 8192 * 8192]))
        .expect("encoded");
    assert!(bomb.len() < 300_000, "{}", bomb.len());
    for (session, said) in [(8192, 8192), (64, 8192), (64, 64)] {
        let mut file = file_of_size(session, session, &[]);
        file.extend(keyframe_bytes(2, (said, said), &bomb, 0));
        let recording = read(&file).expect("a session");
        assert_eq!(
            (recording.keyframes.len(), recording.damage.num_gaps),
            (0, 1)
        );
    }
    // a plain image is written so that it can be read again
    let plain = Image::filled(640, 480, 0);
    let file = file_of_size(
        640,
        480,
        &[Record::Keyframe(keyframe(0, Some(plain.clone())))],
    );
    assert_eq!(read(&file).expect("whole").keyframes[0].image, Some(plain));
    // and one of another size than the session's is none of its images
    let odd = Image::filled(320, 240, 0);
    let file = file_of_size(640, 480, &[Record::Keyframe(keyframe(0, Some(odd)))]);
    assert_eq!(read(&file).expect("whole").keyframes[0].image, None);
}

#[test]
fn counts_beyond_the_bytes_are_refused_before_anything_is_allocated() {
    let huge = u32::MAX.to_le_bytes();
    let mut poses = vec![0; 8];
    poses.extend(huge);
    let mut depth = vec![0; 8];
    depth.extend(huge);
    let mut file = file_of_size(64, 48, &[]);
    file.extend(record_bytes(3, &depth));
    file.extend(record_bytes(4, &poses));
    file.extend(record_bytes(6, &huge));
    file.extend(keyframe_bytes(1, (u32::MAX, u32::MAX), b"", 0));
    file.extend(keyframe_bytes(0, (0, 0), b"", u32::MAX));
    let recording = read(&file).expect("a session");
    assert_eq!(recording.damage.num_gaps, 5);
    assert!(recording.keyframes.is_empty() && recording.continuation.is_none());
}

#[test]
fn sessions_of_impossible_cameras_are_refused() {
    for (width, height) in [
        (60_000, 60_000),
        (u32::MAX as usize, 48),
        (0, 0),
        (8193, 8192),
    ] {
        let file = file_of_size(width, height, &[]);
        let error = read(&file).expect_err("impossible").to_string();
        assert!(error.contains("no session record"), "{error}");
    }
}

fn edge(i: u32, j: u32) -> RecordedEdge {
    RecordedEdge {
        i,
        j,
        kind: 1,
        kernel: 1,
        kernel_parameter: 3.0,
        i_from_j: Sim3::identity(),
        information: [0.0; 28],
    }
}

fn point(
    host: u32,
    pixel: [f64; 2],
    idepth: f64,
    observations: &[(u32, [f64; 2])],
) -> RecordedPoint {
    RecordedPoint {
        host,
        pixel,
        idepth: [idepth, 1.0, 0.1],
        observations: observations.to_vec(),
    }
}

#[test]
fn a_continuation_that_names_what_does_not_exist_loses_just_that() {
    let link = |id, parent| KeyframeLink {
        id,
        parent,
        gain: 1.0,
        bias: 0.0,
    };
    let frame = |session, keyframe| RecordedFrame {
        session,
        frame_index: u64::MAX,
        timestamp_ns: i64::MIN,
        keyframe,
        keyframe_from_frame: Se3::identity(),
    };
    let continuation = Continuation {
        sessions: vec![RecordedSession {
            source: "kitchen".to_owned(),
            first_keyframe: 0,
        }],
        keyframes: vec![
            link(0, None),
            link(1, Some(0)),
            link(1, Some(1)),
            link(7, Some(0)),
        ],
        edges: vec![edge(0, 1), edge(0, 2), edge(u32::MAX, 1), edge(1, 1)],
        points: vec![
            point(0, [63.5, 0.0], 1.0, &[(1, [3.0, 4.0])]),
            point(2, [3.0, 4.0], 1.0, &[]),
            point(0, [1e300, 4.0], 1.0, &[]),
            point(0, [3.0, -0.1], 1.0, &[]),
            point(0, [3.0, 4.0], 0.0, &[]),
            point(0, [3.0, 4.0], 1.0, &[(9, [3.0, 4.0])]),
            point(0, [3.0, 4.0], 1.0, &[(1, [64.0, 4.0])]),
        ],
        frames: vec![frame(0, 1), frame(1, 1), frame(60_000, 0), frame(0, 2)],
        fragments: Vec::new(),
    };
    let records = [
        Record::Keyframe(keyframe(0, None)),
        Record::Keyframe(keyframe(1, None)),
        Record::Poses(PoseSnapshot {
            revision: 1,
            poses: vec![(0, Sim3::identity()), (1, Sim3::identity())],
        }),
        Record::Continuation(continuation.clone()),
    ];
    let recording = read(&file_of_size(64, 48, &records)).expect("whole");
    let kept = recording.continuation.expect("a continuation");
    assert_eq!(kept.keyframes, continuation.keyframes[..2]);
    assert_eq!(kept.edges, continuation.edges[..1]);
    assert_eq!(kept.points, continuation.points[..1]);
    assert_eq!(kept.frames, continuation.frames[..1]);
    assert_eq!(recording.num_invalid_links, 2 + 3 + 6 + 3);
}

#[test]
fn depth_pixels_outside_the_image_are_dropped() {
    let mut far = keyframe(0, None);
    far.pixels = vec![DepthPixel {
        x: u16::MAX,
        y: u16::MAX,
        idepth: f32::MAX,
        idepth_var: f32::MIN_POSITIVE,
    }];
    let recording = read(&file_of_size(64, 48, &[Record::Keyframe(far)])).expect("whole");
    assert_eq!(recording.num_invalid_pixels, 1);
}

#[test]
fn images_show_no_more_than_their_recording_can_have_stored() {
    const SIZE: (usize, usize) = (2048, 1024);
    // noise in the first rows, so that each is believed by itself
    let noise = |x: usize, y: usize| ((x * SIZE.1 + y) as u32).wrapping_mul(2_654_435_761) >> 24;
    let image = Image::from_fn(
        SIZE.0,
        SIZE.1,
        |x, y| if y < 20 { noise(x, y) as u8 } else { 0 },
    );
    let keyframe = |id| {
        Record::Keyframe(KeyframeRecord {
            id,
            frame_index: id.into(),
            timestamp_ns: id.into(),
            camera: None,
            image: Some(image.clone()),
            pixels: Vec::new(),
        })
    };
    let file = |count| {
        file_of_size(
            SIZE.0,
            SIZE.1,
            &(0..count).map(keyframe).collect::<Vec<_>>(),
        )
    };
    assert_eq!(read(&file(1)).expect("one").keyframes.len(), 1);
    let four = file(4);
    assert!(four.len() < 400_000, "{}", four.len());
    let error = read(&four).expect_err("eight million pixels");
    assert!(matches!(error, DatasetError::TooManyPixels(_)), "{error}");
}
