//! Panics on purpose, by which tests see that no part of a run can fail unheard.

/// Panics where the environment variable `MONOGRID_PANIC_IN` is `part:N` and this is the N-th
/// passage of that part, the first being 1. Builds without debug assertions never do.
///
/// # Panics
/// That is what it is for.
pub fn pass(part: &str) {
    #[cfg(debug_assertions)]
    injected::pass(part);
    #[cfg(not(debug_assertions))]
    let _ = part;
}

#[cfg(debug_assertions)]
mod injected {
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicUsize, Ordering};

    static WANTED: OnceLock<Option<(String, usize)>> = OnceLock::new();
    static PASSED: AtomicUsize = AtomicUsize::new(0);

    fn wanted() -> Option<(String, usize)> {
        let value = std::env::var("MONOGRID_PANIC_IN").ok()?;
        let (part, passage) = value.split_once(':')?;
        Some((part.to_owned(), passage.parse().ok()?))
    }

    pub(super) fn pass(part: &str) {
        if let Some((wanted, passage)) = WANTED.get_or_init(wanted)
            && wanted == part
        {
            let passed = PASSED.fetch_add(1, Ordering::Relaxed) + 1;
            assert!(passed != *passage, "a panic on purpose in {part}");
        }
    }
}
