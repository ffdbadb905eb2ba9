//! Depth on large planes, put on them.
//!
//! A plane that many keyframes measured is where the surface is more exactly than a pixel of it.
//! Not every plane is a surface: one through a seat, a table and what lies on it has as many
//! points. What tells them apart is how the points lie about it: close to a surface, and evenly on
//! both sides of what only passes through ([`super::shared::SharedPlane::concentration`]).

use super::shared::{SeenPlane, Surroundings};
use crate::scene::{Depths, Scene};
use monogrid_occupancy::DepthPixel as Measurement;

/// Relative standard deviation of the inverse depth of a plane.
const RELATIVE_SIGMA: f64 = 0.006;
/// How far beyond where a plane was measured depth is put on it, as a share of the range.
const MAX_EXTENT: f64 = 0.03;
/// Share of the standard deviation of a pixel that it has in common with its plane, whose points
/// the same images measured.
const SHARED: f64 = 0.5;
/// Depth agrees with a plane that is off by at most so many standard deviations of both.
const MAX_DEVIATIONS: f64 = 2.0;
/// Share of what lies on a plane that must lie close to it: planes through furniture have less.
const MIN_CONCENTRATION: f64 = 0.7;

/// Depths of a keyframe, those that lie on large planes averaged with them.
pub(super) fn straightened(
    scene: &Scene,
    index: usize,
    mut depths: Depths,
    surroundings: &Surroundings,
) -> Depths {
    let Some(view) = &scene.views[index] else {
        return depths;
    };
    let planes = surroundings.planes.iter();
    let surfaces = planes.filter(|plane| plane.concentration >= MIN_CONCENTRATION);
    let seen = |plane| SeenPlane::new(plane, &view.world_from_keyframe, scene.camera);
    let planes: Vec<SeenPlane> = surfaces.map(seen).collect();
    for pixel in depths.measured.iter_mut().chain(&mut depths.filled) {
        *pixel = on_plane(*pixel, &planes);
    }
    depths
}

/// A pixel averaged with the plane that it agrees with best, if it does with one.
fn on_plane(pixel: Measurement, planes: &[SeenPlane]) -> Measurement {
    let at = [pixel.x.into(), pixel.y.into()];
    let (own, sigma) = (f64::from(pixel.idepth), f64::from(pixel.sigma_idepth));
    let mut best: Option<(f64, f64)> = None;
    for plane in planes {
        let idepth = plane.idepth(at);
        let deviations = (own - idepth).abs() / sigma.hypot(RELATIVE_SIGMA * idepth);
        let is_nearer = best.is_none_or(|(_, least)| deviations < least);
        if idepth > 0.0
            && deviations <= MAX_DEVIATIONS
            && is_nearer
            && plane.is_measured(&plane.point(at), MAX_EXTENT)
        {
            best = Some((idepth, deviations));
        }
    }
    best.map_or(pixel, |(idepth, _)| {
        averaged(pixel, idepth, RELATIVE_SIGMA * idepth)
    })
}

/// The mean of a pixel and its plane, weighed by their variances. What the pixel shares with the
/// plane, an average does not take away.
pub(super) fn averaged(pixel: Measurement, plane: f64, plane_sigma: f64) -> Measurement {
    let (own, sigma) = (f64::from(pixel.idepth), f64::from(pixel.sigma_idepth));
    let (weight, plane_weight) = (sigma.powi(-2), plane_sigma.powi(-2));
    let total = weight + plane_weight;
    let of_mean = total.powf(-0.5);
    Measurement {
        idepth: ((own * weight + plane * plane_weight) / total) as f32,
        sigma_idepth: (SHARED * sigma + (1.0 - SHARED) * of_mean) as f32,
        ..pixel
    }
}
