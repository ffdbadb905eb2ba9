//! A map is kept at the end of a run, and a later run goes on with it.
//!
//! Depth is filtered anew from what was published, and places are learned from the images. Frames
//! are lost until one is recognised; from then on all is as after any loss, and a camera that
//! begins elsewhere starts a fragment. Keyframes without constraints (the earlier run was killed)
//! are held where they are. Where the map must not change (`is_frozen`), no keyframe is made,
//! refined or moved.

use super::depth::published_depth;
use crate::depth_step::tracking_samples;
use crate::graph::RestoredGraph;
use crate::map::{Map, MapKeyframe, Observation, SeenPoints, SparsePoint};
use crate::setup::Setup;
use crate::sparse::{dense_links, pixel_size};
use crate::store::Store;
use crate::stored::{
    ContinueError, StoredEdge, StoredKeyframe, StoredLink, StoredMap, StoredPoint,
};
use crate::view::{Exposure, View};
use crate::{FragmentId, KeptKeyframe, KeyframeId, Scale};
use monogrid_geometry::{Pinhole, Vec2};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A map as it is kept; `pinhole_of` says the camera of a keyframe.
pub(super) fn stored(map: &Map, pinhole_of: impl Fn(KeyframeId) -> Pinhole) -> StoredMap {
    let stored = |keyframe: &MapKeyframe| stored_keyframe(keyframe, pinhole_of(keyframe.id));
    StoredMap {
        scale: map.scale(),
        pose_revision: map.snapshot().revision,
        keyframes: map.keyframes().iter().filter_map(stored).collect(),
        edges: stored_edges(map),
        points: stored_points(map).collect(),
    }
}

pub(super) fn stored_edges(map: &Map) -> Vec<StoredEdge> {
    let count = map.num_published() as u64;
    let is_finished = |e: &&StoredEdge| e.edge.i.max(e.edge.j) < count;
    map.edges().iter().filter(is_finished).copied().collect()
}

pub(super) fn stored_link(keyframe: &MapKeyframe) -> StoredLink {
    StoredLink {
        id: keyframe.id,
        fragment: keyframe.fragment,
        world_from_keyframe: keyframe.world_from_keyframe,
        parent: keyframe.parent,
        gain: keyframe.exposure.gain,
        bias: keyframe.exposure.bias,
    }
}

pub(super) fn stored_points(map: &Map) -> impl Iterator<Item = StoredPoint> {
    let count = map.num_published();
    let is_finished = move |id: KeyframeId| (id as usize) < count;
    let points = map.points().iter();
    points
        .filter(move |point| point.alive && is_finished(point.host))
        .map(move |point| stored_point(point, is_finished))
}

fn stored_keyframe(keyframe: &MapKeyframe, pinhole: Pinhole) -> Option<StoredKeyframe> {
    Some(StoredKeyframe {
        keyframe: keyframe.published.as_ref()?.load()?,
        pinhole,
        fragment: keyframe.fragment,
        world_from_keyframe: keyframe.world_from_keyframe,
        parent: keyframe.parent,
        gain: keyframe.exposure.gain,
        bias: keyframe.exposure.bias,
    })
}

fn stored_point(point: &SparsePoint, is_finished: impl Fn(KeyframeId) -> bool) -> StoredPoint {
    let seen = point.observations.iter();
    let seen = seen.filter(|observation| is_finished(observation.keyframe));
    StoredPoint {
        host: point.host,
        pixel: point.pixel.into(),
        idepth: point.idepth,
        prior: [point.prior_idepth, point.prior_sigma],
        observations: seen.map(|o| (o.keyframe, o.pixel.into())).collect(),
    }
}

