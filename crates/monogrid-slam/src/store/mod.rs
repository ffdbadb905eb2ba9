//! What is kept of keyframes: in memory as far as there is room, beyond that in a file.
//!
//! A [`Kept`] value is immutable and comes back, the same in every bit, whenever somebody asks for
//! it; that is why no result depends on how much room there is. What was used least recently leaves
//! first, by the order of use and never by a clock:
//!
//! - a value of its own ([`Store::keep`]) leaves for the file, where there is one
//!   ([`Store::spill_into`]), and is written at most once;
//! - a value that follows from others ([`Store::derive`]), such as the pyramid of an image, is made
//!   again.
//!
//! The file holds what a running system works with and nothing that a later one needs: what
//! survives the process is the recording.
//!
//! Depth at the final poses and what is mapped of each keyframe are kept here too, so that the end
//! of a run needs a few of them at a time.

mod config;
mod lru_cache;
mod packed;
mod scratch;
#[cfg(test)]
mod tests;

use self::lru_cache::LruCache;
pub use self::lru_cache::{SpillError, StoreBytes};
use self::packed::pack_any;
pub use self::packed::{Keepable, Measured, PackedPixel, pack_pixels, unpack_pixels};
pub use config::MemoryConfig;
use std::any::Any;
use std::fs::File;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Values that are kept, shared by all that use them.
#[derive(Clone, Debug, Default)]
pub struct Store(Arc<Mutex<LruCache>>);

/// A value that is kept as long as somebody holds this.
#[derive(Debug)]
pub struct Kept<T>(Arc<Ticket<T>>);

/// How a value that has left memory comes back.
enum Origin<T> {
    /// From what was written to the file.
    Own(fn(&[u8]) -> Option<T>),
    /// From others; `None` where one of them cannot be read back.
    Derived(Box<dyn Fn() -> Option<T> + Send + Sync>),
}

struct Ticket<T> {
    store: Store,
    number: u64,
    origin: Origin<T>,
}

impl Store {
    /// With as much room as the settings say.
    pub fn new(config: &MemoryConfig) -> Self {
        let store = Self::default();
        store.resize(config);
        store
    }

    /// Has as much room as these settings say from now on.
    pub fn resize(&self, config: &MemoryConfig) {
        self.cache().resize(config);
    }

    /// Lets values of their own leave memory for a file, which is overwritten.
    pub fn spill_into(&self, file: File) {
        self.cache().spill_into(file);
    }

    /// Keeps a value.
    pub fn keep<T: Keepable>(&self, value: T) -> Kept<T> {
        let bytes = value.bytes();
        let number = self.cache().keep(Arc::new(value), bytes, pack_any::<T>);
        self.kept(number, Origin::Own(T::unpack))
    }

    /// Keeps a value that nobody needs for long: it leaves memory at once.
    pub fn lay_aside<T: Keepable>(&self, value: T) -> Kept<T> {
        let kept = self.keep(value);
        self.cache().lay_aside(kept.0.number);
        kept
    }

    /// A value that follows from others and is made when somebody asks for it.
    pub fn derive<T: Measured>(
        &self,
        make: impl Fn() -> Option<T> + Send + Sync + 'static,
    ) -> Kept<T> {
        let number = self.cache().promise();
        self.kept(number, Origin::Derived(Box::new(make)))
    }

    /// Bytes of its values.
    pub fn bytes(&self) -> StoreBytes {
        self.cache().bytes()
    }

    /// What went wrong with the file first, if anything did.
    pub fn failure(&self) -> Option<String> {
        self.cache().failure.clone()
    }

    /// Whether all that was asked for came back.
    ///
    /// # Errors
    /// A value could not be read back, and what was made without it is wrong.
    pub fn check(&self) -> Result<(), SpillError> {
        self.cache().lost.clone().map_or(Ok(()), Err)
    }

    fn kept<T>(&self, number: u64, origin: Origin<T>) -> Kept<T> {
        let store = self.clone();
        Kept(Arc::new(Ticket {
            store,
            number,
            origin,
        }))
    }

    fn cache(&self) -> MutexGuard<'_, LruCache> {
        // whoever failed has left the cache as it was: it changes in single steps
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Clone for Kept<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> Kept<T> {
    /// What keeps it.
    pub fn store(&self) -> &Store {
        &self.0.store
    }
}

impl<T: Measured> Kept<T> {
    /// The value; `None` where it, or what it follows from, cannot be read back from the file. The
    /// store remembers that ([`Store::failure`]).
    pub fn get(&self) -> Option<Arc<T>> {
        if let Some(value) = self.found() {
            return Some(value);
        }
        let value = self.made()?;
        let (bytes, value) = (value.bytes(), Arc::new(value));
        let shared: Arc<dyn Any + Send + Sync> = Arc::clone(&value) as _;
        // it has left memory, of which it is a part again
        let mut cache = self.store().cache();
        cache.put_back(self.0.number, shared, bytes);
        Some(value)
    }

    /// [`Self::get`], but a value that has left memory does not come back into it.
    pub fn get_once(&self) -> Option<Arc<T>> {
        self.found().or_else(|| self.made().map(Arc::new))
    }

    /// The value, if it is in memory.
    fn found(&self) -> Option<Arc<T>> {
        let found = self.store().cache().find(self.0.number)?;
        found.downcast().ok()
    }

    /// The value as it was written, or made of others.
    fn made(&self) -> Option<T> {
        let unpack = match &self.0.origin {
            Origin::Own(unpack) => unpack,
            Origin::Derived(make) => return make(),
        };
        let packed = self.store().cache().read(self.0.number)?;
        let value = unpack(&packed);
        if value.is_none() {
            let why = "its bytes mean nothing".to_owned();
            self.store().cache().lose(why);
        }
        value
    }
}

impl<T> Drop for Ticket<T> {
    fn drop(&mut self) {
        // values may hold others: they are dropped when the cache is free again
        let value = self.store.cache().forget(self.number);
        drop(value);
    }
}

impl<T> std::fmt::Debug for Ticket<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Kept({})", self.number)
    }
}
