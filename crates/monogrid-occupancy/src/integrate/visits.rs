//! The updates of a batch of beams on their way to the bricks.
//!
//! (1) Beams are walked and their visits of bricks handed to the shards of those. Of bricks that a
//! beam crosses wholly in free space only the fact is handed on; where it meets more, the update of
//! every cell. (2) Each shard takes the visits in the order of the beams. A free visit of a brick that
//! is saturated free ends with a look into the directory.

use super::beam::{Beam, Beams, Beginnings, Measured};
use super::ray::TIME_BITS;
use super::rays::BrickFilter;
use crate::evidence::Limits;
use crate::key::{BRICK_CELLS, BrickKey};
use crate::sensor::table::{EvidenceTable, TableSet};
use crate::storage::{BrickRef, SHARDS, Shard, SlotIndex, hash, shard_of};

/// A batch of beams and the visits that they make.
pub(crate) struct Visits {
    beams: Vec<Beam>,
    /// By shard.
    lists: Vec<List>,
    count: usize,
}

/// Visits of the bricks of one shard, in the order of the beams.
///
/// A visit is a packed key in two words and a third, which is either `beam << 1 | 1` for a
/// brick in free space, or `count << 1` before as many updates: `position << 16 | evidence`.
#[derive(Clone, Debug, Default)]
struct List {
    words: Vec<u32>,
}

/// A brick in free space.
const FREE: u32 = 1;
/// Cells that a ray can cross in a brick, at most.
const MOST_CELLS: usize = 24;
/// Free space so short before the obstacle is walked with it: looking for its bricks costs more.
const SHORT: i64 = 12 << TIME_BITS;

impl List {
    #[inline]
    fn push(&mut self, key: u64, word: u32, updates: &[u32]) {
        self.words
            .extend_from_slice(&[key as u32, (key >> 32) as u32, word]);
        self.words.extend_from_slice(updates);
    }
}

impl Default for Visits {
    fn default() -> Self {
        Self {
            beams: Vec::new(),
            lists: vec![List::default(); SHARDS],
            count: 0,
        }
    }
}

impl Visits {
    /// Number of visits.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// How much there is to be applied to a shard, in words.
    pub(crate) fn words(&self, shard: usize) -> usize {
        self.lists[shard].words.len()
    }

    /// Step 1: the visits of each beam, in the order of the beams.
    pub(crate) fn collect(
        &mut self,
        beams: &Beams,
        batch: &[Measured],
        beginnings: Option<&Beginnings>,
        only: BrickFilter,
    ) {
        self.lists.iter_mut().for_each(|list| list.words.clear());
        self.beams.clear();
        self.count = 0;
        for (index, measured) in batch.iter().enumerate() {
            let mut beam = beams.beam(measured);
            if let Some(beginnings) = beginnings {
                beginnings.settle(&mut beam, measured);
            }
            let mut collector = Collector {
                lists: &mut self.lists,
                only,
                beam: &beam,
                word: (index as u32) << 1 | FREE,
                visits: 0,
            };
            collector.collect(beams.tables.table(beam.table));
            self.count += collector.visits;
            self.beams.push(beam);
        }
    }
}

/// The visits of one beam.
struct Collector<'a> {
    lists: &'a mut [List],
    only: BrickFilter<'a>,
    beam: &'a Beam,
    /// The third word of a free visit.
    word: u32,
    visits: usize,
}

impl Collector<'_> {
    fn push(&mut self, key: u64, word: u32, updates: &[u32]) {
        if self
            .only
            .is_none_or(|only| only.binary_search(&key).is_ok())
        {
            self.lists[shard_of(hash(key))].push(key, word, updates);
            self.visits += 1;
        }
    }

    fn collect(&mut self, table: &EvidenceTable) {
        let beam = self.beam;
        let mut from = beam.settled_until;
        if beam.free_until - from > SHORT {
            let mut is_done = true;
            beam.ray.walk_bricks(from, |key, leaves| {
                if leaves >= beam.free_until {
                    is_done = false;
                    return true;
                }
                from = leaves;
                self.push(key, self.word, &[]);
                false
            });
            if is_done {
                return;
            }
        }
        self.collect_cells(from, table);
    }

    /// The updates of all cells from the time `from` on.
    fn collect_cells(&mut self, from: i64, table: &EvidenceTable) {
        let mut updates = [0; MOST_CELLS];
        let mut count = 0;
        let mut brick = u64::MAX;
        let beam = self.beam;
        beam.ray.for_each_cell_from(from, |key, index, range| {
            if key != brick {
                if count > 0 {
                    self.push(brick, (count as u32) << 1, &updates[..count]);
                }
                (brick, count) = (key, 0);
            }
            let evidence = beam.evidence_at(range, table);
            if evidence != 0 {
                updates[count] = (index as u32) << 16 | u32::from(evidence as u16);
                count += 1;
            }
        });
        if count > 0 {
            self.push(brick, (count as u32) << 1, &updates[..count]);
        }
    }
}

/// Step 2 for one shard.
pub(crate) struct ShardWriter<'a> {
    tables: &'a TableSet,
    limits: Limits,
    revision: u32,
    free_visits: u32,
}

impl<'a> ShardWriter<'a> {
    pub(crate) fn new(tables: &'a TableSet, limits: Limits, revision: u32) -> Self {
        Self {
            tables,
            limits,
            revision,
            free_visits: 0,
        }
    }

    /// Takes the visits of a batch in the shard `index`.
    pub(crate) fn apply(&mut self, shard: &mut Shard, visits: &Visits, index: usize) {
        let mut words = &visits.lists[index].words[..];
        while let [low, high, word, rest @ ..] = words {
            let key = u64::from(*high) << 32 | u64::from(*low);
            let slot = shard.find_or_insert(key, hash(key));
            words = rest;
            if word & FREE == 0 {
                let (updates, rest) = rest.split_at((word >> 1) as usize);
                words = rest;
                self.update(shard, slot, updates);
            } else {
                let beam = &visits.beams[(word >> 1) as usize];
                self.clear(shard, slot, key, beam);
            }
        }
    }

    /// A brick that the beam crosses wholly in free space.
    fn clear(&mut self, shard: &mut Shard, slot: SlotIndex, key: u64, beam: &Beam) {
        let free = self.tables.table(beam.table).free;
        if free == 0 {
            return;
        }
        if shard.contents(slot) == BrickRef::Uniform(self.limits.min) && free < 0 {
            return;
        }
        let limits = self.limits;
        let cells = &mut shard.payload_mut(slot).0;
        let entry = beam
            .ray
            .enter_from(BrickKey::unpack(key), beam.settled_until);
        beam.ray.walk(entry, |index, _| {
            cells[index] = limits.updated(cells[index], free);
        });
        shard.touch(slot, self.revision);
        // Saturated bricks spare all later free rays: look for them now and then.
        self.free_visits += 1;
        if self.free_visits.is_multiple_of(32) {
            shard.collapse(slot);
        }
    }

    /// A brick in which the beam meets more than free space.
    fn update(&self, shard: &mut Shard, slot: SlotIndex, updates: &[u32]) {
        let limits = self.limits;
        if shard.contents(slot) == BrickRef::Uniform(limits.min)
            && updates.iter().all(|update| (*update as i16) < 0)
        {
            return;
        }
        let cells = &mut shard.payload_mut(slot).0;
        for update in updates {
            let cell = &mut cells[(update >> 16) as usize % BRICK_CELLS];
            *cell = limits.updated(*cell, *update as i16);
        }
        shard.touch(slot, self.revision);
    }
}
