//! `report.html` of a run.

mod explore;
mod tracking;

use super::align::MapFrame;
use super::recorder::measured;
use super::summary::Summary;
use super::threads::Tracked;
use crate::colours::Colours;
use crate::explorer::{self, ShownKeyframe};
use crate::picture::keyframe::{Measured, depth_picture, uncertainty_picture};
use crate::report::Page;
use crate::report::svg::{Plot, Series, number};
use crate::surface::ColouredMesh;
use monogrid_datasets::{encode_png, encode_png_rgb};
use monogrid_image::Image;
use monogrid_occupancy::OccupancyMap;
use std::io::Write;
use tracking::{losses, ribbon, tracking_plots};

/// Keyframes shown with their pictures.
const SHOWN_KEYFRAMES: usize = 8;

/// What the report shows besides tracking itself.
#[derive(Debug)]
pub struct ReportInput<'a> {
    /// Heading.
    pub title: &'a str,
    /// One sentence for people.
    pub verdict: &'a str,
    /// Numbers.
    pub summary: &'a Summary,
    /// The frame of the results.
    pub frame: &'a MapFrame,
    /// Camera centres in the frame of the results.
    pub path: &'a [[f64; 3]],
    /// Path as it was reported frame by frame; empty to leave it out.
    pub reported_path: &'a [[f64; 3]],
    /// Reference path in the same frame; empty for none.
    pub reference: &'a [[f64; 3]],
    /// Distance of each pose of the trajectory from the reference at its time; empty without a reference.
    pub errors: &'a [Option<f64>],
    /// The global map.
    pub map: Option<&'a OccupancyMap>,
    /// The keyframes of the main map.
    pub keyframes: &'a [ShownKeyframe<'a>],
    /// What is known of their colours.
    pub colours: &'a Colours,
    /// Height above which cells hide the room.
    pub cut: Option<f64>,
    /// Surface of the map.
    pub mesh: Option<&'a ColouredMesh>,
    /// View of the map, PNG.
    pub preview: Option<&'a [u8]>,
    /// The map before and after loops were closed, PNG.
    pub loops: Option<&'a [Vec<u8>; 2]>,
    /// The effective configuration.
    pub config: &'a str,
}

/// Writes the complete page.
pub fn write_page(
    out: &mut dyn Write,
    tracked: &Tracked,
    input: &ReportInput,
) -> anyhow::Result<()> {
    let mut warnings = Page::default();
    for warning in &input.summary.warnings {
        warnings.warning(warning);
    }
    let rest = below_the_explorer(tracked, input);
    let explorer = |out: &mut dyn Write| {
        let scene = explore::scene(tracked, input)?;
        explorer::write_section(out, &scene)
    };
    warnings.write_around(out, (input.title, input.verdict), explorer, &rest)
}

fn below_the_explorer(tracked: &Tracked, input: &ReportInput) -> Page {
    let mut page = Page::default();
    page.heading("In numbers");
    page.facts(&facts(input));
    if let Some(preview) = input.preview {
        page.heading("Map");
        page.picture(
            preview,
            "occupied cells, coloured by height, with the path of the camera",
        );
        page.note("Occupied cells coloured by height, cut above the camera; black: its path.");
    }
    page.heading("Path of the camera, from above");
    page.plot(&path_plot(input));
    if let Some([before, after]) = input.loops {
        page.heading("What the loops corrected");
        page.row(&[
            (
                before.clone(),
                "before: each keyframe where it was when it was finished".into(),
            ),
            (
                after.clone(),
                "after: where the graph of keyframes has it".into(),
            ),
        ]);
    }
    page.heading("Tracking");
    page.ribbon(&ribbon(&tracked.rows));
    page.note(
        "green: good, yellow: degraded, red: lost, violet: in a fragment of the map, blue: starting, grey: no image",
    );
    let losses = losses(&tracked.rows);
    if !losses.is_empty() {
        page.table(&["frames", "what happened"], &losses);
    }
    for plot in tracking_plots(&tracked.rows) {
        page.plot(&plot);
    }
    show_keyframes(&mut page, tracked);
    page.heading("Settings");
    page.folded("all settings, as in config.toml", input.config);
    page
}

fn facts(input: &ReportInput) -> Vec<(String, String)> {
    let summary = input.summary;
    let unit = summary.unit();
    let mut facts = vec![
        (
            "Frames",
            format!("{} ({} with a pose)", summary.frames, summary.tracked),
        ),
        ("Keyframes", summary.keyframes.to_string()),
        ("Times lost", summary.lost_episodes.to_string()),
        (
            "Speed",
            format!(
                "{:.1} frames per second, everything included",
                summary.frames_per_second
            ),
        ),
        ("Scale", summary.scale.to_owned()),
        ("Frame of the results", input.frame.description.clone()),
        (
            "Map",
            format!(
                "cells of {} {unit}, {} leaves, {:.1} MB, from {} measurements",
                number(summary.map.resolution),
                summary.map.leaves,
                summary.map.bytes_in_memory as f64 / 1e6,
                summary.points
            ),
        ),
        (
            "Path",
            format!("{} {unit}", number(path_length(input.path))),
        ),
    ];
    facts.extend(error_facts(input));
    facts
        .into_iter()
        .map(|(name, value)| (name.to_owned(), value))
        .collect()
}

