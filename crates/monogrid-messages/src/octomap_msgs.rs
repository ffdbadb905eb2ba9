//! Three-dimensional maps.

use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// A tree of OctoMap.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Octomap {
    /// Time, and the frame.
    pub header: Header,
    /// Whether cells are free or occupied only, as in `.bt` files; else they have log-odds, as in
    /// `.ot` files.
    pub binary: bool,
    /// Class of the tree: `OcTree`.
    pub id: String,
    /// Edge of a cell, m.
    pub resolution: f64,
    /// The file without its header. (`int8[]` by definition, which is the same on the wire.)
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}
ros_message!("octomap_msgs", Octomap);
