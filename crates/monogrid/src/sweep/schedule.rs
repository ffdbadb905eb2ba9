//! Several maps at once, within a memory limit; what an earlier sweep did is kept.

use super::build::{Job, build};
use super::plan::Entry;
use super::record::{MapRecord, MapResult};
use crate::failure::Failure;
use crate::tally::Tally;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

/// How a sweep is carried out.
#[derive(Clone, Copy, Debug)]
pub struct Resources {
    /// Maps built at the same time.
    pub workers: usize,
    /// Bytes that all maps may take together.
    pub memory_bytes: usize,
}

/// The records of all entries of one job, in their order: those of an earlier sweep where they are of
/// the same work, the rest built. A map that does not fit into its share of the memory is built again
/// alone, with all of it, before it is given up.
pub fn run(
    job: &Job,
    entries: &[Entry],
    fingerprint: impl Fn(&Entry) -> String + Sync,
    resources: Resources,
    progress: &Tally,
) -> Result<Vec<MapRecord>, Failure> {
    let name = |entry: &Entry| format!("{}/{}.json", job.name, entry.name());
    let file = |entry: &Entry| job.out.path().join(name(entry));
    let records: Vec<Mutex<Option<MapRecord>>> = entries
        .iter()
        .map(|entry| Mutex::new(MapRecord::load(&file(entry), &fingerprint(entry))))
        .collect();
    let is_missing = |index: usize| lock(&records[index]).is_none();
    let missing: Vec<usize> = (0..entries.len()).filter(|i| is_missing(*i)).collect();
    for index in (0..entries.len()).filter(|i| !missing.contains(i)) {
        if let Some(record) = lock(&records[index]).as_ref() {
            progress.done(&line(&entries[index], &record.result));
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
        *lock(&records[index]) = Some(record);
        Ok(())
    };
    let too_large = in_parallel(job, entries, &missing, resources, &finish)?;
    for index in too_large {
        let result = build(job, &entries[index], resources.memory_bytes)?;
        finish(index, result)?;
    }
    Ok(records
        .into_iter()
        .filter_map(|record| record.into_inner().ok()?)
        .collect())
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
    let too_large = Mutex::new(Vec::new());
    let work = || {
        while let Some(&index) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
            match build(job, &entries[index], share)? {
                MapResult::BeyondMemory { .. } if workers > 1 => lock(&too_large).push(index),
                result => finish(index, result)?,
            }
        }
        Ok(())
    };
    let outcomes: Vec<Result<(), Failure>> = thread::scope(|scope| {
        let handles: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        handles
            .into_iter()
            .map(|handle| {
                handle
                    .join()
                    .unwrap_or_else(|_| Err(Failure::running("a worker of the sweep failed")))
            })
            .collect()
    });
    outcomes.into_iter().collect::<Result<(), Failure>>()?;
    let mut too_large = too_large.into_inner().unwrap_or_default();
    too_large.sort_unstable();
    Ok(too_large)
}

/// A poisoned lock only means that another worker failed, which is reported by its join.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
