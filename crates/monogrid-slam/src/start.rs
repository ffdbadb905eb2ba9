//! How the first keyframe gets its depth: from a depth image, at random, or from two views.

use crate::frame::{BufferedFrame, Frame};
use crate::median::median;
use crate::setup::Setup;
use crate::tracker::MIN_POINTS;
use crate::two_view_start::TwoViewStart;
use crate::{InitializationMode, LostReason, Scale, SlamConfig};
use monogrid_depth::DepthMap;
use monogrid_geometry::Se3;
use monogrid_image::GrayImage;

/// Waits for the first keyframe.
#[derive(Debug)]
pub(crate) enum Start {
    /// Random depth in the first frame.
    Random {
        /// Seed of the generator.
        seed: u64,
    },
    /// Two views with parallax.
    TwoView(Box<TwoViewStart>),
}

/// The first keyframe, and the frames that were seen while waiting for it.
#[derive(Debug)]
pub(crate) struct Started {
    pub keyframe: Frame,
    pub depth: DepthMap,
    /// Keyframe unit in world units.
    pub world_scale: f64,
    pub scale: Scale,
    /// Motion of the camera from the keyframe to the next frame, where it is known.
    pub first_step: Se3,
    /// Frames before the keyframe, in the order of time.
    pub earlier: Vec<BufferedFrame>,
    /// Frames after it, in the order of time.
    pub later: Vec<BufferedFrame>,
}

impl Started {
    /// In its own unit, where no other frame is known.
    pub(crate) fn new(keyframe: Frame, depth: DepthMap) -> Self {
        Self {
            keyframe,
            depth,
            world_scale: 1.0,
            scale: Scale::Arbitrary,
            first_step: Se3::identity(),
            earlier: Vec::new(),
            later: Vec::new(),
        }
    }

    /// Time to the frame after the keyframe, or from the one before it.
    pub(crate) fn first_interval_ns(&self) -> i64 {
        let (next, own_ns) = (self.later.first(), self.keyframe.timestamp_ns);
        let next = next.or(self.earlier.last());
        next.map_or(0, |next| (next.timestamp_ns - own_ns).abs())
    }

    /// All frames, in the order of time.
    pub(crate) fn into_frames(self) -> Vec<BufferedFrame> {
        let mut frames = self.earlier;
        frames.push(BufferedFrame::new(&self.keyframe));
        frames.extend(self.later);
        frames
    }
}

impl Start {
    /// The frames that were kept, in the order of time.
    pub(crate) fn into_frames(self) -> Vec<BufferedFrame> {
        match self {
            Self::Random { .. } => Vec::new(),
            Self::TwoView(start) => start.into_frames(),
        }
    }

    pub(crate) fn new(config: &SlamConfig, seed: u64) -> Self {
        match config.initialization.mode {
            InitializationMode::Random => Self::Random { seed },
            InitializationMode::TwoView => {
                Self::TwoView(Box::new(TwoViewStart::new(&config.initialization, seed)))
            }
        }
    }

    /// Takes the next frame: the first keyframe, or why there is none yet. A seed depth decides at
    /// once, whatever the mode.
    pub(crate) fn add_frame(
        &mut self,
        frame: Frame,
        seed_depth: Option<&GrayImage>,
        setup: &Setup,
    ) -> Result<Box<Started>, LostReason> {
        if let Some(started) = seed_depth.and_then(|depth| from_seed_depth(&frame, depth, setup)) {
            return Ok(Box::new(started));
        }
        match self {
            Self::Random { seed } => {
                let started = random(frame, *seed, setup);
                started.map(Box::new).ok_or(LostReason::NoTexture)
            }
            Self::TwoView(start) => start.add_frame(frame, setup),
        }
    }
}

/// Random depth in a frame that has texture.
fn random(frame: Frame, seed: u64, setup: &Setup) -> Option<Started> {
    let config = &setup.config;
    let mut depth = DepthMap::empty(setup.host(frame.image().clone())?, &config.depth);
    depth.initialize_random(seed);
    (depth.num_known() >= MIN_POINTS).then(|| Started::new(frame, depth))
}

/// A metric start from a depth image. The keyframe's unit is the median depth.
fn from_seed_depth(frame: &Frame, seed_depth: &GrayImage, setup: &Setup) -> Option<Started> {
    let config = &setup.config;
    if !seed_depth.same_size(frame.image()) {
        return None;
    }
    let depths = seed_depth.as_slice().iter().copied();
    let mut known: Vec<f32> = depths.filter(|z| z.is_finite() && *z > 0.0).collect();
    if known.len() < MIN_POINTS {
        return None;
    }
    let unit = median(&mut known)?;
    let mut depth = DepthMap::empty(setup.host(frame.image().clone())?, &config.depth);
    let sigma = config.initialization.seed_relative_sigma;
    depth.initialize_from_depth(&seed_depth.map(|z| z / unit), sigma);
    (depth.num_known() >= MIN_POINTS).then(|| Started {
        world_scale: f64::from(unit),
        scale: Scale::Metric,
        ..Started::new(frame.clone(), depth)
    })
}
