//! What is in memory, what is in the file, and what leaves memory next.

use super::config::MemoryConfig;
use super::scratch::{Place, Scratch};
use std::any::Any;
use std::collections::BTreeMap;
use std::fs::File;
use std::sync::{Arc, Weak};

/// A value of any type.
pub(super) type Value = Arc<dyn Any + Send + Sync>;
/// A value as bytes.
pub(super) type Pack = fn(&(dyn Any + Send + Sync)) -> Option<Vec<u8>>;

/// Bytes of what is kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StoreBytes {
    /// Values of their own that are in memory.
    pub own: usize,
    /// Values that were made of others, and are in memory.
    pub derived: usize,
    /// The file.
    pub file: usize,
}

/// A keyframe, or poses of frames, are lost that lay in the file for what is not in memory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "a keyframe, or poses of frames, cannot be read back from the file for what is not in memory: \
     {0}; write to another disk, or keep more of them in memory (slam.memory.keyframes_mb)"
)]
pub struct SpillError(String);

/// How a value leaves memory.
#[derive(Clone, Copy, Debug)]
enum Kind {
    /// For the file; where it is there, once it was written.
    Own(Pack, Option<Place>),
    /// It is made again.
    Derived,
}

#[derive(Debug)]
struct Entry {
    kind: Kind,
    /// While it is in memory because of us.
    value: Option<Value>,
    /// Others may still hold it.
    seen: Weak<dyn Any + Send + Sync>,
    bytes: usize,
    /// When it was used, counted in uses.
    used: u64,
}

/// Values in memory of one kind, by their last use.
#[derive(Debug, Default)]
struct ByUse {
    by_use: BTreeMap<u64, u64>,
    bytes: usize,
    /// Bytes from which values leave.
    limit: usize,
}

/// All values, by their numbers.
#[derive(Debug, Default)]
pub(super) struct LruCache {
    entries: BTreeMap<u64, Entry>,
    own: ByUse,
    derived: ByUse,
    num_made: u64,
    num_uses: u64,
    scratch: Option<Scratch>,
    /// What went wrong with the file first.
    pub(super) failure: Option<String>,
    /// The first value that could not be read back.
    pub(super) lost: Option<SpillError>,
}

const MEGABYTE: f64 = 1e6;

impl LruCache {
    pub(super) fn resize(&mut self, config: &MemoryConfig) {
        self.own.limit = (config.keyframes_mb * MEGABYTE) as usize;
        self.derived.limit = (config.prepared_mb * MEGABYTE) as usize;
        self.make_room();
    }

    pub(super) fn spill_into(&mut self, file: File) {
        self.scratch = Some(Scratch::new(file));
        self.make_room();
    }

    pub(super) fn bytes(&self) -> StoreBytes {
        StoreBytes {
            own: self.own.bytes,
            derived: self.derived.bytes,
            file: self.scratch.as_ref().map_or(0, Scratch::bytes) as usize,
        }
    }

    /// Takes a value; its number.
    pub(super) fn keep(&mut self, value: Value, bytes: usize, pack: Pack) -> u64 {
        let number = self.enter(Kind::Own(pack, None));
        self.put_back(number, value, bytes);
        number
    }

    /// Lets a value of its own leave memory, where there is a file.
    pub(super) fn lay_aside(&mut self, number: u64) {
        if self.write(number) {
            self.take_out(number);
        }
    }

    /// A number for a value that is made when somebody asks for it.
    pub(super) fn promise(&mut self) -> u64 {
        self.enter(Kind::Derived)
    }

    fn enter(&mut self, kind: Kind) -> u64 {
        let number = self.num_made;
        self.num_made += 1;
        let entry = Entry {
            kind,
            value: None,
            seen: Weak::<()>::new(),
            bytes: 0,
            used: 0,
        };
        self.entries.insert(number, entry);
        number
    }

    /// A value that is in memory, for whatever reason.
    pub(super) fn find(&mut self, number: u64) -> Option<Value> {
        let entry = self.entries.get(&number)?;
        let value = entry.value.clone().or_else(|| entry.seen.upgrade())?;
        self.put_back(number, Arc::clone(&value), entry.bytes);
        Some(value)
    }

