//! Beams on their way into the map: the visits of a batch of beams are collected, then every shard
//! takes those of its bricks.
//!
//! Threads do not wait for each other: one that is free applies batches to a shard that has all
//! those before them, or else collects the next batch. Each shard gets the batches in their order,
//! so the map is that of one thread.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use crate::integrate::rays::beam::{Beams, Beginnings, Measured};
use crate::integrate::rays::visits::{ShardWriter, Visits};
use crate::key::BrickFilter;
use crate::map::OccupancyMap;
use crate::storage::Shard;

/// Beams of a batch: few enough that their visits stay in a core's own cache, where every brick on
/// their way looks them up.
const BEAMS_PER_BATCH: usize = 4096;
/// The same where several threads have a batch each.
const BEAMS_PER_SHARED_BATCH: usize = 2048;
/// The last batches of several threads are smaller, so that all end at the same time: each is this
/// share of a thread's part of the rest, down to so many beams.
const SHARE_OF_REST: usize = 4;
const FEWEST_BEAMS: usize = 256;

/// Beams that begin where the same search found.
pub(crate) struct Walk<'a> {
    pub beams: &'a Beams,
    pub beginnings: Option<&'a Beginnings<'a>>,
    pub only: BrickFilter<'a>,
    pub threads: usize,
}

impl Walk<'_> {
    /// Integrates beams in their order; the number of visits. `spare` keeps memory for the next
    /// walk.
    pub(crate) fn integrate(
        &self,
        map: &mut OccupancyMap,
        measured: &[Measured],
        spare: &mut Vec<Visits>,
    ) -> usize {
        let batches = self.batches(measured);
        let (rule, revision) = (self.beams.tables.rule(map.limits), map.revision);
        let queue = Mutex::new(Queue::new(&mut map.shards, std::mem::take(spare)));
        let run = || {
            let mut done = None;
            // A poisoned lock means that another thread panicked: the scope reports it.
            while let Ok(mut waiting) = queue.lock() {
                if let Some(done) = done.take() {
                    waiting.put_back(done);
                }
                let Some(mut job) = waiting.next_job(batches.len()) else {
                    return;
                };
                drop(waiting);
                match &mut job {
                    Job::Collect(batch, visits) => {
                        let beams = batches[*batch];
                        visits.collect(self.beams, beams, self.beginnings, self.only);
                    }
                    Job::Apply(index, shard, batches) => {
                        let mut writer = ShardWriter::new(&self.beams.tables, rule, revision);
                        for visits in batches {
                            writer.apply(shard, visits, *index);
                        }
                    }
                }
                done = Some(job);
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..self.threads.min(batches.len()) {
                scope.spawn(run);
            }
            run();
        });
        queue.into_inner().map_or(0, |queue| {
            *spare = queue.spare;
            queue.visits
        })
    }

    fn batches<'m>(&self, mut measured: &'m [Measured]) -> Vec<&'m [Measured]> {
        let mut batches = Vec::new();
        while !measured.is_empty() {
            let beams = if self.threads == 1 {
                BEAMS_PER_BATCH
            } else {
                let rest = measured.len() / (SHARE_OF_REST * self.threads);
                rest.clamp(FEWEST_BEAMS, BEAMS_PER_SHARED_BATCH)
            };
            let (batch, rest) = measured.split_at(beams.min(measured.len()));
            batches.push(batch);
            measured = rest;
        }
        batches
    }
}

/// Something to be done that depends on nothing else that is being done.
enum Job<'a> {
    Collect(usize, Visits),
    Apply(usize, &'a mut Shard, Vec<Arc<Visits>>),
}

/// What is to be done, and with what.
struct Queue<'a> {
    /// Those that somebody works on are absent.
    shards: Vec<Option<&'a mut Shard>>,
    /// Batches that each shard has got, or is getting.
    applied: Vec<usize>,
    /// The batches from `first` on, which some shard still needs; `None` while being collected.
    batches: VecDeque<Option<Arc<Visits>>>,
    first: usize,
    spare: Vec<Visits>,
    visits: usize,
}

impl<'a> Queue<'a> {
    fn new(shards: &'a mut [Shard], spare: Vec<Visits>) -> Self {
        Self {
            applied: vec![0; shards.len()],
            shards: shards.iter_mut().map(Some).collect(),
            batches: VecDeque::new(),
            first: 0,
            spare,
            visits: 0,
        }
    }

    /// A job for somebody who is free; `None` if others do all that is left.
    fn next_job(&mut self, batches: usize) -> Option<Job<'a>> {
        let collected = self.batches.iter().take_while(|b| b.is_some()).count();
        // The shard with most to do, so that it is not left for the end.
        let mut most = (0, 0);
        for index in 0..self.shards.len() {
            if self.shards[index].is_none() {
                continue;
            }
            let new = self
                .batches
                .range(self.applied[index] - self.first..collected);
            let words = new.flatten().map(|visits| visits.words(index)).sum();
            if words == 0 {
                self.applied[index] = self.first + collected;
            } else if words > most.0 {
                most = (words, index);
            }
        }
        let job = if let (1.., index) = most {
            let new = self
                .batches
                .range(self.applied[index] - self.first..collected);
            let new = new.flatten().cloned().collect();
            self.applied[index] = self.first + collected;
            let shard = self.shards[index].take()?;
            Some(Job::Apply(index, shard, new))
        } else if self.first + self.batches.len() < batches {
            self.batches.push_back(None);
            let batch = self.first + self.batches.len() - 1;
            Some(Job::Collect(batch, self.spare.pop().unwrap_or_default()))
        } else {
            None
        };
        let least = self.applied.iter().min().copied().unwrap_or(0);
        let unneeded: Vec<_> = self.batches.drain(..least - self.first).flatten().collect();
        self.first = least;
        self.recycle(unneeded);
        job
    }

    /// Takes what somebody has done.
    fn put_back(&mut self, done: Job<'a>) {
        match done {
            Job::Collect(batch, visits) => {
                self.visits += visits.count();
                self.batches[batch - self.first] = Some(Arc::new(visits));
            }
            Job::Apply(index, shard, batches) => {
                self.shards[index] = Some(shard);
                self.recycle(batches);
            }
        }
    }

    /// Keeps the memory of batches that nobody needs any more.
    fn recycle(&mut self, batches: Vec<Arc<Visits>>) {
        let free = batches.into_iter().filter_map(Arc::into_inner);
        self.spare.extend(free);
    }
}
