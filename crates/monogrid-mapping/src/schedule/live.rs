//! Better depth of keyframes while a run goes on.
//!
//! They take the stages of the final maps (module `stages`), one keyframe and one stage at a time.
//! A keyframe takes a stage when the [`AHEAD`] keyframes after it are as far, so that neighbours on
//! both sides have their say, and its depth is ready when five more are finished. Who has no time
//! for all of them leaves out some: keyframes are taken in their order, and where more than
//! [`MAX_BEHIND`] wait, the newest are, the others when there is nothing else to do.

use super::stages::{Completed, Found, agreed, completed, found, mapped, matched};
use crate::agreement::Certainty;
use crate::scene::Depths;
use crate::scene::View;
use crate::scene::{PosedKeyframe, Scene};
use crate::stereo::neighbours;
use crate::{KeyframeCamera, KeyframeScan, MappingConfig};
use monogrid_depth::DenseDepth;
use monogrid_slam::store::Kept;
use monogrid_slam::{KeptKeyframe, KeyframeId, PoseSnapshot};
use std::collections::VecDeque;

/// Later keyframes that must be as far as one that takes a step.
const AHEAD: usize = 1;

/// Keyframes that wait for their first step while it is taken in order.
const MAX_BEHIND: usize = 8;
/// Keyframes of which what was found is kept for the others.
const MAX_HELD: usize = 20;
/// How far from a keyframe, in keyframes, are those that tell how certain its depth is.
const COMPARED: usize = 3;

/// How far a keyframe has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Waiting,
    /// Its image was matched with those of its neighbours.
    Matched,
    /// What these confirm was merged with its own depth, refined and filled.
    Found,
    /// As certain as they agree, and fused with theirs.
    Agreed,
    /// With depth that they have and it has not.
    Completed,
    /// Handed over.
    Ready,
}

/// A keyframe and how far it has come. What it had at each stage is kept, since neighbours that are behind compare theirs with it.
#[derive(Debug)]
struct Work {
    keyframe: KeptKeyframe,
    stage: Stage,
    /// Its dense depth, as it was matched.
    dense: Option<Kept<DenseDepth>>,
    /// What was found by each later stage.
    found: Option<Found>,
    agreed: Option<Found>,
    completed: Option<Completed>,
}

impl Work {
    /// Nothing was found yet.
    fn new(keyframe: KeptKeyframe) -> Self {
        Self {
            keyframe,
            stage: Stage::Waiting,
            dense: None,
            found: None,
            agreed: None,
            completed: None,
        }
    }
}

/// What a step has done.
#[derive(Debug)]
pub(crate) enum Step {
    /// There was nothing to do.
    Idle,
    /// Something that nobody sees yet.
    Worked,
    /// A keyframe has better depth.
    Better(KeyframeScan),
}

/// The keyframes of a run.
#[derive(Debug)]
pub(crate) struct LiveDepth {
    config: MappingConfig,
    camera: KeyframeCamera,
    /// By identity.
    work: Vec<Work>,
    /// Those of which something is kept, in the order in which they were matched.
    held: VecDeque<KeyframeId>,
    /// The one that was matched last.
    last: Option<KeyframeId>,
}

impl LiveDepth {
    /// Of no keyframe yet.
    pub fn new(config: MappingConfig, camera: KeyframeCamera) -> Self {
        Self {
            config,
            camera,
            work: Vec::new(),
            held: VecDeque::new(),
            last: None,
        }
    }

    /// Takes a keyframe, or another depth of one.
    pub fn add(&mut self, keyframe: KeptKeyframe) {
        match self.index(keyframe.id) {
            Ok(index) => {
                self.held.retain(|held| *held != keyframe.id);
                self.work[index] = Work::new(keyframe);
            }
            Err(index) => self.work.insert(index, Work::new(keyframe)),
        }
    }

    /// Whether better depth of a keyframe was handed over.
    pub fn has_handed_over(&self, id: KeyframeId) -> bool {
        self.index(id)
            .is_ok_and(|index| self.work[index].stage == Stage::Ready)
    }

    /// Lets one keyframe take a step, at poses that are the newest.
    pub fn step(&mut self, poses: &PoseSnapshot) -> Step {
        let Some(index) = self.next() else {
            return Step::Idle;
        };
        let stage = match self.work[index].stage {
            Stage::Waiting => self.match_images(index, poses),
            Stage::Matched => self.find(index, poses),
            Stage::Found => self.agree(index, poses),
            Stage::Agreed => self.complete(index, poses),
            Stage::Completed | Stage::Ready => {
                self.work[index].stage = Stage::Ready;
                return Step::Better(self.map(index, poses));
            }
        };
        self.work[index].stage = stage;
        Step::Worked
    }

