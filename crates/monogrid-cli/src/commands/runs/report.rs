//! `monogrid report`: one page of all recordings of a batch.

use crate::batch::page::page;
use crate::batch::record::{TASK_FILE, TaskRecord};
use clap::Args;
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::failure::{Classify, CommandResult, Failure, Outcome};
use std::path::{Path, PathBuf};

/// `monogrid report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Output folder of `monogrid batch`
    pub batch: PathBuf,
    /// Output folder [default: `report` in that of the batch]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
}

/// Name of the page.
const PAGE: &str = "report.html";

/// Writes the page.
pub fn execute(args: &ReportArgs) -> CommandResult {
    let tasks = args.batch.join("tasks");
    let (records, left_out) = records(&tasks)?;
    if left_out > 0 {
        eprintln!("warning: {left_out} recordings have no task.json that is understood");
    }
    let beside = || args.batch.join("report");
    let out = args.out.clone().unwrap_or_else(beside);
    let task_file = |record: &TaskRecord| tasks.join(&record.name).join(TASK_FILE);
    let task_files = records.iter().map(task_file);
    let inputs = Inputs::of("what is known of the recordings", &tasks)
        .and_all("what is known of a recording", task_files);
    let folder = OutputFolder::replace(&out, args.force, &inputs)?;
    let runs = args.batch.join("runs");
    let real = args.batch.canonicalize();
    let real = real.while_running("the batch is gone")?;
    let link = match out.parent().map(Path::canonicalize) {
        Some(Ok(parent)) if parent == real => "../runs".to_owned(),
        _ => real.join("runs").display().to_string(),
    };
    let name = real.file_name().unwrap_or_default().to_string_lossy();
    folder.write(PAGE, page(&name, &records, &runs, &link))?;
    println!("{} recordings: {}", records.len(), out.join(PAGE).display());
    Ok(Outcome::Done)
}

/// What is known of all recordings, in the order of their names, and how many say nothing.
fn records(tasks: &Path) -> Result<(Vec<TaskRecord>, usize), Failure> {
    let entries = std::fs::read_dir(tasks).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let entries = entries.map_err(|error| {
        Failure::input(format!(
            "{} cannot be read ({error}); expected the output folder of `monogrid batch`",
            tasks.display()
        ))
    })?;
    let mut folders: Vec<PathBuf> = entries.iter().map(std::fs::DirEntry::path).collect();
    folders.sort();
    let found = folders.iter().filter_map(|folder| TaskRecord::read(folder));
    let found: Vec<TaskRecord> = found.collect();
    let left_out = folders.len() - found.len();
    Ok((found, left_out))
}
