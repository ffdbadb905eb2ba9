//! Work on all keyframes.

use monogrid_slam::fault;
use rayon::prelude::*;

/// Results of independent work in their order, on the threads of the pool if on several: each takes
/// the next that nobody has begun, so that those under way are neighbours, which share what is in
/// memory.
pub(crate) fn for_each_keyframe<T: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> T + Sync,
) -> Vec<T> {
    let result = |index| {
        fault::pass("depth");
        (index, work(index))
    };
    let mut results: Vec<(usize, T)> = match threads {
        0 | 1 => (0..count).map(result).collect(),
        _ => (0..count).par_bridge().map(result).collect(),
    };
    results.sort_unstable_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}
