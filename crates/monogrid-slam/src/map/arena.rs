//! The keyframes with everything known about them, their points, and the frames tracked on them.

use super::events::Changes;
use super::frames::FrameLog;
use super::keyframe::MapKeyframe;
use super::parts::path_between;
use super::points::SparsePoint;
use crate::store::Store;
use crate::stored::StoredEdge;
use crate::{
    Bridge, Fragment, FragmentId, InFragment, KeptKeyframe, KeyframeId, MAIN_MAP, MapBytes,
    MapSize, PoseSnapshot, Scale,
};
use monogrid_geometry::Se3;
use std::collections::BTreeSet;
use std::ops::Index;
use std::sync::Arc;

/// The map. Keyframes have consecutive identities; points, consecutive indices, those of an older
/// host before those of a newer one.
#[derive(Debug, Default)]
pub(crate) struct Map {
    /// Images and depth of the keyframes, and what is old of the frames.
    pub(super) store: Store,
    pub(super) keyframes: Vec<MapKeyframe>,
    /// Of these, those of earlier sessions, which come first.
    num_restored: usize,
    /// All keyframes in the order in which tracking last used them, the newest at the end.
    pub(super) recent: Vec<KeyframeId>,
    pub(super) points: Vec<SparsePoint>,
    pub(super) frames: FrameLog,
    /// All but the main map, by identity.
    pub(super) fragments: Vec<Fragment>,
    /// What the main map was called while the camera ran, if not that.
    pub(super) exchanged: Option<FragmentId>,
    /// Losses after which the map went on, in the order of time.
    pub(super) bridges: Vec<Bridge>,
    /// Constraints between keyframes, as the graph has them.
    pub(super) edges: Vec<StoredEdge>,
    pub(super) scale: Scale,
    pub(super) snapshot: Arc<PoseSnapshot>,
    pub(super) counts: Counts,
    pub(super) changes: Changes,
}

/// How often something has happened.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Times that tracking was lost.
    pub lost_episodes: usize,
    /// Times that a lost camera was recognised.
    pub relocalisations: usize,
    /// Times that tracking went on with a keyframe that existed already.
    pub reactivations: usize,
    /// Bundle adjustments that failed.
    pub failed_adjustments: usize,
}

impl Index<KeyframeId> for Map {
    type Output = MapKeyframe;

    fn index(&self, id: KeyframeId) -> &MapKeyframe {
        &self.keyframes[id as usize]
    }
}

impl Map {
    /// A map without keyframes, whose images and depth a store keeps.
    pub(crate) fn new(store: Store) -> Self {
        Self {
            store,
            ..Self::default()
        }
    }

    /// The map of an earlier session: keyframes by identity, points by their hosts.
    pub(crate) fn restored(
        store: Store,
        keyframes: Vec<MapKeyframe>,
        points: Vec<SparsePoint>,
        scale: Scale,
        pose_revision: u64,
    ) -> Self {
        let mut map = Self {
            recent: keyframes.iter().map(|keyframe| keyframe.id).collect(),
            changes: Changes {
                finished: keyframes.iter().map(|keyframe| keyframe.id).collect(),
                ..Changes::default()
            },
            num_restored: keyframes.len(),
            keyframes,
            points,
            scale,
            ..Self::new(store)
        };
        for keyframe in &map.keyframes {
            let id = keyframe.fragment;
            if id != MAIN_MAP && map.fragments.iter().all(|f| f.id != id) {
                let fragment = Fragment::begun(id, keyframe.id, keyframe.frame_index);
                map.fragments.push(fragment);
            }
        }
        map.fragments.sort_by_key(|fragment| fragment.id);
        map.renew_snapshot(pose_revision.saturating_add(1));
        map
    }

    /// What keeps images and depth.
    pub(crate) fn store(&self) -> &Store {
        &self.store
    }

    /// All keyframes, by identity.
    pub(crate) fn keyframes(&self) -> &[MapKeyframe] {
        &self.keyframes
    }

    /// The number of keyframes, which is the identity of the next one.
    pub(crate) fn next_id(&self) -> KeyframeId {
        self.keyframes.len() as KeyframeId
    }

    pub(crate) fn get(&self, id: KeyframeId) -> Option<&MapKeyframe> {
        self.keyframes.get(id as usize)
    }

    /// The keyframe that was made last.
    pub(crate) fn newest(&self) -> Option<&MapKeyframe> {
        self.keyframes.last()
    }

    /// Finished keyframes as they are published, by identity.
    pub(crate) fn published(&self) -> impl Iterator<Item = KeptKeyframe> {
        let keyframes = self.keyframes.iter();
        keyframes.filter_map(|keyframe| keyframe.published.clone())
    }

    /// The number of finished keyframes.
    pub(crate) fn num_published(&self) -> usize {
        let finished = self.keyframes.iter().filter(|k| k.published.is_some());
        finished.count()
    }

    pub(crate) fn points(&self) -> &[SparsePoint] {
        &self.points
    }

    pub(crate) fn edges(&self) -> &[StoredEdge] {
        &self.edges
    }

    pub(crate) fn scale(&self) -> Scale {
        self.scale
    }

