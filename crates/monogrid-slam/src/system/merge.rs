//! Maps of several runs as one, as far as they show the same places.
//!
//! A keyframe has its camera with it in the graph, in the memory of places, in scans and in
//! recordings, so that runs may have different ones. Tracking, the depth filter and the sparse
//! layer know one camera, so a map of several cannot be continued.

use super::points::adjust_whole;
use super::sessions::{restored, stored};
use crate::KeyframeCamera;
use crate::graph::{GraphJob, KeyframeGraph};
use crate::setup::Setup;
use crate::sparse::shared_points;
use crate::store::Store;
use crate::stored::{ContinueError, StoredKeyframe, StoredMap, StoredPoint};
use crate::{DepthPixel, FragmentId, KeyframeId, Meeting, SlamConfig, SlamError};
use monogrid_geometry::{Pinhole, Vec2};
use monogrid_image::{Image, Mask, bilinear};
use std::collections::BTreeSet;
use std::sync::Arc;

/// What came of [`merge_maps`].
#[derive(Clone, Debug)]
pub struct MergedMaps {
    /// All keyframes. Those that were joined are in the fragment of the first of them, in its
    /// world; the others are where they were.
    pub map: StoredMap,
    /// What each two fragments had in common before.
    pub meetings: Vec<Meeting>,
}

/// Joins the fragments of a map that was [put together](StoredMap::side_by_side) of several runs,
/// where they show the same places. The keyframes may have cameras of their own.
///
/// Keyframes are recognised by their corners, verified by points in both directions and aligned
/// directly over Sim(3); two fragments are joined where enough of that is consistent
/// ([`crate::MergeConfig`]), and one robust pose graph then holds all keyframes of both. At last
/// the points of all are looked for in the keyframes of all others, and everything that was joined
/// is adjusted together, as at the end of a run.
///
/// # Errors
/// When the map is damaged, or the settings keep places from being recognised.
pub fn merge_maps(config: &SlamConfig, map: StoredMap) -> Result<MergedMaps, SlamError> {
    config.validate()?;
    map.check_keyframes()?;
    if !(config.graph.enabled && config.graph.places.enabled) {
        return Err(ContinueError::NoPlaces.into());
    }
    let pinholes: Vec<Pinhole> = map.keyframes.iter().map(|k| k.pinhole).collect();
    let setups = setups(config, &map.keyframes);
    let setup_of = |stored: &StoredKeyframe| {
        let known = setups
            .iter()
            .find(|setup| setup.camera() == camera_of(stored));
        known.unwrap_or(&setups[0])
    };
    let store = Store::new(&config.memory);
    let (mut merged, restored_graph) = restored(&setup_of, &store, map)?;
    let mut graph = KeyframeGraph::new(config, pinholes[0], None)?;
    graph.restore(restored_graph);
    let (update, meetings) = graph.merge(&config.merge);
    let joined: BTreeSet<FragmentId> = update.joined.iter().map(|joined| joined.into).collect();
    merged.follow_graph(update, 0);
    let map = stored(&merged, |id: KeyframeId| pinholes[id as usize]);
    drop(merged);
    let map = if config.sparse.enabled && !joined.is_empty() {
        adjusted(&mut graph, &setups, map, &joined)?
    } else {
        map
    };
    Ok(MergedMaps { map, meetings })
}

/// The map with the keyframes of these fragments adjusted together, by the points that they share.
/// The sparse layer knows one camera only: it is shown all keyframes as the one of them with the
/// widest view would see them.
fn adjusted(
    graph: &mut KeyframeGraph,
    setups: &[Setup],
    mut map: StoredMap,
    fragments: &BTreeSet<FragmentId>,
) -> Result<StoredMap, SlamError> {
    let width = |setup: &Setup| setup.mask.width() as f64 / setup.pinhole.fx;
    let widest = setups.iter().max_by(|a, b| width(a).total_cmp(&width(b)));
    let setup = widest.unwrap_or(&setups[0]);
    let camera = setup.camera();
    let store = Store::new(&setup.config.memory);
    let (mut shown, _) = restored(&|_| setup, &store, through(&map, &camera))?;
    for fragment in fragments {
        adjust_whole(setup, &mut shown, *fragment);
    }
    let in_fragments = |k: &&StoredKeyframe| fragments.contains(&k.fragment);
    let keyframes = map.keyframes.iter().filter(in_fragments);
    let keyframes: Vec<KeyframeId> = keyframes.map(|k| k.keyframe.id).collect();
    let update = graph.run(GraphJob {
        poses: Arc::clone(shown.snapshot()),
        // points were found again in all keyframes: what they say is not limited to neighbours
        shared_points: shared_points(&shown, &keyframes, KeyframeId::MAX),
        is_final: true,
        grown: shown.snapshot().fragment.iter().copied().collect(),
        ..GraphJob::default()
    });
    shown.follow_graph(update, 0);
    let found = stored(&shown, |_| camera.pinhole);
    for (keyframe, found) in map.keyframes.iter_mut().zip(&found.keyframes) {
        keyframe.world_from_keyframe = found.world_from_keyframe;
    }
    map.pose_revision = found.pose_revision;
    map.edges = found.edges;
    let own = |id: KeyframeId| map.keyframes[id as usize].pinhole;
    let points = found.points.into_iter();
    map.points = points
        .map(|point| moved(point, |id, pixel| seen_by(&own(id), &camera.pinhole, pixel)))
        .collect();
    Ok(map)
}

