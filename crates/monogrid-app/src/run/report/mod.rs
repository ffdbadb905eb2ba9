//! `report.html` of a run.

mod explore;
mod tracking;

use crate::run::align::MapFrame;
use crate::run::outputs::{MapPictures, Paths};
use crate::run::summary::Summary;
use crate::run::tracking::recorder::measured;
use crate::run::tracking::tracked::Tracked;
use monogrid_report::Page;
use monogrid_report::colours::Colours;
use monogrid_report::explorer::{self, ShownKeyframe};
use monogrid_report::picture::keyframe::{Measured, depth_picture, uncertainty_picture};
use monogrid_report::surface::CellColours;
use monogrid_report::svg::{Plot, Series, number};

use monogrid_datasets::{encode_jpeg, encode_jpeg_rgb};
use monogrid_image::Image;
use monogrid_occupancy::OccupancyMap;
use monogrid_slam::Keyframe;
use rayon::prelude::*;
use std::io::Write;
use tracking::{losses, ribbon, tracking_plots};

/// Keyframes shown with their pictures.
const SHOWN_KEYFRAMES: usize = 8;
/// Quality of their pictures as JPEG.
const QUALITY: u8 = 85;

/// What the report shows besides tracking itself.
#[derive(Debug)]
pub struct ReportInput<'a> {
    /// Heading.
    pub title: &'a str,
    /// How far to trust the map, and how the run went, in sentences for people.
    pub lead: &'a str,
    /// Numbers.
    pub summary: &'a Summary,
    /// The frame of the results.
    pub frame: &'a MapFrame,
    /// Camera centres.
    pub paths: Paths,
    /// Where it really was.
    pub reference: Reference,
    /// The global map.
    pub map: Option<&'a OccupancyMap>,
    /// The keyframes of the main map.
    pub keyframes: &'a [ShownKeyframe<'a>],
    /// What is known of their colours.
    pub colours: &'a Colours,
    /// Colours of the cells.
    pub cell_colours: &'a CellColours,
    /// Pictures of the maps.
    pub pictures: Option<MapPictures>,
    /// The effective configuration.
    pub config: &'a str,
}

/// Where the camera really was, in the frame of the results; empty where that is not known.
#[derive(Debug, Default)]
pub struct Reference {
    /// Its path.
    pub path: Vec<[f64; 3]>,
    /// Distance of each pose of the trajectory from it at its time.
    pub errors: Vec<Option<f64>>,
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
    // without keyframes there is nothing to look at
    let scene = match input.keyframes {
        [] => None,
        _ => Some(explore::scene(tracked, input)?),
    };
    let explorer = |out: &mut dyn Write| match &scene {
        Some(scene) => explorer::write_section(out, scene),
        None => Ok(()),
    };
    warnings.write_around(out, (input.title, input.lead), explorer, &rest)?;
    Ok(())
}

fn below_the_explorer(tracked: &Tracked, input: &ReportInput) -> Page {
    let mut page = Page::default();
    let losses = losses(&tracked.rows);
    if input.keyframes.is_empty() || !losses.is_empty() {
        show_failure(&mut page, tracked, &losses);
    }
    page.heading("In numbers");
    page.facts(&facts(input));
    if let Some(pictures) = &input.pictures {
        page.heading("Map");
        let shown = "the surface as it was filmed, with the path of the camera";
        page.picture(&pictures.preview, shown);
        page.note("The surface from the side that was filmed; black: the path of the camera.");
    }
    if input.paths.path.len() > 1 {
        page.heading("Path of the camera, from above");
        page.plot(&path_plot(input));
    }
    let pictures = input.pictures.as_ref();
    if let Some(loops) = pictures.and_then(|pictures| pictures.loops.clone()) {
        page.heading("What the loops corrected");
        let [before, after] = loops;
        let was = "before: each keyframe where it was when it was finished";
        let is = "after: where the graph of keyframes has it";
        page.row(&[(before, was.into()), (after, is.into())]);
    }
    if !tracked.rows.is_empty() {
        page.heading("Tracking");
        page.ribbon(&ribbon(&tracked.rows));
        page.note(
            "green: good, yellow: degraded, red: lost, violet: in a fragment of the map, blue: \
             starting, grey: no image",
        );
    }
    if !input.keyframes.is_empty() {
        for plot in tracking_plots(&tracked.rows) {
            page.plot(&plot);
        }
    }
    show_keyframes(&mut page, tracked);
    page.heading("Settings");
    page.folded("all settings, as in config.toml", input.config);
    page
}

