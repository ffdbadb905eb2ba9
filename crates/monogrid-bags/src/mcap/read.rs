//! Messages of MCAP files, from the beginning to the footer; topics from the summary behind it,
//! where there is one. Checksums are compared: what comes before damage is given.

use super::{MAGIC, op};
use crate::chunks::{Unpacker, block, in_chunks};
use crate::error::BagError;
use crate::fields::Fields;
use crate::message::{Messages, Raw, Wire};
use crate::part::{Input, Part};
use crate::topic::{Indexed, Topic};
use crc32fast::Hasher;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

/// Bytes of the record that ends a file, without its magic.
const FOOTER_BYTES: u64 = 9 + 20;

/// The topics of a file by its summary; `None` where it has none that can be used.
pub fn topics(part: &Part) -> Result<Option<Vec<Indexed>>, BagError> {
    let mut input = part.open()?;
    Ok(summary(&mut input).ok().flatten())
}

fn summary(input: &mut Input) -> Result<Option<Vec<Indexed>>, String> {
    let end = input.length().map_err(cut)?;
    let end = end.saturating_sub(MAGIC.len() as u64);
    let footer_start = end.saturating_sub(FOOTER_BYTES);
    input.seek(SeekFrom::Start(footer_start)).map_err(cut)?;
    let footer = block(input, end - footer_start)?;
    let mut fields = Fields(&footer);
    let Some((op::FOOTER, mut body)) = record_of(&mut fields).map(|(o, b)| (o, Fields(b))) else {
        return Ok(None);
    };
    let (Some(start), Some(_), Some(crc)) = (body.u64(), body.u64(), body.u32()) else {
        return Ok(None);
    };
    if start == 0 || start >= footer_start {
        return Ok(None);
    }
    input.seek(SeekFrom::Start(start)).map_err(cut)?;
    let records = block(input, footer_start - start)?;
    let mut sum = Hasher::new();
    sum.update(&records);
    sum.update(&footer[..footer.len() - 4]);
    if crc != 0 && crc != sum.finalize() {
        return Ok(None);
    }
    let (mut declared, mut counts) = (Declared::default(), None);
    let mut rest = Fields(&records);
    while let Some((opcode, body)) = record_of(&mut rest) {
        match opcode {
            op::SCHEMA => declared.take_schema(Fields(body)),
            op::CHANNEL => declared.take_channel(Fields(body)),
            op::STATISTICS => {
                counts = message_counts(Fields(body));
                Some(())
            }
            _ => Some(()),
        }
        .ok_or_else(|| too_short(opcode))?;
    }
    Ok(declared.indexed(counts.as_ref()))
}

/// Messages by channel.
fn message_counts(mut body: Fields) -> Option<BTreeMap<u16, u64>> {
    // counts of messages, schemas, channels, attachments, metadata and chunks, then the first and
    // the last time
    body.slice(8 + 2 + 4 + 4 + 4 + 4 + 8 + 8)?;
    let mut pairs = Fields(body.bytes()?);
    let pairs = std::iter::from_fn(|| Some((pairs.u16()?, pairs.u64()?)));
    Some(pairs.collect())
}

/// The messages of a file.
pub fn messages(part: &Part) -> Result<Messages, BagError> {
    let mut records = McapMessages {
        file: Summed::new(BufReader::with_capacity(1 << 18, part.open()?)),
        declared: Declared::default(),
        unpacker: part.unpacker(),
    };
    records
        .expect_magic()
        .map_err(|reason| BagError::damaged(&part.path, reason))?;
    Ok(in_chunks(&part.path, move |messages| {
        records.read_on(messages)
    }))
}

struct Channel {
    topic: Arc<Topic>,
    wire: Option<Wire>,
}

/// What schemas and channels a file has declared.
#[derive(Default)]
struct Declared {
    /// Types; only ever asked by number.
    schemas: HashMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
}

