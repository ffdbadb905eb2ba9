//! Pool of brick payloads: chunks that never move, with a free list.

use crate::evidence::UNKNOWN;
use crate::key::BRICK_CELLS;

/// Evidence of the 512 cells of a brick, x fastest.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(crate) struct Payload(pub [i16; BRICK_CELLS]);

impl Payload {
    /// Asks the processor to fetch it; a hint, without effect on what is read.
    #[inline]
    pub(crate) fn prefetch(&self) {
        #[cfg(target_arch = "x86_64")]
        for line in self.0.chunks_exact(32) {
            // SAFETY: a prefetch reads nothing.
            #[allow(unsafe_code, reason = "an instruction that only gives a hint")]
            unsafe {
                use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
                _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast());
            }
        }
    }

    /// The common value of all cells, if there is one.
    pub(crate) fn uniform_value(&self) -> Option<i16> {
        let first = self.0[0];
        // No early exit: this compiles to wide compares.
        let differs = self.0.iter().fold(0, |acc, &v| acc | (v ^ first));
        (differs == 0).then_some(first)
    }
}

/// Payloads per allocation: 32 KiB, small against the map, large against the allocator's cost.
const CHUNK: usize = 32;

/// Growable store of payloads addressed by index.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pool {
    chunks: Vec<Box<[Payload]>>,
    free: Vec<u32>,
    used: u32,
}

impl Pool {
    /// A payload that holds what `fill` writes into it.
    pub(crate) fn insert(&mut self, fill: impl FnOnce(&mut [i16; BRICK_CELLS])) -> u32 {
        let index = self.free.pop().unwrap_or_else(|| {
            if self.used as usize == self.chunks.len() * CHUNK {
                let chunk = vec![Payload([UNKNOWN; BRICK_CELLS]); CHUNK];
                self.chunks.push(chunk.into_boxed_slice());
            }
            self.used += 1;
            self.used - 1
        });
        fill(&mut self.get_mut(index).0);
        index
    }

    pub(crate) fn release(&mut self, index: u32) {
        self.free.push(index);
    }

    #[inline]
    pub(crate) fn get(&self, index: u32) -> &Payload {
        &self.chunks[index as usize / CHUNK][index as usize % CHUNK]
    }

    #[inline]
    pub(crate) fn get_mut(&mut self, index: u32) -> &mut Payload {
        &mut self.chunks[index as usize / CHUNK][index as usize % CHUNK]
    }

    /// Payloads in use.
    pub(crate) fn len(&self) -> usize {
        self.used as usize - self.free.len()
    }

    /// Bytes of all chunks and of the free list, used or not.
    pub(crate) fn bytes(&self) -> usize {
        self.chunks.len() * CHUNK * size_of::<Payload>()
            + self.free.capacity() * size_of::<u32>()
            + self.chunks.capacity() * size_of::<Box<[Payload]>>()
    }
}
