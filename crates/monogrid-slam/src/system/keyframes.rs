//! Change of the keyframe: publish, propagate, adjust.

use super::{Current, Slam, milliseconds};
use crate::depth_step::{observe, regularize, tracking_samples};
use crate::frame::Frame;
use crate::graph::{GraphView, OdometryEdge};
use crate::node::{Exposure, Node};
use crate::sparse::scale::{dense_links, keyframe_scale};
use crate::{DepthPixel, FrameReport, Keyframe, KeyframeId, PoseSnapshot};
use monogrid_alignment::{Motion, Reference};
use monogrid_depth::{DepthMap, HostFrame, PixelFilter, StereoFrame};
use monogrid_geometry::{Mat6, Se3};
use std::sync::Arc;
use std::time::Instant;

/// Depth that a new keyframe takes over.
pub(super) struct Successor {
    /// In the new keyframe's units.
    pub depth: DepthMap,
    /// The new keyframe's unit in its parent's units.
    pub unit: f64,
}

impl Slam {
    /// Publishes the current keyframe and lets `frame` take over; nothing happens when no depth can be
    /// handed on.
    pub(super) fn change_keyframe(
        &mut self,
        frame: &Frame,
        motion: &Motion,
        report: &mut FrameReport,
    ) -> Option<KeyframeId> {
        self.take_graph_update();
        let successor = self.successor(&self.current.as_ref()?.depth, frame, motion)?;
        let unit = successor.unit;
        let (finished, view) = self.finish_current()?;
        self.begin_keyframe(frame, finished, motion, successor, view, report);
        if let Some(last) = self.last.as_mut() {
            last.motion = Motion::from_pose(Se3::identity());
            last.frame_from_previous.translation /= unit;
        }
        Some(finished)
    }

    /// Publishes the current keyframe; its identity and what the graph needs of it.
    pub(super) fn finish_current(&mut self) -> Option<(KeyframeId, Option<GraphView>)> {
        let id = self.publish_current()?;
        let current = self.current.take()?;
        self.link_dense_depth(&current.depth, id as usize);
        Some((id, self.graph_view(&current.depth)))
    }

    /// Depth of a keyframe carried over to `frame`, in a unit that makes its median 1, and that unit in
    /// the keyframe's units; `None` when nothing arrives there.
    pub(super) fn successor(
        &self,
        depth: &DepthMap,
        frame: &Frame,
        motion: &Motion,
    ) -> Option<Successor> {
        let host =
            Arc::new(HostFrame::new(frame.image().clone(), self.mask.clone(), self.pinhole).ok()?);
        let (mut depth, _) = depth.propagate(host, &motion.frame_from_keyframe, &self.config.depth);
        let median_idepth = depth
            .median_idepth()
            .filter(|m| m.is_finite() && *m > 0.0)?;
        depth.rescale(1.0 / median_idepth);
        Some(Successor {
            depth,
            unit: 1.0 / f64::from(median_idepth),
        })
    }
    /// Makes `frame` the newest keyframe, on top of a parent that it was tracked on; `view` is the keyframe
    /// that was finished for it.
    pub(super) fn begin_keyframe(
        &mut self,
        frame: &Frame,
        parent: KeyframeId,
        motion: &Motion,
        successor: Successor,
        view: Option<GraphView>,
        report: &mut FrameReport,
    ) {
        let Successor { mut depth, unit } = successor;
        let keyframe_from_frame = motion.frame_from_keyframe.inverse();
        let parent_from_keyframe = keyframe_from_frame.with_scale(unit);
        let node = &self.nodes[parent as usize];
        let world_from_keyframe = node.world_from_keyframe * parent_from_keyframe;
        let exposure = node.exposure.then(motion.log_gain.exp(), motion.bias);
        self.push_node(frame, world_from_keyframe, exposure);
        let before_graph = Instant::now();
        self.adjust(&depth);
        let odometry = report.covariance.map(|covariance| OdometryEdge {
            parent,
            keyframe: self.nodes.len() as KeyframeId - 1,
            parent_from_keyframe,
            covariance: in_keyframe(&covariance, &keyframe_from_frame),
        });
        self.submit_graph_job(view, odometry, false);
        report.milliseconds.graph += milliseconds(before_graph);
        self.observe_old_keyframes(&mut depth);
        regularize(&mut depth, &self.config.depth);
        self.set_current(depth);
    }

    /// Brings the newest keyframe into the sparse layer and takes over the adjusted poses and scales.
    pub(super) fn adjust(&mut self, depth: &DepthMap) {
        if !self.config.sparse.enabled {
            return;
        }
        self.sparse_stats = self.sparse.add_keyframe(
            &self.nodes,
            depth,
            &self.pinhole,
            &self.mask,
            &self.config.sparse,
        );
        self.link_dense_depth(depth, self.nodes.len() - 1);
        for (node, links) in self.nodes.iter_mut().zip(&self.links) {
            let world_from_camera = self.sparse.camera_from_world[node.id as usize].inverse();
            let scale = keyframe_scale(&self.sparse, node.id, links, &self.pinhole)
                .unwrap_or(node.world_from_keyframe.scale);
            node.world_from_keyframe = world_from_camera.with_scale(scale);
        }
        self.update_snapshot();
    }

