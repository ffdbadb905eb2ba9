//! Start from two views: features are followed from reference frames until the camera has moved
//! sideways enough since one of them for a relative pose; then that becomes the first keyframe.
//!
//! Two views give a first pose only: views from all the time since the reference are adjusted
//! together with the points, and the start waits until their depths are certain. A new reference is
//! added when the camera has moved on, since features of the first get lost.

use crate::depth_step::{observe, regularize};
use crate::frame::{BufferedFrame, Frame};
use crate::median::median;
use crate::setup::Setup;
use crate::sparse::corner_settings;
use crate::start::Started;
use crate::tracker::MIN_POINTS;
use crate::{InitializationConfig, LostReason, SparseConfig};
use monogrid_depth::{DepthMap, StereoFrame};
use monogrid_features::{
    CornerConfig, Match, TrackConfig, TwoView, TwoViewConfig, TwoViewOutcome, detect_corners,
    track_points, two_view,
};
use monogrid_geometry::{Pinhole, Se3, Vec2};
use monogrid_graph::bundle::{
    AnchoredPoint, BundleConfig, BundleKeyframe, BundleProblem, CovarianceOf, Observation,
    PoseFreedom, adjust,
};
use monogrid_graph::{MapMatch, PoseOnlyConfig, refine_pose};
use monogrid_image::{Mask, Pyramid};
use std::sync::Arc;

/// Features followed since the reference frame.
#[derive(Debug)]
pub(crate) struct TwoViewStart {
    seed: u64,
    settings: InitializationConfig,
    /// Every frame since the first, or the newest of them.
    buffered: Vec<BufferedFrame>,
    /// Oldest first.
    references: Vec<Reference>,
    /// The last frame.
    last: Option<Arc<Pyramid>>,
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
    /// The views since the reference.
    views: Vec<View>,
}

/// Where the points were seen in one frame.
#[derive(Debug)]
struct View {
    /// Steps after the reference in the buffer.
    offset: usize,
    pixels: Vec<Option<Vec2>>,
}

impl TwoViewStart {
    pub(crate) fn new(settings: &InitializationConfig, seed: u64) -> Self {
        Self {
            seed,
            settings: settings.clone(),
            buffered: Vec::new(),
            references: Vec::new(),
            last: None,
        }
    }

    pub(crate) fn into_frames(self) -> Vec<BufferedFrame> {
        self.buffered
    }

    pub(crate) fn add_frame(
        &mut self,
        frame: Frame,
        setup: &Setup,
    ) -> Result<Box<Started>, LostReason> {
        self.buffer(&frame);
        let min_features = self.settings.min_features;
        let last = self.last.replace(Arc::clone(&frame.pyramid));
        for reference in &mut self.references {
            reference.follow(&frame);
            if let Some(last) = last.as_ref().filter(|_| reference.is_poor(min_features)) {
                reference.follow_from(last, &frame);
            }
        }
        self.references.retain(|r| r.num_followed() >= min_features);
        let mut reason = None;
        for at in 0..self.references.len() {
            match self.start_from(at, setup) {
                Ok(started) => return Ok(Box::new(started)),
                Err(refused) => reason = reason.or(Some(refused)),
            }
        }
        if self.needs_reference() {
            let corners = self.corners(&setup.pinhole, &setup.config.sparse);
            self.refer_to(frame, &setup.mask, &corners);
        }
        if self.references.is_empty() {
            return Err(LostReason::TooFewFeatures);
        }
        Err(reason.unwrap_or(LostReason::NotEnoughParallax))
    }

    /// A start from the views since one of the references.
    fn start_from(&mut self, at: usize, setup: &Setup) -> Result<Started, LostReason> {
        let reference = &self.references[at];
        if reference.displacement() < self.settings.min_displacement {
            return Err(LostReason::NotEnoughParallax);
        }
        let views = reference.solve(&setup.pinhole, self.seed, &self.settings)?;
        let started = self.first_keyframe(at, &views, setup);
        started.ok_or(LostReason::AmbiguousStart)
    }

    /// Keeps the newest frames, in eight bits.
    fn buffer(&mut self, frame: &Frame) {
        let mut kept = BufferedFrame::new(frame);
        // measured depth that was too little to start from
        kept.measured = None;
        self.buffered.push(kept);
        if self.buffered.len() <= self.settings.max_buffered_frames {
            return;
        }
        self.references.retain(|r| r.buffer_index > 0);
        self.buffered.remove(0);
        for reference in &mut self.references {
            reference.buffer_index -= 1;
        }
    }

