//! Tracking goes on with a keyframe that exists already: where the camera stays in a known place, the number
//! of keyframes does not grow.

use super::Slam;
use super::graph::Links;
use super::keyframes::in_keyframe;
use crate::config::ReactivationConfig;
use crate::depth_step::tracking_samples;
use crate::frame::Frame;
use crate::graph::Handover;
use crate::node::Node;
use crate::policy::{KeyframeEvidence, keyframe_score};
use crate::report::milliseconds;
use crate::tracker::Tracked;
use crate::{FrameReport, KeyframeId, TrackingState};
use monogrid_alignment::{Alignment, Motion};
use monogrid_depth::DepthMap;
use monogrid_geometry::{Mat6, Se3, Sim3};
use std::time::Instant;

/// A keyframe that may show what the frame shows.
struct Candidate {
    id: KeyframeId,
    /// From the poses; translation in the candidate's units.
    frame_from_candidate: Se3,
    score: f64,
}

/// What a candidate must fulfil.
#[derive(Clone, Copy, Debug)]
struct Limits {
    score: f64,
    good_usage: f32,
    disagreement: f64,
}

/// A candidate that tracking confirms.
struct Confirmed {
    id: KeyframeId,
    depth: DepthMap,
    alignment: Alignment,
}

impl Slam {
    /// Looks for a keyframe that shows what the frame shows and on which it can be tracked, and goes on
    /// with that one; whether there was one.
    pub(super) fn reactivate(
        &mut self,
        frame: &Frame,
        motion: &Motion,
        report: &mut FrameReport,
    ) -> bool {
        let Some(confirmed) = self.find_known_view(frame, motion) else {
            return false;
        };
        let Some((left, view)) = self.finish_current() else {
            return false;
        };
        report.finished_keyframe = (!self.is_frozen).then_some(left);
        let begin = Instant::now();
        let handover = report.covariance.map(|covariance| {
            self.handover(
                (left, motion, &covariance),
                (confirmed.id, &confirmed.alignment),
            )
        });
        self.submit_graph_job(
            view,
            Links {
                odometry: None,
                handover,
            },
            false,
        );
        report.milliseconds.graph += milliseconds(begin);
        let found = confirmed.alignment.motion;
        self.hand_over(
            frame.timestamp_ns,
            motion,
            confirmed.id,
            found.frame_from_keyframe,
        );
        if let Some(last) = self.last.as_mut() {
            last.motion = found;
            let unit = |id: KeyframeId| self.nodes[id as usize].world_from_keyframe.scale;
            last.frame_from_previous.translation *= unit(left) / unit(confirmed.id);
        }
        self.use_again(confirmed.id, confirmed.depth);
        report.reactivated_keyframe = Some(confirmed.id);
        true
    }

    /// Makes a keyframe that was left the current one again.
    pub(super) fn use_again(&mut self, id: KeyframeId, depth: DepthMap) {
        self.recent.retain(|other| *other != id);
        self.recent.push(id);
        self.set_current(id, depth);
        self.reactivations += 1;
    }

    /// The closest keyframe on which the frame can be tracked to where the poses say that it is.
    fn find_known_view(&self, frame: &Frame, motion: &Motion) -> Option<Confirmed> {
        let config = &self.in_use();
        if !config.enabled {
            return None;
        }
        let current = self.current_node()?;
        let exposure = current.exposure.then(motion.log_gain.exp(), motion.bias);
        let (candidates, limits) = self.candidates(current, motion, config);
        candidates.into_iter().find_map(|candidate| {
            let node = &self.nodes[candidate.id as usize];
            let depth = self.stored_depth(candidate.id)?;
            let (gain, bias) = node.exposure.relative(&exposure);
            let predicted = Motion {
                log_gain: gain.ln(),
                bias,
                ..Motion::from_pose(candidate.frame_from_candidate)
            };
            let samples = tracking_samples(&depth, &self.config.tracking);
            let tracked = self.track_on_other(&node.pyramid, &samples, frame, predicted);
            self.confirms(&candidate, &tracked, limits)
                .then_some(Confirmed {
                    id: candidate.id,
                    depth,
                    alignment: tracked.alignment,
                })
        })
    }

    /// The settings; where no keyframe can be made, any closer one is better than none.
    fn in_use(&self) -> ReactivationConfig {
        let config = self.config.keyframes.reactivation.clone();
        if !self.is_frozen {
            return config;
        }
        ReactivationConfig {
            enabled: true,
            min_keyframes_between: 0,
            first_keyframe: 0,
            crowd: 1,
            ..config
        }
    }

