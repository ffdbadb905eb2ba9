//! Frames with a believed pose, each relative to the keyframe that it was tracked on.

use super::arena::Map;
use super::log::Log;
use crate::interpolation::{LostFrame, SeenPose, interpolated};
use crate::{FragmentId, KeyframeId, MAIN_MAP, PoseSource, TrackedFrame, TrajectoryPose};
use monogrid_geometry::{Se3, Vec3, Vec6};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A tracked frame, relative to its keyframe.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Record {
    pub frame_index: usize,
    pub timestamp_ns: i64,
    pub frame_from_keyframe: Se3,
    /// Position in the list of visits.
    pub visit: usize,
}

/// A stretch of time, forwards or backwards, in which frames were tracked on one keyframe.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Visit {
    keyframe: KeyframeId,
    begin_ns: i64,
    end: Option<VisitEnd>,
}

/// The frame with which tracking went on with another keyframe, as both know it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct VisitEnd {
    /// As it was tracked on the keyframe that was left.
    pub frame_from_keyframe: Se3,
    pub frame_from_next: Se3,
}

/// All frames with a believed pose, and those that were lost.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameLog {
    visits: Log<Visit>,
    records: Log<Record>,
    lost: Log<LostFrame>,
    /// How many of them have a pose on each keyframe.
    num_on: BTreeMap<KeyframeId, usize>,
}

impl FrameLog {
    /// Memory, bytes, of those that are not kept beside the keyframes.
    pub(super) fn bytes(&self) -> usize {
        self.records.bytes() + self.visits.bytes() + self.lost.bytes()
    }
}

/// How much longer the ways from a keyframe are than they were tracked on its depth: tracking
/// shrinks translations, since depth and gradients have noise (by up to a percent and a half in
/// rendered rooms), while the poses of keyframes come from adjusted points. It shows where the last
/// frame of a visit was tracked and where the next keyframe has it; neighbouring visits are alike,
/// and say it together.
#[derive(Clone, Copy, Debug, Default)]
struct Stretch {
    /// Sum of tracked way times way as it is known now, in squared units of the keyframes.
    known: f64,
    /// Sum of the squares of the tracked ways.
    tracked: f64,
}

impl Stretch {
    /// The way of a last frame from its keyframe, as it was tracked and as it is known now, in
    /// units of the keyframe. Noise shrinks a way by less than two percent; where the two differ by
    /// more, or by a tenth across, one of them is wrong for another reason, and nobody knows which:
    /// the visit says nothing.
    fn of(tracked: &Vec3, known: &Vec3) -> Self {
        const MAX_ALONG: f64 = 0.02;
        const MAX_ACROSS: f64 = 0.1;
        let stretch = Self {
            known: tracked.dot(known),
            tracked: tracked.norm_squared(),
        };
        let along = (stretch.known / stretch.tracked - 1.0).abs();
        let across = (known - tracked).norm() / tracked.norm();
        // NaN is no length
        if along <= MAX_ALONG && across <= MAX_ACROSS {
            stretch
        } else {
            Self::default()
        }
    }

    /// Visits before and after a visit that are taken for its own.
    const NEIGHBOURS: usize = 2;

    /// The factor for each visit, of what each of them shows.
    fn smoothed(shown: &[Self]) -> Vec<f64> {
        let around = |k: usize| {
            let first = k.saturating_sub(Self::NEIGHBOURS);
            let end = shown.len().min(k + Self::NEIGHBOURS + 1);
            shown[first..end]
                .iter()
                .fold(Self::default(), |sum, one| Self {
                    known: sum.known + one.known,
                    tracked: sum.tracked + one.tracked,
                })
        };
        (0..shown.len()).map(|k| around(k).factor()).collect()
    }

    /// The factor, as if a way of a tenth of the depth of the scene had shown none before.
    fn factor(self) -> f64 {
        const PRIOR: f64 = 0.1 * 0.1;
        (self.known + PRIOR) / (self.tracked + PRIOR)
    }
}

/// What is known now about the end of a visit: the pose of its last frame relative to the next
/// keyframe differs from the tracked one.
struct Correction {
    begin_ns: i64,
    end_ns: i64,
    /// Logarithm of `tracked_from_adjusted` of the last frame's camera.
    twist: Vec6,
}

