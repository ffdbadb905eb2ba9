//! The command line.

use crate::frames::mount;
use crate::log::{LogForm, Severity};
use clap::Parser;
use monogrid_app::args::Profile;
use monogrid_geometry::Se3;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// A ROS 2 node that makes an occupancy map of a camera's images
#[derive(Clone, Debug, Parser)]
#[command(version, max_term_width = 110, args_override_self = true)]
pub struct Args {
    /// Topic of the images (sensor_msgs/Image)
    #[arg(long, value_name = "TOPIC", default_value = "/camera/image_raw")]
    pub image: String,
    /// The images are sensor_msgs/CompressedImage (JPEG or PNG)
    #[arg(long)]
    pub compressed: bool,
    /// Topic of the calibration (sensor_msgs/CameraInfo)
    #[arg(long, value_name = "TOPIC", default_value = "/camera/camera_info")]
    pub info: String,
    /// The images are rectified: the projection of the calibration is theirs, and nothing is
    /// distorted
    #[arg(long)]
    pub rectified: bool,
    /// Calibration from a file instead of the topic (any that `monogrid run --calibration` reads)
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Time that the camera takes from its first row to the last, ms: rows are put right, which
    /// delays poses by an image [default: as
    /// --calibration says, else 0]
    #[arg(
        long, value_name = "MS", value_parser = |text: &str| within(text, -1000.0..=1000.0, "ms"),
        allow_hyphen_values = true
    )]
    pub rolling_shutter: Option<f64>,
    /// Topic of an inertial sensor beside the camera (sensor_msgs/Imu), on the clock of the images:
    /// the map becomes level and metric
    #[arg(long, value_name = "TOPIC")]
    pub imu: Option<String>,
    /// Noise of that sensor and where it sits on the base (EuRoC's sensor.yaml: densities, T_BS)
    /// [default: noise of a phone's sensor]
    #[arg(long, value_name = "FILE", requires = "imu")]
    pub imu_calibration: Option<PathBuf>,
    /// How the camera is mounted on that sensor: tx ty tz qx qy qz qw or a 4x4 matrix, camera to
    /// sensor, metres [default: as
    /// --base-from-camera and --imu-calibration say]
    #[arg(long, value_name = "FILE", requires = "imu")]
    pub imu_from_camera: Option<PathBuf>,
    /// Settings of tracking and mapping (TOML with [slam] and [mapping], as `config.toml` of a run)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The settings that --config changes [default: that of --config, else default]
    #[arg(long, value_name = "PROFILE", value_enum)]
    pub profile: Option<Profile>,
    /// Name of the node
    #[arg(long, value_name = "NAME", default_value = "monogrid")]
    pub name: String,
    /// Namespace of the node and of its topics
    #[arg(long, value_name = "NAMESPACE", default_value = "/")]
    pub namespace: String,
    /// Another name for a topic or service, as `--ros-args -r` gives it
    #[arg(long, value_name = "FROM:=TO", value_parser = rule)]
    pub remap: Vec<(String, String)>,
    /// Times of diagnostics and logs are those of /clock, as in a simulation; a clock that jumps
    /// back begins a new map
    #[arg(long)]
    pub use_sim_time: bool,
    /// How messages on standard error are written
    #[arg(long, value_name = "FORM", value_enum, default_value_t)]
    pub log: LogForm,
    /// What is said on standard error and /rosout at least: debug, info, warn, error or fatal; of
    /// one logger as LOGGER:=LEVEL
    #[arg(long, value_name = "LEVEL", value_parser = level)]
    pub log_level: Vec<(String, Severity)>,
    #[allow(missing_docs, reason = "would become the description of the program")]
    #[arg(skip)]
    pub ignored: Vec<String>,
    #[allow(missing_docs, reason = "would become the description of the program")]
    #[command(flatten)]
    pub frames: FrameArgs,
    /// Metres of a unit of the camera's world, where that is known; parameter `metres_per_unit` of
    /// the node
    #[arg(long, value_name = "METRES", value_parser = scale)]
    pub metres_per_unit: Option<f64>,
    /// Heights over the origin of the base, m, whose cells are obstacles in the grid; without, from
    /// somewhat above what is lowest in the map to somewhat above the camera
    #[arg(long, value_name = "LOW,HIGH", value_parser = band, allow_hyphen_values = true)]
    pub height_band: Option<[f64; 2]>,
    /// Seconds between maps at least
    #[arg(
        long, value_name = "SECONDS", default_value_t = 1.0,
        value_parser = |text: &str| within(text, 0.05..=3600.0, "s")
    )]
    pub map_period: f64,
    /// Where the service `save` makes new folders
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub save_dir: PathBuf,
    /// A map to begin in: a folder that `save` has made, or that of a run; parameter `load_path`,
    /// with which the service `load` begins in another one
    #[arg(long, value_name = "DIR")]
    pub load_path: Option<PathBuf>,
    /// In a map that is loaded the camera is only looked for: the map stays as it is
    #[arg(long)]
    pub localise_only: bool,
    /// Threads that work on one image and one map, 0 for as many as there are processors
    #[arg(long, default_value_t = 0)]
    pub threads: usize,
}

