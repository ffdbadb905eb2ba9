//! Keyframes as they are published, and the poses that live outside them.

use crate::store::{Kept, Store};
use crate::view::KeyframeImage;
use crate::{FragmentId, KeyframeId, MAIN_MAP};
use monogrid_geometry::{Mat7, Pinhole, Se3, Sim3, Vec2};
pub use monogrid_image::DepthPixel;
use monogrid_image::Image;

/// Camera of the keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframeCamera {
    /// Intrinsics.
    pub pinhole: Pinhole,
    /// Width of the images, px.
    pub width: usize,
    /// Height of the images, px.
    pub height: usize,
}

impl KeyframeCamera {
    /// A camera without distortion, with images of this width and height.
    #[must_use]
    pub fn new(pinhole: Pinhole, (width, height): (usize, usize)) -> Self {
        Self {
            pinhole,
            width,
            height,
        }
    }

    /// Whether a pixel lies in its images.
    #[must_use]
    pub fn contains(&self, pixel: &Vec2) -> bool {
        let (width, height) = (self.width as f64, self.height as f64);
        (0.0..width).contains(&pixel.x) && (0.0..height).contains(&pixel.y)
    }
}

/// A finished keyframe: immutable except for its depth, whose revision then grows.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Identity.
    pub id: KeyframeId,
    /// Index of its frame in the source.
    pub frame_index: usize,
    /// Time of its frame.
    pub timestamp_ns: i64,
    /// Grows when the depth changes after publication.
    pub revision: u32,
    /// Grey image.
    pub image: Image<u8>,
    /// Semi-dense depth, row-major.
    pub pixels: Vec<DepthPixel>,
}

impl Keyframe {
    /// Width and height of its image, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.image.width(), self.image.height())
    }
}

/// A finished keyframe whose image and depth are where there is room: in memory, or in a file
/// ([`crate::Slam::spill_into`]).
#[derive(Clone, Debug)]
pub struct KeptKeyframe {
    /// Identity.
    pub id: KeyframeId,
    /// Index of its frame in the source.
    pub frame_index: usize,
    /// Time of its frame.
    pub timestamp_ns: i64,
    /// Grows when the depth changes after publication.
    pub revision: u32,
    /// Pixels with depth.
    pub num_pixels: usize,
    pub(crate) image: KeyframeImage,
    pub(crate) pixels: Kept<Vec<DepthPixel>>,
}

impl KeptKeyframe {
    pub(crate) fn new(store: &Store, keyframe: Keyframe) -> Self {
        Self {
            id: keyframe.id,
            frame_index: keyframe.frame_index,
            timestamp_ns: keyframe.timestamp_ns,
            revision: keyframe.revision,
            num_pixels: keyframe.pixels.len(),
            image: KeyframeImage::new(store, &keyframe.image.map(f32::from)),
            pixels: store.keep(keyframe.pixels),
        }
    }

    /// Width and height of its image, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.image.size()
    }

    /// Its grey image; `None` where it cannot be read back ([`crate::Slam::spill_failure`]).
    #[must_use]
    pub fn image(&self) -> Option<Image<u8>> {
        self.image.grey()
    }

    /// Its semi-dense depth, row-major; `None` where it cannot be read back.
    #[must_use]
    pub fn pixels(&self) -> Option<Vec<DepthPixel>> {
        Some(self.pixels.get()?.to_vec())
    }

    /// What keeps them.
    #[must_use]
    pub fn store(&self) -> &Store {
        self.pixels.store()
    }

    /// All of it; `None` where it cannot be read back.
    #[must_use]
    pub fn load(&self) -> Option<Keyframe> {
        Some(Keyframe {
            id: self.id,
            frame_index: self.frame_index,
            timestamp_ns: self.timestamp_ns,
            revision: self.revision,
            image: self.image()?,
            pixels: self.pixels()?,
        })
    }
}

