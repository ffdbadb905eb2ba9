//! `monogrid run`.

use super::{print_json, use_threads};
use crate::cli::RunArgs;
use crate::config::RunConfig;
use crate::failure::{CommandResult, Failure, Outcome};
use crate::input::{Images, Input};
use crate::output::OutputFolder;
use crate::run::align::{Align, MapFrame};
use crate::run::report::{ReportInput, page};
use crate::run::sessions::{Continued, Earlier, sessions};
use crate::run::summary::{
    End, FragmentSummary, MapFacts, Seconds, SessionSummary, Summary, end_of, stage_seconds,
};
use crate::run::{EarlyEnd, FrameFate, FrameRow, RunSettings, Tracked, in_map, outputs, track};
use crate::usage::{peak_rss_bytes, process_cpu};
use monogrid_geometry::Vec3;
use monogrid_image::GrayImage;
use monogrid_slam::mapping::Maps;
use monogrid_slam::{Purpose, Scale};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// When the process started, as nearly as it is known.
pub fn process_start() -> Instant {
    static START: OnceLock<Instant> = OnceLock::new();
    *START.get_or_init(Instant::now)
}

/// Runs the command.
pub fn execute(args: &RunArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let earlier = args
        .continue_from
        .as_deref()
        .map(Earlier::read)
        .transpose()?;
    let mut config = configuration(args, earlier.as_ref())?;
    config.apply(&args.mapping);
    if let Some(radius) = args.local_radius {
        config.mapping.local_radius = radius;
    }
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    config.validate()?;
    let mut align = Align::parse(args.align.as_deref())?;
    let mut source = args.input.clone();
    if let Some(earlier) = &earlier {
        let size = (earlier.session.width, earlier.session.height);
        source.size = source.size.or(Some(size));
        if matches!(align, Align::FirstCamera) {
            align = Align::Map {
                map_from_world: earlier.map_from_world,
                description: earlier.frame_description.clone(),
                is_metric: earlier.is_metric,
            };
        }
    }
    let mut input = Input::open(&args.source, &source)?;
    if let Some(earlier) = &earlier {
        earlier.check_camera(&input)?;
        input.warnings.extend(earlier.warnings.iter().cloned());
    }
    let seed_depth = seed_depth(&input, args)?;
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from("runs").join(&input.name));
    refuse_output_inside_source(&out, &args.source)?;
    if let Some(continued) = &args.continue_from {
        refuse_output_in_place(&out, continued)?;
    }
    let folder = OutputFolder::prepare(&out, args.force)?;
    let settings = RunSettings {
        config,
        seed_depth,
        continued: earlier.map(|earlier| Continued {
            earlier,
            purpose: if args.localise_only {
                Purpose::LocaliseOnly
            } else {
                Purpose::Extend
            },
        }),
        realtime: args.realtime,
        threads,
        show_progress: std::io::stderr().is_terminal(),
    };
    describe_input(&input);
    let finished = run_all(&input, &folder, &settings, &align, |_, _, _| {
        Ok(Extras::default())
    })?;
    conclude(&finished, &folder, args.json.json)
}

/// The settings of the command line; those of the continued run where none are named.
fn configuration(args: &RunArgs, earlier: Option<&Earlier>) -> Result<RunConfig, Failure> {
    if let Some(earlier) = earlier
        && args.config.is_none()
        && args.profile.is_none()
    {
        let recorded = RunConfig::recorded(&earlier.session.config).ok_or_else(|| {
            Failure::input(format!(
                "the settings in {} cannot be understood by this version; choose some with --profile or --config",
                earlier.path.display()
            ))
        })?;
        return recorded.with_settings(&args.set);
    }
    RunConfig::resolve(
        args.profile.map(Into::into),
        args.config.as_deref(),
        &args.set,
    )
}

/// The run that is continued must not be emptied for the new one.
fn refuse_output_in_place(out: &Path, continued: &Path) -> Result<(), Failure> {
    let (Ok(out), Ok(continued)) = (out.canonicalize(), continued.canonicalize()) else {
        return Ok(());
    };
    if continued.starts_with(&out) {
        return Err(Failure::input(format!(
            "the output folder {} holds the run to continue; choose another with --out",
            out.display()
        )));
    }
    Ok(())
}

