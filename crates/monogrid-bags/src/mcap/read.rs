//! Messages of MCAP files, from the beginning to the footer. Indexes are not needed for that, and checksums not compared: of what is
//! damaged, messages that can be read are given.

use super::{MAGIC, op};
use crate::bag::{Messages, TopicKind};
use crate::chunks::{Unpacker, block, in_chunks};
use crate::error::BagError;
use crate::fields::Fields;
use crate::message::{Raw, Wire};
use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::sync::Arc;

/// The messages of a file.
pub fn messages(path: &Path) -> Result<Messages, BagError> {
    let file = File::open(path).map_err(BagError::io(path))?;
    let mut records = McapMessages {
        file: BufReader::with_capacity(1 << 18, file),
        schemas: HashMap::new(),
        channels: HashMap::new(),
        unpacker: Unpacker::default(),
    };
    records
        .expect_magic()
        .map_err(|reason| BagError::damaged(path, reason))?;
    Ok(in_chunks(path, move |messages| records.read_on(messages)))
}

struct Channel {
    topic: Arc<str>,
    kind: TopicKind,
    wire: Option<Wire>,
}

struct McapMessages {
    file: BufReader<File>,
    /// Kinds of types; only ever asked by number.
    schemas: HashMap<u16, TopicKind>,
    channels: HashMap<u16, Channel>,
    unpacker: Unpacker,
}

impl McapMessages {
    /// Reads the next record and takes what it says; whether it was not the last one.
    fn read_on(&mut self, messages: &mut VecDeque<Raw>) -> Result<bool, String> {
        let mut head = [0; 9];
        self.file.read_exact(&mut head).map_err(cut)?;
        let [opcode, length @ ..] = head;
        let body = block(&mut self.file, u64::from_le_bytes(length))?;
        match opcode {
            op::CHUNK => self.take_chunk(Fields(&body), messages)?,
            op::FOOTER => self.expect_magic()?,
            _ => self.take(opcode, Fields(&body), messages)?,
        }
        Ok(opcode != op::FOOTER)
    }

    fn expect_magic(&mut self) -> Result<(), String> {
        let mut magic = [0; MAGIC.len()];
        self.file.read_exact(&mut magic).map_err(cut)?;
        if magic != *MAGIC {
            let (found, expected) = (magic.escape_ascii(), MAGIC.escape_ascii());
            return Err(format!("{found} where {expected} is expected"));
        }
        Ok(())
    }

    /// Takes what the records of a chunk say.
    fn take_chunk(&mut self, chunk: Fields, messages: &mut VecDeque<Raw>) -> Result<(), String> {
        let (compression, size, data) = chunk_of(chunk).ok_or_else(|| too_short(op::CHUNK))?;
        let records = self.unpacker.unpacked(compression, data, size)?;
        let mut rest = Fields(&records);
        while !rest.0.is_empty() {
            let (opcode, body) = record_of(&mut rest).ok_or("a chunk ends within a record")?;
            self.take(opcode, Fields(body), messages)?;
        }
        Ok(())
    }

    /// Takes what a record says.
    fn take(
        &mut self,
        opcode: u8,
        body: Fields,
        messages: &mut VecDeque<Raw>,
    ) -> Result<(), String> {
        let taken = match opcode {
            op::SCHEMA => self.take_schema(body),
            op::CHANNEL => self.take_channel(body),
            op::MESSAGE => return self.take_message(body, messages),
            _ => Some(()),
        };
        taken.ok_or_else(|| too_short(opcode))
    }

    fn take_schema(&mut self, mut body: Fields) -> Option<()> {
        let id = body.u16()?;
        self.schemas.insert(id, TopicKind::of(body.text()?));
        Some(())
    }

    fn take_channel(&mut self, mut body: Fields) -> Option<()> {
        let (id, schema) = (body.u16()?, body.u16()?);
        let kind = self.schemas.get(&schema).copied();
        let channel = Channel {
            topic: body.text()?.into(),
            kind: kind.unwrap_or(TopicKind::Other),
            wire: match body.text()? {
                "cdr" => Some(Wire::Cdr),
                "ros1" => Some(Wire::Ros1),
                _ => None,
            },
        };
        self.channels.insert(id, channel);
        Some(())
    }

    fn take_message(&mut self, body: Fields, messages: &mut VecDeque<Raw>) -> Result<(), String> {
        let (id, log_time, data) = message_of(body).ok_or_else(|| too_short(op::MESSAGE))?;
        let channel = self.channels.get(&id);
        let channel =
            channel.ok_or_else(|| format!("a message of channel {id}, which was not declared"))?;
        if let Some(wire) = channel.wire {
            let log_ns = i64::try_from(log_time).unwrap_or(i64::MAX);
            messages.push_back(Raw::new(&channel.topic, channel.kind, log_ns, wire, data));
        }
        Ok(())
    }
}

fn cut(error: io::Error) -> String {
    format!("the file ends before its footer, or cannot be read: {error}")
}

fn too_short(opcode: u8) -> String {
    format!("a record of kind {opcode} ends within its fields, or its text is not UTF-8")
}

/// Opcode and body of the next record in a chunk.
fn record_of<'a>(records: &mut Fields<'a>) -> Option<(u8, &'a [u8])> {
    let (opcode, length) = (records.u8()?, records.u64()?);
    Some((opcode, records.slice(length)?))
}

/// Compression of a chunk, bytes of its records without it, and what is there.
fn chunk_of(mut chunk: Fields<'_>) -> Option<(&str, u64, &[u8])> {
    let _times = (chunk.u64()?, chunk.u64()?);
    let (size, _crc) = (chunk.u64()?, chunk.u32()?);
    let (compression, length) = (chunk.text()?, chunk.u64()?);
    Some((compression, size, chunk.slice(length)?))
}