/// A map as if all keyframes were of one camera: images, depths and points where it would see them.
/// What it would not see is left out.
fn through(map: &StoredMap, camera: &KeyframeCamera) -> StoredMap {
    let keyframes = map.keyframes.iter().map(|stored| shown_by(stored, camera));
    let own = |id: KeyframeId| map.keyframes[id as usize].pinhole;
    let points = map.points.iter().cloned().map(|point| {
        let mut point = moved(point, |id, pixel| seen_by(&camera.pinhole, &own(id), pixel));
        let is_inside = |pixel: &Vec2| camera.contains(pixel);
        point
            .observations
            .retain(|(_, pixel)| is_inside(&Vec2::from(*pixel)));
        point
    });
    StoredMap {
        scale: map.scale,
        pose_revision: map.pose_revision,
        keyframes: keyframes.collect(),
        edges: Vec::new(),
        points: points.collect(),
    }
}

/// Where a camera sees what another one with the same pose sees at a pixel.
fn seen_by(camera: &Pinhole, other: &Pinhole, pixel: Vec2) -> Vec2 {
    if camera == other {
        return pixel;
    }
    camera.project(&other.unproject(&pixel))
}

/// A point with other pixels.
fn moved(mut point: StoredPoint, pixel_of: impl Fn(KeyframeId, Vec2) -> Vec2) -> StoredPoint {
    point.pixel = pixel_of(point.host, point.pixel.into()).into();
    for (keyframe, pixel) in &mut point.observations {
        *pixel = pixel_of(*keyframe, (*pixel).into()).into();
    }
    point
}

/// A keyframe as another camera with its pose would see it. Beyond its image the border goes on, in
/// which nothing is found.
fn shown_by(stored: &StoredKeyframe, camera: &KeyframeCamera) -> StoredKeyframe {
    let mut shown = stored.clone();
    if camera_of(stored) == *camera {
        return shown;
    }
    let image = stored.keyframe.image.map(f32::from);
    let last = [image.width(), image.height()].map(|side| side.saturating_sub(1) as f64);
    shown.pinhole = camera.pinhole;
    shown.keyframe.image = Image::from_fn(camera.width, camera.height, |x, y| {
        let pixel = Vec2::new(x as f64, y as f64);
        let pixel = seen_by(&stored.pinhole, &camera.pinhole, pixel);
        let [x, y] = [pixel.x.clamp(0.0, last[0]), pixel.y.clamp(0.0, last[1])];
        bilinear(&image, x as f32, y as f32).map_or(0, |value| value.round() as u8)
    });
    let pixels = stored.keyframe.pixels.iter().filter_map(|depth| {
        let own = Vec2::new(depth.x.into(), depth.y.into());
        let pixel = seen_by(&camera.pinhole, &stored.pinhole, own);
        camera.contains(&pixel).then(|| DepthPixel {
            x: (pixel.x.round() as usize).min(camera.width - 1) as u16,
            y: (pixel.y.round() as usize).min(camera.height - 1) as u16,
            ..*depth
        })
    });
    shown.keyframe.pixels = pixels.collect();
    shown
}

/// The camera of a keyframe.
fn camera_of(stored: &StoredKeyframe) -> KeyframeCamera {
    KeyframeCamera::new(stored.pinhole, stored.keyframe.size())
}

/// The settings for the keyframes of each camera.
fn setups(config: &SlamConfig, keyframes: &[StoredKeyframe]) -> Vec<Setup> {
    let mut setups: Vec<Setup> = Vec::new();
    for stored in keyframes {
        let camera = camera_of(stored);
        if setups.iter().all(|setup| setup.camera() != camera) {
            let mask = Mask::filled(camera.width, camera.height, 255);
            setups.push(Setup::new(config.clone(), camera.pinhole, mask, 0));
        }
    }
    setups
}

#[cfg(test)]
mod tests;
