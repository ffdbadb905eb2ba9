//! Start from two views: features are followed from a reference frame until the camera has moved
//! sideways enough for a relative pose; then the reference becomes the first keyframe.

use crate::depth_step::observe;
use crate::frame::{BufferedFrame, Frame};
use crate::start::{StartOutcome, Started, host_of};
use crate::{InitializationConfig, LostReason, Scale, SlamConfig};
use monogrid_depth::{DepthMap, StereoFrame};
use monogrid_features::{
    CornerConfig, Match, TrackConfig, TwoViewConfig, TwoViewOutcome, detect_corners, track_points,
    two_view,
};
use monogrid_geometry::{Pinhole, Se3, Vec2};
use monogrid_image::Mask;

/// Features followed since the reference frame.
#[derive(Debug)]
pub(crate) struct TwoViewStart {
    seed: u64,
    settings: InitializationConfig,
    /// Every frame since the first, or the newest `max_buffered_frames` of them.
    buffered: Vec<BufferedFrame>,
    reference: Option<Reference>,
}

#[derive(Debug)]
struct Reference {
    frame: Frame,
    /// Pixels in the reference.
    points: Vec<Vec2>,
    /// Where each point was seen last and by how much it had moved there; `None` when it was lost.
    tracks: Vec<Option<(Vec2, Vec2)>>,
    /// Position in the buffer.
    buffer_index: usize,
}

impl TwoViewStart {
    pub(crate) fn new(settings: &InitializationConfig, seed: u64) -> Self {
        Self {
            seed,
            settings: settings.clone(),
            buffered: Vec::new(),
            reference: None,
        }
    }

    pub(crate) fn add_frame(
        &mut self,
        frame: Frame,
        pinhole: &Pinhole,
        mask: &Mask,
        config: &SlamConfig,
    ) -> StartOutcome {
        self.buffer(&frame);
        let Some(reference) = self.reference.as_mut() else {
            return self.restart(frame, mask);
        };
        reference.follow(&frame);
        let num_followed = reference.tracks.iter().flatten().count();
        if num_followed < self.settings.min_features {
            return self.restart(frame, mask);
        }
        let displacement = reference.median_displacement();
        if displacement < self.settings.min_displacement * frame.image().width() as f64 {
            return StartOutcome::Waiting(LostReason::NotEnoughParallax);
        }
        match reference.relative_pose(pinhole, self.seed) {
            Err(reason) => StartOutcome::Waiting(reason),
            Ok(pose) => match self.first_keyframe(&frame, &pose, pinhole, mask, config) {
                Some(started) => StartOutcome::Started(Box::new(started)),
                None => StartOutcome::Waiting(LostReason::AmbiguousStart),
            },
        }
    }

    /// Keeps the newest frames, in eight bits.
    fn buffer(&mut self, frame: &Frame) {
        self.buffered.push(BufferedFrame::new(frame));
        let excess = self
            .buffered
            .len()
            .saturating_sub(self.settings.max_buffered_frames);
        let keep_from = match &mut self.reference {
            // the reference itself is never dropped: it moves to the front instead
            Some(reference) => {
                let dropped = excess.min(reference.buffer_index);
                reference.buffer_index -= dropped;
                dropped
            }
            None => excess,
        };
        self.buffered.drain(..keep_from);
        if self.buffered.len() > 2 * self.settings.max_buffered_frames {
            // a camera that stands still: forget what lies between
            self.reference = None;
            self.buffered.clear();
            self.buffered.push(BufferedFrame::new(frame));
        }
    }

    /// Makes `frame` the new reference.
    fn restart(&mut self, frame: Frame, mask: &Mask) -> StartOutcome {
        let corners = detect_corners(
            &frame.pyramid,
            Some(mask),
            &[],
            &CornerConfig {
                max_corners: self.settings.num_features,
                ..CornerConfig::default()
            },
        );
        let points: Vec<Vec2> = corners.iter().map(|corner| corner.pixel).collect();
        if points.len() < self.settings.min_features {
            self.reference = None;
            return StartOutcome::Waiting(LostReason::TooFewFeatures);
        }
        self.reference = Some(Reference {
            tracks: points.iter().map(|p| Some((*p, Vec2::zeros()))).collect(),
            points,
            frame,
            buffer_index: self.buffered.len() - 1,
        });
        StartOutcome::Waiting(LostReason::NotEnoughParallax)
    }