    /// Notes the dense depth at the points that a keyframe sees.
    pub(super) fn link_dense_depth(&mut self, depth: &DepthMap, keyframe: usize) {
        if !self.config.sparse.enabled {
            return;
        }
        self.links.resize(self.nodes.len(), Vec::new());
        self.links[keyframe] = dense_links(&self.sparse, keyframe as KeyframeId, depth);
    }

    /// Observes the newest keyframe's pixels in older keyframes with a useful baseline.
    pub(super) fn observe_old_keyframes(&self, depth: &mut DepthMap) {
        let config = &self.config.keyframes;
        let Some((node, older)) = self.nodes.split_last() else {
            return;
        };
        let frames: Vec<StereoFrame<'_>> = older
            .iter()
            .rev()
            .map(|other| (other, node.other_from_self(other)))
            .filter(|(_, pose)| pose.inverse().translation.norm() >= config.min_relative_baseline)
            .take(config.old_keyframes_observed)
            .map(|(other, pose)| {
                let (gain, bias) = node.exposure.relative(&other.exposure);
                StereoFrame {
                    image: other.pyramid.level(0),
                    frame_from_keyframe: pose,
                    gain: gain as f32,
                    bias: bias as f32,
                    residual_rms: 5.0,
                    pose_sigma_trans: 0.002,
                    pose_sigma_rot: 0.001,
                    id: other.frame_index as u32,
                }
            })
            .collect();
        if !frames.is_empty() {
            observe(depth, &frames, &self.config.depth);
        }
    }

    /// Adds a keyframe and its pose.
    pub(super) fn push_node(
        &mut self,
        frame: &Frame,
        world_from_keyframe: monogrid_geometry::Sim3,
        exposure: Exposure,
    ) {
        self.nodes.push(Node {
            id: self.nodes.len() as KeyframeId,
            frame_index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            pyramid: Arc::new(frame.pyramid.clone()),
            world_from_keyframe,
            exposure,
        });
        self.update_snapshot();
    }

    pub(super) fn update_snapshot(&mut self) {
        self.snapshot = Arc::new(PoseSnapshot {
            revision: self.snapshot.revision + 1,
            world_from_keyframe: self.nodes.iter().map(|n| n.world_from_keyframe).collect(),
            previous_from_keyframe_covariance: self.relative_covariance.clone(),
        });
    }

    pub(super) fn set_current(&mut self, depth: DepthMap) {
        self.current = Some(Current {
            depth,
            reference: Reference::default(),
            num_mapped: 0,
        });
        self.refresh_reference();
    }

    /// Rebuilds the points that frames are tracked on from the newest depth.
    pub(super) fn refresh_reference(&mut self) {
        let (Some(current), Some(node)) = (self.current.as_mut(), self.nodes.last()) else {
            return;
        };
        let config = &self.config.tracking;
        let samples = tracking_samples(&current.depth, config);
        current.reference = Reference::new(
            &node.pyramid,
            &self.pinhole,
            &samples,
            config.alignment.finest_level,
            config.alignment.coarsest_level,
        );
    }

    /// Publishes depth and image of the current keyframe.
    pub(super) fn publish_current(&mut self) -> Option<KeyframeId> {
        let current = self.current.as_ref()?;
        let node = self.nodes.last()?;
        let publication = &self.config.publication;
        let filter = PixelFilter {
            min_validity: publication.min_validity,
            smoothed: publication.smoothed,
            ..PixelFilter::default()
        };
        let pixels = current
            .depth
            .pixels(filter)
            .map(|p| DepthPixel {
                x: p.x,
                y: p.y,
                idepth: p.idepth,
                idepth_var: p.idepth_var * publication.sigma_factor.powi(2)
                    + (publication.relative_sigma * p.idepth).powi(2),
            })
            .collect();
        self.finished.push(Keyframe {
            id: node.id,
            frame_index: node.frame_index,
            timestamp_ns: node.timestamp_ns,
            revision: 0,
            image: node
                .pyramid
                .level(0)
                .map(|v| v.round().clamp(0.0, 255.0) as u8),
            pixels,
        });
        Some(node.id)
    }
}

/// Covariance of `frame_from_keyframe` (left, in the frame) as that of its inverse (left, in the
/// keyframe).
fn in_keyframe(covariance: &Mat6, keyframe_from_frame: &Se3) -> Mat6 {
    let adjoint = keyframe_from_frame.adjoint();
    adjoint * covariance * adjoint.transpose()
}