/// What a caller adds to summary and report.
#[derive(Debug, Default)]
pub struct Extras {
    /// Reference path in the frame of the results.
    pub reference: Vec<[f64; 3]>,
    /// Error of the depth, JSON.
    pub depth: Option<serde_json::Value>,
    /// Error of the global map, JSON.
    pub map: Option<serde_json::Value>,
    /// More for the user to know.
    pub warnings: Vec<String>,
}

/// A run whose files are written.
#[derive(Debug)]
pub struct Finished {
    /// Numbers.
    pub summary: Summary,
    /// One sentence for people.
    pub verdict: String,
    /// Which exit code.
    pub outcome: Outcome,
    /// Why it failed although everything that exists was saved.
    pub failure: Option<String>,
}

/// Tracks, maps and writes everything. `extras` may evaluate against a truth.
pub fn run_all(
    input: &Input,
    folder: &OutputFolder,
    settings: &RunSettings,
    align: &Align,
    extras: impl FnOnce(&Tracked, &MapFrame, Option<&Maps>) -> Result<Extras, Failure>,
) -> Result<Finished, Failure> {
    // a second handler in one process is refused, which does no harm
    let _ = ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("interrupted: saving (once more to stop at once)");
    });
    let config_text = settings.config.to_toml()?;
    folder.write("config.toml", &config_text)?;
    let mut tracked = track(input, folder, settings, &INTERRUPTED)?;
    let trajectory: Vec<_> = tracked
        .trajectory
        .iter()
        .map(|pose| (pose.timestamp_ns, pose.world_from_camera))
        .collect();
    let (frame, align_warning) = align.frame(&trajectory);
    outputs::write_tables(folder, &tracked, &frame, settings)?;
    let mut warnings = input.warnings.clone();
    warnings.extend(align_warning);
    let path: Vec<[f64; 3]> = tracked
        .trajectory
        .iter()
        .map(|pose| {
            in_map(&frame.map_from_world, &pose.world_from_camera)
                .translation
                .into()
        })
        .collect();
    let maps = final_maps(&mut tracked, &frame, &path, settings);
    let (maps, failure) = match maps {
        Ok(maps) => (maps, early_failure(&tracked)),
        Err(error) => (None, Some(error)),
    };
    let preview = match &maps {
        Some(maps) => Some(outputs::write_maps(folder, maps, &path)?),
        None => None,
    };
    let closed_loops = tracked.slam.graph_stats().loop_closures > 0;
    let reported_path = if closed_loops {
        outputs::reported_path(&tracked, &frame)
    } else {
        Vec::new()
    };
    let loops = match maps.as_ref().filter(|_| closed_loops) {
        Some(maps) => Some(outputs::write_loop_pictures(
            folder,
            maps,
            &reported_path,
            &path,
        )?),
        None => None,
    };
    let extras = extras(&tracked, &frame, maps.as_ref())?;
    warnings.extend(extras.warnings);
    let mut summary = summarise(input, settings, &tracked, &frame, maps.as_ref(), warnings);
    summary.depth = extras.depth;
    summary.map_error = extras.map;
    let outcome = match summary.status {
        "not_initialised" | "not_recognised" | "lost" | "fragment" => Outcome::NotTracked,
        _ => Outcome::Done,
    };
    let verdict = verdict(&summary, &tracked);
    let report = page(
        &tracked,
        &ReportInput {
            title: &format!("monogrid: {}", input.name),
            verdict: &verdict,
            summary: &summary,
            frame: &frame,
            path: &path,
            reported_path: &reported_path,
            reference: &extras.reference,
            preview: preview.as_deref(),
            loops: loops.as_ref(),
            config: &config_text,
        },
    );
    folder.write("report.html", report)?;
    folder.complete();
    finish_times(&mut summary);
    let json = serde_json::to_string_pretty(&summary).map_err(Failure::running)?;
    folder.write("summary.json", json + "\n")?;
    Ok(Finished {
        summary,
        verdict,
        outcome,
        failure,
    })
}

/// Says how it went; the exit code.
pub fn conclude(finished: &Finished, folder: &OutputFolder, json: bool) -> CommandResult {
    let text = format!(
        "{}\n{}\n",
        finished.verdict,
        summary_lines(&finished.summary, folder.path())
    );
    if json {
        eprint!("{text}");
        print_json(&finished.summary)?;
    } else {
        print!("{text}");
    }
    match &finished.failure {
        Some(reason) => Err(Failure::running(format!(
            "{reason} (what was found until then is saved in {})",
            folder.path().display()
        ))),
        None => Ok(finished.outcome),
    }
}

