//! Tracking goes on with another keyframe.

use super::constrain::{Tie, handover, in_keyframe};
use super::depth::{Successor, successor};
use super::keyframes::finish_keyframe;
use super::reactivate::{Confirmed, find_known_view};
use super::relocalise::InUse;
use crate::KeyframeId;
use crate::frame::Frame;
use crate::graph::{Link, OdometryEdge};
use crate::map::{FinishedKeyframe, Map, MapKeyframe, NewKeyframe};
use crate::setup::Setup;
use crate::view::KeyframeImage;
use monogrid_alignment::{Alignment, Motion};
use monogrid_geometry::Sim3;

/// Relative standard deviation of the scale between successive keyframes that tracking and
/// propagation leave.
const ODOMETRY_SCALE_SIGMA: f64 = 0.05;

/// The keyframe that tracking goes on with.
#[derive(Debug)]
pub(super) enum NextKeyframe {
    /// One that shows what the frame shows.
    Known(Box<Confirmed>),
    /// The frame itself, with what is to be published of the keyframe in use.
    Frame(Box<(Successor, FinishedKeyframe)>),
    /// That in use: no other is known, and none may be made.
    NoBetter,
    /// That in use: no depth can be handed on.
    None,
}

impl NextKeyframe {
    /// The keyframe for a frame that was tracked on the one in use.
    pub(super) fn choose(
        setup: &Setup,
        map: &Map,
        in_use: InUse<'_>,
        frame: &Frame,
        motion: &Motion,
    ) -> Self {
        let id = in_use.keyframe;
        if let Some(known) = find_known_view(setup, map, (id, motion), frame) {
            return Self::Known(Box::new(known));
        }
        if setup.is_frozen {
            return Self::NoBetter;
        }
        let (next, finished) = rayon::join(
            || successor(setup, (in_use.depth, map.metres(id)), frame, motion),
            || finish_keyframe(setup, map, id, in_use.depth),
        );
        next.map_or(Self::None, |next| Self::Frame(Box::new((next, finished))))
    }
}

/// What the graph is told of a frame that was tracked on two keyframes, if its covariance is known.
pub(super) fn handover_link(
    (from, alignment): (&MapKeyframe, &Alignment),
    (to, found): (&MapKeyframe, &Alignment),
) -> Link {
    alignment.covariance.as_ref().map_or(Link::None, |own| {
        let left = Tie {
            keyframe: from,
            motion: &alignment.motion,
            covariance: own,
        };
        let found = Tie {
            keyframe: to,
            motion: &found.motion,
            covariance: found.covariance.as_ref().unwrap_or(own),
        };
        Link::Handover(handover(left, found, ODOMETRY_SCALE_SIGMA))
    })
}

/// A frame as a keyframe on top of a parent that it was tracked on.
pub(super) fn keyframe_of(
    map: &Map,
    frame: &Frame,
    parent: KeyframeId,
    motion: &Motion,
    unit: f64,
) -> NewKeyframe {
    let older = &map[parent];
    NewKeyframe {
        fragment: older.fragment,
        parent: Some(parent),
        frame_index: frame.index,
        timestamp_ns: frame.timestamp_ns,
        image: KeyframeImage::new(map.store(), frame.image()),
        exposure: older.exposure.then(motion.log_gain.exp(), motion.bias),
        world_from_keyframe: older.world_from_keyframe * parent_from_keyframe(motion, unit),
        measured: frame.measured_for(map, older.fragment),
    }
}

/// What the graph is told of the two, if the covariance of the frame's pose is known.
pub(super) fn odometry_link(
    parent: KeyframeId,
    keyframe: KeyframeId,
    alignment: &Alignment,
    unit: f64,
) -> Link {
    let parent_from_frame = alignment.motion.frame_from_keyframe.inverse();
    let link = alignment.covariance.as_ref().map(|covariance| {
        Link::Odometry(OdometryEdge {
            i: parent,
            j: keyframe,
            i_from_j: parent_from_keyframe(&alignment.motion, unit),
            covariance: in_keyframe(covariance, &parent_from_frame),
            scale_sigma: ODOMETRY_SCALE_SIGMA,
        })
    });
    link.unwrap_or_default()
}

fn parent_from_keyframe(motion: &Motion, unit: f64) -> Sim3 {
    motion.frame_from_keyframe.inverse().with_scale(unit)
}
