//! A keyframe with everything that is known about it.

use super::points::SeenPoints;
use crate::certainty::PoseSigma;
use crate::store::Kept;
use crate::view::{Exposure, KeyframeImage, View};
use crate::{FragmentId, KeptKeyframe, KeyframeId};
use monogrid_depth::{MeasuredDepth, PackedDepth};
use monogrid_geometry::{Mat7, Se3, Sim3};
use monogrid_image::Pyramid;
use std::sync::Arc;

/// A keyframe in the map.
#[derive(Clone, Debug)]
pub(crate) struct MapKeyframe {
    pub id: KeyframeId,
    /// Fragment that it belongs to now.
    pub fragment: FragmentId,
    /// Keyframes of that fragment when it was made: the first ones of a random start are not to be
    /// trusted.
    pub rank: u32,
    /// Keyframe that it was tracked on when it was made; none for the first of a fragment.
    pub parent: Option<KeyframeId>,
    pub frame_index: usize,
    pub timestamp_ns: i64,
    pub image: KeyframeImage,
    pub exposure: Exposure,
    /// Pose and unit, in the world of its fragment.
    pub world_from_keyframe: Sim3,
    /// The same pose without the unit, as the points are adjusted with it.
    pub camera_from_world: Se3,
    /// How well it was known when the keyframe was made: what is mapped from there is no better.
    /// `None` for the first keyframe of a fragment, which is its world, and where no points are
    /// adjusted.
    pub pose_sigma: Option<PoseSigma>,
    /// Covariance of `parent_from_keyframe`, as the graph has it.
    pub covariance: Option<Mat7>,
    /// What a depth camera measured of what it sees; only in a fragment in metres.
    pub measured: Option<Kept<MeasuredDepth>>,
    /// Its depth as it was left, once it is out of use.
    pub depth: Option<Kept<PackedDepth>>,
    /// As everybody else has it, once it is finished.
    pub published: Option<KeptKeyframe>,
    /// What alignment needs of it, as it was left.
    pub view: Option<Arc<View>>,
    pub points: SeenPoints,
}

impl MapKeyframe {
    /// The pyramid of its image; `None` where it cannot be read back.
    pub(crate) fn pyramid(&self) -> Option<Arc<Pyramid>> {
        self.image.pyramid()
    }

    /// Rigid pose of `other` relative to this keyframe, translation in this keyframe's units.
    pub(crate) fn other_from_self(&self, other: &Self) -> Se3 {
        let relative = other.world_from_keyframe.inverse() * self.world_from_keyframe;
        // `relative` maps own units to the other's units: its scale is s_self / s_other; dividing
        // by it expresses the translation in own units.
        Se3::new(relative.rotation, relative.translation / relative.scale)
    }

    /// Whether its pose is certain; so is that of a world, and where nothing measures it.
    pub(crate) fn is_certain(&self) -> bool {
        self.pose_sigma.is_none_or(|sigma| sigma.is_certain())
    }

    /// Pose in the world of a frame known relative to this keyframe (translation in its units).
    pub(crate) fn world_from_camera(&self, frame_from_keyframe: &Se3) -> Se3 {
        let keyframe_from_frame = frame_from_keyframe.inverse();
        (self.world_from_keyframe * Sim3::from(keyframe_from_frame)).to_se3()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;
    use monogrid_geometry::{Vec3, Vec6, Vec7};
    use monogrid_image::GrayImage;

    fn keyframe(id: KeyframeId, world_from_keyframe: Sim3) -> MapKeyframe {
        MapKeyframe {
            id,
            fragment: 0,
            rank: id,
            parent: None,
            frame_index: 0,
            timestamp_ns: 0,
            image: KeyframeImage::new(&Store::default(), &GrayImage::filled(32, 32, 0.0)),
            exposure: Exposure::NEUTRAL,
            world_from_keyframe,
            camera_from_world: world_from_keyframe.to_se3().inverse(),
            pose_sigma: None,
            covariance: None,
            measured: None,
            depth: None,
            published: None,
            view: None,
            points: SeenPoints::default(),
        }
    }

    #[test]
    fn relative_pose_of_two_keyframes_agrees_with_their_place_in_the_world() {
        let a = keyframe(
            0,
            Sim3::exp(&Vec7::from_column_slice(&[
                0.3, -0.2, 0.5, 0.1, 0.4, -0.2, 0.7,
            ])),
        );
        let b = keyframe(
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
        let world_from_frame =
            keyframe(0, world_from_keyframe).world_from_camera(&frame_from_keyframe);
        let origin_in_keyframe = frame_from_keyframe.inverse().translation;
        let expected = world_from_keyframe * origin_in_keyframe;
        assert!((world_from_frame.translation - expected).norm() < 1e-12);
    }
}
