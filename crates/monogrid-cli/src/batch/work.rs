//! One task: found done, or carried out.

use super::child::{self, Ended, Watch};
use super::class::{Class, End};
use super::digest::{OutputRecord, read_inputs, read_outputs, stamp};
use super::metrics::Metrics;
use super::outputs::Written;
use super::record::{TASK_FILE, TaskRecord};
use super::schedule::Grown;
use super::task::Task;
use monogrid_app::output::{Content, OutputFolder, place_of_file};
use monogrid_app::process::failure::{Classify, Failure};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// What the run said.
const LOG_FILE: &str = "log.txt";
/// Time between looks at a folder that another process holds.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// How often a folder that another process holds is looked at before it is believed to be at work
/// there.
const GLANCES: u32 = 10;
/// Bytes at the end of the log in which the last thing that was said is looked for.
const LAST_WORDS: u64 = 16_384;

/// How all tasks of a batch are carried out.
#[derive(Debug)]
pub struct Job<'a> {
    /// Where results go.
    pub out: &'a Path,
    /// All that the batch writes.
    pub written: &'a Written,
    /// Write beside what others wrote.
    pub force: bool,
    /// Threads of each run.
    pub threads: usize,
    /// Each run is stopped after this time.
    pub timeout: Option<Duration>,
    /// Classes that are done again.
    pub retry: &'a [Class],
    /// Wait for another process that works on the same task.
    pub waits: bool,
    /// Everything is stopped when this is set.
    pub interrupted: &'a AtomicBool,
}

/// What became of a task in this call.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// It was carried out.
    Carried(Box<TaskRecord>),
    /// It was done before.
    Done(Box<TaskRecord>),
    /// Another process works on it.
    Elsewhere,
    /// It could not be begun, or its end could not be written: why, and what that is.
    Refused(Class, String),
}