    /// The keyframe that takes a step: the one that is nearest to its end, else one that waits.
    fn next(&self) -> Option<usize> {
        let begun = Stage::Matched..Stage::Ready;
        let ready = self.ready_for_more();
        let begun = ready.filter(|index| begun.contains(&self.work[*index].stage));
        // the first of equal ones
        let furthest = begun.rev().max_by_key(|index| self.work[*index].stage);
        furthest.or_else(|| self.next_waiting())
    }

    /// Those with enough later ones that are as far.
    fn ready_for_more(&self) -> impl DoubleEndedIterator<Item = usize> {
        (0..self.work.len().saturating_sub(AHEAD)).filter(|index| {
            let ahead = &self.work[index + 1..=index + AHEAD];
            let stage = self.work[*index].stage;
            ahead.iter().all(|later| later.stage >= stage)
        })
    }

    /// The one that is to be matched: after the last one in order, the newest where too many wait, else the oldest.
    fn next_waiting(&self) -> Option<usize> {
        let after = match self.last.map(|id| self.index(id)) {
            Some(Ok(index) | Err(index)) => index,
            None => 0,
        };
        let is_waiting = |index: &usize| self.work[*index].stage == Stage::Waiting;
        let waiting = || self.ready_for_more().filter(is_waiting);
        let mut later = waiting().skip_while(|index| *index < after);
        let Some(next) = later.next() else {
            return waiting().next();
        };
        let newest = later.last().unwrap_or(next);
        Some(if newest - next >= MAX_BEHIND {
            newest
        } else {
            next
        })
    }

    /// Matches the image of a keyframe with those of its neighbours.
    fn match_images(&mut self, index: usize, poses: &PoseSnapshot) -> Stage {
        let store = self.work[index].keyframe.store();
        let dense = self.scene(poses, &[], |scene| {
            matched(scene, index, &neighbours(scene, index), store)
        });
        let work = &mut self.work[index];
        let id = work.keyframe.id;
        work.dense = dense;
        self.last = Some(id);
        self.held.push_back(id);
        while self.held.len() > MAX_HELD
            && let Some(oldest) = self.held.pop_front()
        {
            self.forget(oldest);
        }
        Stage::Matched
    }

    /// Merges what neighbours confirm with the depth of the filter.
    fn find(&mut self, index: usize, poses: &PoseSnapshot) -> Stage {
        let store = self.work[index].keyframe.store();
        let dense = |other: usize| self.work[other].dense.as_ref()?.get();
        let found = self.scene(poses, &[], |scene| {
            found(scene, index, &neighbours(scene, index), dense, store)
        });
        self.work[index].found = Some(found);
        Stage::Found
    }

    /// Makes its depth as certain as others agree, and fuses it with theirs.
    fn agree(&mut self, index: usize, poses: &PoseSnapshot) -> Stage {
        if let Some(found) = &self.work[index].found {
            let near = self.views(COMPARED, index, |work| work.found.as_ref());
            let certainty = self.scene(poses, &near, Certainty::of_scene);
            let views = self.views(MAX_HELD, index, |work| work.found.as_ref());
            let agreed = self.scene(poses, &views, |scene| {
                agreed(scene, found, index, certainty)
            });
            self.work[index].agreed = Some(agreed);
        }
        Stage::Agreed
    }

    /// Takes over depth that others have and it has not.
    fn complete(&mut self, index: usize, poses: &PoseSnapshot) -> Stage {
        if let Some(agreed) = &self.work[index].agreed {
            let views = self.views(MAX_HELD, index, |work| work.agreed.as_ref());
            let completed = self.scene(poses, &views, |scene| completed(scene, agreed, index));
            self.work[index].completed = Some(completed);
        }
        Stage::Completed
    }

    /// What of a keyframe is mapped; nothing where nothing was found.
    fn map(&self, index: usize, poses: &PoseSnapshot) -> KeyframeScan {
        let work = &self.work[index];
        let Some(completed) = &work.completed else {
            let store = work.keyframe.store();
            return Depths::default().joined(work.keyframe.id, &self.camera, store);
        };
        let views = self.views(MAX_HELD, index, |work| {
            Some(&work.completed.as_ref()?.found)
        });
        let cloud = |other: usize| Some(&self.work[other].completed.as_ref()?.cloud);
        self.scene(poses, &views, |scene| {
            mapped(scene, completed, index, cloud)
        })
    }

