//! Frames as they come in and as the tracker needs them.

use crate::map::Map;
use crate::store::Kept;
use crate::{FragmentId, KeyframeId};
use monogrid_alignment::Target;
use monogrid_depth::MeasuredDepth;
use monogrid_geometry::{Pinhole, Se3};
use monogrid_image::{GrayImage, Image, Pyramid, to_gray8};
use std::sync::{Arc, LazyLock};

/// Newest keyframes whose measured depth says what has moved since.
const EARLIER_KEYFRAMES: usize = 5;

/// One working image.
#[derive(Clone, Debug)]
pub struct FrameInput {
    /// Index in the source.
    pub index: usize,
    /// Time.
    pub timestamp_ns: i64,
    /// Undistorted grey image of the working size, values in [0, 255].
    pub image: GrayImage,
    /// What says how far its pixels are, in metres; one of another size is not used.
    pub depth: Option<DepthInput>,
}

/// What says how far the pixels of a frame are.
#[derive(Clone, Debug)]
pub enum DepthInput {
    /// Depth (z, metres, NaN where unknown) in the working camera, as a depth camera measured it.
    Measured(GrayImage),
    /// What the second camera of a stereo pair saw at the same time.
    SecondImage {
        /// As a camera with the intrinsics of the first sees it.
        image: GrayImage,
        /// With the translation in metres.
        second_from_first: Se3,
    },
}

impl From<GrayImage> for DepthInput {
    fn from(depth: GrayImage) -> Self {
        Self::Measured(depth)
    }
}

impl DepthInput {
    /// Width and height, px.
    pub(crate) fn size(&self) -> (usize, usize) {
        let (Self::Measured(image) | Self::SecondImage { image, .. }) = self;
        (image.width(), image.height())
    }
}

/// What was measured with a frame, looked at when it is needed: of most frames nobody asks for it.
pub(crate) type LaterMeasured = LazyLock<MeasuredDepth, Box<dyn FnOnce() -> MeasuredDepth + Send>>;

/// A frame with its pyramid.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub index: usize,
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    pub target: Target,
    /// What a depth camera measured with it.
    pub measured: Option<Arc<LaterMeasured>>,
}

impl Frame {
    pub(crate) fn image(&self) -> &GrayImage {
        self.pyramid.level(0)
    }

    /// What a depth camera measured with it, for a keyframe of a fragment that is in metres.
    pub(crate) fn measured_for(
        &self,
        map: &Map,
        fragment: FragmentId,
    ) -> Option<Kept<MeasuredDepth>> {
        let measured = self.measured.as_ref().filter(|_| map.is_metric(fragment))?;
        Some(map.store().keep(MeasuredDepth::clone(measured)))
    }

    /// This frame, tracked on `keyframe`, without the measured depth of surfaces that stand where
    /// earlier keyframes saw something farther away: they have moved there. `None` where no depth
    /// was measured, or in no metres.
    pub(crate) fn without_moving(
        &self,
        map: &Map,
        keyframe: KeyframeId,
        frame_from_keyframe: &Se3,
        pinhole: Pinhole,
    ) -> Option<Self> {
        let (measured, metres) = (self.measured.clone()?, map.metres(keyframe)?);
        let parent = &map[keyframe];
        let recent = map.recent_in(parent.fragment);
        let earlier = recent.iter().rev().filter_map(|id| {
            let keyframe_from_earlier = parent.other_from_self(&map[*id]).inverse();
            let frame_from_earlier = *frame_from_keyframe * keyframe_from_earlier;
            Some((
                map[*id].measured.clone()?,
                frame_from_earlier.stretched(metres),
            ))
        });
        let earlier: Vec<_> = earlier.take(EARLIER_KEYFRAMES).collect();
        let still = move || {
            let mut still = MeasuredDepth::clone(&measured);
            for (measured, frame_from_earlier) in &earlier {
                if let Some(before) = measured.get() {
                    still.leave_out_moving(&before.seen_from(frame_from_earlier, &pinhole));
                }
            }
            still
        };
        Some(Self {
            measured: Some(Arc::new(LazyLock::new(Box::new(still)))),
            ..self.clone()
        })
    }
}

