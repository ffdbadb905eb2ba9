//! `monogrid evaluate map` and `monogrid evaluate paths`: a map against the true one.

use crate::commands::maps::tools::similarity;
use crate::commands::use_threads;
use anyhow::Context as _;
use clap::Args;
use monogrid_app::args::{JsonArg, MappingArgs, Profile, positive};
use monogrid_app::config::RunConfig;
use monogrid_app::mapfile;
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::recorded::Recorded;
use monogrid_app::run::align::{Align, Up};
use monogrid_app::run::sessions::Source;
use monogrid_app::truth_map::{in_view, load_truth, name_of};
use monogrid_datasets::read_sim3;
use monogrid_evaluation::{
    MapEvaluationConfig, MapReport, PathConfig, PathStats, PathsReport, PolicyReport,
    SurfaceAlignment, TruthGrid, align_to_surfaces, evaluate_map, evaluate_paths,
};
use monogrid_geometry::{Vec2, Vec3};
use monogrid_mapping::KeyframeScan;
use monogrid_occupancy::OccupancyMap;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `monogrid evaluate map`.
#[derive(Debug, Args)]
pub struct EvaluateMapArgs {
    /// Estimated map (.ot; a .bt has no probabilities to rank), or a recording (.mgk), submaps
    /// (submaps.json) or a run to map
    pub estimate: PathBuf,
    /// True map (.ot or .bt); its cells as large as the estimate's, or a whole number of times
    /// smaller
    pub truth: PathBuf,
    /// Surfaces this close agree [default: 0.05 or the edge of a cell, whichever is larger]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub tolerance: Option<f64>,
    /// Recording that a map was made from: its keyframes tell which cells could be seen at all
    #[arg(long, value_name = "FILE.mgk")]
    pub recording: Option<PathBuf>,
    /// Bring the poses of the recording to the frame of a reference, as when the map was made
    #[arg(long, value_name = "gt:FILE|sim3:FILE")]
    pub align: Option<String>,
    /// Then bring the points of the recording onto the surfaces of the true map, by a similarity
    /// that begins at the poses: references can be off by more than a cell
    #[arg(long)]
    pub align_points: bool,
    /// Cells farther from every keyframe do not count as seen
    #[arg(long, value_name = "L", value_parser = positive, default_value_t = 10.0)]
    pub view_range: f64,
    /// Turn and scale the finished map by a Sim(3) file before it is compared, as the thesis did;
    /// a map built with --align is better
    #[arg(long, value_name = "FILE")]
    pub move_map: Option<PathBuf>,
    /// Settings of the maps of a recording
    #[command(flatten)]
    pub mapping: MappingArgs,
    /// Change one setting of the map of a recording, e.g. --set mapping.quality=fast
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid evaluate paths`.
#[derive(Debug, Args)]
pub struct EvaluatePathsArgs {
    /// Estimated map (.ot or .bt)
    pub estimate: PathBuf,
    /// True map (.ot or .bt); its cells as large as the estimate's, or a whole number of times
    /// smaller
    pub truth: PathBuf,
    /// Radius of the ball that the robot fills
    #[arg(long, value_name = "L", value_parser = positive, default_value_t = 0.15)]
    pub robot_radius: f64,
    /// Pairs of start and goal
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub pairs: usize,
    /// Start and goal are at least this far apart
    #[arg(long, value_name = "L", value_parser = positive, default_value_t = 1.0)]
    pub min_distance: f64,
    /// Edge of the cells to plan on, rounded to whole cells of the map
    #[arg(long, value_name = "L", value_parser = positive, default_value_t = 0.064)]
    pub planning_cell: f64,
    /// Seed of the pairs
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Share of the free space of the truth of which a map of the same place knows something.
const LEAST_OVERLAP: f64 = 0.1;

/// Compares an estimated map with the true one, cell by cell.
pub fn map(args: &EvaluateMapArgs) -> CommandResult {
    let is_recording = Source::is_at(&args.estimate);
    let source = is_recording.then_some(&args.estimate);
    let mut recorded = match source.or(args.recording.as_ref()) {
        Some(path) => {
            let align = Align::parse(args.align.as_deref(), Up::default())?;
            Some(Recorded::read(path, &align)?)
        }
        None if args.align.is_some() => {
            return Err(Failure::input(
                "--align brings the poses of a recording to a frame: give the recording instead of \
                 the map, or with --recording; a finished map can be moved with --move-map",
            ));
        }
        None => None,
    };
    let (estimate, alignment) = match &mut recorded {
        Some(recorded) if is_recording => mapped(recorded, args)?,
        _ if args.align_points => {
            return Err(Failure::input(
                "--align-points moves the points of a recording before they are mapped: give the \
                 recording instead of the map",
            ));
        }
        _ => (mapfile::load(&args.estimate)?.0, None),
    };
    let truth = load_truth(&args.truth)?;
    let estimate = match &args.move_map {
        Some(file) => rotated_and_scaled(&estimate, &truth, file)?,
        None => estimate,
    };
    let truth = fitted(&estimate, truth, &args.truth)?;
    let recorded = recorded.as_ref();
    let in_view = recorded.map(|recorded| in_view(&truth, recorded, args.view_range));
    let in_view = in_view.transpose()?;
    let config = MapEvaluationConfig {
        tolerance_m: args.tolerance,
        in_view: in_view.as_ref(),
        ..MapEvaluationConfig::default()
    };
    let report = evaluate_map(&estimate, &truth, &config).bad_input()?;
    let evaluated = Evaluated { report, alignment };
    args.json.print(&evaluated, || {
        evaluated.alignment.iter().for_each(print_alignment);
        print_map(&evaluated.report);
    })
}

/// `evaluate map --json`.
#[derive(Debug, Serialize)]
struct Evaluated {
    #[serde(flatten)]
    report: MapReport,
    #[serde(rename = "aligned_to_surfaces")]
    #[serde(skip_serializing_if = "Option::is_none")]
    alignment: Option<SurfaceAlignment>,
}

/// The map of a recording by its own settings and the options, and how its points were brought onto
/// the surfaces of the truth, where that is asked for: the recording is in that frame then.
fn mapped(
    recorded: &mut Recorded,
    args: &EvaluateMapArgs,
) -> Result<(OccupancyMap, Option<SurfaceAlignment>), Failure> {
    let mut config = recorded
        .config
        .clone()
        .unwrap_or_else(|| RunConfig::of(Profile::Default));
    config.apply(&args.mapping);
    let config = config.with_settings(&args.set)?;
    config.validate()?;
    let threads = use_threads(None)?;
    let scans = recorded.scans(&config.mapping, threads);
    let mut alignment = None;
    if args.align_points {
        let points = points_of(recorded, &scans);
        let (truth, _) = mapfile::load(&args.truth)?;
        let found = align_to_surfaces(&points, &truth, threads);
        let found = found.while_running("the points cannot be aligned")?;
        recorded.frame.map_from_world = found.correction * recorded.frame.map_from_world;
        alignment = Some(found);
    }
    let built = recorded.map(&scans, &config.mapping, threads);
    Ok((built.while_running("the map cannot be built")?.0, alignment))
}

/// Every so many pixels are points that are aligned.
const POINT_STRIDE: usize = 7;

/// Some of the points that the keyframes have, in the frame of maps.
fn points_of(recorded: &Recorded, scans: &[KeyframeScan]) -> Vec<Vec3> {
    let mut points = Vec::new();
    for (keyframe, scan) in recorded.keyframes.iter().zip(scans) {
        let Some(world_from_keyframe) = keyframe.world_from_keyframe else {
            continue;
        };
        let map_from_keyframe = recorded.frame.map_from_world * world_from_keyframe;
        let pinhole = &keyframe.camera.pinhole;
        points.extend(scan.pixels().iter().step_by(POINT_STRIDE).map(|pixel| {
            let at = Vec2::new(pixel.x.into(), pixel.y.into());
            map_from_keyframe * (pinhole.unproject(&at) / f64::from(pixel.idepth))
        }));
    }
    points
}

fn print_alignment(alignment: &SurfaceAlignment) {
    let SurfaceAlignment { before, after, .. } = alignment;
    let [from, to] = [before, after].map(|distances| 100.0 * distances.within_a_cell);
    println!(
        "points brought onto the surfaces of the truth: moved by {:.4}, turned by {:.2} degrees, \
         scaled by {:.4}; median distance {:.4} -> {:.4}, next to a surface {from:.1} -> {to:.1} %",
        alignment.moved, alignment.turned_deg, alignment.scale, before.median, after.median
    );
}

/// The thesis' alignment: the finished map is turned, scaled and resampled into the cells of the
/// truth.
fn rotated_and_scaled(
    estimate: &OccupancyMap,
    truth: &TruthGrid,
    sim3: &Path,
) -> Result<OccupancyMap, Failure> {
    let target_from_map = read_sim3(sim3).bad_input()?;
    // cells as large as the scaled ones, rounded to a whole number of true cells
    let scaled = estimate.resolution() * target_from_map.scale;
    let factor = (scaled / truth.resolution()).round().max(1.0);
    let resolution = truth.resolution() * factor;
    let moved = estimate.transformed(&similarity(&target_from_map), resolution);
    moved.while_running("the map cannot be moved")
}

/// Cells that are searched for paths, 50 bytes of memory each, and how often they are visited, some
/// ten million times a second: for small files, and for each byte of larger ones.
const SMALL_CELLS: u64 = 8_000_000;
const CELLS_PER_BYTE: u64 = 64;
const SMALL_VISITS: u64 = 30_000_000;
const VISITS_PER_BYTE: u64 = 4000;

/// Plans in both maps and checks each path in the other.
pub fn paths(args: &EvaluatePathsArgs) -> CommandResult {
    let (estimate, _) = mapfile::load(&args.estimate)?;
    let truth = fitted(&estimate, load_truth(&args.truth)?, &args.truth)?;
    let files = [&args.estimate, &args.truth].map(std::fs::metadata);
    let bytes = files.into_iter().flatten().map(|file| file.len()).sum();
    let allowed = |small, per_byte| mapfile::allowance(bytes, small, per_byte);
    let config = PathConfig {
        robot_radius: args.robot_radius,
        pairs: args.pairs,
        min_distance: args.min_distance,
        planning_cell: args.planning_cell,
        seed: args.seed,
        max_cells: usize::try_from(allowed(SMALL_CELLS, CELLS_PER_BYTE)).unwrap_or(usize::MAX),
        max_visits: allowed(SMALL_VISITS, VISITS_PER_BYTE),
        ..PathConfig::default()
    };
    let report = evaluate_paths(&estimate, &truth, &config).bad_input()?;
    if report.known_share < LEAST_OVERLAP {
        eprintln!(
            "warning: the map knows {} of the free space of the truth: expected maps of the same \
             place, in one frame and one unit",
            percent(report.known_share)
        );
    }
    args.json.print(&report, || print_paths(&report))
}

/// The truth with cells as large as those of the estimate, where a whole number of its own makes
/// one.
fn fitted(map: &OccupancyMap, truth: TruthGrid, path: &Path) -> Result<TruthGrid, Failure> {
    let truth = truth.with_cells_of(map).with_context(|| name_of(path));
    truth.bad_input()
}

fn print_map(report: &MapReport) {
    let policies = &report.policies;
    println!("policy           AUC  AUC 26     MCC  precision  recall  specificity      F1");
    let rows: [(&str, &PolicyReport); 4] = [
        ("observed", &policies.observed),
        ("known", &policies.known),
        ("everything", &policies.everything),
        ("safety", &policies.safety),
    ];
    for (name, policy) in rows {
        let [auc, auc_26, mcc] = [policy.auc, policy.auc_26, policy.mcc];
        println!(
            "{name:<12}{auc:>8.4}{auc_26:>8.4}{mcc:>8.4}{:>11.4}{:>8.4}{:>13.4}{:>8.4}",
            policy.precision, policy.recall, policy.specificity, policy.f1
        );
    }
    println!();
    println!("at p > 0.5            TP          FP          TN          FN");
    for (name, policy) in rows {
        let counts = &policy.counts;
        println!(
            "{name:<12}{:>12}{:>12}{:>12}{:>12}",
            counts.tp, counts.fp, counts.tn, counts.fn_
        );
    }
    println!();
    print_cells(report);
}

/// What is there, where it is, and how far the probabilities can be believed.
fn print_cells(report: &MapReport) {
    let shares = [report.coverage_free, report.coverage_occupied].map(percent);
    println!(
        "observed: {} of the free and {} of the occupied cells; {} cells beyond the truth",
        shares[0], shares[1], report.observed_outside
    );
    if let (Some(free), Some(occupied), Some(known)) = (
        report.coverage_free_in_view,
        report.coverage_occupied_in_view,
        &report.known_in_view,
    ) {
        let [free, occupied] = [free, occupied].map(percent);
        println!(
            "of those that a keyframe looks at: {free} of the free and {occupied} of the occupied \
             cells; known: AUC {:.4}, MCC {:.4}",
            known.auc, known.mcc
        );
    }
    let surface = &report.surface;
    let [median, most] = [surface.accuracy_median_m, surface.accuracy_p90_m].map(or_dash);
    let mean = or_dash(surface.accuracy_m);
    let [beyond, complete] = [surface.accuracy_beyond_3_cells, surface.completeness].map(percent);
    println!(
        "surface: accuracy median {median}, 90 % {most}, mean {mean}, {beyond} beyond 3 cells; \
         completeness {complete} within {}",
        surface.tolerance_m
    );
    let thickness = &report.thickness;
    let [found, expected] = [thickness.thickness_cells, thickness.true_thickness_cells]
        .map(|cells| cells.map_or_else(|| "-".to_owned(), |cells| cells.to_string()));
    println!("walls: {found} cells in a row across surfaces (median), {expected} in truth");
    println!(
        "false walls: {} of {} occupied cells lie over 0.1 outside what the truth knows; MCC {:.4} \
         with these as false",
        report.predicted_beyond, report.predicted, report.mcc_with_beyond
    );
    let (predicted, outside) = (report.predicted, report.predicted_outside);
    if outside > 0 {
        let share = 100.0 * outside as f64 / predicted as f64;
        println!(
            "of {predicted} occupied cells {outside} ({share:.1} %) lie beyond the truth: they \
             count in the accuracy and nowhere else"
        );
    }
    let (brier, ssd) = (or_dash(report.calibration.brier), report.ssd);
    println!("Brier score {brier}, squared differences {ssd:.2} per slice");
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn or_dash(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"))
}

fn print_paths(report: &PathsReport) {
    println!(
        "robot of radius {}, planned {:.3} farther away, on cells of {:.3}",
        report.robot_radius, report.planning_margin, report.planning_cell
    );
    println!(
        "unknown cells, pairs          pairs   blocked  unreachable  planned   colliding  length  \
         clearance"
    );
    let rules = [&report.unknown_blocked, &report.unknown_free];
    for (name, rule) in ["blocked", "free"].into_iter().zip(rules) {
        print_stats(&format!("{name}, all"), &rule.all);
        print_stats(&format!("{name}, ends observed"), &rule.observed);
        print_stats(&format!("{name}, path observed"), &rule.path_observed);
    }
    println!();
    println!(
        "blocked: of the pairs, the shortest true path is blocked in the map (false positive)"
    );
    println!("colliding: of the paths planned on the map, it hits something true (false negative)");
    println!(
        "observed: the map knows all that the robot fills, at start and goal or all along that path"
    );
}

fn print_stats(name: &str, stats: &PathStats) {
    let [blocked, colliding] = [stats.false_positive, stats.false_negative].map(percent);
    let unreachable = percent(stats.unreachable);
    let length = stats.length_ratio.map(|ratio| format!("{ratio:.3}"));
    let length = length.unwrap_or_else(|| "-".to_owned());
    let clearance = or_dash(stats.clearance_median);
    println!(
        "{name:<28}{:>7}{blocked:>10}{unreachable:>13}{:>9}{colliding:>12}{length:>8}\
         {clearance:>11}",
        stats.pairs, stats.planned
    );
}