    /// What keyframes have at a stage, by their index, of those around one.
    fn views(
        &self,
        reach: usize,
        index: usize,
        at_stage: impl Fn(&Work) -> Option<&Found>,
    ) -> Vec<Option<View>> {
        let around = index.saturating_sub(reach)..=index + reach;
        let work = self.work.iter().enumerate();
        work.map(|(other, work)| match around.contains(&other) {
            true => at_stage(work)?.view.clone(),
            false => None,
        })
        .collect()
    }

    /// Does something with the keyframes at their poses and what they have.
    fn scene<T>(
        &self,
        poses: &PoseSnapshot,
        views: &[Option<View>],
        with: impl FnOnce(&Scene) -> T,
    ) -> T {
        let work = self.work.iter();
        let keyframes: Vec<PosedKeyframe> = work
            .map(|work| PosedKeyframe::kept(&work.keyframe, poses))
            .collect();
        with(&Scene {
            keyframes: &keyframes,
            views,
            camera: &self.camera,
            config: &self.config,
            threads: 1,
        })
    }

    /// Leaves what was found of a keyframe; one that was not handed over begins again.
    fn forget(&mut self, id: KeyframeId) {
        if let Ok(index) = self.index(id) {
            let work = &mut self.work[index];
            (work.dense, work.found, work.agreed, work.completed) = (None, None, None, None);
            if work.stage != Stage::Ready {
                work.stage = Stage::Waiting;
            }
        }
    }

