//! One shard of a map: an open-addressing directory of bricks and the pool of their payloads.
//!
//! Payloads can be packed ([`Shard::pack`]); a packed brick gets a payload again when it changes.
//!
//! Bricks are never taken out of a directory: a brick whose cells all became unknown stays as a
//! uniform unknown brick, so that "changed since revision n" also reports what vanished.

use super::packed::{self, PackedBrick};
use super::pool::{Payload, Pool};
use crate::evidence::{UNKNOWN, UpdateRule};
use crate::for_avx2::for_avx2;
use crate::key::BRICK_CELLS;

const EMPTY: u64 = u64::MAX;
const UNIFORM: u32 = 1 << 31;
const PACKED: u32 = 1 << 30;

/// Contents of a brick: one value for all cells, the index of a payload, or the first word of a
/// packed brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BrickRef {
    Uniform(i16),
    Mixed(u32),
    Packed(u32),
}

impl BrickRef {
    pub(crate) const UNKNOWN: Self = Self::Uniform(UNKNOWN);
}

/// Position in a directory; valid until the next insertion into the same shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SlotIndex(pub u32);

#[derive(Clone, Copy, Debug)]
struct Slot {
    key: u64,
    revision: u32,
    /// `UNIFORM | value`, `PACKED | word`, or the index of a payload.
    contents: u32,
}

