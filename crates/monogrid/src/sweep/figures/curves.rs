//! Distributions of probabilities, growth of memory, scores over parameters.

use super::Figure;
use crate::report::svg::{Plot, Series};
use crate::sweep::plan::usual_models;
use crate::sweep::record::{Growth, MapRecord};
use crate::sweep::result::RecordingResult;
use crate::sweep::tables::{Score, mm};
use crate::sweep::thesis::{self, Family};

/// Share of cells per bin of probability, as log10, with unobserved cells at 0.5 as in the thesis.
fn distribution(records: &[&MapRecord]) -> Option<Vec<[f64; 2]>> {
    let mut shares: Vec<f64> = Vec::new();
    let mut count = 0;
    for scores in records.iter().filter_map(|record| record.scores()) {
        let mut bins = scores.histogram.clone();
        if let Some(middle) = bins.get_mut(50) {
            *middle += scores.unobserved;
        }
        let total: u64 = bins.iter().sum();
        shares.resize(bins.len(), 0.0);
        for (share, cells) in shares.iter_mut().zip(&bins) {
            *share += *cells as f64 / total.max(1) as f64;
        }
        count += 1;
    }
    if count == 0 {
        return None;
    }
    // steps: both ends of each bin
    let width = 1.0 / shares.len() as f64;
    let points = shares.iter().enumerate().flat_map(|(i, share)| {
        let height = (share / f64::from(count)).max(1e-7).log10();
        [[i as f64 * width, height], [(i + 1) as f64 * width, height]]
    });
    Some(points.collect())
}

fn distribution_panel(title: &str, records: &[&MapRecord]) -> Option<Plot> {
    Some(Plot {
        title: title.to_owned(),
        x_label: "probability of occupancy".into(),
        y_label: "log10 of the share of cells".into(),
        series: vec![Series {
            name: String::new(),
            colour: "#2a6fbb",
            points: distribution(records)?,
            ..Series::default()
        }],
        ranges: Some([[0.0, 1.0], [-7.0, 0.0]]),
        is_panel: true,
        ..Plot::default()
    })
}

/// Figures 6.8 (all resolutions) and 6.15 (the finest).
pub fn distributions(result: &RecordingResult) -> Vec<Figure> {
    let select = |family: &'static str, resolution: Option<f64>| -> Vec<&MapRecord> {
        result
            .records
            .iter()
            .filter(|r| r.entry.model.family() == family)
            .filter(|r| resolution.is_none_or(|wanted| (r.entry.resolution - wanted).abs() < 1e-9))
            .collect()
    };
    let families = [
        ("thrun", "Thrun"),
        ("andert", "Andert"),
        ("automatic", "ours, automatic"),
    ];
    let panels = |resolution: Option<f64>| {
        families
            .into_iter()
            .filter_map(|(family, title)| distribution_panel(title, &select(family, resolution)))
            .collect::<Vec<_>>()
    };
    let note = "Cells whose truth is inside the box; unobserved ones count at 0.5, as in the thesis. \
                Thrun has peaks at both limits (0.12 and 0.97) and at 0.5, Andert one more at its \
                free value 0.3.";
    let mut figures = vec![Figure {
        file: "figure-6.8-distribution".to_owned(),
        title: format!(
            "Distribution of probabilities, mean of all maps (Figure 6.8): {}",
            result.name
        ),
        note: note.to_owned(),
        plots: panels(None),
    }];
    if let Some(&finest) = result.resolutions.first() {
        figures.push(Figure {
            file: "figure-6.15-distribution-finest".to_owned(),
            title: format!(
                "Distribution at {} (Figure 6.15): {}",
                mm(finest),
                result.name
            ),
            note: note.to_owned(),
            plots: panels(Some(finest)),
        });
    }
    figures.retain(|figure| !figure.plots.is_empty());
    figures
}

/// Memory while the map grows (thesis 6.1.3): one panel per resolution.
pub fn growth(result: &RecordingResult) -> Figure {
    const MODEL_COLOURS: [&str; 5] = ["#888888", "#e08a1e", "#2a6fbb", "#c7372f", "#1f9e77"];
    let plots = result
        .resolutions
        .iter()
        .map(|&resolution| {
            let mut series = Vec::new();
            for (model, colour) in usual_models().into_iter().zip(MODEL_COLOURS) {
                let Some(built) = result.record(model, resolution).and_then(MapRecord::built)
                else {
                    continue;
                };
                let points = |bytes: &dyn Fn(&Growth) -> Option<usize>| {
                    built
                        .growth
                        .iter()
                        .filter_map(|g| Some([g.keyframes as f64, bytes(g)? as f64 / 1e6]))
                        .collect::<Vec<_>>()
                };
                series.push(Series {
                    name: format!(
                        "{} {}",
                        model.family(),
                        model.parameter().map_or(String::new(), |p| p.to_string())
                    ),
                    colour,
                    points: points(&|g| Some(g.bytes)),
                    is_dashed: false,
                });
                series.push(Series {
                    name: String::new(),
                    colour,
                    points: points(&|g| g.bytes_likelihood),
                    is_dashed: true,
                });
            }
            Plot {
                title: mm(resolution),
                x_label: "keyframes".into(),
                y_label: "MB".into(),
                series,
                from_zero: true,
                is_panel: true,
                ..Plot::default()
            }
        })
        .collect();
    Figure {
        file: "figure-memory-growth".to_owned(),
        title: format!(
            "Memory per keyframe as the map grows (thesis 6.1.3): {}",
            result.name
        ),
        note: "Solid: with probabilities; dashed: in maximum-likelihood form.".to_owned(),
        plots,
    }
}

/// The scores over L or k, with the thesis' AUC dashed: the shape of Tables 6.8 and 6.9.
pub fn score_over_parameter(result: &RecordingResult, family: &Family) -> Figure {
    let curve = |resolution: f64, name: &str, colour, score: Score| Series {
        name: name.to_owned(),
        colour,
        points: family
            .models()
            .into_iter()
            .zip(family.values)
            .filter_map(|(m, value)| Some([value, score.of(result.scores(m, resolution)?)]))
            .collect(),
        is_dashed: false,
    };
    let of_thesis = |column: usize| Series {
        name: "thesis: AUC".into(),
        colour: "#888888",
        points: family
            .values
            .iter()
            .zip(family.auc)
            .map(|(value, row)| [*value, row[column]])
            .collect(),
        is_dashed: true,
    };
    let plot = |&resolution: &f64| {
        let mut series = vec![
            curve(resolution, "AUC known", "#2a6fbb", Score::AucKnown),
            curve(resolution, "AUC observed", "#1f9e77", Score::AucObserved),
            curve(resolution, "MCC observed", "#c7372f", Score::MccObserved),
        ];
        series.extend(thesis::column(resolution).map(of_thesis));
        Plot {
            title: mm(resolution),
            x_label: format!("{}, m", family.symbol),
            y_label: "score".into(),
            series,
            ranges: Some([[0.0, family.values[9]], [0.0, 1.0]]),
            is_panel: true,
            ..Plot::default()
        }
    };
    Figure {
        file: format!("figure-table-{}", family.table),
        title: format!(
            "Scores over {} (Table {}): {}",
            family.symbol, family.table, result.name
        ),
        note: "Dashed: the thesis, another room and another SLAM.".to_owned(),
        plots: result.resolutions.iter().map(plot).collect(),
    }
}
