//! Recordings: what is written is read back, whatever happens to the file.

use super::images::gray;
use monogrid_datasets::{
    ColourRecord, DepthPixel, DepthRevision, EndRecord, KeyframeRecord, PoseSnapshot, ReadOptions,
    Record, RecordedCamera, Recording, RecordingReader, RecordingWriter, Scale, SessionInfo,
};
use monogrid_geometry::{Pinhole, Sim3, Vec7};
use monogrid_image::Image;
use proptest::prelude::*;
use std::io::Cursor;
use std::path::{Path, PathBuf};

pub fn session() -> SessionInfo {
    SessionInfo {
        pinhole: Pinhole::new(50.0, 51.0, 31.5, 23.5),
        width: 64,
        height: 48,
        scale: Scale::Metric,
        seed: 7,
        profile: "default".to_owned(),
        source: "kitchen – Küche".to_owned(),
        config: "[mapping]\nresolution = 0.05\n".to_owned(),
    }
}

pub fn pixels(count: usize, seed: usize) -> Vec<DepthPixel> {
    (0..count)
        .map(|i| DepthPixel {
            x: ((i * 7 + seed) % 64) as u16,
            y: ((i * 5 + 3 * seed) % 48) as u16,
            idepth: 0.5 + 0.01 * i as f32,
            idepth_var: 0.001 * (1 + seed) as f32,
        })
        .collect()
}

pub fn keyframe(id: u32, image: Option<Image<u8>>) -> KeyframeRecord {
    KeyframeRecord {
        id,
        frame_index: 10 * u64::from(id),
        timestamp_ns: 1_403_715_273_262_142_976 + i64::from(id),
        camera: None,
        image,
        pixels: pixels(20 + id as usize, id as usize),
    }
}

pub fn pose(i: usize) -> Sim3 {
    let x = i as f64;
    Sim3::exp(&Vec7::from_column_slice(&[
        x,
        0.2 * x,
        -0.1 * x,
        0.1,
        0.05 * x,
        -0.2,
        0.01 * x,
    ]))
}

fn poses(revision: u64, ids: &[u32]) -> PoseSnapshot {
    PoseSnapshot {
        revision,
        poses: ids
            .iter()
            .map(|&id| (id, pose(id as usize + revision as usize)))
            .collect(),
    }
}

/// The records of a small run, without the session that `create` writes.
fn run() -> Vec<Record> {
    vec![
        Record::Keyframe(keyframe(0, Some(gray(64, 48)))),
        Record::Poses(poses(1, &[0])),
        Record::Keyframe(keyframe(1, None)),
        Record::Poses(poses(2, &[0, 1])),
        Record::Depth(DepthRevision {
            keyframe_id: 0,
            revision: 1,
            pixels: pixels(30, 9),
        }),
        Record::Keyframe(keyframe(
            2,
            Some(Image::from_fn(64, 48, |x, y| (x * 31 + y * 17) as u8)),
        )),
        Record::Poses(poses(3, &[0, 1, 2])),
        Record::End(EndRecord {
            num_frames: 30,
            num_tracked: 29,
            summary: "{\"frames\":30}".to_owned(),
        }),
    ]
}

/// The bytes of a small recording.
pub fn recording_bytes() -> Vec<u8> {
    write(&run()).bytes
}

/// A record with right checksums, whatever its content.
pub fn record_bytes(kind: u32, payload: &[u8]) -> Vec<u8> {
    let mut record = b"RMGK".to_vec();
    record.extend_from_slice(&kind.to_le_bytes());
    record.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    record.extend_from_slice(&crc32fast::hash(payload).to_le_bytes());
    record.extend_from_slice(&crc32fast::hash(&record).to_le_bytes());
    record.extend_from_slice(payload);
    record
}

/// The bytes of a file with the session of these tests at another size and some records more.
pub fn file_of_size(width: usize, height: usize, records: &[Record]) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("recording.mgk");
    let session = SessionInfo {
        pinhole: Pinhole::new(
            0.8 * width as f64,
            0.8 * width as f64,
            0.5 * width as f64,
            0.5 * height as f64,
        ),
        width,
        height,
        ..session()
    };
    let mut writer = RecordingWriter::create(&path, &session).expect("writable");
    for record in records {
        writer.append(record).expect("writable");
    }
    std::fs::read(&path).expect("readable")
}

