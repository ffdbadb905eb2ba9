//! Fragments that were recorded apart, joined all at once: runs of different days and cameras that
//! show the same places.
//!
//! While a run goes on a fragment is joined as soon as a few sightings agree. Here nobody waits, so
//! all are known first: every keyframe is looked up in every other fragment, and what is found for
//! two fragments is divided into sets of sightings that are consistent with each other pair by pair
//! (`[MANGELSON18]`). The two fragments with the largest set are joined first; where they lie then
//! decides what is consistent about the others.

use super::KeyframeGraph;
use super::constrain::MAX_LOOPS;
use super::optimise::Search;
use super::sighting::Sighting;
use crate::graph::job::GraphUpdate;
use crate::{Agreement, FragmentId, KeyframeId, Meeting, MergeConfig};
use monogrid_geometry::Sim3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

/// Sightings of two fragments that are compared with each other at most, evenly chosen: the largest
/// consistent set takes time with their cube.
const MAX_COMPARED: usize = 240;

/// Two fragments, and the largest set of sightings that agree about them.
pub(super) struct Consistent {
    meeting: Meeting,
    pub agreeing: Vec<Sighting>,
}

impl KeyframeGraph {
    /// Joins all fragments that show the same places, and moves the keyframes to where the edges of
    /// all of them have them. Also says what each two fragments had in common before.
    pub(crate) fn merge(&mut self, config: &MergeConfig) -> (GraphUpdate, Vec<Meeting>) {
        self.active = self.poses.fragment.iter().copied().collect();
        self.sightings = self.meet();
        let meetings = self.consistent_pairs();
        let meetings = meetings.into_iter().map(|pair| pair.meeting).collect();
        while let Some(pair) = self.strongest(|meeting| meeting.is_enough(config)) {
            self.join(&pair.agreeing);
            self.optimise(Search::Wide);
        }
        self.optimise(Search::Final);
        self.search_all();
        self.update_covariances(true);
        (self.update(), meetings)
    }

    /// Joins fragments of this run at its end: what was seen first may show what was only seen
    /// later.
    pub(super) fn join_in_the_end(&mut self) {
        self.sightings = self.meet();
        if self.join_fragments() {
            self.optimise(Search::Wide);
        }
    }

    /// Every keyframe, recognised in every other fragment.
    fn meet(&mut self) -> Vec<Sighting> {
        let ids: Vec<KeyframeId> = self.entries.keys().copied().collect();
        let this: &Self = self;
        let fragments: BTreeSet<FragmentId> = this.poses.fragment.iter().copied().collect();
        let in_others = |id: &KeyframeId| {
            let own = this.fragment_of(*id);
            let others = fragments.iter().filter(move |f| **f != own);
            let found = others.flat_map(|other| this.recognise(*id, *other));
            found.collect::<Vec<_>>()
        };
        // the same two keyframes may have recognised each other
        let recognised: BTreeMap<(KeyframeId, KeyframeId), Sim3> =
            ids.par_iter().flat_map_iter(in_others).collect();
        self.stats.loops_proposed += recognised.len();
        let mut sightings = Vec::with_capacity(recognised.len());
        for ((other, own), other_from_own) in recognised {
            let constraint = self.align(own, other, other_from_own);
            sightings.push(Sighting::new(other, own, other_from_own, constraint));
        }
        sightings
    }

    /// The keyframes of a fragment that show what keyframe `id` of another one shows: the older and
    /// the newer of the two, and `older_from_newer`.
    fn recognise(
        &self,
        id: KeyframeId,
        fragment: FragmentId,
    ) -> Vec<((KeyframeId, KeyframeId), Sim3)> {
        let may_join = |other: u64| {
            let other = other as KeyframeId;
            self.fragment_of(other) == fragment && self.may_join(id, other)
        };
        let found = self.find_loops(id, may_join);
        let best = found.into_iter().take(MAX_LOOPS);
        best.map(|found| {
            let other = found.keyframe as KeyframeId;
            if other < id {
                ((other, id), found.this_from_other.inverse())
            } else {
                ((id, other), found.this_from_other)
            }
        })
        .collect()
    }

