//! Dense depth of the keyframes at the final poses: stereo with the keyframes that see the same
//! from beside, then what these confirm of it, then one list of depths with those of the filter.

use super::refine::source_views;
use crate::KeyframeCamera;
use crate::scene::{DepthImage, Neighbour, Scene};
use monogrid_depth::{DenseDepth, SupportingView, dense_depth};
use monogrid_geometry::{Sim3, Vec2, Vec3};
use monogrid_image::Image;
use monogrid_slam::DepthPixel;
use std::sync::Arc;

/// Angle between lines of sight under which two keyframes see the same points at best, degrees.
const BEST_ANGLE_DEG: f64 = 8.0;

/// Depths of a keyframe by which its neighbours are judged, at most.
const MAX_PROBES: usize = 200;
/// Points that are seen this near to the border of an image count as outside, px.
const BORDER_PX: f64 = 8.0;
/// Neighbours below this usefulness are none.
const MIN_USEFULNESS: f64 = 0.1;
/// How fast usefulness falls below and above the best angle, as shares of it.
const ANGLE_WIDTHS: [f64; 2] = [0.5, 1.25];

/// What of the dense depth of one keyframe that of its neighbours confirms; `depth` is that of
/// each, as it was matched.
pub(crate) fn confirmed(
    scene: &Scene,
    index: usize,
    depth: impl Fn(usize) -> Option<Arc<DenseDepth>>,
) -> Option<DenseDepth> {
    let effort = scene.config.quality.effort();
    let own = depth(index)?;
    let neighbours = neighbours(scene, index, effort.max_confirming).into_iter();
    let seen: Vec<(Arc<DenseDepth>, Sim3)> = neighbours
        .filter_map(|other| Some((depth(other.index)?, other.neighbour_from_keyframe)))
        .collect();
    let supporting = seen
        .iter()
        .map(|(depth, view_from_keyframe)| SupportingView {
            depth,
            view_from_keyframe: *view_from_keyframe,
        });
    let supporting: Vec<SupportingView> = supporting.collect();
    Some(own.agreed(&supporting, &scene.camera.pinhole, &effort.stereo))
}

/// The dense depth of one keyframe by its neighbours.
pub(crate) fn stereo(scene: &Scene, index: usize) -> Option<DenseDepth> {
    let effort = scene.config.quality.effort();
    let near = scene.sources(&neighbours(scene, index, effort.max_sources));
    let keyframe = &scene.keyframes[index];
    dense_depth(
        &*keyframe.image()?,
        &scene.camera.pinhole,
        &keyframe.depth.get(),
        &source_views(&near),
        &effort.stereo,
    )
}

/// The keyframes with an image that are most useful for the depth of another one, the best first.
fn neighbours(scene: &Scene, index: usize, most: usize) -> Vec<Neighbour> {
    let camera = scene.camera;
    let points = probes(&scene.keyframes[index].depth.get(), camera);
    scene.neighbours(index, most, |neighbour_from_keyframe| {
        let usefulness = usefulness(&points, neighbour_from_keyframe, camera);
        (usefulness >= MIN_USEFULNESS).then_some(-usefulness)
    })
}

/// Some points that a keyframe sees, in its frame.
fn probes(pixels: &[DepthPixel], camera: &KeyframeCamera) -> Vec<Vec3> {
    let stride = pixels.len().div_ceil(MAX_PROBES).max(1);
    let known = |p: &&DepthPixel| p.idepth > 0.0 && p.idepth.is_finite();
    let pixels = pixels.iter().step_by(stride).filter(known);
    pixels
        .map(|p| {
            let ray = camera.pinhole.unproject(&Vec2::new(p.x.into(), p.y.into()));
            ray / f64::from(p.idepth)
        })
        .collect()
}

/// Mean over points of how well a neighbour measures their depth: 1 at the best angle between the
/// lines of sight (under smaller ones depth is imprecise, under larger ones images differ), 0 where
/// it does not see them.
fn usefulness(points: &[Vec3], neighbour_from_keyframe: &Sim3, camera: &KeyframeCamera) -> f64 {
    let centre = neighbour_from_keyframe.inverse().translation;
    let of_point = |point: &Vec3| {
        let seen = *neighbour_from_keyframe * *point;
        if !is_in_view(&seen, camera) {
            return 0.0;
        }
        let off = point.angle(&(point - centre)).to_degrees() / BEST_ANGLE_DEG - 1.0;
        let width = ANGLE_WIDTHS[usize::from(off > 0.0)];
        (-0.5 * (off / width).powi(2)).exp()
    };
    points.iter().map(of_point).sum::<f64>() / points.len().max(1) as f64
}

/// Whether a point in the frame of a keyframe is well within its image.
fn is_in_view(point: &Vec3, camera: &KeyframeCamera) -> bool {
    if point.z <= 1e-9 {
        return false;
    }
    let at = camera.pinhole.project(point);
    at.x >= BORDER_PX
        && at.y >= BORDER_PX
        && at.x <= camera.width as f64 - 1.0 - BORDER_PX
        && at.y <= camera.height as f64 - 1.0 - BORDER_PX
}

