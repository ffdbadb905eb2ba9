//! `monogrid batch`: many recordings, each by a run of its own.

use crate::batch::class::Class;
use crate::batch::keys::parse_key;
use crate::batch::list::{lists, read_sources};
use crate::batch::outputs::{Written, refuse_collisions};
use crate::batch::record::TaskRecord;
use crate::batch::schedule::{self, Carried, Limits, available_memory};
use crate::batch::task::{Task, tasks};
use crate::batch::work::{Job, Outcome};
use crate::commands::warn;
use clap::Args;
use monogrid_app::args::{JsonArg, positive};
use monogrid_app::output::OutputFolder;
use monogrid_app::process::console::is_drawn;
use monogrid_app::process::failure::{CommandResult, Failure, Outcome as Ended};
use monogrid_app::process::progress::Progress;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// `monogrid batch`.
#[derive(Debug, Args)]
pub struct BatchArgs {
    /// Lists of recordings (.txt, .tsv, - for standard input), recordings, and folders of
    /// recordings
    #[arg(required = true, value_name = "LIST|SOURCE|FOLDER")]
    pub sources: Vec<PathBuf>,
    /// Output folder; a batch that was interrupted goes on where it was
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
    /// Option of `monogrid run` for all recordings of which the list says nothing else, e.g. --each
    /// max-frames=300
    #[arg(long, value_name = "KEY=VALUE")]
    pub each: Vec<String>,
    /// Recordings at once [default: all cores]; the results do not depend on it
    #[arg(
        long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024),
        help_heading = "Resources"
    )]
    pub jobs: Option<u16>,
    /// Threads of each run [default: the cores, shared by those at once]; the results do not depend
    /// on it
    #[arg(
        long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024),
        help_heading = "Resources"
    )]
    pub threads: Option<u16>,
    /// Memory that all runs may take together, GB [default: 80 % of what is free]
    #[arg(long, value_name = "GB", value_parser = positive, help_heading = "Resources")]
    pub memory: Option<f64>,
    /// Stop a run that takes longer, seconds; what it has mapped until then is saved [default:
    /// never]
    #[arg(long, value_name = "S", value_parser = positive, help_heading = "Resources")]
    pub timeout: Option<f64>,
    /// Do recordings of these classes again although nothing has changed
    #[arg(long, value_name = "CLASS,...", value_enum, value_delimiter = ',')]
    pub retry: Vec<Class>,
    /// Only the recording of this name
    #[arg(long, value_name = "NAME", conflicts_with = "number")]
    pub task: Option<String>,
    /// Only the recording at this place of the list, counted from 1
    #[arg(long, value_name = "N")]
    pub number: Option<usize>,
    /// Say what would be done, and do nothing
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Carries out all tasks that are not done.
pub fn execute(args: &BatchArgs) -> CommandResult {
    let (listed, said) = read_sources(&args.sources, &args.out)?;
    warn(&said);
    let keys: Result<Vec<_>, _> = args.each.iter().map(|k| parse_key(k, "--each")).collect();
    let tasks = tasks(&listed, &keys?)?;
    let read = lists(&args.sources);
    refuse_collisions(&tasks, &args.out, read.paths())?;
    let written = Written::of(&tasks, &args.out);
    let tasks = chosen(tasks, args)?;
    let available = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let jobs = args.jobs.map_or(available, usize::from).min(tasks.len());
    let job = Job {
        out: &args.out,
        written: &written,
        force: args.force,
        threads: args
            .threads
            .map_or((available / jobs.max(1)).max(1), usize::from),
        timeout: args.timeout.map(|s| Duration::from_secs_f64(s.min(1e9))),
        retry: &args.retry,
        waits: args.task.is_some() || args.number.is_some(),
        interrupted: &INTERRUPTED,
    };
    if args.dry_run {
        return say_plan(&tasks, &job, args.json);
    }
    prepare(args, &tasks, &job)?;
    stop_when_interrupted();
    let limits = Limits {
        jobs,
        memory_bytes: memory(args),
    };
    let outcomes = carry_out(&tasks, &job, limits);
    conclude(args, &tasks, &outcomes)
}

