//! Depth made better by the images of the keyframes around.

use crate::scene::{Neighbour, PosedKeyframe, Scene, for_each_keyframe};
use crate::{KeyframeCamera, MappingConfig};
use monogrid_depth::{MultiViewConfig, SourceView, refine_depth};
use monogrid_geometry::Sim3;
use monogrid_geometry::median::median;
use monogrid_image::Image;
use monogrid_slam::DepthPixel;
use std::borrow::Cow;

/// Keyframes that one is compared with, the nearest.
const MAX_KEYFRAMES: usize = 8;
/// How far the keyframes may be that one is compared with: distance over the median depth, plus
/// the angle of rotation in radians.
const MAX_SEPARATION: f64 = 1.0;

/// The depth of each keyframe, made better by the images of the keyframes around it; as it was
/// where fewer than two of them agree.
///
/// The result does not depend on the number of threads.
#[must_use]
pub fn refined_depths(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    threads: usize,
) -> Vec<Vec<DepthPixel>> {
    let scene = Scene {
        keyframes,
        views: &[],
        camera,
        config: &MappingConfig::default(),
        threads,
    };
    for_each_keyframe(keyframes.len(), threads, |index| {
        refined(&scene, index, keyframes[index].depth.get()).into_owned()
    })
}

/// Depths of one keyframe, refined by the others; as they were without an image.
pub(crate) fn refined<'a>(
    scene: &Scene,
    index: usize,
    pixels: Cow<'a, [DepthPixel]>,
) -> Cow<'a, [DepthPixel]> {
    let Some(image) = scene.keyframes[index].image() else {
        return pixels;
    };
    let near = scene.sources(&near(scene, index));
    let (pinhole, stereo) = (&scene.camera.pinhole, MultiViewConfig::default());
    let (refined, _) = refine_depth(&image, pinhole, &pixels, &source_views(&near), &stereo);
    refined.into()
}

/// Images, with `source_from_keyframe`, as stereo takes them.
pub(crate) fn source_views<'a>(images: &'a [(Cow<'_, Image<u8>>, Sim3)]) -> Vec<SourceView<'a>> {
    let view = |(image, source_from_keyframe): &'a (Cow<'_, Image<u8>>, Sim3)| SourceView {
        image: image.as_ref(),
        source_from_keyframe: *source_from_keyframe,
    };
    images.iter().map(view).collect()
}

/// The nearest keyframes with image and pose, nearest first.
fn near(scene: &Scene, index: usize) -> Vec<Neighbour> {
    let pixels = scene.keyframes[index].depth.get();
    let idepths = pixels.iter().map(|p| p.idepth);
    let known = idepths.filter(|d| *d > 0.0 && d.is_finite());
    let Some(median) = median(&mut known.collect::<Vec<f32>>()).map(f64::from) else {
        return Vec::new();
    };
    scene.neighbours(index, MAX_KEYFRAMES, |source_from_keyframe| {
        let center_in_this = source_from_keyframe.inverse().translation;
        let separation = center_in_this.norm() * median + source_from_keyframe.rotation.angle();
        (separation <= MAX_SEPARATION).then_some(separation)
    })
}
