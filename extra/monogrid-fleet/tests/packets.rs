//! Packets: what comes out is what went in, as far as is promised; what is damaged or of another
//! version is refused.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_datasets::{
    Continuation, DepthPixel, DepthRevision, EndRecord, KeyframeRecord, PoseSnapshot, Record,
    RecordedSession, Scale, SessionInfo, encode_jpeg, encode_jpeg_rgb,
};
use monogrid_fleet::agent::Packer;
use monogrid_fleet::messages::{Asked, PREFIX, RunKey};
use monogrid_fleet::packet::{
    IDEPTH_STEP, MAX_PACKET_BYTES, MAX_PIXELS, PART_BYTES, PackedDepth, PackedKeyframe,
    PackedRevision, Packet, PacketError, RecordPart, SIGMA_STEPS_PER_OCTAVE, Unfinished, parts_of,
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
    packed.size = (2048, 2048);
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
        sessions: (0..80_000).map(session).collect(),
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
        unfinished.after(&parts[1], 10),
        Err(PacketError::Content(_))
    ));
    let mut deflated = Vec::new();
    for (part, number) in parts.iter().zip(1..) {
        assert!(!unfinished.is_whole());
        unfinished = unfinished.after(part, 10).unwrap();
        assert_eq!(unfinished.parts(), number);
        deflated.extend(&part.bytes);
    }
    assert!(unfinished.is_whole());
    assert_eq!(unfinished.record(&deflated).unwrap(), record);
    let last = deflated.len() - 9;
    deflated[last] ^= 1;
    assert!(unfinished.record(&deflated).is_err());
    // the first part begins anew, whatever there was
    let again = unfinished.after(&parts[0], 10).unwrap();
    assert_eq!(again.parts(), 1);
}

#[test]
fn a_record_is_bounded_from_its_first_part() {
    let of = |record: &Record| match parts_of(record).unwrap().remove(0) {
        Packet::Record(part) => part,
        other => panic!("{other:?}"),
    };
    let continuation = |text: String| {
        Record::Continuation(Continuation {
            sessions: vec![RecordedSession {
                source: text,
                first_keyframe: 0,
            }],
            ..Continuation::default()
        })
    };
    let none = Unfinished::default();
    // more than the keyframes that have come can need
    let large = of(&continuation("x".repeat(2 << 20)));
    let refused = none.after(&large, 1).unwrap_err();
    assert!(matches!(refused, PacketError::Beyond { .. }), "{refused}");
    // a bomb: two million bytes in two thousand
    let bomb = none.after(&large, 10);
    let bomb = bomb.and_then(|whole| whole.record(&large.bytes));
    assert!(matches!(bomb, Err(PacketError::Content(_))), "{bomb:?}");
    let small = of(&continuation("x".into()));
    let with = |count: u32, index: u32| {
        let bytes = small.bytes.clone();
        RecordPart {
            index,
            count,
            bytes,
        }
    };
    assert!(none.after(&with(1, 0), 0).unwrap().is_whole());
    // parts without end, none, and more bytes than a part has
    assert!(none.after(&with(u32::MAX, 0), 0).is_err());
    assert!(none.after(&with(0, 0), 0).is_err());
    let mut fat = with(1, 0);
    fat.bytes.resize(PART_BYTES + 1, 0);
    assert!(none.after(&fat, 0).is_err());
    // a first part without the beginning of a record
    let mut other = with(2, 0);
    other.bytes = vec![0xff; 100];
    assert!(none.after(&other, 0).is_err());
}

#[test]
fn an_image_is_of_a_size_that_recordings_have_and_nothing_else_is_decoded() {
    let with_size = |size: (u16, u16), image: (usize, usize)| {
        let jpeg = encode_jpeg(&Image::from_fn(image.0, image.1, |_, _| 7), 50);
        let mut packed = PackedKeyframe::pack(&keyframe(0), 80).unwrap();
        packed.jpeg = jpeg;
        // padded, so that its bytes could tell
        packed.jpeg.resize(4 << 20, 0);
        packed.size = size;
        packed.depth = PackedDepth::pack(&[], size);
        packed
    };
    let long = with_size((8192, 64), (8192, 64)).unpack().unwrap();
    assert_eq!(long.image.unwrap().width(), 8192);
    for size in [(8193, 64), (64, 8193), (16000, 16000), (4096, 4096), (0, 5)] {
        let refused = with_size(size, (64, 64)).unpack().unwrap_err();
        let PacketError::Beyond { found, .. } = &refused else {
            panic!("{refused}");
        };
        assert_eq!(*found, format!("{}x{} px", size.0, size.1));
        assert!(PackedDepth::pack(&[], (80, 60)).unpack(size).is_err());
    }
    // another image than its size says
    assert!(with_size((64, 64), (64, 65)).unpack().is_err());
    // not the end of the scan but a second one
    let mut two = with_size((64, 64), (64, 64));
    assert!(two.unpack().is_ok());
    let scan = two.jpeg.windows(2).position(|m| m == [0xff, 0xda]).unwrap();
    let (begin, end) = (two.jpeg[..scan].to_vec(), two.jpeg[scan..].to_vec());
    let scan_bytes = end.windows(2).position(|m| m == [0xff, 0xd9]).unwrap();
    two.jpeg = [&begin, &end[..scan_bytes], &end].concat();
    assert!(two.unpack().is_err());
    // progressive
    let mut progressive = with_size((64, 64), (64, 64));
    let frame = progressive.jpeg.windows(2).position(|m| m == [0xff, 0xc0]);
    progressive.jpeg[frame.unwrap() + 1] = 0xc2;
    assert!(progressive.unpack().is_err());
    // colour
    let colour = Image::from_fn(64, 64, |x, _| [x as u8; 3]);
    let mut coloured = with_size((64, 64), (64, 64));
    coloured.jpeg = encode_jpeg_rgb(&colour, 80);
    assert!(coloured.unpack().is_err());
}

