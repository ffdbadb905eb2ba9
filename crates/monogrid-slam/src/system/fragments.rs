//! A camera that stays lost starts a new fragment of the map, which is joined when it is recognised.
//!
//! Each fragment has a world of its own: the camera of its first keyframe. Everything that compares poses
//! (sparse layer, known views, graph) stays within one. What joins them is the recognition of places, in the
//! graph; the frames of a fragment follow their keyframes, so that the camera goes on as if nothing happened.

use super::Slam;
use crate::frame::Frame;
use crate::graph::Joined;
use crate::node::{Node, world_from_camera};
use crate::start::{Start, StartOutcome};
use crate::{
    Fragment, FragmentId, FrameReport, InFragment, Join, Keyframe, KeyframeId, MAIN_MAP,
    TrackingState,
};
use monogrid_geometry::Se3;
use monogrid_image::Pyramid;

/// What is done about a loss that lasts.
#[derive(Debug, Default)]
pub(super) struct Loss {
    /// Time of the last frame.
    last_ns: Option<i64>,
    /// Time of the loss in which the camera saw texture.
    textured_ns: i64,
    /// The fragment that is about to be started.
    start: Option<Start>,
}

/// A pause in the video longer than this does not count as time in which the place was not recognised.
const MAX_STEP_NS: i64 = 200_000_000;

impl Loss {
    fn count(&mut self, frame: &Frame) {
        let step = self
            .last_ns
            .map_or(0, |last| (frame.timestamp_ns - last).abs());
        self.last_ns = Some(frame.timestamp_ns);
        if has_texture(&frame.pyramid) {
            self.textured_ns += step.min(MAX_STEP_NS);
        }
    }
}

/// Whether enough of an image is not plain: in a covered or overexposed one no place can be recognised.
fn has_texture(pyramid: &Pyramid) -> bool {
    /// Level on which noise is averaged out.
    const LEVEL: usize = 2;
    /// Difference across two pixels, grey levels.
    const MIN_GRADIENT: f32 = 8.0;
    const MIN_SHARE: f64 = 0.01;
    let image = pyramid.level(LEVEL.min(pyramid.num_levels() - 1));
    let (width, height) = (image.width(), image.height());
    let mut textured = 0;
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let dx = image.at(x + 1, y) - image.at(x - 1, y);
            let dy = image.at(x, y + 1) - image.at(x, y - 1);
            textured += usize::from(dx.hypot(dy) >= MIN_GRADIENT);
        }
    }
    textured as f64 >= MIN_SHARE * (width * height) as f64
}

impl Slam {
    /// The fragments other than the main map, by identity.
    #[must_use]
    pub fn fragments(&self) -> Vec<Fragment> {
        let fragments = self.fragments.iter();
        fragments
            .map(|fragment| match fragment.joined {
                Some(_) => *fragment,
                None => self.with_counts(fragment),
            })
            .collect()
    }

    fn with_counts(&self, fragment: &Fragment) -> Fragment {
        let records = self.records.iter();
        Fragment {
            keyframes: self.num_keyframes_in(fragment.id),
            frames: records
                .filter(|record| self.fragment_of(record) == fragment.id)
                .count(),
            ..*fragment
        }
    }

    /// Identities of the fragments that are not joined, without the main map.
    pub(super) fn open_fragments(&self) -> Vec<FragmentId> {
        let open = self.fragments.iter().filter(|f| f.joined.is_none());
        open.map(|fragment| fragment.id).collect()
    }

    /// The fragment of the current keyframe.
    pub(super) fn current_fragment(&self) -> FragmentId {
        self.current_node().map_or(MAIN_MAP, |node| node.fragment)
    }

    /// Keyframes of a fragment in the order in which they were used, the newest at the end.
    pub(super) fn recent_in(&self, fragment: FragmentId) -> Vec<KeyframeId> {
        let is_inside = |id: &KeyframeId| self.nodes[*id as usize].fragment == fragment;
        self.recent.iter().copied().filter(is_inside).collect()
    }