/// Channel of a message, when it was recorded (ns), and its bytes.
fn message_of(mut message: Fields<'_>) -> Option<(u16, u64, &[u8])> {
    let (channel, _sequence) = (message.u16()?, message.u32()?);
    let (log_time, _publish_time) = (message.u64()?, message.u64()?);
    Some((channel, log_time, message.0))
}

#[cfg(test)]
mod tests {
    use super::super::record::Record;
    use super::*;

    const IMAGE: &str = "sensor_msgs/msg/Image";

    fn schema(id: u16, name: &str) -> Record {
        let record = Record::new(op::SCHEMA).u16(id).text(name);
        record.text("ros2msg").text("")
    }

    fn channel(id: u16, schema: u16, encoding: &str) -> Record {
        let record = Record::new(op::CHANNEL).u16(id).u16(schema);
        record.text("/topic").text(encoding).bytes(&[])
    }

    fn message(channel: u16, time: u64) -> Record {
        let record = Record::new(op::MESSAGE).u16(channel).u32(0);
        record.u64(time).u64(0).raw(&[1, 2, 3])
    }

    fn chunk(compression: &str, size: u64, records: &[u8]) -> Record {
        let record = Record::new(op::CHUNK).u64(0).u64(0).u64(size).u32(0);
        let record = record.text(compression).u64(records.len() as u64);
        record.raw(records)
    }

    fn footer() -> Record {
        Record::new(op::FOOTER).u64(0).u64(0).u32(0)
    }

    fn bytes(records: Vec<Record>) -> Vec<u8> {
        let records = records.into_iter();
        records.flat_map(|r| r.finish().unwrap()).collect()
    }

    /// The messages of a file of these bytes, and why there are no more.
    fn read(records: &[u8]) -> (Vec<Raw>, Option<String>) {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), [MAGIC, records].concat()).unwrap();
        let (mut read, mut error) = (Vec::new(), None);
        for message in messages(file.path()).unwrap() {
            match message {
                Ok(message) => read.push(message),
                Err(reason) => error = Some(reason.to_string()),
            }
        }
        (read, error)
    }

    /// A channel and a message before what is asked about.
    fn start() -> Vec<Record> {
        vec![schema(1, IMAGE), channel(1, 1, "cdr"), message(1, 5)]
    }

    #[test]
    fn messages_lie_in_chunks_or_beside_them_and_other_records_are_skipped() {
        let mut records = start();
        let in_chunk = bytes(vec![channel(2, 7, "ros1"), message(2, u64::MAX)]);
        records.push(chunk("", in_chunk.len() as u64, &in_chunk));
        records.push(Record::new(0x80).raw(&[9; 40]));
        records.extend([
            channel(3, 1, "json"),
            message(3, 6),
            message(1, 7),
            footer(),
        ]);
        let (read, error) = read(&[&bytes(records), MAGIC, b"behind it"].concat());
        assert_eq!(error, None);
        let read = read
            .iter()
            .map(|m| (m.log_ns, m.kind, m.wire, m.data.len()));
        let expected = [
            (5, TopicKind::Image, Wire::Cdr, 3),
            // of a schema that is not there
            (i64::MAX, TopicKind::Other, Wire::Ros1, 0),
            (7, TopicKind::Image, Wire::Cdr, 3),
        ];
        assert_eq!(read.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn damage_is_named_behind_what_comes_before_it() {
        let huge = [0xFF; 9];
        let bad_topic = Record::new(op::CHANNEL).u16(2).u16(1).bytes(&[0xFF]);
        let cut_record = bytes(vec![message(1, 6)]);
        let cut_record = &cut_record[..cut_record.len() - 1];
        let damages = [
            (bytes(vec![message(2, 5)]), "channel 2"),
            (huge.to_vec(), "claims 18446744073709551615 bytes"),
            (cut_record.to_vec(), "ends within a record"),
            (Vec::new(), "before its footer"),
            (vec![op::FOOTER, 0, 0], "before its footer"),
            (bytes(vec![Record::new(op::SCHEMA).u8(1)]), "kind 3"),
            (bytes(vec![bad_topic]), "kind 4"),
            (bytes(vec![Record::new(op::MESSAGE).u16(1)]), "kind 5"),
            (bytes(vec![Record::new(op::CHUNK).u64(1)]), "kind 6"),
            (bytes(vec![chunk("br", 1, &[0])]), "\"br\" is not supported"),
            (
                bytes(vec![chunk("", 1 << 40, &[0])]),
                "claims to hold 1099511627776",
            ),
            (bytes(vec![chunk("", 2, &[0])]), "holds 1 bytes, expected 2"),
            (
                bytes(vec![chunk("", 1, &[0; 5])]),
                "holds 2 bytes, expected 1",
            ),
            (bytes(vec![chunk("zstd", 1, &[0])]), "zstd"),
            (bytes(vec![chunk("lz4", 1, &[0])]), "lz4"),
            (
                bytes(vec![chunk("", 1, &[5])]),
                "chunk ends within a record",
            ),
            ([&bytes(vec![footer()]), huge.as_slice()].concat(), "MCAP"),
        ];
        for (damage, expected) in damages {
            let (read, error) = read(&[bytes(start()), damage].concat());
            let error = error.unwrap();
            assert!(error.contains(expected), "{error}, not {expected}");
            assert_eq!(read.len(), 1, "{error}");
        }
    }
}
