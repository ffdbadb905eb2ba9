//! Finding points in keyframes by their patches.

use crate::map::{Map, MapKeyframe, Observation, SparsePoint};
use crate::{FragmentId, KeyframeId};
use monogrid_depth::DepthMap;
use monogrid_features::{PatchSearchConfig, find_patch, patch_warp};
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};
use monogrid_image::Pyramid;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most old points that are looked for in a new keyframe.
const MAX_SEARCHED_POINTS: usize = 900;
/// Side of the square cells over which the searched points are spread, px.
const CELL_PX: usize = 24;
/// Half width of the search for a point around its prediction, px.
const SEARCH_RADIUS_PX: f64 = 8.0;
/// Largest angle between the rays from the anchor and from the new keyframe, degrees.
const MAX_VIEW_ANGLE_DEG: f64 = 40.0;
/// Largest ratio of the distances from the anchor and from the new keyframe.
const MAX_DISTANCE_RATIO: f64 = 2.0;
/// Older keyframes in which a new point is looked for.
const BACK_SEARCH_KEYFRAMES: usize = 5;

/// Points that were looked for in an image.
#[derive(Default)]
pub(crate) struct Search {
    pub num_searched: usize,
    /// Index of the point and where it was found.
    pub found: Vec<(usize, Vec2)>,
}

/// No point closer to the border than this, px: room for a patch.
const BORDER_PX: f64 = 10.0;

/// Position of a point in the world.
pub(crate) fn position(map: &Map, point: &SparsePoint, pinhole: &Pinhole) -> Vec3 {
    let direction = pinhole.unproject(&point.pixel);
    map[point.host].camera_from_world.inverse() * (direction / point.idepth)
}

/// Width and height of the images, px.
fn size_of(pyramid: &Pyramid) -> (f64, f64) {
    let image = pyramid.level(0);
    (image.width() as f64, image.height() as f64)
}

fn is_inside(pixel: &Vec2, size: (f64, f64)) -> bool {
    pixel.x >= BORDER_PX
        && pixel.y >= BORDER_PX
        && pixel.x < size.0 - BORDER_PX
        && pixel.y < size.1 - BORDER_PX
}

/// Points of a fragment that are looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    All,
    /// Those that this keyframe sees.
    SeenBy(KeyframeId),
    /// Those that it was not found to see.
    NotSeenBy(KeyframeId),
}

/// An image in which points are looked for, about where it was taken, and how they are looked for.
#[derive(Clone, Debug)]
pub(crate) struct PointSearch<'a> {
    pub pyramid: &'a Pyramid,
    /// Only points of this fragment are looked for.
    pub fragment: FragmentId,
    /// Translation in world units.
    pub camera_from_world: Se3,
    pub patch: PatchSearchConfig,
    /// Which points of the fragment are looked for.
    pub which: Which,
    /// Whether points are left out whose depth is a guess ([`SparsePoint::has_depth`]).
    pub with_depth: bool,
    /// Points that are looked for at most.
    pub max_points: usize,
    /// Whether a point is compared with how it was seen last, which looks most like the image,
    /// instead of with its anchor, whose patches do not wander.
    pub from_newest: bool,
}

impl<'a> PointSearch<'a> {
    /// In a keyframe, within a radius of where points are predicted.
    pub(super) fn in_keyframe(
        (keyframe, pyramid): (&MapKeyframe, &'a Pyramid),
        which: Which,
        radius_px: f64,
    ) -> Self {
        Self {
            pyramid,
            fragment: keyframe.fragment,
            camera_from_world: keyframe.camera_from_world,
            patch: patch_search(radius_px),
            which,
            with_depth: false,
            max_points: MAX_SEARCHED_POINTS,
            from_newest: false,
        }
    }
}

fn patch_search(radius_px: f64) -> PatchSearchConfig {
    PatchSearchConfig {
        radius_px,
        ..PatchSearchConfig::default()
    }
}

/// Looks for the points of its fragment in the newest keyframe.
pub(super) fn find_in_newest(map: &Map, pinhole: &Pinhole) -> Search {
    let newest = map.newest();
    let Some((newest, pyramid)) = newest.and_then(|k| Some((k, k.pyramid()?))) else {
        return Search::default();
    };
    let search = PointSearch::in_keyframe((newest, &pyramid), Which::All, SEARCH_RADIUS_PX);
    find_in_image(map, &search, pinhole)
}

/// Projects the points of a fragment into an image, spreads the visible ones over it, and looks for
/// their patches.
pub(crate) fn find_in_image(map: &Map, search: &PointSearch, pinhole: &Pinhole) -> Search {
    let found = find_in_images(map, std::slice::from_ref(search), pinhole);
    found.into_iter().next().unwrap_or_default()
}

/// The same in several images, one after the other. What keyframes show is made ready once for all
/// images, not once for each.
pub(super) fn find_in_images(
    map: &Map,
    searches: &[PointSearch],
    pinhole: &Pinhole,
) -> Vec<Search> {
    let (mut results, mut all_wanted) = (Vec::new(), Vec::new());
    for search in searches {
        let chosen = spread(&visible_in(map, search, pinhole), map, search);
        all_wanted.extend(chosen.iter().filter_map(|&(point, predicted)| {
            let source = patch_source(map, &map.points()[point], search.from_newest, pinhole)?;
            Some(Wanted {
                image: results.len(),
                point,
                predicted,
                source,
            })
        }));
        results.push(Search {
            num_searched: chosen.len(),
            found: Vec::new(),
        });
    }
    let pixels = find_wanted(&all_wanted, searches, pinhole);
    for (wanted, pixel) in all_wanted.iter().zip(pixels) {
        let found = pixel.map(|pixel| (wanted.point, pixel));
        results[wanted.image].found.extend(found);
    }
    results
}

/// A point that is looked for.
struct Wanted<'a> {
    /// Index of the image in which it is looked for.
    image: usize,
    point: usize,
    predicted: Vec2,
    source: PatchSource<'a>,
}

