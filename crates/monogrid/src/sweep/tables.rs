//! The tables of a sweep, with the thesis' own numbers beside ours.

use super::plan::{BUFFERS, Entry, Model, SIGNIFICANCES, usual_models};
use super::record::{Built, MapRecord, MapResult, PolicyScores, Scores};
use super::slam_rate::Rate;
use super::thesis;
use std::fmt::Write;

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

/// Thrun's model with the thesis' ten values.
pub fn thrun_models() -> Vec<Model> {
    BUFFERS.map(Model::Thrun).to_vec()
}

/// Andert's model with the thesis' ten values.
pub fn andert_models() -> Vec<Model> {
    SIGNIFICANCES.map(Model::Andert).to_vec()
}

/// A table with a title. Cells that start with `*` are the best of their column.
#[derive(Clone, Debug)]
pub struct Table {
    /// Name of its file.
    pub file: &'static str,
    /// Title.
    pub title: String,
    /// What the reader must know.
    pub note: String,
    /// Names of the columns.
    pub header: Vec<String>,
    /// Cells.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Comma-separated values.
    pub fn csv(&self) -> String {
        let mut text = String::new();
        for row in std::iter::once(&self.header).chain(&self.rows) {
            let cells: Vec<String> = row.iter().map(|cell| csv_cell(cell)).collect();
            let _ = writeln!(text, "{}", cells.join(","));
        }
        text
    }
}

fn csv_cell(cell: &str) -> String {
    let plain = cell.strip_prefix('*').unwrap_or(cell);
    if plain.contains([',', '"']) {
        format!("\"{}\"", plain.replace('"', "\"\""))
    } else {
        plain.to_owned()
    }
}

/// Millimetres, for headings.
pub fn mm(resolution: f64) -> String {
    format!("{} mm", crate::report::svg::number(resolution * 1e3))
}

fn headings(first: &str, rest: &[&str]) -> Vec<String> {
    std::iter::once(first)
        .chain(rest.iter().copied())
        .map(str::to_owned)
        .collect()
}

/// Tables 6.3 and 6.5: the data sets.
pub fn data_sets(results: &[RecordingResult]) -> Table {
    let mut rows: Vec<Vec<String>> = results
        .iter()
        .map(|result| {
            let size = result.environment.map_or_else(
                || "not known".to_owned(),
                |[x, y, z]| format!("{x:.1} x {y:.1} x {z:.1}"),
            );
            let rate = result.rates.iter().map(|rate| rate.frames_per_second);
            let rate = rate.fold(f64::NAN, f64::max);
            vec![
                format!("{} ({})", result.name, result.profile),
                size,
                format!("{:.0} s, {} frames", result.video_seconds, result.frames),
                result.keyframes.to_string(),
                format!("{:.2} million", result.points as f64 / 1e6),
                if rate.is_nan() {
                    "not measured".to_owned()
                } else {
                    format!("{rate:.1} per second")
                },
            ]
        })
        .collect();
    let of_thesis = [
        [
            "thesis: machine",
            "30 x 30 x 12",
            "140 s at 50 Hz",
            "148",
            "16.35 million",
            "10 per second",
        ],
        [
            "thesis: office",
            "7 x 8 x 3.5",
            "51 s at 30 Hz",
            "45",
            "3.44 million",
            "14 per second",
        ],
    ];
    rows.extend(of_thesis.map(|row| row.map(str::to_owned).to_vec()));
    Table {
        file: "table-6.3-6.5-data-sets",
        title: "Data sets (Tables 6.3 and 6.5)".to_owned(),
        note: "Seconds from the first to the last keyframe. Rate: SLAM with the least demanding \
               mapping beside it."
            .to_owned(),
        header: headings(
            "data set",
            &["environment, m", "video", "keyframes", "points", "SLAM"],
        ),
        rows,
    }
}

fn megabytes(bytes: usize) -> String {
    significant(bytes as f64 / 1e6)
}

/// Three significant digits.
fn significant(value: f64) -> String {
    match value {
        v if v >= 100.0 => format!("{v:.0}"),
        v if v >= 10.0 => format!("{v:.1}"),
        v if v >= 1.0 => format!("{v:.2}"),
        v => format!("{v:.3}"),
    }
}