    /// Puts a value to those in memory, as the one used last.
    pub(super) fn put_back(&mut self, number: u64, value: Value, bytes: usize) {
        self.take_out(number);
        let Some(entry) = self.entries.get_mut(&number) else {
            return;
        };
        self.num_uses += 1;
        entry.seen = Arc::downgrade(&value);
        (entry.value, entry.bytes, entry.used) = (Some(value), bytes, self.num_uses);
        let same_kind = match entry.kind {
            Kind::Own(..) => &mut self.own,
            Kind::Derived => &mut self.derived,
        };
        same_kind.by_use.insert(self.num_uses, number);
        same_kind.bytes += bytes;
        self.make_room();
    }

    /// Takes a value from those in memory.
    fn take_out(&mut self, number: u64) -> Option<Value> {
        let entry = self.entries.get_mut(&number)?;
        let value = entry.value.take()?;
        let same_kind = match entry.kind {
            Kind::Own(..) => &mut self.own,
            Kind::Derived => &mut self.derived,
        };
        same_kind.by_use.remove(&entry.used);
        same_kind.bytes -= entry.bytes;
        Some(value)
    }

    /// Lets values leave until the rest has room.
    fn make_room(&mut self) {
        while let Some(oldest) = self.derived.oldest_too_many() {
            self.take_out(oldest);
        }
        while let Some(oldest) = self.own.oldest_too_many() {
            if !self.write(oldest) {
                break;
            }
            self.take_out(oldest);
        }
    }

    /// Makes sure that a value of its own is in the file; whether it is.
    fn write(&mut self, number: u64) -> bool {
        let (Some(entry), Some(scratch)) = (self.entries.get_mut(&number), &mut self.scratch)
        else {
            return false;
        };
        let (Kind::Own(pack, place @ None), Some(value)) = (&mut entry.kind, &entry.value) else {
            return true;
        };
        let Some(packed) = pack(&**value) else {
            return false;
        };
        match scratch.write(&packed) {
            Ok(written) => {
                *place = Some(written);
                true
            }
            Err(error) => {
                // what is in the file stays there; the rest stays in memory
                self.own.limit = usize::MAX;
                self.note(&format!(
                    "keyframes stay in memory, since no more can be written to the file for them: \
                     {error}"
                ));
                false
            }
        }
    }

    /// A value as it is in the file.
    pub(super) fn read(&mut self, number: u64) -> Option<Vec<u8>> {
        let Kind::Own(_, Some(place)) = self.entries.get(&number)?.kind else {
            return None;
        };
        match self.scratch.as_mut()?.read(&place) {
            Ok(bytes) => Some(bytes),
            Err(error) => {
                self.lose(error.to_string());
                None
            }
        }
    }

    /// A value does not come back, and why.
    pub(super) fn lose(&mut self, why: String) {
        let lost = SpillError(why);
        self.note(&lost.to_string());
        self.lost.get_or_insert(lost);
    }

    /// Forgets a value; what is left of it is to be dropped without the cache.
    pub(super) fn forget(&mut self, number: u64) -> Option<Value> {
        let value = self.take_out(number);
        let entry = self.entries.remove(&number);
        if let (Some(Kind::Own(_, Some(place))), Some(scratch)) =
            (entry.map(|entry| entry.kind), &mut self.scratch)
        {
            scratch.give_up(&place);
        }
        value
    }

    /// The first failure is told.
    fn note(&mut self, failure: &str) {
        self.failure.get_or_insert_with(|| failure.to_owned());
    }
}

impl ByUse {
    /// The value used least recently, if there are others and all together are too many.
    fn oldest_too_many(&self) -> Option<u64> {
        let is_full = self.bytes > self.limit && self.by_use.len() > 1;
        let oldest = self.by_use.values().next();
        oldest.copied().filter(|_| is_full)
    }
}

#[cfg(test)]
impl LruCache {
    /// Whether a value is in memory because of us.
    pub(super) fn is_here(&self, number: u64) -> bool {
        let entry = self.entries.get(&number);
        entry.is_some_and(|entry| entry.value.is_some())
    }
}