/// The final maps; `None` without keyframes.
fn final_maps(
    tracked: &mut Tracked,
    frame: &MapFrame,
    path: &[[f64; 3]],
    settings: &RunSettings,
) -> Result<Option<Maps>, String> {
    let unfinished = Err(monogrid_occupancy::MapError::Scan {
        id: 0,
        reason: "the maps were taken".into(),
    });
    let live =
        std::mem::replace(&mut tracked.live_maps, unfinished).map_err(|error| error.to_string())?;
    if tracked.slam.keyframes().is_empty() || settings.is_localise_only() {
        return Ok(None);
    }
    let before = process_cpu();
    let camera = path.last().map(|point| Vec3::from(*point));
    let mut maps = live
        .finish(
            &tracked.snapshot,
            &frame.map_from_world,
            camera,
            settings.threads,
        )
        .map_err(|error| error.to_string())?;
    for map in [&mut maps.global, &mut maps.large, &mut maps.local] {
        map.pack(settings.threads);
    }
    tracked.cpu.mapping += process_cpu() - before;
    Ok(Some(maps))
}

fn early_failure(tracked: &Tracked) -> Option<String> {
    match &tracked.early_end {
        Some(EarlyEnd::Unreadable(reason)) => Some(format!(
            "{} images in a row cannot be used, the last because: {reason}",
            crate::input::MAX_UNREADABLE_IN_A_ROW
        )),
        _ => None,
    }
}

fn summarise(
    input: &Input,
    settings: &RunSettings,
    tracked: &Tracked,
    frame: &MapFrame,
    maps: Option<&Maps>,
    mut warnings: Vec<String>,
) -> Summary {
    let count =
        |test: fn(&FrameFate) -> bool| tracked.rows.iter().filter(|r| test(&r.fate)).count();
    let skipped = count(|fate| matches!(fate, FrameFate::Skipped(_)));
    let dropped = count(|fate| matches!(fate, FrameFate::Dropped));
    if skipped > 0 {
        warnings.push(format!(
            "{skipped} frames could not be used and were skipped"
        ));
    }
    let status = match &tracked.early_end {
        Some(EarlyEnd::Unreadable(_)) => "unreadable",
        _ if tracked.slam.keyframes().is_empty() => "not_initialised",
        _ if settings.continued.is_some() && tracked.trajectory.is_empty() => "not_recognised",
        _ => match end_of(&tracked.rows) {
            End::Lost => "lost",
            End::Fragment if !has_last_frame(tracked) => "fragment",
            _ if tracked.early_end.is_some() => "interrupted",
            _ => "done",
        },
    };
    let is_metric = tracked.slam.scale() == Scale::Metric || frame.is_aligned;
    let points = maps.map_or(0, |maps| maps.stats.points);
    let (width, height) = input.size();
    Summary {
        source: input.name.clone(),
        version: env!("CARGO_PKG_VERSION"),
        status,
        frames: tracked.rows.len(),
        tracked: tracked.trajectory.len(),
        skipped,
        dropped,
        lost_episodes: tracked.slam.lost_episodes(),
        keyframes: tracked.slam.keyframes().len(),
        reactivated_keyframes: tracked.slam.reactivations(),
        relocalisations: tracked.slam.relocalisations(),
        fragments: tracked
            .slam
            .fragments()
            .iter()
            .map(FragmentSummary::new)
            .collect(),
        sessions: sessions(
            &tracked.slam,
            settings.continued.as_ref().map(|c| &c.earlier),
            &input.name,
        )
        .into_iter()
        .map(|session| SessionSummary {
            source: session.source,
            first_keyframe: session.first_keyframe,
        })
        .collect(),
        localise_only: settings.is_localise_only(),
        constraints: tracked.slam.graph_stats().constraints,
        graph_wait_ms: tracked.slam.graph_stats().max_wait_ms,
        loop_closures: tracked.slam.graph_stats().loop_closures,
        points,
        frames_per_second: 0.0,
        seconds: Seconds {
            total: 0.0,
            ..stage_seconds(tracked, &tracked.cpu)
        },
        mapping_seconds_per_100k_points: if points > 0 {
            tracked.cpu.mapping.as_secs_f64() * 1e5 / points as f64
        } else {
            0.0
        },
        map: MapFacts {
            resolution: settings.config.mapping.resolution,
            leaves: maps.map_or(0, |maps| maps.global.leaf_count()),
            bytes_in_memory: maps.map_or(0, |maps| maps.global.bytes_in_memory()),
        },
        peak_rss_bytes: peak_rss_bytes(),
        scale: if is_metric { "metric" } else { "arbitrary" },
        frame: frame.description.clone(),
        profile: settings.config.profile.name(),
        seed: settings.config.seed,
        working_size: [width, height],
        threads: settings.threads,
        warnings,
        trajectory: frame
            .fit
            .as_ref()
            .and_then(|fit| serde_json::to_value(fit).ok()),
        depth: None,
        map_error: None,
    }
    .timed()
}

