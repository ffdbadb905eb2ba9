//! Relocalisation: a camera that is lost finds back to any keyframe that it sees.

use super::depth::{Successor, sampled_depth, stored_depth, successor, unpacked};
use super::slam::Slam;
use super::tracking::track_on_other;
use crate::frame::Frame;
use crate::graph::Relocalised;
use crate::policy::aligned_score;
use crate::tracker::Tracked;
use crate::{KeyframeId, TrackingState};
use monogrid_alignment::{Alignment, Motion};
use monogrid_depth::DepthMap;

/// A keyframe at which a lost camera was recognised, and where direct alignment agrees.
#[derive(Debug)]
pub(super) struct Recognised {
    pub id: KeyframeId,
    pub alignment: Alignment,
    pub resume: Resume,
}

/// How tracking goes on there.
#[derive(Debug)]
pub(super) enum Resume {
    /// The frame shows about the same: on that keyframe, with this depth.
    Known(DepthMap),
    /// On the frame as a keyframe on top of it.
    New(Successor),
}

impl Slam {
    /// The first of the keyframes found by appearance on which the frame can be tracked.
    pub(super) fn relocalise(&self, found: &[Relocalised], frame: &Frame) -> Option<Recognised> {
        found.iter().find_map(|found| {
            // from the pose that its points give
            let predicted = Motion::from_pose(found.frame_from_keyframe);
            let view = &found.view;
            let (pyramid, samples) = (view.image.pyramid()?, view.samples.get()?);
            let tracked = track_on_other(&self.setup, &pyramid, &samples, frame, predicted);
            if tracked.state != TrackingState::Good {
                return None;
            }
            Some(Recognised {
                id: view.id,
                resume: self.resume_at(found, &tracked, frame)?,
                alignment: tracked.alignment,
            })
        })
    }

    /// Goes on with the recognised keyframe where the frame shows about the same, else with the frame.
    fn resume_at(&self, found: &Relocalised, tracked: &Tracked, frame: &Frame) -> Option<Resume> {
        let (setup, view) = (&self.setup, &found.view);
        if setup.is_frozen || self.is_same_view(view.id, &tracked.alignment) {
            return self.depth_as_left(view.id).map(Resume::Known);
        }
        // as it was when the keyframe was finished
        let image = view.image.pyramid()?.level(0).clone();
        let depth = sampled_depth(setup, image, &view.samples.get()?)?;
        successor(setup, &depth, frame, &tracked.alignment.motion).map(Resume::New)
    }

    fn is_same_view(&self, id: KeyframeId, alignment: &Alignment) -> bool {
        let config = &self.setup.config.keyframes;
        config.reactivation.enabled
            && self.map[id].rank >= config.reactivation.first_keyframe
            && aligned_score(alignment, config) < config.reactivation.max_score
    }

    /// Depth of a keyframe as it was left, or will be if it is the one in use.
    fn depth_as_left(&self, id: KeyframeId) -> Option<DepthMap> {
        let (setup, keyframe) = (&self.setup, &self.map[id]);
        let active = self.camera.active.as_ref();
        match active.filter(|active| active.id == id && !setup.is_frozen) {
            Some(active) => unpacked(setup, keyframe, &active.depth.packed()),
            None => stored_depth(setup, keyframe),
        }
    }
}
