//! A fragment that a loss began, where an inertial sensor says where it lies: it becomes a part of
//! the main map without a place that is seen again.
//!
//! The paths before and after the loss are two parts of one motion, each with a unit of its own;
//! the readings go through both and the time between ([`monogrid_inertial::estimate`]).

use super::constrain::covariance_of;
use crate::graph::{Joined, Link, OdometryEdge};
use crate::map::Map;
use crate::policy::{PlaceEvidence, is_placed};
use crate::setup::Setup;
use crate::{FragmentId, KeyframeId, MAIN_MAP, TrajectoryPose};
use monogrid_geometry::Sim3;
use monogrid_inertial::{Estimate, Observation, estimate};

/// Time of the path before a loss that is used, ns.
const BEFORE_NS: i64 = 12_000_000_000;
/// Time after it, ns: what comes later says nothing more about the loss.
const AFTER_NS: i64 = 20_000_000_000;

/// Where a fragment lies in the main map.
struct Place {
    main_from_fragment: Sim3,
    evidence: PlaceEvidence,
    /// Standard deviation of the fragment's first camera, in units of the main map.
    position_sigma: f64,
    turn_sigma_rad: f64,
}

/// A fragment that becomes a part of the main map.
pub(super) struct Placement {
    pub joined: Joined,
    place: Place,
    /// The keyframes on both sides of the loss.
    parent: KeyframeId,
    first: KeyframeId,
}

impl Placement {
    /// Where a fragment lies in the main map, where the readings of an inertial sensor say so well
    /// enough.
    pub(super) fn of(setup: &Setup, map: &Map, fragment: FragmentId) -> Option<Self> {
        let place = Place::of(&read(setup, map, fragment)?)?;
        if !is_placed(&place.evidence) {
            return None;
        }
        let (parent, first) = ends_of_loss(map, fragment)?;
        Some(Self {
            joined: Joined {
                from: fragment,
                into: MAIN_MAP,
            },
            place,
            parent,
            first,
        })
    }

    pub(super) fn main_from_fragment(&self) -> &Sim3 {
        &self.place.main_from_fragment
    }

    /// What the graph is told once the map has the fragment there.
    pub(super) fn link(&self, placed: &Map) -> Link {
        Link::Odometry(self.place.link(placed, self.parent, self.first))
    }
}

/// What the readings say of the paths before and after a loss; `None` where they say nothing.
fn read(setup: &Setup, map: &Map, fragment: FragmentId) -> Option<Estimate> {
    let imu = setup.imu.as_ref()?;
    let after = map.trajectory_in(fragment);
    let begin_ns = after.first()?.timestamp_ns;
    let before = map.trajectory_in(MAIN_MAP);
    let used = begin_ns - BEFORE_NS..begin_ns;
    let before = before.iter().filter(|p| used.contains(&p.timestamp_ns));
    let end_ns = begin_ns + AFTER_NS;
    let after = after.iter().filter(|p| p.timestamp_ns < end_ns);
    let seen = |part: usize| {
        move |pose: &TrajectoryPose| Observation {
            timestamp_ns: pose.timestamp_ns,
            seen: Some((part, pose.world_from_camera)),
        }
    };
    let observations: Vec<_> = before.map(seen(0)).chain(after.map(seen(1))).collect();
    estimate(imu, &observations, &setup.config.inertial).ok()
}

impl Place {
    fn of(found: &Estimate) -> Option<Self> {
        let [main, fragment] = found.parts.as_slice() else {
            return None;
        };
        // the first part has neither rotation nor translation
        let unit = 1.0 / main.metric_from_part.scale;
        let metric = &fragment.metric_from_part;
        let (scale, translation) = (metric.scale * unit, metric.translation * unit);
        let main_from_fragment = Sim3::new(scale, metric.rotation, translation);
        Some(Self {
            main_from_fragment,
            evidence: PlaceEvidence {
                scale_sigma: main.scale_sigma.hypot(fragment.scale_sigma),
                position_sigma_m: fragment.position_sigma_m,
                loss_m: found.way_between_parts_m,
            },
            position_sigma: fragment.position_sigma_m * unit,
            turn_sigma_rad: fragment.rotation_sigma_rad,
        })
    }

    /// What the graph is told about the keyframes on both sides of the loss.
    fn link(&self, map: &Map, parent: KeyframeId, keyframe: KeyframeId) -> OdometryEdge {
        let world_from_parent = &map[parent].world_from_keyframe;
        let position = self.position_sigma / world_from_parent.scale;
        let turn = self.turn_sigma_rad.max(MIN_TURN_SIGMA);
        OdometryEdge {
            i: parent,
            j: keyframe,
            i_from_j: world_from_parent.inverse() * map[keyframe].world_from_keyframe,
            covariance: covariance_of(position, turn),
            scale_sigma: self.evidence.scale_sigma,
        }
    }
}

/// No turn over a loss is claimed to be known better than this, rad.
const MIN_TURN_SIGMA: f64 = 0.002;

/// The last keyframe of the main map before a fragment, and the fragment's first.
fn ends_of_loss(map: &Map, fragment: FragmentId) -> Option<(KeyframeId, KeyframeId)> {
    let first = map.in_fragment(fragment).next()?.id;
    let main = map
        .in_fragment(MAIN_MAP)
        .filter(|keyframe| keyframe.id < first);
    Some((main.map(|keyframe| keyframe.id).max()?, first))
}
