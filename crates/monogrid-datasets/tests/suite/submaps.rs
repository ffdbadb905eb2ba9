//! Submaps: a run in pieces is the same run, and nothing else is taken for it.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use super::images::gray;
use super::mutations::{Tried, mutations};
use super::recording::{keyframe, pixels, pose, session};
use hmac_sha256::Hash;
use monogrid_datasets::{
    BuiltSubmap, ColourRecord, Continuation, DepthRevision, EndRecord, FragmentKeyframe,
    KeyframeLink, PoseSnapshot, ReadOptions, Record, RecordedCamera, Recording, RecordingWriter,
    SUBMAP_TABLE, SubmapBuilder, SubmapEntry, SubmapId, SubmapReader, SubmapTable,
};
use monogrid_geometry::{Pinhole, Sim3};
use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;

const ALL: ReadOptions = ReadOptions { with_images: true };

/// Poses of six keyframes in the world: those of the first submap as it has them, the others moved
/// since; keyframe 4 is in no map.
fn world(id: u32) -> Option<Sim3> {
    (id != 4).then(|| pose(id as usize))
}

fn colour(keyframe_id: u32) -> Record {
    let jpeg = vec![0xff, 0xd8, keyframe_id as u8];
    Record::Colour(ColourRecord { keyframe_id, jpeg })
}

fn newer_depth() -> DepthRevision {
    DepthRevision {
        keyframe_id: 1,
        revision: 3,
        pixels: pixels(70, 5),
    }
}

/// What keyframe 4 is in, and what the run says at its end.
fn last_records() -> [Record; 2] {
    let continuation = Continuation {
        keyframes: vec![KeyframeLink {
            id: 1,
            parent: Some(0),
            gain: 1.01,
            bias: -2.0,
        }],
        fragments: vec![FragmentKeyframe {
            keyframe: 4,
            fragment: 1,
            fragment_from_keyframe: pose(9),
        }],
        ..Continuation::default()
    };
    let end = EndRecord {
        num_frames: 60,
        num_tracked: 55,
        summary: String::new(),
    };
    [Record::Continuation(continuation), Record::End(end)]
}

/// A submap of these keyframes. In it they lie as they did when it was closed: `closed` says where
/// in the world.
fn submap(ids: &[u32], closed: impl Fn(u32) -> Option<Sim3>, more: &[Record]) -> BuiltSubmap {
    let mut builder = SubmapBuilder::new(&session()).unwrap();
    let origin = closed(ids[0]).unwrap().inverse();
    for &id in ids {
        let mut keyframe = keyframe(id, Some(gray(64, 48)));
        if id == 3 {
            keyframe.image = None;
            keyframe.camera = Some(other_camera());
        }
        let in_submap = if id == ids[0] {
            Some(Sim3::identity())
        } else {
            closed(id).map(|pose| origin * pose)
        };
        builder.add_keyframe(keyframe, id % 2, in_submap).unwrap();
        builder.add(&colour(id)).unwrap();
    }
    for record in more {
        builder.add(record).unwrap();
    }
    builder.finish().unwrap()
}

fn other_camera() -> RecordedCamera {
    RecordedCamera {
        pinhole: Pinhole::new(30.0, 30.0, 16.0, 12.0),
        width: 64,
        height: 48,
    }
}

fn submaps() -> [BuiltSubmap; 2] {
    let [continuation, end] = last_records();
    let more = [Record::Depth(newer_depth()), continuation, end];
    [
        submap(&[0, 1, 2], world, &[]),
        submap(
            &[3, 4, 5],
            |id| (id != 4).then(|| pose(7 * id as usize)),
            &more,
        ),
    ]
}

fn table(submaps: &[BuiltSubmap]) -> SubmapTable {
    let placed = submaps.iter().map(|submap| {
        let file = (submap.id, submap.bytes.len() as u64);
        SubmapEntry::placed(file, &submap.poses, world)
    });
    SubmapTable {
        pose_revision: Some(8),
        submaps: placed.collect(),
    }
}

