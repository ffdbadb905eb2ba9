//! How the first keyframe gets its depth: from a depth image, at random, or from two views.

use crate::frame::{BufferedFrame, Frame};
use crate::median::median;
use crate::two_view_start::TwoViewStart;
use crate::{InitializationMode, LostReason, Scale, SlamConfig};
use monogrid_depth::{DepthMap, HostFrame};
use monogrid_geometry::{Pinhole, Se3};
use monogrid_image::{GrayImage, Mask};
use std::sync::Arc;

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

/// Outcome of one frame.
#[derive(Debug)]
pub(crate) enum StartOutcome {
    /// Not yet.
    Waiting(LostReason),
    /// There is a first keyframe.
    Started(Box<Started>),
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
    /// Time to the frame after the keyframe, or from the one before it.
    pub(crate) fn first_interval_ns(&self) -> i64 {
        let next = self.later.first().or(self.earlier.last());
        next.map_or(0, |next| {
            (next.timestamp_ns - self.keyframe.timestamp_ns).abs()
        })
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

    /// Takes the next frame. A seed depth decides at once, whatever the mode.
    pub(crate) fn add_frame(
        &mut self,
        frame: Frame,
        seed_depth: Option<&GrayImage>,
        pinhole: &Pinhole,
        mask: &Mask,
        config: &SlamConfig,
    ) -> StartOutcome {
        if let Some(started) =
            seed_depth.and_then(|d| from_seed_depth(&frame, d, pinhole, mask, config))
        {
            return StartOutcome::Started(Box::new(started));
        }
        match self {
            Self::Random { seed } => random(frame, *seed, pinhole, mask, config),
            Self::TwoView(start) => start.add_frame(frame, pinhole, mask, config),
        }
    }
}

/// The host of a frame; `None` for sizes the depth filter cannot work with.
pub(crate) fn host_of(frame: &Frame, pinhole: &Pinhole, mask: &Mask) -> Option<Arc<HostFrame>> {
    HostFrame::new(frame.image().clone(), mask.clone(), *pinhole).map(Arc::new)
}

/// Random depth in the first frame that has texture.
fn random(
    frame: Frame,
    seed: u64,
    pinhole: &Pinhole,
    mask: &Mask,
    config: &SlamConfig,
) -> StartOutcome {
    let Some(host) = host_of(&frame, pinhole, mask) else {
        return StartOutcome::Waiting(LostReason::NoTexture);
    };
    let mut depth = DepthMap::empty(host, &config.depth);
    depth.initialize_random(seed);
    if depth.num_known() < config.tracking.min_points {
        return StartOutcome::Waiting(LostReason::NoTexture);
    }
    StartOutcome::Started(Box::new(Started {
        keyframe: frame,
        depth,
        world_scale: 1.0,
        scale: Scale::Arbitrary,
        first_step: Se3::identity(),
        earlier: Vec::new(),
        later: Vec::new(),
    }))
}

/// A metric start from a depth image. The keyframe's unit is the median depth.
fn from_seed_depth(
    frame: &Frame,
    seed_depth: &GrayImage,
    pinhole: &Pinhole,
    mask: &Mask,
    config: &SlamConfig,
) -> Option<Started> {
    let host = host_of(frame, pinhole, mask)?;
    if !seed_depth.same_size(frame.image()) {
        return None;
    }
    let depths = seed_depth.as_slice().iter().copied();
    let mut known: Vec<f32> = depths.filter(|z| z.is_finite() && *z > 0.0).collect();
    if known.len() < config.tracking.min_points {
        return None;
    }
    let unit = median(&mut known)?;
    let mut depth = DepthMap::empty(host, &config.depth);
    let sigma = config.initialization.seed_relative_sigma;
    depth.initialize_from_depth(&seed_depth.map(|z| z / unit), sigma);
    (depth.num_known() >= config.tracking.min_points).then(|| Started {
        keyframe: frame.clone(),
        depth,
        world_scale: f64::from(unit),
        scale: Scale::Metric,
        first_step: Se3::identity(),
        earlier: Vec::new(),
        later: Vec::new(),
    })
}
