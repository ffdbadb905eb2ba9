//! `monogrid merge-runs`: recordings of different days and cameras as one map, as far as they show
//! the same places.

mod component;
mod inputs;

use crate::commands::runs::rescale::{SUMMARY, write_maps};
use crate::commands::{use_threads, warn};
use clap::Args;
use component::{Written, components, write_component};
use inputs::{Part, read_parts};
use monogrid_app::args::WriteArgs;
use monogrid_app::config::RunConfig;
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::failure::{Classify, CommandResult, Outcome};
use monogrid_app::run::sessions::{MAP_FROM_WORLD, RECORDING, files_of};
use monogrid_slam::{FragmentId, Meeting, StoredMap, merge_maps};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// `monogrid merge-runs`.
#[derive(Debug, Args)]
pub struct MergeRunsArgs {
    /// Folders of runs, or recordings (.mgk); their order says nothing but their numbers
    #[arg(required = true, num_args = 2..)]
    pub runs: Vec<PathBuf>,
    /// Output folder: recording.mgk and the maps of what was joined; what stays apart in apart_1,
    /// apart_2, ...
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Edge length of a cell [default: as the first recording that was joined has it, or as its
    /// scene asks for]
    #[arg(long, value_name = "L", value_parser = monogrid_app::args::positive)]
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
    pub write: WriteArgs,
}

/// Joins what can be joined, and writes all of it.
pub fn execute(args: &MergeRunsArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let config = RunConfig::resolve(None, args.config.as_deref(), &args.set)?;
    config.validate()?;
    let mut parts = read_parts(&args.runs)?;
    let folder = OutputFolder::replace(&args.out, args.write.force, &read_files(args))?;
    for part in &parts {
        warn(&part.earlier.warnings);
    }
    let maps = parts.iter_mut().map(Part::take_map).collect();
    let apart = StoredMap::side_by_side(maps);
    let owners = inputs::owners(&parts, &apart);
    let merged = merge_maps(&config.slam, apart).bad_input()?;
    let components = components(&merged.map, &parts);
    let written = components.iter();
    let written = written.map(|component| write_component(&folder, component, &parts));
    let written: Vec<Written> = written.collect::<Result<_, _>>()?;
    let summary = summary(&parts, &owners, &merged.meetings, &written, &config);
    let lead = format!("Merged from {} runs.", parts.len());
    let path = &written[0].path;
    let summary = write_maps(&folder, (summary, &lead), path, args.resolution, threads)?;
    let json = args.write.json;
    json.print(&summary, || print_summary(&args.out, &summary))?;
    Ok(match components.len() {
        1 => Outcome::Done,
        _ => Outcome::Apart,
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

/// `summary.json`, without what is known of the maps.
fn summary(
    parts: &[Part],
    owners: &BTreeMap<FragmentId, usize>,
    meetings: &[Meeting],
    written: &[Written],
    config: &RunConfig,
) -> Value {
    let mut recordings: Vec<&Part> = parts.iter().collect();
    recordings.sort_by_key(|part| part.number);
    let recording = |part: &&Part| {
        json!({
            "number": part.number,
            "path": part.path.display().to_string(),
            "source": part.earlier.session.source,
            "keyframes": part.keyframes.len(),
        })
    };
    let meeting = |meeting: &Meeting| {
        let (a, b) = meeting.fragments;
        let (a, b) = (owners.get(&a), owners.get(&b));
        json!({
            "recordings": [a.min(b), a.max(b)],
            "sightings": meeting.sightings,
            "agreeing": meeting.agreeing,
            "contradicting": meeting.contradicting,
            "is_enough": meeting.is_enough(&config.slam.merge),
        })
    };
    // what is known of the largest component, and the parts of all
    let mut summary = written[0].facts.clone();
    summary["recordings"] = recordings.iter().map(recording).collect();
    summary["meetings"] = meetings.iter().map(meeting).collect();
    summary["components"] = written.iter().map(component).collect();
    summary
}

fn component(written: &Written) -> Value {
    let mut recordings = written.recordings.clone();
    recordings.sort_unstable();
    let said = |&(number, keyframes)| json!({ "number": number, "keyframes": keyframes });
    json!({
        "recording": format!("{}recording.mgk", written.place),
        "scale": written.facts["scale"],
        "recordings": recordings.iter().map(said).collect::<Value>(),
    })
}

/// Says what was joined, what was not, and why.
fn print_summary(out: &Path, summary: &Value) {
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    for recording in list(&summary["recordings"]) {
        let (number, path) = (&recording["number"], text(&recording["path"]));
        println!("{number}: {path}, {} keyframes", recording["keyframes"]);
    }
    for meeting in list(&summary["meetings"]) {
        let pair = &meeting["recordings"];
        let (agreeing, contradicting) = (&meeting["agreeing"], &meeting["contradicting"]);
        let verdict = match meeting["is_enough"].as_bool() {
            Some(true) => "",
            _ => ": not enough",
        };
        println!(
            "{} and {}: {} pairs of keyframes show the same; {} keyframes agree ({} pairs \
             aligned), {} contradict them{verdict}",
            pair[0],
            pair[1],
            meeting["sightings"],
            agreeing["keyframes"],
            agreeing["aligned"],
            contradicting["keyframes"]
        );
    }
    for component in list(&summary["components"]) {
        let recordings = list(&component["recordings"]).into_iter();
        let numbers = recordings.map(|recording| recording["number"].to_string());
        let numbers: Vec<String> = numbers.collect();
        let (recording, scale) = (text(&component["recording"]), text(&component["scale"]));
        let (recording, numbers) = (out.join(recording), numbers.join(" + "));
        println!("{}: {numbers} (scale {scale})", recording.display());
    }
}
