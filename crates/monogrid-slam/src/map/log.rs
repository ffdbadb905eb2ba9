//! A list that grows as long as the camera runs: what is new is in memory, what is older lies in
//! the file of the keyframes, where there is one ([`crate::store`]).

use crate::store::{Keepable, Kept, Measured, Store};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// What goes to the keyframes at once.
const PART: usize = 1024;

/// The list. It comes back the same in every bit.
#[derive(Clone, Debug)]
pub(super) struct Log<T> {
    /// Parts of [`PART`] values.
    old: Vec<Kept<Part<T>>>,
    /// From `PART` to twice as many, once there are so many.
    new: Vec<T>,
}

/// Values that go together.
#[derive(Debug)]
struct Part<T>(Vec<T>);

/// A value of such a list.
pub(super) trait Row: Copy + Serialize + DeserializeOwned + Send + Sync + 'static {}

impl<T: Copy + Serialize + DeserializeOwned + Send + Sync + 'static> Row for T {}

impl<T> Default for Log<T> {
    fn default() -> Self {
        Self {
            old: Vec::new(),
            new: Vec::new(),
        }
    }
}

impl<T: Row> Log<T> {
    /// Adds a value.
    pub(super) fn push(&mut self, value: T, store: &Store) {
        if self.new.len() == 2 * PART {
            let old = self.new.drain(..PART).collect();
            self.old.push(store.lay_aside(Part(old)));
        }
        self.new.push(value);
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        PART * self.old.len() + self.new.len()
    }

    pub(super) fn last(&self) -> Option<&T> {
        self.new.last()
    }

    pub(super) fn last_mut(&mut self) -> Option<&mut T> {
        self.new.last_mut()
    }

    /// One of the newest [`PART`], by its place in the list.
    pub(super) fn recent(&self, index: usize) -> Option<&T> {
        self.new.get(index.checked_sub(PART * self.old.len())?)
    }

    /// All, in their order. Those that cannot be read back are missing; the store remembers that.
    pub(super) fn iter(&self) -> impl Iterator<Item = T> {
        let parts = self.old.iter().filter_map(Kept::get_once);
        let old = parts.flat_map(|part| (0..part.0.len()).map(move |k| part.0[k]));
        old.chain(self.new.iter().copied())
    }

    /// Memory, bytes, of what is not kept beside the keyframes.
    pub(super) fn bytes(&self) -> usize {
        size_of::<T>() * self.new.capacity()
    }
}

impl<T: Row> Measured for Part<T> {
    fn bytes(&self) -> usize {
        size_of_val(self.0.as_slice())
    }
}

impl<T: Row> Keepable for Part<T> {
    fn pack(&self) -> Vec<u8> {
        // none of its numbers is refused
        postcard::to_allocvec(&self.0).unwrap_or_default()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes(bytes).ok().map(Self)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]
mod tests {
    use super::*;
    use crate::MemoryConfig;

    #[test]
    fn what_is_old_leaves_memory_and_comes_back_the_same() {
        let store = Store::new(&MemoryConfig::default());
        store.spill_into(tempfile::tempfile().unwrap());
        let value = |k: usize| (k, 1.0 / (k as f64 + 3.0));
        let mut log = Log::default();
        for k in 0..10 * PART + 5 {
            log.push(value(k), &store);
            assert_eq!(log.last(), Some(&value(k)));
            assert_eq!(log.recent(k), Some(&value(k)));
        }
        assert_eq!(log.len(), 10 * PART + 5);
        let bytes = store.bytes();
        assert!(bytes.own == 0 && bytes.file > 8 * PART * 9, "{bytes:?}");
        assert!(log.iter().eq((0..log.len()).map(value)));
        assert_eq!(log.recent(8 * PART), None);
        assert_eq!(log.recent(9 * PART), Some(&value(9 * PART)));
        assert_eq!(store.bytes(), bytes, "what was read is not in memory");
        assert!(log.bytes() <= 2 * PART * size_of::<(usize, f64)>());
        log.last_mut().unwrap().0 = 7;
        assert_eq!(log.iter().last().unwrap().0, 7);
    }
}
