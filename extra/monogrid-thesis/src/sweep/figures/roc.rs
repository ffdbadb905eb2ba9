//! ROC curves: figures 6.13, 6.14, 6.16 and 6.17.

use super::Figure;
use crate::sweep::plan::Model;
use crate::sweep::record::{PolicyScores, Scores};
use crate::sweep::result::RecordingResult;
use crate::sweep::tables::{Score, mm};
use crate::sweep::thesis::{ANDERT, Family, THRUN};
use monogrid_report::svg::{COLOURS, Plot, Series};

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

/// Curves are given by name, colour, and scores.
fn roc_panel<'a>(
    resolution: f64,
    curves: impl IntoIterator<Item = (String, &'static str, &'a PolicyScores)>,
) -> Plot {
    let chance = vec![[0.0, 0.0], [1.0, 1.0]];
    let mut series = vec![Series::new("", "#bbbbbb", chance).dashed()];
    for (name, colour, scores) in curves {
        // completed with the corners, as the area is
        let points = [&[[1.0, 1.0]], scores.roc.as_slice(), &[[0.0, 0.0]]].concat();
        let name = format!("{name}: {:.3}", scores.auc_26);
        series.push(Series::new(name, colour, points));
    }
    let labels = ["false positive rate", "true positive rate"];
    Plot {
        ranges: Some([[0.0, 1.0], [0.0, 1.0]]),
        is_panel: true,
        ..Plot::new(mm(resolution), labels, series)
    }
}

/// Figures 6.13 and 6.14: one panel per resolution, one curve per value.
pub fn roc_over_parameter(result: &RecordingResult, family: &Family, policy: RocPolicy) -> Figure {
    let number = family.figure;
    let plot = |&resolution: &f64| {
        let models = family.models().into_iter().zip(COLOURS);
        let curves = models.filter_map(|(model, colour)| {
            let scores = policy.of(result.scores(model, resolution)?);
            Some((model.label(), colour, scores))
        });
        roc_panel(resolution, curves)
    };
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
        plots: result.resolutions.iter().map(plot).collect(),
    }
}

/// Figure 6.16: two values of L with the same area and different curves, at the finest resolution.
pub fn roc_of_equal_area(result: &RecordingResult) -> Option<Figure> {
    let resolution = *result.resolutions.first()?;
    let known = |model| Some((model, &result.scores(model, resolution)?.known));
    let models = THRUN.models().into_iter();
    let curves: Vec<(Model, &PolicyScores)> = models.filter_map(known).collect();
    // the most alike in area among those that are at least three values apart
    let count = curves.len();
    let pairs = (0..count).flat_map(|i| (i + 3..count).map(move |j| (i, j)));
    let gap = |&(i, j): &(usize, usize)| (curves[i].1.auc_26 - curves[j].1.auc_26).abs();
    let (i, j) = pairs.min_by(|a, b| gap(a).total_cmp(&gap(b)))?;
    let curve = |index: usize, colour| {
        let (model, scores) = curves[index];
        (model.label(), colour, scores)
    };
    let alike = [curve(i, "#1f9e77"), curve(j, "#c7372f")];
    Some(Figure {
        file: "figure-6.16-roc-equal-area".to_owned(),
        title: format!(
            "Two values of L with nearly the same area (Figure 6.16): {}",
            result.name
        ),
        note: "The thesis: L = 0.3 and 1.0 at 8 mm, both 0.85. The area alone does not choose \
               between them."
            .to_owned(),
        plots: vec![roc_panel(resolution, alike)],
    })
}

/// Figure 6.17: the best of both models against each other, with the ideal model and ours.
pub fn roc_of_best(result: &RecordingResult, policy: RocPolicy) -> Figure {
    let score = match policy {
        RocPolicy::Known => Score::AucKnown,
        RocPolicy::Observed => Score::AucObserved,
    };
    let plot = |&resolution: &f64| {
        let best = |family| result.best(family, resolution, score);
        let named = [
            ("Thrun", "#2a6fbb", best(&THRUN)),
            ("Andert", "#c7372f", best(&ANDERT)),
            ("", "#888888", Some(Model::Ideal)),
            ("", "#1f9e77", Some(Model::Automatic)),
        ];
        let curves = named.into_iter().filter_map(|(name, colour, model)| {
            let scores = policy.of(result.scores(model?, resolution)?);
            let label = format!("{name} {}", model?.label());
            Some((label.trim().to_owned(), colour, scores))
        });
        roc_panel(resolution, curves)
    };
    Figure {
        file: format!("figure-6.17-{}-best", policy.file()),
        title: format!("The best of each model (Figure 6.17): {}", result.name),
        note: format!("Counted: {}.", policy.words()),
        plots: result.resolutions.iter().map(plot).collect(),
    }
}
