//! `monogrid merge-runs`: recordings of different days and cameras as one map, as far as they show the same places.

mod component;
mod inputs;
mod summary;

use super::rescale::write_maps;
use super::{print_json, use_threads};
use crate::args::{ForceArg, JsonArg};
use crate::config::RunConfig;
use crate::failure::{Classify, CommandResult, Failure, Outcome};
use crate::output::{Inputs, OutputFolder};
use crate::run::outputs::Ground;
use crate::run::sessions::{MAP_FROM_WORLD, RECORDING, files_of};
use clap::Args;
use component::{Component, components, write_component};
use inputs::{Part, read_parts};
use monogrid_slam::{StoredMap, merge_maps};
use serde_json::json;
use std::path::PathBuf;
use summary::{print_summary, summary};

/// `monogrid merge-runs`.
#[derive(Debug, Args)]
pub struct MergeRunsArgs {
    /// Folders of runs, or recordings (.mgk); their order says nothing but their numbers
    #[arg(required = true, num_args = 2..)]
    pub runs: Vec<PathBuf>,
    /// Output folder: recording.mgk and the maps of what was joined; what stays apart in apart_1, apart_2, ...
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Edge length of a cell [default: as the first recording that was joined has it, or as its scene asks for]
    #[arg(long, value_name = "L", value_parser = crate::args::positive)]
    pub resolution: Option<f64>,
    /// Settings, TOML (as config.toml of a run; slam.merge, slam.graph and slam.fragments are used)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Change one setting, e.g. --set slam.merge.min_agreeing=5
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Threads of computation [default: all cores]; the results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Name of the summary, as beside a run.
const SUMMARY: &str = "summary.json";

/// Joins what can be joined, and writes all of it.
pub fn execute(args: &MergeRunsArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let config = RunConfig::resolve(None, args.config.as_deref(), &args.set)?;
    config.validate()?;
    let mut parts = read_parts(&args.runs)?;
    let folder = OutputFolder::replace(&args.out, args.force.force, &read_files(args))?;
    for part in &parts {
        for warning in &part.earlier.warnings {
            eprintln!("warning: {warning}");
        }
    }
    let maps = parts.iter_mut().map(Part::take_map).collect();
    let apart = StoredMap::side_by_side(maps);
    let owners = inputs::owners(&parts, &apart);
    let merged = merge_maps(&config.slam, apart).bad_input()?;
    let components = components(&merged.map, &parts);
    let mut written = Vec::new();
    for (number, component) in components.iter().enumerate() {
        let place = Component::folder(number);
        written.push(write_component(&folder, &place, component, &parts)?);
    }
    let mut summary = summary(&parts, &owners, &merged.meetings, &written, &config);
    // the maps are built in the frame that stands beside the recording
    folder.write(SUMMARY, summary.to_string())?;
    let ground = Ground {
        has_floor: !summary["floor"].is_null(),
        is_metric: summary["scale"] == "metric",
    };
    let path = &written[0].path;
    summary["map"] = write_maps(&folder, path, args.resolution, ground, threads)?;
    let text = serde_json::to_string_pretty(&summary).map_err(Failure::running)?;
    folder.write(SUMMARY, text + "\n")?;
    if args.json.json {
        print_json(&summary)?;
    } else {
        print_summary(&args.out, &summary);
    }
    let is_one = components.len() == 1;
    Ok(if is_one {
        Outcome::Done
    } else {
        Outcome::Apart
    })
}

/// All that the command reads.
fn read_files(args: &MergeRunsArgs) -> Inputs {
    let names = [RECORDING, MAP_FROM_WORLD, SUMMARY];
    let of_run = |run: &PathBuf| names.map(|name| run.join(name));
    let beside = |run: &PathBuf| {
        let folder = run.parent().map(PathBuf::from).unwrap_or_default();
        [MAP_FROM_WORLD, SUMMARY].map(|name| folder.join(name))
    };
    let mut inputs = Inputs::of("the settings", args.config.clone().unwrap_or_default());
    for run in &args.runs {
        inputs = inputs.and("a run", run).and_all("a run", files_of(run));
        inputs = if run.is_dir() {
            inputs.and_all("a run", of_run(run))
        } else {
            inputs.and_all("what lies beside a recording", beside(run))
        };
    }
    inputs
}

/// An object of what a map is, as `summary.json` of a run says it.
fn scale_name(is_metric: bool) -> serde_json::Value {
    json!(if is_metric { "metric" } else { "arbitrary" })
}
