//! One shard of a map: an open-addressing directory of bricks and the pool of their payloads.
//!
//! Bricks are never taken out of a directory: a brick whose cells all became unknown stays as a
//! uniform unknown brick, so that "changed since revision n" also reports what vanished.

use super::pool::{Payload, Pool};
use crate::evidence::{Limits, UNKNOWN};
use crate::key::BRICK_CELLS;

const EMPTY: u64 = u64::MAX;
const UNIFORM: u32 = 1 << 31;

/// Contents of a brick: one value for all cells, or the index of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BrickRef {
    Uniform(i16),
    Mixed(u32),
}

/// Position in a directory; valid until the next insertion into the same shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SlotIndex(pub u32);

#[derive(Clone, Copy, Debug)]
struct Slot {
    key: u64,
    revision: u32,
    /// `UNIFORM | value` or the index of a payload.
    contents: u32,
}

impl Slot {
    #[inline]
    fn contents(self) -> BrickRef {
        if self.contents & UNIFORM == 0 {
            BrickRef::Mixed(self.contents)
        } else {
            BrickRef::Uniform(self.contents as u16 as i16)
        }
    }
}

const fn uniform_word(value: i16) -> u32 {
    UNIFORM | value as u16 as u32
}

/// Directory and payloads of the bricks whose hash falls into this shard.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shard {
    slots: Vec<Slot>,
    len: usize,
    pool: Pool,
}

impl Shard {
    /// Bytes per directory slot, for budgets.
    pub(crate) const SLOT_BYTES: usize = size_of::<Slot>();

    #[inline]
    fn start(&self, hash: u64) -> usize {
        (hash >> 27) as usize & (self.slots.len() - 1)
    }

    /// The slot of a brick, if it is in the directory.
    #[inline]
    pub(crate) fn find(&self, packed: u64, hash: u64) -> Option<SlotIndex> {
        if self.slots.is_empty() {
            return None;
        }
        let mut index = self.start(hash);
        loop {
            let key = self.slots[index].key;
            if key == packed {
                return Some(SlotIndex(index as u32));
            }
            if key == EMPTY {
                return None;
            }
            index = (index + 1) & (self.slots.len() - 1);
        }
    }

    /// The slot of a brick, inserted as uniform unknown if it was absent.
    #[inline]
    pub(crate) fn find_or_insert(&mut self, packed: u64, hash: u64) -> SlotIndex {
        if self.len * 4 >= self.slots.len() * 3 {
            self.grow();
        }
        let mut index = self.start(hash);
        loop {
            let slot = &mut self.slots[index];
            if slot.key == packed {
                return SlotIndex(index as u32);
            }
            if slot.key == EMPTY {
                *slot = Slot {
                    key: packed,
                    revision: 0,
                    contents: uniform_word(UNKNOWN),
                };
                self.len += 1;
                return SlotIndex(index as u32);
            }
            index = (index + 1) & (self.slots.len() - 1);
        }
    }

    fn grow(&mut self) {
        let capacity = (self.slots.len() * 2).max(16);
        let empty = Slot {
            key: EMPTY,
            revision: 0,
            contents: 0,
        };
        let old = std::mem::replace(&mut self.slots, vec![empty; capacity]);
        for slot in old.into_iter().filter(|s| s.key != EMPTY) {
            let mut index = self.start(super::hash(slot.key));
            while self.slots[index].key != EMPTY {
                index = (index + 1) & (capacity - 1);
            }
            self.slots[index] = slot;
        }
    }

    #[inline]
    pub(crate) fn contents(&self, slot: SlotIndex) -> BrickRef {
        self.slots[slot.0 as usize].contents()
    }

    #[inline]
    pub(crate) fn touch(&mut self, slot: SlotIndex, revision: u32) {
        self.slots[slot.0 as usize].revision = revision;
    }

    #[inline]
    pub(crate) fn payload(&self, index: u32) -> &[i16; BRICK_CELLS] {
        &self.pool.get(index).0
    }

    /// Evidence of one cell.
    #[inline]
    pub(crate) fn value(&self, slot: SlotIndex, index_in_brick: usize) -> i16 {
        match self.contents(slot) {
            BrickRef::Uniform(value) => value,
            BrickRef::Mixed(payload) => self.payload(payload)[index_in_brick],
        }
    }

    /// Makes all cells of a brick equal and returns its payload to the pool.
    pub(crate) fn set_uniform(&mut self, slot: SlotIndex, value: i16) {
        if let BrickRef::Mixed(payload) = self.contents(slot) {
            self.pool.release(payload);
        }
        self.slots[slot.0 as usize].contents = uniform_word(value);
    }

    /// The payload of a brick for writing; a uniform brick gets one first.
    #[inline]
    pub(crate) fn payload_mut(&mut self, slot: SlotIndex) -> &mut Payload {
        let payload = match self.contents(slot) {
            BrickRef::Mixed(payload) => payload,
            BrickRef::Uniform(value) => {
                let payload = self.pool.allocate(value);
                self.slots[slot.0 as usize].contents = payload;
                payload
            }
        };
        self.pool.get_mut(payload)
    }