#[test]
fn a_camera_and_a_time_of_a_keyframe_are_sane() {
    let good = PackedKeyframe::pack(&keyframe(0), 80).unwrap();
    for focal in [f64::NAN, 0.0, -60.0, 1e300] {
        let mut bad = good.clone();
        bad.camera = Some([focal, 60.0, 40.0, 30.0]);
        assert!(
            matches!(bad.unpack(), Err(PacketError::Beyond { .. })),
            "{focal}"
        );
    }
    for timestamp_ns in [i64::MIN, i64::MAX] {
        let bad = PackedKeyframe {
            timestamp_ns,
            ..good.clone()
        };
        assert!(matches!(bad.unpack(), Err(PacketError::Beyond { .. })));
    }
    let mut own = good;
    own.camera = Some([60.0, 60.0, 40.0, 30.0]);
    assert!(own.unpack().is_ok());
}

#[test]
fn a_packet_is_of_a_size_that_servers_take() {
    let mut packed = PackedKeyframe::pack(&keyframe(0), 80).unwrap();
    packed.jpeg.resize(MAX_PACKET_BYTES, 0);
    let encoded = Packet::Keyframe(packed).encode();
    assert_eq!(encoded, Err(PacketError::TooLarge));
    let large = vec![0; MAX_PACKET_BYTES + 1];
    assert!(matches!(
        Packet::decode(&large),
        Err(PacketError::Beyond { .. })
    ));
}

/// What is in a log, in words.
fn words(log: &PacketLog) -> Vec<String> {
    let count = log.len();
    let word = |number| match Packet::decode(&log.read(number).unwrap().unwrap()).unwrap() {
        Packet::Keyframe(keyframe) => format!("keyframe {}", keyframe.id),
        Packet::Depth(depth) => format!("depth {} {}", depth.keyframe_id, depth.revision),
        Packet::Record(part) => match Unfinished::default()
            .after(&part, 2)
            .and_then(|whole| whole.record(&part.bytes))
            .unwrap()
        {
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
    assert_eq!(words(&log), expected);
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

/// Damaged copies of a packet, whose length and checksum are right.
fn mutant(packet: &[u8], number: u64) -> Vec<u8> {
    // Marsaglia's xorshift: the same mutants in every run
    let mut state = 0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(number + 1);
    let mut random = |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 16) as usize % below.max(1)
    };
    let mut bytes = packet.to_vec();
    for _ in 0..=random(3) {
        // mostly in the first fields
        let reach = if random(2) == 0 { 100 } else { bytes.len() };
        let at = 16 + random(reach.min(bytes.len()) - 16);
        match random(5) {
            0 => bytes[at] ^= 1 << random(8),
            1 => bytes[at] = 0xff,
            2 => bytes[at..].iter_mut().take(9).for_each(|byte| *byte = 0xff),
            3 => bytes.truncate(at.max(20)),
            _ => drop(bytes.splice(at..at, [0x80; 30])),
        }
    }
    let length = (bytes.len() - 16) as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    let checksum = crc32fast::hash(&[&bytes[4..12], &bytes[16..]].concat());
    bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

#[test]
fn mutated_packets_are_refused_or_sane() {
    let number = std::env::var("TORTURE_MUTANTS").unwrap_or_default();
    let mutants: u64 = number.parse().ok().filter(|n| *n > 0).unwrap_or(1000);
    let before = keyframe(4);
    let revision = DepthRevision {
        keyframe_id: 4,
        revision: 2,
        pixels: before.pixels.clone(),
    };
    let mut packets = vec![
        Packet::Keyframe(PackedKeyframe::pack(&before, 90).unwrap()),
        Packet::Depth(PackedRevision::pack(&revision, (80, 60))),
    ];
    packets.extend(parts_of(&session()).unwrap());
    packets.extend(parts_of(&Record::Poses(poses(3, 0.5))).unwrap());
    for packet in &packets {
        let bytes = packet.encode().unwrap();
        let mut refused = 0;
        for number in 0..mutants {
            let taken = match Packet::decode(&mutant(&bytes, number)) {
                Ok(Packet::Keyframe(keyframe)) => keyframe.unpack().map(|keyframe| {
                    let image = keyframe.image.unwrap();
                    assert!(image.width() * image.height() <= MAX_PIXELS);
                }),
                Ok(Packet::Depth(depth)) => depth.unpack().map(|depth| {
                    let sane = |p: &DepthPixel| p.idepth.is_finite() && p.idepth_var.is_finite();
                    assert!(depth.pixels.iter().all(sane));
                }),
                Ok(Packet::Record(part)) => {
                    let whole = Unfinished::default().after(&part, 10);
                    whole.and_then(|whole| whole.record(&part.bytes)).map(drop)
                }
                Err(error) => Err(error),
            };
            refused += u64::from(taken.is_err());
        }
        assert!(refused > mutants / 10, "{refused} of {mutants}");
    }
}
