//! Where evidence lives: bricks in sharded open-addressing directories with pooled or packed
//! payloads.

pub(crate) mod packed;
pub(crate) mod pool;
pub(crate) mod shard;

pub(crate) use shard::{BrickRef, Shard, SlotIndex};

/// Shards of a map; a power of two. Bricks of one shard change on one thread at a time, so any
/// number of threads gives the same map.
pub(crate) const SHARDS: usize = 64;

/// Clears the lowest bit of each index of a packed key: 2 x 2 x 2 neighbours share a shard, so
/// that a thread finds the same measurements in its cache for all of them.
const NEIGHBOURS: u64 = !(1 << 42 | 1 << 21 | 1);

/// Mixes a packed brick key: the upper bits choose the slot, the lowest six the shard.
#[inline]
pub(crate) fn hash(packed: u64) -> u64 {
    // Multiplicative hashing: the upper bits of a product depend on all bits of the key.
    let group = (packed & NEIGHBOURS).wrapping_mul(0xd6e8_feb8_6659_fd93);
    let slot = packed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    slot >> 12 << 6 | group >> 58
}

/// The shard of a hashed key.
#[inline]
pub(crate) fn shard_of(hash: u64) -> usize {
    (hash & (SHARDS as u64 - 1)) as usize
}
