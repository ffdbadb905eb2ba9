//! Image sources, calibration and trajectory files, and recordings.
//!
//! * [`Dataset::open`] finds the frames of a sequence in any of the usual layouts; [`read_gray`]
//!   and [`read_depth`] decode them.
//! * [`Calibration::read`] and [`DepthCalibration::read`] understand the usual calibration files.
//! * [`DepthRegistration`] brings depth images into the colour camera.
//! * [`read_trajectory`], [`write_tum`], [`read_sim3`] and their kin handle poses.
//! * [`ImuFile`] reads the inertial measurements beside them.
//! * [`RecordingWriter`] and [`Recording`] write and read `.mgk` files, [`ScansReader`] reads
//!   `.scans`.
//! * [`SubmapBuilder`], [`SubmapReader`] and [`SubmapTable`] are the same in pieces that never
//!   change, `.mgs`.
//! * [`FrameChecker`] and [`SequenceCheck`] say what in the images would hurt tracking.
//! * [`FixedPartFinder`] finds what of the picture is fixed to the camera.
//! * [`write_atomically`] replaces files whole or not at all.
//!
//! Everything that comes from outside is checked: bad input is an error that names the file, what
//! was found and what was expected, never a panic.
#![deny(missing_docs)]

mod archive;
mod atomic;
mod bytes;
mod calibration;
mod check;
mod columns;
mod error;
mod files;
mod fixed;
mod gpmf;
mod images;
mod imu;
mod log_line;
mod phone_logs;
mod places;
mod printable;
mod recording;
mod scans;
mod source;
mod submap;
mod text;
mod timestamp;
mod trajectory;

pub use atomic::{AtomicFile, write_atomically, write_atomically_with};
pub use calibration::{Calibration, SecondCamera, read_photometric, read_response, read_vignette};
pub use check::{FrameCheck, FrameChecker, SequenceCheck, blur};
pub use error::DatasetError;
pub use files::{open_file, read_file};
pub use fixed::{FixedPart, FixedPartFinder, Rectangle};
pub use gpmf::CameraTelemetry;
pub use images::{
    DepthCalibration, DepthRegistration, Levels, PixelBudget, TUM_UNITS_PER_METRE, TooManyPixels,
    decode_depth, decode_gray, decode_jpeg_luma, decode_jpeg_rgb, encode_jpeg, encode_jpeg_rgb,
    encode_png, encode_png_16, encode_png_rgb, exif_focal_px, read_depth, read_gray, read_gray_in,
    read_mask, read_rgb, read_rgb_in,
};
pub use imu::{ImuCalibration, ImuFile, write_imu};
pub use log_line::log_line;
pub use places::{GlobalPlace, TimedPlace, places_of_photographs, read_places_of_subtitles};
pub use printable::{is_obeyed, printable};
pub use recording::{
    ColourRecord, Continuation, Damage, DepthPixel, DepthRevision, EndRecord, FragmentKeyframe,
    KeyframeLink, KeyframeRecord, PoseSnapshot, ReadOptions, Record, RecordedCamera, RecordedEdge,
    RecordedFrame, RecordedKeyframe, RecordedPoint, RecordedSession, Recording, RecordingReader,
    RecordingWriter, Scale, SessionInfo,
};
pub use scans::{Scan, ScanPoint, ScansReader};
pub use source::{
    DEFAULT_FPS, Dataset, DepthEntry, FrameEntry, Layout, SourceOptions, natural_order,
};
pub use submap::{
    BuiltSubmap, MovedKeyframe, SUBMAP_FOLDER, SUBMAP_TABLE, SubmapBlock, SubmapBuilder,
    SubmapEntry, SubmapId, SubmapInfo, SubmapPose, SubmapReader, SubmapTable, is_submap,
    is_submap_table, submap_table_in,
};
pub use text::read_text;
pub use timestamp::{format_seconds, parse_seconds};
pub(crate) use trajectory::pose_from_numbers;
pub use trajectory::{
    TimedPose, format_sim3, format_tum, parse_kitti, parse_trajectory, read_path, read_sim3,
    read_trajectory, read_transform, write_sim3, write_tum,
};
