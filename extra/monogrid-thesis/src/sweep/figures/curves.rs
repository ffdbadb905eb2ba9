//! Distributions of probabilities, growth of memory, scores over parameters.

use super::Figure;
use crate::sweep::plan::{Model, usual_models};
use crate::sweep::record::{Growth, MapRecord};
use crate::sweep::result::RecordingResult;
use crate::sweep::tables::{Score, mm};
use crate::sweep::thesis::{self, Family};
use monogrid_report::svg::{Plot, Series};

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
    let labels = ["probability of occupancy", "log10 of the share of cells"];
    let series = vec![Series::new("", "#2a6fbb", distribution(records)?)];
    Some(Plot {
        ranges: Some([[0.0, 1.0], [-7.0, 0.0]]),
        is_panel: true,
        ..Plot::new(title, labels, series)
    })
}

/// Figures 6.8 (all resolutions) and 6.15 (the finest).
pub fn distributions(result: &RecordingResult) -> Vec<Figure> {
    let is_of = |record: &MapRecord, resolution: Option<f64>| {
        resolution.is_none_or(|wanted| (record.entry.resolution - wanted).abs() < 1e-9)
    };
    let families = [
        ("thrun", "Thrun"),
        ("andert", "Andert"),
        ("automatic", "ours, automatic"),
    ];
    let figure = |file: &str, title: String, resolution: Option<f64>| {
        let panels = families.into_iter().filter_map(|(family, title)| {
            let of_family = |r: &&MapRecord| r.entry.model.family() == family;
            let records = result.records.iter().filter(of_family);
            let records: Vec<_> = records.filter(|r| is_of(r, resolution)).collect();
            distribution_panel(title, &records)
        });
        Figure {
            file: file.to_owned(),
            title: format!("{title}: {}", result.name),
            note: "Cells whose truth is inside the box; unobserved ones count at 0.5, as in the \
                thesis. Thrun has peaks at both limits (0.12 and 0.97) and at 0.5, Andert one more \
                at its free value 0.3."
                .to_owned(),
            plots: panels.collect(),
        }
    };
    let mean = "Distribution of probabilities, mean of all maps (Figure 6.8)".to_owned();
    let mut figures = vec![figure("figure-6.8-distribution", mean, None)];
    if let Some(&finest) = result.resolutions.first() {
        let title = format!("Distribution at {} (Figure 6.15)", mm(finest));
        let file = "figure-6.15-distribution-finest";
        figures.push(figure(file, title, Some(finest)));
    }
    figures.retain(|figure| !figure.plots.is_empty());
    figures
}

/// Memory while the map grows (thesis 6.1.3): one panel per resolution.
pub fn growth(result: &RecordingResult) -> Figure {
    const MODEL_COLOURS: [&str; 5] = ["#888888", "#e08a1e", "#2a6fbb", "#c7372f", "#1f9e77"];
    let curves = |model: Model, resolution: f64, colour| {
        let built = result.record(model, resolution)?.built()?;
        let points = |bytes: fn(&Growth) -> Option<usize>| {
            let point = |g: &Growth| Some([g.keyframes as f64, bytes(g)? as f64 / 1e6]);
            built.growth.iter().filter_map(point).collect()
        };
        let parameter = model.parameter().map_or(String::new(), |p| p.to_string());
        let name = format!("{} {parameter}", model.family());
        Some([
            Series::new(name, colour, points(|g| Some(g.bytes))),
            Series::new("", colour, points(|g| g.bytes_likelihood)).dashed(),
        ])
    };
    let plot = |&resolution: &f64| {
        let models = usual_models().into_iter().zip(MODEL_COLOURS);
        let series = models.filter_map(|(model, colour)| curves(model, resolution, colour));
        Plot {
            from_zero: true,
            is_panel: true,
            ..Plot::new(
                mm(resolution),
                ["keyframes", "MB"],
                series.flatten().collect(),
            )
        }
    };
    Figure {
        file: "figure-memory-growth".to_owned(),
        title: format!(
            "Memory per keyframe as the map grows (thesis 6.1.3): {}",
            result.name
        ),
        note: "Solid: with probabilities; dashed: in maximum-likelihood form.".to_owned(),
        plots: result.resolutions.iter().map(plot).collect(),
    }
}

/// The scores over L or k, with the thesis' AUC dashed: the shape of Tables 6.8 and 6.9.
pub fn score_over_parameter(result: &RecordingResult, family: &Family) -> Figure {
    let curve = |resolution: f64, name: &str, colour, score: Score| {
        let values = family.models().into_iter().zip(family.values);
        let points = values.filter_map(|(model, value)| {
            Some([value, score.of(result.scores(model, resolution)?)])
        });
        Series::new(name, colour, points.collect())
    };
    let of_thesis = |column: usize| {
        let rows = family.values.into_iter().zip(family.auc);
        let points = rows.map(|(value, row)| [value, row[column]]);
        Series::new("thesis: AUC", "#888888", points.collect()).dashed()
    };
    let plot = |&resolution: &f64| {
        let mut series = vec![
            curve(resolution, "AUC known", "#2a6fbb", Score::AucKnown),
            curve(resolution, "AUC observed", "#1f9e77", Score::AucObserved),
            curve(resolution, "MCC observed", "#c7372f", Score::MccObserved),
        ];
        series.extend(thesis::column(resolution).map(of_thesis));
        let length = format!("{}, m", family.symbol);
        Plot {
            ranges: Some([[0.0, family.values[9]], [0.0, 1.0]]),
            is_panel: true,
            ..Plot::new(mm(resolution), [&length, "score"], series)
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