impl From<Keyframe> for KeptKeyframe {
    /// One that stays in memory as long as this does.
    fn from(keyframe: Keyframe) -> Self {
        Self::new(&Store::default(), keyframe)
    }
}

/// The keyframe in use at one moment, seen from the newest frame: what is known of the surroundings
/// of the camera without any correction of the map.
#[derive(Clone, Debug)]
pub struct KeyframeInUse {
    /// Identity.
    pub id: KeyframeId,
    /// Its pose in the camera of the newest frame, as it was tracked; the scale is the keyframe's
    /// unit of length.
    pub camera_from_keyframe: Sim3,
    /// Its semi-dense depth as it is now, row-major.
    pub pixels: Vec<DepthPixel>,
    /// How often odometry has gone on although nobody knows how the camera came where it is: what
    /// lay around it before has another place now.
    pub num_gaps: usize,
}

/// Poses of all keyframes at one revision.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseSnapshot {
    /// Grows with every change.
    pub revision: u64,
    /// Pose and scale of each keyframe, by identity; in the world of its fragment.
    pub world_from_keyframe: Vec<Sim3>,
    /// Covariance of a left update `[v, w, s]` of each keyframe's pose relative to the keyframe
    /// that it was tracked on when it was made (mostly the one before), in the units of that one,
    /// by identity; `None` or missing where it is not known (yet).
    pub previous_from_keyframe_covariance: Vec<Option<Mat7>>,
    /// The keyframe that each was tracked on when it was made, by identity; none for the first of a
    /// fragment.
    pub parent: Vec<Option<KeyframeId>>,
    /// Fragment of each keyframe, by identity; the main map where it is missing.
    pub fragment: Vec<FragmentId>,
}

impl PoseSnapshot {
    /// The fragment of a keyframe.
    #[must_use]
    pub fn fragment_of(&self, id: KeyframeId) -> FragmentId {
        self.fragment.get(id as usize).copied().unwrap_or(MAIN_MAP)
    }

    /// The keyframe on which another was tracked.
    pub(crate) fn parent_of(&self, id: KeyframeId) -> Option<KeyframeId> {
        self.parent.get(id as usize).copied().flatten()
    }

    /// Pose and scale of a keyframe in the main map, if it belongs to it.
    #[must_use]
    pub fn in_main_map(&self, id: KeyframeId) -> Option<&Sim3> {
        let pose = self.world_from_keyframe.get(id as usize);
        pose.filter(|_| self.fragment_of(id) == MAIN_MAP)
    }
}

/// Whether lengths are metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// World units are metres.
    Metric,
    #[default]
    /// World units are arbitrary: the median depth of the first keyframe is 1.
    Arbitrary,
}

/// A frame with a believed pose, relative to its keyframe: it follows when the keyframe is moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedFrame {
    /// Index of the frame in its source.
    pub frame_index: usize,
    /// Time of the frame.
    pub timestamp_ns: i64,
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// Pose, translation in the keyframe's units.
    pub keyframe_from_frame: Se3,
}

impl TrackedFrame {
    /// The pose in the world, given the keyframe's.
    #[must_use]
    pub fn world_from_camera(&self, world_from_keyframe: &Sim3) -> Se3 {
        (*world_from_keyframe * self.keyframe_from_frame.with_scale(1.0)).to_se3()
    }
}

/// A frame with a believed pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPose {
    /// Index of the frame in its source.
    pub frame_index: usize,
    /// Time of the frame.
    pub timestamp_ns: i64,
    /// Pose with all that is known now.
    pub world_from_camera: Se3,
    /// What it comes from.
    pub source: PoseSource,
}

/// What the pose of a frame comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseSource {
    /// Its image, and what the images show holds the pose of its keyframe: to a hundredth of the
    /// median depth and 0.4 degrees (one standard deviation, beside the keyframes before).
    Certain,
    /// Its image, and less holds the pose of its keyframe.
    Uncertain,
    /// The frames before and after it: in its own image the camera is lost.
    Interpolated,
}
