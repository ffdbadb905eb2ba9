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
    #[serde(default)]
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
        let mut summary: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
        let error = summary["trajectory"]["ate_rmse"].clone();
        let fields = summary.as_object_mut()?;
        fields.insert("ate_rmse_m".to_owned(), error);
        serde_json::from_value(summary).ok()
    }

    /// Share of the frames that have a pose.
    pub fn coverage(&self) -> f64 {
        self.tracked as f64 / self.frames.max(1) as f64
    }
}
