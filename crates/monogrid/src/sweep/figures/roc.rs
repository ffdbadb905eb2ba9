//! ROC curves: figures 6.13, 6.14, 6.16 and 6.17.

use super::Figure;
use crate::report::svg::{COLOURS, Plot, Series};
use crate::sweep::plan::Model;
use crate::sweep::record::{PolicyScores, Scores};
use crate::sweep::result::RecordingResult;
use crate::sweep::tables::{Score, mm};
use crate::sweep::thesis::{ANDERT, Family, THRUN};

/// Which cells a ROC curve counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RocPolicy {
    /// Cells whose truth is known: probably the thesis' way.
    Known,
    /// Observed cells.
    Observed,
}

impl RocPolicy {
    fn of(self, scores: &Scores) -> &PolicyScores {
        match self {
            Self::Known => &scores.known,
            Self::Observed => &scores.observed,
        }
    }

    /// Part of the names of files.
    fn file(self) -> &'static str {
        match self {
            Self::Known => "roc",
            Self::Observed => "roc-observed",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Known => "all cells whose truth is known, unobserved ones at 0.5",
            Self::Observed => "observed cells",
        }
    }
}

fn roc_panel(title: String, curves: Vec<(String, &'static str, bool, &PolicyScores)>) -> Plot {
    let mut series = vec![Series {
        name: String::new(),
        colour: "#bbbbbb",
        points: vec![[0.0, 0.0], [1.0, 1.0]],
        is_dashed: true,
    }];
    for (name, colour, is_dashed, scores) in curves {
        // completed with the corners, as the area is
        let mut points = vec![[1.0, 1.0]];
        points.extend(&scores.roc);
        points.push([0.0, 0.0]);
        series.push(Series {
            name: format!("{name}: {:.3}", scores.auc_26),
            colour,
            points,
            is_dashed,
        });
    }
    Plot {
        title,
        x_label: "false positive rate".into(),
        y_label: "true positive rate".into(),
        series,
        ranges: Some([[0.0, 1.0], [0.0, 1.0]]),
        is_panel: true,
        ..Plot::default()
    }
}

/// Figures 6.13 and 6.14: one panel per resolution, one curve per value.
pub fn roc_over_parameter(result: &RecordingResult, family: &Family, policy: RocPolicy) -> Figure {
    let (models, number) = (family.models(), family.figure);
    let plots = result
        .resolutions
        .iter()
        .map(|&resolution| {
            let curves = models
                .iter()
                .enumerate()
                .filter_map(|(i, model)| {
                    let scores = policy.of(result.scores(*model, resolution)?);
                    Some((model.label(), COLOURS[i], false, scores))
                })
                .collect();
            roc_panel(mm(resolution), curves)
        })
        .collect();
    Figure {
        file: format!("figure-{number}-{}-{}", policy.file(), family.file),
        title: format!(
            "ROC curves, {} (Figure {number}): {}",
            family.name, result.name
        ),
        note: format!(
            "Counted: {}. The area under each curve stands beside its value.",
            policy.words()
        ),
        plots,
    }
}

/// Figure 6.16: two values of L with the same area and different curves, at the finest resolution.
pub fn roc_of_equal_area(result: &RecordingResult) -> Option<Figure> {
    let resolution = *result.resolutions.first()?;
    let curves: Vec<(Model, &PolicyScores)> = THRUN
        .models()
        .into_iter()
        .filter_map(|model| Some((model, &result.scores(model, resolution)?.known)))
        .collect();
    // the most alike in area among those that are at least three values apart
    let mut pairs: Vec<(usize, usize)> = (0..curves.len())
        .flat_map(|i| (i + 3..curves.len()).map(move |j| (i, j)))
        .collect();
    let gap = |&(i, j): &(usize, usize)| (curves[i].1.auc_26 - curves[j].1.auc_26).abs();
    pairs.sort_by(|a, b| gap(a).total_cmp(&gap(b)));
    let &(i, j) = pairs.first()?;
    let curve = |index: usize, colour| {
        let (model, scores) = curves[index];
        (model.label(), colour, false, scores)
    };
    Some(Figure {
        file: "figure-6.16-roc-equal-area".to_owned(),
        title: format!(
            "Two values of L with nearly the same area (Figure 6.16): {}",
            result.name
        ),
        note: "The thesis: L = 0.3 and 1.0 at 8 mm, both 0.85. The area alone does not choose \
               between them."
            .to_owned(),
        plots: vec![roc_panel(
            mm(resolution),
            vec![curve(i, "#1f9e77"), curve(j, "#c7372f")],
        )],
    })
}

/// Figure 6.17: the best of both models against each other, with the ideal model and ours.
pub fn roc_of_best(result: &RecordingResult, policy: RocPolicy) -> Figure {
    let score: fn(&Scores) -> f64 = match policy {
        RocPolicy::Known => |scores| Score::AucKnown.of(scores),
        RocPolicy::Observed => |scores| Score::AucObserved.of(scores),
    };
    let plots = result
        .resolutions
        .iter()
        .map(|&resolution| {
            let named = [
                (
                    "Thrun",
                    "#2a6fbb",
                    result.best(&THRUN.models(), resolution, score),
                ),
                (
                    "Andert",
                    "#c7372f",
                    result.best(&ANDERT.models(), resolution, score),
                ),
                ("", "#888888", Some(Model::Ideal)),
                ("", "#1f9e77", Some(Model::Automatic)),
            ];
            let curves = named
                .into_iter()
                .filter_map(|(name, colour, model)| {
                    let model = model?;
                    let scores = policy.of(result.scores(model, resolution)?);
                    let label = format!("{name} {}", model.label());
                    Some((label.trim().to_owned(), colour, false, scores))
                })
                .collect();
            roc_panel(mm(resolution), curves)
        })
        .collect();
    Figure {
        file: format!("figure-6.17-{}-best", policy.file()),
        title: format!("The best of each model (Figure 6.17): {}", result.name),
        note: format!("Counted: {}.", policy.words()),
        plots,
    }
}
