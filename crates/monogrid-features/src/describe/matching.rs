//! Features of two images that belong together, each compared with all of the other.

use super::{DescriptorMatch, Feature};

/// The closest of what a feature was compared with, and the distance of the second.
#[derive(Clone, Copy)]
struct Nearest {
    distance: u32,
    idx: usize,
    second: u32,
}

impl Nearest {
    const NONE: Self = Self {
        distance: u32::MAX,
        idx: usize::MAX,
        second: u32::MAX,
    };

    /// Ties go to the first.
    fn add(&mut self, distance: u32, idx: usize) {
        if distance < self.distance {
            self.second = self.distance;
            (self.distance, self.idx) = (distance, idx);
        } else {
            self.second = self.second.min(distance);
        }
    }
}

/// Pairs of features of `a` and `b` that are nearest to each other, differ in `max_distance` bits
/// at most, and are closer than `max_ratio` times the second of `b` (`[LOWE04]`, section 7.1). Blur
/// and large steps change more bits than an index forgives, so that nothing is left out here.
#[must_use]
pub(crate) fn match_features(
    a: &[Feature],
    b: &[Feature],
    max_distance: u32,
    max_ratio: f32,
) -> Vec<DescriptorMatch> {
    let mut of_b = vec![Nearest::NONE; b.len()];
    let of_a = a.iter().enumerate().map(|(a_idx, feature)| {
        let mut nearest = Nearest::NONE;
        for (b_idx, other) in b.iter().enumerate() {
            let distance = feature.descriptor.distance(&other.descriptor);
            nearest.add(distance, b_idx);
            of_b[b_idx].add(distance, a_idx);
        }
        nearest
    });
    let of_a: Vec<Nearest> = of_a.collect();
    let is_distinct = |n: &Nearest| {
        n.distance <= max_distance && (n.distance as f32) < max_ratio * n.second as f32
    };
    let pairs = of_a.iter().enumerate();
    let mutual = pairs.filter(|(a_idx, n)| is_distinct(n) && of_b[n.idx].idx == *a_idx);
    mutual
        .map(|(a_idx, n)| DescriptorMatch {
            a_idx,
            b_idx: n.idx,
            distance: n.distance,
        })
        .collect()
}