impl Job<'_> {
    /// Folder of what is known of a task.
    pub fn task_folder(&self, task: &Task) -> PathBuf {
        self.out.join("tasks").join(&task.name)
    }

    /// Folder of its run.
    pub fn run_folder(&self, task: &Task) -> PathBuf {
        self.out.join("runs").join(&task.name)
    }

    /// The record of a task that is done: of the same work, with nothing changed since.
    pub fn done(&self, task: &Task) -> Option<TaskRecord> {
        let record = self.finished(task)?;
        let is_same = match (&record.input, stamp(task, self.written)) {
            (Some(input), Ok(stamp)) => input.stamp == stamp,
            // what could not be read cannot be read now; what came of a recording stays when it is
            // gone
            (_, Err(_)) => true,
            (None, Ok(_)) => false,
        };
        is_same.then_some(record)
    }

    /// The record of a task that has ended, whatever is read now.
    fn finished(&self, task: &Task) -> Option<TaskRecord> {
        let record = TaskRecord::read(&self.task_folder(task))?;
        let has_more_time = record.class == Class::Timeout
            && self.timeout.map(|limit| limit.as_secs_f64()) != record.timeout_s;
        let is_done = record.is_of(task)
            && record.class.is_final()
            && !self.retry.contains(&record.class)
            && !has_more_time
            && record.has_outputs(&self.run_folder(task));
        is_done.then_some(record)
    }

    /// Carries out a task, unless it is done; `attempt` counts from 1.
    pub fn carry_out(&self, task: &Task, attempt: u32, peak: &Grown) -> Outcome {
        let folder = match self.hold(task) {
            Ok(Some(folder)) => folder,
            Ok(None) => return Outcome::Elsewhere,
            Err(error) => return refused(Class::BadInput, error),
        };
        // while it was waited for, another process may have done it
        if let Some(record) = self.done(task) {
            return Outcome::Done(Box::new(record));
        }
        let carried = self.carry_out_in(&folder, task, attempt, peak);
        carried.unwrap_or_else(|error| {
            let class = Class::of(End::Exit(1), &format!("{error:?}"), None);
            refused(class, error)
        })
    }

    /// Holds the folder of a task against other processes; `None` where one works on it.
    fn hold(&self, task: &Task) -> Result<Option<OutputFolder>, Failure> {
        let path = self.task_folder(task);
        let mut glances = 0;
        loop {
            if let Some(folder) = OutputFolder::resume_unless_in_use(&path, self.force)? {
                return Ok(Some(folder));
            }
            glances += 1;
            let is_over = self.interrupted.load(Ordering::Relaxed);
            if is_over || glances > GLANCES && !self.waits {
                return Ok(None);
            }
            thread::sleep(LOOK_EVERY);
        }
    }

    fn carry_out_in(
        &self,
        folder: &OutputFolder,
        task: &Task,
        attempt: u32,
        peak: &Grown,
    ) -> Result<Outcome, Failure> {
        let input = read_inputs(task, self.written);
        if let Some(said) = self.refusal(task, input.as_ref().err()) {
            return Ok(Outcome::Refused(Class::BadInput, said));
        }
        if let (Ok(input), Some(mut record)) = (&input, self.finished(task))
            && record.input.as_ref().map(|i| &i.sha256) == Some(&input.sha256)
        {
            // only times have changed
            record.input = Some(input.clone());
            write(folder, &record)?;
            return Ok(Outcome::Done(Box::new(record)));
        }
        let seconds = self.timeout.map(|limit| limit.as_secs_f64());
        let earlier = TaskRecord::read(&self.task_folder(task));
        let mut record = TaskRecord::begun(task, now(), seconds);
        record.input = input.ok();
        record.attempts = attempt;
        write(folder, &record)?;
        let log = folder.begin(LOG_FILE)?;
        self.wait_for_an_earlier_run(task);
        self.remove_earlier_file(task, earlier.as_ref())?;
        let watch = Watch {
            timeout: self.timeout,
            interrupted: self.interrupted,
            peak,
        };
        let begin = SystemTime::now();
        let ended = child::run(&self.arguments(task), &log, watch)?;
        let metrics = Metrics::read(&self.run_folder(task), begin);
        conclude(&mut record, &ended, metrics, &last_words(&log));
        self.doubt(&mut record, task);
        folder.list(LOG_FILE, Content::Whole)?;
        let outputs = read_outputs(&self.run_folder(task));
        record.take_outputs(outputs.while_running("what a run wrote cannot be read")?);
        record.files = self
            .files_beside(task)
            .while_running("what a run wrote cannot be read")?;
        write(folder, &record)?;
        Ok(Outcome::Carried(Box::new(record)))
    }

    /// Why a task is not begun although it is not done: nothing that came of it before would be
    /// left.
    fn refusal(&self, task: &Task, unreadable: Option<&io::Error>) -> Option<String> {
        let run = self.run_folder(task);
        if let Some(error) = unreadable {
            let earlier = TaskRecord::read(&self.task_folder(task));
            let had_map =
                |record: &TaskRecord| record.class == Class::Ok && record.has_outputs(&run);
            return earlier.filter(had_map).map(|_| {
                format!("its recording cannot be read now ({error}); what came of it before stays")
            });
        }
        if let Err(failure) = OutputFolder::check(&run, self.force) {
            return Some(said(failure));
        }
        let file = place_of_mcap(task)?;
        let is_free = self.force || fs::symlink_metadata(&file).is_err();
        let is_ours = || {
            let earlier = TaskRecord::read(&self.task_folder(task));
            earlier.is_some_and(|record| record.wrote(&file)) || OutputFolder::wrote(&run, &file)
        };
        (!is_free && !is_ours()).then(|| {
            format!(
                "output {} exists, and no run of this recording wrote it as it is; choose another \
                 name, or replace it with --force",
                file.display()
            )
        })
    }

    /// Removes the file that an earlier run wrote beside its folder, of which that folder may know
    /// nothing any more.
    fn remove_earlier_file(
        &self,
        task: &Task,
        earlier: Option<&TaskRecord>,
    ) -> Result<(), Failure> {
        let Some(file) = place_of_mcap(task) else {
            return Ok(());
        };
        match earlier.is_some_and(|record| record.wrote(&file)) {
            true => fs::remove_file(&file)
                .while_running(&format!("{} cannot be replaced", file.display())),
            false => Ok(()),
        }
    }

    /// What the run wrote beside its folder.
    fn files_beside(&self, task: &Task) -> io::Result<BTreeMap<String, OutputRecord>> {
        let file = place_of_mcap(task);
        let file = file.filter(|file| OutputFolder::wrote(&self.run_folder(task), file));
        let of_file = |file: PathBuf| Ok((file.display().to_string(), OutputRecord::of(&file)?));
        file.map(of_file).into_iter().collect()
    }

    /// What is said of a recording holds only of what it was when the run began.
    fn doubt(&self, record: &mut TaskRecord, task: &Task) {
        let before = record.input.as_ref().map(|input| &input.stamp);
        let is_same = stamp(task, self.written).ok().as_ref() == before;
        if record.class.is_final() && record.class != Class::Ok && !is_same {
            record.class = Class::Failed;
            record.reason = format!(
                "the recording changed or vanished while it was read; it had said: {}",
                record.reason
            );
        }
    }

    /// Where a batch was killed and its run was not.
    fn wait_for_an_earlier_run(&self, task: &Task) {
        let run = self.run_folder(task);
        while OutputFolder::is_in_use(&run) && !self.interrupted.load(Ordering::Relaxed) {
            thread::sleep(LOOK_EVERY);
        }
    }

    fn arguments(&self, task: &Task) -> Vec<OsString> {
        let mut arguments: Vec<OsString> = vec!["run".into()];
        arguments.extend(task.options.iter().map(OsString::from));
        arguments.extend(["--threads".into(), self.threads.to_string().into()]);
        arguments.extend(["--out".into(), self.run_folder(task).into()]);
        arguments.extend(self.force.then(|| "--force".into()));
        arguments.extend(["--".into(), task.source.clone().into()]);
        arguments
    }
}

