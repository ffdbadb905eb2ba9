//! Scores over the parameters of the sensor models.

use super::{Table, mm, model_name, or, words};
use crate::sweep::plan::Model;
use crate::sweep::record::{PolicyScores, Scores};
use crate::sweep::result::RecordingResult;
use crate::sweep::thesis::{self, ANDERT, Family, THRUN};

/// A score of a map, for a table over parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Score {
    /// AUC of all cells whose truth is known, unobserved ones at 0.5, by 26 thresholds: the thesis'
    /// way.
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

    /// Part of the name of its files, name for people, and what is counted.
    fn words(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::AucKnown => (
                "auc",
                "AUC",
                "Cells whose truth is known, unobserved ones count as 0.5; 26 thresholds, \
                 trapezoid. Probably the thesis' way; its numbers are of another room.",
            ),
            Self::AucObserved => (
                "auc-observed",
                "AUC of observed cells",
                "Only cells that the map observed; exact.",
            ),
            Self::MccObserved => (
                "mcc",
                "MCC of observed cells",
                "Only cells that the map observed, occupied above 0.5. AUC rewards thick walls, \
                 MCC does not.",
            ),
        }
    }
}

/// Tables 6.8 and 6.9: a score over the values of L or k.
pub fn over_parameter(result: &RecordingResult, family: &Family, score: Score) -> Table {
    let value = |model: Model, resolution: f64| Some(score.of(result.scores(model, resolution)?));
    let cell = |v: Option<f64>| or("x", v, |v| format!("{v:.3}"));
    let best = |resolution: f64| {
        let values = family.models().into_iter();
        let values = values.filter_map(|m| value(m, resolution));
        values.fold(f64::NEG_INFINITY, f64::max)
    };
    // a column per resolution, and one of the thesis' own beside it where it has the same score
    let row = |first: String, column: &dyn Fn(f64) -> (String, String)| {
        let mut row = vec![first];
        for &resolution in &result.resolutions {
            let (ours, theirs) = column(resolution);
            row.push(ours);
            row.extend((score == Score::AucKnown).then_some(theirs));
        }
        row
    };
    let mut rows = Vec::new();
    for (model, of_thesis) in family.models().into_iter().zip(family.auc) {
        rows.push(row(model.label(), &|resolution| {
            let ours = value(model, resolution);
            let is_best = ours.is_some_and(|v| v >= best(resolution));
            let mark = if is_best { "*" } else { "" };
            let theirs = thesis::column(resolution).map(|c| format!("{:.2}", of_thesis[c]));
            (format!("{mark}{}", cell(ours)), theirs.unwrap_or_default())
        }));
    }
    for model in [Model::Ideal, Model::Automatic] {
        let ours = |resolution: f64| (cell(value(model, resolution)), String::new());
        rows.push(row(model_name(model), &ours));
    }
    let (file, what, note) = score.words();
    Table {
        file: format!("table-{}-{file}-{}", family.table, family.file),
        title: format!(
            "{what}, {} (Table {}): {}",
            family.name, family.table, result.name
        ),
        note: note.to_owned(),
        header: row(format!("{}, m", family.symbol), &|resolution| {
            (mm(resolution), "thesis".to_owned())
        }),
        rows,
    }
}

/// The best values of both models, the ideal model and ours, per resolution.
pub fn best_of(result: &RecordingResult) -> Table {
    let mut rows = Vec::new();
    for &resolution in &result.resolutions {
        let candidates = [
            result.best(&THRUN, resolution, Score::AucKnown),
            result.best(&ANDERT, resolution, Score::AucKnown),
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
            let percent = |share| or("-", share, |s: f64| format!("{:.0} %", 100.0 * s));
            row.push(percent(scores.coverage_free_in_view));
            row.push(percent(scores.coverage_occupied_in_view));
            row.push(or("-", scores.occupied_ratio, |ratio| {
                format!("{ratio:.2}")
            }));
            rows.push(row);
        }
    }
    Table {
        file: "best".to_owned(),
        title: format!("The best values against each other: {}", result.name),
        note:
            "Best L and k by AUC of known cells, ties by recall (the thesis' rule). Coverage: of \
            the cells that a keyframe looks at. Thickness: predicted occupied cells per true one."
                .to_owned(),
        header: words(
            "cells | model | AUC observed | MCC | precision | recall | AUC known | free covered | \
             occupied covered | thickness",
        ),
        rows,
    }
}
