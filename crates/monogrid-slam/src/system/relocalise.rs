//! Relocalisation: a camera that is lost finds back to any keyframe that it sees.

use super::camera::Active;
use super::depth::{Successor, sampled_depth, stored_depth, successor, unpacked};
use super::setup::Setup;
use super::tracking::track_on_other;
use crate::frame::Frame;
use crate::graph::Relocalised;
use crate::map::Map;
use crate::policy::{KeyframeEvidence, keyframe_score};
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

/// The first of the keyframes found by appearance on which the frame can be tracked.
pub(super) fn relocalise(
    setup: &Setup,
    map: &Map,
    active: Option<&Active>,
    found: &[Relocalised],
    frame: &Frame,
) -> Option<Recognised> {
    found.iter().find_map(|found| {
        // from the pose that its points give
        let predicted = Motion::from_pose(found.frame_from_keyframe);
        let view = &found.view;
        let (pyramid, samples) = (view.image.pyramid()?, view.samples.get()?);
        let tracked = track_on_other(setup, &pyramid, &samples, frame, predicted);
        if tracked.state != TrackingState::Good {
            return None;
        }
        Some(Recognised {
            id: view.id,
            resume: resume(setup, map, active, found, &tracked, frame)?,
            alignment: tracked.alignment,
        })
    })
}

/// Goes on with the recognised keyframe where the frame shows about the same, else with the frame.
fn resume(
    setup: &Setup,
    map: &Map,
    active: Option<&Active>,
    found: &Relocalised,
    tracked: &Tracked,
    frame: &Frame,
) -> Option<Resume> {
    let id = found.view.id;
    if setup.is_frozen || is_same_view(setup, map, id, &tracked.alignment) {
        return depth_as_left(setup, map, active, id).map(Resume::Known);
    }
    // as it was when the keyframe was finished
    let image = found.view.image.pyramid()?.level(0).clone();
    let depth = sampled_depth(setup, image, &found.view.samples.get()?)?;
    successor(setup, &depth, frame, &tracked.alignment.motion).map(Resume::New)
}

fn is_same_view(setup: &Setup, map: &Map, id: KeyframeId, alignment: &Alignment) -> bool {
    let config = &setup.config.keyframes;
    let keyframe_from_frame = alignment.motion.frame_from_keyframe.inverse();
    let evidence = KeyframeEvidence {
        relative_distance: keyframe_from_frame.translation.norm(),
        usage: f64::from(alignment.usage),
        ..KeyframeEvidence::default()
    };
    config.reactivation.enabled
        && map[id].rank >= config.reactivation.first_keyframe
        && keyframe_score(&evidence, config) < config.reactivation.max_score
}

/// Depth of a keyframe as it was left, or will be if it is the one in use.
fn depth_as_left(
    setup: &Setup,
    map: &Map,
    active: Option<&Active>,
    id: KeyframeId,
) -> Option<DepthMap> {
    let keyframe = &map[id];
    match active.filter(|active| active.id == id && !setup.is_frozen) {
        Some(active) => unpacked(setup, keyframe, &active.depth.packed()),
        None => stored_depth(setup, keyframe),
    }
}