fn conclude(record: &mut TaskRecord, ended: &Ended, metrics: Option<Metrics>, said: &str) {
    record.class = Class::of(ended.end, said, metrics.as_ref());
    record.reason = reason(ended.end, said);
    record.metrics = metrics;
    record.exit_code = match ended.end {
        End::Exit(code) => Some(code),
        _ => None,
    };
    record.wall_s = ended.wall.as_secs_f64();
    record.cpu_s = ended.cpu.map(|cpu| cpu.as_secs_f64());
    record.peak_rss_bytes = ended.peak_rss_bytes;
}

fn refused(class: Class, failure: Failure) -> Outcome {
    Outcome::Refused(class, said(failure))
}

fn said(failure: Failure) -> String {
    let error = failure.into_error();
    let causes = std::iter::successors(error.source(), |cause| cause.source());
    let causes: String = causes.map(|cause| format!(": {cause}")).collect();
    format!("{error}{causes}")
}

/// Where the file lies that a task writes beside its folder, whatever the current folder.
fn place_of_mcap(task: &Task) -> Option<PathBuf> {
    task.mcap.as_deref().and_then(place_of_file)
}

fn write(folder: &OutputFolder, record: &TaskRecord) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(record).map_err(Failure::running)?;
    folder.write(TASK_FILE, text + "\n")
}

/// Seconds since 1970.
fn now() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs())
}

/// The last line of a log that is no detail of the one before: a verdict, or an error.
fn last_words(log: &Path) -> String {
    let tail = || -> std::io::Result<Vec<u8>> {
        let mut file = std::fs::File::open(log)?;
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(LAST_WORDS)))?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let bytes = tail().unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let is_detail = |line: &str| line.starts_with([' ', '\t']) || line.starts_with("note: ");
    let is_said = |line: &&str| !line.is_empty() && !is_detail(line);
    let line = text.lines().rev().find(is_said).unwrap_or_default();
    line.strip_prefix("error: ").unwrap_or(line).to_owned()
}

/// Why a run ended so.
fn reason(end: End, said: &str) -> String {
    match end {
        End::Exit(_) => said.to_owned(),
        End::Signal(signal) => format!("ended by signal {signal}; it had said: {said}"),
        End::TooLong => format!("stopped because it took too long; it said: {said}"),
        End::Interrupted => format!("stopped with the batch; it said: {said}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_words_are_a_verdict_or_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let log = dir.path().join("log");
        let said = |text: &str| {
            std::fs::write(&log, text).unwrap();
            last_words(&log)
        };
        assert_eq!(
            said("10 frames\nTracking never started.\n  0 frames\n"),
            "Tracking never started."
        );
        assert_eq!(said("kitchen\nerror: no such file\n"), "no such file");
        assert_eq!(said(""), "");
        assert_eq!(said(&format!("{}\nend\n", "x".repeat(100_000))), "end");
    }
}
