//! Walls, floor and ceiling beyond what was measured of them.
//!
//! What plain regions are filled with ends with their outline, and what only the rim of an image
//! shows no other image measures. But a wall goes on until the next one. Large planes that nothing
//! lies behind bound the view of a keyframe: the nearest of them on a line of sight is the last
//! that it can meet. A region without depth whose outline lies on them is on them, as far as each
//! was measured nearby.
//!
//! Two kinds of regions are looked at: plain ones, and what is left of the others. An edge in the
//! image may be where another surface begins, a ceiling that nobody measured. So a plain region is
//! not filled with a plane that it meets along a single line, with that plane on the other side of
//! it.

use super::fill::{
    EIGHT_DIRECTIONS, MAX_BEHIND_SHARE, MIN_AREA_PX, MIN_INLIERS_OFFERED, NO_REGION, Regions,
    regions_beside,
};
use super::shared::{SeenPlane, Surroundings};
use crate::scene::{DepthImage, Scene, measurement};
use monogrid_geometry::Vec2;
use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;
use nalgebra::Matrix2;

/// How far from where it was measured a plane is continued, as a share of the range. Measured:
/// icl-office-kt3, which is open on one side, has 7,800 cells outside with 0.1, 10,100 with 0.15,
/// 12,700 with 0.2.
const MAX_EXTENT: f64 = 0.15;

/// Share of the outline of a plain region that must lie on the planes.
const MIN_PLAIN_SHARE: f64 = 0.3;
/// The same for regions that are not plain.
const MIN_OTHER_SHARE: f64 = 0.6;
/// Relative difference of inverse depths on a plane, a standard deviation.
const FLATNESS: f64 = 0.015;
/// The outline of a region along a line, px: root mean square of the distance from it.
const LINE_PX: f64 = 5.0;
/// The same as a share of its length.
const LINE_SHARE: f64 = 0.05;
/// How far beyond an outline is looked what lies there, px.
const BEYOND_PX: i32 = 12;

/// Depth of the regions of a keyframe that have none, where large planes bound its view. None
/// without pose or image.
pub(super) fn continued(
    scene: &Scene,
    index: usize,
    surroundings: &Surroundings,
) -> Vec<Measurement> {
    let camera = scene.camera;
    let image = scene.keyframes[index].image();
    let (Some(view), Some(image)) = (&scene.views[index], image) else {
        return Vec::new();
    };
    let planes = surroundings.bounding();
    if planes.is_empty() {
        return Vec::new();
    }
    let seen = |plane| SeenPlane::new(plane, &view.world_from_keyframe, camera);
    let bounds = BoundingPlanes {
        planes: planes.into_iter().map(seen).collect(),
        max_relative_sigma: scene.config.filter.max_relative_sigma,
    };
    let [measured, filled] = view.depths.kinds();
    let plain = Regions::new(&image, measured.iter().chain(filled.iter()));
    let mut shown = DepthImage::of(&view.depths, camera);
    let mut added = bounds.of_plain(&plain, &shown);
    shown.show(added.iter().copied());
    let mut others = bounds.of_others(&plain, &shown);
    added.append(&mut others);
    added
}

/// The planes that bound the view of a keyframe.
struct BoundingPlanes<'a> {
    planes: Vec<SeenPlane<'a>>,
    /// Where they are less certain, they give no depth.
    max_relative_sigma: f64,
}

