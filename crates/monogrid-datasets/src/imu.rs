//! Inertial measurements: EuRoC's `imu0`, and the logs of phones.

use crate::calibration::sensor_yaml;
use crate::columns::{TimeUnit, bare, fields};
use crate::files::is_file;
use crate::phone_logs::PhoneLogs;
use crate::text::{numbers, read_text};
use crate::{DatasetError, write_atomically};
use monogrid_geometry::median::median;
use monogrid_geometry::{Se3, Vec3};
use monogrid_inertial::{GRAVITY_M_S2, ImuNoise, ImuSample};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Readings as a file holds them, and how it was understood.
#[derive(Clone, Debug)]
pub struct ImuFile {
    /// In the order of the file.
    pub samples: Vec<ImuSample>,
    /// What `sensor.yaml` beside it says of the noise.
    pub noise: Option<ImuNoise>,
    /// Where the sensor sits in the body, by the same file.
    pub body_from_imu: Option<Se3>,
    /// Units and columns, for people.
    pub interpretation: String,
    /// The file.
    pub path: PathBuf,
}

impl ImuFile {
    /// Reads a table of readings, one a line, separated by commas, semicolons or blanks.
    ///
    /// Columns are found by their names in the first line (`timestamp,gx,gy,gz,ax,ay,az`, EuRoC's,
    /// and most of what phones write), else they are time, gyroscope x y z, accelerometer x y z.
    /// The unit of time follows from the time between readings, which is taken to be 0.5 to 200 ms;
    /// that of the accelerometer from gravity, which must be in it; gyroscopes are in rad/s unless
    /// a name says degrees.
    ///
    /// A folder, or a file of one sensor beside that of the other, is a log of a phone: of Sensor
    /// Logger or of OpenCamera Sensors.
    ///
    /// # Errors
    /// When the file cannot be read, a line is not one of numbers, or the readings are not those of
    /// such a sensor.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        match PhoneLogs::read(path)? {
            Some(logs) => Self::of_phone(path, &logs),
            None => Self::of_table(path),
        }
    }

    fn of_phone(path: &Path, logs: &PhoneLogs) -> Result<Self, DatasetError> {
        let forces = logs.rows.iter().map(|(.., force)| force.norm());
        let (to_force, unit) = force_unit(forces, path)?;
        let sample = |(timestamp_ns, angular_velocity, force): &(i64, Vec3, Vec3)| ImuSample {
            timestamp_ns: *timestamp_ns,
            angular_velocity: *angular_velocity,
            specific_force: force * to_force,
        };
        Ok(Self {
            samples: logs.rows.iter().map(sample).collect(),
            noise: None,
            body_from_imu: None,
            interpretation: format!("{}, accelerometer in {unit}", logs.interpretation),
            path: path.to_path_buf(),
        })
    }

    fn of_table(path: &Path) -> Result<Self, DatasetError> {
        let text = read_text(path)?;
        let columns = Columns::find(&text, path)?;
        let rows = rows(&text, path, &columns)?;
        let time = TimeUnit::of(rows.iter().map(|row| row.time), path)?;
        let (to_force, force_unit) = force_unit(rows.iter().map(|row| row.force.norm()), path)?;
        let (to_rate, rate_unit) = match columns.in_degrees {
            true => (1f64.to_radians(), "degrees per second"),
            false => (1.0, "rad/s"),
        };
        let found = match columns.are_named {
            true => "columns by their names",
            false => "columns as time, gyroscope, accelerometer",
        };
        let sample = |row: &Row| {
            Some(ImuSample {
                timestamp_ns: time.nanoseconds(row.time)?,
                angular_velocity: row.rate * to_rate,
                specific_force: row.force * to_force,
            })
        };
        let samples: Option<Vec<_>> = rows.iter().map(sample).collect();
        let samples = samples
            .ok_or_else(|| DatasetError::content(path, "times that are no numbers", "numbers"))?;
        let calibration = match path.parent().map(|folder| folder.join("sensor.yaml")) {
            Some(yaml) if is_file(&yaml) => sensor_yaml(&read_text(&yaml)?),
            _ => ImuCalibration::default(),
        };
        Ok(Self {
            interpretation: format!(
                "{found}, time in {}, gyroscope in {rate_unit}, accelerometer in {force_unit}",
                time.name
            ),
            samples,
            noise: calibration.noise,
            body_from_imu: calibration.body_from_imu,
            path: path.to_path_buf(),
        })
    }
}

/// What a file says about an inertial sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuCalibration {
    /// Its noise.
    pub noise: Option<ImuNoise>,
    /// Where it sits in the body.
    pub body_from_imu: Option<Se3>,
}

impl ImuCalibration {
    /// Reads EuRoC's `sensor.yaml`.
    ///
    /// # Errors
    /// When the file cannot be read, or says nothing about the sensor.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let said = sensor_yaml(&read_text(path)?);
        if said == Self::default() {
            let found = "neither noise nor place of an inertial sensor";
            let expected = "gyroscope_noise_density, gyroscope_random_walk, \
                accelerometer_noise_density, accelerometer_random_walk, T_BS";
            return Err(DatasetError::content(path, found, expected));
        }
        Ok(said)
    }
}

/// A line of the table; the time as it is written, since a number would round it.
struct Row<'a> {
    time: &'a str,
    rate: Vec3,
    force: Vec3,
}

/// Which column holds what.
#[derive(Debug, PartialEq)]
struct Columns {
    time: usize,
    rate: [usize; 3],
    force: [usize; 3],
    in_degrees: bool,
    are_named: bool,
}