/// Whether the last frame is in the map: a fragment may have been joined when the run was over.
fn has_last_frame(tracked: &Tracked) -> bool {
    let last = tracked.rows.iter().rev().find_map(FrameRow::report);
    let placed = tracked.trajectory.last();
    last.zip(placed)
        .is_some_and(|(last, placed)| placed.frame_index >= last.index)
}

impl Summary {
    fn timed(mut self) -> Self {
        finish_times(&mut self);
        self
    }
}

/// Brings the numbers that grow until the last file is written up to date.
fn finish_times(summary: &mut Summary) {
    let total = process_start().elapsed().as_secs_f64();
    summary.seconds.total = total;
    summary.frames_per_second = summary.frames as f64 / total.max(1e-9);
    summary.peak_rss_bytes = peak_rss_bytes();
}

/// One sentence for people.
fn verdict(summary: &Summary, tracked: &Tracked) -> String {
    let share = 100.0 * summary.tracked as f64 / summary.frames.max(1) as f64;
    let num_apart = num_apart(summary);
    match summary.status {
        "not_initialised" => {
            let last = tracked.rows.iter().rev().find_map(|row| row.report());
            let reason = last
                .and_then(|report| report.reason)
                .map(|reason| reason.to_string())
                .unwrap_or_else(|| "no usable frame".into());
            format!(
                "Tracking never started ({reason}). The camera must move sideways while it sees texture; there is no map."
            )
        }
        "not_recognised" if num_apart > 0 => format!(
            "The camera was never recognised in the map. What it saw is kept as {num_apart} fragment(s) beside it, which a later run may join."
        ),
        "not_recognised" => "The camera was never recognised in the map: no frame shows a place that it holds. The map is as it was.".to_owned(),
        "fragment" => format!(
            "Tracking was lost and went on in a fragment that was never recognised as part of the map; {share:.0} % of the frames have a pose in the map."
        ),
        "lost" => format!(
            "Tracking was lost for good; {share:.0} % of the frames have a pose, and what was mapped until then is saved."
        ),
        "unreadable" => format!(
            "The images became unreadable; {share:.0} % of the frames until then have a pose."
        ),
        "interrupted" => format!(
            "Interrupted; {share:.0} % of the frames until then have a pose, everything is saved."
        ),
        _ if summary.lost_episodes > 0 => format!(
            "{share:.0} % of the frames have a pose; tracking was lost {} times and found again.",
            summary.lost_episodes
        ),
        _ => format!("{share:.0} % of the frames have a pose; tracking was never lost."),
    }
}

/// Fragments that were not joined.
fn num_apart(summary: &Summary) -> usize {
    let fragments = summary.fragments.iter();
    fragments.filter(|f| f.joined_into.is_none()).count()
}