/// Writes a run as submaps; where its table lies.
fn write_submaps(folder: &Path) -> std::path::PathBuf {
    let submaps = submaps();
    for submap in &submaps {
        fs::write(folder.join(submap.id.file_name()), &submap.bytes).unwrap();
    }
    let path = folder.join(SUBMAP_TABLE);
    fs::write(&path, table(&submaps).to_json()).unwrap();
    path
}

/// Writes the same run as a recording.
fn write_recording(path: &Path) {
    let mut writer = RecordingWriter::create(path, &session()).unwrap();
    for id in 0..6 {
        let mut first = keyframe(id, Some(gray(64, 48)));
        if id == 3 {
            first.image = None;
            first.camera = Some(other_camera());
        }
        let pixels = first.pixels.clone();
        writer.append_keyframe(first).unwrap();
        writer.append(&colour(id)).unwrap();
        if id % 2 == 1 {
            let (keyframe_id, revision) = (id, 1);
            writer
                .append_depth(DepthRevision {
                    keyframe_id,
                    revision,
                    pixels,
                })
                .unwrap();
        }
    }
    writer.append_depth(newer_depth()).unwrap();
    let poses = (0..6).filter_map(|id| Some((id, world(id)?))).collect();
    let revision = 8;
    writer
        .append_poses(PoseSnapshot { revision, poses })
        .unwrap();
    for record in last_records() {
        writer.append(&record).unwrap();
    }
}

#[test]
fn a_run_in_submaps_is_the_run_of_its_recording() {
    let folder = tempfile::tempdir().unwrap();
    let table = write_submaps(folder.path());
    let file = folder.path().join("recording.mgk");
    write_recording(&file);
    for with_images in [false, true] {
        let options = ReadOptions { with_images };
        let recording = Recording::read(&file, options).unwrap();
        assert_eq!(recording.keyframes.len(), 6);
        assert_eq!(Recording::read(&table, options).unwrap(), recording);
    }
}

#[test]
fn one_submap_is_a_recording_in_its_own_frame() {
    let folder = tempfile::tempdir().unwrap();
    write_submaps(folder.path());
    let [_, second] = submaps();
    let one = Recording::read(&folder.path().join(second.id.file_name()), ALL).unwrap();
    let keyframes: Vec<_> = one
        .keyframes
        .iter()
        .map(|k| (k.id, k.frame_index))
        .collect();
    assert_eq!(keyframes, [(0, 30), (1, 40), (2, 50)]);
    assert_eq!(one.keyframes[0].world_from_keyframe, Some(Sim3::identity()));
    assert_eq!(one.keyframes[1].world_from_keyframe, None);
    assert_eq!(one.keyframes[2].world_from_keyframe, second.poses[2].1);
    assert!(one.continuation.is_none() && one.end.is_none());
}

#[test]
fn the_table_comes_back_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_submaps(folder.path());
    assert_eq!(SubmapTable::read(&path).unwrap(), table(&submaps()));
    assert!(
        submaps()[0].bytes == fs::read(folder.path().join(submaps()[0].id.file_name())).unwrap()
    );
}

#[test]
fn what_moved_as_a_whole_is_said_once() {
    let submap = submap(&[0, 1, 2], world, &[]);
    let file = (submap.id, 1);
    // as the reader composes them
    let moved = |shift: Sim3| {
        let in_submap: BTreeMap<u32, Sim3> = submap
            .poses
            .iter()
            .map(|(id, pose)| (*id, pose.unwrap()))
            .collect();
        SubmapEntry::placed(file, &submap.poses, |id| Some(shift * in_submap[&id]))
    };
    let entry = moved(pose(4));
    assert!(entry.moved.is_empty());
    assert_eq!(entry.world_from_submap, Some(pose(4)));
    let bent = SubmapEntry::placed(file, &submap.poses, |id| (id != 2).then(|| pose(4)));
    assert_eq!(
        bent.moved.iter().map(|moved| moved.id).collect::<Vec<_>>(),
        [1, 2]
    );
    assert_eq!(bent.moved[1].world_from_keyframe, None);
}

