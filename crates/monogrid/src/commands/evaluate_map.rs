//! `monogrid evaluate map` and `monogrid evaluate paths`: a map against the true one.

use super::{print_json, tools, use_threads};
use crate::args::{JsonArg, MappingArgs, Profile, positive};
use crate::config::RunConfig;
use crate::failure::{Classify, CommandResult, Failure, Outcome};
use crate::mapfile;
use crate::recorded::Recorded;
use crate::run::align::{Align, Up};
use crate::run::sessions::Source;
use clap::Args;
use monogrid_datasets::read_sim3;
use monogrid_evaluation::{
    MapEvaluationConfig, MapReport, PathConfig, PathReport, PathStats, PathsReport, PolicyReport,
    SurfaceAlignment, TruthGrid, align_to_surfaces, cells_in_view, evaluate_map, evaluate_paths,
};
use monogrid_geometry::{Vec2, Vec3};
use monogrid_occupancy::OccupancyMap;
use monogrid_slam::mapping::KeyframeScan;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `monogrid evaluate map`.
#[derive(Debug, Args)]
pub struct EvaluateMapArgs {
    /// Estimated map (.ot; a .bt has no probabilities to rank), or a recording (.mgk), submaps (submaps.json) or a run to map
    pub estimate: PathBuf,
    /// True map (.ot or .bt); its cells as large as the estimate's, or a whole number of times smaller
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
    /// Then bring the points of the recording onto the surfaces of the true map, by a similarity that begins at the poses: references
    /// can be off by more than a cell
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
    /// True map (.ot or .bt); its cells as large as the estimate's, or a whole number of times smaller
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

/// Most cells of the box of a true map, two bits each.
const MAX_CELLS: u64 = 4_000_000_000;

/// Edge of the cells in which views are traced: finer ones cost time and change little.
const VIEW_CELL: f64 = 0.064;

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
    let mut alignment = None;
    let estimate = match &mut recorded {
        Some(recorded) if is_recording => {
            let (map, on_surfaces) = mapped(recorded, args)?;
            alignment = on_surfaces;
            map
        }
        _ if args.align_points => {
            return Err(Failure::input(
                "--align-points moves the points of a recording before they are mapped: give the recording instead of the map",
            ));
        }
        _ => mapfile::load(&args.estimate)?.0,
    };
    let truth = load_truth(&args.truth)?;
    let (estimate, truth) = match &args.move_map {
        Some(file) => rotated_and_scaled(&estimate, truth, file, &args.truth)?,
        None => fitted(estimate, truth, &args.truth)?,
    };
    let in_view = match &recorded {
        Some(recorded) => Some(in_view(&truth, recorded, args.view_range)?),
        None => None,
    };
    let config = MapEvaluationConfig {
        tolerance_m: args.tolerance,
        in_view: in_view.as_ref(),
        ..MapEvaluationConfig::default()
    };
    let report = evaluate_map(&estimate, &truth, &config).bad_input()?;
    if args.json.json {
        print_json(&Evaluated { report, alignment })?;
    } else {
        if let Some(alignment) = &alignment {
            print_alignment(alignment);
        }
        print_map(&report);
    }
    Ok(Outcome::Done)
}

/// `evaluate map --json`.
#[derive(Debug, Serialize)]
struct Evaluated {
    #[serde(flatten)]
    report: MapReport,
    #[serde(
        rename = "aligned_to_surfaces",
        skip_serializing_if = "Option::is_none"
    )]
    alignment: Option<SurfaceAlignment>,
}

/// The map of a recording by its own settings and the options, and how its points were brought onto the surfaces of the truth, where
/// that is asked for: the recording is in that frame then.
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
    println!(
        "points brought onto the surfaces of the truth: moved by {:.4}, turned by {:.2} degrees, scaled by {:.4}; median distance {:.4} -> \
         {:.4}, next to a surface {:.1} -> {:.1} %",
        alignment.moved,
        alignment.turned_deg,
        alignment.scale,
        before.median,
        after.median,
        100.0 * before.within_a_cell,
        100.0 * after.within_a_cell
    );
}

/// The cells that some keyframe of a recording looks at.
pub fn in_view(truth: &TruthGrid, recorded: &Recorded, range: f64) -> Result<TruthGrid, Failure> {
    let factor = (VIEW_CELL / truth.resolution()).floor().max(1.0) as u32;
    let coarse = truth
        .coarsened(factor)
        .while_running("no view can be made")?;
    Ok(cells_in_view(&coarse, &recorded.views(), range))
}

/// The thesis' alignment: the finished map is turned, scaled and resampled into the cells of the truth.
fn rotated_and_scaled(
    estimate: &OccupancyMap,
    truth: TruthGrid,
    sim3: &Path,
    truth_path: &Path,
) -> Result<(OccupancyMap, TruthGrid), Failure> {
    let target_from_map = read_sim3(sim3).bad_input()?;
    // cells as large as the scaled ones, rounded to a whole number of true cells
    let scaled = estimate.resolution() * target_from_map.scale;
    let factor = (scaled / truth.resolution()).round().max(1.0);
    let moved = estimate
        .transformed(
            &tools::similarity(&target_from_map),
            truth.resolution() * factor,
        )
        .while_running("the map cannot be moved")?;
    fitted(moved, truth, truth_path)
}

