//! Several tasks at once: as many as there are jobs, and as their memory allows.
//!
//! A task is expected to need as much memory as it did when it was tried before, else a tenth more
//! than the largest of those that have ended, else 1 GB. It begins when all that run, by what they
//! are expected to need or have taken by now, leave that much; a task that never fits runs when
//! nothing else does. One that was killed is tried once more when all others are done, alone.

use super::class::Class;
use monogrid_app::process::usage::bytes_in;
use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// What a task is expected to need while nothing is known, bytes.
const FIRST_GUESS: u64 = 1_000_000_000;
/// What the largest one until now is multiplied by.
const MARGIN: f64 = 1.1;

/// What all tasks together may take.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Tasks at once.
    pub jobs: usize,
    /// Memory, bytes; `None` for as much as they want.
    pub memory_bytes: Option<u64>,
}

/// A task that was carried out.
#[derive(Clone, Copy, Debug)]
pub struct Carried {
    /// What became of it.
    pub class: Class,
    /// Memory that it took, bytes.
    pub peak_bytes: Option<u64>,
}

/// Hears of the memory that a task takes by now, bytes.
pub type Grown<'a> = dyn Fn(u64) + Sync + 'a;

/// Which tasks wait, and what those that run take.
#[derive(Debug, Default)]
struct Queue {
    /// Index of a task, and the memory that it took before.
    waiting: VecDeque<(usize, Option<u64>)>,
    running: BTreeMap<usize, u64>,
    largest: Option<u64>,
    again: Vec<usize>,
    is_stopped: bool,
}

impl Queue {
    fn expected(&self, before: Option<u64>) -> u64 {
        let of_others = self.largest.map(|bytes| (bytes as f64 * MARGIN) as u64);
        before.or(of_others).unwrap_or(FIRST_GUESS)
    }

    /// The first task that may begin now.
    fn next(&mut self, limits: Limits) -> Option<usize> {
        let taken: u64 = self.running.values().sum();
        let fits = |bytes: u64| {
            let limit = limits.memory_bytes;
            self.running.is_empty() || limit.is_none_or(|limit| taken + bytes <= limit)
        };
        let waiting = self.waiting.iter();
        let mut expected = waiting.map(|(_, before)| self.expected(*before));
        let place = expected.position(fits)?;
        let (index, before) = self.waiting.remove(place)?;
        self.running.insert(index, self.expected(before));
        Some(index)
    }

    fn grown(&mut self, index: usize, bytes: u64) {
        if let Some(taken) = self.running.get_mut(&index) {
            *taken = bytes.max(*taken);
        }
    }

    fn ended(&mut self, index: usize, carried: Carried) {
        self.running.remove(&index);
        self.largest = self.largest.max(carried.peak_bytes);
        self.is_stopped |= carried.class.stops_the_batch();
        if carried.class.is_tried_again() {
            self.again.push(index);
        }
    }
}

/// Carries out tasks, given by their indices with the memory that they took before; `work` gets the
/// index, which try it is, and somebody to tell of the memory that it takes by now. Those that were
/// not begun because something stopped all.
pub fn run(
    tasks: &[(usize, Option<u64>)],
    limits: Limits,
    work: &(impl Fn(usize, u32, &Grown) -> Carried + Sync),
) -> usize {
    let queue = Mutex::new(Queue {
        waiting: tasks.iter().copied().collect(),
        largest: tasks.iter().filter_map(|(_, before)| *before).max(),
        ..Queue::default()
    });
    let changed = Condvar::new();
    let carry_out = |index: usize, attempt: u32| {
        let work = || work(index, attempt, &|bytes| lock(&queue).grown(index, bytes));
        let carried = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
            // those that wait for its room would wait for ever
            lock(&queue).is_stopped = true;
            changed.notify_all();
            resume_unwind(panic)
        });
        lock(&queue).ended(index, carried);
        changed.notify_all();
    };
    let worker = || {
        while let Some(index) = next(&queue, &changed, limits) {
            carry_out(index, 1);
        }
    };
    thread::scope(|scope| {
        let jobs = 0..limits.jobs.clamp(1, tasks.len().max(1));
        let workers: Vec<_> = jobs.map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            worker.join().unwrap_or_else(|panic| resume_unwind(panic));
        }
    });
    let again = std::mem::take(&mut lock(&queue).again);
    for index in again {
        if !lock(&queue).is_stopped {
            carry_out(index, 2);
        }
    }
    lock(&queue).waiting.len()
}