    /// Drops the payload of a brick whose cells are all equal.
    pub(crate) fn collapse(&mut self, slot: SlotIndex) {
        if let BrickRef::Mixed(payload) = self.contents(slot)
            && let Some(value) = self.pool.get(payload).uniform_value()
        {
            self.set_uniform(slot, value);
        }
    }

    /// Drops the payloads of bricks last changed at `revision` whose cells are all equal.
    pub(crate) fn collapse_revision(&mut self, revision: u32) {
        for index in 0..self.slots.len() {
            if self.slots[index].revision == revision && self.slots[index].key != EMPTY {
                self.collapse(SlotIndex(index as u32));
            }
        }
    }

    /// The same update for all cells of a brick; returns whether anything changed.
    pub(crate) fn update_all(&mut self, slot: SlotIndex, delta: i16, limits: Limits) -> bool {
        match self.contents(slot) {
            BrickRef::Uniform(value) => {
                let updated = limits.updated(value, delta);
                self.slots[slot.0 as usize].contents = uniform_word(updated);
                updated != value
            }
            BrickRef::Mixed(payload) => {
                let mut changed = 0;
                for value in &mut self.pool.get_mut(payload).0 {
                    let updated = limits.updated(*value, delta);
                    changed |= *value ^ updated;
                    *value = updated;
                }
                self.collapse(slot);
                changed != 0
            }
        }
    }

    /// An update per cell, where 0 leaves the cell alone; returns whether anything changed.
    pub(crate) fn update_each(
        &mut self,
        slot: SlotIndex,
        updates: &[i16; BRICK_CELLS],
        limits: Limits,
    ) -> bool {
        let mut changed = 0;
        for (value, &update) in self.payload_mut(slot).0.iter_mut().zip(updates) {
            let updated = if update == 0 {
                *value
            } else {
                limits.updated(*value, update)
            };
            changed |= *value ^ updated;
            *value = updated;
        }
        self.collapse(slot);
        changed != 0
    }

    /// All bricks, tombstones included, in no particular order: packed key, revision, contents.
    pub(crate) fn bricks(&self) -> impl Iterator<Item = (u64, u32, BrickRef)> + '_ {
        self.slots
            .iter()
            .filter(|s| s.key != EMPTY)
            .map(|s| (s.key, s.revision, s.contents()))
    }

    /// Bricks in the directory.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Bricks with a payload.
    pub(crate) fn payloads(&self) -> usize {
        self.pool.len()
    }

    /// Bytes allocated for the directory and the payloads.
    pub(crate) fn bytes(&self) -> usize {
        self.directory_bytes() + self.pool.bytes()
    }

    /// Bytes allocated for the directory.
    pub(crate) fn directory_bytes(&self) -> usize {
        self.slots.capacity() * Self::SLOT_BYTES
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::storage::hash;
    use std::collections::BTreeMap;

    #[test]
    fn directory_and_pool_agree_with_a_plain_map_under_random_use() {
        let limits = Limits::new(-2.0, 3.5, 0.5).unwrap();
        let mut shard = Shard::default();
        let mut oracle: BTreeMap<u64, [i16; BRICK_CELLS]> = BTreeMap::new();
        let mut state = 7_u64;
        let mut random = move || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            state >> 33
        };
        for _ in 0..20_000 {
            let key = random() % 700;
            let slot = shard.find_or_insert(key, hash(key));
            let cells = oracle.entry(key).or_insert([UNKNOWN; BRICK_CELLS]);
            match random() % 4 {
                0 => {
                    let value = (random() % 5) as i16 * 100 - 200;
                    shard.set_uniform(slot, value);
                    cells.fill(value);
                }
                1 => {
                    shard.update_all(slot, -2458, limits);
                    cells
                        .iter_mut()
                        .for_each(|c| *c = limits.updated(*c, -2458));
                }
                _ => {
                    let index = random() as usize % BRICK_CELLS;
                    let value = &mut shard.payload_mut(slot).0[index];
                    *value = limits.updated(*value, 700);
                    cells[index] = limits.updated(cells[index], 700);
                    shard.collapse(slot);
                }
            }
        }
        assert_eq!(shard.len(), oracle.len());
        let mixed = oracle
            .values()
            .filter(|c| c.iter().any(|v| *v != c[0]))
            .count();
        assert_eq!(shard.payloads(), mixed, "uniform bricks hold no payload");
        for (key, cells) in oracle {
            let slot = shard.find(key, hash(key)).unwrap();
            for (index, value) in cells.iter().enumerate() {
                assert_eq!(shard.value(slot, index), *value, "brick {key} cell {index}");
            }
        }
        assert_eq!(shard.find(10_000, hash(10_000)), None);
    }
}
