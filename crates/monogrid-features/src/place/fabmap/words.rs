//! Words: binary descriptors that stand for all that are near.

use crate::{Descriptor, Rng};

/// Index of the nearest word and its distance, the smallest index on ties; `None` without words.
pub(super) fn nearest(words: &[Descriptor], descriptor: &Descriptor) -> Option<(usize, u32)> {
    let distances = words.iter().map(|word| word.distance(descriptor));
    distances.enumerate().min_by_key(|(_, distance)| *distance)
}

/// Median of binary descriptors: each bit as most of them have it (of equally many, zero), which is
/// the point with the least sum of Hamming distances.
pub(super) fn majority<'a>(descriptors: impl IntoIterator<Item = &'a Descriptor>) -> Descriptor {
    let mut counts = [0i64; 256];
    for descriptor in descriptors {
        for (bit, count) in counts.iter_mut().enumerate() {
            let is_set = descriptor.0[bit / 64] >> (bit % 64) & 1 == 1;
            *count += if is_set { 1 } else { -1 };
        }
    }
    let mut median = Descriptor::default();
    for (bit, count) in counts.iter().enumerate() {
        median.0[bit / 64] |= u64::from(*count > 0) << (bit % 64);
    }
    median
}

/// Seeds of the clusters: each next descriptor is drawn in proportion to its squared distance to
/// the nearest seed (k-means++, `[ARTHUR07]`). Fewer when there are fewer different ones.
fn seeds(descriptors: &[Descriptor], count: usize, rng: &mut Rng) -> Vec<Descriptor> {
    if descriptors.is_empty() || count == 0 {
        return Vec::new();
    }
    let mut seeds = vec![descriptors[rng.below(descriptors.len())]];
    let mut weights = vec![u64::MAX; descriptors.len()];
    while seeds.len() < count {
        let newest = seeds[seeds.len() - 1];
        let mut total = 0u64;
        for (weight, descriptor) in weights.iter_mut().zip(descriptors) {
            *weight = (*weight).min(u64::from(newest.distance(descriptor)).pow(2));
            total += *weight;
        }
        if total == 0 {
            break;
        }
        let mut left = ((u128::from(rng.next_u64()) * u128::from(total)) >> 64) as u64;
        let chosen = weights.iter().position(|weight| {
            let is_here = left < *weight;
            left = left.saturating_sub(*weight);
            is_here
        });
        seeds.extend(chosen.map(|i| descriptors[i]));
    }
    seeds
}

/// At most `count` words for the descriptors: Lloyd's iterations with medians, until nothing moves
/// or `max_iterations`. `done` hears the number of finished iterations.
pub(super) fn k_majority(
    descriptors: &[Descriptor],
    count: usize,
    max_iterations: usize,
    seed: u64,
    mut done: impl FnMut(usize),
) -> Vec<Descriptor> {
    let mut words = seeds(descriptors, count, &mut Rng::new(seed));
    for iteration in 0..max_iterations {
        let mut members: Vec<Vec<&Descriptor>> = vec![Vec::new(); words.len()];
        for descriptor in descriptors {
            if let Some((word, _)) = nearest(&words, descriptor) {
                members[word].push(descriptor);
            }
        }
        let moved: Vec<Descriptor> = words
            .iter()
            .zip(members)
            .map(|(word, members)| {
                // a word that lost all its members stays: it may win others
                if members.is_empty() {
                    *word
                } else {
                    majority(members)
                }
            })
            .collect();
        let has_converged = moved == words;
        words = moved;
        done(iteration + 1);
        if has_converged {
            break;
        }
    }
    words.sort_unstable_by_key(|word| word.0);
    words.dedup();
    words
}
