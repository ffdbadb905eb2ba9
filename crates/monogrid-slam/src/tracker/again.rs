//! A second alignment, from where the motion leads, for frames that the first one explains badly.
//!
//! Alignment begins on a coarse level, where what is left of a keyframe at the border of the image
//! is a few pixels wide: before a plain wall it slides off with them, from a prediction that was
//! right. The finest levels alone do not.

use super::{MotionPrior, has_other_gain, judge};
use crate::{TrackingConfig, TrackingState};
use monogrid_alignment::Alignment;

/// Aligned again on the two finest levels, from where the motion of the last frames leads, where
/// the grey values correlate less than this, the pose is a surprise, or it is not good; taken if
/// they correlate at least so well there, and it explains more. Only with `motion_hypotheses`.
const RETRY_CORRELATION: f64 = 0.8;

/// Whether another start may explain a frame better.
pub(super) fn is_weak(alignment: &Alignment, prior: &MotionPrior, config: &TrackingConfig) -> bool {
    let (state, _) = judge(alignment, config);
    state != TrackingState::Good
        || prior.is_beyond_gate(&alignment.motion)
        || has_other_gain(alignment, prior)
        || alignment.correlation.unwrap_or(0.0) < RETRY_CORRELATION
}

/// The second of two alignments of a frame if it agrees well and explains more than the first. (In
/// noise no alignment agrees well, and those that were right to be refused at a start would be let
/// in.)
pub(super) fn better(first: Alignment, second: Alignment) -> Alignment {
    let is_better = second.motion.frame_from_keyframe.is_finite()
        && second.correlation.unwrap_or(0.0) >= RETRY_CORRELATION
        && explained(&second) > MIN_TIMES_BETTER * explained(&first);
    if is_better { second } else { first }
}

/// How much an alignment explains: the share of all points that are where they should be, by how
/// well their grey values agree. Residuals count in the contrast of the keyframe, since a small
/// gain makes all of them small.
fn explained(alignment: &Alignment) -> f64 {
    let residual = f64::from(alignment.residual_rms / alignment.gain()).max(MIN_RESIDUAL);
    f64::from(alignment.good_share) * alignment.correlation.unwrap_or(0.0) / residual
}

/// Where a shutter rolls two alignments differ by less without one of them having slid, and the
/// first has seen more levels.
const MIN_TIMES_BETTER: f64 = 1.25;

/// Smaller residuals say nothing, grey levels.
const MIN_RESIDUAL: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::super::prior::FIRST_GATE;
    use super::super::tests::perfect;
    use super::*;
    use monogrid_alignment::Motion;
    use monogrid_geometry::{Se3, Vec3};

    fn still() -> MotionPrior {
        MotionPrior::at(Motion::from_pose(Se3::identity()))
    }

    #[test]
    fn a_frame_is_aligned_again_where_it_is_not_good_or_surprising_or_agrees_badly() {
        let config = TrackingConfig::default();
        let is_weak = |a: &Alignment| is_weak(a, &still(), &config);
        assert!(!is_weak(&perfect(1000)));
        assert!(is_weak(&perfect(config.min_holding_points - 1)));
        let moved = Se3::new(
            Se3::identity().rotation,
            Vec3::new(2.0 * FIRST_GATE, 0.0, 0.0),
        );
        assert!(is_weak(&Alignment {
            motion: Motion::from_pose(moved),
            ..perfect(1000)
        }));
        let correlated = |correlation| Alignment {
            correlation,
            ..perfect(1000)
        };
        assert!(is_weak(&correlated(Some(RETRY_CORRELATION - 0.01))));
        assert!(!is_weak(&correlated(Some(RETRY_CORRELATION + 0.01))));
        assert!(is_weak(&correlated(None)));
    }

    /// Numbers of the frame of the stairs at which alignment slid off the door that left the view.
    #[test]
    fn few_points_that_agree_are_worth_more_than_many_that_do_not() {
        let few = Alignment {
            good_share: 0.4,
            residual_rms: 2.8,
            correlation: Some(0.99),
            ..perfect(1600)
        };
        let slid = Alignment {
            good_share: 0.96,
            residual_rms: 10.0,
            correlation: Some(0.78),
            ..perfect(1600)
        };
        let mut dim = Alignment {
            good_share: 0.93,
            residual_rms: 3.5,
            correlation: Some(0.75),
            ..perfect(1600)
        };
        dim.motion.log_gain = -1.23;
        for wrong in [slid, dim] {
            assert_eq!(better(wrong.clone(), few.clone()).residual_rms, 2.8);
            assert_eq!(better(few.clone(), wrong).residual_rms, 2.8);
        }
    }

    #[test]
    fn what_agrees_badly_is_not_taken_however_much_better_it_is() {
        let noisy = |correlation, residual_rms| Alignment {
            correlation: Some(correlation),
            residual_rms,
            ..perfect(2800)
        };
        let chosen = |second| better(noisy(0.32, 28.0), second).residual_rms;
        let least = RETRY_CORRELATION;
        assert_eq!(chosen(noisy(least - 0.01, 14.0)), 28.0);
        assert_eq!(chosen(noisy(least + 0.01, 14.0)), 14.0);
    }

    #[test]
    fn a_little_better_is_not_enough() {
        let with = |residual_rms| Alignment {
            residual_rms,
            ..perfect(2800)
        };
        assert_eq!(better(with(6.0), with(5.0)).residual_rms, 6.0);
        assert_eq!(better(with(6.0), with(4.0)).residual_rms, 4.0);
    }

    #[test]
    fn the_first_stays_where_the_second_is_no_better_or_no_motion() {
        let first = Alignment {
            iterations: 1,
            ..perfect(1000)
        };
        let second = perfect(1000);
        assert_eq!(better(first.clone(), second).iterations, 1);
        let mut lost = Alignment {
            residual_rms: 0.5,
            ..perfect(1000)
        };
        lost.motion.frame_from_keyframe.translation.x = f64::NAN;
        assert_eq!(better(first, lost).iterations, 1);
    }
}
