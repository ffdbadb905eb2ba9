//! Features of two images that belong together, each compared with all of the other.

use super::Feature;

/// Two descriptors that belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DescriptorMatch {
    /// Index in the first list.
    pub a_idx: usize,
    /// Index in the second list.
    pub b_idx: usize,
    /// Bits that differ.
    pub distance: u32,
}

/// The closest of the descriptors that one was compared with, and the distance of the second.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest {
    pub best: DescriptorMatch,
    second: u32,
}

impl Nearest {
    pub(super) fn of(best: DescriptorMatch) -> Self {
        Self {
            best,
            second: u32::MAX,
        }
    }

    /// Of two that are as close the first in the second list, then the one that came first.
    pub(super) fn add(&mut self, found: DescriptorMatch) {
        let key = |m: &DescriptorMatch| (m.distance, m.b_idx);
        if key(&found) < key(&self.best) {
            self.second = self.best.distance;
            self.best = found;
        } else {
            self.second = self.second.min(found.distance);
        }
    }

    /// [`Self::add`] where this may be the first.
    fn update(nearest: &mut Option<Self>, found: DescriptorMatch) {
        match nearest {
            Some(known) => known.add(found),
            None => *nearest = Some(Self::of(found)),
        }
    }

    /// Whether the second is farther away (`[LOWE04]`, section 7.1).
    pub(super) fn is_distinct(&self, max_ratio: f32) -> bool {
        max_ratio >= 1.0 || (self.best.distance as f32) < max_ratio * self.second as f32
    }
}

/// Pairs of features of `a` and `b` that are nearest to each other, differ in `max_distance` bits
/// at most, and are closer than `max_ratio` times the second of `b`. Blur and large steps change
/// more bits than an index forgives, so that nothing is left out here.
#[must_use]
pub(crate) fn match_features(
    a: &[Feature],
    b: &[Feature],
    max_distance: u32,
    max_ratio: f32,
) -> Vec<DescriptorMatch> {
    let mut of_b: Vec<Option<Nearest>> = vec![None; b.len()];
    let of_a = a.iter().enumerate().map(|(a_idx, feature)| {
        let mut nearest = None;
        for (b_idx, other) in b.iter().enumerate() {
            let found = DescriptorMatch {
                a_idx,
                b_idx,
                distance: feature.descriptor.distance(&other.descriptor),
            };
            Nearest::update(&mut nearest, found);
            Nearest::update(&mut of_b[b_idx], found);
        }
        nearest
    });
    let of_a: Vec<Option<Nearest>> = of_a.collect();
    let is_mutual = |m: &DescriptorMatch| of_b[m.b_idx].is_some_and(|n| n.best.a_idx == m.a_idx);
    of_a.into_iter()
        .flatten()
        .filter(|n| n.best.distance <= max_distance && n.is_distinct(max_ratio))
        .map(|n| n.best)
        .filter(is_mutual)
        .collect()
}
