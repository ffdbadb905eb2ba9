//! No thread dies unheard.

use std::sync::{Arc, Mutex, PoisonError};

/// The first panic of this process since it is watched.
#[derive(Clone, Debug, Default)]
pub struct Panics(Arc<Mutex<Option<String>>>);

impl Panics {
    /// Watches all threads from now on; what was said of a panic before is still said.
    #[must_use]
    pub fn watch() -> Self {
        let panics = Self::default();
        let (heard, earlier) = (panics.clone(), std::panic::take_hook());
        std::panic::set_hook(Box::new(move |panic| {
            let thread = std::thread::current();
            let name = thread.name().unwrap_or("without a name");
            heard.hear(&format!("the thread {name}: {panic}"));
            earlier(panic);
        }));
        panics
    }

    fn hear(&self, text: &str) {
        let mut first = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        first.get_or_insert_with(|| text.to_owned());
    }

    /// Which thread died first, and why.
    #[must_use]
    pub fn first(&self) -> Option<String> {
        let first = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        first.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_thread_that_dies_is_named() {
        let panics = Panics::watch();
        assert_eq!(panics.first(), None);
        for name in ["one", "two"] {
            let thread = std::thread::Builder::new().name(name.into());
            let died = thread.spawn(|| panic!("out of numbers")).unwrap();
            assert!(died.join().is_err());
        }
        let first = panics.first().unwrap();
        assert!(
            first.contains("one") && first.contains("out of numbers"),
            "{first}"
        );
    }
}
