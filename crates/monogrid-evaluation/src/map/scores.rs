//! How often each score occurs among truly occupied, free and unknown cells.
//!
//! A map of half a billion cells has few distinct scores: everything that ranks or counts works on
//! this table, and unobserved cells never have to be visited.

use crate::truth::CellCounts;
use std::collections::HashMap;

/// Cells by what is true of them, per distinct log-odds.
#[derive(Clone, Debug, Default)]
pub(crate) struct ScoreCounter {
    slot_of_bits: HashMap<u32, usize>,
    entries: Vec<(f32, CellCounts)>,
    /// Bits and slot seen last: neighbouring cells often agree.
    last: Option<(u32, usize)>,
}

impl ScoreCounter {
    /// The counts of a score, to be increased.
    pub fn at(&mut self, log_odds: f32) -> &mut CellCounts {
        // Zero and minus zero are one score.
        let log_odds = if log_odds == 0.0 { 0.0 } else { log_odds };
        let bits = log_odds.to_bits();
        let slot = match self.last {
            Some((last_bits, slot)) if last_bits == bits => slot,
            _ => *self.slot_of_bits.entry(bits).or_insert_with(|| {
                self.entries.push((log_odds, CellCounts::default()));
                self.entries.len() - 1
            }),
        };
        self.last = Some((bits, slot));
        &mut self.entries[slot].1
    }

    /// All scores in ascending order.
    pub fn into_sorted(mut self) -> Vec<(f32, CellCounts)> {
        self.entries.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.entries
    }
}

/// Cells of one probability that a policy counts: positives are truly occupied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ScoreGroup {
    pub probability: f64,
    pub positives: u64,
    pub negatives: u64,
}

/// Sorts by probability and joins groups of the same one; drops empty groups.
pub(crate) fn joined(mut groups: Vec<ScoreGroup>) -> Vec<ScoreGroup> {
    groups.retain(|g| g.positives + g.negatives > 0);
    groups.sort_by(|a, b| a.probability.total_cmp(&b.probability));
    let mut joined: Vec<ScoreGroup> = Vec::with_capacity(groups.len());
    for group in groups {
        match joined.last_mut() {
            Some(last) if last.probability == group.probability => {
                last.positives += group.positives;
                last.negatives += group.negatives;
            }
            _ => joined.push(group),
        }
    }
    joined
}
