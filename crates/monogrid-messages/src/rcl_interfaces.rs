//! What a node says.

use crate::builtin_interfaces::Time;
use serde::{Deserialize, Serialize};

/// A line of a log.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Log {
    /// When it was said.
    pub stamp: Time,
    /// [`DEBUG`], [`INFO`], [`WARN`], [`ERROR`] or [`FATAL`].
    pub level: u8,
    /// The logger: names of a namespace and a node with points between them.
    pub name: String,
    /// What was said.
    pub msg: String,
    /// The source file that said it.
    pub file: String,
    /// The function.
    pub function: String,
    /// The line.
    pub line: u32,
}
ros_message!("rcl_interfaces", Log);

/// For those who look for a fault.
pub const DEBUG: u8 = 10;
/// What is as it should be.
pub const INFO: u8 = 20;
/// Something should be looked at.
pub const WARN: u8 = 30;
/// Something does not work.
pub const ERROR: u8 = 40;
/// The node ends.
pub const FATAL: u8 = 50;
