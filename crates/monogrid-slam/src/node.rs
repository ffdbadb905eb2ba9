//! Keyframes as the system works with them: image, pose, brightness.

use crate::{FragmentId, KeyframeId};
use monogrid_depth::PackedDepth;
use monogrid_geometry::{Se3, Sim3};
use monogrid_image::Pyramid;
use std::sync::Arc;

/// `I_keyframe = gain * I_first + bias`: brightness relative to the first keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Exposure {
    pub gain: f64,
    pub bias: f64,
}

impl Exposure {
    pub(crate) const NEUTRAL: Self = Self {
        gain: 1.0,
        bias: 0.0,
    };

    /// Exposure of a frame that is `gain * I_self + bias`.
    pub(crate) fn then(&self, gain: f64, bias: f64) -> Self {
        Self {
            gain: gain * self.gain,
            bias: gain * self.bias + bias,
        }
    }

    /// Gain and bias with `I_other = gain * I_self + bias`.
    pub(crate) fn relative(&self, other: &Self) -> (f64, f64) {
        let gain = other.gain / self.gain;
        (gain, other.bias - gain * self.bias)
    }
}

/// A keyframe in the system.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    pub id: KeyframeId,
    /// Fragment that it belongs to now.
    pub fragment: FragmentId,
    /// Keyframes of that fragment when it was made: the first ones of a random start are not to be trusted.
    pub rank: u32,
    /// Keyframe that it was tracked on when it was made; none for the first of a fragment.
    pub parent: Option<KeyframeId>,
    pub frame_index: usize,
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    /// Pose and unit, in the world of its fragment.
    pub world_from_keyframe: Sim3,
    pub exposure: Exposure,
    /// Its depth as it was left, once it is out of use.
    pub depth: Option<Arc<PackedDepth>>,
}

impl Node {
    /// Rigid pose of `other` relative to this keyframe, translation in this keyframe's units.
    pub(crate) fn other_from_self(&self, other: &Self) -> Se3 {
        let relative = other.world_from_keyframe.inverse() * self.world_from_keyframe;
        // `relative` maps own units to the other's units: its scale is s_self / s_other; dividing by it
        // expresses the translation in own units.
        Se3::new(relative.rotation, relative.translation / relative.scale)
    }
}

/// Steps from keyframe to keyframe along which tracking came from `a` to `b`, in either direction: each
/// keyframe was tracked on its parent.
pub(crate) fn steps_between(nodes: &[Node], a: KeyframeId, b: KeyframeId) -> u32 {
    let parent_of = |id: KeyframeId| nodes.get(id as usize).and_then(|node| node.parent);
    path_between(parent_of, a, b).len().saturating_sub(1) as u32
}

/// The keyframes of those steps, from `a` to `b`. Keyframes without a common ancestor follow each other.
pub(crate) fn path_between(
    parent_of: impl Fn(KeyframeId) -> Option<KeyframeId>,
    a: KeyframeId,
    b: KeyframeId,
) -> Vec<KeyframeId> {
    let (mut left, mut right) = (vec![a], vec![b]);
    let (mut a, mut b) = (a, b);
    // a parent is always older than its child
    while a != b {
        let (side, end) = if a > b {
            (&mut left, &mut a)
        } else {
            (&mut right, &mut b)
        };
        match parent_of(*end) {
            Some(parent) => {
                *end = parent;
                side.push(parent);
            }
            None => break,
        }
    }
    if a == b {
        right.pop();
    }
    left.extend(right.iter().rev());
    left
}

/// Pose in the world of a frame known relative to a keyframe (translation in its units).
pub(crate) fn world_from_camera(world_from_keyframe: &Sim3, frame_from_keyframe: &Se3) -> Se3 {
    let keyframe_from_frame = frame_from_keyframe.inverse();
    (*world_from_keyframe * Sim3::from(keyframe_from_frame)).to_se3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Vec3, Vec6, Vec7};

    fn node(id: KeyframeId, world_from_keyframe: Sim3) -> Node {
        Node {
            id,
            fragment: 0,
            rank: id,
            parent: None,
            frame_index: 0,
            timestamp_ns: 0,
            pyramid: Arc::default(),
            world_from_keyframe,
            exposure: Exposure::NEUTRAL,
            depth: None,
        }
    }

    #[test]
    fn relative_pose_of_two_keyframes_agrees_with_their_place_in_the_world() {
        let a = node(
            0,
            Sim3::exp(&Vec7::from_column_slice(&[
                0.3, -0.2, 0.5, 0.1, 0.4, -0.2, 0.7,
            ])),
        );
        let b = node(
            1,
            Sim3::exp(&Vec7::from_column_slice(&[
                -0.1, 0.6, 0.2, -0.3, 0.1, 0.2, -0.4,
            ])),
        );
        let point_in_a = Vec3::new(0.2, -0.1, 1.4);
        let point_in_world = a.world_from_keyframe * point_in_a;
        let point_in_b = b.world_from_keyframe.inverse() * point_in_world;
        let found = a.other_from_self(&b) * point_in_a;
        let ratio = a.world_from_keyframe.scale / b.world_from_keyframe.scale;
        assert!((found * ratio - point_in_b).norm() < 1e-12);
    }

    #[test]
    fn world_pose_of_a_frame_scales_its_translation() {
        let world_from_keyframe = Sim3::exp(&Vec7::from_column_slice(&[
            0.3, 0.1, 0.2, 0.2, 0.1, 0.3, 0.5,
        ]));
        let frame_from_keyframe = Se3::exp(&Vec6::new(0.1, 0.2, -0.1, 0.05, 0.1, 0.0));
        let world_from_frame = world_from_camera(&world_from_keyframe, &frame_from_keyframe);
        let origin_in_keyframe = frame_from_keyframe.inverse().translation;
        let expected = world_from_keyframe * origin_in_keyframe;
        assert!((world_from_frame.translation - expected).norm() < 1e-12);
    }

    #[test]
    fn exposures_compose() {
        let a = Exposure {
            gain: 1.2,
            bias: 5.0,
        };
        let b = a.then(0.8, -3.0);
        let (gain, bias) = a.relative(&b);
        assert!((gain - 0.8).abs() < 1e-12 && (bias + 3.0).abs() < 1e-12);
    }
}