impl Declared {
    fn take_schema(&mut self, mut body: Fields) -> Option<()> {
        let id = body.u16()?;
        self.schemas.insert(id, body.text()?.to_owned());
        Some(())
    }

    fn take_channel(&mut self, mut body: Fields) -> Option<()> {
        let (id, schema) = (body.u16()?, body.u16()?);
        let type_name = self.schemas.get(&schema).map_or("", String::as_str);
        let channel = Channel {
            topic: Arc::new(Topic::new(body.text()?, type_name)),
            wire: Wire::of(body.text()?),
        };
        self.channels.insert(id, channel);
        Some(())
    }

    fn indexed(&self, counts: Option<&BTreeMap<u16, u64>>) -> Option<Vec<Indexed>> {
        let indexed = |(id, channel): (&u16, &Channel)| Indexed {
            topic: Topic::clone(&channel.topic),
            messages: counts.map(|counts| counts.get(id).copied().unwrap_or(0)),
        };
        let indexed: Vec<Indexed> = self.channels.iter().map(indexed).collect();
        (!indexed.is_empty()).then_some(indexed)
    }
}

/// Reads, and keeps the checksum of what was read.
struct Summed<R> {
    input: R,
    sum: Hasher,
}

impl<R: Read> Summed<R> {
    fn new(input: R) -> Self {
        Self {
            input,
            sum: Hasher::new(),
        }
    }

    /// Begins anew behind what was read.
    fn restart(&mut self) {
        self.sum = Hasher::new();
    }
}

impl<R: Read> Read for Summed<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.input.read(bytes)?;
        self.sum.update(&bytes[..read]);
        Ok(read)
    }
}

struct McapMessages {
    file: Summed<BufReader<Input>>,
    declared: Declared,
    unpacker: Unpacker,
}

impl McapMessages {
    /// Reads the next record and takes what it says; whether it was not the last one.
    fn read_on(&mut self, messages: &mut VecDeque<Raw>) -> Result<bool, String> {
        let before = self.file.sum.clone();
        let mut head = [0; 9];
        self.file.read_exact(&mut head).map_err(cut)?;
        let [opcode, length @ ..] = head;
        let body = block(&mut self.file, u64::from_le_bytes(length))?;
        match opcode {
            op::CHUNK => self.take_chunk(Fields(&body), messages)?,
            op::DATA_END => {
                let expected = Fields(&body).u32().ok_or_else(|| too_short(opcode))?;
                compare("the part with the messages", before.finalize(), expected)?;
                // that of the summary begins here
                self.file.restart();
            }
            op::FOOTER => {
                let (summed, crc) = body.split_at_checked(16).ok_or_else(|| too_short(opcode))?;
                let expected = Fields(crc).u32().ok_or_else(|| too_short(opcode))?;
                let mut sum = before;
                sum.update(&head);
                sum.update(summed);
                compare("the summary", sum.finalize(), expected)?;
                self.expect_magic()?;
            }
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
        let chunk = chunk_of(chunk).ok_or_else(|| too_short(op::CHUNK))?;
        let records = self
            .unpacker
            .unpacked(chunk.compression, chunk.data, chunk.size)?;
        compare("a chunk", crc32fast::hash(&records), chunk.crc)?;
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
            op::SCHEMA => self.declared.take_schema(body),
            op::CHANNEL => self.declared.take_channel(body),
            op::MESSAGE => return self.take_message(body, messages),
            _ => Some(()),
        };
        taken.ok_or_else(|| too_short(opcode))
    }

