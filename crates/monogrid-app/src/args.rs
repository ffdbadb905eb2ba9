//! Arguments that several commands share, and how their values are understood.

use crate::process::failure::{CommandResult, Outcome};
use crate::process::interrupt::INTERRUPTED;
use crate::process::print_json;
use clap::{Args, ValueEnum};
use monogrid_image::WorkingSize;
use monogrid_mapping::{AutoLength, IntegrationRule, SensorModelKind};
use monogrid_video::Patience;
use serde::{Deserialize, Serialize};
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Output for programs.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct JsonArg {
    /// Print one JSON object to standard output
    #[arg(long)]
    pub json: bool,
}

impl JsonArg {
    /// Prints a report for programs where that is asked for, else for people: the end of a command
    /// that did all it was to do.
    pub fn print(self, report: &impl Serialize, for_people: impl FnOnce()) -> CommandResult {
        if self.json {
            print_json(report)?;
        } else {
            for_people();
        }
        Ok(Outcome::Done)
    }
}

/// Options of commands that write what the user names and say what it is.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct WriteArgs {
    /// Replace the output file if it exists; never one that is read
    #[arg(long)]
    pub force: bool,
    /// Output for programs
    #[command(flatten)]
    pub json: JsonArg,
}

/// One of the complete configurations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// The best we know
    #[default]
    Default,
    /// For small computers: images of 400x300 pixels, maps of quality `fast`
    Fast,
    /// LSD-SLAM and the mapping rules of the thesis
    Thesis,
}

impl Profile {
    /// As it stands in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Fast => "fast",
            Self::Thesis => "thesis",
        }
    }
}

/// Inverse sensor models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SensorModelArg {
    /// Ideal sensor convolved with the Gaussian of the range
    Thrun,
    /// Andert's model for stereo cameras
    Andert,
    /// Free before, occupied at the measured range
    Ideal,
    /// End points only, no free space
    None,
}

impl From<SensorModelArg> for SensorModelKind {
    fn from(model: SensorModelArg) -> Self {
        match model {
            SensorModelArg::Thrun => Self::Thrun,
            SensorModelArg::Andert => Self::Andert,
            SensorModelArg::Ideal => Self::Ideal,
            SensorModelArg::None => Self::None,
        }
    }
}

/// How measurements are combined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum IntegrationArg {
    /// One update per cell and keyframe
    Fused,
    /// Every measurement updates every cell that it crosses
    Rays,
}

impl From<IntegrationArg> for IntegrationRule {
    fn from(rule: IntegrationArg) -> Self {
        match rule {
            IntegrationArg::Fused => Self::Fused,
            IntegrationArg::Rays => Self::Rays,
        }
    }
}

/// Sensor model and map options shared by `run` and `map`.
#[derive(Debug, Clone, Default, Args)]
pub struct MappingArgs {
    /// Inverse sensor model [default: thrun]
    #[arg(long, value_enum, help_heading = "Mapping")]
    pub sensor_model: Option<SensorModelArg>,
    /// Edge length of a cell, in metres or map units [default: 0.05]
    #[arg(long, value_name = "L", value_parser = positive, help_heading = "Mapping")]
    pub resolution: Option<f64>,
    /// Thickness L of the occupied band of the models ideal and thrun [default: auto]
    #[arg(long, value_name = "L|auto", value_parser = auto_or_positive, help_heading = "Mapping")]
    pub buffer: Option<AutoLength>,
    /// Significance k of the model andert [default: auto]
    #[arg(long, value_name = "K|auto", value_parser = auto_or_positive, help_heading = "Mapping")]
    pub significance: Option<AutoLength>,
    /// How measurements are combined [default: fused]
    #[arg(long, value_enum, help_heading = "Mapping")]
    pub integration: Option<IntegrationArg>,
    /// Ignore measurements farther away than this
    #[arg(long, value_name = "L", value_parser = positive, help_heading = "Mapping")]
    pub max_range: Option<f64>,
}

