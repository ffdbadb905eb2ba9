//! Identities of keyframes and fragments.

/// Identity of a keyframe; never reused, counted from 0.
pub type KeyframeId = u32;

/// Identity of a fragment; never reused. 0 is the main map, with which the largest fragment can
/// change places at the end.
pub type FragmentId = u32;

/// The fragment that the first keyframe belongs to, and all that are joined to it.
pub const MAIN_MAP: FragmentId = 0;
