//! Packets: what comes out is what went in, as far as is promised; what is damaged or of another version is refused.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_datasets::{
    Continuation, DepthPixel, DepthRevision, EndRecord, KeyframeRecord, PoseSnapshot, Record,
    RecordedSession, Scale, SessionInfo,
};
use monogrid_fleet::agent::Packer;
use monogrid_fleet::messages::{Asked, PREFIX, RunKey};
use monogrid_fleet::packet::{
    IDEPTH_STEP, PART_BYTES, PackedKeyframe, Packet, PacketError, SIGMA_STEPS_PER_OCTAVE,
    Unfinished, parts_of,
};
use monogrid_fleet::packet_log::PacketLog;
use monogrid_geometry::{Pinhole, Rotation, Sim3, Vec3};
use monogrid_image::Image;

const SIZE: (usize, usize) = (80, 60);

/// A keyframe with depth in every third pixel of a slanted plane.
fn keyframe(id: u32) -> KeyframeRecord {
    let (width, height) = SIZE;
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let places = places.filter(|(x, y)| (x + 2 * y) % 3 == 0);
    let pixels = places.map(|(x, y)| {
        let idepth = 0.5 + 0.01 * x as f32 + 0.003 * y as f32;
        let sigma = 0.002 * (1.0 + x as f32) * idepth;
        DepthPixel {
            x: x as u16,
            y: y as u16,
            idepth,
            idepth_var: sigma * sigma,
        }
    });
    KeyframeRecord {
        id,
        frame_index: 7 + u64::from(id),
        timestamp_ns: -3,
        camera: None,
        image: Some(Image::from_fn(width, height, |x, y| (2 * x + y) as u8)),
        pixels: pixels.collect(),
    }
}

fn session() -> Record {
    Record::Session(SessionInfo {
        pinhole: Pinhole::new(60.0, 60.0, 39.5, 29.5),
        width: SIZE.0,
        height: SIZE.1,
        scale: Scale::Arbitrary,
        seed: 1,
        profile: "default".into(),
        source: "a camera".into(),
        config: "x = 1\n".repeat(100),
    })
}

fn poses(revision: u64, way: f64) -> PoseSnapshot {
    let pose = Sim3::new(1.5, Rotation::identity(), Vec3::new(way, 0.0, 0.0));
    PoseSnapshot {
        revision,
        poses: vec![(0, Sim3::identity()), (1, pose)],
    }
}

#[test]
fn a_keyframe_is_what_it_was_up_to_the_promised_steps() {
    let before = keyframe(4);
    let packed = PackedKeyframe::pack(&before, 90).unwrap();
    let bytes = Packet::Keyframe(packed).encode().unwrap();
    let Packet::Keyframe(packed) = Packet::decode(&bytes).unwrap() else {
        panic!("expected a keyframe");
    };
    let after = packed.unpack().unwrap();
    assert_eq!(
        (after.id, after.frame_index, after.timestamp_ns),
        (4, 11, -3)
    );
    assert_eq!(after.pixels.len(), before.pixels.len());
    // half a step, and what single precision leaves of it
    let (idepth_step, sigma_step) = (
        IDEPTH_STEP / 2.0 + 1e-6,
        0.5 / SIGMA_STEPS_PER_OCTAVE + 1e-4,
    );
    for (a, b) in after.pixels.iter().zip(&before.pixels) {
        assert_eq!((a.x, a.y), (b.x, b.y));
        assert!((f64::from(a.idepth) / f64::from(b.idepth)).ln().abs() <= idepth_step);
        let sigma = |p: &DepthPixel| f64::from(p.idepth_var).sqrt() / f64::from(p.idepth);
        assert!((sigma(a) / sigma(b)).log2().abs() <= sigma_step);
    }
    let (a, b) = (after.image.unwrap(), before.image.clone().unwrap());
    let differences = a.as_slice().iter().zip(b.as_slice());
    assert!(differences.into_iter().all(|(a, b)| a.abs_diff(*b) <= 3));
    let recorded = Record::Keyframe(before).encode().unwrap().len();
    assert!(
        4 * bytes.len() < recorded,
        "{} of {recorded} bytes",
        bytes.len()
    );
}

