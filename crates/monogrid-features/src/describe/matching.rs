//! Brute-force matching of binary descriptors.

use super::Descriptor;

/// Settings of [`match_descriptors`].
#[derive(Clone, Debug, PartialEq)]
pub struct MatchConfig {
    /// Largest number of differing bits. Default 64.
    pub max_distance: u32,
    /// The best must be below this times the second best. Default 0.85; 1 accepts all.
    pub max_ratio: f32,
    /// Whether the match must be the best in both directions. Default true.
    pub cross_check: bool,
}

impl Default for MatchConfig {
    fn default() -> Self {
        Self {
            max_distance: 64,
            max_ratio: 0.85,
            cross_check: true,
        }
    }
}

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

/// For each descriptor in `a` its partner in `b`, if it has one; ordered by `a_idx`.
///
/// Cost: `a.len() * b.len()` comparisons of a few nanoseconds.
#[must_use]
pub fn match_descriptors(
    a: &[Descriptor],
    b: &[Descriptor],
    config: &MatchConfig,
) -> Vec<DescriptorMatch> {
    // nearest of a for every b, smallest index on ties
    let mut nearest_a = vec![(u32::MAX, usize::MAX); b.len()];
    let mut matches = Vec::new();
    for (a_idx, first) in a.iter().enumerate() {
        let (mut best, mut second, mut b_idx) = (u32::MAX, u32::MAX, usize::MAX);
        for ((j, other), nearest) in b.iter().enumerate().zip(&mut nearest_a) {
            let distance = first.distance(other);
            if distance < best {
                (second, best, b_idx) = (best, distance, j);
            } else if distance < second {
                second = distance;
            }
            if distance < nearest.0 {
                *nearest = (distance, a_idx);
            }
        }
        let is_distinct =
            config.max_ratio >= 1.0 || (best as f32) < config.max_ratio * second as f32;
        if best <= config.max_distance && is_distinct {
            matches.push(DescriptorMatch {
                a_idx,
                b_idx,
                distance: best,
            });
        }
    }
    if config.cross_check {
        matches.retain(|m| nearest_a[m.b_idx].1 == m.a_idx);
    }
    matches
}