/// Options of `run` that say what to read.
#[derive(Debug, Clone, Default, Args)]
pub struct SourceArgs {
    /// Camera calibration [default: calibration.toml or calibration.txt in the source, else
    /// estimated from the images]
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    pub calibration: Option<PathBuf>,
    /// Horizontal field of view of a camera without calibration, degrees [default: estimated]
    #[arg(
        long, value_name = "DEG", value_parser = field_of_view, conflicts_with = "calibration",
        help_heading = "Input"
    )]
    pub fov: Option<f64>,
    /// Time in which the camera reads the rows of its sensor, from the first to the last,
    /// milliseconds; negative where it begins with the last [default: as the calibration says, else
    /// as the images show where there is none, else 0]
    #[arg(
        long, value_name = "MS", value_parser = readout_ms, allow_negative_numbers = true,
        help_heading = "Input"
    )]
    pub rolling_shutter: Option<f64>,
    /// Topic of a recording whose images are used [default: the only one that has some]
    #[arg(long, value_name = "NAME", help_heading = "Input")]
    pub topic: Option<String>,
    /// First frame to use
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Input")]
    pub start: usize,
    /// Use only every N-th frame, as if the camera were slower [default: 1]
    #[arg(long, value_name = "N", help_heading = "Input")]
    pub every: Option<NonZeroUsize>,
    /// Use at most this many frames
    #[arg(long, value_name = "N", help_heading = "Input")]
    pub max_frames: Option<usize>,
    /// Give a source up that has sent no whole frame for this long, seconds, 0: never [default: 10
    /// for addresses (http, rtsp ...), else never]
    #[arg(long, value_name = "S", value_parser = source_timeout, help_heading = "Input")]
    pub source_timeout: Option<f64>,
    /// Frame rate of a folder of images without timestamps [default: 30]
    #[arg(long, value_name = "N", value_parser = frame_rate, help_heading = "Input")]
    pub fps: Option<f64>,
    /// Working size of the images [default: about as many pixels as 640x480, or 400x300 with
    /// --profile fast]
    #[arg(long, value_name = "WxH", value_parser = size, help_heading = "Input")]
    pub size: Option<(usize, usize)>,
    /// Image, black where pixels must be ignored; one for each frame where this is a folder with
    /// images of the same names, or a video
    #[arg(long, value_name = "PATH", help_heading = "Input")]
    pub mask: Option<PathBuf>,
    /// Readings of an inertial sensor beside the camera: CSV, the folder of a phone's log, or a
    /// topic of the recording [default: mav0/imu0/data.csv, imu0/data.csv, imu.csv or imu.txt in
    /// the source, the topic nearest to that of the images; `none`: none]
    #[arg(long, value_name = "PATH|TOPIC|none", help_heading = "Input")]
    pub imu: Option<PathBuf>,
    /// How the camera is mounted on that sensor: tx ty tz qx qy qz qw or a 4x4 matrix, camera to
    /// sensor, metres [default: as the sensor.yaml of both say, or /tf_static of the recording]
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    pub imu_from_camera: Option<PathBuf>,
    /// Milliseconds to add to the times of readings to have those of the images [default: 0]
    #[arg(
        long, value_name = "MS", value_parser = time_offset_ms, allow_hyphen_values = true,
        help_heading = "Input"
    )]
    pub imu_time_offset: Option<f64>,
}

impl SourceArgs {
    /// How long to wait for a source; an interrupt ends the wait.
    pub fn patience(&self, source: &Path) -> Patience {
        let mut patience = Patience::usual(source);
        if let Some(seconds) = self.source_timeout {
            patience.limit = (seconds > 0.0).then(|| Duration::from_secs_f64(seconds));
        }
        patience.interrupted = Some(&INTERRUPTED);
        patience
    }
}

/// How long a source may take, s: at most a day.
fn source_timeout(text: &str) -> Result<f64, String> {
    number_in(text, 0.0..=86_400.0, "0 to 86400 seconds")
}