impl BoundingPlanes<'_> {
    /// The plane that the line of sight of a pixel meets first, and its inverse depth there.
    fn nearest(&self, x: f64, y: f64) -> Option<(usize, f64)> {
        let planes = self.planes.iter().enumerate();
        let idepths = planes.map(|(index, plane)| (index, plane.idepth([x, y])));
        let ahead = idepths.filter(|(_, idepth)| *idepth > 0.0);
        ahead.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Whether an inverse depth at a pixel is that of a plane.
    fn is_on(&self, plane: usize, at: [f64; 2], idepth: f64) -> bool {
        let expected = self.planes[plane].idepth(at);
        expected > 0.0 && (idepth / expected - 1.0).abs() <= 2.0 * FLATNESS
    }

    /// Depth of the plain regions whose outline lies on them.
    fn of_plain(&self, regions: &Regions, shown: &DepthImage) -> Vec<Measurement> {
        let allowed: Vec<Vec<bool>> = outlines(regions, shown)
            .iter()
            .map(|outline| {
                if !self.holds(outline, MIN_PLAIN_SHARE) {
                    return Vec::new();
                }
                let is_allowed = |plane| {
                    let points = self.points_on(plane, outline);
                    !is_line(&points) || !self.goes_on_beyond(plane, &points, shown)
                };
                (0..self.planes.len()).map(is_allowed).collect()
            })
            .collect();
        self.filled(regions, &allowed)
    }

    /// Depth of the regions of all other pixels without depth whose outline lies on them.
    fn of_others(&self, plain: &Regions, shown: &DepthImage) -> Vec<Measurement> {
        let labels = &plain.labels;
        let is_left = Image::from_fn(labels.width(), labels.height(), |x, y| {
            labels.at(x, y) == NO_REGION && shown.at(x, y).is_none()
        });
        let regions = Regions::of_pixels(&is_left, MIN_AREA_PX);
        let allowed: Vec<Vec<bool>> = outlines(&regions, shown)
            .iter()
            .map(|outline| vec![self.holds(outline, MIN_OTHER_SHARE); self.planes.len()])
            .collect();
        self.filled(&regions, &allowed)
    }

    /// Whether so much of the outline of a region lies on them, and little behind it.
    fn holds(&self, outline: &[OutlinePoint], min_share: f64) -> bool {
        let (mut on, mut behind) = (0_usize, 0_usize);
        for ([x, y], idepth) in outline {
            if let Some((_, expected)) = self.nearest(*x, *y) {
                let gap = (idepth / expected - 1.0) / FLATNESS;
                on += usize::from(gap.abs() <= 2.0);
                behind += usize::from(gap < -2.5);
            }
        }
        let total = outline.len() as f64;
        on >= MIN_INLIERS_OFFERED
            && on as f64 >= min_share * total
            && behind as f64 <= MAX_BEHIND_SHARE * total
    }

    /// The points of an outline on a plane.
    fn points_on(&self, plane: usize, outline: &[OutlinePoint]) -> Vec<[f64; 2]> {
        let outline = outline.iter();
        let on_plane = outline.filter(|(place, idepth)| self.is_on(plane, *place, *idepth));
        on_plane.map(|(place, _)| *place).collect()
    }

    /// Whether what is known beside points of an outline is on the plane for the most part.
    fn goes_on_beyond(&self, plane: usize, points: &[[f64; 2]], shown: &DepthImage) -> bool {
        let (mut on, mut total) = (0_usize, 0_usize);
        for [x, y] in points {
            for (dx, dy) in EIGHT_DIRECTIONS {
                let (x, y) = (*x as i32 + BEYOND_PX * dx, *y as i32 + BEYOND_PX * dy);
                let idepth = shown.idepth(x, y);
                if idepth > 0.0 {
                    total += 1;
                    on += usize::from(self.is_on(plane, [x.into(), y.into()], idepth.into()));
                }
            }
        }
        2 * on >= total
    }

    /// The depth of the nearest plane at the pixels of regions where it is allowed and near what
    /// was measured of it.
    fn filled(&self, regions: &Regions, allowed: &[Vec<bool>]) -> Vec<Measurement> {
        let mut filled = Vec::new();
        for (index, label) in regions.labels.as_slice().iter().enumerate() {
            let Some(allowed) = allowed.get(*label as usize).filter(|a| !a.is_empty()) else {
                continue;
            };
            let width = regions.labels.width();
            let (x, y) = (index % width, index / width);
            let Some((plane, idepth)) = self.nearest(x as f64, y as f64) else {
                continue;
            };
            if !allowed[plane] {
                continue;
            }
            let plane = &self.planes[plane];
            let point = plane.point([x as f64, y as f64]);
            let sigma = plane.relative_sigma(&point);
            if sigma <= self.max_relative_sigma && plane.is_measured(&point, MAX_EXTENT) {
                let sigma = (sigma * idepth) as f32;
                filled.push(measurement((x, y), idepth as f32, sigma));
            }
        }
        filled
    }
}

/// A pixel with depth on the outline of a region: its place and its inverse depth.
type OutlinePoint = ([f64; 2], f64);

/// What is shown on the outline of each region.
fn outlines(regions: &Regions, shown: &DepthImage) -> Vec<Vec<OutlinePoint>> {
    let mut outlines = vec![Vec::new(); regions.count];
    for (x, y, [idepth, _]) in shown.pixels() {
        for label in regions_beside(regions, x as u16, y as u16) {
            outlines[label as usize].push(([x as f64, y as f64], f64::from(idepth)));
        }
    }
    outlines
}

/// Whether points of an image lie along one line.
pub(super) fn is_line(points: &[[f64; 2]]) -> bool {
    let count = points.len() as f64;
    let middle = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / count);
    let mut scatter = Matrix2::zeros();
    for [x, y] in points {
        let off = Vec2::new(x - middle[0], y - middle[1]);
        scatter += off * off.transpose() / count;
    }
    let [low, high] = scatter.symmetric_eigenvalues().into();
    let (thickness, length) = (low.min(high).max(0.0).sqrt(), low.max(high).max(0.0).sqrt());
    // of less than three points nothing is known
    points.len() < 3 || thickness < f64::max(LINE_PX, LINE_SHARE * length)
}