/// A frame that waits for the first keyframe, in eight bits.
#[derive(Clone, Debug)]
pub(crate) struct BufferedFrame {
    pub index: usize,
    pub timestamp_ns: i64,
    image: Image<u8>,
    pub measured: Option<Arc<LaterMeasured>>,
}

impl BufferedFrame {
    pub(crate) fn new(frame: &Frame) -> Self {
        Self {
            index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            image: frame.image().map(to_gray8),
            measured: frame.measured.clone(),
        }
    }

    pub(crate) fn image(&self) -> GrayImage {
        self.image.map(f32::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::NewKeyframe;
    use crate::setup::Setup;
    use crate::view::{Exposure, KeyframeImage};
    use crate::{MAIN_MAP, Scale, SlamConfig};
    use monogrid_geometry::{Rotation, Vec3};
    use monogrid_image::Mask;

    const PINHOLE: Pinhole = Pinhole {
        fx: 30.0,
        fy: 30.0,
        cx: 15.5,
        cy: 15.5,
    };

    /// Keyframes at one place, in units of 2 m, that see a wall at these depths, m.
    fn map_of_walls(depths: &[f32]) -> Map {
        let mut map = Map::default();
        map.set_scale(Scale::Metric);
        for (frame_index, depth) in depths.iter().enumerate() {
            let wall = MeasuredDepth::new(&GrayImage::filled(32, 32, *depth), 0.002);
            map.create(NewKeyframe {
                fragment: MAIN_MAP,
                parent: None,
                frame_index,
                timestamp_ns: 0,
                image: KeyframeImage::new(map.store(), &GrayImage::filled(32, 32, 0.0)),
                exposure: Exposure::NEUTRAL,
                world_from_keyframe: Se3::identity().with_scale(2.0),
                measured: Some(map.store().keep(wall)),
            });
        }
        map
    }

    /// Columns in which something moves, of a frame 0.3 m to the right of the newest keyframe that
    /// sees something 1 m away everywhere.
    fn moving_columns(map: &Map) -> Vec<usize> {
        let mask = Mask::filled(32, 32, 255);
        let setup = Setup::new(SlamConfig::default(), PINHOLE, mask.clone(), 0);
        let image = BufferedFrame {
            index: 9,
            timestamp_ns: 0,
            image: Image::filled(32, 32, 0),
            measured: None,
        };
        let mut frame = setup.restored(&image);
        let depth = MeasuredDepth::new(&GrayImage::filled(32, 32, 1.0), 0.002);
        frame.measured = Some(Arc::new(LazyLock::new(Box::new(move || depth))));
        let newest = map.newest().unwrap().id;
        let frame_from_keyframe = Se3::new(Rotation::identity(), Vec3::new(-0.15, 0.0, 0.0));
        let frame = frame.without_moving(map, newest, &frame_from_keyframe, PINHOLE);
        let still = frame.unwrap().measured.unwrap().still(&mask);
        (0..32).filter(|x| still.at(*x, 16) == 0).collect()
    }

    #[test]
    fn a_surface_moves_where_one_of_five_keyframes_saw_through_it() {
        // the last three columns, which are 0.3 m of the wall, no keyframe saw
        let seen: Vec<usize> = (0..29).collect();
        assert_eq!(moving_columns(&map_of_walls(&[3.0])), seen);
        assert_eq!(
            moving_columns(&map_of_walls(&[3.0, 1.0, 1.0, 1.0, 1.0])),
            seen
        );
        let seen_earlier = map_of_walls(&[3.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        assert!(moving_columns(&seen_earlier).is_empty());
    }
}
