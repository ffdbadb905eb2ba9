//! How the first keyframe gets its depth: from a depth camera, at random, or from two views.

use crate::frame::{BufferedFrame, Frame};
use crate::median::median;
use crate::setup::Setup;
use crate::tracker::MIN_POINTS;
use crate::two_view_start::TwoViewStart;
use crate::{InitializationMode, LostReason, Scale, SlamConfig};
use monogrid_depth::DepthMap;
use monogrid_geometry::Se3;
use std::collections::VecDeque;

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
    /// The first frame of which the depth was measured, for which others wait.
    Measured {
        /// Its number.
        first: usize,
        /// The newest of the frames before it.
        earlier: VecDeque<BufferedFrame>,
    },
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
            Self::Measured { earlier, .. } => earlier.into(),
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

    /// Waits for the frame with this number, of which the depth was measured.
    pub(crate) fn with_measured(first: usize) -> Self {
        let earlier = VecDeque::new();
        Self::Measured { first, earlier }
    }

    /// Takes the next frame: the first keyframe, or why there is none yet. Measured depth decides
    /// at once, whatever the mode.
    pub(crate) fn add_frame(
        &mut self,
        frame: Frame,
        setup: &Setup,
    ) -> Result<Box<Started>, LostReason> {
        if let Some(mut started) = from_measured_depth(&frame, setup) {
            if let Self::Measured { earlier, .. } = self {
                started.earlier = std::mem::take(earlier).into();
            }
            return Ok(Box::new(started));
        }
        if let Self::Measured { first, .. } = self
            && frame.index >= *first
        {
            // too little was measured, or that frame never came
            *self = Self::new(&setup.config, setup.seed);
        }
        match self {
            Self::Measured { earlier, .. } => {
                earlier.push_back(BufferedFrame::new(&frame));
                let most = setup.config.initialization.max_buffered_frames;
                earlier.drain(..earlier.len().saturating_sub(most));
                Err(LostReason::WaitingForDepth)
            }
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

/// A metric start from what a depth camera measured with the frame. The keyframe's unit is the
/// median depth.
fn from_measured_depth(frame: &Frame, setup: &Setup) -> Option<Started> {
    let measured = frame.measured.as_ref()?;
    let mut depths: Vec<f32> = measured
        .pixels(1.0)
        .map(|pixel| 1.0 / pixel.idepth)
        .collect();
    let unit = median(&mut depths)?;
    let mut depth = DepthMap::empty(setup.host(frame.image().clone())?, &setup.config.depth);
    let num_measured = depth.fuse_measured(measured, unit);
    (num_measured >= MIN_POINTS).then(|| Started {
        world_scale: f64::from(unit),
        scale: Scale::Metric,
        ..Started::new(frame.clone(), depth)
    })
}