/// Table 6.4: memory and files.
pub fn memory(result: &RecordingResult) -> Table {
    let mut rows = Vec::new();
    for model in usual_models() {
        for &resolution in &result.resolutions {
            let Some(record) = result.record(model, resolution) else {
                continue;
            };
            let mut row = vec![model_name(model), mm(resolution)];
            match &record.result {
                MapResult::Built(built) => row.extend(memory_cells(built)),
                MapResult::BeyondMemory { .. } => row.extend(vec!["x".to_owned(); 6]),
            }
            row.extend(thesis_memory_cells(model, resolution));
            rows.push(row);
        }
    }
    Table {
        file: "table-6.4-memory",
        title: format!("Memory and files (Table 6.4): {}", result.name),
        note:
            "Megabytes, as likely / full: the map in maximum-likelihood form (every cell free or \
               occupied) and with probabilities; files .bt / .ot. x: beyond the memory limit. The \
               thesis measured the memory of its mapping process, which also holds waiting \
               keyframes; ours is the map alone."
                .to_owned(),
        header: headings(
            "model",
            &[
                "cells",
                "RAM likely",
                "RAM full",
                ".bt",
                ".ot",
                "nodes",
                "extent, m",
                "thesis office: RAM",
                "files",
                "thesis machine: RAM",
                "files",
            ],
        ),
        rows,
    }
}

fn memory_cells(built: &Built) -> Vec<String> {
    let file = |bytes: Option<u64>| {
        bytes.map_or_else(|| "-".to_owned(), |bytes| megabytes(bytes as usize))
    };
    let [x, y, z] = built.extent;
    vec![
        megabytes(built.bytes_likelihood),
        megabytes(built.bytes),
        file(built.bt_bytes),
        file(built.ot_bytes),
        built
            .nodes
            .map_or_else(|| "-".to_owned(), |n| n.to_string()),
        format!("{x:.1} x {y:.1} x {z:.1}"),
    ]
}

fn thesis_memory_cells(model: Model, resolution: f64) -> Vec<String> {
    let tables = match model {
        Model::Thrun(_) => [thesis::OFFICE_MEMORY_THRUN, thesis::MACHINE_MEMORY_THRUN],
        Model::Andert(_) => [thesis::OFFICE_MEMORY_ANDERT, thesis::MACHINE_MEMORY_ANDERT],
        _ => return vec![String::new(); 4],
    };
    let Some(column) = thesis::column(resolution) else {
        return vec![String::new(); 4];
    };
    let cell =
        |value: Option<f64>| value.map_or_else(|| "x".to_owned(), crate::report::svg::number);
    tables
        .iter()
        .flat_map(|table| {
            let [bt_ram, ot_ram, bt_file, ot_file] = table[column].map(cell);
            [
                format!("{bt_ram} / {ot_ram}"),
                format!("{bt_file} / {ot_file}"),
            ]
        })
        .collect()
}

fn model_name(model: Model) -> String {
    match model {
        Model::None => "unprocessed".to_owned(),
        Model::Ideal => "ideal".to_owned(),
        Model::Thrun(l) => format!("Thrun, L = {l}"),
        Model::Andert(k) => format!("Andert, k = {k}"),
        Model::Automatic => "ours, automatic".to_owned(),
    }
}

/// Tables 6.6 and 6.7: time, and the rate of SLAM beside it.
pub fn speed(result: &RecordingResult) -> Table {
    let mut rows = Vec::new();
    for model in usual_models() {
        for &resolution in &result.resolutions {
            let Some(record) = result.record(model, resolution) else {
                continue;
            };
            let cells = match record.built() {
                Some(built) => [
                    format!("{:.3}", built.seconds * 1e5 / built.points.max(1) as f64),
                    significant(built.seconds),
                ],
                None => ["x".to_owned(), "x".to_owned()],
            };
            let rate = result
                .rates
                .iter()
                .find(|rate| rate.entry == record.entry)
                .map_or_else(
                    || "-".to_owned(),
                    |rate| format!("{:.1}", rate.frames_per_second),
                );
            let [office, machine] = thesis_seconds(model, resolution);
            let total = |per_100k: Option<f64>, count: f64| {
                per_100k.map_or_else(String::new, |s| format!("{s:.2} ({:.0})", s * count))
            };
            let mut row = vec![model_name(model), mm(resolution)];
            row.extend(cells);
            row.push(rate);
            row.push(total(office, thesis::OFFICE_100K_POINTS));
            row.push(total(machine, thesis::MACHINE_100K_POINTS));
            rows.push(row);
        }
    }
    Table {
        file: "table-6.6-6.7-speed",
        title: format!("Time (Tables 6.6 and 6.7): {}", result.name),
        note: "CPU seconds of one core per 100 000 points, and for the whole recording. The thesis \
               used a core of an i7-4700MQ; its seconds for the whole data set (in brackets) are its \
               rate times its points. SLAM: frames per second with this mapping running beside it."
            .to_owned(),
        header: headings(
            "model",
            &[
                "cells",
                "s per 100k",
                "s in all",
                "SLAM",
                "thesis office",
                "thesis machine",
            ],
        ),
        rows,
    }
}