/// What is known from a truth.
fn error_facts(input: &ReportInput) -> Vec<(&'static str, String)> {
    let mut facts = Vec::new();
    if let Some(fit) = &input.frame.fit {
        facts.push((
            "Error against the reference",
            format!(
                "ATE {:.4} m (largest {:.4}), scale drift {:.3}, coverage {:.3}",
                fit.ate_rmse, fit.ate_max, fit.scale_drift, fit.coverage
            ),
        ));
    }
    if let Some(depth) = &input.summary.depth {
        facts.push((
            "Depth against the truth",
            format!(
                "of all pixels with texture {:.0} % within 3 %, {:.0} % within 10 %",
                100.0 * depth.shares.within_3_percent,
                100.0 * depth.shares.within_10_percent
            ),
        ));
    }
    if let Some(map) = input.summary.observed_map_error() {
        facts.push((
            "Map against the truth",
            format!(
                "observed cells: AUC {:.3}, MCC {:.3}, precision {:.3}, recall {:.3}",
                map.auc, map.mcc, map.precision, map.recall
            ),
        ));
    }
    facts
}

fn path_length(path: &[[f64; 3]]) -> f64 {
    let length = |pair: &[[f64; 3]]| {
        let squares = (0..3).map(|i| (pair[1][i] - pair[0][i]).powi(2));
        squares.sum::<f64>().sqrt()
    };
    path.windows(2).map(length).sum()
}

fn path_plot(input: &ReportInput) -> Plot {
    let from_above = |path: &[[f64; 3]]| path.iter().map(|p| [p[0], p[1]]).collect();
    let mut series = Vec::new();
    if !input.reference.is_empty() {
        series.push(Series {
            name: "reference".into(),
            colour: "#b0b0b0",
            points: from_above(input.reference),
            ..Series::default()
        });
    }
    if !input.reported_path.is_empty() {
        series.push(Series {
            name: "as reported, before corrections".into(),
            colour: "#e08a3c",
            points: from_above(input.reported_path),
            ..Series::default()
        });
    }
    series.push(Series {
        name: "estimated".into(),
        colour: "#1f6fb4",
        points: from_above(input.path),
        ..Series::default()
    });
    series.extend(mark("start", "#1f9e77", input.path.first(), input.path));
    series.extend(mark("end", "#c7372f", input.path.last(), input.path));
    let unit = input.summary.unit();
    Plot {
        title: String::new(),
        x_label: format!("x ({unit})"),
        y_label: format!("y ({unit})"),
        series,
        equal_axes: true,
        ..Plot::default()
    }
}

/// A small cross at a point of a path.
fn mark(
    name: &str,
    colour: &'static str,
    point: Option<&[f64; 3]>,
    path: &[[f64; 3]],
) -> Option<Series> {
    let [x, y, _] = *point?;
    let reach = |axis: usize| {
        let along = || path.iter().map(|p| p[axis]);
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    let arm = 0.02 * reach(0).max(reach(1));
    let gap = [f64::NAN; 2];
    Some(Series {
        name: name.into(),
        colour,
        points: vec![
            [x - arm, y - arm],
            [x + arm, y + arm],
            gap,
            [x - arm, y + arm],
            [x + arm, y - arm],
        ],
        ..Series::default()
    })
}

/// Some keyframes, evenly spread, with image, depth and uncertainty, at half their size.
fn show_keyframes(page: &mut Page, tracked: &Tracked) {
    let keyframes = tracked.run.slam.keyframes();
    let count = keyframes.len();
    if count == 0 {
        return;
    }
    page.heading("Keyframes");
    page.note(
        "Image; depth (red near, blue far); uncertainty of the depth (green certain, red 10 % or more).",
    );
    let shown = count.min(SHOWN_KEYFRAMES);
    for i in 0..shown {
        let position = if shown > 1 {
            i * (count - 1) / (shown - 1)
        } else {
            0
        };
        let Some(keyframe) = keyframes[position].load() else {
            continue;
        };
        let image = Image::from_fn(
            keyframe.image.width() / 2,
            keyframe.image.height() / 2,
            |x, y| {
                let sum: u32 = [(0, 0), (1, 0), (0, 1), (1, 1)]
                    .iter()
                    .map(|(dx, dy)| u32::from(keyframe.image.at(2 * x + dx, 2 * y + dy)))
                    .sum();
                (sum / 4) as u8
            },
        );
        let measured: Vec<Measured> = measured(&keyframe)
            .map(|m| Measured {
                x: m.x / 2,
                y: m.y / 2,
                ..m
            })
            .collect();
        let caption = format!("keyframe {}, frame {}", keyframe.id, keyframe.frame_index);
        let points = format!("{} depths", keyframe.pixels.len());
        page.triple([
            (&encode_png(&image), &caption),
            (&encode_png_rgb(&depth_picture(&image, &measured)), &points),
            (
                &encode_png_rgb(&uncertainty_picture(&image, &measured)),
                "uncertainty",
            ),
        ]);
    }
}
