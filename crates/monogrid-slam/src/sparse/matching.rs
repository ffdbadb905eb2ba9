//! Finding points in keyframes by their patches.

use super::SparseConfig;
use super::points::{Observation, SparseLayer, SparsePoint};
use crate::KeyframeId;
use crate::node::Node;
use monogrid_depth::{DepthMap, DepthState};
use monogrid_features::{CornerConfig, PatchSearchConfig, detect_corners, find_patch, patch_warp};
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};
use monogrid_image::Mask;
use rayon::prelude::*;

/// Points that were looked for in a new keyframe.
pub(crate) struct Search {
    pub num_searched: usize,
    /// Index of the point and where it was found.
    pub found: Vec<(usize, Vec2)>,
}

/// A point about to be anchored.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewPoint {
    pub pixel: Vec2,
    /// 1 / world units.
    pub idepth: f64,
    pub sigma: f64,
}

/// No point closer to the border than this, px: room for a patch.
const BORDER_PX: f64 = 10.0;

/// Projects all points into the newest keyframe, spreads the visible ones over the image, and looks
/// for their patches.
pub(crate) fn find_in_new_keyframe(
    layer: &SparseLayer,
    nodes: &[Node],
    pinhole: &Pinhole,
    config: &SparseConfig,
) -> Search {
    let Some((newest, _)) = nodes.split_last() else {
        return Search {
            num_searched: 0,
            found: Vec::new(),
        };
    };
    let camera_from_world = layer.camera_from_world[newest.id as usize];
    let image = newest.pyramid.level(0);
    let size = (image.width() as f64, image.height() as f64);
    let visible: Vec<(usize, Vec2)> = layer
        .points
        .iter()
        .enumerate()
        .filter(|(_, point)| point.alive && nodes[point.host as usize].fragment == newest.fragment)
        .filter_map(|(i, point)| {
            predict(layer, point, &camera_from_world, size, pinhole, config).map(|pixel| (i, pixel))
        })
        .collect();
    let chosen = spread(&visible, layer, size, config);
    let search = search_config(config);
    let found: Vec<Option<(usize, Vec2)>> = chosen
        .par_iter()
        .map(|&(i, predicted)| {
            let point = &layer.points[i];
            let host = &nodes[point.host as usize];
            let newest_from_host =
                camera_from_world * layer.camera_from_world[point.host as usize].inverse();
            let warp = patch_warp(pinhole, &point.pixel, point.idepth, &newest_from_host)?;
            // the search wants offsets in the reference from offsets in the current image
            let outcome = find_patch(
                &host.pyramid,
                &point.pixel,
                &warp,
                &newest.pyramid,
                &predicted,
                &search,
            );
            outcome.pixel().map(|pixel| (i, pixel))
        })
        .collect();
    Search {
        num_searched: chosen.len(),
        found: found.into_iter().flatten().collect(),
    }
}

fn search_config(config: &SparseConfig) -> PatchSearchConfig {
    PatchSearchConfig {
        radius_px: config.search_radius_px,
        ..PatchSearchConfig::default()
    }
}

/// Pixel of a point in a camera, if it lies inside and is seen from about where its anchor sees it.
fn predict(
    layer: &SparseLayer,
    point: &SparsePoint,
    camera_from_world: &Se3,
    size: (f64, f64),
    pinhole: &Pinhole,
    config: &SparseConfig,
) -> Option<Vec2> {
    let position = point.position(&layer.camera_from_world, pinhole);
    let in_camera = *camera_from_world * position;
    if in_camera.z <= 1e-6 {
        return None;
    }
    let pixel = pinhole.project(&in_camera);
    let inside = pixel.x >= BORDER_PX
        && pixel.y >= BORDER_PX
        && pixel.x < size.0 - BORDER_PX
        && pixel.y < size.1 - BORDER_PX;
    if !inside {
        return None;
    }
    let host_centre = layer.camera_from_world[point.host as usize]
        .inverse()
        .translation;
    let centre = camera_from_world.inverse().translation;
    let (a, b): (Vec3, Vec3) = (position - host_centre, position - centre);
    let ratio = a.norm() / b.norm();
    let limit = config.max_distance_ratio;
    let cosine = a.dot(&b) / (a.norm() * b.norm());
    (ratio < limit && ratio > 1.0 / limit && cosine > config.max_view_angle_deg.to_radians().cos())
        .then_some(pixel)
}

/// At most `max_searched_points`, taken round robin from square cells, the best observed ones first.
fn spread(
    visible: &[(usize, Vec2)],
    layer: &SparseLayer,
    size: (f64, f64),
    config: &SparseConfig,
) -> Vec<(usize, Vec2)> {
    let cell = config.cell_px as f64;
    let columns = (size.0 / cell).ceil() as usize;
    let rows = (size.1 / cell).ceil() as usize;
    let mut cells: Vec<Vec<(usize, Vec2)>> = vec![Vec::new(); columns * rows];
    for &(i, pixel) in visible {
        cells[(pixel.y / cell) as usize * columns + (pixel.x / cell) as usize].push((i, pixel));
    }
    for list in &mut cells {
        list.sort_by_key(|(i, _)| {
            let seen = layer.points[*i].observations.len();
            (std::cmp::Reverse(seen), *i)
        });
    }
    let deepest = cells.iter().map(Vec::len).max().unwrap_or(0);
    let mut chosen = Vec::new();
    for depth in 0..deepest {
        for list in &cells {
            if chosen.len() >= config.max_searched_points {
                return chosen;
            }
            chosen.extend(list.get(depth));
        }
    }
    chosen
}