/// Seconds per 100 000 points in the thesis: office and machine.
fn thesis_seconds(model: Model, resolution: f64) -> [Option<f64>; 2] {
    let row = match model {
        Model::Ideal => 0,
        Model::Thrun(_) => 1,
        Model::Andert(_) => 2,
        Model::None | Model::Automatic => return [None, None],
    };
    let column = thesis::column(resolution);
    [
        column.map(|c| thesis::OFFICE_SECONDS[row][c]),
        column.map(|c| thesis::MACHINE_SECONDS[row][c]),
    ]
}

/// A score of a map, for a table over parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Score {
    /// AUC of all cells whose truth is known, unobserved ones at 0.5, by 26 thresholds: the thesis' way.
    AucKnown,
    /// Exact AUC of observed cells.
    AucObserved,
    /// MCC of observed cells at p > 0.5.
    MccObserved,
}

impl Score {
    /// The score of a map.
    pub fn of(self, scores: &Scores) -> f64 {
        match self {
            Self::AucKnown => scores.known.auc_26,
            Self::AucObserved => scores.observed.auc,
            Self::MccObserved => scores.observed.mcc,
        }
    }
}

/// Tables 6.8 and 6.9: a score over the values of L or k.
pub fn over_parameter(result: &RecordingResult, is_thrun: bool, score: Score) -> Table {
    let (models, of_thesis, number) = if is_thrun {
        (thrun_models(), thesis::AUC_THRUN, "6.8")
    } else {
        (andert_models(), thesis::AUC_ANDERT, "6.9")
    };
    let shows_thesis = score == Score::AucKnown;
    let value = |model: Model, resolution: f64| {
        result
            .scores(model, resolution)
            .map(|scores| score.of(scores))
    };
    let best = |resolution: f64| {
        let values = models.iter().filter_map(|m| value(*m, resolution));
        values.fold(f64::NEG_INFINITY, f64::max)
    };
    let mut rows: Vec<Vec<String>> = Vec::new();
    for (index, model) in models.iter().enumerate() {
        let mut row = vec![model.label()];
        for &resolution in &result.resolutions {
            let ours = value(*model, resolution).map_or_else(
                || "x".to_owned(),
                |v| {
                    let mark = if v >= best(resolution) { "*" } else { "" };
                    format!("{mark}{v:.3}")
                },
            );
            row.push(ours);
            if shows_thesis {
                let theirs = thesis::column(resolution).map(|c| of_thesis[index][c]);
                row.push(theirs.map_or_else(String::new, |v| format!("{v:.2}")));
            }
        }
        rows.push(row);
    }
    for model in [Model::Ideal, Model::Automatic] {
        let mut row = vec![model_name(model)];
        for &resolution in &result.resolutions {
            let text = value(model, resolution);
            row.push(text.map_or_else(|| "x".to_owned(), |v| format!("{v:.3}")));
            if shows_thesis {
                row.push(String::new());
            }
        }
        rows.push(row);
    }
    let mut header = vec![if is_thrun { "L, m" } else { "k, m" }.to_owned()];
    for &resolution in &result.resolutions {
        header.push(mm(resolution));
        if shows_thesis {
            header.push("thesis".to_owned());
        }
    }
    let (file, what) = match (score, is_thrun) {
        (Score::AucKnown, true) => ("table-6.8-auc-thrun", "AUC"),
        (Score::AucKnown, false) => ("table-6.9-auc-andert", "AUC"),
        (Score::AucObserved, true) => ("table-6.8-auc-observed-thrun", "AUC of observed cells"),
        (Score::AucObserved, false) => ("table-6.9-auc-observed-andert", "AUC of observed cells"),
        (Score::MccObserved, true) => ("table-6.8-mcc-thrun", "MCC of observed cells"),
        (Score::MccObserved, false) => ("table-6.9-mcc-andert", "MCC of observed cells"),
    };
    let family = if is_thrun { "Thrun" } else { "Andert" };
    Table {
        file,
        title: format!("{what}, {family} (Table {number}): {}", result.name),
        note: match score {
            Score::AucKnown => "Cells whose truth is known, unobserved ones count as 0.5; 26 \
                                thresholds, trapezoid. Probably the thesis' way; its numbers are of \
                                another room."
                .to_owned(),
            Score::AucObserved => "Only cells that the map observed; exact.".to_owned(),
            Score::MccObserved => "Only cells that the map observed, occupied above 0.5. AUC rewards \
                                   thick walls, MCC does not."
                .to_owned(),
        },
        header,
        rows,
    }
}