fn summary_lines(summary: &Summary, folder: &Path) -> String {
    let unit = if summary.scale == "metric" {
        "m"
    } else {
        "map units (scale unknown)"
    };
    let memory = summary
        .peak_rss_bytes
        .map(|bytes| format!(", {:.0} MB of memory", bytes as f64 / 1e6))
        .unwrap_or_default();
    let mut lines = if summary.localise_only {
        format!(
            "  {} frames; the map of {} keyframes stays as it is, no new one is written\n",
            summary.frames, summary.keyframes
        )
    } else {
        format!(
            "  {} frames, {} keyframes, {} measurements mapped\n  \
             map: cells of {} {unit}, {} leaves\n",
            summary.frames,
            summary.keyframes,
            summary.points,
            summary.map.resolution,
            summary.map.leaves,
        )
    };
    if !summary.fragments.is_empty() {
        let num_apart = num_apart(summary);
        lines += &format!(
            "  {} fragments after losses, {} joined to the map, {num_apart} apart\n",
            summary.fragments.len(),
            summary.fragments.len() - num_apart
        );
    }
    lines += &format!(
        "  {:.1} s, {:.1} frames per second{memory}\n",
        summary.seconds.total, summary.frames_per_second,
    );
    if let Some(ate) = summary
        .trajectory
        .as_ref()
        .and_then(|t| t.get("ate_rmse")?.as_f64())
    {
        lines += &format!("  error against the reference: {ate:.4} m\n");
    }
    if let Some(within) = number_at(summary.depth.as_ref(), &["within_3_percent"]) {
        lines += &format!(
            "  depth: {:.0} % of the textured pixels within 3 %\n",
            100.0 * within
        );
    }
    let observed =
        |name: &str| number_at(summary.map_error.as_ref(), &["policies", "observed", name]);
    if let (Some(auc), Some(mcc)) = (observed("auc"), observed("mcc")) {
        lines += &format!("  map against the truth: AUC {auc:.3}, MCC {mcc:.3}\n");
    }
    lines += &format!("  look at {}", folder.join("report.html").display());
    lines
}

/// A number inside a JSON object.
pub fn number_at(value: Option<&serde_json::Value>, path: &[&str]) -> Option<f64> {
    path.iter()
        .try_fold(value?, |value, key| value.get(key))?
        .as_f64()
}

fn describe_input(input: &Input) {
    let (width, height) = input.size();
    eprintln!(
        "{}: {} frames of {}x{} pixels, working size {width}x{height}",
        input.name,
        input.frames.len(),
        input.camera.width,
        input.camera.height
    );
    if !input.interpretation.is_empty() {
        eprintln!("calibration: {}", input.interpretation);
    }
    for warning in &input.warnings {
        eprintln!("warning: {warning}");
    }
}

/// An output folder that holds the source, or is it, must never be emptied.
fn refuse_output_inside_source(out: &Path, source: &Path) -> Result<(), Failure> {
    let (Ok(out), Ok(source)) = (out.canonicalize(), source.canonicalize()) else {
        return Ok(());
    };
    if source.starts_with(&out) {
        return Err(Failure::input(format!(
            "the output folder {} holds the source; choose another with --out",
            out.display()
        )));
    }
    Ok(())
}

/// The depth to start with and its frame.
fn seed_depth(input: &Input, args: &RunArgs) -> Result<Option<(usize, GrayImage)>, Failure> {
    let (Some(argument), Images::Files(dataset)) = (&args.seed_depth, &input.images) else {
        return Ok(None);
    };
    let calibration =
        crate::input::depth_calibration(dataset, args.depth_calibration.as_deref(), &input.camera)?;
    if argument != "dataset" {
        let first = input.frames.first().map_or(0, |frame| frame.index);
        let depth = input.read_depth(Path::new(argument), &calibration)?;
        return Ok(Some((first, depth)));
    }
    let seed = dataset_seed_depth(input, args.depth_calibration.as_deref())?;
    if seed.is_none() {
        return Err(Failure::input(format!(
            "--seed-depth dataset: {} has no depth image for any of the frames to use",
            dataset.root.display()
        )));
    }
    Ok(seed)
}

/// The first depth image of the source that belongs to a frame to use, and that frame's index.
pub fn dataset_seed_depth(
    input: &Input,
    calibration: Option<&Path>,
) -> Result<Option<(usize, GrayImage)>, Failure> {
    let Images::Files(dataset) = &input.images else {
        return Ok(None);
    };
    let seeded = input
        .frames
        .iter()
        .find_map(|frame| Some((frame, dataset.depth_of_frame(frame.timestamp_ns)?)));
    let Some((frame, entry)) = seeded else {
        return Ok(None);
    };
    let calibration = crate::input::depth_calibration(dataset, calibration, &input.camera)?;
    let depth = input.read_depth(&entry.path, &calibration)?;
    Ok(Some((frame.index, depth)))
}