#[test]
fn depth_that_is_none_is_left_out() {
    let mut before = keyframe(0);
    let good = before.pixels[5];
    before.pixels = vec![
        DepthPixel {
            idepth: f32::NAN,
            ..good
        },
        DepthPixel { x: 80, ..good },
        DepthPixel {
            idepth_var: 0.0,
            x: 1,
            ..good
        },
        good,
    ];
    let packed = PackedKeyframe::pack(&before, 90).unwrap();
    let after = packed.unpack().unwrap();
    assert_eq!(after.pixels.len(), 1);
    assert_eq!((after.pixels[0].x, after.pixels[0].y), (good.x, good.y));
    before.pixels.clear();
    let empty = PackedKeyframe::pack(&before, 90).unwrap();
    assert!(empty.unpack().unwrap().pixels.is_empty());
    before.image = None;
    assert_eq!(
        PackedKeyframe::pack(&before, 90),
        Err(PacketError::NoImage(0))
    );
}

#[test]
fn every_damaged_byte_and_every_other_version_is_noticed() {
    let packed = PackedKeyframe::pack(&keyframe(0), 80).unwrap();
    let bytes = Packet::Keyframe(packed).encode().unwrap();
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        let refused = Packet::decode(&damaged).unwrap_err();
        match at {
            0..4 => assert!(matches!(refused, PacketError::NotAPacket(_))),
            4..8 => assert!(matches!(refused, PacketError::Version { .. })),
            8..12 => assert!(matches!(refused, PacketError::Length { .. })),
            _ => assert_eq!(refused, PacketError::Damaged),
        }
    }
    let mut newer = bytes.clone();
    newer[4] = 2;
    let refused = Packet::decode(&newer).unwrap_err();
    assert_eq!(refused, PacketError::Version { found: 2 });
    assert!(refused.to_string().contains("update the server"));
    let cut = Packet::decode(&bytes[..bytes.len() - 1]).unwrap_err();
    assert!(matches!(cut, PacketError::Length { .. }));
    assert_eq!(Packet::decode(b"hello"), Err(PacketError::NotAPacket(5)));
}

#[test]
fn a_packet_does_not_become_more_than_its_bytes_can_tell() {
    let mut packed = PackedKeyframe::pack(&keyframe(0), 80).unwrap();
    packed.size = (8192, 8192);
    assert!(matches!(packed.unpack(), Err(PacketError::Content(_))));
    packed.size = (80, 61);
    assert!(matches!(packed.unpack(), Err(PacketError::Content(_))));
}

#[test]
fn large_records_come_in_parts_in_their_order() {
    let noise = |k: u32| k.wrapping_mul(2_654_435_761) >> 8;
    let session = |k: u32| RecordedSession {
        source: noise(k).to_string(),
        first_keyframe: noise(k + 1),
    };
    let record = Record::Continuation(Continuation {
        sessions: (0..30_000).map(session).collect(),
        ..Continuation::default()
    });
    let parts = parts_of(&record).unwrap();
    let parts: Vec<_> = parts
        .into_iter()
        .map(|packet| match packet {
            Packet::Record(part) => part,
            other => panic!("{other:?}"),
        })
        .collect();
    assert!(parts.len() > 2 && parts.iter().all(|part| part.bytes.len() <= PART_BYTES));
    let mut unfinished = Unfinished::default();
    assert!(matches!(
        unfinished.take(&parts[1]),
        Err(PacketError::Content(_))
    ));
    for part in &parts[..parts.len() - 1] {
        assert_eq!(unfinished.take(part).unwrap(), None);
    }
    let mut damaged = parts[parts.len() - 1].clone();
    damaged.bytes[9] ^= 1;
    assert!(unfinished.take(&damaged).is_err());
    assert_eq!(
        unfinished.take(&parts[parts.len() - 1]).unwrap(),
        Some(record)
    );
}

/// What is in a log, in words.
fn words(log: &mut PacketLog) -> Vec<String> {
    let mut unfinished = Unfinished::default();
    let count = log.len();
    let word = |number| match Packet::decode(&log.read(number).unwrap().unwrap()).unwrap() {
        Packet::Keyframe(keyframe) => format!("keyframe {}", keyframe.id),
        Packet::Depth(depth) => format!("depth {} {}", depth.keyframe_id, depth.revision),
        Packet::Record(part) => match unfinished.take(&part).unwrap().unwrap() {
            Record::Session(_) => "session".into(),
            Record::Poses(poses) => format!("{} poses {}", poses.poses.len(), poses.revision),
            Record::Continuation(_) => "continuation".into(),
            Record::End(_) => "end".into(),
            other => format!("{other:?}"),
        },
    };
    (0..count).map(word).collect()
}

