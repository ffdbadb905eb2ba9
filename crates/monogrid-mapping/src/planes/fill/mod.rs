//! Depth of plain surfaces: planes through the depth around them.
//!
//! A semi-dense depth map knows depth where the image has gradients. Walls, floors and table tops
//! are plain; seen from a robot they are most of a room, and a map without them has neither these
//! surfaces nor the free space before them. What is known is their outline, and what is likely is
//! that they are flat: the inverse depth of a plane is an affine function of the pixel,
//!
//! ```text
//! d(x, y) = a x + b y + c
//! ```
//!
//! Flow: **regions** of weak gradient ([`regions`]) → **planes** through the measurements along the
//! outline of each ([`plane`], sample consensus: outlines also show what stands before the surface)
//! → the planes of the whole image are offered to the regions that found none (tiles of one floor)
//! → each pixel of a region gets the depth of the plane whose outline is nearest inside the region.
//!
//! A plane is believed if most of the outline lies on it or before it. An outline *behind* the
//! plane contradicts it: a plain surface cannot be seen through. What outlines a wall often stands
//! a centimetre or two before it, frames, skirtings and switches, so the surface is the hindmost
//! layer of the points on the plane. It holds inside of the hull of the points of the outline that
//! lie on it ([`hull`]): beyond, nobody has seen that the surface goes on; a wall that is continued
//! behind the next one was most of the false walls. The uncertainty of a filled pixel grows with
//! its distance from the outline as the covariance of the fit says, so far extrapolation fails the
//! same limit as any imprecise measurement.
//!
//! Filled depth is for maps alone: it never enters tracking.

mod hull;
mod plane;
mod regions;

use crate::scene::{at_or, measurement};
use hull::Hull;
use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;
use plane::{Border, FLATNESS, MIN_INLIERS};
pub(crate) use plane::{MAX_BEHIND_SHARE, Plane};
pub(crate) use regions::{MIN_AREA_PX, NO_REGION, Regions};

/// Measurements of the outline that must lie on a plane that another region found.
pub(crate) const MIN_INLIERS_OFFERED: usize = 8;
/// Planes that regions without an own one may choose from.
const MAX_OFFERED: usize = 12;
/// Share of the outline that must lie on a plane that another region found.
const MIN_OFFERED_SHARE: f64 = 0.3;

/// Measurements of the whole image that planes are looked for in, at most.
const MAX_IMAGE_POINTS: usize = 4000;
/// Planes of the whole image, at most.
const MAX_IMAGE_PLANES: u64 = 6;
/// Random triples for each of them.
const MAX_IMAGE_SAMPLES: usize = 300;
/// Share of all measurements on such a plane.
const MIN_IMAGE_SHARE: f64 = 0.05;
/// Where the region of a measurement is looked for: offsets of this many pixels along eight
/// directions.
const BORDER_OFFSETS_PX: [i32; 2] = [2, 5];

/// Depth of the plain regions of a keyframe, at pixels that have none in `measured`.
///
/// `measured` passed the filter; `max_relative_sigma` is the limit of that filter. The result is
/// row-major, in units of the keyframe.
#[must_use]
pub fn fill_plain_regions(
    image: &Image<u8>,
    measured: &[Measurement],
    max_relative_sigma: f64,
) -> Vec<Measurement> {
    let regions = Regions::new(image, measured);
    let borders = borders(&regions, measured);
    let held = planes_of_regions(measured, &borders);
    fill(&regions, &held, max_relative_sigma)
}

/// The measurements along the outline of each region.
fn borders(regions: &Regions, measured: &[Measurement]) -> Vec<Border> {
    let mut borders = vec![Border::default(); regions.count];
    for point in measured {
        for label in regions_beside(regions, point.x, point.y) {
            borders[label as usize].push(point);
        }
    }
    borders
}

/// The regions on whose outline a pixel is. One on the edge between two regions belongs to both.
pub(crate) fn regions_beside(
    regions: &Regions,
    x: u16,
    y: u16,
) -> impl Iterator<Item = u32> + use<> {
    let mut found: [u32; 16] = [NO_REGION; 16];
    let mut num_found = 0;
    let (x, y) = (i32::from(x), i32::from(y));
    for offset in BORDER_OFFSETS_PX {
        for (dx, dy) in EIGHT_DIRECTIONS {
            let label = at_or(&regions.labels, x + dx * offset, y + dy * offset, NO_REGION);
            if label != NO_REGION && !found[..num_found].contains(&label) {
                found[num_found] = label;
                num_found += 1;
            }
        }
    }
    found.into_iter().take(num_found)
}

