//! How points look in the keyframes that see them, for an adjustment to the images themselves.

use super::ImageAdjustmentConfig;
use crate::KeyframeId;
use crate::map::Map;
use monogrid_features::{PhotometricCost, PhotometricCostConfig, patch_warp};
use monogrid_geometry::{Pinhole, Vec2};
use monogrid_graph::bundle::{Appearance, BundleProblem, Observation, PixelSlope};
use monogrid_image::Image;

/// Side of the piece of an image around the place of a point, px: a patch of eight with its border
/// may move by two and a half.
const SIDE: usize = 16;

/// The patches of the points of a problem, and what keyframes show where they see them.
#[derive(Debug)]
pub(super) struct Looks {
    /// By observation; none where the keyframe does not show what the anchor shows.
    looks: Vec<Option<Look>>,
    config: PhotometricCostConfig,
}

/// A point in a keyframe.
#[derive(Debug)]
struct Look {
    photometric: PhotometricCost,
    /// The keyframe's image around the point; all images at once would not fit.
    piece: Image<u8>,
    /// The pixel of the image that is the first of the piece.
    corner: Vec2,
}

impl Looks {
    /// Patches as the poses and depths of a problem warp them. `keyframes` and `points` are the
    /// identities behind its indices.
    pub fn new(
        map: &Map,
        problem: &BundleProblem,
        (keyframes, points): (&[KeyframeId], &[usize]),
        config: &ImageAdjustmentConfig,
    ) -> Self {
        let observations = &problem.observations;
        let mut costs: Vec<Option<PhotometricCost>> = vec![None; observations.len()];
        let host = |o: &Observation| problem.points[o.point].host;
        for (host, seen) in by_keyframe(observations, host) {
            let Some(pyramid) = map[keyframes[host]].pyramid() else {
                continue;
            };
            for i in seen {
                let (point, observer) = (observations[i].point, observations[i].keyframe);
                let anchor = &problem.points[point];
                let pose = |k: usize| problem.keyframes[k].camera_from_world;
                let observer_from_host = pose(observer) * pose(host).inverse();
                let (pixel, idepth) = (&anchor.pixel, anchor.inverse_depth);
                let warp = patch_warp(&problem.pinhole, pixel, idepth, &observer_from_host);
                let pixel_in_image = &map.points()[points[point]].pixel;
                costs[i] = warp.and_then(|w| PhotometricCost::new(&pyramid, pixel_in_image, &w));
            }
        }
        let mut looks: Vec<Option<Look>> = observations.iter().map(|_| None).collect();
        for (observer, seen) in by_keyframe(observations, |o| o.keyframe) {
            let Some(image) = map[keyframes[observer]].image.grey() else {
                continue;
            };
            for i in seen {
                let (photometric, place) = (costs[i].take(), projected(problem, i));
                looks[i] = photometric
                    .zip(place)
                    .and_then(|(photometric, place)| Look::new(photometric, &image, place, config));
            }
        }
        Self {
            looks,
            config: config.photometric_cost(),
        }
    }
}

impl Look {
    /// A patch in an image, where a point is projected to; `None` where the image shows something
    /// else.
    fn new(
        photometric: PhotometricCost,
        image: &Image<u8>,
        place: Vec2,
        config: &ImageAdjustmentConfig,
    ) -> Option<Self> {
        let half = 0.5 * (SIDE as f64 - 1.0);
        let corner = (place - Vec2::repeat(half)).map(f64::round);
        let fits = |at: f64, size: usize| at >= 0.0 && at + SIDE as f64 <= size as f64;
        // NaN does not fit
        if !fits(corner.x, image.width()) || !fits(corner.y, image.height()) {
            return None;
        }
        let (left, top) = (corner.x as usize, corner.y as usize);
        let piece = Image::from_fn(SIDE, SIDE, |x, y| image.at(left + x, top + y));
        let correlation = photometric.correlation(&piece, &(place - corner))?;
        (correlation >= config.min_correlation).then_some(Self {
            photometric,
            piece,
            corner,
        })
    }
}

impl Appearance for Looks {
    fn cost(&self, observation: usize, pixel: &Vec2) -> f64 {
        let Some(look) = &self.looks[observation] else {
            return 0.0;
        };
        let pixel = pixel - look.corner;
        let cost = look.photometric.cost(&look.piece, &pixel, &self.config);
        // nothing is gained by leaving the piece
        cost.unwrap_or_else(|| self.config.largest_cost())
    }

    fn slope(&self, observation: usize, pixel: &Vec2) -> Option<PixelSlope> {
        let look = self.looks[observation].as_ref()?;
        let pixel = pixel - look.corner;
        let slope = look.photometric.slope(&look.piece, &pixel, &self.config)?;
        Some(PixelSlope {
            gradient: slope.gradient,
            information: slope.information,
        })
    }
}

/// The observations with the same keyframe together, by it.
fn by_keyframe(
    observations: &[Observation],
    keyframe: impl Fn(&Observation) -> usize,
) -> Vec<(usize, Vec<usize>)> {
    let mut order: Vec<usize> = (0..observations.len()).collect();
    order.sort_by_key(|i| keyframe(&observations[*i]));
    let same = |a: &usize, b: &usize| keyframe(&observations[*a]) == keyframe(&observations[*b]);
    let seen_by = |seen: &[usize]| (keyframe(&observations[seen[0]]), seen.to_vec());
    order.chunk_by(same).map(seen_by).collect()
}

/// Where the point of an observation is projected to.
fn projected(problem: &BundleProblem, observation: usize) -> Option<Vec2> {
    let observation = &problem.observations[observation];
    let point = &problem.points[observation.point];
    let pose = |k: usize| &problem.keyframes[k].camera_from_world;
    let in_host = problem.pinhole.unproject(&point.pixel) / point.inverse_depth;
    let in_observer = *pose(observation.keyframe) * (pose(point.host).inverse() * in_host);
    (in_observer.z > Pinhole::MIN_DEPTH).then(|| problem.pinhole.project(&in_observer))
}

#[cfg(test)]
mod tests;