/// The depth of a keyframe by its filter and by dense stereo, row-major: fused where they agree
/// within two standard deviations, else the dense one, which other keyframes have confirmed.
pub(crate) fn merged(
    filter: &[DepthPixel],
    dense: &DenseDepth,
    camera: &KeyframeCamera,
) -> Vec<DepthPixel> {
    let mut depths = DepthImage::new(camera);
    for pixel in filter {
        let depth = [pixel.idepth, pixel.idepth_var];
        depths.set(pixel.x.into(), pixel.y.into(), depth);
    }
    for y in 0..2 * dense.idepth.height() {
        for x in 0..2 * dense.idepth.width() {
            if let Some(idepth) = dense.at_full_size(x, y) {
                let variance = dense.sigma.at(x / 2, y / 2).powi(2);
                depths.set(x, y, fused(depths.at(x, y), idepth, variance));
            }
        }
    }
    let pixel = |(x, y, [idepth, idepth_var]): (usize, usize, [f32; 2])| DepthPixel {
        x: x as u16,
        y: y as u16,
        idepth,
        idepth_var,
    };
    depths.pixels().map(pixel).collect()
}

/// Dense depth with that of the filter. Both come from the same images, so that the variance is the
/// smaller one.
fn fused(filter: Option<[f32; 2]>, idepth: f32, variance: f32) -> [f32; 2] {
    match filter {
        Some([before, before_variance])
            if (idepth - before).powi(2) <= 4.0 * (variance + before_variance) =>
        {
            let weight = variance / (variance + before_variance);
            let mean = idepth + weight * (before - idepth);
            [mean, variance.min(before_variance)]
        }
        _ => [idepth, variance],
    }
}

/// Relative standard deviation below which no depth that images alone give is published: they share
/// errors of 1.8 %.
const MEASURED_SIGMA: f32 = 0.017;
/// Share of the pixels of an image with such depth from which a depth camera measured it.
const MEASURED_SHARE: f64 = 0.5;

/// Whether the depth of a keyframe is that of a depth camera, of which images can tell no more.
pub(crate) fn is_measured(pixels: &[DepthPixel], camera: &KeyframeCamera) -> bool {
    let is_certain = |p: &&DepthPixel| p.idepth_var <= (MEASURED_SIGMA * p.idepth).powi(2);
    let certain = pixels.iter().filter(is_certain).count();
    certain as f64 >= MEASURED_SHARE * (camera.width * camera.height) as f64
}

/// Depth of a keyframe at half the size: of each four pixels the nearest.
pub(crate) fn half_size(pixels: &[DepthPixel], camera: &KeyframeCamera) -> DenseDepth {
    let (width, height) = (camera.width / 2, camera.height / 2);
    let mut half = DenseDepth {
        idepth: Image::filled(width, height, 0.0),
        sigma: Image::filled(width, height, 0.0),
    };
    for pixel in pixels {
        let (x, y) = (usize::from(pixel.x) / 2, usize::from(pixel.y) / 2);
        if x < width && y < height && pixel.idepth > half.idepth.at(x, y) {
            half.idepth.set(x, y, pixel.idepth);
            half.sigma.set(x, y, pixel.idepth_var.sqrt());
        }
    }
    half
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DepthOf, ImageOf, MappingConfig, PosedKeyframe};
    use monogrid_geometry::{Pinhole, Rotation};

    const CAMERA: KeyframeCamera = KeyframeCamera {
        pinhole: Pinhole {
            fx: 100.0,
            fy: 100.0,
            cx: 49.5,
            cy: 39.5,
        },
        width: 100,
        height: 80,
    };

    fn half(idepth: f32) -> DenseDepth {
        DenseDepth {
            idepth: Image::filled(50, 40, idepth),
            sigma: Image::filled(50, 40, 0.01 * idepth),
        }
    }

    #[test]
    fn neighbours_are_those_that_see_the_same_under_a_good_angle() {
        let image = Image::filled(CAMERA.width, CAMERA.height, 0_u8);
        let pixels: Vec<DepthPixel> = (0..80)
            .map(|i| DepthPixel {
                x: i,
                y: i,
                idepth: 0.5,
                idepth_var: 1e-4,
            })
            .collect();
        // in order: itself, too near, 8 degrees, 16 degrees, out of sight, behind
        let places = [0.0, 0.02, 0.28, 0.56, 4.0];
        let mut keyframes: Vec<PosedKeyframe> = places
            .iter()
            .enumerate()
            .map(|(i, x)| PosedKeyframe {
                id: i as u32,
                image: Some(ImageOf::Held(&image)),
                depth: DepthOf::Held(&pixels),
                world_from_keyframe: Some(Sim3::new(
                    1.0,
                    Rotation::identity(),
                    Vec3::new(*x, 0.0, 0.0),
                )),
            })
            .collect();
        let order = |keyframes: &[PosedKeyframe], max| -> Vec<usize> {
            let config = MappingConfig::default();
            let scene = Scene {
                keyframes,
                views: &[],
                camera: &CAMERA,
                config: &config,
                threads: 1,
            };
            let found = neighbours(&scene, 0, max);
            found.iter().map(|n| n.index).collect()
        };
        assert_eq!(order(&keyframes, 9), [2, 3, 1]);
        assert_eq!(order(&keyframes, 1), [2]);
        keyframes[2].image = None;
        keyframes[3].world_from_keyframe = None;
        assert_eq!(order(&keyframes, 9), [1]);
    }

    #[test]
    fn dense_depth_joins_agreeing_depth_of_the_filter_and_replaces_other() {
        let pixel = |x, idepth| DepthPixel {
            x,
            y: 10,
            idepth,
            idepth_var: 1e-4,
        };
        let all = merged(&[pixel(20, 0.51), pixel(30, 0.7)], &half(0.5), &CAMERA);
        assert_eq!(all.len(), CAMERA.width * CAMERA.height);
        let at = |x: usize| all[10 * CAMERA.width + x].idepth;
        assert!(at(20) > 0.5 && at(20) < 0.505 && (at(30) - 0.5).abs() < 1e-6);
        let filter = [pixel(20, 0.51)];
        assert_eq!(merged(&filter, &half(0.0), &CAMERA), filter);
    }
}
