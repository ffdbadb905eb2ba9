//! Points looked for once more when all poses are known: in every keyframe that should see them.

use super::SparseConfig;
use super::matching::{PointSearch, SearchImage, Which, find_in_image};
use crate::FragmentId;
use crate::map::{Map, Observation};
use monogrid_features::PatchSearchConfig;
use monogrid_geometry::Pinhole;

/// Where keyframes of a fragment see points that were not found in them before: those that were anchored later, and
/// those that the poses of their time had elsewhere.
pub(crate) fn find_again(
    map: &Map,
    fragment: FragmentId,
    pinhole: &Pinhole,
    config: &SparseConfig,
) -> Vec<(usize, Observation)> {
    let mut seen = Vec::new();
    for keyframe in map.in_fragment(fragment) {
        let Some(pyramid) = keyframe.pyramid() else {
            continue;
        };
        let image = SearchImage {
            pyramid: &pyramid,
            fragment,
            camera_from_world: keyframe.camera_from_world,
        };
        let search = PointSearch {
            patch: PatchSearchConfig {
                radius_px: config.final_radius_px,
                ..PatchSearchConfig::default()
            },
            which: Which::NotSeenBy(keyframe.id),
            max_points: config.max_searched_points,
            from_newest: false,
        };
        let found = find_in_image(map, &image, &search, pinhole, config).found;
        let keyframe = keyframe.id;
        seen.extend(
            found
                .into_iter()
                .map(|(point, pixel)| (point, Observation { keyframe, pixel })),
        );
    }
    seen
}
