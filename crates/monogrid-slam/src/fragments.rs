//! Fragments of the map: what a camera sees that was lost and does not recognise the place.
//!
//! The first map is fragment 0, the *main map*. A later fragment has a world of its own (the camera of its
//! first keyframe, of unknown place and scale) until its keyframes are recognised in another one.

use crate::KeyframeId;
use serde::{Deserialize, Serialize};

/// Identity of a fragment; never reused. 0 is the main map.
pub type FragmentId = u32;

/// The fragment that the first keyframe belongs to, and all that are joined to it.
pub const MAIN_MAP: FragmentId = 0;

/// When a lost camera starts a new fragment of the map, and when that is joined to another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FragmentConfig {
    /// Whether there are fragments; without, a lost camera waits until it sees a known place. They need
    /// `graph.enabled` and `graph.places.enabled`, without which none would ever be joined.
    pub enabled: bool,
    /// Seconds of video with texture that the camera must be lost before a fragment is started; a known place
    /// is recognised in less. Range [0.01, 1000000].
    pub min_lost_secs: f64,
    /// Fragments that are not joined at most; while there are as many, a lost camera waits. Range [0, 1000].
    pub max_apart: usize,
    /// Keyframes of a fragment that must be recognised in another one, verified by points in both directions,
    /// and agree about where the fragment is; one of them must have been aligned directly. More for places that
    /// look alike. Range [1, 1000].
    pub min_agreeing: usize,
    /// Largest difference between two that agree where there is no way between them: median depths, rad, and
    /// the logarithm of the scale. It grows with the way as drift does (`graph.places.drift`), but starts here,
    /// because recognised points say less than direct alignment. Range [0.000001, 1000].
    pub max_disagreement: f64,
    /// Last frames with a pose that are kept, in case that the camera is lost after them: a start that shows them goes on
    /// in their map. Range [0, 100].
    pub bridge_frames: usize,
    /// Of these, frames that must be tracked on a start. Range [3, 100].
    pub min_bridge_frames: usize,
    /// Largest standard deviation of the logarithm of the scale by which their positions agree. Range [0, 10].
    pub max_bridge_scale_sigma: f64,
    /// Largest root mean square of the angles between their orientations, degrees. Range [0, 180].
    pub max_bridge_turn_deg: f64,
}

impl Default for FragmentConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_lost_secs: 1.0,
            max_apart: 8,
            min_agreeing: 2,
            max_disagreement: 0.1,
            bridge_frames: 8,
            min_bridge_frames: 4,
            max_bridge_scale_sigma: 0.1,
            max_bridge_turn_deg: 1.0,
        }
    }
}

/// What is known of a fragment other than the main map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fragment {
    /// Identity.
    pub id: FragmentId,
    /// Its first keyframe.
    pub first_keyframe: KeyframeId,
    /// Frame of that keyframe, as indexed by the source.
    pub first_frame: usize,
    /// Its keyframes, when it was joined or now.
    pub keyframes: usize,
    /// Its frames with a pose, when it was joined or now.
    pub frames: usize,
    /// What it became a part of.
    pub joined: Option<Join>,
}

impl Fragment {
    /// A fragment that begins with a keyframe.
    pub(crate) fn begun(id: FragmentId, first_keyframe: KeyframeId, first_frame: usize) -> Self {
        Self {
            id,
            first_keyframe,
            first_frame,
            keyframes: 0,
            frames: 0,
            joined: None,
        }
    }
}

/// A fragment became a part of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Join {
    /// The other, which is older.
    pub into: FragmentId,
    /// The frame after which it was.
    pub frame: usize,
}

/// A loss after which the map went on: the start that ended it shows frames from before.
///
/// What lies behind is known less well relative to what lies before than keyframes that follow each other, until points
/// or places are seen from both.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bridge {
    /// The keyframe that was in use before the loss.
    pub from_keyframe: KeyframeId,
    /// The first one after it.
    pub first_keyframe: KeyframeId,
    /// Frame of that keyframe, as indexed by the source.
    pub first_frame: usize,
    /// Frames that were tracked on both sides.
    pub common_frames: usize,
    /// Standard deviation of the logarithm of the scale behind the loss relative to that before it.
    pub scale_sigma: f64,
}