impl Correction {
    /// The share of the correction that has built up at a time, taken as growing evenly.
    fn at(&self, timestamp_ns: i64) -> Se3 {
        // backwards in time both are negative
        let length = (self.end_ns - self.begin_ns) as f64;
        let share = (timestamp_ns - self.begin_ns) as f64 / length;
        if share.is_finite() {
            Se3::exp(&(self.twist * share.clamp(0.0, 1.0)))
        } else {
            Se3::identity()
        }
    }
}

impl Map {
    /// Frames are tracked on this keyframe from this time on; how the change came about, where both
    /// keyframes know a frame.
    pub(crate) fn visit(&mut self, keyframe: KeyframeId, begin_ns: i64, end: Option<VisitEnd>) {
        let visits = &mut self.frames.visits;
        if let (Some(visit), Some(_)) = (visits.last_mut(), end) {
            visit.end = end;
        }
        let visit = Visit {
            keyframe,
            begin_ns,
            end: None,
        };
        visits.push(visit, &self.store);
    }

    /// A frame has a pose on the keyframe in use.
    pub(crate) fn track(
        &mut self,
        frame_index: usize,
        timestamp_ns: i64,
        frame_from_keyframe: Se3,
    ) {
        let frames = &mut self.frames;
        let Some(visit) = frames.visits.last() else {
            return;
        };
        *frames.num_on.entry(visit.keyframe).or_default() += 1;
        let record = Record {
            frame_index,
            timestamp_ns,
            frame_from_keyframe,
            visit: frames.visits.len() - 1,
        };
        frames.records.push(record, &self.store);
    }

    /// A frame has no pose; one that comes later may give it one.
    pub(crate) fn miss(&mut self, frame_index: usize, timestamp_ns: i64) {
        let frame = LostFrame {
            frame_index,
            timestamp_ns,
        };
        self.frames.lost.push(frame, &self.store);
    }

    /// The last frame with a pose.
    pub(crate) fn last_record(&self) -> Option<&Record> {
        self.frames.records.last()
    }

    /// `last_from_this` of two frames as both were tracked on one keyframe, in units of the world;
    /// `None` if there is none that knows both.
    pub(crate) fn tracked_step(&self, last: &Record, this: &Record) -> Option<Se3> {
        let visits = &self.frames.visits;
        let keyframe = visits.recent(this.visit)?.keyframe;
        let last_from_keyframe = if last.visit == this.visit {
            last.frame_from_keyframe
        } else {
            let is_next = last.visit + 1 == this.visit;
            let left = visits.recent(last.visit)?;
            let next = visits.recent(last.visit + 1)?;
            let end = left.end.as_ref()?;
            (is_next && next.begin_ns == last.timestamp_ns).then_some(end.frame_from_next)?
        };
        let scale = self.get(keyframe)?.world_from_keyframe.scale;
        let step = last_from_keyframe * this.frame_from_keyframe.inverse();
        Some(step.stretched(scale))
    }

    /// The frames of a fragment, in its world, in the order of time, with everything known now.
    ///
    /// Frames are known relative to their keyframe. Where the keyframe after it says something else
    /// about the last of them, all ways from the keyframe are stretched alike as far as that
    /// explains it, and the rest of the difference is spread over the frames of the visit.
    pub(crate) fn trajectory_in(&self, fragment: FragmentId) -> Vec<TrajectoryPose> {
        let seen = self.seen_in(fragment).into_iter();
        seen.map(|seen| seen.pose).collect()
    }

    /// The frames of the main map, and between them those that were lost for a short time.
    pub(crate) fn whole_trajectory(&self) -> Vec<TrajectoryPose> {
        let seen = self.seen_in(MAIN_MAP);
        // a frame that was lost may have been found from one that came after it
        let known: BTreeSet<usize> = self.frames.records.iter().map(|r| r.frame_index).collect();
        let lost = self.frames.lost.iter();
        let lost = lost.filter(|frame| !known.contains(&frame.frame_index));
        // one that waited for a start was lost twice
        let lost: BTreeMap<i64, LostFrame> =
            lost.map(|frame| (frame.timestamp_ns, frame)).collect();
        let lost: Vec<LostFrame> = lost.into_values().collect();
        let between = interpolated(&seen, &lost);
        let seen = seen.into_iter().map(|seen| seen.pose);
        let mut poses: Vec<TrajectoryPose> = seen.chain(between).collect();
        poses.sort_by_key(|pose| (pose.timestamp_ns, pose.frame_index));
        poses
    }