    fn take_message(&mut self, body: Fields, messages: &mut VecDeque<Raw>) -> Result<(), String> {
        let (id, log_time, data) = message_of(body).ok_or_else(|| too_short(op::MESSAGE))?;
        let channel = self.declared.channels.get(&id);
        let channel =
            channel.ok_or_else(|| format!("a message of channel {id}, which was not declared"))?;
        let log_ns = i64::try_from(log_time).unwrap_or(i64::MAX);
        messages.push_back(Raw::new(&channel.topic, log_ns, channel.wire, data));
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

/// A chunk as it lies in the file.
struct PackedChunk<'a> {
    compression: &'a str,
    /// Bytes of its records without compression, and their checksum; 0 where it was not computed.
    size: u64,
    crc: u32,
    data: &'a [u8],
}

fn chunk_of(mut chunk: Fields<'_>) -> Option<PackedChunk<'_>> {
    let _times = (chunk.u64()?, chunk.u64()?);
    let (size, crc) = (chunk.u64()?, chunk.u32()?);
    let (compression, length) = (chunk.text()?, chunk.u64()?);
    Some(PackedChunk {
        compression,
        size,
        crc,
        data: chunk.slice(length)?,
    })
}

/// Compares checksums; one of 0 was not computed.
fn compare(what: &str, found: u32, expected: u32) -> Result<(), String> {
    if expected != 0 && found != expected {
        return Err(format!(
            "{what} is damaged: its checksum is {found:08x}, expected {expected:08x}"
        ));
    }
    Ok(())
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
    use crate::part::parts_of;
    use crate::topic::TopicKind;

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
        let part = parts_of(file.path()).unwrap().remove(0);
        for message in messages(&part).unwrap() {
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
            channel(3, 1, "cbor"),
            message(3, 6),
            message(1, 7),
            footer(),
        ]);
        let (read, error) = read(&[&bytes(records), MAGIC, b"behind it"].concat());
        assert_eq!(error, None);
        let read = read
            .iter()
            .map(|m| (m.log_ns, m.topic.kind, m.wire, m.data.len()));
        let expected = [
            (5, TopicKind::Image, Some(Wire::Cdr), 3),
            // of a schema that is not there
            (i64::MAX, TopicKind::Other, Some(Wire::Ros1), 0),
            // written as nobody knows
            (6, TopicKind::Image, None, 0),
            (7, TopicKind::Image, Some(Wire::Cdr), 3),
        ];
        assert_eq!(read.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn checksums_are_compared_where_they_were_computed() {
        let records = bytes(vec![message(1, 6)]);
        let chunk = |crc: u32| {
            let record = Record::new(op::CHUNK)
                .u64(0)
                .u64(0)
                .u64(records.len() as u64);
            record
                .u32(crc)
                .text("")
                .u64(records.len() as u64)
                .raw(&records)
        };
        let right = crc32fast::hash(&records);
        let data = |crc| [bytes(start()), bytes(vec![chunk(crc)])].concat();
        let sum_of_data = crc32fast::hash(&[MAGIC, &data(right)].concat());
        let end = |data_crc: u32, summary_crc: u32| {
            let records = vec![
                Record::new(op::DATA_END).u32(data_crc),
                Record::new(0x80).raw(&[7; 5]),
                Record::new(op::FOOTER).u64(1).u64(0).u32(summary_crc),
            ];
            [&bytes(records), MAGIC].concat()
        };
        let summary = end(0, 0);
        let sum_of_summary = crc32fast::hash(&summary[13..summary.len() - MAGIC.len() - 4]);
        let file = |chunk_crc, data_crc, summary_crc| {
            read(&[data(chunk_crc), end(data_crc, summary_crc)].concat())
        };
        for (crc, data_crc, summary_crc) in [(0, 0, 0), (right, sum_of_data, sum_of_summary)] {
            let (read, error) = file(crc, data_crc, summary_crc);
            assert_eq!((read.len(), error), (2, None));
        }
        let damaged = [
            (file(right ^ 1, 0, 0), 1, "a chunk is damaged"),
            (
                file(right, sum_of_data ^ 1, 0),
                2,
                "part with the messages is damaged",
            ),
            (
                file(right, sum_of_data, sum_of_summary ^ 1),
                2,
                "the summary is damaged",
            ),
        ];
        for ((read, error), count, expected) in damaged {
            let error = error.unwrap();
            assert!(error.contains(expected), "{error}, not {expected}");
            assert_eq!(read.len(), count, "{error}");
        }
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
