//! A picture of a map for queries: only what is unknown, free or occupied, two bits per cell.
//!
//! Bricks are grouped into blocks of 8 x 8 x 8. A brick whose cells are all in one state is one
//! word; others have two masks of 512 bits. That is an eighth of the map, so that random questions
//! find more of it in the caches, and a brick without an obstacle is passed by a ray in one look.
//! Blocks are shared between copies of a snapshot: a planner keeps its copy while the map grows.

use std::sync::Arc;

use super::cast::{RayHit, UnknownCells, first_hit, first_in_brick};
use super::collide::{self, States};
use crate::evidence::Occupancy;
use crate::integrate::rays::ray::Ray;
use crate::key::{BRICK_CELLS, BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::storage::BrickRef;

const BRICKS_PER_BLOCK: usize = 512;
/// The bits of a packed brick key that tell the bricks of a block apart.
const IN_BLOCK: u64 = 7 << 42 | 7 << 21 | 7;

/// Bits of the word of a brick: what states occur in it, and where its masks are if several do.
const HAS_UNKNOWN: u32 = 1;
const HAS_OCCUPIED: u32 = 2;
const MIXED: u32 = 4;
const MASK_SHIFT: u32 = 3;

/// States of the cells of a brick, one bit each, x fastest.
#[derive(Clone, Copy, Debug)]
struct Masks {
    known: [u64; BRICK_CELLS / 64],
    occupied: [u64; BRICK_CELLS / 64],
}

impl Masks {
    fn new(cells: &[i16; BRICK_CELLS], state: impl Fn(i16) -> Occupancy) -> Self {
        let mut masks = Self {
            known: [0; BRICK_CELLS / 64],
            occupied: [0; BRICK_CELLS / 64],
        };
        for (word, cells) in cells.chunks_exact(64).enumerate() {
            for (bit, &cell) in cells.iter().enumerate() {
                let state = state(cell);
                masks.known[word] |= u64::from(state != Occupancy::Unknown) << bit;
                masks.occupied[word] |= u64::from(state == Occupancy::Occupied) << bit;
            }
        }
        masks
    }

    /// The flags of [`HAS_UNKNOWN`] and [`HAS_OCCUPIED`], and whether all cells share a state.
    fn summary(&self) -> (u32, bool) {
        let known: u32 = self.known.iter().map(|w| w.count_ones()).sum();
        let occupied: u32 = self.occupied.iter().map(|w| w.count_ones()).sum();
        let all = BRICK_CELLS as u32;
        let has = |flag: u32, is_there: bool| if is_there { flag } else { 0 };
        let flags = has(HAS_UNKNOWN, known < all) | has(HAS_OCCUPIED, occupied > 0);
        let is_uniform = known == 0 || occupied == all || (known == all && occupied == 0);
        (flags, is_uniform)
    }

    #[inline]
    fn state(&self, index: usize) -> Occupancy {
        let bit = |words: &[u64; 8]| words[index / 64] >> (index % 64) & 1;
        match (bit(&self.known), bit(&self.occupied)) {
            (0, _) => Occupancy::Unknown,
            (_, 0) => Occupancy::Free,
            _ => Occupancy::Occupied,
        }
    }

    fn first_hit(&self, way: (&Ray, BrickKey, f64), unknown: UnknownCells) -> RayHit {
        let mut stops = self.occupied;
        if unknown == UnknownCells::Stop {
            for (stop, known) in stops.iter_mut().zip(&self.known) {
                *stop |= !known;
            }
        }
        let stops = |index| stops[index / 64] >> (index % 64) & 1 == 1;
        first_in_brick(way, stops, |index| self.state(index))
    }
}

/// 8 x 8 x 8 bricks.
#[derive(Clone, Debug)]
struct Block {
    key: u64,
    words: [u32; BRICKS_PER_BLOCK],
    masks: Vec<Masks>,
}

impl Block {
    fn new(key: u64) -> Self {
        Self {
            key,
            words: [HAS_UNKNOWN; BRICKS_PER_BLOCK],
            masks: Vec::new(),
        }
    }

    /// This block with some of its bricks read again; their masks move together.
    fn refreshed(&self, map: &OccupancyMap, changed: &[u64]) -> Self {
        let mut block = Self::new(self.key);
        let mut put = |index: usize, word: u32, masks: Option<&Masks>| {
            block.words[index] = word;
            if let Some(masks) = masks {
                block.words[index] |= MIXED | (block.masks.len() as u32) << MASK_SHIFT;
                block.masks.push(*masks);
            }
        };
        let mut is_changed = [false; BRICKS_PER_BLOCK];
        for &packed in changed {
            let index = index_in_block(packed);
            is_changed[index] = true;
            let state = |value| map.limits.occupancy(value);
            let key = BrickKey::unpack(packed);
            if let BrickRef::Uniform(value) = map.brick(key) {
                put(index, word_of_state(state(value)), None);
                continue;
            }
            let masks = Masks::new(&map.brick_values(key), state);
            match masks.summary() {
                (_, true) => put(index, word_of_state(masks.state(0)), None),
                (flags, false) => put(index, flags, Some(&masks)),
            }
        }
        for (index, &word) in self.words.iter().enumerate() {
            if !is_changed[index] {
                let flags = word & (HAS_UNKNOWN | HAS_OCCUPIED);
                put(index, flags, self.masks_of(word));
            }
        }
        block
    }

    #[inline]
    fn masks_of(&self, word: u32) -> Option<&Masks> {
        (word & MIXED != 0).then(|| &self.masks[(word >> MASK_SHIFT) as usize])
    }

    #[inline]
    fn state(&self, packed: u64, index_in_brick: usize) -> Occupancy {
        let word = self.words[index_in_block(packed)];
        match self.masks_of(word) {
            None => state_of_word(word),
            Some(masks) => masks.state(index_in_brick),
        }
    }
}

fn word_of_state(state: Occupancy) -> u32 {
    match state {
        Occupancy::Unknown => HAS_UNKNOWN,
        Occupancy::Free => 0,
        Occupancy::Occupied => HAS_OCCUPIED,
    }
}

/// The state of a brick that is not mixed.
#[inline]
fn state_of_word(word: u32) -> Occupancy {
    match word {
        0 => Occupancy::Free,
        HAS_OCCUPIED => Occupancy::Occupied,
        _ => Occupancy::Unknown,
    }
}

#[inline]
fn index_in_block(packed: u64) -> usize {
    (packed >> 42 & 7 | (packed >> 21 & 7) << 3 | (packed & 7) << 6) as usize
}

/// The states of all cells of a map at one revision, for many fast questions and for other
/// threads. See [`Snapshot::new`]; copies share memory.
#[derive(Clone, Debug)]
pub struct Snapshot {
    resolution: f64,
    inv_resolution: f64,
    revision: u32,
    /// Open addressing by block key, at most half full: indices of blocks plus one.
    directory: Vec<u32>,
    blocks: Vec<Arc<Block>>,
}

impl Snapshot {
    /// The states of a map now.
    #[must_use]
    pub fn new(map: &OccupancyMap) -> Self {
        let mut snapshot = Self {
            resolution: map.resolution(),
            inv_resolution: map.inv_resolution,
            revision: map.revision(),
            directory: vec![0; 16],
            blocks: Vec::new(),
        };
        snapshot.read(map, map.bricks());
        snapshot
    }

    /// Follows the map that this snapshot was made from: reads the bricks that changed since.
    /// Copies of this snapshot stay as they are. Returns the number of bricks read.
    pub fn update(&mut self, map: &OccupancyMap) -> usize {
        let changed = map.bricks_changed_since(self.revision);
        let count = changed.len();
        self.read(map, changed);
        self.revision = map.revision();
        count
    }

    /// The revision of the map that this shows.
    #[must_use]
    pub fn revision(&self) -> u32 {
        self.revision
    }

    /// Edge of a cell in map units.
    #[must_use]
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Bytes allocated, those shared with copies included.
    #[must_use]
    pub fn bytes_in_memory(&self) -> usize {
        let masks: usize = self.blocks.iter().map(|b| b.masks.capacity()).sum();
        self.blocks.len() * (size_of::<Block>() + 8)
            + masks * size_of::<Masks>()
            + self.directory.len() * 4
    }

    fn read(&mut self, map: &OccupancyMap, bricks: Vec<BrickKey>) {
        let mut packed: Vec<u64> = bricks.into_iter().map(BrickKey::pack).collect();
        packed.sort_unstable_by_key(|p| (p & !IN_BLOCK, *p));
        for changed in packed.chunk_by(|a, b| a & !IN_BLOCK == b & !IN_BLOCK) {
            let index = self.block_index(changed[0] & !IN_BLOCK);
            self.blocks[index] = Arc::new(self.blocks[index].refreshed(map, changed));
        }
    }

    /// The block of a key, made if it is missing.
    fn block_index(&mut self, key: u64) -> usize {
        match self.find(key) {
            Ok(index) => index,
            Err(mut slot) => {
                if self.blocks.len() * 2 >= self.directory.len() {
                    self.directory = vec![0; self.directory.len() * 2];
                    for index in 0..self.blocks.len() {
                        if let Err(slot) = self.find(self.blocks[index].key) {
                            self.directory[slot] = index as u32 + 1;
                        }
                    }
                    slot = self.find(key).err().unwrap_or(slot);
                }
                self.blocks.push(Arc::new(Block::new(key)));
                self.directory[slot] = self.blocks.len() as u32;
                self.blocks.len() - 1
            }
        }
    }

    /// The index of a block, or the directory slot where it would be.
    #[inline]
    fn find(&self, key: u64) -> Result<usize, usize> {
        let mask = self.directory.len() - 1;
        let mut slot = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as usize & mask;
        loop {
            match self.directory[slot] as usize {
                0 => return Err(slot),
                index if self.blocks[index - 1].key == key => return Ok(index - 1),
                _ => slot = (slot + 1) & mask,
            }
        }
    }

    #[inline]
    fn block(&self, packed: u64) -> Option<&Block> {
        self.find(packed & !IN_BLOCK).ok().map(|i| &*self.blocks[i])
    }

    /// What is known about the cell that holds a point.
    #[must_use]
    #[inline]
    pub fn state(&self, point_in_map: [f64; 3]) -> Occupancy {
        let key = VoxelKey::from_point(point_in_map, self.inv_resolution);
        key.map_or(Occupancy::Unknown, |key| self.state_of(key))
    }

    /// What is known about a cell.
    #[must_use]
    #[inline]
    pub fn state_of(&self, key: VoxelKey) -> Occupancy {
        let packed = key.brick().pack();
        self.block(packed).map_or(Occupancy::Unknown, |block| {
            block.state(packed, key.index_in_brick())
        })
    }

    /// States of many points, written to `states` (as long as `points`). The memory accesses of
    /// neighbouring points overlap, so this is faster than one by one.
    ///
    /// If the lengths differ, the surplus of the longer slice is left alone.
    pub fn states(&self, points_in_map: &[[f64; 3]], states: &mut [Occupancy]) {
        const LANES: usize = 32;
        for (points, states) in points_in_map.chunks(LANES).zip(states.chunks_mut(LANES)) {
            // Pass by pass, so that the cache misses of a pass are under way together.
            let mut words = [(HAS_UNKNOWN, 0_usize, None::<&Block>); LANES];
            for (lane, point) in words.iter_mut().zip(points) {
                if let Some(key) = VoxelKey::from_point(*point, self.inv_resolution) {
                    let packed = key.brick().pack();
                    if let Some(block) = self.block(packed) {
                        let word = block.words[index_in_block(packed)];
                        *lane = (word, key.index_in_brick(), Some(block));
                    }
                }
            }
            for (state, (word, index, block)) in states.iter_mut().zip(words) {
                *state = match block.and_then(|b| b.masks_of(word)) {
                    Some(masks) => masks.state(index),
                    None => state_of_word(word),
                };
            }
        }
    }

    /// As [`OccupancyMap::cast_ray`], with the same result.
    #[must_use]
    pub fn cast_ray(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        max_range: f64,
        unknown: UnknownCells,
    ) -> RayHit {
        let stopping = stopping_flags(unknown);
        let mut block_key = !0;
        let mut block = None;
        let way = [origin, direction];
        first_hit(way, max_range, self.inv_resolution, |ray, packed| {
            if packed & !IN_BLOCK != block_key {
                block_key = packed & !IN_BLOCK;
                block = self.block(packed);
            }
            let word = block.map_or(HAS_UNKNOWN, |b| b.words[index_in_block(packed)]);
            if word & stopping == 0 {
                return RayHit::Nothing;
            }
            let way = (ray, BrickKey::unpack(packed), self.resolution);
            match block.and_then(|b| b.masks_of(word)) {
                Some(masks) => masks.first_hit(way, unknown),
                None => first_in_brick(way, |_| true, |_| state_of_word(word)),
            }
        })
    }

    /// As [`OccupancyMap::sphere_collides`], with the same result.
    #[must_use]
    pub fn sphere_collides(&self, center: [f64; 3], radius: f64, unknown: UnknownCells) -> bool {
        collide::sphere(self, center, radius, unknown)
    }

    /// As [`OccupancyMap::box_collides`], with the same result.
    #[must_use]
    pub fn box_collides(&self, low: [f64; 3], high: [f64; 3], unknown: UnknownCells) -> bool {
        collide::axis_box(self, low, high, unknown)
    }
}

fn stopping_flags(unknown: UnknownCells) -> u32 {
    match unknown {
        UnknownCells::PassThrough => HAS_OCCUPIED,
        UnknownCells::Stop => HAS_OCCUPIED | HAS_UNKNOWN,
    }
}

impl States for Snapshot {
    fn cell_edge(&self) -> f64 {
        self.resolution
    }

    fn may_stop(&self, brick: BrickKey, unknown: UnknownCells) -> bool {
        let packed = brick.pack();
        let block = self.block(packed);
        let word = block.map_or(HAS_UNKNOWN, |b| b.words[index_in_block(packed)]);
        word & stopping_flags(unknown) != 0
    }

    fn cell_state(&self, key: VoxelKey) -> Occupancy {
        self.state_of(key)
    }

    fn known_bricks(&self) -> usize {
        self.blocks.len() * BRICKS_PER_BLOCK
    }

    fn stopping_bricks(&self) -> Vec<BrickKey> {
        let mut packed = Vec::new();
        for block in &self.blocks {
            for (index, word) in block.words.iter().enumerate() {
                if word & HAS_OCCUPIED != 0 {
                    let index = index as u64;
                    packed
                        .push(block.key | (index & 7) << 42 | (index >> 3 & 7) << 21 | index >> 6);
                }
            }
        }
        packed.sort_unstable();
        packed.into_iter().map(BrickKey::unpack).collect()
    }
}