/// Those that were asked for.
fn chosen(all: Vec<Task>, args: &BatchArgs) -> Result<Vec<Task>, Failure> {
    let count = all.len();
    let (place, expected) = match (&args.task, args.number) {
        (Some(name), _) => (
            all.iter().position(|task| task.name == *name),
            format!(
                "--task {name}: none of the {count} recordings has this name; --dry-run says their \
                 names"
            ),
        ),
        (None, Some(number)) => (
            number.checked_sub(1),
            format!("--number {number}: expected 1 to {count}"),
        ),
        (None, None) => return Ok(all),
    };
    let task = place.and_then(|place| all.into_iter().nth(place));
    Ok(vec![task.ok_or_else(|| Failure::input(expected))?])
}

/// Refuses a destination that must not be written to, before anything is.
fn prepare(args: &BatchArgs, tasks: &[Task], job: &Job) -> Result<(), Failure> {
    let sources = tasks.iter().map(|task| &task.source);
    let files = tasks.iter().flat_map(|task| &task.option_files);
    let inputs = lists(&args.sources)
        .and_all("a recording", sources)
        .and_all("a file of an option", files);
    for task in tasks {
        OutputFolder::check(&job.task_folder(task), args.force)?;
    }
    OutputFolder::of_folders(&args.out, args.force, &inputs)
}

/// The first Ctrl-C lets the runs save what they have, a second one ends them.
fn stop_when_interrupted() {
    // a second handler in one process is refused, which does no harm
    let _ = ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("interrupted: the runs save what they have (once more to stop at once)");
    });
}

/// Share of the free memory that is used when nothing else is said.
const MEMORY_SHARE: f64 = 0.8;

fn memory(args: &BatchArgs) -> Option<u64> {
    let asked = args.memory.map(|gigabytes| (gigabytes * 1e9) as u64);
    asked.or_else(|| Some((available_memory()? as f64 * MEMORY_SHARE) as u64))
}

/// What became of each; none for those that were not begun.
fn carry_out(tasks: &[Task], job: &Job, limits: Limits) -> Vec<Option<Outcome>> {
    let outcomes = Mutex::new(vec![None; tasks.len()]);
    let keep = |index: usize, outcome: Outcome| {
        let mut outcomes = outcomes.lock().unwrap_or_else(PoisonError::into_inner);
        outcomes[index] = Some(outcome);
    };
    let mut missing = Vec::new();
    for (index, task) in tasks.iter().enumerate() {
        match job.done(task) {
            Some(record) => keep(index, Outcome::Done(Box::new(record))),
            None => {
                let before = TaskRecord::read(&job.task_folder(task));
                missing.push((index, before.and_then(|record| record.peak_rss_bytes)));
            }
        }
    }
    if missing.len() < tasks.len() {
        let done = tasks.len() - missing.len();
        eprintln!("{done} of {} recordings are done already", tasks.len());
    }
    let progress = Progress::new(missing.len(), "recordings", is_drawn());
    let left = schedule::run(&missing, limits, &|index, attempt, peak| {
        let outcome = job.carry_out(&tasks[index], attempt, peak);
        progress.done(&format!("{}: {}", tasks[index].name, line(&outcome)));
        let carried = carried(&outcome);
        keep(index, outcome);
        carried
    });
    progress.finish();
    if left > 0 {
        eprintln!("{left} recordings were not begun");
    }
    let outcomes = outcomes.into_inner();
    outcomes.unwrap_or_else(PoisonError::into_inner)
}

fn carried(outcome: &Outcome) -> Carried {
    let (class, peak_bytes) = match outcome {
        Outcome::Carried(record) => (record.class, record.peak_rss_bytes),
        // what it took is known, but it does not run
        Outcome::Done(_) | Outcome::Elsewhere => (Class::Ok, None),
        Outcome::Refused(class, _) => (*class, None),
    };
    Carried { class, peak_bytes }
}

/// What is said of a task when it is done.
fn line(outcome: &Outcome) -> String {
    let record = match outcome {
        Outcome::Carried(record) => record,
        Outcome::Done(record) => return format!("{}, done already", record.class.name()),
        Outcome::Elsewhere => return "another process works on it".to_owned(),
        Outcome::Refused(class, reason) => return format!("{}: {reason}", class.name()),
    };
    let mut text = record.class.name().to_owned();
    if record.class != Class::Ok {
        text += &format!(": {}", record.reason);
    }
    if let Some(metrics) = &record.metrics {
        let share = (100.0 * metrics.coverage()).floor();
        text += &format!(
            ", {share:.0} % of {} frames, {:.1} per second",
            metrics.frames, metrics.frames_per_second
        );
        if let Some(ate) = metrics.ate_rmse_m {
            text += &format!(", error {ate:.4} m");
        }
    }
    let memory = record
        .peak_rss_bytes
        .map(|b| format!(", {:.0} MB", b as f64 / 1e6));
    text + &memory.unwrap_or_default()
}

