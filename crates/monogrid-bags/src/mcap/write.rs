//! Messages into MCAP files, as Foxglove, Rerun and rosbag2 read them.

use super::chunk::Chunk;
use super::record::{Output, Record};
use super::summary::Summary;
use super::{MAGIC, op};
use monogrid_messages::{RosMessage, cdr, definition};
use std::collections::BTreeMap;
use std::io::{self, Write};

/// CDR, little endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A chunk that is longer takes no more messages. Readers hold a chunk in memory and read all of it
/// for one message.
const CHUNK_BYTES: usize = 1 << 20;

/// A file that grows by messages of ROS 2. It is complete when [finished](Self::finish); nobody
/// seeks in it, and a chunk of some 1 MB is in memory. When it could not be written once, what
/// follows is of no use.
///
/// ```
/// use monogrid_bags::McapWriter;
/// use monogrid_messages::nav_msgs::Path;
/// let mut writer = McapWriter::new(Vec::new(), "my program")?;
/// writer.write("/path", 1_500_000_000, &Path::default())?;
/// writer.finish()?;
/// # Ok::<(), std::io::Error>(())
/// ```
pub struct McapWriter<W: Write> {
    out: Output<W>,
    chunk: Chunk,
    /// Schemas by type.
    schemas: BTreeMap<String, u16>,
    /// Channels by topic.
    channels: BTreeMap<String, u16>,
    summary: Summary,
}

impl<W: Write> McapWriter<W> {
    /// A file that says that `program` wrote it.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub fn new(out: W, program: &str) -> io::Result<Self> {
        let mut out = Output::new(out);
        out.write(MAGIC)?;
        let header = Record::new(op::HEADER).text("ros2").text(program);
        out.write(&header.finish()?)?;
        Ok(Self {
            out,
            chunk: Chunk::default(),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            summary: Summary::default(),
        })
    }

    /// Appends a message of this time, ns; times before the epoch become 0.
    ///
    /// # Errors
    /// When the file cannot be written, or the message has no [definition].
    pub fn write<M: RosMessage>(
        &mut self,
        topic: &str,
        time_ns: i64,
        message: &M,
    ) -> io::Result<()> {
        let body = cdr::to_vec(message).map_err(io::Error::other)?;
        let channel = self.channel::<M>(topic)?;
        if self.chunk.records.len() > CHUNK_BYTES {
            self.close_chunk()?;
        }
        let time = u64::try_from(time_ns).unwrap_or(0);
        // a counter to see gaps by, which may begin anew
        let sequence = self.summary.count(channel, time) as u32;
        let record = Record::new(op::MESSAGE)
            .u16(channel)
            .u32(sequence)
            .u64(time) // of recording
            .u64(time) // of publication
            .raw(&ENCAPSULATION)
            .raw(&body);
        self.chunk.push_message(channel, time, &record.finish()?);
        Ok(())
    }

    /// The channel of a topic; its record comes before its first message.
    fn channel<M: RosMessage>(&mut self, topic: &str) -> io::Result<u16> {
        if let Some(id) = self.channels.get(topic) {
            return Ok(*id);
        }
        let schema = self.schema::<M>()?;
        let id = self.summary.channels.next_id()?;
        let record = Record::new(op::CHANNEL)
            .u16(id)
            .u16(schema)
            .text(topic)
            .text("cdr")
            .bytes(&[]) // no facts about it
            .finish()?;
        self.chunk.records.extend_from_slice(&record);
        self.summary.channels.push(&record);
        self.channels.insert(topic.to_owned(), id);
        Ok(id)
    }

    /// The schema of a type.
    fn schema<M: RosMessage>(&mut self) -> io::Result<u16> {
        let name = format!("{}/msg/{}", M::PACKAGE, M::NAME);
        if let Some(id) = self.schemas.get(&name) {
            return Ok(*id);
        }
        let Some(text) = definition::<M>() else {
            return Err(io::Error::other(format!("{name} has no definition")));
        };
        let id = self.summary.schemas.next_id()?;
        let record = Record::new(op::SCHEMA).u16(id).text(&name);
        let record = record.text("ros2msg").text(&text).finish()?;
        self.chunk.records.extend_from_slice(&record);
        self.summary.schemas.push(&record);
        self.schemas.insert(name, id);
        Ok(id)
    }

    /// Notes facts about the file.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn note(&mut self, name: &str, facts: BTreeMap<String, String>) -> io::Result<()> {
        self.close_chunk()?;
        let record = Record::new(op::METADATA)
            .text(name)
            .list(&facts, |list, (name, fact)| list.text(name).text(fact))
            .finish()?;
        let start = self.out.write(&record)?;
        let index = Record::new(op::METADATA_INDEX).u64(start);
        let index = index.u64(record.len() as u64).text(name).finish()?;
        self.summary.metadata.push(&index);
        Ok(())
    }

    fn close_chunk(&mut self) -> io::Result<()> {
        if !self.chunk.records.is_empty() {
            let chunk = std::mem::take(&mut self.chunk);
            self.summary.chunks.push(&chunk.write(&mut self.out)?);
        }
        Ok(())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.close_chunk()?;
        let data_end = Record::new(op::DATA_END).u32(self.out.crc()).finish()?;
        self.out.write(&data_end)?;
        let summary = self.summary.bytes(self.out.position)?;
        self.out.write(&summary)?;
        self.out.write(MAGIC)?;
        self.out.out.flush()
    }
}
