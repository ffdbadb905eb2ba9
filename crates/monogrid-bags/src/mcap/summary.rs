//! What stands behind the data: everything that readers need to seek.

use super::chunk::TimeSpan;
use super::op;
use super::record::Record;
use std::collections::BTreeMap;
use std::io;

/// Records of a kind, one after the other.
#[derive(Debug, Default)]
pub struct Group {
    bytes: Vec<u8>,
    count: u32,
}

impl Group {
    pub fn push(&mut self, record: &[u8]) {
        self.bytes.extend_from_slice(record);
        self.count += 1;
    }

    /// The number of the next record, from 1.
    pub fn next_id(&self) -> io::Result<u16> {
        let id = u16::try_from(self.count + 1);
        id.map_err(|_| io::Error::other("more than 65535 topics or types"))
    }
}

/// What is known of the file so far.
#[derive(Debug, Default)]
pub struct Summary {
    pub schemas: Group,
    pub channels: Group,
    pub chunks: Group,
    pub metadata: Group,
    times: TimeSpan,
    /// Messages by channel.
    counts: BTreeMap<u16, u64>,
}

impl Summary {
    /// Counts a message of this time, ns; how many of its channel came before.
    pub fn count(&mut self, channel: u16, time: u64) -> u64 {
        self.times.add(time);
        let count = self.counts.entry(channel).or_default();
        *count += 1;
        *count - 1
    }

    /// All records from `start` in the file to its last magic.
    pub fn bytes(&self, start: u64) -> io::Result<Vec<u8>> {
        let statistics = self.statistics()?;
        let groups = [
            (op::SCHEMA, &self.schemas.bytes),
            (op::CHANNEL, &self.channels.bytes),
            (op::STATISTICS, &statistics),
            (op::CHUNK_INDEX, &self.chunks.bytes),
            (op::METADATA_INDEX, &self.metadata.bytes),
        ];
        let (mut bytes, mut offsets) = (Vec::new(), Vec::new());
        for (opcode, records) in groups {
            if !records.is_empty() {
                let group_start = start + bytes.len() as u64;
                let offset = Record::new(op::SUMMARY_OFFSET).u8(opcode).u64(group_start);
                offsets.extend(offset.u64(records.len() as u64).finish()?);
                bytes.extend_from_slice(records);
            }
        }
        let offsets_start = start + bytes.len() as u64;
        bytes.extend(offsets);
        with_footer(bytes, start, offsets_start)
    }

    fn statistics(&self) -> io::Result<Vec<u8>> {
        let (first, last) = self.times.bounds();
        Record::new(op::STATISTICS)
            .u64(self.counts.values().sum())
            .u16(self.schemas.count as u16)
            .u32(self.channels.count)
            .u32(0) // attachments
            .u32(self.metadata.count)
            .u32(self.chunks.count)
            .u64(first)
            .u64(last)
            .list(&self.counts, |list, (channel, count)| {
                list.u16(*channel).u64(*count)
            })
            .finish()
    }
}

/// The summary with the record that says where it begins; its checksum covers that record too, up
/// to the checksum.
fn with_footer(mut summary: Vec<u8>, start: u64, offsets_start: u64) -> io::Result<Vec<u8>> {
    let footer = Record::new(op::FOOTER).u64(start).u64(offsets_start);
    let footer = footer.u32(0).finish()?;
    summary.extend_from_slice(&footer[..footer.len() - 4]);
    let crc = crc32fast::hash(&summary);
    summary.extend_from_slice(&crc.to_le_bytes());
    Ok(summary)
}