    /// The two fragments that have most in common, if that is enough to join them.
    pub(super) fn strongest(&self, is_enough: impl Fn(&Meeting) -> bool) -> Option<Consistent> {
        let pairs = self.consistent_pairs().into_iter();
        pairs
            .filter(|pair| is_enough(&pair.meeting))
            .max_by_key(|pair| (pair.meeting.agreeing, Reverse(pair.meeting.fragments)))
    }

    /// What is known about each two fragments that have sightings of each other.
    fn consistent_pairs(&self) -> Vec<Consistent> {
        let mut pairs: BTreeMap<(FragmentId, FragmentId), Vec<&Sighting>> = BTreeMap::new();
        for sighting in &self.sightings {
            let pair = self.pair_of(sighting);
            pairs.entry(pair).or_default().push(sighting);
        }
        let pairs = pairs.iter();
        let consistent = pairs.map(|(pair, sightings)| self.consistent(*pair, sightings));
        consistent.collect()
    }

    /// Divides the sightings of two fragments.
    fn consistent(
        &self,
        fragments: (FragmentId, FragmentId),
        sightings: &[&Sighting],
    ) -> Consistent {
        let every = sightings.len().div_ceil(MAX_COMPARED).max(1);
        let compared: Vec<&Sighting> = sightings.iter().copied().step_by(every).collect();
        let agrees = |a: &&Sighting| {
            let agrees = |b: &&Sighting| self.agree(a, b) && self.agree(b, a);
            compared.iter().map(agrees).collect()
        };
        let agree: Vec<Vec<bool>> = compared.iter().map(agrees).collect();
        let all: Vec<usize> = (0..compared.len()).collect();
        let best = largest_clique(&agree, &all);
        let others: Vec<usize> = all.into_iter().filter(|i| !best.contains(i)).collect();
        let second = largest_clique(&agree, &others);
        let chosen = |set: &[usize]| set.iter().map(|i| compared[*i]).collect::<Vec<_>>();
        let meeting = Meeting {
            fragments,
            sightings: sightings.len(),
            agreeing: self.agreement(&chosen(&best)),
            contradicting: self.agreement(&chosen(&second)),
        };
        // one that was aligned says best where the fragment lies
        let mut agreeing: Vec<Sighting> = chosen(&best).into_iter().cloned().collect();
        agreeing.sort_by_key(|sighting| !sighting.is_aligned());
        Consistent { meeting, agreeing }
    }

    /// How much a consistent set says.
    fn agreement(&self, sightings: &[&Sighting]) -> Agreement {
        let mut sides: BTreeMap<FragmentId, BTreeSet<KeyframeId>> = BTreeMap::new();
        for id in sightings.iter().flat_map(|s| [s.own, s.other]) {
            sides.entry(self.fragment_of(id)).or_default().insert(id);
        }
        Agreement {
            keyframes: sides.values().map(BTreeSet::len).min().unwrap_or(0),
            aligned: sightings.iter().filter(|s| s.is_aligned()).count(),
            pairs: sightings.len(),
        }
    }
}

/// The largest set of `nodes` that are all linked to each other, as far as it is found by taking
/// each node as the first and adding those with most links one after the other.
fn largest_clique(is_linked: &[Vec<bool>], nodes: &[usize]) -> Vec<usize> {
    let degree = |i: usize| nodes.iter().filter(|j| is_linked[i][**j]).count();
    let mut order = nodes.to_vec();
    order.sort_by_key(|i| (Reverse(degree(*i)), *i));
    let mut best: Vec<usize> = Vec::new();
    for first in &order {
        let mut clique = vec![*first];
        for i in &order {
            if i != first && clique.iter().all(|j| is_linked[*i][*j]) {
                clique.push(*i);
            }
        }
        if clique.len() > best.len() {
            best = clique;
        }
    }
    best.sort_unstable();
    best
}

#[cfg(test)]
mod tests;
