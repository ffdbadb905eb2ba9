//! Images of one camera in, trajectory and occupancy map out: what a viewer, a live camera or a
//! robot needs around [`monogrid_slam`].
//!
//! ```
//! use monogrid_geometry::{Camera, Distortion, Pinhole};
//! use monogrid_image::GrayImage;
//! use monogrid_pipeline::{Event, Pipeline, Settings};
//!
//! # fn camera_frames() -> impl Iterator<Item = (GrayImage, i64)> {
//! #     let grey = |x, y, k| ((x * 7 + y * 13 + 3 * k) % 251) as f32;
//! #     let image = move |k: usize| GrayImage::from_fn(80, 60, |x, y| grey(x, y, k));
//! #     (0..).map(move |k| (image(k), 33_000_000 * k as i64))
//! # }
//! let pinhole = Pinhole::new(60.0, 60.0, 39.5, 29.5);
//! let camera = Camera { width: 80, height: 60, pinhole, distortion: Distortion::None };
//! let mut pipeline = Pipeline::new(&camera, Settings::default())?;
//! pipeline.listen(|event: &Event| println!("{event:?}"))?;
//! let live = pipeline.live_map()?; // for any thread: live.latest()
//! for (image, timestamp_ns) in camera_frames().take(5) {
//!     match pipeline.push(image, timestamp_ns) {
//!         Ok(report) => println!("{:?}", report.world_from_camera),
//!         Err(unusable) => println!("{unusable}"),
//!     }
//! }
//! let maps = pipeline.finish()?.maps()?; // none before the camera has moved
//! # assert!(maps.is_none() && live.latest().is_none());
//! # Ok::<(), monogrid_pipeline::PipelineError>(())
//! ```
//!
//! What happens inside: [`Preparation`] undistorts an image and brings it to the working size;
//! [`monogrid_slam::Slam`] tracks it in the calling thread; what changes about the map of keyframes
//! goes as [`Event`]s to every [`Listener`] and to the mapper, each in a thread of its own behind a
//! bounded channel. [`read_ahead`] decodes a [`FrameSource`] of known length or without end in one
//! more thread, [`Pipeline::run`] puts both together.
//!
//! Frames: images are those of the camera (grey, 0 to 255), poses and maps are in the world of the
//! run (the first keyframe's camera) until [`Finished::maps_around_camera`] brings them elsewhere;
//! [`Finished::maps`] is z up. Times are nanoseconds. The same images and settings give the same
//! bits, for any number of threads, unless frames are read at [`Pace::Real`].
#![deny(missing_docs)]

pub mod clock;
mod finished;
mod listener;
mod local;
mod mapper;
mod panics;
mod pipeline;
mod preparation;
mod read_frame;
mod readings;
mod shutter;
mod source;
mod unusable;
mod waiting;

pub use finished::{Cpu, Finished};
pub use listener::{Listener, ListenerError, Run};
pub use local::{LocalMapper, LocalView};
pub use monogrid_inertial::{Imu, ImuNoise, ImuSample};
pub use monogrid_slam::Event;
pub use panics::{attempt, message_of};
pub use pipeline::{Pipeline, PipelineError, Settings};
pub use preparation::Preparation;
pub use read_frame::ReadFrame;
pub use shutter::Rectification;
pub use source::{FrameSource, Pace, ReadOn, Reading, SourceFrame, read_ahead};
pub use unusable::Unusable;
