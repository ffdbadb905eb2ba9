//! From a prior to the pose of a frame relative to the keyframe, with a verdict.

mod again;
mod combine;
mod config;
mod points;
mod prior;

pub use self::config::{PointTrackingConfig, TrackingConfig};
pub(crate) use self::points::PointMap;
pub(crate) use self::prior::{Accelerations, MotionPrior, extrapolate};

use self::again::{better, is_weak};
use crate::frame::Frame;
use crate::setup::Setup;
use crate::{LostReason, TrackingState};
use monogrid_alignment::{Alignment, AlignmentConfig, Freedom, Motion, Reference, align};
use monogrid_geometry::{Se3, Vec3, rotation_exp};
use monogrid_image::Pyramid;

/// A turn is believed when this share of the visible points fits.
const MIN_GOOD_OF_TURN: f32 = 0.3;
/// Turns about every axis that are tried where the expected motion does not lead to the image, rad.
const GUESSED_TURNS: [f64; 2] = [0.02, 0.05];

/// A hypothesis is taken without looking at the others when on the coarsest level this share of
/// the visible points is good.
const ACCEPT_GOOD_OF_VISIBLE: f32 = 0.85;
/// For that, this share of all points must be visible, too.
const ACCEPT_VISIBLE_SHARE: f32 = 0.5;
/// Fewest points on the finest level, and fewest pixels with depth of a start.
pub(crate) const MIN_POINTS: usize = 60;
/// Largest change of the logarithm of the gain from one frame to the next that is no surprise.
const SURPRISING_LOG_GAIN: f64 = 0.2;

/// What points of the sparse layer say about a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Support {
    /// They do not decide.
    None,
    /// A few of them are where the pose by alignment has them.
    Confirmed,
    /// They gave the pose.
    Held {
        /// Points that agree.
        num_points: usize,
    },
}

/// Pose of a frame and how far to believe it.
#[derive(Clone, Debug)]
pub(crate) struct Tracked {
    pub alignment: Alignment,
    /// Whether the pose is farther from where the motion of the last frames leads than the camera
    /// can be: then another thing than the room may have been "explained".
    pub is_beyond_gate: bool,
    /// Whether the brightness is another than that of the last frame.
    pub has_other_gain: bool,
    pub support: Support,
    pub state: TrackingState,
    pub reason: Option<LostReason>,
}

impl Tracked {
    /// Whether the frame is not what was expected.
    pub(crate) fn is_surprising(&self) -> bool {
        self.is_beyond_gate || self.has_other_gain
    }
}

/// A frame that is to be tracked on a keyframe.
#[derive(Clone, Copy)]
pub(crate) struct Task<'a> {
    setup: &'a Setup,
    config: &'a TrackingConfig,
    /// The points of the keyframe.
    reference: &'a Reference,
    frame: &'a Frame,
    prior: &'a MotionPrior,
}

impl<'a> Task<'a> {
    pub(crate) fn new(
        setup: &'a Setup,
        reference: &'a Reference,
        frame: &'a Frame,
        prior: &'a MotionPrior,
    ) -> Self {
        Self {
            setup,
            config: &setup.config.tracking,
            reference,
            frame,
            prior,
        }
    }

    /// Tracks the frame by its pixels; `previous` is the frame before, if it is of the same motion.
    ///
    /// The motion hypotheses are compared on the coarsest level by the share of keyframe points
    /// that they explain; the best one is refined over the finer levels.
    pub(crate) fn track(&self, previous: Option<&Pyramid>) -> Tracked {
        let (config, prior) = (self.config, self.prior);
        let levels = &config.alignment;
        let level = levels.coarsest_level.min(self.reference.coarsest_level());
        let coarse = AlignmentConfig {
            coarsest_level: level,
            finest_level: level,
            ..levels.clone()
        };
        let refined = AlignmentConfig {
            coarsest_level: level.saturating_sub(1).max(levels.finest_level),
            ..levels.clone()
        };
        let attempt = |frame_from_last: &Se3| {
            let last = &prior.last_from_keyframe;
            let start = Motion {
                frame_from_keyframe: *frame_from_last * last.frame_from_keyframe,
                ..*last
            };
            self.align(&start, &coarse)
        };
        let mut best = attempt(&prior.frame_from_last);
        if config.motion_hypotheses && !explains(&best) {
            let rotation = previous.and_then(|previous| self.align_rotation(previous));
            let rotation = rotation.unwrap_or_else(Se3::identity);
            for hypothesis in hypotheses(&prior.frame_from_last, &rotation) {
                let candidate = attempt(&hypothesis);
                if candidate.good_share > best.good_share {
                    best = candidate;
                }
                if explains(&best) {
                    break;
                }
            }
        }
        let mut alignment = self.align(&best.motion, &refined);
        if config.motion_hypotheses && is_weak(&alignment, prior, config) {
            alignment = better(alignment, self.polish(&prior.motion()));
        }
        let (state, reason) = judge(&alignment, config);
        Tracked {
            is_beyond_gate: self.is_beyond_gate(&alignment.motion),
            has_other_gain: has_other_gain(&alignment, prior),
            alignment,
            support: Support::None,
            state,
            reason,
        }
    }

    /// Whether the camera cannot have come to a pose; it can where its motion is not followed.
    fn is_beyond_gate(&self, motion: &Motion) -> bool {
        self.config.motion_hypotheses && self.prior.is_beyond_gate(motion)
    }

    fn align(&self, start: &Motion, config: &AlignmentConfig) -> Alignment {
        let target = &self.frame.target;
        align(self.reference, target, start, Freedom::Rigid, config)
    }

