//! rosbag2 in MCAP files.

use crate::bag::{Messages, TopicKind};
use crate::chunks::{InChunks, Records};
use crate::error::BagError;
use crate::message::{Raw, Wire};
use mcap::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, Read};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

/// Most bytes of a record, and of what is in a chunk.
const MAX_BYTES: usize = 1 << 30;

/// The messages of a file.
pub fn messages(path: &Path) -> Result<Messages, BagError> {
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_record_length_limit(MAX_BYTES);
    let records = McapMessages {
        file: File::open(path).map_err(BagError::io(path))?,
        reader: LinearReader::new_with_options(options),
        schemas: HashMap::new(),
        channels: HashMap::new(),
    };
    Ok(Box::new(InChunks::new(records, path.to_owned())))
}

struct Channel {
    topic: Arc<str>,
    kind: TopicKind,
    wire: Option<Wire>,
}

struct McapMessages {
    file: File,
    reader: LinearReader,
    /// Only ever asked by number.
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
}

impl Records for McapMessages {
    fn read_on(&mut self, messages: &mut VecDeque<Raw>) -> Result<ControlFlow<()>, String> {
        let (opcode, data) = match self.reader.next_event() {
            None => {
                return Ok(ControlFlow::Break(()));
            }
            Some(Err(error)) => return Err(error.to_string()),
            Some(Ok(LinearReadEvent::ReadRequest(bytes))) => {
                let read = self.file.read(self.reader.insert(bytes));
                self.reader
                    .notify_read(read.map_err(|error| error.to_string())?);
                return Ok(ControlFlow::Continue(()));
            }
            Some(Ok(LinearReadEvent::Record { opcode, data })) => (opcode, data.to_vec()),
        };
        if opcode != op::CHUNK {
            self.take(opcode, &data, messages)?;
            return Ok(ControlFlow::Continue(()));
        }
        let Record::Chunk { header, data } =
            parse_record(opcode, &data).map_err(|e| e.to_string())?
        else {
            return Err("a chunk that is none".to_owned());
        };
        let records = decompressed(&header.compression, &data, header.uncompressed_size)?;
        let mut rest = records.as_slice();
        while let Some((&opcode, after)) = rest.split_first() {
            let (length, after) = after
                .split_first_chunk()
                .ok_or("a chunk ends within a record")?;
            let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|e| e.to_string())?;
            let (body, behind) = after
                .split_at_checked(length)
                .ok_or("a chunk ends within a record")?;
            self.take(opcode, body, messages)?;
            rest = behind;
        }
        Ok(ControlFlow::Continue(()))
    }
}

impl McapMessages {
    /// Takes what a record says.
    fn take(
        &mut self,
        opcode: u8,
        data: &[u8],
        messages: &mut VecDeque<Raw>,
    ) -> Result<(), String> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        match parse_record(opcode, data).map_err(|error| error.to_string())? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let type_name = self.schemas.get(&channel.schema_id);
                let wire = match channel.message_encoding.as_str() {
                    "cdr" => Some(Wire::Cdr),
                    "ros1" => Some(Wire::Ros1),
                    _ => None,
                };
                self.channels.insert(
                    channel.id,
                    Channel {
                        topic: channel.topic.into(),
                        kind: type_name.map_or(TopicKind::Other, |name| TopicKind::of(name)),
                        wire,
                    },
                );
            }
            Record::Message { header, data } => {
                let channel = self.channels.get(&header.channel_id);
                let channel = channel.ok_or_else(|| {
                    format!(
                        "a message of channel {}, which was not declared",
                        header.channel_id
                    )
                })?;
                if let Some(wire) = channel.wire {
                    messages.push_back(Raw {
                        topic: Arc::clone(&channel.topic),
                        kind: channel.kind,
                        log_ns: i64::try_from(header.log_time).unwrap_or(i64::MAX),
                        wire,
                        // only what is looked at is kept
                        data: if channel.kind == TopicKind::Other {
                            Vec::new()
                        } else {
                            data.into_owned()
                        },
                    });
                }
            }
            _ => {}
        }
        Ok(())
    }
}

/// What is in a chunk of so many bytes.
fn decompressed(compression: &str, data: &[u8], size: u64) -> Result<Vec<u8>, String> {
    let size = usize::try_from(size).ok().filter(|size| *size <= MAX_BYTES);
    let size = size.ok_or_else(|| format!("a chunk claims more than {MAX_BYTES} bytes"))?;
    let failed =
        |error: io::Error| format!("a chunk cannot be decompressed ({compression}): {error}");
    let mut out = Vec::new();
    match compression {
        "" => out.extend_from_slice(data),
        "zstd" => {
            let mut decoder = ruzstd::decoding::StreamingDecoder::new(data)
                .map_err(|error| failed(io::Error::other(error)))?;
            (&mut decoder)
                .take(size as u64 + 1)
                .read_to_end(&mut out)
                .map_err(failed)?;
        }
        "lz4" => {
            let decoder = lz4_flex::frame::FrameDecoder::new(data);
            decoder
                .take(size as u64 + 1)
                .read_to_end(&mut out)
                .map_err(failed)?;
        }
        other => {
            return Err(format!(
                "compression {other:?} is not supported, expected zstd or lz4"
            ));
        }
    }
    if out.len() != size {
        return Err(format!(
            "a chunk holds {} bytes, expected {size}",
            out.len()
        ));
    }
    Ok(out)
}