/// Where the documents say what to do.
const TROUBLE: &str = concat!(
    env!("CARGO_PKG_REPOSITORY"),
    "/blob/main/docs/book/troubleshooting.md"
);

/// Where it went wrong, what the camera saw there, and what to film instead.
fn show_failure(page: &mut Page, tracked: &Tracked, losses: &[Vec<String>]) {
    page.heading("Where it went wrong");
    if !losses.is_empty() {
        page.table(&["frames", "what happened"], losses);
    }
    let caption = |index: usize| {
        let row = tracked.rows.iter().find(|row| row.index == index);
        let reason = row.and_then(|row| row.report()?.reason);
        let reason = reason.map(|reason| format!(": {reason}"));
        format!("frame {index}{}", reason.unwrap_or_default())
    };
    // the first one shows how a run began that has no keyframe
    let begun = usize::from(!losses.is_empty() && tracked.run.slam.num_keyframes() > 0);
    let moments = tracked.moments.iter().skip(begun);
    let pictures = moments.map(|(index, jpeg)| (jpeg.clone(), caption(*index)));
    page.row(&pictures.collect::<Vec<_>>());
    page.html(&format!(
        "<p>Film again: move sideways while filming, turn slowly, in good light, with something \
         that has texture in view all the time, and come back to what was seen before. <a \
         href=\"{TROUBLE}\">When something is wrong</a> says more.</p>"
    ));
}

fn facts(input: &ReportInput) -> Vec<(String, String)> {
    let summary = input.summary;
    let unit = summary.unit();
    let rate = summary.frames_per_second;
    let speed = format!("{rate:.1} frames per second, everything included");
    let length = number(path_length(&input.paths.path));
    let map = format!(
        "cells of {} {unit}, {} leaves, {:.1} MB, from {} measurements",
        number(summary.map.resolution),
        summary.map.leaves,
        summary.map.bytes_in_memory as f64 / 1e6,
        summary.points
    );
    let facts = [
        (
            "Frames",
            format!("{} ({} with a pose)", summary.frames, summary.tracked),
        ),
        ("Keyframes", summary.keyframes.to_string()),
        ("Times lost", summary.lost_episodes.to_string()),
        ("Speed", speed),
        ("Scale", scale(summary)),
        ("Frame of the results", input.frame.description.clone()),
        ("Map", map),
        ("Path", format!("{length} {unit}")),
    ];
    // what there is nothing of is not described
    let described = match input.keyframes {
        [] => 4,
        _ => facts.len(),
    };
    let facts = facts.into_iter().take(described);
    let facts = facts.chain(error_facts(input));
    facts
        .map(|(name, value)| (name.to_owned(), value))
        .collect()
}

/// What the unit of length is, and who says so.
fn scale(summary: &Summary) -> String {
    let (measured, all) = (summary.measured_keyframes, summary.keyframes);
    match measured {
        0 => summary.scale.to_owned(),
        _ => format!(
            "{}: the depth of {measured} of {all} keyframes was measured",
            summary.scale
        ),
    }
}

/// What is known from a truth.
fn error_facts(input: &ReportInput) -> impl Iterator<Item = (&'static str, String)> {
    let fit = input.frame.fit.as_ref().map(|fit| {
        let text = format!(
            "ATE {:.4} m (largest {:.4}), scale drift {:.3}, coverage {:.3}",
            fit.ate_rmse, fit.ate_max, fit.scale_drift, fit.coverage
        );
        ("Error against the reference", text)
    });
    let depth = input.summary.depth.as_ref().map(|depth| {
        let text = format!(
            "of all pixels with texture {:.0} % within 3 %, {:.0} % within 10 %",
            100.0 * depth.shares.within_3_percent,
            100.0 * depth.shares.within_10_percent
        );
        ("Depth against the truth", text)
    });
    let map = input.summary.observed_map_error().map(|map| {
        let text = format!(
            "observed cells: AUC {:.3}, MCC {:.3}, precision {:.3}, recall {:.3}",
            map.auc, map.mcc, map.precision, map.recall
        );
        ("Map against the truth", text)
    });
    fit.into_iter().chain(depth).chain(map)
}

