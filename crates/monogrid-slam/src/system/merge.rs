//! Maps of several runs as one, as far as they show the same places.

use super::sessions::{restored, stored};
use super::setup::Setup;
use crate::graph::KeyframeGraph;
use crate::map::Change;
use crate::mapping::KeyframeCamera;
use crate::stored::{ContinueError, StoredKeyframe, StoredMap};
use crate::{KeyframeId, Meeting, SlamConfig, SlamError};
use monogrid_geometry::Pinhole;
use monogrid_image::Mask;

/// What came of [`merge_maps`].
#[derive(Clone, Debug)]
pub struct MergedMaps {
    /// All keyframes. Those that were joined are in the fragment of the first of them, in its world; the others are where they were.
    pub map: StoredMap,
    /// What each two fragments had in common before.
    pub meetings: Vec<Meeting>,
}

/// Joins the fragments of a map that was [put together](StoredMap::side_by_side) of several runs, where they show the same places. The keyframes
/// may have cameras of their own.
///
/// Keyframes are recognised by their corners, verified by points in both directions and aligned directly over Sim(3); two fragments are
/// joined where enough of that is consistent ([`crate::MergeConfig`]), and one robust pose graph then holds all keyframes of both. The
/// result depends on the order of the fragments only as far as rounding does.
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
        let camera = KeyframeCamera::new(stored.pinhole, stored.keyframe.size());
        let known = setups.iter().find(|setup| setup.camera() == camera);
        known.unwrap_or(&setups[0])
    };
    let (mut merged, restored_graph) = restored(&setup_of, map)?;
    let mut graph = KeyframeGraph::new(
        config.graph.clone(),
        config.fragments.clone(),
        pinholes[0],
        None,
    )?;
    graph.restore(restored_graph);
    let (update, meetings) = graph.merge(&config.merge);
    merged.apply(Change::Optimised(Box::new(update), 0));
    Ok(MergedMaps {
        map: stored(&merged, |id: KeyframeId| pinholes[id as usize]),
        meetings,
    })
}

/// The settings for the keyframes of each camera.
fn setups(config: &SlamConfig, keyframes: &[StoredKeyframe]) -> Vec<Setup> {
    let mut setups: Vec<Setup> = Vec::new();
    for stored in keyframes {
        let camera = KeyframeCamera::new(stored.pinhole, stored.keyframe.size());
        if setups.iter().all(|setup| setup.camera() != camera) {
            setups.push(Setup {
                config: config.clone(),
                pinhole: camera.pinhole,
                mask: Mask::filled(camera.width, camera.height, 255),
                seed: 0,
                is_frozen: false,
                imu: None,
                left_radial: 0.0,
            });
        }
    }
    setups
}