/// Keyframes of which patches are taken at the same time: as many pyramids are in memory.
const MAX_SOURCES: usize = 8;

/// Where each of the points is found.
fn find_wanted(
    wanted: &[Wanted],
    searches: &[PointSearch],
    pinhole: &Pinhole,
) -> Vec<Option<Vec2>> {
    let sources: BTreeMap<KeyframeId, &MapKeyframe> = wanted
        .iter()
        .map(|wanted| (wanted.source.keyframe.id, wanted.source.keyframe))
        .collect();
    let sources: Vec<&MapKeyframe> = sources.into_values().collect();
    let mut found: Vec<Option<Vec2>> = vec![None; wanted.len()];
    for some in sources.chunks(MAX_SOURCES) {
        let pyramids: BTreeMap<KeyframeId, Arc<Pyramid>> = some
            .par_iter()
            .filter_map(|keyframe| Some((keyframe.id, keyframe.pyramid()?)))
            .collect();
        let wanted = wanted.par_iter().zip(found.par_iter_mut());
        wanted.for_each(|(wanted, found)| {
            let source = wanted.source.keyframe;
            if let Some(pyramid) = pyramids.get(&source.id) {
                let image = &searches[wanted.image];
                let image_from_source =
                    image.camera_from_world * source.camera_from_world.inverse();
                let image = (image.pyramid, &wanted.predicted, &image.patch);
                *found = wanted
                    .source
                    .find_in(image, &image_from_source, pyramid, pinhole);
            }
        });
    }
    found
}

/// Where the patch of a point is taken from.
struct PatchSource<'a> {
    keyframe: &'a MapKeyframe,
    pixel: Vec2,
    /// 1 / world units, in that keyframe.
    idepth: f64,
}

impl PatchSource<'_> {
    /// Where an image shows it, around where it is predicted; `pyramid` is that of its keyframe.
    fn find_in(
        &self,
        (image, predicted, config): (&Pyramid, &Vec2, &PatchSearchConfig),
        image_from_source: &Se3,
        pyramid: &Pyramid,
        pinhole: &Pinhole,
    ) -> Option<Vec2> {
        let warp = patch_warp(pinhole, &self.pixel, self.idepth, image_from_source)?;
        // the search wants offsets in the reference from offsets in the current image
        find_patch(pyramid, &self.pixel, &warp, image, predicted, config).pixel()
    }
}

/// The anchor of a point, or the newest keyframe that sees it.
fn patch_source<'a>(
    map: &'a Map,
    point: &SparsePoint,
    from_newest: bool,
    pinhole: &Pinhole,
) -> Option<PatchSource<'a>> {
    let newest = point.observations.iter().max_by_key(|o| o.keyframe);
    match newest.filter(|o| from_newest && o.keyframe > point.host) {
        Some(seen) => {
            let keyframe = &map[seen.keyframe];
            let in_camera = keyframe.camera_from_world * position(map, point, pinhole);
            (in_camera.z > Pinhole::MIN_DEPTH).then(|| PatchSource {
                keyframe,
                pixel: seen.pixel,
                idepth: 1.0 / in_camera.z,
            })
        }
        None => Some(PatchSource {
            keyframe: &map[point.host],
            pixel: point.pixel,
            idepth: point.idepth,
        }),
    }
}

