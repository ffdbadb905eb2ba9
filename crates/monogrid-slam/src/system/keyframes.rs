//! Change of the keyframe: publish, propagate, adjust.

use super::depth::Successor;
use super::graph::Links;
use super::{Current, Slam};
use crate::depth_step::regularize;
use crate::frame::Frame;
use crate::graph::{GraphView, OdometryEdge};
use crate::node::{Exposure, Node};
use crate::report::milliseconds;
use crate::sparse::scale::{dense_links, keyframe_scale};
use crate::{DepthPixel, FragmentId, FrameReport, Keyframe, KeyframeId, MAIN_MAP, PoseSnapshot};
use monogrid_alignment::{Motion, Reference};
use monogrid_depth::{DepthMap, PixelFilter};
use monogrid_geometry::{Mat6, Se3};
use std::sync::Arc;
use std::time::Instant;

impl Slam {
    /// Publishes the current keyframe and goes on with another: one that shows the same, or `frame`.
    pub(super) fn leave_keyframe(
        &mut self,
        frame: &Frame,
        motion: &Motion,
        report: &mut FrameReport,
    ) {
        self.take_graph_update();
        if self.reactivate(frame, motion, report) {
            return;
        }
        if !self.is_frozen {
            self.change_keyframe(frame, motion, report);
        } else if let Some(current) = self.current.as_mut() {
            // there is no better keyframe; it is looked for again after a while
            current.num_mapped = 0;
        }
    }

    /// Publishes the current keyframe and lets `frame` take over; nothing happens when no depth can be
    /// handed on.
    fn change_keyframe(
        &mut self,
        frame: &Frame,
        motion: &Motion,
        report: &mut FrameReport,
    ) -> Option<()> {
        let successor = self.successor(&self.current.as_ref()?.depth, frame, motion)?;
        let unit = successor.unit;
        let (finished, view) = self.finish_current()?;
        report.finished_keyframe = Some(finished);
        report.created_keyframe = true;
        let newest = self.nodes.len() as KeyframeId;
        self.hand_over(frame.timestamp_ns, motion, newest, Se3::identity());
        self.begin_keyframe(frame, finished, motion, successor, view, report);
        if let Some(last) = self.last.as_mut() {
            last.motion = Motion::from_pose(Se3::identity());
            last.frame_from_previous.translation /= unit;
        }
        Some(())
    }

    /// Publishes the current keyframe; its identity and what the graph needs of it.
    pub(super) fn finish_current(&mut self) -> Option<(KeyframeId, Option<GraphView>)> {
        if self.is_frozen {
            let current = self.current.take()?;
            return Some((current.id, None));
        }
        let id = self.publish_current()?;
        let current = self.current.take()?;
        self.link_dense_depth(&current.depth, id as usize);
        if self.config.keyframes.reactivation.enabled || self.nodes[id as usize].depth.is_some() {
            self.nodes[id as usize].depth = Some(Arc::new(current.depth.packed()));
        }
        Some((id, self.graph_view(id, &current.depth)))
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
        let (world_from_keyframe, fragment) = (
            node.world_from_keyframe * parent_from_keyframe,
            node.fragment,
        );
        let exposure = node.exposure.then(motion.log_gain.exp(), motion.bias);
        self.push_node(frame, fragment, Some(parent), world_from_keyframe, exposure);
        let before_graph = Instant::now();
        self.adjust(&depth);
        let odometry = report.covariance.map(|covariance| OdometryEdge {
            parent,
            keyframe: self.nodes.len() as KeyframeId - 1,
            parent_from_keyframe,
            covariance: in_keyframe(&covariance, &keyframe_from_frame),
        });
        let links = Links {
            odometry,
            handover: None,
        };
        self.submit_graph_job(view, links, false);
        report.milliseconds.graph += milliseconds(before_graph);
        self.observe_old_keyframes(&mut depth);
        regularize(&mut depth, &self.config.depth);
        self.set_current(self.nodes.len() as KeyframeId - 1, depth);
    }