    /// Keyframes that should show about the same as the frame, closest first, and what they must fulfil.
    fn candidates(
        &self,
        current: &Node,
        motion: &Motion,
        config: &ReactivationConfig,
    ) -> (Vec<Candidate>, Limits) {
        let keyframe_from_frame = Sim3::from(motion.frame_from_keyframe.inverse());
        let world_from_frame = current.world_from_keyframe * keyframe_from_frame;
        let width = self.mask.width() as f64;
        let field_of_view = 2.0 * (0.5 * width / self.pinhole.fx).atan();
        let recent = self.recent_in(current.fragment);
        let others = recent.iter().rev().skip(1 + config.min_keyframes_between);
        let mut candidates: Vec<Candidate> = others
            .filter(|id| self.nodes[**id as usize].rank >= config.first_keyframe)
            .filter_map(|id| {
                let node = &self.nodes[*id as usize];
                node.depth.as_ref()?;
                let candidate_from_frame = node.world_from_keyframe.inverse() * world_from_frame;
                let turned = candidate_from_frame.rotation.angle() / field_of_view;
                let evidence = KeyframeEvidence {
                    relative_distance: candidate_from_frame.translation.norm(),
                    usage: 1.0 - turned.min(1.0),
                    ..KeyframeEvidence::default()
                };
                let score = keyframe_score(&evidence, &self.config.keyframes);
                let pose = Se3::new(
                    candidate_from_frame.rotation,
                    candidate_from_frame.translation,
                );
                (score < config.max_predicted_score).then_some(Candidate {
                    id: *id,
                    frame_from_candidate: pose.inverse(),
                    score,
                })
            })
            .collect();
        candidates.sort_by(|a, b| a.score.total_cmp(&b.score).then(a.id.cmp(&b.id)));
        let limits = if candidates.len() >= config.crowd {
            candidates.truncate(config.crowd.max(config.max_candidates));
            Limits {
                score: config.crowded_max_score,
                good_usage: 0.0,
                disagreement: config.crowded_max_disagreement,
            }
        } else {
            candidates.truncate(config.max_candidates);
            Limits {
                score: config.max_score,
                good_usage: config.min_good_usage,
                disagreement: config.max_disagreement,
            }
        };
        (candidates, limits)
    }

    /// Whether a frame was tracked on a candidate as well as on a keyframe of its own, to where it was
    /// expected.
    fn confirms(&self, candidate: &Candidate, tracked: &Tracked, limits: Limits) -> bool {
        let alignment = &tracked.alignment;
        let found = &alignment.motion.frame_from_keyframe;
        let evidence = KeyframeEvidence {
            relative_distance: found.inverse().translation.norm(),
            usage: f64::from(alignment.usage),
            ..KeyframeEvidence::default()
        };
        let disagreement = *found * candidate.frame_from_candidate.inverse();
        tracked.state == TrackingState::Good
            && keyframe_score(&evidence, &self.config.keyframes) < limits.score
            && alignment.usage * alignment.good_of_visible >= limits.good_usage
            && disagreement.log().norm() <= limits.disagreement
    }

    /// What a frame that was tracked on two keyframes says about them.
    fn handover(
        &self,
        (left, motion, covariance): (KeyframeId, &Motion, &Mat6),
        (found, alignment): (KeyframeId, &Alignment),
    ) -> Handover {
        let side = |id: KeyframeId, motion: &Motion, covariance: &Mat6| {
            let keyframe_from_frame = motion.frame_from_keyframe.inverse();
            let scale = self.nodes[id as usize].world_from_keyframe.scale;
            let covariance = in_keyframe(covariance, &keyframe_from_frame);
            (id, keyframe_from_frame, scale, covariance)
        };
        let a = side(left, motion, covariance);
        let other = alignment.covariance.unwrap_or(*covariance);
        let b = side(found, &alignment.motion, &other);
        let (older, newer) = if a.0 < b.0 { (a, b) } else { (b, a) };
        // both see the same frame; lengths in units of the older
        let unit = newer.2 / older.2;
        let newer_from_frame = Se3::new(newer.1.rotation, newer.1.translation * unit);
        let rigid = older.1 * newer_from_frame.inverse();
        Handover {
            i: older.0,
            j: newer.0,
            i_from_j: rigid.with_scale(unit),
            covariance: older.3 + newer.3 * (unit * unit).max(1.0),
        }
    }
}
