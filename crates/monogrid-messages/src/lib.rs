//! Messages of ROS 2 as plain structs: as many as a camera needs to become a map.
//!
//! The fields stand in the order of the interface definitions (`common_interfaces`, `map_msgs`,
//! `octomap_msgs`, `geometry2`) with the names that these give them, so that [`cdr`], which writes
//! fields one after the other, gives what every other ROS program reads. Nothing here knows of a
//! middleware, a file or the rest of the project.
//!
//! ```
//! use monogrid_messages::{RosMessage, sensor_msgs::Image};
//! assert_eq!((Image::PACKAGE, Image::NAME), ("sensor_msgs", "Image"));
//! ```
#![deny(missing_docs)]

/// Says what ROS calls a message.
macro_rules! ros_message {
    ($package:literal, $name:ident) => {
        impl crate::RosMessage for $name {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($name);
        }
    };
}

pub mod builtin_interfaces;
pub mod cdr;
mod definitions;
pub mod diagnostic_msgs;
pub mod geometry_msgs;
pub mod map_msgs;
pub mod nav_msgs;
pub mod octomap_msgs;
pub mod rcl_interfaces;
pub mod rosgraph_msgs;
pub mod sensor_msgs;
pub mod std_msgs;
pub mod std_srvs;
pub mod tf2_msgs;

pub use definitions::definition;

/// A message that can be a topic, and what ROS calls it.
pub trait RosMessage: serde::Serialize + serde::de::DeserializeOwned {
    /// The package that defines it.
    const PACKAGE: &'static str;
    /// Its name there.
    const NAME: &'static str;
}
