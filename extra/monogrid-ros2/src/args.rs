//! The command line.

use crate::frames::mount;
use clap::Parser;
use clap::error::ErrorKind;
use monogrid_geometry::Se3;
use std::ffi::OsString;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// A ROS 2 node that makes an occupancy map of a camera's images
#[derive(Clone, Debug, Parser)]
#[command(version, max_term_width = 110)]
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
    /// Name of the node
    #[arg(long, value_name = "NAME", default_value = "monogrid")]
    pub name: String,
    /// Namespace of the node and of its topics
    #[arg(long, value_name = "NAMESPACE", default_value = "/")]
    pub namespace: String,
    /// Another name for a topic or service, as `--ros-args -r` gives it
    #[arg(long, value_name = "FROM:=TO", value_parser = rule)]
    pub remap: Vec<(String, String)>,
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

fn rule(text: &str) -> Result<(String, String), String> {
    let rule = text
        .split_once(":=")
        .filter(|(from, to)| !from.is_empty() && !to.is_empty());
    let (from, to) = rule.ok_or_else(|| format!("{text:?} is not FROM:=TO"))?;
    Ok((from.to_owned(), to.to_owned()))
}

impl Args {
    /// Reads a command line, with what ROS and its launch files add to it: from `--ros-args` to the
    /// end or to `--`.
    ///
    /// # Errors
    /// What is not understood, and the help and the version that were asked for.
    pub fn read(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let mut own = Vec::new();
        let mut arguments = arguments.into_iter();
        while let Some(argument) = arguments.next() {
            if argument == "--ros-args" {
                let block = arguments.by_ref().take_while(|argument| argument != "--");
                let added = of_ros(block.map(|argument| argument.to_string_lossy().into_owned()));
                let added = added.map_err(|why| clap::Error::raw(ErrorKind::InvalidValue, why))?;
                own.extend(added.into_iter().map(OsString::from));
            } else {
                own.push(argument);
            }
        }
        Self::try_parse_from(own)
    }
}

/// What ROS says, in options of the program.
fn of_ros(mut arguments: impl Iterator<Item = String>) -> Result<Vec<String>, String> {
    let mut own = Vec::new();
    while let Some(argument) = arguments.next() {
        let mut value = || {
            let value = arguments.next();
            value.ok_or_else(|| format!("{argument} has no value\n"))
        };
        match argument.as_str() {
            "-r" | "--remap" => {
                let (from, to) = rule(&value()?).map_err(|why| why + "\n")?;
                own.push(match from.as_str() {
                    "__node" | "__name" => format!("--name={to}"),
                    "__ns" => format!("--namespace={to}"),
                    _ => format!("--remap={from}:={to}"),
                });
            }
            "-p" | "--param" => {
                let (name, value) = rule(&value()?).map_err(|why| why + "\n")?;
                match name.as_str() {
                    "metres_per_unit" => own.push(format!("--metres-per-unit={value}")),
                    // all times are those of the images
                    "use_sim_time" => {}
                    _ => return Err(format!("there is no parameter {name:?}\n")),
                }
            }
            // what other nodes write to logs stands in the diagnostics
            "--log-level" | "-e" | "--enclave" => drop(value()?),
            other if other.starts_with("--enable-") || other.starts_with("--disable-") => {}
            other => return Err(format!("{other:?} after --ros-args is not understood\n")),
        }
    }
    Ok(own)
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
    fn what_ros_says_after_ros_args() {
        let read = |line: &str| Args::read(line.split(' ').map(OsString::from));
        let args = read(
            "node --image /a --ros-args -r __node:=eye -r __ns:=/robot --remap map:=/floor \
             -p use_sim_time:=true -p metres_per_unit:=0.5 --log-level info -- --compressed",
        );
        let args = args.unwrap();
        assert_eq!(
            (args.name.as_str(), args.namespace.as_str()),
            ("eye", "/robot")
        );
        assert_eq!(args.remap, [("map".to_owned(), "/floor".to_owned())]);
        assert_eq!((args.metres_per_unit, args.compressed), (Some(0.5), true));
        for (wrong, named) in [
            ("node --ros-args -r map", "FROM:=TO"),
            ("node --ros-args -r", "-r"),
            ("node --ros-args -p speed:=1", "speed"),
            ("node --ros-args --params-file x.yaml", "--params-file"),
            ("node --ros-args -p metres_per_unit:=-1", "metres-per-unit"),
        ] {
            let error = read(wrong).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
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
