//! `task.json`: what became of a recording.

use super::class::Class;
use super::digest::{InputRecord, OutputRecord};
use super::metrics::Metrics;
use super::task::Task;
use monogrid_datasets::read_text;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Name of the file.
pub const TASK_FILE: &str = "task.json";
/// Version of its form.
const FORMAT: u32 = 1;

/// Files of a run whose content holds times of that very run: they are hashed, but no part of the
/// hash of the result.
const WITH_TIMES: [&str; 4] = [
    "summary.json",
    "report.html",
    "frames.csv",
    "monogrid-manifest.txt",
];

/// The content of `task.json`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TaskRecord {
    /// Version of the form of this file.
    pub format: u32,
    /// Name of the recording in the batch.
    pub name: String,
    /// What was read.
    pub source: String,
    /// Options of `monogrid run`.
    pub options: Vec<String>,
    /// What became of it.
    pub class: Class,
    /// Why, in one sentence.
    pub reason: String,
    /// Exit code of the run, where it had one.
    pub exit_code: Option<i32>,
    /// Times that it was tried in the call that wrote this.
    pub attempts: u32,
    /// Version of the program.
    pub version: String,
    /// SHA-256 of the effective settings (`config.toml` of the run).
    pub settings_sha256: String,
    /// What was read, by content; absent where it could not be.
    pub input: Option<InputRecord>,
    /// SHA-256 of the lines `HASH  NAME` of all outputs that hold no times: equal wherever the same
    /// was computed.
    pub result_sha256: Option<String>,
    /// When the run began, seconds since 1970.
    pub began_unix_s: u64,
    /// Wall time, s.
    pub wall_s: f64,
    /// Limit of the wall time that it had, s.
    pub timeout_s: Option<f64>,
    /// CPU time, s, where the system says it.
    pub cpu_s: Option<f64>,
    /// Largest resident memory, bytes, where the system says it.
    pub peak_rss_bytes: Option<u64>,
    /// Numbers of its `summary.json`.
    pub metrics: Option<Metrics>,
    /// What the run wrote, by name.
    pub outputs: BTreeMap<String, OutputRecord>,
    /// What it wrote beside its folder (`mcap`), by path.
    #[serde(default)]
    pub files: BTreeMap<String, OutputRecord>,
}

impl TaskRecord {
    /// A task that has begun.
    pub fn begun(task: &Task, began_unix_s: u64, timeout_s: Option<f64>) -> Self {
        Self {
            format: FORMAT,
            name: task.name.clone(),
            source: task.source.display().to_string(),
            options: task.options.clone(),
            class: Class::Unfinished,
            reason: "it has begun, and its end was not seen".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            settings_sha256: task.settings_sha256.clone(),
            began_unix_s,
            timeout_s,
            ..Self::default()
        }
    }

    /// The record in a folder; none where there is none, or one that is not understood.
    pub fn read(folder: &Path) -> Option<Self> {
        let text = read_text(&folder.join(TASK_FILE)).ok()?;
        Self::parse(&text)
    }

    /// The record that a text holds.
    pub fn parse(text: &str) -> Option<Self> {
        let record: Self = serde_json::from_str(text).ok()?;
        (record.format == FORMAT).then_some(record)
    }

    /// Takes the outputs, and the hash of the result.
    pub fn take_outputs(&mut self, outputs: Vec<(String, OutputRecord)>) {
        let holds_time = |name: &String| WITH_TIMES.contains(&name.as_str());
        let results = outputs.iter().filter(|(name, _)| !holds_time(name));
        let lines: String = results
            .map(|(name, output)| format!("{}  {name}\n", output.sha256))
            .collect();
        self.result_sha256 = Some(super::sha256::sha256_of(lines.as_bytes()));
        self.outputs = outputs.into_iter().collect();
    }

    /// Whether it is of the same work: source, options, settings and version.
    pub fn is_of(&self, task: &Task) -> bool {
        self.source == task.source.display().to_string()
            && self.options == task.options
            && self.settings_sha256 == task.settings_sha256
            && self.version == env!("CARGO_PKG_VERSION")
    }

    /// Whether all that the run wrote is still where it was, as large as it was.
    pub fn has_outputs(&self, run: &Path) -> bool {
        let in_run = self
            .outputs
            .iter()
            .map(|(name, output)| (run.join(name), output));
        let beside = self
            .files
            .iter()
            .map(|(path, output)| (path.into(), output));
        in_run.chain(beside).all(|(path, output)| {
            let metadata = std::fs::metadata(path);
            metadata.is_ok_and(|metadata| metadata.is_file() && metadata.len() == output.bytes)
        })
    }

    /// Whether it wrote this file, which is as it was.
    pub fn wrote(&self, path: &Path) -> bool {
        let output = path.to_str().and_then(|path| self.files.get(path));
        output.is_some_and(|output| OutputRecord::of(path).is_ok_and(|found| found == *output))
    }
}
