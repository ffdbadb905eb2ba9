//! `monogrid evaluate map` and `monogrid evaluate paths`: a map against the true one.

use super::print_json;
use crate::cli::{JsonArg, positive};
use crate::failure::{Classify, CommandResult, Failure, Outcome};
use crate::mapfile;
use clap::Args;
use monogrid_evaluation::{
    MapEvaluationConfig, MapReport, PathConfig, PathReport, PathStats, PathsReport, PolicyReport,
    TruthGrid, evaluate_map, evaluate_paths,
};
use monogrid_occupancy::OccupancyMap;
use std::path::{Path, PathBuf};

/// `monogrid evaluate map`.
#[derive(Debug, Args)]
pub struct EvaluateMapArgs {
    /// Estimated map (.ot; a .bt has no probabilities to rank)
    pub estimate: PathBuf,
    /// True map (.ot or .bt); its cells as large as the estimate's, or a whole number of times smaller
    pub truth: PathBuf,
    /// Surfaces this close agree [default: 0.05 or the edge of a cell, whichever is larger]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub tolerance: Option<f64>,
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

/// Compares an estimated map with the true one, cell by cell.
pub fn map(args: &EvaluateMapArgs) -> CommandResult {
    let (estimate, truth) = load_pair(&args.estimate, &args.truth)?;
    let config = MapEvaluationConfig {
        tolerance_m: args.tolerance,
        ..MapEvaluationConfig::default()
    };
    let report = evaluate_map(&estimate, &truth, &config).bad_input()?;
    if args.json.json {
        print_json(&report)?;
    } else {
        print_map(&report);
    }
    Ok(Outcome::Done)
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

/// Both maps, the truth with cells as large as those of the estimate where a whole number of its own
/// makes one.
fn load_pair(estimate: &Path, truth: &Path) -> Result<(OccupancyMap, TruthGrid), Failure> {
    let (map, _) = mapfile::load(estimate)?;
    let (true_map, _) = mapfile::load(truth)?;
    let of_truth = |error: monogrid_evaluation::TruthError| {
        Failure::Input(anyhow::Error::from(error).context(format!("true map {}", truth.display())))
    };
    let grid = TruthGrid::from_map(&true_map, MAX_CELLS).map_err(of_truth)?;
    let ratio = map.resolution() / grid.resolution();
    let factor = ratio.round();
    if factor >= 2.0 && (ratio - factor).abs() < 1e-6 * factor && factor < f64::from(u32::MAX) {
        return Ok((map, grid.coarsened(factor as u32).map_err(of_truth)?));
    }
    Ok((map, grid))
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
    println!(
        "observed: {:.1} % of the free and {:.1} % of the occupied cells; {} cells beyond the truth",
        100.0 * report.coverage_free,
        100.0 * report.coverage_occupied,
        report.observed_outside
    );
    println!(
        "surface: accuracy {}, completeness {:.1} % within {}",
        or_dash(report.surface.accuracy_m),
        100.0 * report.surface.completeness,
        report.surface.tolerance_m
    );
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
        print_stats(&format!("{name}, in observed space"), &rule.observed);
    }
    println!();
    println!(
        "blocked: of the pairs, the shortest true path is blocked in the map (false positive)"
    );
    println!("colliding: of the paths planned on the map, it hits something true (false negative)");
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