    /// Alignment on the two finest levels.
    fn polish(&self, start: &Motion) -> Alignment {
        let config = &self.config.alignment;
        let settings = AlignmentConfig {
            coarsest_level: (config.finest_level + 1).min(config.coarsest_level),
            ..config.clone()
        };
        self.align(start, &settings)
    }

    /// Rotation between the last frame and this one, from all pixels of a coarse level at infinity.
    fn align_rotation(&self, previous: &Pyramid) -> Option<Se3> {
        let target = &self.frame.target;
        let level = target.coarsest_level().min(previous.num_levels() - 1);
        let reference = Reference::at_infinity(previous, &self.setup.pinhole, level);
        let settings = AlignmentConfig {
            coarsest_level: level,
            finest_level: level,
            max_points: 0,
            ..self.config.alignment.clone()
        };
        let turn = Se3::new(self.prior.frame_from_last.rotation, Vec3::zeros());
        let start = Motion::from_pose(turn);
        let found = align(&reference, target, &start, Freedom::Rotation, &settings);
        let turn = found.motion.frame_from_keyframe;
        (turn.is_finite() && found.good_of_visible > MIN_GOOD_OF_TURN).then_some(turn)
    }
}

fn has_other_gain(alignment: &Alignment, prior: &MotionPrior) -> bool {
    let change = alignment.motion.log_gain - prior.last_from_keyframe.log_gain;
    change.abs() > SURPRISING_LOG_GAIN
}

/// Whether a coarse alignment is good enough to stop looking for a better start.
fn explains(alignment: &Alignment) -> bool {
    alignment.good_of_visible >= ACCEPT_GOOD_OF_VISIBLE
        && alignment.visible_share >= ACCEPT_VISIBLE_SHARE
}

/// Alternatives to the constant motion, likeliest first: the rotation that aligns the images, no
/// motion, double, half, and small rotations around the prior in each direction.
fn hypotheses(frame_from_last: &Se3, rotation: &Se3) -> Vec<Se3> {
    let twist = frame_from_last.log();
    let mut out = vec![
        Se3::new(rotation.rotation, frame_from_last.translation),
        Se3::identity(),
        Se3::new(rotation.rotation, Vec3::zeros()),
        Se3::exp(&(twist * 2.0)),
        Se3::exp(&(twist * 0.5)),
    ];
    for radius in GUESSED_TURNS {
        for x in [-1.0, 0.0, 1.0] {
            for y in [-1.0, 0.0, 1.0] {
                for z in [-1.0, 0.0, 1.0] {
                    let w = Vec3::new(x, y, z) * radius;
                    if w.norm_squared() > 0.0 {
                        let turn = Se3::new(rotation_exp(&w), Vec3::zeros());
                        out.push(turn * *frame_from_last);
                    }
                }
            }
        }
    }
    out
}

/// Good, degraded or lost, with the reason.
fn judge(alignment: &Alignment, config: &TrackingConfig) -> (TrackingState, Option<LostReason>) {
    let lost = |reason| (TrackingState::Lost, Some(reason));
    if alignment.num_points < MIN_POINTS.max(config.min_holding_points) {
        return lost(LostReason::NoTexture);
    }
    if !alignment.motion.frame_from_keyframe.is_finite() {
        return lost(LostReason::Jump);
    }
    if alignment.visible_share < config.min_visible_share
        || alignment.good_share < config.min_good_share
    {
        return lost(LostReason::NoOverlap);
    }
    // A covered lens: gain and bias alone would explain a picture without contrast.
    let Some(correlation) = alignment.correlation else {
        return lost(LostReason::NoTexture);
    };
    if correlation < config.min_correlation
        || alignment.good_of_visible < config.min_good_of_visible
    {
        return lost(LostReason::Residuals);
    }
    if alignment.good_of_visible < config.degraded_good_of_visible {
        return (TrackingState::Degraded, Some(LostReason::Residuals));
    }
    (TrackingState::Good, None)
}

/// Whether a pose may be believed right after a loss or with degraded residuals, when nothing says
/// that the camera is near its last place: a picture of another place can be "explained" by little
/// contrast and little overlap.
pub(crate) fn is_convincing(
    alignment: &Alignment,
    was_lost: bool,
    config: &TrackingConfig,
) -> bool {
    alignment.correlation.unwrap_or(0.0) >= config.return_correlation
        && (!was_lost || alignment.good_of_visible >= config.return_good_of_visible)
        && alignment.usage >= config.return_usage
        && alignment.motion.log_gain.abs() <= config.return_max_log_gain
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Of a frame that shows all points where they should be.
    pub(crate) fn perfect(num_points: usize) -> Alignment {
        Alignment {
            motion: Motion::from_pose(Se3::identity()),
            residual_rms: 2.0,
            mean_cost: 1.0,
            good_share: 1.0,
            good_of_visible: 1.0,
            visible_share: 1.0,
            usage: 1.0,
            correlation: Some(1.0),
            num_points,
            covariance: None,
            iterations: 5,
        }
    }

    #[test]
    fn what_too_few_points_agree_on_is_lost() {
        let (usual, thesis) = (TrackingConfig::default(), TrackingConfig::thesis());
        let state = |num_points, config| judge(&perfect(num_points), config).0;
        let least = usual.min_holding_points;
        assert_eq!(state(least, &usual), TrackingState::Good);
        assert_eq!(state(least - 1, &usual), TrackingState::Lost);
        assert_eq!(state(MIN_POINTS, &thesis), TrackingState::Good);
        assert_eq!(state(MIN_POINTS - 1, &thesis), TrackingState::Lost);
    }
}
