//! A ROS 2 node that makes an occupancy map of a camera's images, without an installation of ROS.
//!
//! Three threads, which pass messages over bounded channels: that of the middleware ([`serve`])
//! hands on what comes, the tracking thread ([`tracking`]) owns the pipeline and publishes poses,
//! the thread of the maps ([`maps`]) publishes maps and diagnostics and writes files. One more maps
//! what is around the robot ([`local`]), while somebody listens. What a message is made of stands
//! in [`convert`], one function each; the frames of a robot in [`frames`].
#![deny(missing_docs)]

pub mod args;
pub mod clock;
pub mod convert;
pub mod frames;
pub mod levels;
pub mod load;
pub mod local;
pub mod log;
pub mod maps;
pub mod node;
pub mod parameters;
pub mod params_file;
pub mod ros_args;
pub mod save;
pub mod serve;
pub mod shown;
pub mod topics;
pub mod tracking;
pub mod trail;
pub mod wheels;
pub mod work;
