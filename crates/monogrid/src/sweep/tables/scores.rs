//! Scores over the parameters of the sensor models.

use super::{Table, headings, mm, model_name};
use crate::sweep::plan::Model;
use crate::sweep::record::{PolicyScores, Scores};
use crate::sweep::result::{RecordingResult, andert_models, thrun_models};
use crate::sweep::thesis;

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
