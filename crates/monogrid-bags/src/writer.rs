//! Messages into MCAP files, as Foxglove, Rerun and rosbag2 read them.

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};
use monogrid_messages::{RosMessage, cdr, definition};
use std::collections::BTreeMap;
use std::io::{self, Write};

/// CDR, little endian.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A file that grows by messages of ROS 2. It is complete when [finished](Self::finish).
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
    writer: Writer<NoSeek<W>>,
    /// Channels by topic, and how many messages each has.
    channels: BTreeMap<String, (u16, u32)>,
}

impl<W: Write> McapWriter<W> {
    /// A file that says that `program` wrote it.
    ///
    /// # Errors
    /// When `out` cannot be written.
    pub fn new(out: W, program: &str) -> io::Result<Self> {
        let options = WriteOptions::new()
            .compression(None)
            .disable_seeking(true)
            .profile("ros2")
            .library(program);
        Ok(Self {
            writer: options.create(NoSeek::new(out)).map_err(failed)?,
            channels: BTreeMap::new(),
        })
    }

    /// Appends a message of this time, ns.
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
        let (channel_id, sequence) = self.channel::<M>(topic)?;
        let time = u64::try_from(time_ns).unwrap_or(0);
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        let bytes = [ENCAPSULATION.as_slice(), &body].concat();
        let written = self.writer.write_to_known_channel(&header, &bytes);
        written.map_err(failed)
    }

    /// The channel of a topic and the number of its next message.
    fn channel<M: RosMessage>(&mut self, topic: &str) -> io::Result<(u16, u32)> {
        if let Some((id, count)) = self.channels.get_mut(topic) {
            *count += 1;
            return Ok((*id, *count));
        }
        let name = format!("{}/msg/{}", M::PACKAGE, M::NAME);
        let Some(text) = definition::<M>() else {
            return Err(io::Error::other(format!("{name} has no definition")));
        };
        let schema = self.writer.add_schema(&name, "ros2msg", text.as_bytes());
        let schema = schema.map_err(failed)?;
        let nothing = BTreeMap::new();
        let id = self.writer.add_channel(schema, topic, "cdr", &nothing);
        let id = id.map_err(failed)?;
        self.channels.insert(topic.to_owned(), (id, 0));
        Ok((id, 0))
    }

    /// Notes facts about the file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn note(&mut self, name: &str, facts: BTreeMap<String, String>) -> io::Result<()> {
        let metadata = Metadata {
            name: name.to_owned(),
            metadata: facts,
        };
        self.writer.write_metadata(&metadata).map_err(failed)
    }

    /// Completes the file.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.writer.finish().map(drop).map_err(failed)
    }
}

fn failed(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
