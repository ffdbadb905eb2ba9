//! Several maps at once, within a memory limit; what an earlier sweep did is kept.

use super::build::{Job, build};
use super::plan::Entry;
use super::record::{MapRecord, MapResult};
use monogrid_app::process::failure::Failure;
use monogrid_app::process::progress::Progress;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// How a sweep is carried out.
#[derive(Clone, Copy, Debug)]
pub struct Resources {
    /// Maps built at the same time.
    pub workers: usize,
    /// Bytes that all maps may take together.
    pub memory_bytes: usize,
}

/// The records of all entries of one job, in their order: those of an earlier sweep where they are
/// of the same work, the rest built. A map that does not fit into its share of the memory is built
/// again alone, with all of it, before it is given up.
pub fn run(
    job: &Job,
    entries: &[Entry],
    fingerprint: impl Fn(&Entry) -> String + Sync,
    resources: Resources,
    progress: &Progress,
) -> Result<Vec<MapRecord>, Failure> {
    let name = |entry: &Entry| format!("{}/{}.json", job.name, entry.name());
    let file = |entry: &Entry| job.out.path().join(name(entry));
    let load = |entry: &Entry| MapRecord::load(&file(entry), &fingerprint(entry));
    let loaded = entries.iter().map(load);
    let records: Vec<OnceLock<MapRecord>> = loaded
        .map(|record| record.map_or_else(OnceLock::new, OnceLock::from))
        .collect();
    let mut missing = Vec::new();
    for (index, entry) in entries.iter().enumerate() {
        match records[index].get() {
            Some(record) => progress.done(&line(entry, &record.result)),
            None => missing.push(index),
        }
    }
    let finish = |index: usize, result: MapResult| {
        let entry = &entries[index];
        progress.done(&line(entry, &result));
        let record = MapRecord {
            fingerprint: fingerprint(entry),
            entry: *entry,
            result,
        };
        record.save(job.out, &name(entry))?;
        // each is built once
        let _ = records[index].set(record);
        Ok(())
    };
    let too_large = in_parallel(job, entries, &missing, resources, &finish)?;
    for index in too_large {
        let result = build(job, &entries[index], resources.memory_bytes)?;
        finish(index, result)?;
    }
    let records = records.into_iter();
    Ok(records.filter_map(OnceLock::into_inner).collect())
}

/// What a map says when it is done.
fn line(entry: &Entry, result: &MapResult) -> String {
    let name = entry.name();
    match result {
        MapResult::Built(built) => match &built.scores {
            Some(scores) => format!(
                "{name}: {:.1} s, AUC {:.3}, MCC {:.3}",
                built.seconds, scores.observed.auc, scores.observed.mcc
            ),
            None => format!("{name}: {:.1} s", built.seconds),
        },
        MapResult::BeyondMemory { .. } => format!("{name}: beyond the memory limit"),
    }
}

/// Builds entries on all workers; returns those that need more than their share of the memory.
fn in_parallel(
    job: &Job,
    entries: &[Entry],
    wanted: &[usize],
    resources: Resources,
    finish: &(impl Fn(usize, MapResult) -> Result<(), Failure> + Sync),
) -> Result<Vec<usize>, Failure> {
    let workers = resources.workers.clamp(1, wanted.len().max(1));
    let share = resources.memory_bytes / workers;
    let next = AtomicUsize::new(0);
    let work = || {
        let mut too_large = Vec::new();
        while let Some(&index) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
            match build(job, &entries[index], share)? {
                MapResult::BeyondMemory { .. } if workers > 1 => too_large.push(index),
                result => finish(index, result)?,
            }
        }
        Ok(too_large)
    };
    let joined = thread::scope(|scope| {
        let handles: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let failed = |_| Err(Failure::running("a worker of the sweep failed"));
        let outcomes = handles.into_iter().map(|handle| handle.join());
        let outcomes = outcomes.map(|outcome| outcome.unwrap_or_else(failed));
        // all of them are waited for, also behind one that failed
        outcomes.collect::<Vec<Result<Vec<usize>, Failure>>>()
    });
    let mut too_large = joined.into_iter().collect::<Result<Vec<_>, _>>()?.concat();
    too_large.sort_unstable();
    Ok(too_large)
}