/// The best values of both models, the ideal model and ours, per resolution.
pub fn best_of(result: &RecordingResult) -> Table {
    let known = |scores: &Scores| Score::AucKnown.of(scores);
    let mut rows = Vec::new();
    for &resolution in &result.resolutions {
        let candidates = [
            result.best(&thrun_models(), resolution, known),
            result.best(&andert_models(), resolution, known),
            Some(Model::Ideal),
            Some(Model::Automatic),
        ];
        for model in candidates.into_iter().flatten() {
            let Some(scores) = result.scores(model, resolution) else {
                continue;
            };
            let cells = |policy: &PolicyScores| {
                [policy.auc, policy.mcc, policy.precision, policy.recall].map(|v| format!("{v:.3}"))
            };
            let mut row = vec![mm(resolution), model_name(model)];
            row.extend(cells(&scores.observed));
            row.push(format!("{:.3}", scores.known.auc));
            row.extend(
                [
                    scores.coverage_free_in_view,
                    scores.coverage_occupied_in_view,
                ]
                .map(|share| {
                    share.map_or_else(|| "-".to_owned(), |s| format!("{:.0} %", 100.0 * s))
                }),
            );
            row.push(
                scores
                    .occupied_ratio
                    .map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.2}")),
            );
            rows.push(row);
        }
    }
    Table {
        file: "best",
        title: format!("The best values against each other: {}", result.name),
        note: "Best L and k by AUC of known cells, ties by recall (the thesis' rule). Coverage: of the \
               cells that a keyframe looks at. Thickness: predicted occupied cells per true one."
            .to_owned(),
        header: headings(
            "cells",
            &[
                "model",
                "AUC observed",
                "MCC",
                "precision",
                "recall",
                "AUC known",
                "free covered",
                "occupied covered",
                "thickness",
            ],
        ),
        rows,
    }
}

/// Every map in one line, for other programs.
pub fn all_maps_csv(results: &[RecordingResult]) -> String {
    let mut text = String::from(
        "recording,profile,model,parameter,resolution,keyframes,points,seconds,bytes,bytes_likelihood,\
         nodes,leaves,extent_x,extent_y,extent_z,bt_bytes,ot_bytes,auc_observed,auc_known,\
         auc_everything,auc_safety,auc_26_observed,auc_26_known,mcc_observed,precision_observed,\
         recall_observed,f1_observed,mcc_known,coverage_free,coverage_occupied,\
         coverage_free_in_view,coverage_occupied_in_view,brier,ssd,occupied_ratio\n",
    );
    for result in results {
        for record in &result.records {
            let entry = &record.entry;
            let parameter = entry.model.parameter().map(|p| p.to_string());
            let _ = write!(
                text,
                "{},{},{},{},{}",
                csv_cell(&result.name),
                result.profile,
                entry.model.family(),
                parameter.unwrap_or_default(),
                entry.resolution
            );
            let Some(built) = record.built() else {
                text.push_str(",x\n");
                continue;
            };
            let optional = |value: Option<String>| value.unwrap_or_default();
            let _ = write!(
                text,
                ",{},{},{:.4},{},{},{},{},{:.3},{:.3},{:.3},{},{}",
                built.keyframes,
                built.points,
                built.seconds,
                built.bytes,
                built.bytes_likelihood,
                optional(built.nodes.map(|n| n.to_string())),
                built.leaves,
                built.extent[0],
                built.extent[1],
                built.extent[2],
                optional(built.bt_bytes.map(|n| n.to_string())),
                optional(built.ot_bytes.map(|n| n.to_string())),
            );
            if let Some(scores) = &built.scores {
                for value in score_columns(scores) {
                    let _ = write!(
                        text,
                        ",{}",
                        value.map_or(String::new(), |v| format!("{v:.6}"))
                    );
                }
            }
            text.push('\n');
        }
    }
    text
}

fn score_columns(scores: &Scores) -> [Option<f64>; 18] {
    [
        Some(scores.observed.auc),
        Some(scores.known.auc),
        Some(scores.everything.auc),
        Some(scores.safety.auc),
        Some(scores.observed.auc_26),
        Some(scores.known.auc_26),
        Some(scores.observed.mcc),
        Some(scores.observed.precision),
        Some(scores.observed.recall),
        Some(scores.observed.f1),
        Some(scores.known.mcc),
        Some(scores.coverage_free),
        Some(scores.coverage_occupied),
        scores.coverage_free_in_view,
        scores.coverage_occupied_in_view,
        scores.brier,
        Some(scores.ssd),
        scores.occupied_ratio,
    ]
}