#[test]
fn a_submap_says_what_is_in_it() {
    let built = submap(&[0, 1, 2], world, &[]);
    let reader = SubmapReader::new(Cursor::new(&built.bytes), Path::new("x")).unwrap();
    assert_eq!(reader.id(), built.id);
    assert_eq!(reader.num_keyframes(), 3);
    let info = reader.info();
    assert_eq!(
        (info.camera, info.scale),
        (session().camera(), session().scale)
    );
    let first = keyframe(0, None).timestamp_ns;
    assert_eq!(info.times_ns, Some([first, first + 2]));
    // every point, as the format says where it lies
    let [low, high] = info.bounds.unwrap();
    let mut reached = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for (id, in_submap) in &built.poses {
        let in_submap = in_submap.unwrap();
        let p = session().pinhole;
        let pixels = keyframe(*id, None).pixels.into_iter();
        let points = pixels
            .filter(|pixel| pixel.idepth_var.sqrt() / pixel.idepth <= 0.1)
            .map(|pixel| {
                let z = 1.0 / f64::from(pixel.idepth);
                let x = (f64::from(pixel.x) - p.cx) / p.fx * z;
                let y = (f64::from(pixel.y) - p.cy) / p.fy * z;
                in_submap * monogrid_geometry::Vec3::new(x, y, z)
            });
        for point in points.chain([in_submap.translation]) {
            for axis in 0..3 {
                reached[0][axis] = reached[0][axis].min(point[axis]);
                reached[1][axis] = reached[1][axis].max(point[axis]);
            }
        }
    }
    for axis in 0..3 {
        assert!((low[axis] - reached[0][axis]).abs() < 1e-9);
        assert!((high[axis] - reached[1][axis]).abs() < 1e-9);
    }
}

/// Counts what is read of a file.
struct Counted<R>(R, usize);

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let read = self.0.read(bytes)?;
        self.1 += read;
        Ok(read)
    }
}

impl<R: Seek> Seek for Counted<R> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn one_block_costs_its_range() {
    let built = submap(&[0, 1, 2], world, &[]);
    let mut input = Counted(Cursor::new(&built.bytes), 0);
    let mut reader = SubmapReader::new(&mut input, Path::new("x")).unwrap();
    let mut blocks = reader.blocks().to_vec().into_iter();
    let depth = blocks
        .find(|block| block.kind == 3 && block.keyframe == Some(2))
        .unwrap();
    let directory = 57 * reader.blocks().len();
    let record = reader.read(&depth, ALL).unwrap();
    let expected = DepthRevision {
        keyframe_id: 2,
        revision: 0,
        pixels: keyframe(2, None).pixels,
    };
    assert_eq!(record, Some(Record::Depth(expected)));
    let read = input.1;
    assert!(
        read <= directory + depth.stored_bytes as usize + 256,
        "{read}"
    );
    assert!(read * 2 < built.bytes.len());
}

#[test]
fn the_same_run_makes_the_same_files_and_another_one_others() {
    let [first, second] = submaps();
    let again = submaps();
    assert!(first.bytes == again[0].bytes && second.id == again[1].id);
    assert_ne!(first.id, second.id);
    assert_ne!(submap(&[0, 1, 2], world, &[colour(1)]).id, first.id);
}

#[test]
fn every_changed_byte_is_noticed() {
    let built = submap(&[0, 3], world, &[]);
    let path = Path::new("x");
    for at in 0..built.bytes.len() {
        let mut bytes = built.bytes.clone();
        bytes[at] ^= 1 << (at % 8);
        let opened = SubmapReader::new(Cursor::new(&bytes[..]), path);
        let read = opened.and_then(|mut reader| reader.records(ALL).collect::<Result<Vec<_>, _>>());
        let error = read.expect_err("changed").to_string();
        assert!(
            error.contains("\"x\" is not a usable submap"),
            "{at}: {error}"
        );
    }
    for length in 0..built.bytes.len() {
        let cut = Cursor::new(&built.bytes[..length]);
        assert!(SubmapReader::new(cut, path).is_err());
    }
}

