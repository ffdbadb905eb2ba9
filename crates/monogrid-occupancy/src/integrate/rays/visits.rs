//! The updates of a batch of beams on their way to the bricks.
//!
//! (1) Beams are walked and their visits of bricks handed to the shards of those. Of bricks that a
//! beam crosses wholly in free space only the fact is handed on; where it meets more, the update of
//! every cell. (2) Each shard takes the visits in the order of the beams. A free visit of a brick
//! that is saturated free ends with a look into the directory.

use crate::evidence::UpdateRule;
use crate::integrate::rays::beam::{Beam, Beams, Beginnings, Measured};
use crate::integrate::rays::ray::{CellVisitor, TIME_BITS};
use crate::key::BrickFilter;
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
/// Visits whose bricks are fetched together.
const AHEAD: usize = 8;
/// Of so few bricks of a shard most are in a cache of the core.
const CACHED: usize = 32;
/// A ray crosses at most 22 cells of a brick.
const MOST_CELLS: usize = 24;
/// Free space so short before the obstacle is walked with it: looking for its bricks costs more.
const SHORT: i64 = 22 << TIME_BITS;

impl List {
    #[inline]
    fn push(&mut self, key: u64, word: u32) {
        self.words
            .extend_from_slice(&[key as u32, (key >> 32) as u32, word]);
    }

    #[inline]
    fn push_updates(&mut self, updates: &[u32; MOST_CELLS], count: usize) {
        // A copy of fixed size needs no call.
        let end = self.words.len() + count;
        self.words.extend_from_slice(updates);
        self.words.truncate(end);
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
        for measured in batch {
            let mut beam = beams.beam(measured);
            if let Some(beginnings) = beginnings {
                beginnings.settle(&mut beam, measured);
            }
            let mut visitor = Visitor {
                lists: &mut self.lists,
                only,
                beam: &beam,
                table: beams.tables.table(beam.table),
                updates: [0; MOST_CELLS],
                count: 0,
                visits: 0,
            };
            let is_needed = visitor.visit((self.beams.len() as u32) << 1 | FREE);
            self.count += visitor.visits;
            if is_needed {
                self.beams.push(beam);
            }
        }
    }
}

/// Collects the visits of one beam.
struct Visitor<'a> {
    lists: &'a mut [List],
    only: BrickFilter<'a>,
    beam: &'a Beam,
    table: &'a EvidenceTable,
    /// So many updates of the present brick.
    updates: [u32; MOST_CELLS],
    count: usize,
    visits: usize,
}

impl Visitor<'_> {
    /// Visits all that the beam can change; whether bricks in free space were visited, with
    /// `free_word` for the third word.
    fn visit(&mut self, free_word: u32) -> bool {
        let beam = self.beam;
        let mut from = beam.saturated_until;
        let mut is_needed = false;
        if beam.free_until - from > SHORT {
            let mut is_done = true;
            beam.ray.walk_bricks(from, |key, leaves| {
                if leaves >= beam.free_until {
                    is_done = false;
                    return true;
                }
                from = leaves;
                is_needed = true;
                if self.is_wanted(key) {
                    self.lists[shard_of(hash(key))].push(key, free_word);
                    self.visits += 1;
                }
                false
            });
            if is_done {
                return is_needed;
            }
        }
        beam.ray.visit_cells_from(from, self);
        is_needed
    }

    #[inline]
    fn is_wanted(&self, key: u64) -> bool {
        self.only
            .is_none_or(|only| only.binary_search(&key).is_ok())
    }
}

impl CellVisitor for Visitor<'_> {
    #[inline]
    fn cell(&mut self, index: usize, range: i64) {
        let evidence = self.beam.evidence_at(range, self.table);
        // Overwritten by the next if it changes nothing.
        self.updates[self.count] = (index as u32) << 16 | u32::from(evidence as u16);
        self.count += usize::from(evidence != 0);
    }

    #[inline]
    fn leave_brick(&mut self, key: u64) {
        if self.count > 0 && self.is_wanted(key) {
            let list = &mut self.lists[shard_of(hash(key))];
            list.push(key, (self.count as u32) << 1);
            list.push_updates(&self.updates, self.count);
            self.visits += 1;
        }
        self.count = 0;
    }
}

