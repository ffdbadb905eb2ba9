//! Everything that a sweep found out, ready to be shown.

use super::plan::{Entry, Model, usual_models};
use super::record::{MapRecord, Scores};
use super::slam_rate::Rate;
use super::tables::Score;
use super::thesis::Family;
use std::cmp::Ordering;

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

    /// The maps of the usual models, in the order of these and of the resolutions.
    pub fn usual_records(&self) -> impl Iterator<Item = &MapRecord> {
        let resolutions = self.resolutions.iter();
        usual_models().into_iter().flat_map(move |model| {
            let resolutions = resolutions.clone();
            resolutions.filter_map(move |resolution| self.record(model, *resolution))
        })
    }

    /// The model of a family with the largest score; ties go to the larger recall, as in the
    /// thesis.
    pub fn best(&self, family: &Family, resolution: f64, score: Score) -> Option<Model> {
        let ranked = family.models().into_iter().filter_map(|model| {
            let scores = self.scores(model, resolution)?;
            // as many digits as the thesis prints
            let rounded = (100.0 * score.of(scores)).round();
            Some(((rounded, scores.known.recall), model))
        });
        let best = ranked.max_by(|(a, _), (b, _)| a.partial_cmp(b).unwrap_or(Ordering::Equal));
        best.map(|(_, model)| model)
    }
}
