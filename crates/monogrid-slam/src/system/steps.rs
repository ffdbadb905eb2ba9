//! Steps that change the map or the state of tracking, used wherever a frame has led to them.

use super::camera::{Active, Known, Last};
use super::constrain::{GraphLink, graph_job};
use super::keyframes::finish_keyframe;
use super::lost::Loss;
use super::outcome::Attempt;
use super::slam::Slam;
use crate::KeyframeId;
use crate::frame::Frame;
use crate::graph::{GraphUpdate, Link};
use crate::map::{FinishedKeyframe, NUM_LEVELS, View};
use monogrid_alignment::Motion;
use monogrid_depth::DepthMap;
use monogrid_image::Pyramid;
use std::sync::Arc;

/// Last frames with a pose that are kept, in case that the camera is lost after them: a start that
/// shows them goes on in their map.
pub(super) const BRIDGE_FRAMES: usize = 8;

/// The keyframe that was in use.
pub(super) struct Left {
    pub id: KeyframeId,
    /// What the graph needs of it.
    pub view: Option<Arc<View>>,
}

impl Slam {
    /// Stores a believed pose and makes it the prior of the next frame.
    pub(super) fn believe(&mut self, frame: &Frame, motion: Motion) {
        let pose = motion.frame_from_keyframe;
        self.map.track(frame.index, frame.timestamp_ns, pose);
        self.camera.last = Some(Last::after(self.camera.last.as_ref(), frame, motion));
    }

    /// Keeps a frame with a pose in case that the camera is lost after it.
    pub(super) fn remember(&mut self, frame: &Frame, attempt: &Attempt) {
        self.camera.known.push_back(Known {
            frame_index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            pyramid: Arc::clone(&frame.pyramid),
            keyframe: attempt.keyframe,
            frame_from_keyframe: attempt.tracked.alignment.motion.frame_from_keyframe,
        });
        while self.camera.known.len() > BRIDGE_FRAMES {
            self.camera.known.pop_front();
        }
    }

    /// The camera has a pose again, on a keyframe.
    pub(super) fn end_loss(&mut self, keyframe: KeyframeId, is_recognised: bool) {
        if self.camera.lost_in_a_row > 0 {
            self.map.find(self.frame_index, keyframe, is_recognised);
        }
        self.camera.lost_in_a_row = 0;
        self.camera.loss = Loss::default();
    }

    /// Publishes the keyframe in use, which is in use no longer.
    pub(super) fn leave(&mut self) -> Option<Left> {
        let active = self.camera.active.take()?;
        let id = active.id;
        if self.setup.is_frozen {
            return Some(Left { id, view: None });
        }
        let finished = finish_keyframe(&self.setup, &self.map, &active);
        Some(self.leave_as(finished))
    }

    /// The same with what is to be published of it.
    pub(super) fn leave_as(&mut self, finished: FinishedKeyframe) -> Left {
        self.camera.active = None;
        let left = Left {
            id: finished.id,
            view: finished.view.clone(),
        };
        self.map.finish(finished);
        left
    }

    /// Makes a keyframe that was left the one in use again.
    pub(super) fn use_again(&mut self, id: KeyframeId, depth: DepthMap) {
        self.map.reactivate(id);
        self.activate(id, depth);
    }

    pub(super) fn activate(&mut self, id: KeyframeId, depth: DepthMap) {
        let pyramid = self.map[id].pyramid();
        let made_again = || Arc::new(Pyramid::new(depth.host().image.clone(), NUM_LEVELS));
        let pyramid = pyramid.unwrap_or_else(made_again);
        self.camera.active = Some(Active::new(&self.setup, id, pyramid, depth));
    }

    /// Gives the graph a finished keyframe and the poses as they are now.
    pub(super) fn constrain(&mut self, finished: Option<Arc<View>>, link: Link, is_final: bool) {
        if let Some(graph) = self.graph.as_mut().filter(|_| !self.setup.is_frozen) {
            graph.submit(graph_job(&self.setup, &self.map, finished, link, is_final));
        }
    }

    /// Takes over the result of the graph's job under way, waiting for it when it is not ready.
    pub(super) fn await_graph(&mut self) {
        let update = self.graph.as_mut().and_then(GraphLink::wait);
        self.follow_graph(update);
    }

    /// Takes over what the graph has found, if it has.
    pub(super) fn follow_graph(&mut self, update: Option<GraphUpdate>) {
        if let Some(update) = update {
            self.map.follow_graph(update, self.frame_index);
        }
    }
}
