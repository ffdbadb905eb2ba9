//! Whether the pose of a frame is to be doubted although nothing about the frame alone says so.
//!
//! Where little but a plain wall is in view, turning and moving sideways look alike: the camera
//! slides, what comes into view gets its depth from wrong poses, and frames agree less and less
//! with keyframes that were made of them, each by itself well enough to be believed. Before they
//! disagree, the little that is in view holds the pose less than is usual.

use crate::median::median;
use crate::policy::{Hold, doubt_about};
use crate::{LostReason, TrackingConfig};
use monogrid_alignment::Alignment;
use monogrid_geometry::Mat6;
use std::collections::VecDeque;

/// Frames that say what is usual, at most.
const MAX_FRAMES: usize = 200;
/// At least for residuals: frames on the first keyframe agree with it better than any later ones.
const MIN_RESIDUALS: usize = 100;
/// At least for standard deviations.
const MIN_SIGMAS: usize = 50;

/// How well the last frames held on to their keyframes.
#[derive(Debug, Default)]
pub(super) struct Doubt {
    last: VecDeque<Hold>,
    /// Why one of the last frames was doubted, and the frames for which that doubt lasts.
    lasting: Option<(LostReason, usize)>,
}

impl Doubt {
    /// Why a frame with this alignment is to be doubted after those before it, if it is.
    pub(super) fn judge(
        &mut self,
        alignment: &Alignment,
        config: &TrackingConfig,
    ) -> Option<LostReason> {
        let frame = Hold {
            residual_rms: f64::from(alignment.residual_rms),
            sigma: alignment.covariance.as_ref().map_or(f64::INFINITY, sigma),
        };
        let usual_residual_rms = self.usual(MIN_RESIDUALS, |hold| hold.residual_rms);
        let usual_sigma = self.usual(MIN_SIGMAS, |hold| hold.sigma);
        let doubt = doubt_about(&frame, usual_residual_rms, usual_sigma, config);
        // the first frames on a keyframe agree with it, whether it is right or not
        let lasting = match (doubt, self.lasting) {
            (Some(reason), _) => Some((reason, config.doubtful_frames)),
            (None, lasting) => lasting.map(|(reason, frames)| (reason, frames - 1)),
        };
        self.lasting = lasting.filter(|(_, frames)| *frames > 0);
        self.last.push_back(frame);
        if self.last.len() > MAX_FRAMES {
            self.last.pop_front();
        }
        self.lasting.map(|(reason, _)| reason)
    }

    /// Median over the last frames; `None` before there are enough.
    fn usual(&self, min_frames: usize, value: impl Fn(&Hold) -> f64) -> Option<f64> {
        if self.last.len() < min_frames {
            return None;
        }
        let mut values: Vec<f64> = self.last.iter().map(value).collect();
        median(&mut values)
    }
}

/// The largest standard deviation of a place or of an orientation, in its worst direction.
fn sigma(covariance: &Mat6) -> f64 {
    if !covariance.iter().all(|value| value.is_finite()) {
        return f64::INFINITY;
    }
    let worst = |first: usize| {
        let block = covariance.fixed_view::<3, 3>(first, first);
        block.symmetric_eigenvalues().max()
    };
    worst(0).max(worst(3)).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracker::tests::perfect;
    use monogrid_geometry::Vec6;

    fn config() -> TrackingConfig {
        TrackingConfig {
            doubtful_residual: 1.5,
            doubtful_sigma: 3.0,
            doubtful_frames: 3,
            ..TrackingConfig::default()
        }
    }

    /// Which frames are doubted, with these residuals and standard deviations.
    fn judged(frames: impl IntoIterator<Item = (f32, f64)>) -> Vec<Option<LostReason>> {
        let (mut doubt, config) = (Doubt::default(), config());
        let judge = |(residual_rms, sigma): (f32, f64)| {
            let alignment = Alignment {
                residual_rms,
                covariance: Some(Mat6::identity() * sigma.powi(2)),
                ..perfect(1000)
            };
            doubt.judge(&alignment, &config)
        };
        frames.into_iter().map(judge).collect()
    }

    #[test]
    fn a_frame_that_agrees_much_worse_than_others_is_doubted_and_so_are_some_after_it() {
        let mut residuals = vec![4.0; 130];
        residuals.extend([6.1, 4.0, 4.0, 4.0, 6.0]);
        let judged = judged(residuals.into_iter().map(|r| (r, 0.001)));
        assert!(judged[..130].iter().all(Option::is_none));
        let doubted = Some(LostReason::Doubtful);
        assert_eq!(judged[130..], [doubted, doubted, doubted, None, None]);
    }

    #[test]
    fn a_frame_that_holds_on_much_less_is_doubted_and_so_are_some_after_it() {
        let mut sigmas = vec![0.001; 60];
        sigmas.extend([0.0031, 0.001, 0.001, 0.001, 0.003]);
        let judged = judged(sigmas.into_iter().map(|sigma| (4.0, sigma)));
        assert!(judged[..60].iter().all(Option::is_none));
        let doubted = Some(LostReason::Loose);
        assert_eq!(judged[60..], [doubted, doubted, doubted, None, None]);
    }

    #[test]
    fn the_last_doubt_says_why() {
        let mut frames = vec![(4.0, 0.001); 130];
        frames.extend([(6.1, 0.001), (4.0, 0.0031), (4.0, 0.001)]);
        let reasons = [LostReason::Doubtful, LostReason::Loose, LostReason::Loose];
        assert_eq!(judged(frames)[130..], reasons.map(Some));
    }

    #[test]
    fn the_first_frames_say_nothing_of_what_is_usual() {
        let last = |frames: usize, last: (f32, f64)| {
            let frame = |k| if k + 1 == frames { last } else { (4.0, 0.001) };
            judged((0..frames).map(frame))[frames - 1]
        };
        assert_eq!(last(100, (40.0, 0.001)), None);
        assert_eq!(last(101, (40.0, 0.001)), Some(LostReason::Doubtful));
        assert_eq!(last(50, (4.0, 1.0)), None);
        assert_eq!(last(51, (4.0, 1.0)), Some(LostReason::Loose));
    }

    #[test]
    fn doubt_that_lasts_for_no_frame_is_none() {
        let config = TrackingConfig {
            doubtful_frames: 0,
            ..config()
        };
        let mut doubt = Doubt::default();
        for k in 0..101 {
            let alignment = Alignment {
                residual_rms: if k == 100 { 40.0 } else { 4.0 },
                covariance: Some(Mat6::identity()),
                ..perfect(1000)
            };
            assert_eq!(doubt.judge(&alignment, &config), None);
        }
    }

    #[test]
    fn what_lasts_becomes_usual() {
        let judged = judged((0..400).map(|k| (if k < 200 { 4.0 } else { 7.0 }, 0.001)));
        assert!(judged[200].is_some() && judged[299].is_some());
        assert_eq!(judged[399], None);
    }

    #[test]
    fn the_worst_direction_counts() {
        let variances = Vec6::new(1.0, 2.0, 9.0, 4.0, 1.0, 1.0);
        assert!((sigma(&Mat6::from_diagonal(&variances)) - 3.0).abs() < 1e-12);
        let turning = Vec6::new(1.0, 2.0, 3.0, 16.0, 1.0, 1.0);
        assert!((sigma(&Mat6::from_diagonal(&turning)) - 4.0).abs() < 1e-12);
        assert_eq!(sigma(&Mat6::repeat(f64::NAN)), f64::INFINITY);
    }
}
