//! What is said about each frame.

use crate::{FragmentId, KeyframeId};
use monogrid_geometry::{Mat6, Se3};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Instant;

/// How far the pose of a frame is to be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TrackingState {
    /// There is no map yet.
    Initialising,
    /// The pose is believed.
    Good,
    /// The pose is believed, but less: grey values of frame and keyframe do not agree well enough
    /// to refine depth, or points hold the pose of the keyframe too little
    /// ([`LostReason::Loose`]).
    Degraded,
    /// The pose is believed, but only within a fragment of which it is not known where it lies in
    /// the main map.
    Fragment,
    /// There is no pose for this frame.
    Lost,
}

impl TrackingState {
    /// Lower-case name, as in `frames.csv`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Initialising => "initialising",
            Self::Good => "good",
            Self::Degraded => "degraded",
            Self::Fragment => "fragment",
            Self::Lost => "lost",
        }
    }
}

/// Why a frame is degraded, lost, or not yet tracked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LostReason {
    /// Too little parallax to start.
    NotEnoughParallax,
    /// Too few features could be followed to start.
    TooFewFeatures,
    /// The first frame of which the depth was measured is still to come.
    WaitingForDepth,
    /// The start is ambiguous (plane or rotation).
    AmbiguousStart,
    /// Too few of the keyframe's points project into the frame.
    NoOverlap,
    /// The points project into the frame, but the grey values do not agree.
    Residuals,
    /// The image has almost no texture.
    NoTexture,
    /// The motion since the last frame is not that of a camera.
    Jump,
    /// A map is continued and the camera has not been recognised in it yet.
    NotRecognised,
    /// The image is the same as the one before; its pose was taken over.
    Repeated,
    /// Too little in view holds the pose of the keyframe: before a plain wall the camera may slide.
    Loose,
}

impl fmt::Display for LostReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotEnoughParallax => "not enough parallax to start",
            Self::TooFewFeatures => "too few features to start",
            Self::WaitingForDepth => "waiting for the first measured depth",
            Self::AmbiguousStart => "start is ambiguous",
            Self::NoOverlap => "too little overlap with the keyframe",
            Self::Residuals => "grey values do not agree with the keyframe",
            Self::NoTexture => "image has almost no texture",
            Self::Jump => "implausible motion",
            Self::NotRecognised => "not recognised in the map",
            Self::Repeated => "repeated image",
            Self::Loose => "too little in view holds the pose",
        })
    }
}

/// Milliseconds of wall time per stage; for reports only, never for decisions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageTimes {
    /// Pyramid and tracking.
    pub tracking: f64,
    /// Depth filter.
    pub depth: f64,
    /// Sparse layer and graph.
    pub graph: f64,
}

/// Times the stages of a frame one after the other.
#[derive(Debug)]
pub(crate) struct Stopwatch {
    pub times: StageTimes,
    since: Instant,
}

impl Stopwatch {
    pub(crate) fn start() -> Self {
        Self {
            times: StageTimes::default(),
            since: Instant::now(),
        }
    }

    /// The time since the last lap was spent on this stage.
    pub(crate) fn lap(&mut self, stage: impl FnOnce(&mut StageTimes) -> &mut f64) {
        let now = Instant::now();
        *stage(&mut self.times) += (now - self.since).as_secs_f64() * 1e3;
        self.since = now;
    }
}

/// Size of what the system keeps about the places it has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MapSize {
    /// Keyframes.
    pub keyframes: usize,
    /// Edges of their graph.
    pub edges: usize,
    /// Points of the sparse layer.
    pub points: usize,
    /// What they take in memory.
    pub bytes: MapBytes,
}

/// Bytes of the map by what they hold. The memory of places and the poses of the graph, which its
/// thread owns, are not counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MapBytes {
    /// Images and depth of keyframes that are in memory.
    pub keyframes: usize,
    /// What was made of them and is kept for a while: pyramids.
    pub prepared: usize,
    /// The temporary file for images and depth of keyframes.
    pub in_file: usize,
    /// Points of the sparse layer, their observations, and what keyframes know of them.
    pub points: usize,
    /// Frames with a pose.
    pub frames: usize,
}

/// Outcome of one frame.
///
/// Written and read again (`serde`), it is the same but for its covariance, which is left out.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FrameReport {
    /// Index of the frame in its source.
    pub index: usize,
    /// Time of the frame.
    pub timestamp_ns: i64,
    /// How far its pose is to be believed.
    pub state: TrackingState,
    /// Why it is not [`TrackingState::Good`].
    pub reason: Option<LostReason>,
    /// Pose in the main map as known now; `None` while initialising or lost, or in a fragment.
    pub world_from_camera: Option<Se3>,
    /// Pose by what was tracked from frame to frame alone, in units of the world then: it begins at
    /// `world_from_camera`, drifts, and never jumps. `None` while initialising or lost, or in a
    /// fragment, whose unit is not that of the world; where the camera is recognised afterwards it
    /// goes on from where it was.
    pub odom_from_camera: Option<Se3>,
    /// Covariance of the pose relative to the keyframe: twist `[v, w]`, left, in the frame,
    /// keyframe units.
    #[serde(skip)]
    pub covariance: Option<Mat6>,
    /// Root mean square residual of good points, grey levels.
    pub residual: f32,
    /// Good points over visible points.
    pub good_share: f32,
    /// Share of the keyframe still resolved by the frame.
    pub usage: f32,
    /// Gain from the keyframe to the frame.
    pub exposure_gain: f32,
    /// Wall time per stage.
    pub milliseconds: StageTimes,
    /// Keyframe that the frame was tracked on.
    pub keyframe: Option<KeyframeId>,
    /// Keyframe that was finished with this frame.
    pub finished_keyframe: Option<KeyframeId>,
    /// Whether this frame became a keyframe.
    pub created_keyframe: bool,
    /// Keyframe that existed already and with which tracking goes on after this frame.
    pub reactivated_keyframe: Option<KeyframeId>,
    /// Whether the camera was lost and this frame was recognised.
    pub relocalised: bool,
    /// Where the camera is, when that is not in the main map.
    pub fragment: Option<InFragment>,
    /// Fragment that was started with this frame.
    pub started_fragment: Option<FragmentId>,
    /// Fragments that became a part of another before or with this frame.
    pub joined_fragments: Vec<FragmentId>,
}

/// A pose in the world of a fragment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct InFragment {
    /// The fragment.
    pub id: FragmentId,
    /// Pose as known now, in its own unit of length.
    pub fragment_from_camera: Se3,
}

impl FrameReport {
    /// A report of which nothing but the state is known yet.
    #[must_use]
    pub fn new(index: usize, timestamp_ns: i64, state: TrackingState) -> Self {
        Self {
            index,
            timestamp_ns,
            state,
            reason: None,
            world_from_camera: None,
            odom_from_camera: None,
            covariance: None,
            residual: 0.0,
            good_share: 0.0,
            usage: 0.0,
            exposure_gain: 1.0,
            milliseconds: StageTimes::default(),
            keyframe: None,
            finished_keyframe: None,
            created_keyframe: false,
            reactivated_keyframe: None,
            relocalised: false,
            fragment: None,
            started_fragment: None,
            joined_fragments: Vec::new(),
        }
    }

    /// What the map corrects of odometry: jumps with loops, optimisation and relocalisation.
    #[must_use]
    pub fn map_from_odom(&self) -> Option<Se3> {
        Some(self.world_from_camera? * self.odom_from_camera?.inverse())
    }
}