    /// Whether another reference may do better: there is none, or the camera has moved on since the
    /// newest.
    fn needs_reference(&self) -> bool {
        let newest = self.references.last();
        newest.is_none_or(|r| r.displacement() >= self.settings.reference_displacement)
    }

    /// How the features of a reference are chosen. (From the first frame on, close ones make starts
    /// worse where there is enough to see.)
    fn corners(&self, pinhole: &Pinhole, sparse: &SparseConfig) -> CornerConfig {
        let close = corner_settings(self.settings.num_features, pinhole, sparse);
        if self.buffered.len() > self.settings.patient_frames {
            return close;
        }
        CornerConfig {
            min_distance_px: CornerConfig::default().min_distance_px,
            ..close
        }
    }

    /// Makes `frame` the newest reference if it shows enough features.
    fn refer_to(&mut self, frame: Frame, mask: &Mask, settings: &CornerConfig) {
        let corners = detect_corners(&frame.pyramid, Some(mask), &[], settings);
        let points: Vec<Vec2> = corners.iter().map(|corner| corner.pixel).collect();
        if points.len() < self.settings.min_features {
            return;
        }
        if self.references.len() >= MAX_REFERENCES {
            self.references.remove(0);
        }
        self.references.push(Reference {
            tracks: points.iter().map(|p| Some((*p, Vec2::zeros()))).collect(),
            points,
            frame,
            buffer_index: self.buffered.len() - 1,
            views: Vec::new(),
        });
    }

    /// Depth of the reference from the views; `None` when too few pixels get one.
    fn first_keyframe(&mut self, at: usize, views: &[PosedView], setup: &Setup) -> Option<Started> {
        let (reference, config) = (&self.references[at], &setup.config);
        let host = setup.host(reference.frame.image().clone())?;
        let mut depth = DepthMap::empty(host, &config.depth);
        // The longest baselines last: short ones find the place, long ones make it exact.
        for view in views {
            let buffered = self.buffered.get(reference.buffer_index + view.offset)?;
            let image = buffered.image();
            let baseline = view.frame_from_reference.translation.norm() as f32;
            let stereo = StereoFrame {
                image: &image,
                frame_from_keyframe: view.frame_from_reference,
                gain: 1.0,
                bias: 0.0,
                residual_rms: 5.0,
                pose_sigma_trans: 0.01 * baseline,
                pose_sigma_rot: 0.0005,
                id: view.offset as u32,
            };
            observe(&mut depth, &[stereo], &config.depth);
        }
        regularize(&mut depth, &config.depth);
        if depth.num_known() < MIN_POINTS {
            return None;
        }
        let first_step = views.first().map_or_else(Se3::identity, |view| {
            Se3::exp(&(view.frame_from_reference.log() / view.offset as f64))
        });
        let reference = self.references.swap_remove(at);
        let mut later = std::mem::take(&mut self.buffered);
        let before = reference.buffer_index.min(later.len() - 1);
        Some(Started {
            first_step,
            earlier: later.drain(..=before).take(before).collect(),
            later,
            ..Started::new(reference.frame, depth)
        })
    }
}

/// A view with its pose; the median depth of the points is 1.
#[derive(Clone, Copy, Debug)]
struct PosedView {
    offset: usize,
    frame_from_reference: Se3,
}

/// Views that are adjusted together at most.
const MAX_VIEWS: usize = 10;

/// A reference with fewer features than so many times the least is given up soon where the camera
/// moves ahead. Those that are not found by their patch in the reference any more are followed from
/// frame to frame, less exactly: where there are more, the start became worse by it.
const FEW_TIMES: usize = 3;

/// References in competition at most; the oldest gives way.
const MAX_REFERENCES: usize = 3;