/// A keyframe of another camera than the session's.
fn keyframe_of(camera: RecordedCamera) -> KeyframeRecord {
    let image = gray(camera.width, camera.height);
    KeyframeRecord {
        camera: Some(camera),
        pixels: vec![
            DepthPixel {
                x: 70,
                y: 9,
                ..pixels(1, 0)[0]
            },
            DepthPixel {
                x: 80,
                ..pixels(1, 0)[0]
            },
        ],
        ..keyframe(1, Some(image))
    }
}

#[test]
fn a_keyframe_may_have_a_camera_of_its_own() {
    let camera = RecordedCamera {
        pinhole: Pinhole::new(70.0, 71.0, 40.0, 25.0),
        width: 80,
        height: 50,
    };
    let of_session = gray(64, 48);
    let records = [
        Record::Keyframe(keyframe(0, Some(of_session))),
        Record::Keyframe(keyframe_of(camera)),
    ];
    let recording = Recording::read(&write(&records).path, ReadOptions::default()).expect("whole");
    let [first, second] = &recording.keyframes[..] else {
        panic!("two keyframes");
    };
    assert_eq!(first.camera, session().camera());
    assert_eq!(second.camera, camera);
    // what lies inside is judged by its own camera
    let size = second.image.as_ref().map(|i| (i.width(), i.height()));
    assert_eq!(size, Some((80, 50)));
    assert_eq!(second.pixels.len(), 1);
    assert_eq!(recording.num_invalid_pixels, 1);
    // a keyframe of a camera that cannot be is none
    let impossible = RecordedCamera {
        pinhole: Pinhole::new(0.0, 71.0, 40.0, 25.0),
        ..camera
    };
    let records = [Record::Keyframe(keyframe_of(impossible))];
    let recording = Recording::read(&write(&records).path, ReadOptions::default()).expect("whole");
    assert!(recording.keyframes.is_empty());
}

struct Written {
    _folder: tempfile::TempDir,
    path: PathBuf,
    bytes: Vec<u8>,
    /// End of each record; the first is the session's.
    ends: Vec<usize>,
}

fn write(records: &[Record]) -> Written {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("recording.mgk");
    let mut writer = RecordingWriter::create(&path, &session()).expect("writable");
    // what was appended is in the file at once
    let length = || std::fs::metadata(&path).expect("a file").len() as usize;
    let mut ends = vec![length()];
    for record in records {
        writer.append(record).expect("writable");
        ends.push(length());
    }
    // not finished, not dropped: everything must be in the file already
    let bytes = std::fs::read(&path).expect("readable");
    drop(writer);
    assert_eq!(bytes.len(), *ends.last().expect("a session"));
    Written {
        _folder: folder,
        path,
        bytes,
        ends,
    }
}

fn reader(bytes: &[u8]) -> RecordingReader<Cursor<&[u8]>> {
    RecordingReader::new(
        Cursor::new(bytes),
        Path::new("test.mgk"),
        ReadOptions::default(),
    )
    .expect("a recording")
}

fn records(bytes: &[u8]) -> Vec<Record> {
    reader(bytes).map(|r| r.expect("no read error")).collect()
}

fn poses_close(a: &Sim3, b: &Sim3) -> bool {
    (a.translation - b.translation).norm() < 1e-12
        && a.rotation.angle_to(&b.rotation) < 1e-7
        && a.scale == b.scale
}

