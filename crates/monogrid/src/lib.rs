//! From the video of one camera to a 3D occupancy map: images in, poses and a growing map out.
//!
//! ```
//! use monogrid::{Calibration, GrayImage, Pipeline, Settings};
//!
//! # fn pictures() -> impl Iterator<Item = (Vec<u8>, i64)> {
//! #     let value = |i: usize, k: usize| ((i % 80 * 7 + i / 80 * 13 + 3 * k) % 251) as u8;
//! #     (0..).map(move |k| ((0..80 * 60).map(|i| value(i, k)).collect(), 33_000_000 * k as i64))
//! # }
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = tempfile::tempdir()?;
//! # let file = folder.path().join("calibration.txt");
//! # std::fs::write(&file, "60 60 39.5 29.5 80 60")?; // fx fy cx cy width height
//! let camera = Calibration::read(&file, None)?.camera;
//! let mut pipeline = Pipeline::new(&camera, Settings::default())?;
//! for (grey, time_ns) in pictures().take(5) { // 8 bits per pixel; from_rgb8 takes colour
//!     let image = GrayImage::from_gray8(camera.width, camera.height, &grey).ok_or("too short")?;
//!     match pipeline.push(image, time_ns) {
//!         Ok(report) => println!("{} {:?}", report.state.name(), report.world_from_camera),
//!         Err(unusable) => println!("not used: {unusable}"),
//!     }
//! }
//! let now = pipeline.map()?; // while it goes on
//! let maps = pipeline.finish()?.maps()?; // None before the camera has moved
//! # assert!(now.is_none() && maps.is_none());
//! # Ok(())
//! # }
//! ```
//!
//! Lens distortion, working size, mask, rolling shutter and repeated images are taken care of
//! inside; [`Settings`] has them all. Losing track is an outcome of [`Pipeline::push`], not an
//! error. The same images and settings give the same bytes.
//!
//! The examples `camera`, `own_images`, `lidar_scans` and `depth_and_poses` are programs of at most
//! 25 lines. What is here comes from crates that can be used alone, each with a first page of its
//! own:
//!
//! | for | module |
//! |---|---|
//! | tracking and mapping with threads, listeners and sources | [`pipeline`], over [`slam`] |
//! | maps of any sensor: scans in, rays, distances, OctoMap files out | [`occupancy`] |
//! | calibrations, trajectories, recordings and folders of images | [`datasets`] |
//! | frames of videos and cameras | [`video`] |
//! | trajectories and maps against the truth | [`evaluation`] |
//! | readings of an inertial sensor ([`Pipeline::push_readings`]) | [`inertial`] |
//! | transforms and camera models | [`geometry`] |
//!
//! The command of the same name is the crate `monogrid-cli`.
#![deny(missing_docs)]

pub use monogrid_datasets as datasets;
pub use monogrid_evaluation as evaluation;
pub use monogrid_geometry as geometry;
pub use monogrid_inertial as inertial;
pub use monogrid_mapping as mapping;
pub use monogrid_occupancy as occupancy;
pub use monogrid_pipeline as pipeline;
pub use monogrid_slam as slam;
pub use monogrid_video as video;

pub use monogrid_datasets::Calibration;
pub use monogrid_geometry::{Camera, Distortion, Pinhole};
pub use monogrid_image::{GrayImage, Mask, WorkingSize};
pub use monogrid_occupancy::OccupancyMap;
pub use monogrid_pipeline::{Event, Finished, Pipeline, PipelineError, Settings, Unusable};
pub use monogrid_slam::{FrameReport, LostReason, TrackingState, TrajectoryPose};