/// A difference of two clocks, ms: at most some centuries.
fn time_offset_ms(text: &str) -> Result<f64, String> {
    number_in(text, -9e12..=9e12, "a number of milliseconds")
}

/// A field of view that a pinhole can have, degrees.
fn field_of_view(text: &str) -> Result<f64, String> {
    number_in(text, 5.0..=160.0, "a field of view from 5 to 160 degrees")
}

/// Time between the first and the last row of an image, ms, negative where it is upside down: real
/// sensors take at most as long as a frame of a slow video lasts.
pub fn readout_ms(text: &str) -> Result<f64, String> {
    number_in(text, -100.0..=100.0, "-100 to 100 milliseconds")
}

fn number_in(text: &str, allowed: RangeInclusive<f64>, expected: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value| allowed.contains(value));
    value.ok_or_else(|| format!("expected {expected}"))
}

/// A positive, finite number.
pub fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse().ok();
    let value = value.filter(|value: &f64| value.is_finite() && *value > 0.0);
    value.ok_or_else(|| "expected a positive number".into())
}

/// Frames per second.
pub fn frame_rate(text: &str) -> Result<f64, String> {
    let value = text.parse().ok();
    let value = value.filter(|value| (0.001..=100_000.0).contains(value));
    value.ok_or_else(|| "expected a frame rate from 0.001 to 100000".into())
}

fn auto_or_positive(text: &str) -> Result<AutoLength, String> {
    if text == "auto" {
        return Ok(AutoLength::Auto);
    }
    positive(text)
        .map(AutoLength::Fixed)
        .map_err(|_| "expected a positive number or `auto`".into())
}

/// Bytes of memory, from 1 MB on.
pub fn memory(text: &str) -> Result<u64, String> {
    let upper = text.trim().to_ascii_uppercase();
    let units = [("MB", 1e6), ("GB", 1e9)];
    let bytes = units.iter().find_map(|(unit, bytes)| {
        let number: f64 = upper.strip_suffix(unit)?.trim().parse().ok()?;
        Some(number * bytes)
    });
    match bytes {
        Some(bytes @ 1e6..=1e15) => Ok(bytes as u64),
        _ => Err("expected a size from 1MB to 1000000GB, e.g. 500MB or 1.5GB".to_owned()),
    }
}

/// Most pixels of a working image.
const MAX_PIXELS: usize = *WorkingSize::ALLOWED_PIXELS.end();

/// Width and height of an image.
pub fn size(text: &str) -> Result<(usize, usize), String> {
    let expected = || {
        format!(
            "expected WIDTHxHEIGHT, both from 32 to 8192 and at most {MAX_PIXELS} pixels, e.g. \
             640x480"
        )
    };
    let side = |text: &str| text.parse().ok().filter(|n| (32..=8192).contains(n));
    let sides = text.split_once(['x', 'X']);
    let size = sides.and_then(|(width, height)| side(width).zip(side(height)));
    size.filter(|(width, height)| width * height <= MAX_PIXELS)
        .ok_or_else(expected)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_lengths_are_checked() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        for bad in ["8192x8192", "640", "x480", "0x480", "640x-1", "9999x480"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert_eq!(memory("500MB"), Ok(500_000_000));
        assert_eq!(memory("1.5 gb"), Ok(1_500_000_000));
        for bad in ["500", "MB", "0MB", "-1GB", "nanMB", "infGB", "1e9GB"] {
            assert!(memory(bad).is_err(), "{bad}");
        }
        for bad in ["0", "-1", "nan", "inf", "x"] {
            assert!(positive(bad).is_err(), "{bad}");
        }
        assert_eq!(frame_rate("29.97"), Ok(29.97));
        for bad in ["1e-4", "1e300", "nan", "-30", "x"] {
            assert!(frame_rate(bad).is_err(), "{bad}");
        }
        assert_eq!(auto_or_positive("auto"), Ok(AutoLength::Auto));
        assert_eq!(auto_or_positive("0.1"), Ok(AutoLength::Fixed(0.1)));
    }
}