#[test]
fn the_newest_state_is_read_back() {
    let written = write(&run());
    let recording = Recording::read(&written.path, ReadOptions::default()).expect("whole");
    assert_eq!(recording.session, session());
    assert_eq!(recording.damage, Default::default());
    assert_eq!(recording.pose_revision, Some(3));
    assert_eq!(recording.end.as_ref().map(|e| e.num_tracked), Some(29));
    assert_eq!(recording.num_invalid_pixels, 0);
    let ids: Vec<u32> = recording.keyframes.iter().map(|k| k.id).collect();
    assert_eq!(ids, [0, 1, 2]);
    let first = &recording.keyframes[0];
    assert_eq!(first.image, Some(gray(64, 48)));
    assert_eq!(first.depth_revision, 1);
    assert_eq!(first.pixels, pixels(30, 9));
    let third = &recording.keyframes[2];
    assert_eq!(third.pixels, pixels(22, 2));
    assert_eq!(third.timestamp_ns, 1_403_715_273_262_142_978);
    assert_eq!(third.frame_index, 20);
    for (i, keyframe) in recording.keyframes.iter().enumerate() {
        let read = keyframe.world_from_keyframe.expect("posed");
        assert!(poses_close(&read, &pose(i + 3)), "{i}");
    }
    let without =
        Recording::read(&written.path, ReadOptions { with_images: false }).expect("whole");
    assert!(without.keyframes.iter().all(|k| k.image.is_none()));
    assert_eq!(without.keyframes[2].pixels, third.pixels);
}

#[test]
fn colour_belongs_to_its_keyframe() {
    let colour = |keyframe_id, byte| {
        let jpeg = vec![byte; 9];
        Record::Colour(ColourRecord { keyframe_id, jpeg })
    };
    let mut records = run();
    records.insert(1, colour(0, 1));
    records.push(colour(2, 2));
    records.push(colour(77, 3));
    let written = write(&records);
    let read = |with_images| {
        let recording = Recording::read(&written.path, ReadOptions { with_images });
        let recording = recording.expect("whole");
        assert_eq!(recording.damage, Default::default());
        let colours = recording.keyframes.into_iter().map(|k| k.colour);
        colours.collect::<Vec<_>>()
    };
    assert_eq!(read(true), [Some(vec![1; 9]), None, Some(vec![2; 9])]);
    assert_eq!(read(false), [None, None, None]);
}

#[test]
fn truncated_anywhere_it_yields_every_whole_record() {
    let written = write(&run());
    let all = records(&written.bytes);
    for length in 16..=written.bytes.len() {
        let cut = &written.bytes[..length];
        let whole = written.ends.iter().filter(|&&end| end <= length).count();
        let mut reader = reader(cut);
        let read: Vec<Record> = reader.by_ref().map(|r| r.expect("no read error")).collect();
        assert_eq!(read, all[..whole], "cut to {length}");
        let at_boundary = length == 16 || written.ends.contains(&length);
        assert_eq!(reader.damage().truncated, !at_boundary, "cut to {length}");
        let collected = Recording::collect(self::reader(cut), Path::new("test.mgk"));
        assert_eq!(collected.is_ok(), whole > 0);
    }
    for length in 0..16 {
        let header = RecordingReader::new(
            Cursor::new(&written.bytes[..length]),
            Path::new("test.mgk"),
            ReadOptions::default(),
        );
        assert!(header.is_err(), "cut to {length}");
    }
}

#[test]
fn other_files_and_later_versions_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("x.mgk");
    let mut later = write(&[]).bytes;
    later[8] = 99;
    for (bytes, part) in [
        (&b"not a recording at all"[..], "monogrid"),
        (&later[..], "version 99"),
        (&later[..16], "version 99"),
        (b"", "monogrid"),
    ] {
        std::fs::write(&path, bytes).expect("writable");
        let error = Recording::read(&path, ReadOptions::default())
            .expect_err("refused")
            .to_string();
        assert!(error.contains("x.mgk") && error.contains(part), "{error}");
    }
    assert!(Recording::read(&folder.path().join("none.mgk"), ReadOptions::default()).is_err());
}

#[test]
fn a_record_of_a_later_kind_is_passed_over() {
    let written = write(&run());
    // a well-formed record of kind 77 in the place of nothing: appended after the session
    let unknown = record_bytes(77, b"hello");
    let at = written.ends[0];
    let mut bytes = written.bytes.clone();
    bytes.splice(at..at, unknown);
    assert_eq!(records(&bytes), records(&written.bytes));
    assert_eq!(
        Recording::collect(reader(&bytes), Path::new("t"))
            .expect("whole")
            .damage,
        Default::default()
    );
}