    /// Depth of the reference from the accepted second view; `None` when too few pixels get one.
    fn first_keyframe(
        &mut self,
        frame: &Frame,
        pose: &RelativePose,
        pinhole: &Pinhole,
        mask: &Mask,
        config: &SlamConfig,
    ) -> Option<Started> {
        let reference = self.reference.as_ref()?;
        let host = host_of(&reference.frame, pinhole, mask)?;
        let mut depth = DepthMap::empty(host, &config.depth);
        let stereo = StereoFrame {
            image: frame.image(),
            frame_from_keyframe: pose.frame_from_reference,
            gain: 1.0,
            bias: 0.0,
            residual_rms: 5.0,
            pose_sigma_trans: 0.01 * pose.frame_from_reference.translation.norm() as f32,
            pose_sigma_rot: 0.0005,
            id: frame.index as u32,
        };
        observe(&mut depth, &[stereo], &config.depth);
        depth.fill_holes(&config.depth);
        depth.regularize(&config.depth);
        if depth.num_known() < config.tracking.min_points {
            return None;
        }
        let reference = self.reference.take()?;
        let mut later = std::mem::take(&mut self.buffered);
        let mut earlier: Vec<BufferedFrame> =
            later.drain(..=reference.buffer_index.min(later.len() - 1)).collect();
        earlier.pop();
        Some(Started {
            keyframe: reference.frame,
            depth,
            world_scale: 1.0,
            scale: Scale::Arbitrary,
            earlier,
            later,
        })
    }
}

/// An accepted relative pose; the median depth of the points is 1.
#[derive(Debug)]
struct RelativePose {
    frame_from_reference: Se3,
}

impl Reference {
    /// Follows every point from the reference into `frame`, from where it was seen last.
    fn follow(&mut self, frame: &Frame) {
        let config = TrackConfig::default();
        let alive: Vec<usize> = (0..self.points.len())
            .filter(|&i| self.tracks[i].is_some())
            .collect();
        let points: Vec<Vec2> = alive.iter().map(|&i| self.points[i]).collect();
        let initial: Vec<Vec2> = alive
            .iter()
            .filter_map(|&i| self.tracks[i].map(|(pixel, step)| pixel + step))
            .collect();
        let outcomes = track_points(
            &self.frame.pyramid,
            &frame.pyramid,
            &points,
            &initial,
            &config,
        );
        for (&i, outcome) in alive.iter().zip(&outcomes) {
            self.tracks[i] = match (outcome.pixel(), self.tracks[i]) {
                (Some(pixel), Some((last, _))) => Some((pixel, pixel - last)),
                _ => None,
            };
        }
    }

    fn median_displacement(&self) -> f64 {
        let mut moves: Vec<f64> = self
            .points
            .iter()
            .zip(&self.tracks)
            .filter_map(|(point, track)| track.map(|(pixel, _)| (pixel - point).norm()))
            .collect();
        moves.sort_unstable_by(f64::total_cmp);
        moves.get(moves.len() / 2).copied().unwrap_or(0.0)
    }

    /// Pose of the last frame, if two views determine it.
    fn relative_pose(&self, pinhole: &Pinhole, seed: u64) -> Result<RelativePose, LostReason> {
        let matches: Vec<Match> = self
            .points
            .iter()
            .zip(&self.tracks)
            .filter_map(|(a, track)| track.map(|(b, _)| Match { a: *a, b }))
            .collect();
        let config = TwoViewConfig {
            seed,
            ..TwoViewConfig::default()
        };
        let motion = match two_view(&matches, pinhole, &config) {
            TwoViewOutcome::Accepted(motion) => motion,
            TwoViewOutcome::NotEnoughParallax { .. } => return Err(LostReason::NotEnoughParallax),
            TwoViewOutcome::TooFewMatches { .. } => return Err(LostReason::TooFewFeatures),
            _ => return Err(LostReason::AmbiguousStart),
        };
        let mut idepths: Vec<f64> = motion.points.iter().flatten().map(|p| p.idepth).collect();
        idepths.sort_unstable_by(f64::total_cmp);
        let median = idepths
            .get(idepths.len() / 2)
            .copied()
            .filter(|d| *d > 0.0)
            .ok_or(LostReason::AmbiguousStart)?;
        // Lengths grow by the median inverse depth: the median depth becomes 1.
        let mut frame_from_reference = motion.b_from_a;
        frame_from_reference.translation *= median;
        Ok(RelativePose {
            frame_from_reference,
        })
    }
}
