//! Work split over threads whose results do not depend on how it was split.

use std::sync::Mutex;

/// Runs `work` on every item, on up to `threads` threads, items handed out one at a time.
///
/// Items must not depend on each other; each is changed by one thread only.
pub(crate) fn for_each<T: Send>(
    items: &mut [T],
    threads: usize,
    work: impl Fn(usize, &mut T) + Sync,
) {
    let threads = threads.min(items.len());
    if threads <= 1 {
        for (index, item) in items.iter_mut().enumerate() {
            work(index, item);
        }
        return;
    }
    let queue = Mutex::new(items.iter_mut().enumerate());
    let next = || match queue.lock() {
        Ok(mut queue) => queue.next(),
        // Another worker panicked: its panic is reported when the scope ends.
        Err(_) => None,
    };
    std::thread::scope(|scope| {
        let run = || {
            while let Some((index, item)) = next() {
                work(index, item);
            }
        };
        for _ in 1..threads {
            scope.spawn(run);
        }
        run();
    });
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_item_is_worked_on_once_for_any_number_of_threads() {
        for threads in [0, 1, 2, 7, 100] {
            let mut items = vec![0_usize; 37];
            super::for_each(&mut items, threads, |index, item| *item += index + 1);
            assert!(items.iter().enumerate().all(|(i, v)| *v == i + 1));
        }
    }
}