// no documentation comment, which would become the description of the program
#[allow(missing_docs, reason = "see above")]
#[derive(Clone, Debug, clap::Args)]
pub struct FrameArgs {
    /// Frame of the map
    #[arg(long, value_name = "FRAME", default_value = "map")]
    pub map_frame: String,
    /// Frame of the odometry
    #[arg(long, value_name = "FRAME", default_value = "odom")]
    odom_frame: String,
    /// Frame of the robot
    #[arg(long, value_name = "FRAME", default_value = "base_link")]
    pub base_frame: String,
    /// The robot has an odometry of its own: its frame on /tf, or a topic that begins with a slash
    /// (nav_msgs/Odometry, from --odom-frame to --base-frame). Only map -> odom is published then,
    /// and metres follow from it
    #[arg(long, value_name = "FRAME|TOPIC")]
    pub odometry: Option<String>,
    /// Where the camera sits on the base: place, m, and angles of its body (x ahead, y left, z up),
    /// rad
    #[arg(
        long, value_name = "X,Y,Z,ROLL,PITCH,YAW", value_parser = numbers::<6>,
        allow_hyphen_values = true
    )]
    pub base_from_camera: Option<[f64; 6]>,
    /// Where the camera sits is published by others (a robot's description): not here
    #[arg(long)]
    pub no_camera_tf: bool,
    /// Nothing is published on /tf; poses are in the odometry and in the path
    #[arg(long)]
    pub no_tf: bool,
}

impl FrameArgs {
    /// The frame of the odometry.
    #[must_use]
    pub fn odom_frame(&self) -> &str {
        let on_tf = self
            .odometry
            .as_deref()
            .filter(|name| !name.starts_with('/'));
        on_tf.unwrap_or(&self.odom_frame)
    }

    /// base_from_camera of the optical axes, m.
    #[must_use]
    pub fn mount(&self) -> Se3 {
        let [x, y, z, roll, pitch, yaw] = self.base_from_camera.unwrap_or_default();
        mount([x, y, z], [roll, pitch, yaw])
    }
}

/// `FROM:=TO`.
///
/// # Errors
/// What is none.
pub(crate) fn rule(text: &str) -> Result<(String, String), String> {
    let rule = text
        .split_once(":=")
        .filter(|(from, to)| !from.is_empty() && !to.is_empty());
    let (from, to) = rule.ok_or_else(|| format!("{text:?} is not FROM:=TO"))?;
    Ok((from.to_owned(), to.to_owned()))
}

impl Args {
    /// The name of the node from the root.
    #[must_use]
    pub fn full_name(&self) -> String {
        let namespace = self.namespace.trim_matches('/');
        match namespace.is_empty() {
            true => format!("/{}", self.name),
            false => format!("/{namespace}/{}", self.name),
        }
    }

    /// The name of the node in logs.
    #[must_use]
    pub fn logger(&self) -> String {
        self.full_name()[1..].replace('/', ".")
    }

    /// The least severity that the node says: that for it, or for the nearest of those above it.
    #[must_use]
    pub fn least_severity(&self) -> Severity {
        let logger = self.logger();
        let is_above = |above: &str| {
            let rest = logger.strip_prefix(above);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.') || above.is_empty())
        };
        let levels = self.log_level.iter().filter(|(of, _)| is_above(of));
        // of equal ones the last counts
        let nearest = levels.max_by_key(|(of, _)| of.len());
        nearest.map_or(Severity::Info, |(_, severity)| *severity)
    }
}

