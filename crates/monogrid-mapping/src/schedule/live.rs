//! Better depth of keyframes while a run goes on.
//!
//! They take the stages of the final maps (`stages`), one keyframe and one stage at a time, among
//! the keyframes of a window around it. A keyframe takes a stage when the [`AHEAD`] keyframes after
//! it are as far, so that neighbours on both sides have their say, and its depth is ready when four
//! more are finished. Who has no time for all of them leaves out some: keyframes are taken in their
//! order, and where more than [`MAX_BEHIND`] wait, the newest are, the others when there is nothing
//! else to do.

use super::stages::{Progress, Stage, mapped, taken, views_of};
use crate::scene::{PosedKeyframe, Scene};
use crate::{KeyframeCamera, KeyframeScan, MapQuality, MappingConfig};
use monogrid_slam::{KeptKeyframe, KeyframeId, PoseSnapshot};
use std::collections::VecDeque;

/// Later keyframes that must be as far as one that takes a step.
const AHEAD: usize = 1;

/// Keyframes that wait for their first step while it is taken in order.
const MAX_BEHIND: usize = 8;
/// Keyframes of which what was found is kept for the others, and keyframes on either side that are
/// looked at.
const MAX_HELD: usize = 20;
/// How far from a keyframe, in keyframes, are those that tell how certain its depth is.
const COMPARED: usize = 3;

/// A keyframe and how far it has come.
#[derive(Debug)]
struct Work {
    keyframe: KeptKeyframe,
    stage: Stage,
    /// What it had at each stage that it has taken, which neighbours that are behind look at.
    had: Vec<Progress>,
}

impl Work {
    /// Nothing was found yet.
    fn new(keyframe: KeptKeyframe) -> Self {
        Self {
            keyframe,
            stage: Stage::Waiting,
            had: Vec::new(),
        }
    }

