//! Tables of readings: their fields, the names of their columns, and the unit of their times.

use crate::{DatasetError, parse_seconds};
use monogrid_geometry::median::median;
use std::path::Path;

/// Fields of a line, separated by commas, semicolons or blanks.
pub fn fields(line: &str) -> impl Iterator<Item = &str> {
    let separator = match line.contains([',', ';']) {
        true => [',', ';'],
        false => [' ', '\t'],
    };
    let fields = line.split(separator).map(str::trim);
    fields.filter(|field| !field.is_empty())
}

/// The name of a column without its unit: `w_rs_s_x [rad s^-1]` is about x.
pub fn bare(name: &str) -> String {
    let bare = name.split(['[', '(']).next().unwrap_or("");
    bare.trim().to_owned()
}

/// Unit of a time.
pub struct TimeUnit {
    pub name: &'static str,
    nanoseconds: i64,
}

/// Units that are known.
const TIME_UNITS: [TimeUnit; 4] = [
    TimeUnit::new("seconds", 1_000_000_000),
    TimeUnit::new("milliseconds", 1_000_000),
    TimeUnit::new("microseconds", 1_000),
    TimeUnit::new("nanoseconds", 1),
];

impl TimeUnit {
    const fn new(name: &'static str, nanoseconds: i64) -> Self {
        Self { name, nanoseconds }
    }

    /// The one in which sensors give 5 to 2000 readings per second.
    pub fn of<'a>(times: impl Iterator<Item = &'a str>, path: &Path) -> Result<Self, DatasetError> {
        let times = times.filter_map(|time| time.parse().ok());
        let times: Vec<f64> = times.collect();
        let intervals = times.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let mut intervals: Vec<f64> = intervals.filter(|i| *i > 0.0).collect();
        let median = median(&mut intervals).unwrap_or(0.0);
        let fits = |unit: &Self| {
            let per_second = (1_000_000_000 / unit.nanoseconds) as f64;
            (0.0005..=0.2).contains(&(median / per_second))
        };
        TIME_UNITS.into_iter().find(fits).ok_or_else(|| {
            let found = format!("a median of {median} between the times of readings");
            let expected = "0.5 to 200 ms, in seconds, milliseconds, microseconds or nanoseconds";
            DatasetError::content(path, found, expected)
        })
    }

    pub fn nanoseconds(&self, text: &str) -> Option<i64> {
        if self.name == "seconds" {
            return parse_seconds(text);
        }
        if let Ok(whole) = text.parse::<i64>() {
            return whole.checked_mul(self.nanoseconds);
        }
        let ns = text.parse::<f64>().ok()? * self.nanoseconds as f64;
        (ns.abs() < 9e18).then_some(ns.round() as i64)
    }
}
