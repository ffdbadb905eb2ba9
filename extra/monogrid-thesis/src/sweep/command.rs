//! `monogrid thesis sweep`: the thesis' experiments on recordings.

use crate::sweep::build::{Job, Scans};
use crate::sweep::inputs::{Named, file_stamp, open_folder, orders, read_recordings};
use crate::sweep::page::{self, Lead, truth_slice_file};
use crate::sweep::pictures::{PictureOrders, truth_slice};
use crate::sweep::plan::{self, Entry, RESOLUTIONS};
use crate::sweep::record::MapRecord;
use crate::sweep::result::RecordingResult;
use crate::sweep::schedule::{self, Resources};
use crate::sweep::slam_rate::{self, Rate, RateJob};
use clap::{Args, ValueEnum};
use monogrid_app::args::{JsonArg, Profile, SourceArgs, positive};
use monogrid_app::config::RunConfig;
use monogrid_app::input::Input;
use monogrid_app::input::depth_images::FrameDepths;
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::console::is_drawn;
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::process::progress::Progress;
use monogrid_app::process::usage::peak_rss_bytes;
use monogrid_app::process::{use_threads, warn};
use monogrid_app::run::align::{Align, Up};
use monogrid_app::truth_map::{in_view, load_truth};
use monogrid_datasets::Scale;
use monogrid_evaluation::{MapEvaluationConfig, MapEvaluator, TruthGrid, whole_ratio};
use monogrid_mapping::KeyframeScan;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// `monogrid thesis sweep`.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// Recordings (.mgk) or folders of runs of one environment, e.g. with both profiles
    #[arg(required = true)]
    pub recordings: Vec<PathBuf>,
    /// True map (.ot or .bt), best of the finest resolution; without it nothing is compared
    #[arg(long, value_name = "MAP.ot")]
    pub truth: Option<PathBuf>,
    /// Output folder; a sweep that was interrupted goes on where it was
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
    /// Bring the poses of the recordings to the frame of the truth
    #[arg(long, value_name = "gt:FILE|sim3:FILE")]
    pub align: Option<String>,
    /// Edges of the cells, metres [default: 0.008,0.016,0.032,0.064,0.128]
    #[arg(
        long, value_name = "L,...", value_delimiter = ',', value_parser = positive,
        default_values_t = RESOLUTIONS, hide_default_value = true
    )]
    pub resolutions: Vec<f64>,
    /// Memory that all maps may take together, GB; maps beyond it are marked
    #[arg(long, value_name = "GB", value_parser = positive, default_value_t = 4.0)]
    pub memory: f64,
    /// Cells farther from every keyframe do not count as seen
    #[arg(long, value_name = "L", value_parser = positive, default_value_t = 10.0)]
    pub view_range: f64,
    /// Measure SLAM with each mapping beside it on this source, one run after the other
    #[arg(long, value_name = "SOURCE")]
    pub slam_source: Option<PathBuf>,
    /// Frames of each of these runs
    #[arg(long, value_name = "N", default_value_t = 300)]
    pub slam_frames: usize,
    /// Maps built at the same time [default: all cores]; the results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Output for programs
    #[command(flatten)]
    pub json: JsonArg,
}

/// `sweep --json`.
#[derive(Debug, Serialize)]
struct SweepReport {
    maps: usize,
    beyond_memory: usize,
    wall_seconds: f64,
    map_cpu_seconds: f64,
    peak_rss_bytes: Option<u64>,
    page: PathBuf,
    warnings: Vec<String>,
}

/// Carries out the sweep and writes the page.
pub fn execute(args: &SweepArgs) -> CommandResult {
    let begin = Instant::now();
    let workers = use_threads(args.threads)?;
    let align = Align::parse(args.align.as_deref(), Up::default())?;
    let mut resolutions = args.resolutions.clone();
    resolutions.sort_by(f64::total_cmp);
    resolutions.dedup();
    let recordings = read_recordings(&args.recordings, &align)?;
    let finest_truth = args.truth.as_deref().map(load_truth).transpose()?;
    let out = open_folder(&args.out, args.force, &inputs(args)?, &recordings)?;
    let orders = orders(&recordings, finest_truth.as_ref(), &resolutions);
    let resources = Resources {
        workers,
        memory_bytes: (args.memory * 1e9) as usize,
    };
    let num_maps = recordings.len() * resolutions.len() * plan::models().len();
    let progress = Progress::new(num_maps, "maps", is_drawn());
    let sweep = Sweep {
        args,
        out: &out,
        resolutions: &resolutions,
        finest_truth: finest_truth.as_ref(),
        orders: &orders,
        resources,
        progress: &progress,
    };
    let results = recordings.iter().map(|recording| sweep.result(recording));
    let mut results: Vec<RecordingResult> = results.collect::<Result<_, _>>()?;
    progress.finish();
    if let Some(source) = &args.slam_source {
        for (result, recording) in results.iter_mut().zip(&recordings) {
            result.rates = sweep.rates(source, recording)?;
        }
    }
    sweep.conclude(&results, &recordings, begin)
}

