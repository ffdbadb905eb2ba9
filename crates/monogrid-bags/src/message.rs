//! Messages as they lie in a recording, and what is in them.

use crate::chunks::Unpacker;
use crate::error::BagError;
use crate::magic;
use crate::topic::{Topic, TopicKind};
use monogrid_messages::cdr::{self, ByteOrder};
use serde::de::DeserializeOwned;
use std::borrow::Cow;
use std::sync::Arc;

/// How the fields of a message are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// ROS 2: CDR with its four bytes in front, fields aligned.
    Cdr,
    /// ROS 1: little endian, one after the other.
    Ros1,
    /// Protocol Buffers.
    Protobuf,
    Json,
}

impl Wire {
    /// As MCAP calls it; `None` where it is another one.
    pub fn of(encoding: &str) -> Option<Self> {
        match encoding {
            "cdr" => Some(Self::Cdr),
            "ros1" => Some(Self::Ros1),
            "protobuf" => Some(Self::Protobuf),
            "json" => Some(Self::Json),
            _ => None,
        }
    }
}

/// A message.
#[derive(Clone, Debug)]
pub struct Raw {
    pub topic: Arc<Topic>,
    /// When it was recorded.
    pub log_ns: i64,
    /// `None` where nobody knows how it is written.
    pub wire: Option<Wire>,
    /// Nothing of topics that nobody looks at.
    pub data: Vec<u8>,
    /// Of the file that it lies in.
    pub unpacker: Arc<Unpacker>,
}

/// Messages one after the other.
pub type Messages = Box<dyn Iterator<Item = Result<Raw, BagError>> + Send>;

impl Raw {
    pub fn new(topic: &Arc<Topic>, log_ns: i64, wire: Option<Wire>, data: &[u8]) -> Self {
        let is_kept = topic.kind != TopicKind::Other && wire.is_some();
        Self {
            topic: Arc::clone(topic),
            log_ns,
            wire,
            data: if is_kept { data.to_vec() } else { Vec::new() },
            unpacker: Arc::default(),
        }
    }

    /// The bytes of the message, decompressed where rosbag2 has compressed each one by itself.
    pub fn bytes(&self) -> Result<Cow<'_, [u8]>, String> {
        // CDR begins with a zero
        if self.wire == Some(Wire::Cdr) && self.data.starts_with(magic::ZSTD) {
            return self.unpacker.unpacked_message(&self.data).map(Cow::Owned);
        }
        Ok(Cow::Borrowed(&self.data))
    }

    /// What is in a message of ROS, or why it is no such message.
    pub fn content<M: DeserializeOwned>(&self) -> Result<M, String> {
        let bytes = self.bytes()?;
        let num_bytes = bytes.len();
        match self.wire {
            Some(Wire::Cdr) => {}
            Some(Wire::Ros1) => {
                let too_short =
                    |_| format!("a message of {num_bytes} bytes ends within its fields");
                return cdr::from_ros1(&bytes).map_err(too_short);
            }
            _ => return Err("it is not written as ROS writes messages".to_owned()),
        }
        let Some((&[_, order, _, _], body)) = bytes.split_first_chunk() else {
            return Err(format!(
                "a message of {num_bytes} bytes has no encapsulation"
            ));
        };
        let order = match order {
            1 => ByteOrder::Little,
            0 => ByteOrder::Big,
            other => {
                return Err(format!(
                    "encapsulation {other} is not supported, expected plain CDR (0 or 1)"
                ));
            }
        };
        cdr::from_bytes(body, order).map_err(|error| error.to_string())
    }
}