    /// Where a keyframe is, or would be.
    fn index(&self, id: KeyframeId) -> Result<usize, usize> {
        self.work.binary_search_by_key(&id, |work| work.keyframe.id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_wall::{CAMERA, depths, share_right, wall};
    use crate::{DepthOf, ImageOf, final_scans};
    use monogrid_geometry::{Rotation, Sim3, Vec3};
    use monogrid_slam::Keyframe;
    use std::ops::Range;

    fn place(id: KeyframeId) -> f64 {
        0.12 * f64::from(id)
    }

    fn poses(count: KeyframeId) -> PoseSnapshot {
        let pose = |id| Sim3::new(1.0, Rotation::identity(), Vec3::new(place(id), 0.0, 0.0));
        PoseSnapshot {
            world_from_keyframe: (0..count).map(pose).collect(),
            ..PoseSnapshot::default()
        }
    }

    /// A keyframe that knows the depth of every ninth pixel, 4 % too large.
    fn keyframe(id: KeyframeId) -> Keyframe {
        let mut pixels = depths(1.0);
        pixels.retain(|p| p.x % 3 == 0 && p.y % 3 == 0);
        Keyframe {
            id,
            frame_index: id as usize,
            timestamp_ns: 0,
            revision: 0,
            image: wall(place(id)),
            pixels,
        }
    }

    fn live() -> LiveDepth {
        LiveDepth::new(MappingConfig::default(), CAMERA)
    }

    /// Lets it do all that there is to do; the keyframes that it handed over, in this order.
    fn rest(live: &mut LiveDepth, poses: &PoseSnapshot) -> Vec<KeyframeScan> {
        let mut ready = Vec::new();
        loop {
            match live.step(poses) {
                Step::Idle => return ready,
                Step::Worked => {}
                Step::Better(scan) => ready.push(scan),
            }
        }
    }

    fn ids(scans: &[KeyframeScan]) -> Vec<KeyframeId> {
        scans.iter().map(|scan| scan.id).collect()
    }

    /// Some keyframes, and how far they have come.
    fn stages(count: KeyframeId, stages: &[(Range<usize>, Stage)]) -> LiveDepth {
        let mut live = live();
        for id in 0..count {
            live.add(keyframe(id).into());
        }
        for (range, stage) in stages {
            for work in &mut live.work[range.clone()] {
                work.stage = *stage;
            }
        }
        live
    }

    #[test]
    fn a_keyframe_is_ready_when_five_more_are_finished_with_depth_as_good_as_that_of_final_maps() {
        let (count, snapshot) = (11, poses(11));
        let mut live = live();
        let mut ready = Vec::new();
        for id in 0..count {
            live.add(keyframe(id).into());
            let scans = rest(&mut live, &snapshot);
            let expected: Vec<KeyframeId> = id.checked_sub(5).into_iter().collect();
            assert_eq!(ids(&scans), expected);
            ready.extend(scans);
        }
        assert!(live.has_handed_over(5) && !live.has_handed_over(6));
        let keyframes: Vec<Keyframe> = (0..count).map(keyframe).collect();
        let posed: Vec<PosedKeyframe> = keyframes
            .iter()
            .map(|keyframe| PosedKeyframe {
                id: keyframe.id,
                image: Some(ImageOf::Held(&keyframe.image)),
                depth: DepthOf::Held(&keyframe.pixels),
                world_from_keyframe: snapshot.in_main_map(keyframe.id).copied(),
            })
            .collect();
        let config = MappingConfig::default();
        let last = final_scans(&posed, &CAMERA, &config, 2);
        // the first one has neighbours on one side, of which too few confirm it
        for scan in &ready[1..] {
            // the newest are seen from one side only when they take their steps
            let share = if scan.id < 4 { 0.95 } else { 0.8 };
            let all = last[scan.id as usize].num_pixels as f64;
            assert!(scan.num_pixels as f64 > share * all, "{}", scan.id);
            // what a single neighbour confirms, until the others are there, is now and then wrong
            assert!(share_right(scan, 1.0) > 0.98);
            assert!(share_right(&last[scan.id as usize], 1.0) > 0.99);
        }
        // the filter has too little to be mapped, and nothing right
        let measured = &keyframes[1].pixels;
        let of_filter = KeyframeScan::new(1, measured, None, &CAMERA, &config);
        assert!(of_filter.num_pixels == 0 && !measured.is_empty());
    }

    #[test]
    fn work_that_has_begun_goes_first_and_needs_later_keyframes_that_are_as_far() {
        let next = |given: &[(Range<usize>, Stage)]| stages(9, given).next();
        assert_eq!(next(&[]), Some(0));
        assert_eq!(next(&[(0..1, Stage::Matched)]), Some(1));
        assert_eq!(next(&[(0..2, Stage::Matched)]), Some(0));
        let two = [(0..1, Stage::Found), (1..3, Stage::Matched)];
        assert_eq!(next(&two), Some(1));
        let three = [(4..5, Stage::Agreed), (5..9, Stage::Matched)];
        assert_eq!(next(&three), Some(5));
        let four = [(4..6, Stage::Agreed), (6..9, Stage::Found)];
        assert_eq!(next(&four), Some(4));
        let last_steps = [
            (0..1, Stage::Completed),
            (1..4, Stage::Agreed),
            (4..9, Stage::Found),
        ];
        assert_eq!(next(&last_steps), Some(1));
        let last_step = [
            (0..2, Stage::Completed),
            (2..4, Stage::Agreed),
            (4..9, Stage::Found),
        ];
        assert_eq!(next(&last_step), Some(0));
        assert_eq!(next(&[(0..9, Stage::Ready)]), None);
        // there is none after the last one
        assert_eq!(next(&[(0..8, Stage::Ready)]), None);
    }

    #[test]
    fn who_is_behind_leaves_keyframes_out_until_there_is_time() {
        let mut live = stages(20, &[(0..20, Stage::Ready)]);
        let wait = |live: &mut LiveDepth, range: Range<usize>| {
            for work in &mut live.work[range] {
                work.stage = Stage::Waiting;
            }
        };
        live.last = Some(9);
        wait(&mut live, 10..19);
        // in order: of nine that wait the newest is eight after the first, and goes first
        assert_eq!(live.next_waiting(), Some(18));
        live.work[18].stage = Stage::Ready;
        assert_eq!(live.next_waiting(), Some(10));
        // older ones come when there is nothing newer
        live.last = Some(18);
        assert_eq!(live.next_waiting(), Some(10));
        live.last = Some(14);
        live.work[14].stage = Stage::Ready;
        assert_eq!(live.next_waiting(), Some(15));
    }

    #[test]
    fn what_is_kept_is_bounded_and_other_depth_begins_again() {
        let count = MAX_HELD as KeyframeId + 8;
        let snapshot = poses(count);
        let mut live = live();
        for id in 0..count {
            live.add(keyframe(id).into());
            rest(&mut live, &snapshot);
        }
        let num_held = |live: &LiveDepth| live.work.iter().filter(|w| w.found.is_some()).count();
        let num_dense = |live: &LiveDepth| live.work.iter().filter(|w| w.dense.is_some()).count();
        assert!(num_held(&live) <= MAX_HELD && num_dense(&live) == MAX_HELD);
        // one that nothing is kept of is ready all the same
        assert!(live.has_handed_over(0) && live.work[0].found.is_none());
        let revised = live.work.len() - 8;
        live.add(keyframe(revised as KeyframeId).into());
        assert!(!live.has_handed_over(revised as KeyframeId));
        assert_eq!(live.work.len(), count as usize);
        assert_eq!(ids(&rest(&mut live, &snapshot)), [revised as KeyframeId]);
    }
}