/// Waits until a task may begin; `None` when there is none left.
fn next(queue: &Mutex<Queue>, changed: &Condvar, limits: Limits) -> Option<usize> {
    let mut queue = lock(queue);
    loop {
        if queue.is_stopped || queue.waiting.is_empty() {
            return None;
        }
        if let Some(index) = queue.next(limits) {
            return Some(index);
        }
        let waited = changed.wait(queue);
        queue = waited.unwrap_or_else(PoisonError::into_inner);
    }
}

/// A poisoned lock only means that another worker failed, which ends the program.
fn lock(queue: &Mutex<Queue>) -> MutexGuard<'_, Queue> {
    queue.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Memory that programs may take now, bytes: what is free, within what the group of this process
/// may have.
pub fn available_memory() -> Option<u64> {
    let free = bytes_in("/proc/meminfo", "MemAvailable:")?;
    let group = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    let group = group.and_then(|text| text.trim().parse().ok());
    Some(free.min(group.unwrap_or(u64::MAX)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_pipeline::attempt;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn queue(tasks: &[Option<u64>]) -> Queue {
        Queue {
            waiting: tasks.iter().copied().enumerate().collect(),
            running: BTreeMap::new(),
            largest: None,
            again: Vec::new(),
            is_stopped: false,
        }
    }

    const GB: u64 = 1_000_000_000;
    const LIMITS: Limits = Limits {
        jobs: 8,
        memory_bytes: Some(3 * GB),
    };

    fn done(gigabytes: f64) -> Carried {
        Carried {
            class: Class::Ok,
            peak_bytes: Some((gigabytes * GB as f64) as u64),
        }
    }

    #[test]
    fn memory_decides_how_many_run() {
        let mut q = queue(&[None; 9]);
        let begin = |q: &mut Queue| std::iter::from_fn(|| q.next(LIMITS)).count();
        assert_eq!(begin(&mut q), 3, "1 GB each while nothing is known");
        q.ended(0, done(0.5));
        assert_eq!(begin(&mut q), 1, "0.55 GB beside the first guesses");
        q.ended(1, done(0.5));
        q.ended(2, done(0.5));
        assert_eq!(begin(&mut q), 4, "five of 0.55 GB");
        q.grown(4, 2 * GB);
        q.ended(5, done(0.1));
        assert_eq!(begin(&mut q), 0, "one takes more than was expected");
    }

    #[test]
    fn a_smaller_one_goes_first_and_one_that_never_fits_alone() {
        let mut q = queue(&[Some(2 * GB), Some(9 * GB), Some(GB / 2)]);
        assert_eq!(q.next(LIMITS), Some(0));
        assert_eq!(q.next(LIMITS), Some(2));
        assert_eq!(q.next(LIMITS), None);
        q.ended(0, done(2.0));
        assert_eq!(q.next(LIMITS), None);
        q.ended(2, done(0.5));
        assert_eq!(q.next(LIMITS), Some(1));
    }

    #[test]
    fn a_worker_that_panics_ends_those_that_wait_for_its_room_and_the_batch() {
        let tasks: Vec<(usize, Option<u64>)> = (0..20).map(|i| (i, Some(2 * GB))).collect();
        let begun = AtomicUsize::new(0);
        let failed = attempt(|| {
            run(&tasks, LIMITS, &|index, _, _| {
                begun.fetch_add(1, Ordering::Relaxed);
                assert_ne!(index, 1, "the second");
                done(2.0)
            })
        });
        assert!(failed.unwrap_err().contains("the second"));
        assert!(begun.into_inner() < 20);
    }

    #[test]
    fn a_full_disk_stops_all_and_a_killed_one_gets_a_second_try() {
        let tasks: Vec<(usize, Option<u64>)> = (0..20).map(|index| (index, None)).collect();
        let begun = AtomicUsize::new(0);
        let limits = Limits {
            jobs: 2,
            memory_bytes: None,
        };
        let carried = |class| Carried {
            class,
            peak_bytes: None,
        };
        let left = run(&tasks, limits, &|index, _, _| {
            begun.fetch_add(1, Ordering::Relaxed);
            carried(if index == 3 {
                Class::NoSpace
            } else {
                Class::Ok
            })
        });
        assert_eq!(left + begun.load(Ordering::Relaxed), 20);
        assert!(left > 0, "{left}");
        let tries = Mutex::new(Vec::new());
        let left = run(&tasks[..3], limits, &|index, attempt, _| {
            tries.lock().unwrap().push((index, attempt));
            carried(if index == 1 { Class::Killed } else { Class::Ok })
        });
        assert_eq!(left, 0);
        let tries = tries.into_inner().unwrap();
        assert_eq!(tries.len(), 4);
        assert_eq!(tries[3], (1, 2), "once more, when all others are done");
    }
}