/// `LEVEL` for all, or `LOGGER:=LEVEL`.
fn level(text: &str) -> Result<(String, Severity), String> {
    let (of, level) = text.split_once(":=").unwrap_or(("", text));
    let severity = Severity::from_name(level);
    let names = Severity::NAMES.join(", ");
    let severity = severity.ok_or_else(|| format!("{level:?} is none of {names}"))?;
    Ok((of.to_owned(), severity))
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let number = |part: &str| part.trim().parse().ok().filter(|v: &f64| v.is_finite());
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
    numbers.ok_or_else(|| format!("expected {N} numbers with commas between them"))
}

fn band(text: &str) -> Result<[f64; 2], String> {
    let [low, high] = numbers(text)?;
    let band = Some([low, high]).filter(|_| low < high);
    band.ok_or_else(|| format!("the lower height ({low}) is not below the upper one ({high})"))
}

/// Smallest and largest scale that is believed, m.
const SCALES: RangeInclusive<f64> = 1e-6..=1e6;

/// Checks a scale.
///
/// # Errors
/// A scale that is none.
pub fn checked_scale(metres_per_unit: f64) -> Result<f64, String> {
    let scale = Some(metres_per_unit).filter(|scale| SCALES.contains(scale));
    scale.ok_or_else(|| {
        let (least, most) = (SCALES.start(), SCALES.end());
        format!("metres_per_unit is {metres_per_unit}, expected {least} to {most}")
    })
}

fn scale(text: &str) -> Result<f64, String> {
    let [metres] = numbers(text)?;
    checked_scale(metres)
}

fn within(text: &str, range: RangeInclusive<f64>, unit: &str) -> Result<f64, String> {
    let [number] = numbers(text)?;
    let (least, most) = (range.start(), range.end());
    let allowed = Some(number).filter(|number| range.contains(number));
    allowed.ok_or_else(|| format!("{number} {unit} is not between {least} and {most} {unit}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Vec3;

    fn parse(arguments: &[&str]) -> Result<Args, clap::Error> {
        Args::try_parse_from([&["monogrid-ros2"], arguments].concat())
    }

    #[test]
    fn where_the_camera_sits() {
        let args = parse(&["--base-from-camera", "0.1,-0.2,0.3,0,0,0"]).unwrap();
        let base_from_camera = args.frames.mount();
        // what is ahead of the camera by 1 m
        let ahead = base_from_camera * Vec3::new(0.0, 0.0, 1.0);
        assert!((ahead - Vec3::new(1.1, -0.2, 0.3)).norm() < 1e-12);
        let down = parse(&["--base-from-camera", "0,0,0,0,1.5707963267948966,0"]).unwrap();
        let ahead = down.frames.mount() * Vec3::new(0.0, 0.0, 1.0);
        assert!((ahead - Vec3::new(0.0, 0.0, -1.0)).norm() < 1e-12);
    }

    #[test]
    fn the_nearest_logger_says_what_is_said() {
        let of = |levels: &[&str]| {
            let options = levels.iter().flat_map(|level| ["--log-level", level]);
            let names = ["--name", "eye", "--namespace", "/robot"];
            let args = parse(&options.chain(names).collect::<Vec<_>>());
            args.unwrap().least_severity()
        };
        assert_eq!(of(&[]), Severity::Info);
        assert_eq!(of(&["WARN"]), Severity::Warn);
        assert_eq!(of(&["robot:=error", "debug"]), Severity::Error);
        assert_eq!(of(&["robot.eye:=debug", "robot:=error"]), Severity::Debug);
        assert_eq!(
            of(&["rob:=debug", "eye:=debug", "rcl:=debug"]),
            Severity::Info
        );
        assert_eq!(of(&["debug", "fatal"]), Severity::Fatal);
    }

    #[test]
    fn numbers_outside_their_range_are_refused() {
        for wrong in [
            ["--base-from-camera", "0,0,0"],
            ["--base-from-camera", "0,0,0,0,0,nan"],
            ["--height-band", "1,0"],
            ["--height-band", "0.1"],
            ["--metres-per-unit", "0"],
            ["--metres-per-unit", "-1"],
            ["--map-period", "0"],
            ["--map-period", "1e9"],
            ["--rolling-shutter", "2000"],
        ] {
            assert!(parse(&wrong).is_err(), "{wrong:?}");
        }
        let args = parse(&["--height-band", "-0.1,1.5", "--metres-per-unit", "0.3"]).unwrap();
        assert_eq!(args.height_band, Some([-0.1, 1.5]));
        assert_eq!(args.metres_per_unit, Some(0.3));
    }
}