    pub(super) fn num_keyframes_in(&self, fragment: FragmentId) -> usize {
        let nodes = self.nodes.iter();
        nodes.filter(|node| node.fragment == fragment).count()
    }

    /// Whether a keyframe is not one of the first after a random start.
    pub(super) fn is_settled(&self, node: &Node) -> bool {
        node.rank as usize >= self.config.keyframes.ramp_keyframes
    }

    /// Says where the camera is: in the main map, or in a fragment.
    pub(super) fn report_pose(&self, report: &mut FrameReport, frame_from_keyframe: &Se3) {
        let Some(node) = self.current_node() else {
            return;
        };
        let pose = world_from_camera(&node.world_from_keyframe, frame_from_keyframe);
        if node.fragment == MAIN_MAP {
            report.world_from_camera = Some(pose);
        } else {
            report.state = TrackingState::Fragment;
            report.fragment = Some(InFragment {
                id: node.fragment,
                fragment_from_camera: pose,
            });
        }
    }

    /// The camera has a pose again.
    pub(super) fn end_loss(&mut self) {
        self.lost_in_a_row = 0;
        self.loss = Loss::default();
    }

    /// Brings the start of a new fragment forward, where the loss has lasted long enough.
    pub(super) fn await_fragment(&mut self, frame: Frame, report: &mut FrameReport) {
        let config = &self.config.fragments;
        let can_be_joined = self.config.graph.enabled && self.config.graph.places.enabled;
        if !config.enabled || !can_be_joined || self.is_frozen {
            return;
        }
        self.loss.count(&frame);
        let lost_secs = self.loss.textured_ns as f64 * 1e-9;
        if lost_secs < config.min_lost_secs || self.open_fragments().len() >= config.max_apart {
            return;
        }
        let id = 1 + self.fragments.last().map_or(MAIN_MAP, |f| f.id);
        let seed = self.seed.wrapping_add(u64::from(id));
        let start = self.loss.start.take();
        let mut start = start.unwrap_or_else(|| Start::new(&self.config, seed));
        match start.add_frame(frame, None, &self.pinhole, &self.mask, &self.config) {
            StartOutcome::Waiting(_) => self.loss.start = Some(start),
            StartOutcome::Started(started) => {
                self.take_graph_update();
                self.end_loss();
                self.fragments.push(Fragment {
                    id,
                    first_keyframe: self.nodes.len() as KeyframeId,
                    first_frame: started.keyframe.index,
                    keyframes: 0,
                    frames: 0,
                    joined: None,
                });
                report.reason = None;
                self.begin_map(id, *started, report);
                report.started_fragment = Some(id);
            }
        }
    }

    /// A keyframe of an earlier session brings its fragment along.
    pub(super) fn restore_fragment(&mut self, id: FragmentId, keyframe: &Keyframe) {
        if id == MAIN_MAP || self.fragments.iter().any(|f| f.id == id) {
            return;
        }
        self.fragments.push(Fragment {
            id,
            first_keyframe: keyframe.id,
            first_frame: keyframe.frame_index,
            keyframes: 0,
            frames: 0,
            joined: None,
        });
        self.fragments.sort_by_key(|fragment| fragment.id);
    }

    /// Notes what the graph has joined, before the keyframes are told.
    pub(super) fn note_joined(&mut self, joined: &[Joined]) {
        for Joined { from, into } in joined {
            let Some(at) = self.fragments.iter().position(|f| f.id == *from) else {
                continue;
            };
            let frame = self.frame_index;
            self.fragments[at] = Fragment {
                joined: Some(Join { into: *into, frame }),
                ..self.with_counts(&self.fragments[at])
            };
        }
    }

    /// Tells which fragments of those that were open before are joined now.
    pub(super) fn report_joined(&self, before: &[FragmentId], report: &mut FrameReport) {
        let fragments = self.fragments.iter();
        report.joined_fragments = fragments
            .filter(|f| f.joined.is_some() && before.contains(&f.id))
            .map(|f| f.id)
            .collect();
    }
}