impl Reference {
    /// Follows every point from the reference into `frame`, from where it was seen last.
    fn follow(&mut self, frame: &Frame) {
        let alive = (0..self.points.len()).filter_map(|i| Some((i, self.tracks[i]?)));
        let (alive, tracks): (Vec<usize>, Vec<(Vec2, Vec2)>) = alive.unzip();
        let points: Vec<Vec2> = alive.iter().map(|&i| self.points[i]).collect();
        let initial: Vec<Vec2> = tracks.iter().map(|(pixel, step)| pixel + step).collect();
        let (own, other, config) = (&self.frame.pyramid, &frame.pyramid, TrackConfig::default());
        let outcomes = track_points(own, other, &points, &initial, &config);
        for ((&i, (last, _)), outcome) in alive.iter().zip(&tracks).zip(&outcomes) {
            self.tracks[i] = outcome.pixel().map(|pixel| (pixel, pixel - last));
        }
        let offset = self.views.last().map_or(1, |view| view.offset + 1);
        self.views.push(View {
            offset,
            pixels: self.tracks.iter().map(|t| t.map(|(p, _)| p)).collect(),
        });
    }

    /// Follows those points from the last frame that are not found in `frame`, the newest view, by
    /// what they look like in the reference: a camera that moves ahead sees them grow.
    fn follow_from(&mut self, last: &Pyramid, frame: &Frame) {
        let [.., before, view] = &mut self.views[..] else {
            return;
        };
        let lost = (0..self.points.len()).filter(|&i| view.pixels[i].is_none());
        let (lost, points): (Vec<usize>, Vec<Vec2>) =
            lost.filter_map(|i| Some((i, before.pixels[i]?))).unzip();
        let config = TrackConfig::default();
        let outcomes = track_points(last, &frame.pyramid, &points, &points, &config);
        for ((&i, point), outcome) in lost.iter().zip(&points).zip(&outcomes) {
            if let Some(pixel) = outcome.pixel() {
                self.tracks[i] = Some((pixel, pixel - point));
                view.pixels[i] = Some(pixel);
            }
        }
    }

    /// Whether it will soon be given up where the camera moves ahead.
    fn is_poor(&self, min_features: usize) -> bool {
        self.points.len() < FEW_TIMES * min_features
    }

    fn num_followed(&self) -> usize {
        self.tracks.iter().flatten().count()
    }

    /// Median way of the features that are still followed, as a share of the image width.
    fn displacement(&self) -> f64 {
        let pairs = self.points.iter().zip(&self.tracks);
        let moves = pairs.filter_map(|(point, track)| Some(((*track)?.0 - point).norm()));
        let median = median(&mut moves.collect::<Vec<f64>>()).unwrap_or(0.0);
        median / self.frame.image().width() as f64
    }

    /// Poses of views since the reference: the last one from two views alone, then all of them and
    /// the points adjusted together. Refused while the depths remain uncertain.
    fn solve(
        &self,
        pinhole: &Pinhole,
        seed: u64,
        settings: &InitializationConfig,
    ) -> Result<Vec<PosedView>, LostReason> {
        let (indices, motion) = self.relative_pose(pinhole, seed)?;
        let points = indices.iter().zip(&motion.points);
        let points = points.filter_map(|(&i, point)| point.map(|p| (i, p.idepth)));
        let points: Vec<(usize, f64)> = points.filter(|(_, idepth)| *idepth > 0.0).collect();
        let step = self.views.len().div_ceil(MAX_VIEWS).max(1);
        // evenly spread, with the last one
        let chosen = self.views.iter().rev().step_by(step).rev();
        let last_offset = self.views.last().map(|view| view.offset);
        let mut views = Vec::with_capacity(chosen.len());
        let mut guess = Se3::identity();
        for view in chosen {
            if Some(view.offset) == last_offset {
                guess = motion.b_from_a;
            }
            guess = self.pose_of_view(view, &points, &guess, pinhole);
            views.push((view, guess));
        }
        self.adjust_views(&views, &points, pinhole, settings)
    }

    /// Pose of a view from points with known depth.
    fn pose_of_view(
        &self,
        view: &View,
        points: &[(usize, f64)],
        guess: &Se3,
        pinhole: &Pinhole,
    ) -> Se3 {
        let matches: Vec<MapMatch> = points
            .iter()
            .filter_map(|&(i, idepth)| {
                Some(MapMatch {
                    point_in_world: pinhole.unproject(&self.points[i]) / idepth,
                    pixel: view.pixels[i]?,
                    inv_sigma_px: 1.0,
                })
            })
            .collect();
        refine_pose(guess, pinhole, &matches, &PoseOnlyConfig::default())
            .map_or(*guess, |solution| solution.camera_from_world)
    }