fn path_length(path: &[[f64; 3]]) -> f64 {
    let length = |pair: &[[f64; 3]]| {
        let squares = (0..3).map(|i| (pair[1][i] - pair[0][i]).powi(2));
        squares.sum::<f64>().sqrt()
    };
    path.windows(2).map(length).sum()
}

fn path_plot(input: &ReportInput) -> Plot {
    let path = &input.paths.path;
    let from_above = |name: &str, colour, path: &[[f64; 3]]| {
        Series::new(name, colour, path.iter().map(|p| [p[0], p[1]]).collect())
    };
    let reported = input.paths.reported.as_deref().unwrap_or_default();
    let lines = [
        from_above("reference", "#b0b0b0", &input.reference.path),
        from_above("as reported, before corrections", "#e08a3c", reported),
    ];
    let known = lines.into_iter().filter(|line| !line.points.is_empty());
    let mut series: Vec<Series> = known.collect();
    series.push(from_above("estimated", "#1f6fb4", path));
    series.extend(mark("start", "#1f9e77", path.first(), path));
    series.extend(mark("end", "#c7372f", path.last(), path));
    let [x, y] = ["x", "y"].map(|axis| format!("{axis} ({})", input.summary.unit()));
    Plot {
        equal_axes: true,
        ..Plot::new("", [&x, &y], series)
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
    let points = vec![
        [x - arm, y - arm],
        [x + arm, y + arm],
        gap,
        [x - arm, y + arm],
        [x + arm, y - arm],
    ];
    Some(Series::new(name, colour, points))
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
        "Image; depth (red near, blue far); uncertainty of the depth (green certain, red 10 % or \
         more).",
    );
    let shown = count.min(SHOWN_KEYFRAMES);
    let positions = (0..shown).map(|i| i * (count - 1) / (shown - 1).max(1));
    let keyframes: Vec<_> = positions.map(|i| &keyframes[i]).collect();
    let pictures = keyframes.par_iter();
    let pictures = pictures.filter_map(|keyframe| Some(KeyframePictures::new(&keyframe.load()?)));
    let pictures: Vec<KeyframePictures> = pictures.collect();
    for shown in &pictures {
        page.triple([
            (&shown.image, &shown.caption),
            (&shown.depth, &shown.points),
            (&shown.uncertainty, "uncertainty"),
        ]);
    }
}

/// A keyframe at half its size, as JPEG files.
struct KeyframePictures {
    caption: String,
    image: Vec<u8>,
    points: String,
    depth: Vec<u8>,
    uncertainty: Vec<u8>,
}

impl KeyframePictures {
    fn new(keyframe: &Keyframe) -> Self {
        let (width, height) = (keyframe.image.width() / 2, keyframe.image.height() / 2);
        let image = Image::from_fn(width, height, |x, y| {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
            let grey = |(dx, dy)| u32::from(keyframe.image.at(2 * x + dx, 2 * y + dy));
            (four.into_iter().map(grey).sum::<u32>() / 4) as u8
        });
        let measured: Vec<Measured> = measured(keyframe)
            .map(|m| Measured {
                x: m.x / 2,
                y: m.y / 2,
                ..m
            })
            .collect();
        Self {
            caption: format!("keyframe {}, frame {}", keyframe.id, keyframe.frame_index),
            points: format!("{} depths", keyframe.pixels.len()),
            depth: encode_jpeg_rgb(&depth_picture(&image, &measured), QUALITY),
            uncertainty: encode_jpeg_rgb(&uncertainty_picture(&image, &measured), QUALITY),
            image: encode_jpeg(&image, QUALITY),
        }
    }
}
