//! Trees of frames.

use crate::geometry_msgs::TransformStamped;
use serde::{Deserialize, Serialize};

/// Transforms of `/tf` and `/tf_static`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TFMessage {
    /// The transforms.
    pub transforms: Vec<TransformStamped>,
}
ros_message!("tf2_msgs", TFMessage);