impl Slot {
    #[inline]
    fn contents(self) -> BrickRef {
        if self.contents & UNIFORM != 0 {
            BrickRef::Uniform(self.contents as u16 as i16)
        } else if self.contents & PACKED != 0 {
            BrickRef::Packed(self.contents & !PACKED)
        } else {
            BrickRef::Mixed(self.contents)
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
    /// Bricks in the directory.
    pub(crate) len: usize,
    pool: Pool,
    /// Words of the packed bricks, and of those that were given a payload since.
    packed: Vec<u64>,
    /// Packed bricks.
    pub(crate) packed_len: usize,
}

impl Shard {
    /// Bytes per directory slot, for budgets.
    pub(crate) const SLOT_BYTES: usize = size_of::<Slot>();

    /// The place in the directory, which is not empty, of a brick, or of the next that is free.
    #[inline]
    fn place(&self, packed: u64, hash: u64) -> usize {
        let mask = self.slots.len() - 1;
        let mut index = (hash >> 27) as usize & mask;
        while ![packed, EMPTY].contains(&self.slots[index].key) {
            index = (index + 1) & mask;
        }
        index
    }

    /// The slot of a brick, if it is in the directory.
    #[inline]
    pub(crate) fn find(&self, packed: u64, hash: u64) -> Option<SlotIndex> {
        if self.slots.is_empty() {
            return None;
        }
        let index = self.place(packed, hash);
        (self.slots[index].key == packed).then_some(SlotIndex(index as u32))
    }

    /// The slot of a brick, inserted as uniform unknown if it was absent.
    #[inline]
    pub(crate) fn find_or_insert(&mut self, packed: u64, hash: u64) -> SlotIndex {
        self.reserve(1);
        let index = self.place(packed, hash);
        if self.slots[index].key == EMPTY {
            self.slots[index] = Slot {
                key: packed,
                revision: 0,
                contents: uniform_word(UNKNOWN),
            };
            self.len += 1;
        }
        SlotIndex(index as u32)
    }

    /// Makes room for so many bricks: the slots of those that are inserted next stay valid.
    #[inline]
    pub(crate) fn reserve(&mut self, bricks: usize) {
        while (self.len + bricks - 1) * 4 >= self.slots.len() * 3 {
            self.grow();
        }
    }

    /// Fetches the payload of a brick, if it has one.
    #[inline]
    pub(crate) fn prefetch(&self, slot: SlotIndex) {
        if let BrickRef::Mixed(payload) = self.contents(slot) {
            self.pool.get(payload).prefetch();
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
            let index = self.place(slot.key, super::hash(slot.key));
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

    #[inline]
    pub(crate) fn packed(&self, word: u32) -> PackedBrick<'_> {
        PackedBrick::new(&self.packed[word as usize..])
    }

    /// Evidence of all cells.
    pub(crate) fn values(&self, contents: BrickRef) -> [i16; BRICK_CELLS] {
        match contents {
            BrickRef::Uniform(value) => [value; BRICK_CELLS],
            BrickRef::Mixed(payload) => *self.payload(payload),
            BrickRef::Packed(word) => self.packed(word).values(),
        }
    }

    /// Evidence of one cell.
    #[inline]
    pub(crate) fn value(&self, slot: SlotIndex, index_in_brick: usize) -> i16 {
        match self.contents(slot) {
            BrickRef::Uniform(value) => value,
            BrickRef::Mixed(payload) => self.payload(payload)[index_in_brick],
            BrickRef::Packed(word) => self.packed(word).value(index_in_brick),
        }
    }

    /// Makes all cells of a brick equal and returns its payload to the pool.
    pub(crate) fn set_uniform(&mut self, slot: SlotIndex, value: i16) {
        match self.contents(slot) {
            BrickRef::Uniform(_) => {}
            BrickRef::Mixed(payload) => self.pool.release(payload),
            BrickRef::Packed(_) => self.packed_len -= 1,
        }
        self.slots[slot.0 as usize].contents = uniform_word(value);
    }

    /// The payload of a brick for writing; a uniform or packed brick gets one first.
    #[inline]
    pub(crate) fn payload_mut(&mut self, slot: SlotIndex) -> &mut Payload {
        let payload = match self.contents(slot) {
            BrickRef::Mixed(payload) => payload,
            BrickRef::Uniform(value) => {
                let payload = self.pool.insert(|cells| cells.fill(value));
                self.slots[slot.0 as usize].contents = payload;
                payload
            }
            BrickRef::Packed(word) => self.unpack(slot, word),
        };
        self.pool.get_mut(payload)
    }

    #[cold]
    fn unpack(&mut self, slot: SlotIndex, word: u32) -> u32 {
        let values = self.packed(word).values();
        let payload = self.pool.insert(|cells| *cells = values);
        self.slots[slot.0 as usize].contents = payload;
        self.packed_len -= 1;
        payload
    }

    /// Packs every payload that becomes smaller by it, and gives back the memory of payloads and
    /// packed bricks that are no longer in use. No evidence changes.
    pub(crate) fn pack(&mut self) {
        let mut words = Vec::new();
        let mut pool = Pool::default();
        let mut packed_len = 0;
        for index in 0..self.slots.len() {
            let slot = self.slots[index];
            if slot.key == EMPTY {
                continue;
            }
            let first = words.len();
            let is_packed = match slot.contents() {
                BrickRef::Uniform(_) => continue,
                // Positions have 30 bits: what lies beyond 8 GiB of one shard has a payload.
                _ if first >= PACKED as usize => false,
                BrickRef::Mixed(payload) => packed::pack(self.payload(payload), &mut words),
                BrickRef::Packed(word) => {
                    words.extend_from_slice(self.packed(word).words());
                    true
                }
            };
            self.slots[index].contents = if is_packed {
                packed_len += 1;
                PACKED | first as u32
            } else {
                pool.insert(|cells| *cells = self.values(slot.contents()))
            };
        }
        words.shrink_to_fit();
        (self.packed, self.packed_len, self.pool) = (words, packed_len, pool);
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
    pub(crate) fn update_all(&mut self, slot: SlotIndex, delta: i16, rule: UpdateRule) -> bool {
        match self.contents(slot) {
            BrickRef::Uniform(value) => {
                let updated = rule.updated(value, delta);
                self.slots[slot.0 as usize].contents = uniform_word(updated);
                updated != value
            }
            BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                let mut changed = 0;
                for value in &mut self.payload_mut(slot).0 {
                    let updated = rule.updated(*value, delta);
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
        rule: UpdateRule,
    ) -> bool {
        let cells = &mut self.payload_mut(slot).0;
        let [changed, differs] = update_cells(cells, updates, rule);
        if !differs {
            let value = cells[0];
            self.set_uniform(slot, value);
        }
        changed
    }

    /// All bricks, tombstones included, in no particular order: packed key, revision, contents.
    pub(crate) fn bricks(&self) -> impl Iterator<Item = (u64, u32, BrickRef)> + '_ {
        let used = self.slots.iter().filter(|s| s.key != EMPTY);
        used.map(|s| (s.key, s.revision, s.contents()))
    }

    /// Bricks with a payload, packed ones not counted.
    pub(crate) fn payloads(&self) -> usize {
        self.pool.len()
    }

    /// Bytes allocated for the directory and the payloads.
    pub(crate) fn bytes(&self) -> usize {
        self.directory_bytes() + self.pool.bytes() + self.packed.capacity() * size_of::<u64>()
    }

    /// Bytes allocated for the directory.
    pub(crate) fn directory_bytes(&self) -> usize {
        self.slots.capacity() * Self::SLOT_BYTES
    }
}

for_avx2! {
    /// An update per cell, where 0 leaves the cell alone; whether anything changed, and whether not
    /// all are equal then.
    fn update_cells(
        cells: &mut [i16; BRICK_CELLS],
        updates: &[i16; BRICK_CELLS],
        rule: UpdateRule,
    ) -> [bool; 2] {
        let updated = |value, update| match update {
            0 => value,
            update => rule.updated(value, update),
        };
        let first = updated(cells[0], updates[0]);
        let (mut changed, mut differs) = (0, 0);
        for (value, &update) in cells.iter_mut().zip(updates) {
            let updated = updated(*value, update);
            changed |= *value ^ updated;
            differs |= first ^ updated;
            *value = updated;
        }
        [changed, differs].map(|bits| bits != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Limits;
    use crate::storage::hash;
    use crate::test_random::Random;
    use std::collections::BTreeMap;

    #[test]
    fn directory_and_pool_agree_with_a_plain_map_under_random_use() {
        let limits = Limits::new(-2.0, 3.5, 0.5).unwrap();
        let mut shard = Shard::default();
        let mut oracle: BTreeMap<u64, [i16; BRICK_CELLS]> = BTreeMap::new();
        let mut random = Random(7);
        let mut random = move || random.bits(31);
        let mut most_packed = 0;
        for step in 0..20_000 {
            let key = random() % 700;
            let slot = shard.find_or_insert(key, hash(key));
            let cells = oracle.entry(key).or_insert([UNKNOWN; BRICK_CELLS]);
            if step % 1500 == 700 {
                shard.pack();
                most_packed = most_packed.max(shard.packed_len);
            }
            match random() % 4 {
                0 => {
                    let value = (random() % 5) as i16 * 100 - 200;
                    shard.set_uniform(slot, value);
                    cells.fill(value);
                }
                1 => {
                    shard.update_all(slot, -2458, limits.rule([0, 0]));
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
        assert_eq!(shard.len, oracle.len());
        let mixed = oracle
            .values()
            .filter(|c| c.iter().any(|v| *v != c[0]))
            .count();
        let own = shard.payloads() + shard.packed_len;
        assert_eq!(own, mixed, "uniform bricks hold no payload");
        assert!(most_packed > 50, "{most_packed} packed");
        for (key, cells) in oracle {
            let slot = shard.find(key, hash(key)).unwrap();
            for (index, value) in cells.iter().enumerate() {
                assert_eq!(shard.value(slot, index), *value, "brick {key} cell {index}");
            }
        }
        assert_eq!(shard.find(10_000, hash(10_000)), None);
    }

    #[test]
    fn slots_stay_valid_until_the_room_that_was_made_is_used() {
        let mut shard = Shard::default();
        for first in (0..4000_u64).step_by(8) {
            shard.reserve(8);
            let keys = first..first + 8;
            let slots: Vec<_> = keys
                .clone()
                .map(|key| shard.find_or_insert(key, hash(key)))
                .collect();
            assert!(
                keys.zip(slots)
                    .all(|(key, slot)| shard.find(key, hash(key)) == Some(slot))
            );
        }
    }

    #[test]
    fn a_brick_whose_cells_become_equal_holds_no_payload() {
        let limits = Limits::new(-2.0, 3.5, 0.5).unwrap();
        let mut shard = Shard::default();
        let slot = shard.find_or_insert(5, hash(5));
        let mut updates = [-8000; BRICK_CELLS];
        updates[300] = 0;
        assert!(shard.update_each(slot, &updates, limits.rule([0, 0])));
        assert!(matches!(shard.contents(slot), BrickRef::Mixed(_)));
        assert!(!shard.update_each(slot, &[0; BRICK_CELLS], limits.rule([0, 0])));
        assert!(shard.update_each(slot, &[-9000; BRICK_CELLS], limits.rule([0, 0])));
        assert_eq!(shard.contents(slot), BrickRef::Uniform(limits.min));
        assert!(!shard.update_each(slot, &[-1; BRICK_CELLS], limits.rule([0, 0])));
    }
}
