//! Relocalisation: a camera that is lost finds back to any keyframe that it sees.

use super::depth::{DepthStage, Successor, sampled_depth, stored_depth, successor, unpacked};
use super::tracking::{Tracker, track_where_recognised};
use crate::frame::Frame;
use crate::graph::Relocalised;
use crate::map::{Map, MapKeyframe};
use crate::policy::aligned_score;
use crate::setup::Setup;
use crate::tracker::Tracked;
use crate::{KeyframeId, TrackingState};
use monogrid_alignment::Alignment;
use monogrid_depth::DepthMap;

/// A keyframe at which a lost camera was recognised, and where direct alignment agrees.
#[derive(Debug)]
pub(super) struct Recognised {
    pub id: KeyframeId,
    pub alignment: Alignment,
    /// How far the pixels agree: good or degraded.
    pub state: TrackingState,
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

/// The keyframe in use, and its depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct InUse<'a> {
    pub keyframe: KeyframeId,
    pub depth: &'a DepthMap,
}

impl<'a> InUse<'a> {
    /// What is tracked on, if anything is.
    pub(super) fn of(tracker: &Tracker, depth: &'a DepthStage) -> Option<Self> {
        Some(Self {
            keyframe: tracker.active.as_ref()?.id,
            depth: depth.get()?,
        })
    }
}

/// The first of the keyframes found by appearance on which the frame can be tracked; one on which
/// its pixels agree comes before those where a blurred frame agrees by its points alone.
pub(super) fn relocalise(
    setup: &Setup,
    map: &Map,
    found: &[Relocalised],
    frame: &Frame,
    in_use: Option<InUse<'_>>,
) -> Option<Recognised> {
    let resumed = |(found, tracked): (&Relocalised, Tracked)| {
        Some(Recognised {
            id: found.view.id,
            resume: resume_at(setup, map, (found, &tracked), frame, in_use)?,
            state: tracked.state,
            alignment: tracked.alignment,
        })
    };
    let mut degraded = Vec::new();
    for found in found {
        let Some(tracked) = track_where_recognised(setup, map, found, frame) else {
            continue;
        };
        if tracked.state != TrackingState::Good {
            degraded.push((found, tracked));
        } else if let Some(recognised) = resumed((found, tracked)) {
            return Some(recognised);
        }
    }
    degraded.into_iter().find_map(resumed)
}

/// Goes on with the recognised keyframe where the frame shows about the same, else with the frame.
fn resume_at(
    setup: &Setup,
    map: &Map,
    (found, tracked): (&Relocalised, &Tracked),
    frame: &Frame,
    in_use: Option<InUse<'_>>,
) -> Option<Resume> {
    let view = &found.view;
    if setup.is_frozen || is_same_view(setup, map[view.id].rank, &tracked.alignment) {
        return depth_as_left(setup, &map[view.id], in_use).map(Resume::Known);
    }
    // as it was when the keyframe was finished
    let image = view.image.pyramid()?.level(0).clone();
    let depth = sampled_depth(setup, image, &view.samples.get()?)?;
    let known = (&depth, map.metres(view.id));
    successor(setup, known, frame, &tracked.alignment.motion).map(Resume::New)
}

fn is_same_view(setup: &Setup, rank: u32, alignment: &Alignment) -> bool {
    let config = &setup.config.keyframes;
    config.reactivation.enabled
        && rank >= config.reactivation.first_keyframe
        && aligned_score(alignment, config) < config.reactivation.max_score
}

/// Depth of a keyframe as it was left, or will be if it is the one in use.
fn depth_as_left(
    setup: &Setup,
    keyframe: &MapKeyframe,
    in_use: Option<InUse<'_>>,
) -> Option<DepthMap> {
    match in_use.filter(|in_use| in_use.keyframe == keyframe.id && !setup.is_frozen) {
        Some(in_use) => unpacked(setup, keyframe, &in_use.depth.packed()),
        None => stored_depth(setup, keyframe),
    }
}
