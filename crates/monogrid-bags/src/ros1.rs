//! ROS 1 bags, version 2.0: records of header fields (`name=value`) and data; messages lie in chunks.

use crate::bag::{Messages, TopicKind};
use crate::chunks::{self, Unpacker, in_chunks};
use crate::error::BagError;
use crate::fields::Fields;
use crate::message::{Raw, Wire};
use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::sync::Arc;

/// What a file begins with.
pub const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

const MESSAGE: u8 = 2;
const CHUNK: u8 = 5;
const CONNECTION: u8 = 7;

/// The messages of a file.
pub fn messages(path: &Path) -> Result<Messages, BagError> {
    let mut file = BufReader::with_capacity(1 << 18, File::open(path).map_err(BagError::io(path))?);
    file.read_exact(&mut [0; MAGIC.len()])
        .map_err(BagError::io(path))?;
    let mut records = Ros1Messages {
        file,
        connections: HashMap::new(),
        unpacker: Unpacker::default(),
    };
    Ok(in_chunks(path, move |messages| records.read_on(messages)))
}

struct Ros1Messages {
    file: BufReader<File>,
    /// Topic and kind; only ever asked by number.
    connections: HashMap<u32, (Arc<str>, TopicKind)>,
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
                let number = fields.u32("conn").ok_or("a connection without a number")?;
                let topic = fields.text("topic").ok_or("a connection without a topic")?;
                let type_name = Header(data).text("type").unwrap_or_default();
                let kind = TopicKind::of(&type_name);
                self.connections.insert(number, (topic.into(), kind));
            }
            Some(MESSAGE) => {
                let number = fields.u32("conn").ok_or("a message without a connection")?;
                let connection = self.connections.get(&number);
                let (topic, kind) = connection.ok_or_else(|| {
                    format!("a message of connection {number}, which was not declared")
                })?;
                let time = fields
                    .value("time")
                    .and_then(|time| <[u8; 8]>::try_from(time).ok());
                let [a, b, c, d, nanoseconds @ ..] = time.ok_or("a message without a time")?;
                let seconds = u32::from_le_bytes([a, b, c, d]);
                let log_ns =
                    i64::from(seconds) * 1_000_000_000 + i64::from(u32::from_le_bytes(nanoseconds));
                messages.push_back(Raw::new(topic, *kind, log_ns, Wire::Ros1, data));
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