    /// Whether the unit of a fragment's world is the metre, as a depth camera measured it.
    pub(crate) fn is_metric(&self, fragment: FragmentId) -> bool {
        if fragment == MAIN_MAP {
            return self.scale == Scale::Metric;
        }
        let first = self.in_fragment(fragment).next();
        first.is_some_and(|keyframe| keyframe.measured.is_some())
    }

    /// The unit of a keyframe in metres, where the world of its fragment is in metres.
    pub(crate) fn metres(&self, id: KeyframeId) -> Option<f64> {
        let keyframe = &self[id];
        let is_metric = self.is_metric(keyframe.fragment);
        is_metric.then_some(keyframe.world_from_keyframe.scale)
    }

    pub(crate) fn snapshot(&self) -> &Arc<PoseSnapshot> {
        &self.snapshot
    }

    pub(crate) fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Keyframes of a fragment, by identity.
    pub(crate) fn in_fragment(&self, fragment: FragmentId) -> impl Iterator<Item = &MapKeyframe> {
        let all = self.keyframes.iter();
        all.filter(move |keyframe| keyframe.fragment == fragment)
    }

    pub(crate) fn num_keyframes_in(&self, fragment: FragmentId) -> usize {
        self.in_fragment(fragment).count()
    }

    /// The fragments in which this session has made keyframes.
    pub(crate) fn grown_fragments(&self) -> BTreeSet<FragmentId> {
        let made = self.keyframes.iter().skip(self.num_restored);
        made.map(|keyframe| keyframe.fragment).collect()
    }

    /// Keyframes of a fragment in the order in which they were used, the newest at the end.
    pub(crate) fn recent_in(&self, fragment: FragmentId) -> Vec<KeyframeId> {
        let is_inside = |id: &KeyframeId| self[*id].fragment == fragment;
        self.recent.iter().copied().filter(is_inside).collect()
    }

    /// Fragments that are not joined, without the main map.
    pub(crate) fn apart(&self) -> impl Iterator<Item = &Fragment> {
        self.fragments.iter().filter(|f| f.joined.is_none())
    }

    /// The identity of the next fragment.
    pub(crate) fn next_fragment(&self) -> FragmentId {
        1 + self.fragments.last().map_or(MAIN_MAP, |f| f.id)
    }

    /// The fragments other than the main map, by identity, with what they hold or held when they
    /// were joined.
    pub(crate) fn fragments(&self) -> Vec<Fragment> {
        let fragments = self.fragments.iter();
        fragments.map(|f| self.with_counts(f)).collect()
    }

    /// What the main map was called while the camera ran, if not that.
    pub(crate) fn exchanged(&self) -> Option<FragmentId> {
        self.exchanged
    }

    /// Whether it began with the map of an earlier session.
    pub(crate) fn is_restored(&self) -> bool {
        self.num_restored > 0
    }

    pub(crate) fn bridges(&self) -> &[Bridge] {
        &self.bridges
    }

    pub(super) fn with_counts(&self, fragment: &Fragment) -> Fragment {
        if fragment.joined.is_some() {
            return *fragment;
        }
        Fragment {
            keyframes: self.num_keyframes_in(fragment.id),
            frames: self.num_frames_in(fragment.id),
            ..*fragment
        }
    }

    /// Where a camera is that is known relative to a keyframe.
    pub(crate) fn locate(&self, keyframe: KeyframeId, frame_from_keyframe: &Se3) -> InFragment {
        let keyframe = &self[keyframe];
        InFragment {
            id: keyframe.fragment,
            fragment_from_camera: keyframe.world_from_camera(frame_from_keyframe),
        }
    }

    /// Steps from keyframe to keyframe along which tracking came from `a` to `b`, in either
    /// direction.
    pub(crate) fn steps_between(&self, a: KeyframeId, b: KeyframeId) -> u32 {
        let parent_of = |id: KeyframeId| self.get(id).and_then(|keyframe| keyframe.parent);
        path_between(parent_of, a, b).len().saturating_sub(1) as u32
    }

    /// What grows, and what that takes in memory.
    pub(crate) fn size(&self) -> MapSize {
        let kept = self.store.bytes();
        let points = self.points.iter().map(SparsePoint::bytes);
        let seen = self.keyframes.iter().map(|k| k.points.bytes());
        MapSize {
            keyframes: self.keyframes.len(),
            edges: self.edges.len(),
            points: self.points.len(),
            bytes: MapBytes {
                keyframes: kept.own,
                prepared: kept.derived,
                in_file: kept.file,
                points: points.chain(seen).sum(),
                frames: self.frames.bytes(),
            },
        }
    }

    /// Forgets what only more frames would need of keyframes.
    pub(crate) fn release(&mut self) {
        for keyframe in &mut self.keyframes {
            keyframe.depth = None;
            keyframe.view = None;
        }
    }

    /// Makes the poses known as they are now.
    pub(super) fn renew_snapshot(&mut self, revision: u64) {
        let keyframes = self.keyframes.iter();
        self.snapshot = Arc::new(PoseSnapshot {
            revision,
            world_from_keyframe: keyframes.clone().map(|k| k.world_from_keyframe).collect(),
            previous_from_keyframe_covariance: keyframes.clone().map(|k| k.covariance).collect(),
            parent: keyframes.clone().map(|k| k.parent).collect(),
            fragment: keyframes.map(|k| k.fragment).collect(),
        });
    }
}
