//! When a fragment of the map becomes a part of another.
//!
//! A *sighting* is a keyframe that was recognised in another fragment, verified by points in both
//! directions. Each says where one fragment lies in the other, with its scale. A single one may be
//! wrong (rooms that look alike): fragments are joined when several agree, and more of them than
//! contradict ([`crate::Meeting`]). While the run goes on that is asked whenever a keyframe was
//! recognised. At the end all keyframes are looked up in all other fragments (`merge`).
//!
//! The fragment that began later is moved by one similarity, and with its keyframes all that is
//! known relative to them. Sightings that were aligned become loops. The first keyframes of a
//! random start, whose shape is not reliable yet, never decide.

use super::KeyframeGraph;
use super::sighting::Sighting;
use crate::graph::job::Joined;
use crate::{FragmentId, KeyframeId};
use monogrid_alignment::SimilarityConstraint;
use monogrid_geometry::Sim3;

/// Largest difference between two keyframes that agree where there is no way between them: median
/// depths, rad, and the logarithm of the scale. It grows with the way as drift does, but starts
/// here, because recognised points say less than direct alignment.
const MAX_DISAGREEMENT: f64 = 0.1;

/// Sightings that are kept at most; the oldest are forgotten.
const MAX_SIGHTINGS: usize = 64;

impl KeyframeGraph {
    /// Whether a keyframe may say where its fragment is in that of another.
    pub(super) fn may_join(&self, own: KeyframeId, other: KeyframeId) -> bool {
        let has_converged = |id| self.entries.get(&id).is_some_and(|e| e.view.has_converged);
        has_converged(own) && has_converged(other)
    }

    /// Remembers that a keyframe was recognised in another fragment: by points, and by direct
    /// alignment unless that failed.
    pub(super) fn add_sighting(
        &mut self,
        other: KeyframeId,
        own: KeyframeId,
        other_from_own: Sim3,
        constraint: Option<SimilarityConstraint>,
    ) {
        if self.sightings.len() >= MAX_SIGHTINGS {
            self.sightings.remove(0);
        }
        let sighting = Sighting::new(other, own, other_from_own, constraint);
        self.sightings.push(sighting);
    }

    /// Joins fragments of this run about which enough sightings agree; whether there were any.
    pub(super) fn join_fragments(&mut self) -> bool {
        let config = self.fragments.clone();
        let mut has_joined = false;
        while let Some(pair) = self.strongest(|meeting| meeting.is_enough_in_run(&config)) {
            self.join(&pair.agreeing);
            has_joined = true;
        }
        has_joined
    }

    /// The two fragments of a sighting, the older first.
    pub(super) fn pair_of(&self, sighting: &Sighting) -> (FragmentId, FragmentId) {
        let [a, b] = [sighting.other, sighting.own].map(|id| self.fragment_of(id));
        (a.min(b), a.max(b))
    }

    /// What a sighting says: the pose of the other of its two fragments in `fragment`.
    fn fragment_from_other(&self, fragment: FragmentId, sighting: &Sighting) -> Sim3 {
        let [other, own] = [sighting.other, sighting.own].map(|id| self.pose(id));
        let others_from_owns = other * sighting.other_from_own * own.inverse();
        match self.fragment_of(sighting.other) == fragment {
            true => others_from_owns,
            false => others_from_owns.inverse(),
        }
    }

    /// Whether two sightings of the same fragments say the same, but for what drift can do on the
    /// ways between their keyframes in both fragments, and for the errors of recognition.
    pub(super) fn agree(&self, a: &Sighting, b: &Sighting) -> bool {
        let others_from_owns = self.fragment_from_other(self.fragment_of(b.other), a);
        let world_from = |id: KeyframeId| self.pose(id);
        let predicted = world_from(b.other).inverse() * others_from_owns * world_from(b.own);
        let error = (b.other_from_own.inverse() * predicted).log();
        // keyframes of one fragment are on either side of each sighting
        let is_same_side = self.fragment_of(a.own) == self.fragment_of(b.own);
        let (own_of_a, other_of_a) = if is_same_side {
            (a.own, a.other)
        } else {
            (a.other, a.own)
        };
        let way = self.way(own_of_a, b.own) + self.way(other_of_a, b.other);
        let drift = self.config.places.drift.starting_at(MAX_DISAGREEMENT);
        drift.explains(&error, way)
    }

    /// Moves the newer fragment of agreeing sightings to where the first of them has it in the
    /// older one, and holds it there by all that were aligned.
    pub(super) fn join(&mut self, agreeing: &[Sighting]) {
        let Some(first) = agreeing.first() else {
            return;
        };
        let (into, from) = self.pair_of(first);
        let into_from_fragment = self.fragment_from_other(into, first);
        let sightings = std::mem::take(&mut self.sightings).into_iter();
        let others = sightings.filter(|sighting| self.pair_of(sighting) != (into, from));
        self.sightings = others.collect();
        let poses = self.poses.world_from_keyframe.iter_mut();
        for (pose, fragment) in poses.zip(&mut self.poses.fragment) {
            if *fragment == from {
                *pose = into_from_fragment * *pose;
                *fragment = into;
            }
        }
        for sighting in agreeing {
            if let Some(constraint) = &sighting.constraint {
                self.close_loop(sighting.other, sighting.own, constraint);
            }
        }
        if agreeing.iter().all(|sighting| !sighting.is_aligned()) {
            // until points that both see, or alignment from there, say it better
            self.hold(first.other, first.own);
        }
        self.active.remove(&from);
        self.active.insert(into);
        self.joined.push(Joined { from, into });
    }
}