/// Step 2 for one shard.
pub(crate) struct ShardWriter<'a> {
    tables: &'a TableSet,
    rule: UpdateRule,
    revision: u32,
    free_visits: u32,
}

impl<'a> ShardWriter<'a> {
    pub(crate) fn new(tables: &'a TableSet, rule: UpdateRule, revision: u32) -> Self {
        Self {
            tables,
            rule,
            revision,
            free_visits: 0,
        }
    }

    /// Takes the visits of a batch in the shard `index`.
    pub(crate) fn apply(&mut self, shard: &mut Shard, visits: &Visits, index: usize) {
        let mut words = &visits.lists[index].words[..];
        let mut next: Vec<(u64, SlotIndex, u32, &[u32])> = Vec::with_capacity(AHEAD);
        // The next bricks are fetched side by side before they are changed.
        let ahead = if shard.payloads() > CACHED { AHEAD } else { 1 };
        while !words.is_empty() {
            next.clear();
            shard.reserve(ahead);
            while let [low, high, word, rest @ ..] = words
                && next.len() < ahead
            {
                let key = u64::from(*high) << 32 | u64::from(*low);
                let slot = shard.find_or_insert(key, hash(key));
                if ahead > 1 {
                    shard.prefetch(slot);
                }
                let count = if word & FREE == 0 { word >> 1 } else { 0 };
                let (updates, rest) = rest.split_at(count as usize);
                next.push((key, slot, *word, updates));
                words = rest;
            }
            for &(key, slot, word, updates) in &next {
                if word & FREE == 0 {
                    self.update(shard, slot, updates);
                } else {
                    let beam = &visits.beams[(word >> 1) as usize];
                    self.clear(shard, slot, key, beam);
                }
            }
        }
    }

    /// A brick that the beam crosses wholly in free space.
    fn clear(&mut self, shard: &mut Shard, slot: SlotIndex, key: u64, beam: &Beam) {
        let free = self.tables.table(beam.table).free;
        if free == 0 {
            return;
        }
        if shard.contents(slot) == BrickRef::Uniform(self.rule.limits.min) && free < 0 {
            return;
        }
        let cells = &mut shard.payload_mut(slot).0;
        add_along(cells, beam, BrickKey::unpack(key), self.rule, free);
        shard.touch(slot, self.revision);
        // Saturated bricks spare all later free rays: look for them now and then.
        self.free_visits += 1;
        if self.free_visits.is_multiple_of(32) {
            shard.collapse(slot);
        }
    }

    /// A brick in which the beam meets more than free space.
    fn update(&self, shard: &mut Shard, slot: SlotIndex, updates: &[u32]) {
        let rule = self.rule;
        if shard.contents(slot) == BrickRef::Uniform(rule.limits.min)
            && updates.iter().all(|update| (*update as i16) < 0)
        {
            return;
        }
        let cells = &mut shard.payload_mut(slot).0;
        for update in updates {
            let cell = &mut cells[(update >> 16) as usize % BRICK_CELLS];
            *cell = rule.updated(*cell, *update as i16);
        }
        shard.touch(slot, self.revision);
    }
}

/// Adds the same evidence to all cells of a brick that a beam crosses. A function of its own: what
/// its loop needs has room in registers.
#[inline(never)]
fn add_along(
    cells: &mut [i16; BRICK_CELLS],
    beam: &Beam,
    brick: BrickKey,
    rule: UpdateRule,
    evidence: i16,
) {
    let entry = beam.ray.enter_from(brick, beam.saturated_until);
    beam.ray.walk(entry, |index, _| {
        cells[index] = rule.updated(cells[index], evidence);
    });
}
