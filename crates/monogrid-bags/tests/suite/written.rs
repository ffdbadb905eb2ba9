//! Files that are written: byte for byte those of `data/written.mcap`, which the crate `mcap` 0.26
//! wrote, and indexes that point at what they say.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_bags::{Bag, McapWriter};
use monogrid_datasets::encode_png;
use monogrid_image::Image;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::{Pose, PoseStamped, TransformStamped};
use monogrid_messages::nav_msgs::Path;
use monogrid_messages::sensor_msgs::CompressedImage;
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use std::collections::BTreeMap;
use std::io::{self, Write};

const WRITTEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/written.mcap");

fn header(time_ns: i64) -> Header {
    Header {
        stamp: Time::from_nanoseconds(time_ns),
        frame_id: "map".to_owned(),
    }
}

fn path(time_ns: i64, poses: usize) -> Path {
    let pose = |_| PoseStamped {
        header: header(time_ns),
        pose: Pose::default(),
    };
    Path {
        header: header(time_ns),
        poses: (0..poses).map(pose).collect(),
    }
}

fn transform(time_ns: i64) -> TFMessage {
    let transform = TransformStamped {
        header: header(time_ns),
        child_frame_id: "camera".to_owned(),
        ..TransformStamped::default()
    };
    TFMessage {
        transforms: vec![transform],
    }
}

/// Topics that share a type, times that go back and before the epoch, notes that close a chunk and
/// one that finds none open.
fn write_small(out: &mut impl Write) -> io::Result<()> {
    let mut writer = McapWriter::new(out, "a test")?;
    let facts = [("unit of length", "m"), ("b", ""), ("a", "ä")];
    let facts = BTreeMap::from(facts.map(|(name, fact)| (name.to_owned(), fact.to_owned())));
    writer.note("facts", facts)?;
    writer.write("/path", 2_000_000_000, &path(2_000_000_000, 1))?;
    for k in 0..3 {
        writer.write("/tf", 1_000_000_000 + k, &transform(k))?;
        writer.write("/smooth/path", 3_000_000_000 - k, &path(k, 0))?;
    }
    writer.note("in between", BTreeMap::new())?;
    writer.write("/tf", -1, &transform(-1))?;
    writer.write("/tf", 1_500_000_000, &transform(0))?;
    writer.finish()
}

/// Takes a few bytes at a time, and none beyond a limit.
struct Trickle {
    bytes: Vec<u8>,
    limit: usize,
}

impl Write for Trickle {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = bytes.len().min(7).min(self.limit - self.bytes.len());
        self.bytes.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn files_are_as_they_were_before_into_whatever_takes_bytes() {
    let expected = std::fs::read(WRITTEN).unwrap();
    let mut out = Trickle {
        bytes: Vec::new(),
        limit: expected.len(),
    };
    write_small(&mut out).unwrap();
    assert!(out.bytes == expected);
    for limit in 0..expected.len() {
        let bytes = Vec::new();
        assert!(write_small(&mut Trickle { bytes, limit }).is_err());
    }
}

#[test]
fn a_file_that_is_cut_anywhere_gives_what_was_before_the_cut() {
    let cut = tempfile::NamedTempFile::new().unwrap();
    let length = std::fs::copy(WRITTEN, cut.path()).unwrap();
    let mut topics = 3;
    for end in (0..length).rev() {
        cut.as_file().set_len(end).unwrap();
        let found = Bag::open(cut.path()).map_or(0, |bag| bag.topics().len());
        assert!(found <= topics, "{found} of {end} bytes");
        topics = found;
        if end == length - 1 {
            assert_eq!(found, 3);
        }
    }
}

/// Grey values that no compression makes fewer.
fn noise(seed: u32) -> Image<u8> {
    let mut state = seed;
    Image::from_fn(300, 300, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    })
}

const IMAGES: u32 = 40;

/// Images of some 90 kB on two topics: 3.6 MB.
fn write_large() -> Vec<u8> {
    let mut out = Vec::new();
    let mut writer = McapWriter::new(&mut out, "a test").unwrap();
    for k in 0..IMAGES {
        let time_ns = 1_000 + i64::from(k);
        let image = CompressedImage {
            header: header(time_ns),
            format: "png".to_owned(),
            data: encode_png(&noise(k)),
        };
        let topic = if k % 3 == 0 { "/left" } else { "/right" };
        writer.write(topic, time_ns, &image).unwrap();
    }
    writer.finish().unwrap();
    out
}

#[test]
fn several_chunks_are_read_again() {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), write_large()).unwrap();
    let bag = Bag::open(file.path()).unwrap();
    let mut num_images = 0;
    for topic in bag.topics() {
        for image in bag.images(topic) {
            let (time_ns, image) = image.unwrap();
            let expected = noise(u32::try_from(time_ns - 1_000).unwrap());
            let (x, y) = (299, 298);
            assert_eq!(image.at(x, y), f32::from(expected.at(x, y)));
            num_images += 1;
        }
    }
    assert_eq!(num_images, IMAGES);
}