    /// What it had at a stage.
    fn at(&self, stage: Stage) -> Option<&Progress> {
        let index = Stage::ALL.iter().position(|other| *other == stage)?;
        self.had.get(index)
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
    /// Of no keyframe yet. Qualities beyond the default are left for the end.
    pub fn new(mut config: MappingConfig, camera: KeyframeCamera) -> Self {
        config.quality = MapQuality::Default;
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
        self.take_stage(index, poses)
    }

    /// Lets a keyframe take its next stage, among those of the window around it.
    fn take_stage(&mut self, index: usize, poses: &PoseSnapshot) -> Step {
        let (last, stage) = (self.work[index].stage, self.work[index].stage.next());
        let first = index.saturating_sub(MAX_HELD);
        let window = &self.work[first..(index + MAX_HELD + 1).min(self.work.len())];
        let keyframes = window.iter().map(|work| &work.keyframe);
        let keyframes: Vec<PosedKeyframe> =
            keyframes.map(|k| PosedKeyframe::kept(k, poses)).collect();
        let before: Vec<Option<&Progress>> = window.iter().map(|work| work.at(last)).collect();
        let (views, store) = (views_of(&before), self.work[index].keyframe.store());
        let index_in_window = index - first;
        let scene = Scene {
            keyframes: &keyframes,
            views: &views,
            camera: &self.camera,
            config: &self.config,
            threads: 1,
        };
        if stage == Stage::Ready {
            let scan = mapped(&scene, index_in_window, &before, store);
            self.work[index].stage = stage;
            return Step::Better(scan);
        }
        let near = index_in_window.saturating_sub(COMPARED)
            ..(index_in_window + COMPARED + 1).min(views.len());
        let certainty = stage.certainty(&scene.seeing(&views[near]));
        let rest = (certainty, store);
        let progress = taken(stage, &scene, index_in_window, &before, rest);
        let work = &mut self.work[index];
        work.had.push(progress);
        work.stage = stage;
        if stage == Stage::Matched {
            self.hold(index);
        }
        Step::Worked
    }

    /// Remembers that something of a keyframe is kept, and leaves what was kept longest.
    fn hold(&mut self, index: usize) {
        let id = self.work[index].keyframe.id;
        self.last = Some(id);
        self.held.push_back(id);
        while self.held.len() > MAX_HELD
            && let Some(oldest) = self.held.pop_front()
        {
            self.forget(oldest);
        }
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

    /// The one that is to be matched: after the last one in order, the newest where too many wait,
    /// else the oldest.
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

    /// Leaves what was found of a keyframe; one that was not handed over begins again.
    fn forget(&mut self, id: KeyframeId) {
        if let Ok(index) = self.index(id) {
            let work = &mut self.work[index];
            work.had.clear();
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

    fn posed<'a>(keyframes: &'a [Keyframe], snapshot: &PoseSnapshot) -> Vec<PosedKeyframe<'a>> {
        let posed = |keyframe: &'a Keyframe| PosedKeyframe {
            id: keyframe.id,
            image: Some(ImageOf::Held(&keyframe.image)),
            depth: DepthOf::Held(&keyframe.pixels),
            world_from_keyframe: snapshot.in_main_map(keyframe.id).copied(),
        };
        keyframes.iter().map(posed).collect()
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
    fn a_keyframe_is_ready_when_four_more_are_finished_with_depth_as_good_as_that_of_final_maps() {
        let (count, snapshot) = (11, poses(11));
        let mut live = live();
        let mut ready = Vec::new();
        for id in 0..count {
            live.add(keyframe(id).into());
            let scans = rest(&mut live, &snapshot);
            let expected: Vec<KeyframeId> = id.checked_sub(4).into_iter().collect();
            assert_eq!(ids(&scans), expected);
            ready.extend(scans);
        }
        assert!(live.has_handed_over(6) && !live.has_handed_over(7));
        let keyframes: Vec<Keyframe> = (0..count).map(keyframe).collect();
        let config = MappingConfig::default();
        let last = final_scans(&posed(&keyframes, &snapshot), &CAMERA, &config, 2);
        // the first one has neighbours on one side, of which too few confirm it
        for scan in &ready[1..] {
            // the newest are seen from one side only when they take their steps
            let share = if scan.id < 4 { 0.95 } else { 0.75 };
            let all = last[scan.id as usize].num_pixels as f64;
            assert!(
                scan.num_pixels as f64 > share * all,
                "{}: {} of {all}",
                scan.id,
                scan.num_pixels
            );
            // that of the filter, where there is no dense depth, is wrong
            assert!(share_right(scan, 1.0) > 0.97);
            assert!(share_right(&last[scan.id as usize], 1.0) > 0.97);
        }
        // the filter has nothing right
        let measured = &keyframes[1].pixels;
        let of_filter = KeyframeScan::new(1, measured, None, &CAMERA, &config);
        assert!(of_filter.num_pixels > 0 && share_right(&of_filter, 1.0) <= 0.0);
    }

    #[test]
    fn a_window_that_holds_all_keyframes_gives_their_final_depth() {
        let (count, snapshot) = (
            COMPARED as KeyframeId + 1,
            poses(COMPARED as KeyframeId + 1),
        );
        let mut live = live();
        (0..count).for_each(|id| live.add(keyframe(id).into()));
        let mut scans = Vec::new();
        for _ in 0..=Stage::ALL.len() {
            for index in 0..count as usize {
                if let Step::Better(scan) = live.take_stage(index, &snapshot) {
                    scans.push(scan);
                }
            }
        }
        let keyframes: Vec<Keyframe> = (0..count).map(keyframe).collect();
        let last = final_scans(&posed(&keyframes, &snapshot), &CAMERA, &live.config, 2);
        assert!(scans == last && last.iter().all(|scan| scan.num_pixels > 1000));
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
            (0..1, Stage::Agreed),
            (1..4, Stage::Found),
            (4..9, Stage::Matched),
        ];
        assert_eq!(next(&last_steps), Some(1));
        let last_step = [
            (0..2, Stage::Agreed),
            (2..4, Stage::Found),
            (4..9, Stage::Matched),
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
        let num_held = live.work.iter().filter(|w| !w.had.is_empty()).count();
        assert_eq!(num_held, MAX_HELD);
        // one that nothing is kept of is ready all the same
        assert!(live.has_handed_over(0) && live.work[0].had.is_empty());
        let revised = live.work.len() - 8;
        live.add(keyframe(revised as KeyframeId).into());
        assert!(!live.has_handed_over(revised as KeyframeId));
        assert_eq!(live.work.len(), count as usize);
        assert_eq!(ids(&rest(&mut live, &snapshot)), [revised as KeyframeId]);
    }
}
