//! MCAP files (<https://mcap.dev/spec>): magic, records, magic. A record is an opcode, the length
//! of what follows (`u64`) and fields, all little endian; messages lie in chunks, and behind them a
//! summary says where.

mod chunk;
mod read;
mod record;
mod summary;
mod write;

pub use read::{messages, topics};
pub use write::McapWriter;

/// What a file begins and ends with.
pub const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// What a record is.
mod op {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const STATISTICS: u8 = 0x0B;
    pub const METADATA: u8 = 0x0C;
    pub const METADATA_INDEX: u8 = 0x0D;
    pub const SUMMARY_OFFSET: u8 = 0x0E;
    pub const DATA_END: u8 = 0x0F;
}
