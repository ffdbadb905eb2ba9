//! A chunk while it grows.

use super::op;
use super::record::{Output, Record};
use std::collections::BTreeMap;
use std::io::{self, Write};

/// The first and the last time of messages, ns; 0 of none.
#[derive(Clone, Copy, Debug, Default)]
pub struct TimeSpan(Option<(u64, u64)>);

impl TimeSpan {
    pub fn add(&mut self, time: u64) {
        let (first, last) = self.0.unwrap_or((time, time));
        self.0 = Some((first.min(time), last.max(time)));
    }

    pub fn bounds(self) -> (u64, u64) {
        self.0.unwrap_or_default()
    }
}

/// Records that are written together.
#[derive(Debug, Default)]
pub struct Chunk {
    pub records: Vec<u8>,
    times: TimeSpan,
    /// Time of each message, and where it begins in the records, by channel.
    messages: BTreeMap<u16, Vec<(u64, u64)>>,
}

impl Chunk {
    /// Adds a message of this time, ns.
    pub fn push_message(&mut self, channel: u16, time: u64, record: &[u8]) {
        let entry = (time, self.records.len() as u64);
        self.messages.entry(channel).or_default().push(entry);
        self.times.add(time);
        self.records.extend_from_slice(record);
    }

    /// Writes it and the indexes of its messages; the record of the summary that says where.
    pub fn write(&self, out: &mut Output<impl Write>) -> io::Result<Vec<u8>> {
        let (first, last) = self.times.bounds();
        let size = self.records.len() as u64;
        let chunk = Record::new(op::CHUNK)
            .u64(first)
            .u64(last)
            .u64(size)
            .u32(crc32fast::hash(&self.records))
            .text("")
            .u64(size)
            .raw(&self.records)
            .finish()?;
        let start = out.write(&chunk)?;
        let end = out.position;
        let indexes = self.write_indexes(out)?;
        Record::new(op::CHUNK_INDEX)
            .u64(first)
            .u64(last)
            .u64(start)
            .u64(end - start)
            .list(indexes, |list, (channel, at)| list.u16(channel).u64(at))
            .u64(out.position - end)
            .text("")
            .u64(size)
            .u64(size)
            .finish()
    }

    /// Where the index of each channel is in the file.
    fn write_indexes(&self, out: &mut Output<impl Write>) -> io::Result<Vec<(u16, u64)>> {
        let mut starts = Vec::new();
        for (channel, messages) in &self.messages {
            let index = Record::new(op::MESSAGE_INDEX)
                .u16(*channel)
                .list(messages, |list, (time, at)| list.u64(*time).u64(*at))
                .finish()?;
            starts.push((*channel, out.write(&index)?));
        }
        Ok(starts)
    }
}
