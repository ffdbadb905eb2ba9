//! ROS 1 bags, version 2.0: records of header fields (`name=value`) and data; messages lie in
//! chunks.

use crate::chunks::{self, Unpacker, in_chunks};
use crate::error::BagError;
use crate::fields::Fields;
use crate::magic;
use crate::message::{Messages, Raw, Wire};
use crate::part::{Input, Part};
use crate::topic::{Indexed, Topic};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

const MESSAGE: u8 = 2;
const BAG: u8 = 3;
const CHUNK: u8 = 5;
const CHUNK_INFO: u8 = 6;
const CONNECTION: u8 = 7;

/// The topics of a file by its index at the end; `None` where it has none that can be used.
pub fn topics(part: &Part) -> Result<Option<Vec<Indexed>>, BagError> {
    let mut input = part.open()?;
    Ok(index(&mut input).unwrap_or_default())
}

/// Connections, and how many messages the chunks have of each.
fn index(input: &mut Input) -> Result<Option<Vec<Indexed>>, String> {
    let sought = |error: io::Error| error.to_string();
    let start = magic::ROS1.len() as u64;
    input.seek(SeekFrom::Start(start)).map_err(sought)?;
    let header = block(input)?.unwrap_or_default();
    let fields = Header(&header);
    let position = fields
        .value("index_pos")
        .and_then(|b| <[u8; 8]>::try_from(b).ok());
    let position = position.map_or(0, u64::from_le_bytes);
    if fields.op() != Some(BAG) || position == 0 {
        return Ok(None);
    }
    input.seek(SeekFrom::Start(position)).map_err(sought)?;
    let mut input = BufReader::new(input);
    let (mut topics, mut counts) = (BTreeMap::new(), BTreeMap::<u32, u64>::new());
    while let Some(header) = block(&mut input)? {
        let data = block(&mut input)?.ok_or("the index ends within a record")?;
        match Header(&header).op() {
            Some(CONNECTION) => {
                let (number, topic) = connection(Header(&header), &data)?;
                topics.insert(number, topic);
            }
            Some(CHUNK_INFO) => {
                let mut rest = Fields(&data);
                while let (Some(number), Some(count)) = (rest.u32(), rest.u32()) {
                    *counts.entry(number).or_default() += u64::from(count);
                }
            }
            _ => return Ok(None),
        }
    }
    let has_counts = !counts.is_empty();
    let indexed = topics.into_iter().map(|(number, topic)| Indexed {
        topic,
        messages: has_counts.then(|| counts.get(&number).copied().unwrap_or(0)),
    });
    let indexed: Vec<Indexed> = indexed.collect();
    Ok((!indexed.is_empty()).then_some(indexed))
}

/// Number and topic of a connection.
fn connection(fields: Header, data: &[u8]) -> Result<(u32, Topic), String> {
    let number = fields.u32("conn").ok_or("a connection without a number")?;
    let name = fields.text("topic").ok_or("a connection without a topic")?;
    let type_name = Header(data).text("type").unwrap_or_default();
    Ok((number, Topic::new(&name, &type_name)))
}

/// The messages of a file.
pub fn messages(part: &Part) -> Result<Messages, BagError> {
    let path = &part.path;
    let mut file = BufReader::with_capacity(1 << 18, part.open()?);
    file.read_exact(&mut [0; magic::ROS1.len()])
        .map_err(BagError::io(path))?;
    let mut records = Ros1Messages {
        file,
        connections: HashMap::new(),
        unpacker: part.unpacker(),
    };
    Ok(in_chunks(path, move |messages| records.read_on(messages)))
}

struct Ros1Messages {
    file: BufReader<Input>,
    /// Topics; only ever asked by number.
    connections: HashMap<u32, Arc<Topic>>,
    unpacker: Unpacker,
}

impl Ros1Messages {
    /// Reads the next record and takes what it says; whether there was one.
    fn read_on(&mut self, messages: &mut VecDeque<Raw>) -> Result<bool, String> {
        let Some(header) = block(&mut self.file)? else {
            return Ok(false);
        };
        let data = block(&mut self.file)?.ok_or("the file ends within a record")?;
        let fields = Header(&header);
        if fields.op() != Some(CHUNK) {
            self.take(fields, &data, messages)?;
            return Ok(true);
        }
        let compression = fields.text("compression").unwrap_or_default();
        let size = fields.u32("size").ok_or("a chunk does not say its size")?;
        let records = self
            .unpacker
            .unpacked(&compression, &data, u64::from(size))?;
        let mut rest = records.as_slice();
        while !rest.is_empty() {
            let cut = || "a chunk ends within a record".to_owned();
            let header = block(&mut rest)?.ok_or_else(cut)?;
            let data = block(&mut rest)?.ok_or_else(cut)?;
            self.take(Header(&header), &data, messages)?;
        }
        Ok(true)
    }

    /// Takes what a record says.
    fn take(
        &mut self,
        fields: Header,
        data: &[u8],
        messages: &mut VecDeque<Raw>,
    ) -> Result<(), String> {
        match fields.op() {
            Some(CONNECTION) => {
                let (number, topic) = connection(fields, data)?;
                self.connections.insert(number, Arc::new(topic));
            }
            Some(MESSAGE) => {
                let number = fields.u32("conn").ok_or("a message without a connection")?;
                let connection = self.connections.get(&number);
                let topic = connection.ok_or_else(|| {
                    format!("a message of connection {number}, which was not declared")
                })?;
                let time = fields
                    .value("time")
                    .and_then(|time| <[u8; 8]>::try_from(time).ok());
                let [a, b, c, d, nanoseconds @ ..] = time.ok_or("a message without a time")?;
                let seconds = u32::from_le_bytes([a, b, c, d]);
                let log_ns =
                    i64::from(seconds) * 1_000_000_000 + i64::from(u32::from_le_bytes(nanoseconds));
                messages.push_back(Raw::new(topic, log_ns, Some(Wire::Ros1), data));
            }
            _ => {}
        }
        Ok(())
    }
}

/// Bytes behind their length; none at the end.
fn block(input: &mut impl Read) -> Result<Option<Vec<u8>>, String> {
    let mut length = [0; 4];
    match input.read(&mut length[..1]) {
        Ok(0) => return Ok(None),
        Ok(_) => {}
        Err(error) => return Err(error.to_string()),
    }
    let cut = |error: io::Error| format!("a record cannot be read: {error}");
    input.read_exact(&mut length[1..]).map_err(cut)?;
    let length = u32::from_le_bytes(length);
    chunks::block(input, u64::from(length)).map(Some)
}

/// Fields `name=value`, each behind its length.
#[derive(Clone, Copy)]
struct Header<'a>(&'a [u8]);

impl<'a> Header<'a> {
    fn value(self, name: &str) -> Option<&'a [u8]> {
        let mut rest = Fields(self.0);
        while let Some(field) = rest.bytes() {
            let equals = field.iter().position(|byte| *byte == b'=')?;
            if &field[..equals] == name.as_bytes() {
                return Some(&field[equals + 1..]);
            }
        }
        None
    }

    fn op(self) -> Option<u8> {
        self.value("op")?.first().copied()
    }

    fn u32(self, name: &str) -> Option<u32> {
        Some(u32::from_le_bytes(self.value(name)?.try_into().ok()?))
    }

    fn text(self, name: &str) -> Option<String> {
        Some(String::from_utf8_lossy(self.value(name)?).into_owned())
    }
}