pub(crate) const EIGHT_DIRECTIONS: [(i32, i32); 8] = [
    (1, 0),
    (-1, 0),
    (0, 1),
    (0, -1),
    (1, 1),
    (1, -1),
    (-1, 1),
    (-1, -1),
];

/// A plane, by which outlines judge, and the surface that it stands for, which lies a little behind
/// where frames and skirtings outline it: judged by that, too little would contradict.
#[derive(Clone, Debug)]
struct Candidate {
    plane: Plane,
    surface: Plane,
}

impl Candidate {
    fn new(plane: Plane, points: &Border) -> Self {
        Self {
            surface: points.surface(&plane),
            plane,
        }
    }
}

/// The surface of each region, and where its outline holds it: its own plane's, or one that is seen
/// in many places, if its outline agrees with that as well as with its own: the tiles of a floor
/// share one plane, the bricks of a wall another.
fn planes_of_regions(measured: &[Measurement], borders: &[Border]) -> Vec<Option<(Plane, Hull)>> {
    let regions = borders.iter().enumerate();
    let own: Vec<Option<Candidate>> = regions
        .map(|(region, border)| {
            let plane = border.fit_plane(region as u64)?;
            Some(Candidate::new(plane, border))
        })
        .collect();
    let image = some_of(measured);
    let mut pool: Vec<Candidate> = planes_of_image(measured)
        .into_iter()
        .map(|plane| Candidate::new(plane, &image))
        .collect();
    pool.extend(own.iter().flatten().cloned());
    // the best supported first; equal support in the order of the regions
    pool.sort_by_key(|candidate| std::cmp::Reverse(candidate.plane.inliers));
    pool.truncate(MAX_OFFERED);
    let borders = borders.iter().zip(&own);
    borders
        .map(|(border, own)| {
            let own_score = own
                .as_ref()
                .map_or(0, |own| border.count(&own.plane).score());
            let best = pool
                .iter()
                .map(|offered| (border.count(&offered.plane), offered))
                .filter(|(count, _)| count.is_believable(MIN_INLIERS_OFFERED, MIN_OFFERED_SHARE))
                // the first of equal ones
                .rev()
                .max_by_key(|(count, _)| count.score())
                .filter(|(count, _)| 5 * count.score() >= 4 * own_score);
            let best = best.map(|(_, offered)| offered).or(own.as_ref())?;
            let hull = Hull::new(border.points_on(&best.surface));
            Some((best.surface.clone(), hull))
        })
        .collect()
}

/// Measurements of the whole image, evenly spread.
fn some_of(measured: &[Measurement]) -> Border {
    let stride = measured.len().div_ceil(MAX_IMAGE_POINTS).max(1);
    let mut some = Border::default();
    for point in measured.iter().step_by(stride) {
        some.push(point);
    }
    some
}

/// Planes that much of the whole image lies on, one after the other.
pub(crate) fn planes_of_image(measured: &[Measurement]) -> Vec<Plane> {
    let mut left = some_of(measured);
    let min_inliers = (left.len() as f64 * MIN_IMAGE_SHARE) as usize;
    let next = |round| {
        let plane = left.take_best_plane(round, MAX_IMAGE_SAMPLES)?;
        (plane.inliers >= min_inliers.max(MIN_INLIERS)).then_some(plane)
    };
    (0..MAX_IMAGE_PLANES).map_while(next).collect()
}

/// The depth of all pixels of the regions that have a plane, where its outline holds it and it is
/// certain enough.
fn fill(
    regions: &Regions,
    planes: &[Option<(Plane, Hull)>],
    max_relative_sigma: f64,
) -> Vec<Measurement> {
    let mut filled = Vec::new();
    for y in 0..regions.labels.height() {
        let held: Vec<Option<(&Plane, (f64, f64))>> = planes
            .iter()
            .map(|held| {
                let (plane, hull) = held.as_ref()?;
                Some((plane, hull.columns(y as f64)?))
            })
            .collect();
        for (x, label) in regions.labels.row(y).iter().enumerate() {
            let Some(Some((plane, (first, last)))) = held.get(*label as usize) else {
                continue;
            };
            let (idepth, fit_sigma) = plane.at(x as f64, y as f64);
            let sigma = (fit_sigma.powi(2) + (FLATNESS * idepth).powi(2)).sqrt();
            let is_held = (*first..=*last).contains(&(x as f64));
            if is_held && idepth > 0.0 && sigma <= max_relative_sigma * idepth {
                filled.push(measurement((x, y), idepth as f32, sigma as f32));
            }
        }
    }
    filled
}

#[cfg(test)]
mod tests;