/// Puts the hashes right again, as far as the directory still says where blocks lie.
fn repair(bytes: &mut [u8]) {
    let Some(end) = bytes.len().checked_sub(56) else {
        return;
    };
    let number = |bytes: &[u8], at: usize, n: usize| {
        let bytes = &bytes[at..at + n];
        bytes
            .iter()
            .rev()
            .fold(0_u64, |value, byte| value << 8 | u64::from(*byte)) as usize
    };
    let begin = number(bytes, end, 8);
    if begin > end {
        return;
    }
    let mut at = begin + 40 + 1 + 17 + 49 + 4;
    while at + 57 <= end {
        let (offset, stored) = (number(bytes, at + 8, 8), number(bytes, at + 16, 4));
        let block = bytes.get(offset..offset.saturating_add(stored));
        if let Some(hash) = block.map(Hash::hash) {
            bytes[at + 25..at + 57].copy_from_slice(&hash);
        }
        at += 57;
    }
    let hash = Hash::hash(&bytes[begin..end]);
    bytes[end + 16..end + 48].copy_from_slice(&hash);
}

#[test]
fn damaged_submaps_are_errors() {
    let [_, built] = submaps();
    let mut repaired = built.bytes.clone();
    repair(&mut repaired);
    assert!(repaired == built.bytes, "the test knows the format");
    let mut tried = Tried::default();
    for mut bytes in mutations(&built.bytes, 3000) {
        for _ in 0..2 {
            let opened = SubmapReader::new(Cursor::new(&bytes[..]), Path::new("damaged"));
            if let Some(mut reader) = tried.count(opened) {
                assert!(reader.blocks().len() * 57 <= bytes.len());
                for with_images in [false, true] {
                    let options = ReadOptions { with_images };
                    let blocks = reader.blocks().to_vec();
                    for block in &blocks {
                        tried.count(reader.read(block, options));
                    }
                }
                tried.count(reader.poses());
            }
            repair(&mut bytes);
        }
    }
    tried.assert_both();
}

#[test]
fn damaged_tables_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_submaps(folder.path());
    let mut tried = Tried::default();
    for bytes in mutations(&fs::read(&path).unwrap(), 600) {
        fs::write(&path, bytes).unwrap();
        tried.count(Recording::read(&path, ReadOptions { with_images: false }));
    }
    tried.assert_both();
}

#[test]
fn a_bomb_is_refused_before_it_is_unpacked() {
    let built = submap(&[0], world, &[]);
    let mut bytes = built.bytes.clone();
    let end = bytes.len() - 56;
    let begin = u64::from_le_bytes(bytes[end..end + 8].try_into().unwrap()) as usize;
    // the first block, the session, says that it holds 4 GiB
    let first = begin + 40 + 1 + 17 + 49 + 4;
    bytes[first + 20..first + 24].fill(255);
    repair(&mut bytes);
    let error = SubmapReader::new(Cursor::new(&bytes[..]), Path::new("x")).expect_err("a bomb");
    assert!(error.to_string().contains("directory"), "{error}");
}

#[test]
fn missing_and_renamed_submaps_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_submaps(folder.path());
    let [first, second] = submaps().map(|submap| submap.id.file_name());
    let read = || {
        Recording::read(&path, ALL)
            .expect_err("unusable")
            .to_string()
    };
    fs::copy(folder.path().join(&second), folder.path().join(&first)).unwrap();
    let error = read();
    assert!(error.contains(&first) && error.contains(&second), "{error}");
    fs::remove_file(folder.path().join(&first)).unwrap();
    assert!(read().contains(&first));
    let twice = fs::read_to_string(&path).unwrap().replace(&second, &first);
    fs::write(&path, twice).unwrap();
    assert!(read().contains("twice"));
    assert!(SubmapId::of_file_name(&first).is_some());
}