/// Fields of a record as the specification has them (<https://mcap.dev/spec>).
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn slice(&mut self, length: u64) -> &'a [u8] {
        let (bytes, rest) = self.0.split_at(length as usize);
        self.0 = rest;
        bytes
    }

    fn int(&mut self, bytes: u64) -> u64 {
        let bytes = self.slice(bytes).iter().rev();
        bytes.fold(0, |number, byte| number << 8 | u64::from(*byte))
    }

    /// Pairs of such sizes, behind the number of their bytes.
    fn pairs(&mut self, first: u64, second: u64) -> Vec<(u64, u64)> {
        let length = self.int(4);
        let mut fields = Fields(self.slice(length));
        let mut pairs = Vec::new();
        while !fields.0.is_empty() {
            pairs.push((fields.int(first), fields.int(second)));
        }
        pairs
    }
}

/// The record that begins there.
fn record(bytes: &[u8], at: u64) -> (u8, Fields<'_>) {
    let mut fields = Fields(&bytes[at as usize..]);
    let opcode = fields.int(1) as u8;
    let length = fields.int(8);
    (opcode, Fields(fields.slice(length)))
}

/// All records, and where each begins.
fn records(bytes: &[u8]) -> Vec<(u64, u8, Fields<'_>)> {
    let (mut at, mut found) = (0, Vec::new());
    while at < bytes.len() as u64 {
        let (opcode, body) = record(bytes, at);
        let length = 9 + body.0.len() as u64;
        found.push((at, opcode, body));
        at += length;
    }
    found
}

/// A chunk is where its index says, and its messages where theirs say; how many there are.
fn check_chunk(file: &[u8], mut index: Fields) -> usize {
    let times = (index.int(8), index.int(8));
    let (start, length) = (index.int(8), index.int(8));
    let message_indexes = index.pairs(2, 8);
    let index_length = index.int(8);
    assert_eq!((index.int(4), index.0.len()), (0, 16), "no compression");

    let (opcode, mut chunk) = record(file, start);
    assert_eq!((opcode, chunk.0.len() as u64), (6, length - 9));
    assert_eq!((chunk.int(8), chunk.int(8)), times);
    let (size, crc, _compression) = (chunk.int(8), chunk.int(4), chunk.int(4));
    assert_eq!((size, size), (index.int(8), index.int(8)));
    assert_eq!((size, size), (chunk.int(8), chunk.0.len() as u64));
    assert_eq!(u64::from(crc32fast::hash(chunk.0)), crc);

    let mut found = Vec::new();
    let mut indexes_end = start + length;
    for (channel, at) in message_indexes {
        assert_eq!(at, indexes_end);
        let (opcode, mut index) = record(file, at);
        indexes_end += 9 + index.0.len() as u64;
        assert_eq!((opcode, index.int(2)), (7, channel));
        for (time, at) in index.pairs(8, 8) {
            let (opcode, mut message) = record(chunk.0, at);
            assert_eq!((opcode, message.int(2)), (5, channel));
            let (_sequence, log_time) = (message.int(4), message.int(8));
            assert_eq!(log_time, time);
            found.push(time);
        }
    }
    assert_eq!(indexes_end, start + length + index_length);
    let bounds = (*found.iter().min().unwrap(), *found.iter().max().unwrap());
    assert_eq!(bounds, times);
    let records = records(chunk.0);
    let messages = records.iter().filter(|(_, opcode, _)| *opcode == 5);
    assert_eq!(messages.count(), found.len());
    found.len()
}

/// Everything that a reader that seeks follows from the end of the file; how many messages there
/// are in how many chunks.
fn check_indexes(file: &[u8]) -> (usize, usize) {
    let end = file.len() as u64 - 8;
    let (opcode, mut footer) = record(file, end - 29);
    assert_eq!((opcode, footer.0.len()), (2, 20));
    let (start, offsets, crc) = (footer.int(8), footer.int(8), footer.int(4));
    let summary = &file[start as usize..end as usize];
    let summed = &summary[..summary.len() - 4];
    assert_eq!(u64::from(crc32fast::hash(summed)), crc);
    let (opcode, mut data_end) = record(file, start - 13);
    let data = &file[..start as usize - 13];
    let data_crc = u64::from(crc32fast::hash(data));
    assert_eq!((opcode, data_end.int(4)), (15, data_crc));

    // groups follow each other, and each is of one kind
    let mut next = start;
    for (_, opcode, mut offset) in records(&file[offsets as usize..end as usize - 29]) {
        let group = offset.int(1);
        assert_eq!((opcode, offset.int(8)), (14, next));
        let group_end = next + offset.int(8);
        for (_, opcode, _) in records(&file[next as usize..group_end as usize]) {
            assert_eq!(u64::from(opcode), group);
        }
        next = group_end;
    }
    assert_eq!(next, offsets);

    let (mut messages, mut chunks) = (0, 0);
    for (_, opcode, index) in records(&file[start as usize..offsets as usize]) {
        if opcode == 8 {
            messages += check_chunk(file, index);
            chunks += 1;
        }
    }
    (messages, chunks)
}

#[test]
fn indexes_point_at_chunks_and_messages() {
    let mut small = Vec::new();
    write_small(&mut small).unwrap();
    assert_eq!(check_indexes(&small), (9, 2));
    // a chunk is closed once it has more than 1 MB
    assert_eq!(check_indexes(&write_large()), (IMAGES as usize, 4));
}

#[test]
fn a_file_without_messages_is_complete() {
    let mut out = Vec::new();
    let writer = McapWriter::new(&mut out, "a test").unwrap();
    writer.finish().unwrap();
    assert_eq!(check_indexes(&out), (0, 0));
}