/// The points of its fragment that an image should show, and where.
fn visible_in(map: &Map, image: &PointSearch, pinhole: &Pinhole) -> Vec<(usize, Vec2)> {
    let view = PointView {
        camera_from_world: image.camera_from_world,
        centre: image.camera_from_world.inverse().translation,
        size: size_of(image.pyramid),
        pinhole,
        max_ratio: MAX_DISTANCE_RATIO,
        min_cosine: MAX_VIEW_ANGLE_DEG.to_radians().cos(),
    };
    let predicted = |index: usize, world_from_host: &Se3| {
        let point = &map.points()[index];
        let is_seen = |keyframe| point.pixel_in(keyframe).is_some();
        if image.with_depth && !point.has_depth() {
            return None;
        }
        if !point.alive || matches!(image.which, Which::NotSeenBy(id) if is_seen(id)) {
            return None;
        }
        Some((index, view.predict(point, world_from_host)?))
    };
    if let Which::SeenBy(keyframe) = image.which {
        let world_from_host =
            |index: usize| map[map.points()[index].host].camera_from_world.inverse();
        let seen = map[keyframe].points.all();
        let seen = seen.filter_map(|index| predicted(index, &world_from_host(index)));
        return seen.collect();
    }
    let hosts = map.in_fragment(image.fragment);
    hosts
        .flat_map(|host| {
            let world_from_host = host.camera_from_world.inverse();
            let anchored = host.points.anchored.clone();
            anchored.filter_map(move |index| predicted(index, &world_from_host))
        })
        .collect()
}

/// A camera that may see points.
#[derive(Clone, Copy)]
struct PointView<'a> {
    camera_from_world: Se3,
    /// Its centre in the world.
    centre: Vec3,
    /// Width and height of the image, px.
    size: (f64, f64),
    pinhole: &'a Pinhole,
    /// Largest ratio of the distances from here and from a point's anchor.
    max_ratio: f64,
    /// Smallest cosine of the angle between both rays.
    min_cosine: f64,
}

impl PointView<'_> {
    /// Pixel of a point, if it lies inside and is seen from about where its anchor sees it.
    fn predict(&self, point: &SparsePoint, world_from_host: &Se3) -> Option<Vec2> {
        let position = *world_from_host * (self.pinhole.unproject(&point.pixel) / point.idepth);
        let in_camera = self.camera_from_world * position;
        if in_camera.z <= Pinhole::MIN_DEPTH {
            return None;
        }
        let pixel = self.pinhole.project(&in_camera);
        if !is_inside(&pixel, self.size) {
            return None;
        }
        let a: Vec3 = position - world_from_host.translation;
        let b: Vec3 = position - self.centre;
        let ratio = a.norm() / b.norm();
        let cosine = a.dot(&b) / (a.norm() * b.norm());
        (ratio < self.max_ratio && ratio > 1.0 / self.max_ratio && cosine > self.min_cosine)
            .then_some(pixel)
    }
}

/// As many points as are looked for at most, taken round robin from square cells, the best observed
/// ones first.
fn spread(visible: &[(usize, Vec2)], map: &Map, search: &PointSearch) -> Vec<(usize, Vec2)> {
    let (cell, size) = (CELL_PX as f64, size_of(search.pyramid));
    let columns = (size.0 / cell).ceil() as usize;
    let rows = (size.1 / cell).ceil() as usize;
    let mut cells: Vec<Vec<(usize, Vec2)>> = vec![Vec::new(); columns * rows];
    for &(i, pixel) in visible {
        cells[(pixel.y / cell) as usize * columns + (pixel.x / cell) as usize].push((i, pixel));
    }
    for list in &mut cells {
        list.sort_by_key(|(i, _)| (Reverse(map.points()[*i].observations.len()), *i));
    }
    let deepest = cells.iter().map(Vec::len).max().unwrap_or(0);
    let mut chosen = Vec::new();
    for depth in 0..deepest {
        for list in &cells {
            if chosen.len() >= search.max_points {
                return chosen;
            }
            chosen.extend(list.get(depth));
        }
    }
    chosen
}

/// Half width of the neighbourhood in which the dense depth of a corner is looked up, px.
const LOOKUP_RADIUS: i32 = 2;

/// Median inverse depth around a pixel and its uncertainty, keyframe units.
pub(super) fn dense_idepth(depth: &DepthMap, pixel: &Vec2) -> Option<(f64, f64)> {
    idepth_within(LOOKUP_RADIUS, depth, pixel)
}

/// Half widths of the neighbourhoods in which the depth of a new point is looked up, px.
const NEARBY_RADII: [i32; 5] = [LOOKUP_RADIUS, 4, 8, 16, 32];

/// The same in the smallest neighbourhood that has depth. A faint corner has none of its own. That
/// of its surroundings says where other keyframes should see it to a few pixels, and where they do
/// says how far away it is.
pub(super) fn nearby_idepth(depth: &DepthMap, pixel: &Vec2) -> Option<(f64, f64)> {
    let mut radii = NEARBY_RADII.into_iter();
    radii.find_map(|radius| idepth_within(radius, depth, pixel))
}