/// `batch --dry-run --json`, for each recording.
#[derive(Debug, Serialize)]
struct Planned<'a> {
    name: &'a str,
    source: String,
    options: &'a [String],
    /// As in `task.json`.
    settings_sha256: &'a str,
    /// As in `task.json`.
    version: &'static str,
    /// What became of it, where it is done.
    done: Option<&'static str>,
    /// Memory that it took when it was tried before.
    peak_rss_bytes: Option<u64>,
}

fn say_plan(tasks: &[Task], job: &Job, json: JsonArg) -> CommandResult {
    let planned = tasks.iter().map(|task| Planned {
        name: &task.name,
        source: task.source.display().to_string(),
        options: &task.options,
        settings_sha256: &task.settings_sha256,
        version: env!("CARGO_PKG_VERSION"),
        done: job.done(task).map(|record| record.class.name()),
        peak_rss_bytes: TaskRecord::read(&job.task_folder(task))
            .and_then(|record| record.peak_rss_bytes),
    });
    let planned: Vec<Planned> = planned.collect();
    json.print(&planned, || {
        for task in &planned {
            let state = task.done.unwrap_or("to do");
            println!("{}\t{state}\t{}", task.name, task.source);
        }
    })
}

/// `batch --json`.
#[derive(Debug, Serialize)]
struct BatchReport {
    recordings: usize,
    /// Carried out by this call.
    carried_out: usize,
    /// Done before.
    done_before: usize,
    /// Not begun, or done by another process at this moment.
    left: usize,
    /// Recordings by what became of them.
    classes: BTreeMap<&'static str, usize>,
}

fn conclude(args: &BatchArgs, tasks: &[Task], outcomes: &[Option<Outcome>]) -> CommandResult {
    let class = |outcome: &Outcome| match outcome {
        Outcome::Carried(record) | Outcome::Done(record) => Some(record.class),
        Outcome::Refused(class, _) => Some(*class),
        Outcome::Elsewhere => None,
    };
    let classes: Vec<Class> = outcomes.iter().flatten().filter_map(class).collect();
    let count = |test: fn(&Outcome) -> bool| outcomes.iter().flatten().filter(|o| test(o)).count();
    let mut report = BatchReport {
        recordings: tasks.len(),
        carried_out: count(|o| matches!(o, Outcome::Carried(_))),
        done_before: count(|o| matches!(o, Outcome::Done(_))),
        left: tasks.len() - classes.len(),
        classes: BTreeMap::new(),
    };
    for class in &classes {
        *report.classes.entry(class.name()).or_default() += 1;
    }
    args.json.print(&report, || {
        let said = Class::all().iter().filter_map(|class| {
            let count = report.classes.get(class.name())?;
            Some(format!("{count} {}", class.name()))
        });
        let mut said: Vec<String> = said.collect();
        if report.left > 0 {
            said.push(format!("{} left", report.left));
        }
        let (out, said) = (args.out.display(), said.join(", "));
        println!("{} recordings in {out}: {said}", report.recordings);
    })?;
    outcome_of(&classes)
}

/// The exit code says the worst: interrupted, a run that failed, a recording without a good map.
fn outcome_of(classes: &[Class]) -> CommandResult {
    let is_fault = |class: &&Class| (Class::Timeout..=Class::NoSpace).contains(class);
    let failed = classes.iter().filter(is_fault).count();
    if classes.contains(&Class::Interrupted) || INTERRUPTED.load(Ordering::Relaxed) {
        Ok(Ended::Interrupted)
    } else if failed > 0 {
        Err(Failure::running(format!(
            "{failed} runs did not come to an end of their own"
        )))
    } else if classes.iter().any(|class| *class != Class::Ok) {
        Ok(Ended::NotTracked)
    } else {
        Ok(Ended::Done)
    }
}
