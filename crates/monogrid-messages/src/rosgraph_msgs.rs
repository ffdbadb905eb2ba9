//! The time of a simulation.

use crate::builtin_interfaces::Time;
use serde::{Deserialize, Serialize};

/// The time now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// Since the simulation began.
    pub clock: Time,
}
ros_message!("rosgraph_msgs", Clock);
