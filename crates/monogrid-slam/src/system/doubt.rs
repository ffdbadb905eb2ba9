//! Whether the pose of a frame is to be doubted although nothing about the frame alone says so.
//!
//! Where little but a plain wall is in view, turning and moving sideways look alike: the camera slides, what comes into view gets
//! its depth from wrong poses, and frames agree less and less with keyframes that were made of them, each by itself well enough to
//! be believed.

use crate::TrackingConfig;
use crate::policy::is_doubtful;
use std::collections::VecDeque;

/// Frames that say what residuals are usual, at most and at least: those on the first keyframe agree with it better than any later ones.
const MAX_FRAMES: usize = 200;
const MIN_FRAMES: usize = 100;

/// How well the last frames agreed with their keyframes.
#[derive(Debug, Default)]
pub(super) struct Doubt {
    /// Root mean square residuals, grey levels.
    residuals: VecDeque<f32>,
    /// Frames for which a doubt lasts.
    remaining: usize,
}

impl Doubt {
    /// Whether a frame with this root mean square residual, grey levels, is to be doubted after those before it.
    pub(super) fn judge(&mut self, residual_rms: f32, config: &TrackingConfig) -> bool {
        if is_doubtful(residual_rms, self.usual(), config) {
            // the first frames on a keyframe agree with it, whether it is right or not
            self.remaining = config.doubtful_frames;
        } else {
            self.remaining = self.remaining.saturating_sub(1);
        }
        self.residuals.push_back(residual_rms);
        if self.residuals.len() > MAX_FRAMES {
            self.residuals.pop_front();
        }
        self.remaining > 0
    }

    /// Median of the last residuals, grey levels; `None` before there are enough.
    fn usual(&self) -> Option<f32> {
        let mut residuals: Vec<f32> = self.residuals.iter().copied().collect();
        if residuals.len() < MIN_FRAMES {
            return None;
        }
        let middle = residuals.len() / 2;
        let (_, median, _) = residuals.select_nth_unstable_by(middle, f32::total_cmp);
        Some(*median)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(residuals: impl IntoIterator<Item = f32>) -> Vec<bool> {
        let config = TrackingConfig {
            doubtful_residual: 1.5,
            doubtful_frames: 3,
            ..TrackingConfig::default()
        };
        let mut doubt = Doubt::default();
        let residuals = residuals.into_iter();
        residuals.map(|r| doubt.judge(r, &config)).collect()
    }

    #[test]
    fn a_frame_that_agrees_much_worse_than_others_is_doubted_and_so_are_some_after_it() {
        let mut residuals = vec![4.0; 130];
        residuals.extend([6.1, 4.0, 4.0, 4.0, 6.0]);
        let judged = judged(residuals);
        assert!(judged[..130].iter().all(|is_doubtful| !is_doubtful));
        assert_eq!(judged[130..], [true, true, true, false, false]);
    }

    #[test]
    fn the_first_frames_say_nothing_of_what_is_usual() {
        assert!(!judged((0..100).map(|k| if k == 99 { 40.0 } else { 4.0 }))[99]);
        assert!(judged((0..101).map(|k| if k == 100 { 40.0 } else { 4.0 }))[100]);
    }

    #[test]
    fn what_lasts_becomes_usual() {
        let judged = judged((0..400).map(|k| if k < 200 { 4.0 } else { 7.0 }));
        assert!(judged[200] && judged[299]);
        assert!(!judged[399]);
    }
}
