//! Images and calibrations in recordings of robots: rosbag2 (`.mcap`, `.db3`, or the folder of one)
//! and ROS 1 bags (`.bag`).
//!
//! ```no_run
//! let bag = monogrid_bags::Bag::open("drive.mcap".as_ref())?;
//! let topic = bag.image_topic(None)?; // the only one, or the one that is named
//! let camera = bag.camera_of(topic)?; // of the CameraInfo beside it
//! for image in bag.images(topic) {
//!     let (time_ns, image) = image?;
//!     println!("{time_ns} ns: {}x{}", image.width(), image.height());
//! }
//! # Ok::<(), monogrid_bags::BagError>(())
//! ```
//!
//! [`McapWriter`] writes what other programs show: poses, images, clouds, maps seen from above.
//!
//! Recordings are read from the beginning, a chunk at a time; what a chunk claims to hold is
//! limited, and damage is an error that says where it was found, never a panic. Times are those of
//! the messages' headers.
#![deny(missing_docs)]

mod bag;
mod chunks;
pub mod convert;
mod db3;
mod error;
mod fields;
mod foxglove;
mod inertial;
mod magic;
mod mcap;
mod message;
mod part;
mod ros1;
mod sqlite;
mod topic;

pub use bag::{Bag, Coded, Images, Packets, is_bag};
pub use error::BagError;
pub use inertial::Readings;
pub use mcap::McapWriter;
pub use topic::{Topic, TopicKind, listed};
