//! The header that most messages begin with.

use crate::builtin_interfaces::Time;
use serde::{Deserialize, Serialize};

/// When, and in which frame.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When the data were taken.
    pub stamp: Time,
    /// The frame of their coordinates.
    pub frame_id: String,
}