fn idepth_within(radius: i32, depth: &DepthMap, pixel: &Vec2) -> Option<(f64, f64)> {
    let host = depth.host();
    let (cx, cy) = (pixel.x.round() as i32, pixel.y.round() as i32);
    let around = |c: i32, size: usize| (c - radius).max(0)..(c + radius + 1).min(size as i32);
    let mut known: Vec<(f32, f32)> = Vec::new();
    for y in around(cy, host.height()) {
        for x in around(cx, host.width()) {
            if let Some(pixel) = depth.at(x as usize, y as usize) {
                known.push((pixel.idepth, pixel.idepth_var));
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

/// For each of the points about to be anchored in the newest keyframe, where the keyframes used
/// last see it.
pub(super) fn find_in_older(
    map: &Map,
    newest: &MapKeyframe,
    points: &[SparsePoint],
    pinhole: &Pinhole,
) -> Vec<Vec<Observation>> {
    let recent = map.recent_in(newest.fragment);
    let is_other = |id: &&KeyframeId| **id != newest.id;
    let others = recent.iter().rev().filter(is_other);
    let with_pyramid = |keyframe| Some((keyframe, MapKeyframe::pyramid(keyframe)?));
    let mut older: Vec<(&MapKeyframe, Arc<Pyramid>)> = others
        .take(BACK_SEARCH_KEYFRAMES)
        .filter_map(|id| with_pyramid(&map[*id]))
        .collect();
    older.reverse();
    let Some(newest) = with_pyramid(newest) else {
        return vec![Vec::new(); points.len()];
    };
    let search = patch_search(SEARCH_RADIUS_PX);
    points
        .par_iter()
        .map(|point| {
            let seen = older.iter().filter_map(|keyframe| {
                let pixel = find_in_one(point, &newest, keyframe, pinhole, &search)?;
                let keyframe = keyframe.0.id;
                Some(Observation { keyframe, pixel })
            });
            seen.collect()
        })
        .collect()
}

/// Where an older keyframe sees a point of the newest.
fn find_in_one(
    point: &SparsePoint,
    (newest, newest_pyramid): &(&MapKeyframe, Arc<Pyramid>),
    (older, older_pyramid): &(&MapKeyframe, Arc<Pyramid>),
    pinhole: &Pinhole,
    search: &PatchSearchConfig,
) -> Option<Vec2> {
    let older_from_newest = older.camera_from_world * newest.camera_from_world.inverse();
    let in_older = older_from_newest * (pinhole.unproject(&point.pixel) / point.idepth);
    if in_older.z <= Pinhole::MIN_DEPTH {
        return None;
    }
    let predicted = pinhole.project(&in_older);
    if !is_inside(&predicted, size_of(newest_pyramid)) {
        return None;
    }
    let source = PatchSource {
        keyframe: newest,
        pixel: point.pixel,
        idepth: point.idepth,
    };
    let older = (&**older_pyramid, &predicted, search);
    source.find_in(older, &older_from_newest, newest_pyramid, pinhole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_depth::{DepthConfig, HostFrame};
    use monogrid_image::{GrayImage, Mask};
    use std::sync::Arc;

    #[test]
    fn a_corner_without_depth_has_that_of_its_surroundings_if_they_are_near() {
        // stripes on the left alone, twice as far away on their left half
        let image = GrayImage::from_fn(160, 48, |x, _| {
            if x < 64 {
                60.0 * (x % 8) as f32 / 8.0
            } else {
                0.0
            }
        });
        let depth = GrayImage::from_fn(160, 48, |x, _| if x < 32 { 4.0 } else { 2.0 });
        let (mask, pinhole) = (
            Mask::filled(160, 48, 255),
            Pinhole::new(150.0, 150.0, 80.0, 24.0),
        );
        let host = HostFrame::new(image, mask, pinhole).unwrap();
        let mut map = DepthMap::empty(Arc::new(host), &DepthConfig::default());
        map.initialize_from_depth(&depth, 0.01);
        let idepth = |x: f64| Some(nearby_idepth(&map, &Vec2::new(x, 24.0))?.0);
        assert_eq!(idepth(16.0), Some(0.25));
        assert_eq!(idepth(48.0), Some(0.5));
        // the nearest is found first, however much there is farther away
        assert_eq!(idepth(68.0), Some(0.5));
        assert_eq!(idepth(90.0), Some(0.5));
        assert_eq!(dense_idepth(&map, &Vec2::new(90.0, 24.0)), None);
        assert_eq!(idepth(110.0), None);
    }
}
