//! What a batch keeps of the `summary.json` of a run.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// Numbers of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// How tracking ended, as `summary.json` says it.
    pub status: String,
    /// Frames of the source.
    pub frames: u64,
    /// Frames with a pose in the map.
    pub tracked: u64,
    /// Times that tracking was lost.
    pub lost_episodes: u64,
    /// Keyframes.
    pub keyframes: u64,
    /// Loops closed.
    pub loop_closures: u64,
    /// Frames per second, everything included.
    pub frames_per_second: f64,
    /// `metric` or `arbitrary`.
    pub scale: String,
    /// Measurements mapped.
    pub points: u64,
    /// Root mean square of the distance from the reference, metres, where there is one.
    pub ate_rmse_m: Option<f64>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Metrics {
    /// From the folder of a run, where there is a summary that was written since `begin`.
    pub fn read(run: &Path, begin: SystemTime) -> Option<Self> {
        let path = run.join("summary.json");
        let written = std::fs::metadata(&path).and_then(|metadata| metadata.modified());
        // the clock of files is coarser
        if written.ok()? + Duration::from_millis(20) < begin {
            return None;
        }
        let text = std::fs::read_to_string(path).ok()?;
        Self::of(&serde_json::from_str(&text).ok()?)
    }

    fn of(summary: &Value) -> Option<Self> {
        let count = |name: &str| summary[name].as_u64();
        let text = |name: &str| summary[name].as_str().map(str::to_owned);
        let warnings = summary["warnings"].as_array().into_iter().flatten();
        Some(Self {
            status: text("status")?,
            frames: count("frames")?,
            tracked: count("tracked")?,
            lost_episodes: count("lost_episodes")?,
            keyframes: count("keyframes")?,
            loop_closures: count("loop_closures")?,
            frames_per_second: summary["frames_per_second"].as_f64()?,
            scale: text("scale")?,
            points: count("points")?,
            ate_rmse_m: summary["trajectory"]["ate_rmse"].as_f64(),
            warnings: warnings
                .filter_map(|warning| warning.as_str().map(str::to_owned))
                .collect(),
        })
    }

    /// Share of the frames that have a pose.
    pub fn coverage(&self) -> f64 {
        self.tracked as f64 / self.frames.max(1) as f64
    }
}
