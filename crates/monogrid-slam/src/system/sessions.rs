//! A map is kept at the end of a run, and a later run goes on with it.

use super::Slam;
use super::graph::GraphLink;
use crate::depth_step::tracking_samples;
use crate::graph::{GraphView, RestoredGraph};
use crate::node::{Exposure, Node};
use crate::sparse::{Observation, SparsePoint};
use crate::stored::{ContinueError, Purpose, StoredKeyframe, StoredMap, StoredPoint};
use crate::{KeyframeId, Scale, SlamConfig, SlamError, TrackedFrame};
use monogrid_geometry::{Pinhole, Vec2};
use monogrid_image::{Mask, Pyramid};
use std::sync::Arc;

impl Slam {
    /// A system that goes on with a map. Until the camera is recognised in it, frames are lost.
    ///
    /// # Errors
    /// As [`Slam::new`], and when the map is damaged, belongs to images of another size, or the settings keep
    /// places from being recognised.
    pub fn continue_from(
        config: SlamConfig,
        pinhole: Pinhole,
        mask: Mask,
        seed: u64,
        map: StoredMap,
        purpose: Purpose,
    ) -> Result<Self, SlamError> {
        map.check((mask.width(), mask.height()))?;
        if !(config.graph.enabled && config.graph.places.enabled) {
            return Err(ContinueError::NoPlaces.into());
        }
        let mut slam = Self::new(config, pinhole, mask, seed)?;
        slam.start = None;
        slam.is_frozen = purpose == Purpose::LocaliseOnly;
        slam.scale = map.scale;
        slam.restore_points(&map);
        let mut views = Vec::with_capacity(map.keyframes.len());
        for stored in map.keyframes {
            views.push(slam.restore_keyframe(stored)?);
        }
        let restored = RestoredGraph {
            views,
            world_from_keyframe: slam.nodes.iter().map(|n| n.world_from_keyframe).collect(),
            parents: slam.nodes.iter().map(|n| n.parent).collect(),
            fragments: slam.nodes.iter().map(|n| n.fragment).collect(),
            edges: map.edges,
        };
        slam.graph = GraphLink::continued(&slam.config, slam.pinhole, &slam.mask, restored)?;
        slam.update_snapshot();
        let snapshot = Arc::make_mut(&mut slam.snapshot);
        snapshot.revision = map.pose_revision.saturating_add(1);
        Ok(slam)
    }

    /// The map as [`Slam::continue_from`] takes it. Only finished keyframes are in it: call
    /// [`Slam::finish`] before.
    #[must_use]
    pub fn stored_map(&self) -> StoredMap {
        let count = self.finished.len();
        let is_finished = |id: KeyframeId| (id as usize) < count;
        let keyframes = self.finished.iter().zip(&self.nodes);
        let edges = self.graph.as_ref().map_or(&[][..], |link| link.edges());
        let points = self.sparse.points.iter().filter(|p| p.alive);
        StoredMap {
            scale: self.scale,
            pose_revision: self.snapshot.revision,
            keyframes: keyframes
                .map(|(keyframe, node)| StoredKeyframe {
                    keyframe: keyframe.clone(),
                    fragment: node.fragment,
                    world_from_keyframe: node.world_from_keyframe,
                    parent: node.parent,
                    gain: node.exposure.gain,
                    bias: node.exposure.bias,
                })
                .collect(),
            edges: edges
                .iter()
                .filter(|e| e.edge.i.max(e.edge.j) < count as u64)
                .copied()
                .collect(),
            points: points
                .filter(|point| is_finished(point.host))
                .map(|point| StoredPoint {
                    host: point.host,
                    pixel: point.pixel.into(),
                    idepth: point.idepth,
                    prior: [point.prior_idepth, point.prior_sigma],
                    observations: point
                        .observations
                        .iter()
                        .filter(|o| is_finished(o.keyframe))
                        .map(|o| (o.keyframe, o.pixel.into()))
                        .collect(),
                })
                .collect(),
        }
    }

    /// Frames with a believed pose in any fragment, relative to their keyframes, in the order of time.
    #[must_use]
    pub fn tracked_frames(&self) -> Vec<TrackedFrame> {
        let mut frames: Vec<TrackedFrame> = self
            .corrected_poses()
            .map(|(record, world_from_camera)| {
                let keyframe = self.visits[record.visit].keyframe;
                let node = &self.nodes[keyframe as usize];
                let relative =
                    node.world_from_keyframe.inverse() * world_from_camera.with_scale(1.0);
                TrackedFrame {
                    frame_index: record.frame_index,
                    timestamp_ns: record.timestamp_ns,
                    keyframe,
                    keyframe_from_frame: relative.to_se3(),
                }
            })
            .collect();
        frames.sort_by_key(|frame| (frame.timestamp_ns, frame.frame_index));
        frames
    }

    fn restore_points(&mut self, map: &StoredMap) {
        self.sparse.has_seed = map.scale == Scale::Metric;
        self.sparse.camera_from_world = map
            .keyframes
            .iter()
            .map(|stored| stored.world_from_keyframe.to_se3().inverse())
            .collect();
        let exists = |id: KeyframeId| (id as usize) < map.keyframes.len();
        let usable = map.points.iter().filter(|point| {
            let positive = |v: f64| v.is_finite() && v > 0.0;
            exists(point.host)
                && positive(point.idepth)
                && positive(point.prior[1])
                && point.observations.iter().all(|(id, _)| exists(*id))
        });
        self.sparse.points = usable
            .map(|point| SparsePoint {
                host: point.host,
                pixel: Vec2::from(point.pixel),
                idepth: point.idepth,
                prior_idepth: point.prior[0],
                prior_sigma: point.prior[1],
                observations: point
                    .observations
                    .iter()
                    .map(|(keyframe, pixel)| Observation {
                        keyframe: *keyframe,
                        pixel: Vec2::from(*pixel),
                    })
                    .collect(),
                alive: true,
            })
            .collect();
    }

    /// Adds a keyframe of an earlier session; what the graph needs of it.
    fn restore_keyframe(&mut self, stored: StoredKeyframe) -> Result<GraphView, ContinueError> {
        let keyframe = stored.keyframe;
        let id = keyframe.id;
        let image = keyframe.image.map(f32::from);
        let depth = self
            .published_depth(&keyframe)
            .ok_or(ContinueError::Keyframe {
                id,
                what: "its image cannot carry depth",
            })?;
        let exposure = Exposure {
            gain: stored.gain,
            bias: stored.bias,
        };
        let pyramid = Arc::new(Pyramid::new(image, super::NUM_LEVELS));
        self.restore_fragment(stored.fragment, &keyframe);
        let rank = self.num_keyframes_in(stored.fragment) as u32;
        self.nodes.push(Node {
            id,
            fragment: stored.fragment,
            rank,
            parent: stored.parent,
            frame_index: keyframe.frame_index,
            timestamp_ns: keyframe.timestamp_ns,
            pyramid: Arc::clone(&pyramid),
            world_from_keyframe: stored.world_from_keyframe,
            exposure,
            depth: Some(Arc::new(depth.packed())),
        });
        self.recent.push(id);
        self.link_dense_depth(&depth, id as usize);
        self.finished.push(keyframe);
        Ok(GraphView {
            id,
            pyramid,
            samples: tracking_samples(&depth, &self.config.tracking),
            exposure,
            is_settled: true,
        })
    }
}