/// Plans in both maps and checks each path in the other.
pub fn paths(args: &EvaluatePathsArgs) -> CommandResult {
    let (estimate, truth) = load_pair(&args.estimate, &args.truth)?;
    let config = PathConfig {
        robot_radius: args.robot_radius,
        pairs: args.pairs,
        min_distance: args.min_distance,
        planning_cell: args.planning_cell,
        seed: args.seed,
        ..PathConfig::default()
    };
    let report = evaluate_paths(&estimate, &truth, &config).bad_input()?;
    if args.json.json {
        print_json(&report)?;
    } else {
        print_paths(&report);
    }
    Ok(Outcome::Done)
}

/// Both maps, the truth with cells as large as those of the estimate.
fn load_pair(estimate: &Path, truth: &Path) -> Result<(OccupancyMap, TruthGrid), Failure> {
    let (map, _) = mapfile::load(estimate)?;
    fitted(map, load_truth(truth)?, truth)
}

/// Reads a true map.
pub fn load_truth(path: &Path) -> Result<TruthGrid, Failure> {
    let (map, _) = mapfile::load(path)?;
    TruthGrid::from_map(&map, MAX_CELLS).map_err(|error| of_truth(error, path))
}

fn of_truth(error: monogrid_evaluation::TruthError, path: &Path) -> Failure {
    Failure::Input(anyhow::Error::from(error).context(format!("true map {}", path.display())))
}

/// The truth with cells as large as those of the estimate, where a whole number of its own makes one.
fn fitted(
    map: OccupancyMap,
    truth: TruthGrid,
    path: &Path,
) -> Result<(OccupancyMap, TruthGrid), Failure> {
    let truth = truth.with_cells_of(&map);
    let truth = truth.map_err(|error| of_truth(error, path))?;
    Ok((map, truth))
}

fn print_map(report: &MapReport) {
    let policies = &report.policies;
    println!(
        "{:<12}{:>8}{:>8}{:>8}{:>11}{:>8}{:>13}{:>8}",
        "policy", "AUC", "AUC 26", "MCC", "precision", "recall", "specificity", "F1"
    );
    let rows: [(&str, &PolicyReport); 4] = [
        ("observed", &policies.observed),
        ("known", &policies.known),
        ("everything", &policies.everything),
        ("safety", &policies.safety),
    ];
    for (name, policy) in rows {
        println!(
            "{name:<12}{:>8.4}{:>8.4}{:>8.4}{:>11.4}{:>8.4}{:>13.4}{:>8.4}",
            policy.auc,
            policy.auc_26,
            policy.mcc,
            policy.precision,
            policy.recall,
            policy.specificity,
            policy.f1
        );
    }
    println!();
    println!(
        "{:<12}{:>12}{:>12}{:>12}{:>12}",
        "at p > 0.5", "TP", "FP", "TN", "FN"
    );
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
    println!(
        "observed: {:.1} % of the free and {:.1} % of the occupied cells; {} cells beyond the truth",
        100.0 * report.coverage_free,
        100.0 * report.coverage_occupied,
        report.observed_outside
    );
    if let (Some(free), Some(occupied)) = (
        report.coverage_free_in_view,
        report.coverage_occupied_in_view,
    ) {
        println!(
            "of those that a keyframe looks at: {:.1} % of the free and {:.1} % of the occupied cells",
            100.0 * free,
            100.0 * occupied
        );
    }
    let surface = &report.surface;
    println!(
        "surface: accuracy median {}, 90 % {}, mean {}, {:.1} % beyond 3 cells; completeness {:.1} % within {}",
        or_dash(surface.accuracy_median_m),
        or_dash(surface.accuracy_p90_m),
        or_dash(surface.accuracy_m),
        100.0 * surface.accuracy_beyond_3_cells,
        100.0 * surface.completeness,
        surface.tolerance_m
    );
    let thickness = &report.thickness;
    let [found, expected] = [thickness.thickness_cells, thickness.true_thickness_cells]
        .map(|cells| cells.map_or_else(|| "-".to_owned(), |cells| cells.to_string()));
    println!("walls: {found} cells in a row across surfaces (median), {expected} in truth");
    println!(
        "false walls: {} of {} occupied cells lie over 0.1 outside what the truth knows; MCC {:.4} with these as false",
        report.predicted_beyond, report.predicted, report.mcc_with_beyond
    );
    if report.predicted_outside > 0 {
        println!(
            "of {} occupied cells {} ({:.1} %) lie beyond the truth: they count in the accuracy and nowhere else",
            report.predicted,
            report.predicted_outside,
            100.0 * report.predicted_outside as f64 / report.predicted as f64
        );
    }
    println!(
        "Brier score {}, squared differences {:.2} per slice",
        or_dash(report.calibration.brier),
        report.ssd
    );
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
        "{:<28}{:>7}{:>10}{:>13}{:>9}{:>12}{:>8}{:>11}",
        "unknown cells, pairs",
        "pairs",
        "blocked",
        "unreachable",
        "planned",
        "colliding",
        "length",
        "clearance"
    );
    let rules: [(&str, &PathReport); 2] = [
        ("blocked", &report.unknown_blocked),
        ("free", &report.unknown_free),
    ];
    for (name, rule) in rules {
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
    println!(
        "{name:<28}{:>7}{:>8.1} %{:>11.1} %{:>9}{:>10.1} %{:>8}{:>11}",
        stats.pairs,
        100.0 * stats.false_positive,
        100.0 * stats.unreachable,
        stats.planned,
        100.0 * stats.false_negative,
        stats
            .length_ratio
            .map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.3}")),
        or_dash(stats.clearance_median)
    );
}
