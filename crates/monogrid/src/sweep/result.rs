//! Everything that a sweep found out, ready to be shown.

use super::plan::{Entry, Model};
use super::record::{MapRecord, Scores};
use super::slam_rate::Rate;

/// Everything that a sweep found out about one recording.
#[derive(Debug)]
pub struct RecordingResult {
    /// Name of its folder in the output.
    pub name: String,
    /// Profile of the run that recorded it.
    pub profile: String,
    /// Whether its lengths are metres.
    pub is_metric: bool,
    /// Frames of the source; 0 when the run did not end by itself.
    pub frames: u64,
    /// Keyframes with a pose.
    pub keyframes: usize,
    /// Depth measurements in the recording.
    pub points: usize,
    /// Seconds from the first to the last keyframe.
    pub video_seconds: f64,
    /// Edges of the environment, where the truth is known.
    pub environment: Option<[f64; 3]>,
    /// Resolutions of the sweep, finest first.
    pub resolutions: Vec<f64>,
    /// All maps.
    pub records: Vec<MapRecord>,
    /// SLAM with mapping beside it.
    pub rates: Vec<Rate>,
}

impl RecordingResult {
    /// What became of a map.
    pub fn record(&self, model: Model, resolution: f64) -> Option<&MapRecord> {
        let wanted = Entry { model, resolution };
        self.records.iter().find(|record| record.entry == wanted)
    }

    /// The scores of a map, if it was built and compared.
    pub fn scores(&self, model: Model, resolution: f64) -> Option<&Scores> {
        self.record(model, resolution)?.scores()
    }

    /// The value of `models` with the largest `score`; ties go to the larger recall, as in the thesis.
    pub fn best(
        &self,
        models: &[Model],
        resolution: f64,
        score: fn(&Scores) -> f64,
    ) -> Option<Model> {
        let rank = |model: &Model| {
            let scores = self.scores(*model, resolution)?;
            // as many digits as the thesis prints
            Some(((100.0 * score(scores)).round(), scores.known.recall))
        };
        models
            .iter()
            .filter(|model| rank(model).is_some())
            .max_by(|a, b| {
                rank(a)
                    .partial_cmp(&rank(b))
                    .unwrap_or(std::cmp::Ordering::Equal)
            })
            .copied()
    }
}