#[test]
fn only_what_has_changed_enough_is_packed_until_the_end_which_is_exact() {
    let revision = |revision: u32, factor: f32| {
        let mut pixels = keyframe(1).pixels;
        pixels.iter_mut().for_each(|p| p.idepth *= factor);
        Record::Depth(DepthRevision {
            keyframe_id: 1,
            revision,
            pixels,
        })
    };
    let records = [
        session(),
        Record::Keyframe(keyframe(0)),
        Record::Keyframe(keyframe(1)),
        Record::Poses(poses(1, 0.3)),
        // a hundredth of a percent: within a sigma, and within what a pose may be off
        revision(1, 1.0001),
        Record::Poses(poses(2, 0.3001)),
        revision(2, 1.5),
        // against what was sent last
        revision(3, 1.5001),
        Record::Poses(poses(3, 0.4)),
        Record::Poses(poses(4, 0.4001)),
        Record::Continuation(Continuation::default()),
        Record::End(EndRecord::default()),
    ];
    let mut log = PacketLog::temporary().unwrap();
    let mut packer = Packer::new(75);
    for record in &records {
        packer.pack(record, &mut log).unwrap();
    }
    let expected = [
        "session",
        "keyframe 0",
        "keyframe 1",
        "2 poses 1",
        "depth 1 2",
        "1 poses 3",
        "1 poses 4",
        "continuation",
        "end",
    ];
    assert_eq!(words(&mut log), expected);
    let newest = packer.newest_pose().unwrap();
    assert_eq!((newest.keyframe, newest.timestamp_ns), (1, -3));
    assert_eq!(newest.world_from_keyframe.translation.x, 0.4001);
}

#[test]
fn a_log_is_taken_up_again_without_what_was_cut_off() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("packets.mgf");
    let packets: Vec<Vec<u8>> = [session(), Record::Poses(poses(1, 0.3))]
        .iter()
        .map(|record| parts_of(record).unwrap()[0].encode().unwrap())
        .collect();
    let mut log = PacketLog::open(&path).unwrap();
    for (number, packet) in (0..).zip(&packets) {
        assert_eq!(log.append(packet).unwrap(), number);
    }
    drop(log);
    let bytes = std::fs::read(&path).unwrap();
    for cut in [1, packets[1].len() - 3] {
        std::fs::write(&path, &bytes[..bytes.len() - cut]).unwrap();
        let mut log = PacketLog::open(&path).unwrap();
        assert_eq!(log.len(), 1);
        assert_eq!(log.append(&packets[1]).unwrap(), 1);
        assert_eq!(log.read(1).unwrap().as_ref(), Some(&packets[1]));
        assert_eq!(log.read(2).unwrap(), None);
    }
    std::fs::write(&path, b"something else that is no packet").unwrap();
    assert!(PacketLog::open(&path).is_err());
}

#[test]
fn names_that_could_leave_their_folder_are_refused() {
    for bad in ["", "a/b", "..", "a b", "ä", &"x".repeat(65)] {
        assert!(RunKey::new(bad, 1).is_err(), "{bad}");
    }
    let run = RunKey::new("drone-1", 0xab).unwrap();
    assert_eq!(run.to_string(), "drone-1/00000000000000ab");
    assert_eq!(run.to_string().parse(), Ok(run.clone()));
    assert_eq!(
        Asked::of(&run.key("packets/12")),
        Some(Asked::Packet(run.clone(), 12))
    );
    assert_eq!(Asked::of(&run.key("missing")), Some(Asked::Missing(run)));
    assert_eq!(Asked::of(&format!("{PREFIX}/fleet")), Some(Asked::Fleet));
    for nothing in [
        "agents/../0/missing",
        "agents/a/zz/missing",
        "fleet/x",
        "agents/a/12/packets/1",
    ] {
        assert_eq!(Asked::of(&format!("{PREFIX}/{nothing}")), None);
    }
}
