//! Logs of phones that have a file for each sensor: those of Sensor Logger
//! (<https://github.com/tszheichoi/awesome-sensor-logger>) and of OpenCamera Sensors
//! (<https://github.com/MobileRoboticsSkoltech/OpenCamera-Sensors>).

use crate::DatasetError;
use crate::columns::{TimeUnit, bare, fields};
use crate::text::{numbers, read_text};
use monogrid_geometry::Vec3;
use std::path::{Path, PathBuf};

/// Readings of the accelerometer that are further apart are not interpolated, ns.
const MAX_GAP_NS: i64 = 100_000_000;

/// Times, ns, and readings of one sensor, in the order of time.
type Readings = Vec<(i64, Vec3)>;

/// Readings of both sensors at the times of the gyroscope, and how the files were understood.
pub struct PhoneLogs {
    /// Times, ns, angular velocities and specific forces as they are written.
    pub rows: Vec<(i64, Vec3, Vec3)>,
    pub interpretation: String,
}

/// The files of a recording.
struct Files {
    gyroscope: PathBuf,
    accelerometer: PathBuf,
    /// What is to be added to have gravity in it.
    gravity: Option<PathBuf>,
    metadata: Option<PathBuf>,
}

impl PhoneLogs {
    /// Of a folder, or of the file of one of its sensors; `None` where there are no such files.
    pub fn read(path: &Path) -> Result<Option<Self>, DatasetError> {
        let Some(files) = Files::find(path)? else {
            return Ok(None);
        };
        let (rates, time_unit) = readings(&files.gyroscope)?;
        let (mut forces, _) = readings(&files.accelerometer)?;
        if let Some(gravity) = &files.gravity {
            let gravity = readings(gravity)?.0;
            let sum = |(time_ns, force): &(i64, Vec3)| {
                Some((*time_ns, force + interpolated(&gravity, *time_ns)?))
            };
            forces = forces.iter().filter_map(sum).collect();
        }
        let is_downwards = files.is_downwards()?;
        let sign = if is_downwards { -1.0 } else { 1.0 };
        let row = |(time_ns, rate): &(i64, Vec3)| {
            Some((*time_ns, *rate, interpolated(&forces, *time_ns)? * sign))
        };
        let name = |path: &Path| path.file_name().unwrap_or_default().display().to_string();
        let gravity = files
            .gravity
            .as_deref()
            .map(|path| format!(" + {}", name(path)));
        let turned = if is_downwards {
            ", turned to point upwards as iOS counts down"
        } else {
            ""
        };
        Ok(Some(Self {
            rows: rates.iter().filter_map(row).collect(),
            interpretation: format!(
                "gyroscope of {}, accelerometer of {}{}{turned}, time in {time_unit}",
                name(&files.gyroscope),
                name(&files.accelerometer),
                gravity.unwrap_or_default()
            ),
        }))
    }
}

impl Files {
    fn find(path: &Path) -> Result<Option<Self>, DatasetError> {
        let is_folder = path.is_dir();
        let folder = match is_folder {
            true => path,
            false => path.parent().unwrap_or(Path::new("")),
        };
        let named = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .to_ascii_lowercase();
        if !is_folder && named.contains("gyr") == named.contains("acc") {
            return Ok(None);
        }
        let names = names_of_logs(folder);
        let gyroscopes: Vec<(&String, &str)> = names
            .iter()
            .filter_map(|name| Some((name, recording(name, "gyro")?)))
            .filter(|(name, prefix)| {
                is_folder
                    || named == name.to_ascii_lowercase()
                    || named.starts_with(&prefix.to_ascii_lowercase()) && named.contains("acc")
            })
            .collect();
        let of = |prefix: &str, sensor: &str| {
            let found = names
                .iter()
                .find(|name| recording(name, sensor) == Some(prefix));
            found.map(|name| folder.join(name))
        };
        let mut all = gyroscopes.iter().filter_map(|(name, prefix)| {
            let total = of(prefix, "totalacceleration");
            let gravity = of(prefix, "gravity").filter(|_| total.is_none());
            Some(Self {
                gyroscope: folder.join(name),
                accelerometer: total.or_else(|| of(prefix, "accel"))?,
                gravity,
                metadata: of(prefix, "metadata"),
            })
        });
        let first = all.next();
        if let (Some(first), Some(second)) = (&first, all.next()) {
            let found = format!(
                "logs of several recordings: {} and {}",
                first.gyroscope.display(),
                second.gyroscope.display()
            );
            return Err(DatasetError::content(path, found, "one of them"));
        }
        match first {
            None if is_folder => Err(DatasetError::content(
                path,
                "no logs of a gyroscope and an accelerometer",
                "Gyroscope.csv with TotalAcceleration.csv, or with Accelerometer.csv and \
                 Gravity.csv, or NAMEgyro.csv and NAMEaccel.csv",
            )),
            first => Ok(first),
        }
    }