    fn seen_in(&self, fragment: FragmentId) -> Vec<SeenPose> {
        let mut seen: Vec<SeenPose> = self
            .corrected_poses()
            .map(|(record, keyframe, pose)| (record, &self[keyframe], pose))
            .filter(|(_, keyframe, _)| keyframe.fragment == fragment)
            .map(|(record, keyframe, world_from_camera)| SeenPose {
                pose: TrajectoryPose {
                    frame_index: record.frame_index,
                    timestamp_ns: record.timestamp_ns,
                    world_from_camera,
                    source: if keyframe.is_certain() {
                        PoseSource::Certain
                    } else {
                        PoseSource::Uncertain
                    },
                },
                median_depth: keyframe.world_from_keyframe.scale,
            })
            .collect();
        seen.sort_by_key(|seen| (seen.pose.timestamp_ns, seen.pose.frame_index));
        seen
    }

    /// The frames of all fragments relative to their keyframes, in the order of time.
    pub(crate) fn tracked_frames(&self) -> Vec<TrackedFrame> {
        let mut frames: Vec<TrackedFrame> = self
            .corrected_poses()
            .map(|(record, keyframe, world_from_camera)| {
                let keyframe_from_world = self[keyframe].world_from_keyframe.inverse();
                let relative = keyframe_from_world * world_from_camera.with_scale(1.0);
                TrackedFrame {
                    frame_index: record.frame_index,
                    timestamp_ns: record.timestamp_ns,
                    keyframe,
                    keyframe_from_frame: relative.to_se3(),
                }
            })
            .collect();
        frames.sort_by_key(|frame| (frame.timestamp_ns, frame.frame_index));
        frames
    }

    /// Frames with a pose in a fragment.
    pub(crate) fn num_frames_in(&self, fragment: FragmentId) -> usize {
        let num_on = self.frames.num_on.iter();
        let in_fragment = num_on.filter(|(id, _)| self[**id].fragment == fragment);
        in_fragment.map(|(_, frames)| frames).sum()
    }

    /// All records with their keyframes and `world_from_camera`, each in the world of its fragment.
    fn corrected_poses(&self) -> impl Iterator<Item = (Record, KeyframeId, Se3)> {
        let visits: Vec<Visit> = self.frames.visits.iter().collect();
        let next = || visits.iter().skip(1).map(Some).chain([None]);
        let shown = visits.iter().zip(next()).map(|(visit, next)| {
            let stretch = next.and_then(|next| self.stretch(visit, next));
            stretch.unwrap_or_default()
        });
        let factors = Stretch::smoothed(&shown.collect::<Vec<_>>());
        let corrections: Vec<Option<Correction>> = visits
            .iter()
            .zip(next())
            .zip(&factors)
            .map(|((visit, next), factor)| self.correction(visit, next?, *factor))
            .collect();
        let records = self.frames.records.iter();
        records.filter_map(move |record| {
            let keyframe = visits.get(record.visit)?.keyframe;
            let factor = factors.get(record.visit).copied().unwrap_or(1.0);
            let frame_from_keyframe = record.frame_from_keyframe.stretched(factor);
            let tracked = self[keyframe].world_from_camera(&frame_from_keyframe);
            let correction = corrections.get(record.visit);
            let pose = match correction.and_then(Option::as_ref) {
                Some(correction) => tracked * correction.at(record.timestamp_ns),
                None => tracked,
            };
            Some((record, keyframe, pose))
        })
    }

    /// What the end of a visit says of its ways; nothing where tracking was lost there.
    fn stretch(&self, visit: &Visit, next: &Visit) -> Option<Stretch> {
        let end = visit.end.as_ref()?;
        let known = self[next.keyframe].world_from_camera(&end.frame_from_next);
        let keyframe_from_world = self[visit.keyframe].world_from_keyframe.inverse();
        let tracked = end.frame_from_keyframe.inverse().translation;
        let adjusted = keyframe_from_world * known.translation;
        Some(Stretch::of(&tracked, &adjusted))
    }