    /// Brings the newest keyframe into the sparse layer and takes over the adjusted poses and scales.
    pub(super) fn adjust(&mut self, depth: &DepthMap) {
        if !self.config.sparse.enabled {
            return;
        }
        let fragment = self.nodes.last().map_or(MAIN_MAP, |node| node.fragment);
        self.sparse_stats = self.sparse.add_keyframe(
            &self.nodes,
            &self.recent_in(fragment),
            depth,
            &self.pinhole,
            &self.mask,
            &self.config.sparse,
        );
        self.link_dense_depth(depth, self.nodes.len() - 1);
        let nodes = self.nodes.iter_mut().zip(&self.links);
        for (node, links) in nodes.filter(|(node, _)| node.fragment == fragment) {
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

    /// Adds a keyframe and its pose in the world of its fragment.
    pub(super) fn push_node(
        &mut self,
        frame: &Frame,
        fragment: FragmentId,
        parent: Option<KeyframeId>,
        world_from_keyframe: monogrid_geometry::Sim3,
        exposure: Exposure,
    ) {
        let id = self.nodes.len() as KeyframeId;
        let rank = self.num_keyframes_in(fragment) as u32;
        self.recent.push(id);
        self.nodes.push(Node {
            id,
            fragment,
            rank,
            parent,
            frame_index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            pyramid: Arc::new(frame.pyramid.clone()),
            world_from_keyframe,
            exposure,
            depth: None,
        });
        self.update_snapshot();
    }

    pub(super) fn update_snapshot(&mut self) {
        self.snapshot = Arc::new(PoseSnapshot {
            revision: self.snapshot.revision + 1,
            world_from_keyframe: self.nodes.iter().map(|n| n.world_from_keyframe).collect(),
            previous_from_keyframe_covariance: self.relative_covariance.clone(),
            fragment: self.nodes.iter().map(|n| n.fragment).collect(),
        });
    }

    pub(super) fn set_current(&mut self, id: KeyframeId, depth: DepthMap) {
        self.current = Some(Current {
            id,
            depth,
            reference: Reference::default(),
            num_mapped: 0,
        });
        self.refresh_reference();
    }

    /// Publishes depth and image of the current keyframe.
    pub(super) fn publish_current(&mut self) -> Option<KeyframeId> {
        let current = self.current.as_ref()?;
        let node = &self.nodes[current.id as usize];
        let publication = &self.config.publication;
        let filter = PixelFilter {
            min_validity: publication.min_validity,
            smoothed: publication.smoothed,
            ..PixelFilter::default()
        };
        let pixels: Vec<DepthPixel> = current
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
        let id = node.id;
        if let Some(known) = self.finished.get_mut(id as usize) {
            if is_worth_a_revision(&known.pixels, &pixels) {
                known.pixels = pixels;
                known.revision += 1;
            }
            return Some(id);
        }
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
        Some(id)
    }
}

/// Whether depth has become so much better that everybody should use it: a keyframe that is used again and
/// again would otherwise be published without end.
fn is_worth_a_revision(known: &[DepthPixel], better: &[DepthPixel]) -> bool {
    const MORE_PIXELS: f64 = 1.05;
    const LESS_VARIANCE: f64 = 0.9;
    let relative_variance = |pixels: &[DepthPixel]| {
        let mut all: Vec<f32> = pixels
            .iter()
            .map(|p| p.idepth_var / (p.idepth * p.idepth))
            .collect();
        let middle = all.len() / 2;
        if all.is_empty() {
            return f64::INFINITY;
        }
        f64::from(*all.select_nth_unstable_by(middle, f32::total_cmp).1)
    };
    better.len() as f64 > known.len() as f64 * MORE_PIXELS
        || relative_variance(better) < relative_variance(known) * LESS_VARIANCE
}

/// Covariance of `frame_from_keyframe` (left, in the frame) as that of its inverse (left, in the
/// keyframe).
pub(super) fn in_keyframe(covariance: &Mat6, keyframe_from_frame: &Se3) -> Mat6 {
    let adjoint = keyframe_from_frame.adjoint();
    adjoint * covariance * adjoint.transpose()
}