    /// Adjusts views and points; the median depth becomes 1.
    fn adjust_views(
        &self,
        views: &[(&View, Se3)],
        points: &[(usize, f64)],
        pinhole: &Pinhole,
        settings: &InitializationConfig,
    ) -> Result<Vec<PosedView>, LostReason> {
        let problem = self.bundle_problem(views, points, pinhole, settings.sigma_px);
        let bundle_config = BundleConfig {
            max_iterations: 20,
            covariance: CovarianceOf::PosesAndPoints,
            ..BundleConfig::default()
        };
        let solution = adjust(&problem, &bundle_config).map_err(|_| LostReason::AmbiguousStart)?;
        let variances = solution
            .covariance
            .as_ref()
            .map_or(&[][..], |c| c.inverse_depth_variances.as_slice());
        let pairs = solution.inverse_depths.iter().zip(variances);
        let relative = pairs.filter_map(|(d, v)| v.map(|v| v.sqrt() / d));
        let uncertainty = positive_median(relative.collect())?;
        if uncertainty > settings.max_relative_sigma {
            return Err(LostReason::NotEnoughParallax);
        }
        let scale = positive_median(solution.inverse_depths.clone())?;
        let poses = &solution.camera_from_world[1..];
        let posed = views.iter().zip(poses).map(|((view, _), pose)| PosedView {
            offset: view.offset,
            frame_from_reference: pose.stretched(scale),
        });
        Ok(posed.collect())
    }

    /// The reference fixed, the last view at a fixed distance from it.
    fn bundle_problem(
        &self,
        views: &[(&View, Se3)],
        points: &[(usize, f64)],
        pinhole: &Pinhole,
        sigma_px: f64,
    ) -> BundleProblem {
        let mut keyframes = vec![BundleKeyframe {
            camera_from_world: Se3::identity(),
            freedom: PoseFreedom::Fixed,
        }];
        keyframes.extend((1..).zip(views).map(|(k, (_, pose))| BundleKeyframe {
            camera_from_world: *pose,
            freedom: if k == views.len() {
                PoseFreedom::FixedDistance { to: 0 }
            } else {
                PoseFreedom::Free
            },
        }));
        let anchored = points.iter().map(|&(i, idepth)| AnchoredPoint {
            host: 0,
            pixel: self.points[i],
            inverse_depth: idepth,
            prior: None,
        });
        let mut observations = Vec::new();
        for (keyframe, (view, _)) in (1..).zip(views) {
            for (point, &(i, _)) in points.iter().enumerate() {
                if let Some(pixel) = view.pixels[i] {
                    observations.push(Observation {
                        keyframe,
                        point,
                        pixel,
                        inv_sigma_px: 1.0 / sigma_px,
                    });
                }
            }
        }
        BundleProblem {
            pinhole: *pinhole,
            keyframes,
            points: anchored.collect(),
            observations,
        }
    }

    /// Pose of the last view with the points that were followed there, if two views determine it.
    fn relative_pose(
        &self,
        pinhole: &Pinhole,
        seed: u64,
    ) -> Result<(Vec<usize>, TwoView), LostReason> {
        let tracks = self.points.iter().zip(&self.tracks).enumerate();
        let followed =
            tracks.filter_map(|(i, (a, track))| track.map(|(b, _)| (i, Match { a: *a, b })));
        let (indices, matches): (Vec<usize>, Vec<Match>) = followed.unzip();
        let config = TwoViewConfig {
            seed,
            ..TwoViewConfig::default()
        };
        match two_view(&matches, pinhole, &config) {
            TwoViewOutcome::Accepted(motion) => Ok((indices, *motion)),
            TwoViewOutcome::NotEnoughParallax { .. }
            | TwoViewOutcome::Uncertain { .. }
            | TwoViewOutcome::NoMotion { .. } => Err(LostReason::NotEnoughParallax),
            TwoViewOutcome::TooFewMatches { .. } => Err(LostReason::TooFewFeatures),
            TwoViewOutcome::Ambiguous { .. } => Err(LostReason::AmbiguousStart),
        }
    }
}

/// The median, where it is one of a positive quantity.
fn positive_median(mut values: Vec<f64>) -> Result<f64, LostReason> {
    let median = median(&mut values).filter(|m| m.is_finite() && *m > 0.0);
    median.ok_or(LostReason::AmbiguousStart)
}

#[cfg(test)]
mod tests;