/// New corners of the newest keyframe where it sees few points, with depth from the dense map.
pub(crate) fn anchor_points(
    node: &Node,
    depth: &DepthMap,
    seen: &[Vec2],
    mask: &Mask,
    config: &SparseConfig,
) -> Vec<NewPoint> {
    let missing = config.points_per_keyframe.saturating_sub(seen.len());
    if missing == 0 {
        return Vec::new();
    }
    let corners = detect_corners(
        &node.pyramid,
        Some(mask),
        seen,
        &CornerConfig {
            max_corners: missing,
            ..CornerConfig::default()
        },
    );
    let unit = node.world_from_keyframe.scale;
    corners
        .iter()
        .filter_map(|corner| {
            let (idepth, sigma) = dense_idepth(depth, &corner.pixel)?;
            Some(NewPoint {
                pixel: corner.pixel,
                idepth: idepth / unit,
                sigma: sigma / unit,
            })
        })
        .collect()
}

/// Half width of the neighbourhood in which the dense depth of a corner is looked up, px.
const LOOKUP_RADIUS: i32 = 2;

/// Median inverse depth around a pixel and its uncertainty, keyframe units.
pub(crate) fn dense_idepth(depth: &DepthMap, pixel: &Vec2) -> Option<(f64, f64)> {
    let host = depth.host();
    let (cx, cy) = (pixel.x.round() as i32, pixel.y.round() as i32);
    let mut known: Vec<(f32, f32)> = Vec::new();
    for y in cy - LOOKUP_RADIUS..=cy + LOOKUP_RADIUS {
        for x in cx - LOOKUP_RADIUS..=cx + LOOKUP_RADIUS {
            if x < 0 || y < 0 || x >= host.width() as i32 || y >= host.height() as i32 {
                continue;
            }
            if let DepthState::Known {
                idepth, idepth_var, ..
            } = depth.state(x as usize, y as usize)
            {
                known.push((idepth, idepth_var));
            }
        }
    }
    if known.len() < 3 {
        return None;
    }
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (idepth, var) = known[known.len() / 2];
    // across a depth edge the neighbourhood says how little is known
    let spread = known[known.len() * 3 / 4].0 - known[known.len() / 4].0;
    (idepth > 0.0).then(|| (f64::from(idepth), f64::from((var + spread * spread).sqrt())))
}

/// For each new point of the newest keyframe, where the keyframes used last see it.
pub(crate) fn find_in_older_keyframes(
    layer: &SparseLayer,
    nodes: &[Node],
    recent: &[KeyframeId],
    anchored: &[NewPoint],
    pinhole: &Pinhole,
    config: &SparseConfig,
) -> Vec<Vec<Observation>> {
    let Some((newest, _)) = nodes.split_last() else {
        return Vec::new();
    };
    let older: Vec<&Node> = recent
        .iter()
        .rev()
        .filter(|id| **id != newest.id)
        .take(config.back_search_keyframes)
        .map(|id| &nodes[*id as usize])
        .collect();
    let world_from_newest = layer.camera_from_world[newest.id as usize].inverse();
    let image = newest.pyramid.level(0);
    let size = (image.width() as f64, image.height() as f64);
    let search = search_config(config);
    anchored
        .par_iter()
        .map(|point| {
            let position = pinhole.unproject(&point.pixel) / point.idepth;
            let mut observations = Vec::new();
            for node in older.iter().rev() {
                let node_from_newest =
                    layer.camera_from_world[node.id as usize] * world_from_newest;
                let in_node = node_from_newest * position;
                if in_node.z <= 1e-6 {
                    continue;
                }
                let predicted = pinhole.project(&in_node);
                let inside = predicted.x >= BORDER_PX
                    && predicted.y >= BORDER_PX
                    && predicted.x < size.0 - BORDER_PX
                    && predicted.y < size.1 - BORDER_PX;
                if !inside {
                    continue;
                }
                let warp = patch_warp(pinhole, &point.pixel, point.idepth, &node_from_newest);
                let outcome = warp.map(|warp| {
                    find_patch(
                        &newest.pyramid,
                        &point.pixel,
                        &warp,
                        &node.pyramid,
                        &predicted,
                        &search,
                    )
                });
                if let Some(pixel) = outcome.and_then(|o| o.pixel()) {
                    observations.push(Observation {
                        keyframe: node.id,
                        pixel,
                    });
                }
            }
            observations
        })
        .collect()
}