    /// The correction over the time of a visit, whose ways are stretched; none where tracking was
    /// lost at its end.
    fn correction(&self, visit: &Visit, next: &Visit, factor: f64) -> Option<Correction> {
        let end = visit.end.as_ref()?;
        let frame_from_keyframe = end.frame_from_keyframe.stretched(factor);
        let tracked = self[visit.keyframe].world_from_camera(&frame_from_keyframe);
        let adjusted = self[next.keyframe].world_from_camera(&end.frame_from_next);
        Some(Correction {
            begin_ns: visit.begin_ns,
            end_ns: next.begin_ns,
            twist: (tracked.inverse() * adjusted).log(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrections_build_up_evenly_in_either_direction_of_time() {
        let twist = Vec6::new(0.1, -0.2, 0.3, 0.02, 0.01, -0.03);
        for (begin_ns, end_ns) in [(100, 300), (300, 100)] {
            let correction = Correction {
                begin_ns,
                end_ns,
                twist,
            };
            let is_at = |time_ns: i64, share: f64| {
                let difference = correction.at(time_ns).log() - twist * share;
                assert!(
                    difference.norm() < 1e-12,
                    "{begin_ns} to {end_ns}, {time_ns}"
                );
            };
            is_at(begin_ns, 0.0);
            is_at((3 * begin_ns + end_ns) / 4, 0.25);
            is_at(end_ns, 1.0);
            is_at(end_ns + (end_ns - begin_ns), 1.0);
        }
    }

    #[test]
    fn ways_that_were_tracked_too_short_are_stretched_by_what_their_neighbours_show() {
        let way = Vec3::new(0.1, -0.05, 0.2);
        // a percent too short; one has an error besides, and one shows nothing
        let shown: Vec<Stretch> = (0..6)
            .map(|k| match k {
                4 => Stretch::of(&way, &(way * 1.018)),
                5 => Stretch::default(),
                _ => Stretch::of(&way, &(way * 1.01)),
            })
            .collect();
        let factors = Stretch::smoothed(&shown);
        assert!((1.009..1.01).contains(&factors[0]), "{factors:?}");
        assert!((1.01..1.013).contains(&factors[3]), "{factors:?}");
        assert!((1.01..1.014).contains(&factors[5]), "of its neighbours");
        // what is across a way says nothing about its length, and a short way hardly anything
        let factor = |known: Vec3| Stretch::of(&Vec3::x(), &known).factor();
        assert_eq!(factor(Vec3::new(1.0, 0.09, 0.0)), 1.0);
        let short = Stretch::of(&(Vec3::x() * 0.01), &(Vec3::x() * 0.0101));
        assert!((1.0..1.001).contains(&short.factor()));
        // what differs by more is an error of one of the two
        assert!(factor(Vec3::new(1.019, 0.0, 0.0)) > 1.018);
        for wrong in [
            [1.021, 0.0, 0.0],
            [0.979, 0.0, 0.0],
            [1.0, 0.11, 0.0],
            [-1.0, 0.0, 0.0],
        ] {
            assert_eq!(factor(Vec3::from(wrong)), 1.0, "{wrong:?}");
        }
        assert_eq!(Stretch::of(&Vec3::zeros(), &Vec3::x()).factor(), 1.0);
        assert_eq!(Stretch::smoothed(&[Stretch::default()]), [1.0]);
        // the camera's place is stretched, whatever its turn
        let pose = Se3::exp(&Vec6::new(0.1, -0.2, 0.3, 0.2, 0.1, -0.3));
        let place = |pose: Se3| pose.inverse().translation;
        assert!((place(pose.stretched(1.5)) - place(pose) * 1.5).norm() < 1e-12);
    }

    #[test]
    fn a_visit_without_length_has_no_correction() {
        let correction = Correction {
            begin_ns: 100,
            end_ns: 100,
            twist: Vec6::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0),
        };
        assert_eq!(correction.at(100), Se3::identity());
    }
}
