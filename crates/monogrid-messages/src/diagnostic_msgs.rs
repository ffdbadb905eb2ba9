//! How a node is.

use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// A fact.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What.
    pub key: String,
    /// How much.
    pub value: String,
}

/// How one part is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// [`OK`], [`WARN`], [`ERROR`] or [`STALE`].
    pub level: u8,
    /// The part.
    pub name: String,
    /// What there is to say.
    pub message: String,
    /// Its serial number or the like.
    pub hardware_id: String,
    /// Facts.
    pub values: Vec<KeyValue>,
}

/// All is well.
pub const OK: u8 = 0;
/// Something should be looked at.
pub const WARN: u8 = 1;
/// It does not work.
pub const ERROR: u8 = 2;
/// Nothing new is known.
pub const STALE: u8 = 3;

/// How several parts are.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Time.
    pub header: Header,
    /// The parts.
    pub status: Vec<DiagnosticStatus>,
}
ros_message!("diagnostic_msgs", DiagnosticArray);
