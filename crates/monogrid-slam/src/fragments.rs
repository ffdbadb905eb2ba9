//! Fragments of the map: what a camera sees that was lost and does not recognise the place.
//!
//! The first map is fragment 0, the *main map*. A later fragment has a world of its own (the camera
//! of its first keyframe, of unknown place and scale) until its keyframes are recognised in another
//! one.
//!
//! A fragment never moves another one: what compares poses (sparse layer, known views, graph) stays
//! within one. Frames in a fragment that is apart have no pose in the map, odometry waits there as
//! in a loss, and trajectory and maps hold the main map only. While the camera runs that is the
//! first one, so that what others were told keeps its frame; in the end a fragment that is much
//! larger becomes the main map. What stays apart is kept, and a later session can still join it.

use crate::{FragmentId, KeyframeId};
use serde::Serialize;

/// When a lost camera starts a new fragment of the map, and when that is joined to another.
#[derive(Clone, Debug, PartialEq)]
pub struct FragmentConfig {
    /// Whether there are fragments; without, a lost camera waits until it sees a known place. They
    /// need `graph.enabled` and `graph.places.enabled`, without which none would ever be joined.
    pub enabled: bool,
    /// Seconds of video with texture that the camera must be lost before a fragment is started; a
    /// known place is recognised in less.
    pub min_lost_secs: f64,
    /// Fragments that are not joined at most; while there are as many, a lost camera waits.
    pub max_apart: usize,
    /// Keyframes of each of two fragments that must be recognised in the other, verified by points
    /// in both directions, and agree about where the one lies in the other, where direct alignment
    /// confirms a pair of them. Where it confirms none, one pair more than this must agree.
    pub(crate) min_agreeing: usize,
    /// A fragment that is apart at the end becomes the map, and the first map a fragment, where it
    /// has at least so many times as many frames with a pose; not where the first map is in metres
    /// or of an earlier session.
    pub min_times_larger: f64,
}

impl Default for FragmentConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_lost_secs: 1.0,
            max_apart: 8,
            min_agreeing: 2,
            min_times_larger: 1.5,
        }
    }
}

/// When maps that were made apart are joined.
#[derive(Clone, Debug, PartialEq)]
pub struct MergeConfig {
    /// Keyframes of each of two maps that must be recognised in the other, verified by points in
    /// both directions, and agree pair by pair about where the one lies in the other, as
    /// `fragments.max_disagreement` and `graph.places.drift` allow.
    pub min_agreeing: usize,
    /// Of these pairs of keyframes, those that direct alignment must have confirmed.
    pub(crate) min_aligned: usize,
    /// How many times as many keyframes must agree as agree about anything else: places that look
    /// alike.
    pub(crate) min_majority: f64,
}

impl Default for MergeConfig {
    fn default() -> Self {
        Self {
            min_agreeing: 2,
            min_aligned: 1,
            min_majority: 1.5,
        }
    }
}

/// How much a set of sightings that agree pair by pair says; more keyframes count first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Agreement {
    /// Its keyframes in the map of which fewer are in it.
    pub keyframes: usize,
    /// Its pairs of keyframes that direct alignment confirmed.
    pub aligned: usize,
    /// Its pairs of keyframes.
    pub pairs: usize,
}

/// What two fragments that were made apart have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Meeting {
    /// The two, the older first.
    pub fragments: (FragmentId, FragmentId),
    /// Pairs of keyframes, one of each, that show the same by their points in both directions.
    pub sightings: usize,
    /// The largest set of them that agree.
    pub agreeing: Agreement,
    /// The largest set of the others that agree.
    pub contradicting: Agreement,
}

impl Meeting {
    /// Whether that is enough to join two runs.
    #[must_use]
    pub fn is_enough(&self, config: &MergeConfig) -> bool {
        let needed = config.min_majority * self.contradicting.keyframes as f64;
        self.agreeing.keyframes >= config.min_agreeing
            && self.agreeing.aligned >= config.min_aligned
            && self.agreeing.keyframes as f64 >= needed
    }

    /// Whether that is enough to join two fragments of one run. Direct alignment fails where steps
    /// are large or a picture is blurred: a further pair of keyframes that agrees by its points is
    /// as good. Nothing was moved meanwhile, so that several keyframes may have recognised a single
    /// one: a lost frame is believed by less.
    #[must_use]
    pub(crate) fn is_enough_in_run(&self, config: &FragmentConfig) -> bool {
        let Agreement {
            keyframes, aligned, ..
        } = self.agreeing;
        let is_aligned = keyframes >= config.min_agreeing && aligned > 0;
        (is_aligned || self.agreeing.pairs > config.min_agreeing)
            && keyframes > self.contradicting.keyframes
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
/// What lies behind is known less well relative to what lies before than keyframes that follow each
/// other, until points or places are seen from both.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn meeting(
        (keyframes, aligned, pairs): (usize, usize, usize),
        contradicting: usize,
    ) -> Meeting {
        Meeting {
            fragments: (0, 1),
            sightings: 10,
            agreeing: Agreement {
                keyframes,
                aligned,
                pairs,
            },
            contradicting: Agreement {
                keyframes: contradicting,
                ..Agreement::default()
            },
        }
    }

    #[test]
    fn fragments_of_a_run_are_joined_by_one_aligned_pair_of_two_keyframes_or_by_three_pairs() {
        let config = FragmentConfig::default();
        let is_enough =
            |agreeing, contradicting| meeting(agreeing, contradicting).is_enough_in_run(&config);
        assert!(is_enough((2, 1, 2), 0));
        assert!(!is_enough((2, 0, 2), 0));
        assert!(!is_enough((1, 1, 2), 0));
        assert!(is_enough((1, 0, 3), 0));
        // not where as many say otherwise
        assert!(!is_enough((1, 0, 3), 1));
        assert!(is_enough((3, 1, 3), 2));
        assert!(!is_enough((3, 1, 3), 3));
    }

    #[test]
    fn maps_are_joined_by_enough_keyframes_that_agree_are_aligned_and_outnumber_the_others() {
        let config = MergeConfig {
            min_agreeing: 4,
            min_aligned: 2,
            min_majority: 1.5,
        };
        let is_enough = |keyframes, aligned, contradicting| {
            meeting((keyframes, aligned, 10), contradicting).is_enough(&config)
        };
        assert!(is_enough(4, 2, 0));
        assert!(!is_enough(3, 2, 0));
        assert!(!is_enough(4, 1, 0));
        assert!(is_enough(6, 2, 4));
        assert!(!is_enough(6, 2, 5));
        // a single keyframe never joins anything by default, nor do points without direct alignment
        let default = MergeConfig::default();
        assert!(default.min_agreeing >= 2 && default.min_aligned >= 1);
    }
}