#[test]
fn unusable_pixels_are_dropped_and_counted() {
    let mut bad = keyframe(0, None);
    bad.pixels = vec![
        DepthPixel {
            x: 64,
            y: 0,
            idepth: 1.0,
            idepth_var: 0.1,
        },
        DepthPixel {
            x: 0,
            y: 48,
            idepth: 1.0,
            idepth_var: 0.1,
        },
        DepthPixel {
            x: 1,
            y: 1,
            idepth: f32::NAN,
            idepth_var: 0.1,
        },
        DepthPixel {
            x: 1,
            y: 1,
            idepth: -1.0,
            idepth_var: 0.1,
        },
        DepthPixel {
            x: 1,
            y: 1,
            idepth: 1.0,
            idepth_var: f32::INFINITY,
        },
        DepthPixel {
            x: 63,
            y: 47,
            idepth: 1.0,
            idepth_var: 0.1,
        },
    ];
    let written = write(&[Record::Keyframe(bad)]);
    let recording = Recording::read(&written.path, ReadOptions::default()).expect("whole");
    assert_eq!(recording.num_invalid_pixels, 5);
    assert_eq!(recording.keyframes[0].pixels.len(), 1);
    assert_eq!(recording.end, None);
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn corrupted_anywhere_it_yields_every_untouched_record(
        damage in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 1..6),
        cut in any::<Option<prop::sample::Index>>(),
    ) {
        let written = write(&run());
        let all = records(&written.bytes);
        let mut bytes = written.bytes.clone();
        let start = 16;
        for (index, flip) in &damage {
            let i = start + index.index(bytes.len() - start);
            bytes[i] ^= flip;
        }
        if let Some(cut) = cut {
            bytes.truncate(start + cut.index(bytes.len() - start));
        }
        let mut begin = start;
        let mut expected = Vec::new();
        for (record, &end) in all.iter().zip(&written.ends) {
            if end <= bytes.len() && bytes[begin..end] == written.bytes[begin..end] {
                expected.push(record.clone());
            }
            begin = end;
        }
        prop_assert_eq!(records(&bytes), expected);
        // must not panic either
        let _ = Recording::collect(reader(&bytes), Path::new("test.mgk"));
    }

    #[test]
    fn noise_behind_a_header_never_panics(noise in prop::collection::vec(any::<u8>(), 0..400)) {
        let mut bytes = write(&[]).bytes[..16].to_vec();
        bytes.extend_from_slice(b"RMGK");
        bytes.extend_from_slice(&noise);
        prop_assert!(records(&bytes).is_empty());
    }

    #[test]
    fn payloads_with_right_checksums_and_wrong_content_never_panic(
        kind in 0u32..8,
        payload in prop::collection::vec(any::<u8>(), 0..120),
    ) {
        let mut bytes = write(&[]).bytes[..16].to_vec();
        bytes.extend(record_bytes(kind, &payload));
        let _ = records(&bytes);
        let _ = Recording::collect(reader(&bytes), Path::new("test.mgk"));
    }
}

/// Read on after every byte that comes, a file gives the records that it gives as a whole, each
/// once.
#[test]
fn a_recording_that_grows_is_read_on() {
    let bytes = write(&run()).bytes;
    let expected = records(&bytes);
    let mut whole_until = 0;
    let mut found = Vec::new();
    for length in (16..=bytes.len()).step_by(97).chain([bytes.len()]) {
        let mut reader = reader(&bytes[..length]).read_on(whole_until);
        found.extend(reader.by_ref().map(|r| r.expect("no read error")));
        whole_until = reader.whole_until();
    }
    assert_eq!(found, expected);
    assert_eq!(whole_until, bytes.len() as u64);
}

#[test]
fn a_record_alone_is_read_back_and_no_other_bytes_are() {
    let written = write(&run());
    let read = records(&written.bytes);
    for ((record, read), ends) in run().iter().zip(&read[1..]).zip(written.ends.windows(2)) {
        let bytes = record.encode().expect("small");
        assert_eq!(bytes, written.bytes[ends[0]..ends[1]]);
        assert_eq!(Record::decode(&bytes).as_ref(), Some(read));
        for damaged in [&bytes[1..], &bytes[..bytes.len() - 1], &[]] {
            assert_eq!(Record::decode(damaged), None);
        }
        let mut damaged = bytes.clone();
        damaged[25] ^= 4;
        assert_eq!(Record::decode(&damaged), None);
    }
}