/// What is read.
fn inputs(args: &SweepArgs) -> Result<Inputs, Failure> {
    let inputs = Inputs::default()
        .and_all("a recording", &args.recordings)
        .and_all("the truth", &args.truth)
        .and_named("the reference", args.align.as_deref());
    match &args.slam_source {
        Some(source) => inputs.and_dataset(source),
        None => Ok(inputs),
    }
}

/// What all recordings of a sweep share.
struct Sweep<'a> {
    args: &'a SweepArgs,
    out: &'a OutputFolder,
    /// Edges of the cells, from the smallest.
    resolutions: &'a [f64],
    finest_truth: Option<&'a TruthGrid>,
    orders: &'a PictureOrders,
    resources: Resources,
    progress: &'a Progress,
}

impl Sweep<'_> {
    /// All maps of one recording, coarse ones first: they are quick and show early what is wrong.
    fn result(&self, named: &Named) -> Result<RecordingResult, Failure> {
        let recorded = &named.recorded;
        let scans = Scans::new(recorded, self.resources.workers);
        let view = |truth| in_view(truth, recorded, self.args.view_range);
        let view = self.finest_truth.map(view).transpose()?;
        let stamp = self.stamp(named)?;
        let mut records = Vec::new();
        for &resolution in self.resolutions.iter().rev() {
            let truth = self.drawn_truth(resolution)?;
            let view = view.as_ref();
            let view = view.map(|view| at_least_as_coarse(view, resolution));
            let view = view.transpose()?;
            let config = MapEvaluationConfig {
                in_view: view.as_ref(),
                max_distance_queries: 0,
                ..MapEvaluationConfig::default()
            };
            let truth = truth.as_ref();
            let evaluator = truth.map(|truth| MapEvaluator::new(truth, &config));
            let evaluator = evaluator.transpose().bad_input()?;
            let job = Job {
                recorded,
                scans: &scans,
                evaluator: evaluator.as_ref(),
                orders: self.orders,
                out: self.out,
                name: &named.name,
            };
            let entry = |model| Entry { model, resolution };
            let entries: Vec<Entry> = plan::models().into_iter().map(entry).collect();
            let fingerprint =
                |entry: &Entry| format!("{stamp}{:?}", entry.model.mapping(entry.resolution));
            let (resources, progress) = (self.resources, self.progress);
            let built = schedule::run(&job, &entries, fingerprint, resources, progress);
            records.extend(built?);
        }
        Ok(self.facts(named, &scans.all, records))
    }

    /// What all records of a recording depend on.
    fn stamp(&self, named: &Named) -> Result<String, Failure> {
        let mut stamp = file_stamp(&named.path)?;
        if let Some(truth) = &self.args.truth {
            stamp.push_str(&file_stamp(truth)?);
        }
        let options = (&self.args.align, self.args.memory, self.args.view_range);
        Ok(format!("{stamp}{options:?} {} ", env!("CARGO_PKG_VERSION")))
    }

    /// The truth with cells of this size, of which slices are drawn; `None` where it is not fine
    /// enough.
    fn drawn_truth(&self, resolution: f64) -> Result<Option<TruthGrid>, Failure> {
        let Some(finest) = self.finest_truth else {
            return Ok(None);
        };
        let Some(factor) = whole_ratio(resolution, finest.resolution()) else {
            return Ok(None);
        };
        let truth = finest.coarsened(factor as u32).bad_input()?;
        for (index, height) in self.orders.heights.iter().enumerate() {
            let name = truth_slice_file(truth.resolution(), index);
            let png = truth_slice(&truth, self.orders, *height);
            self.out.write(&name, &png)?;
        }
        Ok(Some(truth))
    }

    fn facts(
        &self,
        named: &Named,
        all_scans: &[KeyframeScan],
        records: Vec<MapRecord>,
    ) -> RecordingResult {
        let recorded = &named.recorded;
        let times = || recorded.keyframes.iter().map(|k| k.timestamp_ns);
        let span = times().max().unwrap_or(0) - times().min().unwrap_or(0);
        let environment = |truth: &TruthGrid| truth.size().map(|n| n as f64 * truth.resolution());
        RecordingResult {
            name: named.name.clone(),
            profile: recorded.session.profile.clone(),
            is_metric: recorded.frame.is_aligned || recorded.session.scale == Scale::Metric,
            frames: recorded.num_frames.unwrap_or(0),
            keyframes: recorded.world_from_keyframes().iter().flatten().count(),
            points: all_scans.iter().map(|scan| scan.num_pixels).sum(),
            video_seconds: span as f64 * 1e-9,
            environment: self.finest_truth.map(environment),
            resolutions: self.resolutions.to_vec(),
            records,
            rates: Vec::new(),
        }
    }

    fn rates(&self, source: &Path, named: &Named) -> Result<Vec<Rate>, Failure> {
        let (frames, threads) = (self.args.slam_frames, self.resources.workers);
        let input_args = SourceArgs {
            max_frames: Some(frames),
            ..SourceArgs::default()
        };
        let profile = Profile::from_str(&named.recorded.session.profile, false).unwrap_or_default();
        let input = Input::open(source, &input_args, RunConfig::of(profile).working_size())?;
        let job = RateJob {
            depth: FrameDepths::of_dataset(&input, None, 1)?,
            input: &input,
            profile,
            threads,
            out: self.out,
            file: format!("{}/slam-rates.json", named.name),
            fingerprint: format!(
                "{} {frames} frames, {threads} threads, {}",
                source.display(),
                env!("CARGO_PKG_VERSION")
            ),
        };
        slam_rate::measure(&job, self.resolutions)
    }

    fn conclude(
        &self,
        results: &[RecordingResult],
        recordings: &[Named],
        begin: Instant,
    ) -> CommandResult {
        let args = self.args;
        let records = || results.iter().flat_map(|result| &result.records);
        let num_maps = records().count();
        let beyond = records().filter(|record| record.built().is_none()).count();
        let cpu: f64 = records().filter_map(|r| r.built()).map(|b| b.seconds).sum();
        let warnings = recordings.iter().flat_map(|Named { name, recorded, .. }| {
            let warnings = recorded.warnings.iter();
            warnings.map(move |warning| format!("{name}: {warning}"))
        });
        let warnings: Vec<String> = warnings.collect();
        let lead = Lead {
            text: format!(
                "{num_maps} maps of {} recordings, {} resolutions; {beyond} beyond {} GB.",
                recordings.len(),
                args.resolutions.len(),
                args.memory
            ),
            facts: facts(args, cpu),
            warnings: warnings.clone(),
        };
        page::write(self.out, &lead, results, self.orders)?;
        let report = SweepReport {
            maps: num_maps,
            beyond_memory: beyond,
            wall_seconds: begin.elapsed().as_secs_f64(),
            map_cpu_seconds: cpu,
            peak_rss_bytes: peak_rss_bytes(),
            page: args.out.join("sweep.html"),
            warnings,
        };
        args.json.print(&report, || {
            warn(&report.warnings);
            println!("{} {}", lead.text, report.page.display());
        })
    }
}

/// A view with cells no smaller than those of a truth: seen is what is seen in part.
fn at_least_as_coarse(view: &TruthGrid, resolution: f64) -> Result<TruthGrid, Failure> {
    let factor = (resolution / view.resolution()).round().max(1.0);
    view.coarsened(factor as u32)
        .while_running("no view can be made")
}

/// What stands at the top of the page.
fn facts(args: &SweepArgs, cpu_seconds: f64) -> Vec<(String, String)> {
    let truth = args.truth.as_ref();
    let truth = truth.map_or_else(|| "none".to_owned(), |path| path.display().to_string());
    let alignment =
        "the poses of the keyframes, before mapping; the thesis turned and scaled finished maps";
    let facts = [
        ("CPU time of all maps", format!("{cpu_seconds:.0} s")),
        ("Truth", truth),
        ("Alignment", alignment.to_owned()),
    ];
    facts.map(|(name, fact)| (name.to_owned(), fact)).into()
}