/// A map as it was kept, and its graph; `setup_of` has the settings and the camera for a keyframe.
pub(super) fn restored<'a>(
    setup_of: &dyn Fn(&StoredKeyframe) -> &'a Setup,
    store: &Store,
    map: StoredMap,
) -> Result<(Map, RestoredGraph), ContinueError> {
    let mut points = restored_points(&map);
    let seen = seen_points(&points, map.keyframes.len());
    let mut keyframes: Vec<MapKeyframe> = Vec::with_capacity(map.keyframes.len());
    let mut ranks: BTreeMap<FragmentId, u32> = BTreeMap::new();
    for (stored, seen) in map.keyframes.into_iter().zip(seen) {
        let rank = ranks.entry(stored.fragment).or_default();
        let (setup, seen) = (setup_of(&stored), (*rank, seen));
        let keyframe = restored_keyframe(setup, store, stored, seen, &points)?;
        if let Some(pyramid) = keyframe.pyramid() {
            for point in &mut points[keyframe.points.anchored.clone()] {
                point.pixel_size = pixel_size(&pyramid, &point.pixel);
            }
        }
        keyframes.push(keyframe);
        *rank += 1;
    }
    let views = keyframes.iter().filter_map(|k| k.view.clone()).collect();
    let (scale, revision) = (map.scale, map.pose_revision);
    let restored = Map::restored(store.clone(), keyframes, points, scale, revision);
    let graph = RestoredGraph {
        views,
        poses: Arc::clone(restored.snapshot()),
        edges: map.edges,
    };
    Ok((restored, graph))
}

/// The points of a map that make sense, by their hosts.
fn restored_points(map: &StoredMap) -> Vec<SparsePoint> {
    let is_usable = |point: &&StoredPoint| point.is_usable(&map.keyframes);
    let usable = map.points.iter().filter(is_usable);
    let seen = |(keyframe, pixel): &(KeyframeId, [f64; 2])| Observation {
        keyframe: *keyframe,
        pixel: Vec2::from(*pixel),
    };
    let mut points: Vec<SparsePoint> = usable
        .map(|point| SparsePoint {
            host: point.host,
            pixel: Vec2::from(point.pixel),
            idepth: point.idepth,
            prior_idepth: point.prior[0],
            prior_sigma: point.prior[1],
            // what a start in metres had
            is_measured: map.scale == Scale::Metric && point.host == 0,
            pixel_size: 1.0,
            observations: point.observations.iter().map(seen).collect(),
            alive: true,
        })
        .collect();
    points.sort_by_key(|point| point.host);
    points
}

/// The points that each keyframe sees, from points by their hosts.
fn seen_points(points: &[SparsePoint], num_keyframes: usize) -> Vec<SeenPoints> {
    let mut seen = vec![SeenPoints::default(); num_keyframes];
    let mut index = 0;
    for hosted in points.chunk_by(|a, b| a.host == b.host) {
        seen[hosted[0].host as usize].anchored = index..index + hosted.len();
        for point in hosted {
            for observation in &point.observations {
                seen[observation.keyframe as usize].others.push(index);
            }
            index += 1;
        }
    }
    seen
}

/// A keyframe of an earlier session.
fn restored_keyframe(
    setup: &Setup,
    store: &Store,
    stored: StoredKeyframe,
    (rank, mut seen): (u32, SeenPoints),
    points: &[SparsePoint],
) -> Result<MapKeyframe, ContinueError> {
    let id = stored.keyframe.id;
    let depth = published_depth(setup, &stored.keyframe).ok_or(ContinueError::Keyframe {
        id,
        what: "its image cannot carry depth",
    })?;
    if setup.config.sparse.enabled {
        seen.links = dense_links(points, &seen, id, &depth);
    }
    let exposure = Exposure {
        gain: stored.gain,
        bias: stored.bias,
    };
    let published = KeptKeyframe::new(store, stored.keyframe);
    let image = published.image.clone();
    Ok(MapKeyframe {
        id,
        fragment: stored.fragment,
        rank,
        parent: stored.parent,
        frame_index: published.frame_index,
        timestamp_ns: published.timestamp_ns,
        exposure,
        world_from_keyframe: stored.world_from_keyframe,
        camera_from_world: stored.world_from_keyframe.to_se3().inverse(),
        pose_sigma: None,
        covariance: None,
        measured: None,
        depth: Some(store.keep(depth.packed())),
        view: Some(Arc::new(View {
            id,
            camera: setup.camera(),
            image: image.clone(),
            samples: store.keep(tracking_samples(&depth, &setup.config.tracking)),
            exposure,
            has_converged: true,
        })),
        image,
        published: Some(published),
        points: seen,
    })
}
