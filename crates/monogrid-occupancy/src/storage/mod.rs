//! Where evidence lives: bricks in sharded open-addressing directories with pooled payloads.

pub(crate) mod pool;
pub(crate) mod shard;

pub(crate) use shard::{BrickRef, Shard, SlotIndex};

/// Shards of a map; a power of two. Bricks of one shard change on one thread at a time, so any
/// number of threads gives the same map.
pub(crate) const SHARDS: usize = 64;

/// Mixes a packed brick key; the top bits choose the shard, the next ones the slot.
#[inline]
pub(crate) fn hash(packed: u64) -> u64 {
    // Multiplicative hashing; the fold brings high key bits down to where they matter.
    let mixed = packed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    mixed ^ (mixed >> 29)
}

/// The shard of a hashed key.
#[inline]
pub(crate) fn shard_of(hash: u64) -> usize {
    (hash >> 58) as usize
}
