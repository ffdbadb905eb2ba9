//! When a frame becomes a keyframe.

use crate::KeyframeConfig;

/// What the decision looks at.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct KeyframeEvidence {
    /// Distance from the keyframe times its mean inverse depth.
    pub relative_distance: f64,
    /// Share of the keyframe that the frame still resolves.
    pub usage: f64,
    /// Frames that updated the keyframe's depth.
    pub num_mapped: usize,
    /// Keyframes that exist already.
    pub num_keyframes: usize,
}

/// How far a frame is from a keyframe: 1 where a new keyframe is needed. `[ECCV14]` weighted combination of
/// distance and lost overlap.
pub(crate) fn keyframe_score(evidence: &KeyframeEvidence, config: &KeyframeConfig) -> f64 {
    let distance = evidence.relative_distance * config.distance_weight;
    let lost = (1.0 - evidence.usage) * config.usage_weight;
    distance * distance + lost * lost
}

/// The score against a threshold that grows over the first keyframes of a random start.
pub(crate) fn is_new_keyframe(evidence: &KeyframeEvidence, config: &KeyframeConfig) -> bool {
    if evidence.num_mapped < config.min_mapped_frames {
        // A frame that has lost most of the keyframe cannot wait.
        return evidence.usage < config.urgent_usage;
    }
    let ramp = if config.ramp_keyframes > 0 && evidence.num_keyframes < config.ramp_keyframes {
        0.7 * (0.2 + 0.16 * evidence.num_keyframes as f64)
    } else {
        1.0
    };
    keyframe_score(evidence, config) > ramp
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evidence(relative_distance: f64, usage: f64) -> KeyframeEvidence {
        KeyframeEvidence {
            relative_distance,
            usage,
            num_mapped: 10,
            num_keyframes: 20,
        }
    }

    #[test]
    fn translation_alone_triggers_at_the_inverse_of_its_weight() {
        let config = KeyframeConfig::thesis();
        assert!(!is_new_keyframe(&evidence(0.32, 1.0), &config));
        assert!(is_new_keyframe(&evidence(0.35, 1.0), &config));
    }

    #[test]
    fn lost_overlap_alone_triggers_below_three_quarters() {
        let config = KeyframeConfig::thesis();
        assert!(!is_new_keyframe(&evidence(0.0, 0.77), &config));
        assert!(is_new_keyframe(&evidence(0.0, 0.73), &config));
    }

    #[test]
    fn a_young_keyframe_stays_unless_the_view_is_almost_gone() {
        let config = KeyframeConfig::thesis();
        let young = KeyframeEvidence {
            num_mapped: 2,
            ..evidence(0.5, 0.6)
        };
        assert!(!is_new_keyframe(&young, &config));
        let urgent = KeyframeEvidence {
            usage: config.urgent_usage - 0.01,
            ..young
        };
        assert!(is_new_keyframe(&urgent, &config));
    }
}