impl Columns {
    fn find(text: &str, path: &Path) -> Result<Self, DatasetError> {
        let mut lines = text.lines();
        let first = lines.find(|line| !line.trim().is_empty()).unwrap_or("");
        let header = first.trim_start_matches('#').trim();
        if numbers(header).is_some() || header.is_empty() {
            return Ok(Self {
                time: 0,
                rate: [1, 2, 3],
                force: [4, 5, 6],
                in_degrees: false,
                are_named: false,
            });
        }
        let names: Vec<String> = fields(header).map(str::to_lowercase).collect();
        Self::named(&names).ok_or_else(|| {
            let expected = "names of columns for time, gyroscope x y z and accelerometer x y z, as \
                `timestamp,gx,gy,gz,ax,ay,az`";
            DatasetError::line(path, 1, first, expected)
        })
    }

    fn named(names: &[String]) -> Option<Self> {
        let has = |name: &str, parts: &[&str]| parts.iter().any(|part| name.contains(part));
        let is_rate = |name: &str| {
            has(name, &["gyr", "angular", "rotation", "omega"])
                || name.starts_with("w_")
                || ["gx", "gy", "gz", "wx", "wy", "wz"].contains(&name)
        };
        let is_force = |name: &str| {
            !is_rate(name) && !has(name, &["gravity", "user"]) && name.starts_with('a')
                || name.contains("linear_acceleration")
        };
        let find = |test: &dyn Fn(&str) -> bool| {
            let is_of = |name: &str, axis: char| test(name) && name.ends_with(axis);
            let axis = |axis| names.iter().position(|name| is_of(&bare(name), axis));
            Some([axis('x')?, axis('y')?, axis('z')?])
        };
        let is_time = |name: &String| has(name, &["time", "seconds"]) || name == "t";
        let rate = find(&is_rate)?;
        Some(Self {
            time: names.iter().position(is_time)?,
            rate,
            force: find(&is_force)?,
            in_degrees: has(&names[rate[0]], &["deg", "dps", "°"]),
            are_named: true,
        })
    }
}

fn rows<'a>(text: &'a str, path: &Path, columns: &Columns) -> Result<Vec<Row<'a>>, DatasetError> {
    let row = |line: &'a str| {
        let values: Vec<&str> = fields(line).collect();
        let vector = |at: [usize; 3]| {
            let number = |at: usize| values.get(at)?.parse::<f64>().ok();
            Some(Vec3::new(number(at[0])?, number(at[1])?, number(at[2])?))
        };
        Some(Row {
            time: values.get(columns.time)?,
            rate: vector(columns.rate)?,
            force: vector(columns.force)?,
        })
    };
    let lines = (1..).zip(text.lines()).skip(usize::from(columns.are_named));
    let content =
        lines.filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'));
    let checked = |(number, line): (usize, &'a str)| {
        row(line).ok_or_else(|| {
            let expected = "a time and six numbers: gyroscope x y z, accelerometer x y z";
            DatasetError::line(path, number, line, expected)
        })
    };
    let rows = content.map(checked).collect::<Result<Vec<Row>, _>>()?;
    if rows.len() < 2 {
        let expected = "a reading of gyroscope and accelerometer in each line";
        let found = format!("{} readings", rows.len());
        return Err(DatasetError::content(path, found, expected));
    }
    Ok(rows)
}

/// What makes forces of these amounts m/s², and their unit: the sensor feels gravity most of the
/// time.
fn force_unit(
    norms: impl Iterator<Item = f64>,
    path: &Path,
) -> Result<(f64, &'static str), DatasetError> {
    let mut norms: Vec<f64> = norms.collect();
    let median = median(&mut norms).unwrap_or(0.0);
    match median {
        0.7..=1.4 => Ok((GRAVITY_M_S2, "g")),
        6.5..=14.0 => Ok((1.0, "m/s²")),
        _ => {
            let found = format!("a median of {median:.3} of the accelerometer's readings");
            let expected =
                "about 9.81 (m/s²) or 1 (g): what the sensor measures with gravity in it";
            Err(DatasetError::content(path, found, expected))
        }
    }
}

/// Writes readings in EuRoC's layout: `data.csv` and `sensor.yaml` in a folder that exists,
/// atomically.
///
/// # Errors
/// When a file cannot be written.
pub fn write_imu(
    folder: &Path,
    samples: &[ImuSample],
    noise: &ImuNoise,
    body_from_imu: &Se3,
    rate_hz: f64,
) -> Result<(), DatasetError> {
    let mut text = String::from(
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m \
         s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n",
    );
    for sample in samples {
        let (w, a) = (sample.angular_velocity, sample.specific_force);
        // writing into a string cannot fail
        let _ = writeln!(
            text,
            "{},{:.9},{:.9},{:.9},{:.8},{:.8},{:.8}",
            sample.timestamp_ns, w.x, w.y, w.z, a.x, a.y, a.z
        );
    }
    write_atomically(&folder.join("data.csv"), text.as_bytes())?;
    let matrix = body_from_imu.rotation_matrix();
    let rows = [0, 1, 2].map(|row| {
        let [x, y, z] = [0, 1, 2].map(|column| matrix[(row, column)]);
        let t = body_from_imu.translation[row];
        format!("{x:.12}, {y:.12}, {z:.12}, {t:.12},")
    });
    let yaml = format!(
        "sensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{}\n         0.0, 0.0, 0.0, 1.0]\n\
         rate_hz: {rate_hz}\ngyroscope_noise_density: {:e}\ngyroscope_random_walk: {:e}\n\
         accelerometer_noise_density: {:e}\naccelerometer_random_walk: {:e}\n",
        rows.join("\n         "),
        noise.gyroscope,
        noise.gyroscope_walk,
        noise.accelerometer,
        noise.accelerometer_walk
    );
    write_atomically(&folder.join("sensor.yaml"), yaml.as_bytes())
}
