//! Messages as they lie in a recording, and what is in them.

use crate::bag::TopicKind;
use monogrid_messages::RosMessage;
use monogrid_messages::cdr::{self, ByteOrder};
use std::sync::Arc;

/// How the fields of a message are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// ROS 2: CDR with its four bytes in front, fields aligned.
    Cdr,
    /// ROS 1: little endian, one after the other.
    Ros1,
}

/// A message.
#[derive(Clone, Debug)]
pub struct Raw {
    pub topic: Arc<str>,
    pub kind: TopicKind,
    /// When it was recorded.
    pub log_ns: i64,
    pub wire: Wire,
    /// Nothing of topics that nobody looks at.
    pub data: Vec<u8>,
}

impl Raw {
    pub fn new(topic: &Arc<str>, kind: TopicKind, log_ns: i64, wire: Wire, data: &[u8]) -> Self {
        let is_kept = kind != TopicKind::Other;
        Self {
            topic: Arc::clone(topic),
            kind,
            log_ns,
            wire,
            data: if is_kept { data.to_vec() } else { Vec::new() },
        }
    }

    /// What is in it, or why it is no such message.
    pub fn content<M: RosMessage>(&self) -> Result<M, String> {
        let num_bytes = self.data.len();
        if self.wire == Wire::Ros1 {
            let too_short = |_| format!("a message of {num_bytes} bytes ends within its fields");
            return cdr::from_ros1(&self.data).map_err(too_short);
        }
        let Some((&[_, order, _, _], body)) = self.data.split_first_chunk() else {
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