    /// Whether the accelerometer points downwards at rest: so it does on iOS, unless the
    /// application was set to Android's convention.
    fn is_downwards(&self) -> Result<bool, DatasetError> {
        let Some(path) = &self.metadata else {
            return match &self.gravity {
                None => Ok(false),
                Some(gravity) => Err(DatasetError::content(
                    gravity,
                    "nothing that says whether the phone counts gravity upwards (Android) or \
                     downwards (iOS)",
                    "Metadata.csv beside it",
                )),
            };
        };
        let text = read_text(path)?;
        let mut lines = text.lines().map(|line| line.split(','));
        let names: Vec<&str> = lines.next().into_iter().flatten().map(str::trim).collect();
        let values: Vec<&str> = lines.next().into_iter().flatten().map(str::trim).collect();
        let value = |name: &str| {
            let at = names.iter().position(|found| *found == name)?;
            values.get(at).copied()
        };
        let is_ios = value("platform").is_some_and(|name| name.eq_ignore_ascii_case("ios"));
        let is_standard = value("standardisation").is_some_and(|v| v.eq_ignore_ascii_case("true"));
        Ok(is_ios && !is_standard)
    }
}

/// Names of the files in a folder that may be logs, sorted.
fn names_of_logs(folder: &Path) -> Vec<String> {
    let listed = match folder == Path::new("") {
        true => Path::new(".").read_dir(),
        false => folder.read_dir(),
    };
    let entries = listed.into_iter().flatten();
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names
        .filter(|name| {
            let name = name.to_ascii_lowercase();
            name.ends_with(".csv") && !name.contains("uncalibrated")
        })
        .collect();
    names.sort();
    names
}

/// What stands before the name of a sensor: that of the recording.
fn recording<'a>(name: &'a str, sensor: &str) -> Option<&'a str> {
    let at = name.to_ascii_lowercase().find(sensor)?;
    name.get(..at)
}

/// Readings of one sensor, and the unit of their times. Columns are found by their names; without
/// names they are x, y, z and the time, before or behind them.
fn readings(path: &Path) -> Result<(Readings, &'static str), DatasetError> {
    let text = read_text(path)?;
    let lines = (1..).zip(text.lines());
    let mut lines = lines.filter(|(_, line)| !line.trim().is_empty()).peekable();
    let expected =
        "a time and three numbers x, y, z, with or without their names in the first line";
    let names = lines.next_if(|(_, line)| numbers(&line.replace(',', " ")).is_none());
    let columns = names.map(|(_, line)| {
        let names: Vec<String> = fields(line)
            .map(|name| bare(&name.to_lowercase()))
            .collect();
        let at = |test: &dyn Fn(&str) -> bool| names.iter().position(|name| test(name));
        let axis = |axis: char| at(&|name| name.ends_with(axis));
        Some((
            at(&|name| name.contains("time"))?,
            [axis('x')?, axis('y')?, axis('z')?],
        ))
    });
    let rows: Vec<(usize, &str, Vec<&str>)> = lines
        .map(|(number, line)| (number, line, fields(line).collect()))
        .collect();
    let (time, axes) = match columns {
        Some(Some(columns)) => columns,
        Some(None) => return Err(DatasetError::content(path, "other columns", expected)),
        None => {
            let goes_on = |at: usize| {
                let time = |row: &(usize, &str, Vec<&str>)| row.2.get(at)?.parse::<f64>().ok();
                let never_back = rows.windows(2).all(|two| time(&two[0]) <= time(&two[1]));
                never_back && rows.first().and_then(time) < rows.last().and_then(time)
            };
            match [goes_on(0), goes_on(3)] {
                [true, false] => (0, [1, 2, 3]),
                [false, true] => (3, [0, 1, 2]),
                _ => return Err(DatasetError::content(path, "no column of times", expected)),
            }
        }
    };
    let parsed = |(number, line, values): &(usize, &str, Vec<&str>)| {
        let number_at = |at: usize| {
            values
                .get(at)?
                .parse::<f64>()
                .ok()
                .filter(|v| v.is_finite())
        };
        let [x, y, z] = axes.map(number_at);
        let row = || Some((values.get(time).copied()?.to_owned(), Vec3::new(x?, y?, z?)));
        row().ok_or_else(|| DatasetError::line(path, *number, line, expected))
    };
    let rows = rows.iter().map(parsed).collect::<Result<Vec<_>, _>>()?;
    let unit = TimeUnit::of(rows.iter().map(|(time, _)| time.as_str()), path)?;
    let timed = rows
        .iter()
        .map(|(time, value)| Some((unit.nanoseconds(time)?, *value)));
    let timed: Option<Readings> = timed.collect();
    let mut timed =
        timed.ok_or_else(|| DatasetError::content(path, "times that are no numbers", "numbers"))?;
    timed.sort_by_key(|(time_ns, _)| *time_ns);
    Ok((timed, unit.name))
}

/// The reading between those before and after; `None` where there are none nearby.
fn interpolated(readings: &Readings, time_ns: i64) -> Option<Vec3> {
    let after = readings.partition_point(|(at, _)| *at < time_ns);
    let (end_ns, end) = readings.get(after)?;
    if *end_ns == time_ns {
        return Some(*end);
    }
    let (begin_ns, begin) = readings.get(after.checked_sub(1)?)?;
    let length_ns = end_ns
        .checked_sub(*begin_ns)
        .filter(|length| *length <= MAX_GAP_NS)?;
    let share = (time_ns - begin_ns) as f64 / length_ns as f64;
    Some(begin + (end - begin) * share)
}
