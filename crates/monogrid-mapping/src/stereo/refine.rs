//! Depth made better by the images of the keyframes around.

use crate::scene::{Neighbour, PosedKeyframe, Scene, for_each_keyframe};
use crate::{KeyframeCamera, MappingConfig, RefineConfig};
use monogrid_depth::{SourceView, epipolar_misfits, refine_depth};
use monogrid_geometry::Sim3;
use monogrid_geometry::median::median;
use monogrid_image::Image;
use monogrid_slam::DepthPixel;
use std::borrow::Cow;

/// How far the keyframes may be that one is compared with: distance over the median depth, plus
/// the angle of rotation in radians.
const MAX_SEPARATION: f64 = 1.0;

/// The depth of each keyframe, made better by the images of the keyframes around it, whether or not
/// the settings are enabled; as it was where fewer than two of them agree.
///
/// The result does not depend on the number of threads.
#[must_use]
pub fn refined_depths(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &RefineConfig,
    threads: usize,
) -> Vec<Vec<DepthPixel>> {
    let config = MappingConfig {
        refine: config.clone(),
        ..MappingConfig::default()
    };
    let scene = Scene {
        keyframes,
        views: &[],
        camera,
        config: &config,
        threads,
    };
    for_each_keyframe(keyframes.len(), threads, |index| {
        let (pixels, _) = refined(&scene, index, keyframes[index].depth.get());
        pixels.into_owned()
    })
}

/// Depth of a keyframe, and how far its patches are beside epipolar lines, px.
type Refined<'a> = (Cow<'a, [DepthPixel]>, Vec<f32>);

/// Depths of one keyframe, refined by the others; as they were without an image.
pub(crate) fn refined<'a>(
    scene: &Scene,
    index: usize,
    pixels: Cow<'a, [DepthPixel]>,
) -> Refined<'a> {
    let Some(image) = scene.keyframes[index].image() else {
        return (pixels, Vec::new());
    };
    let config = &scene.config.refine;
    let near = scene.sources(&near(scene, index), config.max_keyframes);
    let sources = source_views(&near);
    let (pinhole, stereo) = (&scene.camera.pinhole, &config.stereo);
    let (refined, _) = refine_depth(&image, pinhole, &pixels, &sources, stereo);
    let misfits = epipolar_misfits(&image, pinhole, &refined, &sources, stereo);
    (refined.into(), misfits)
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
    let config = &scene.config.refine;
    let pixels = scene.keyframes[index].depth.get();
    let idepths = pixels.iter().map(|p| p.idepth);
    let known = idepths.filter(|d| *d > 0.0 && d.is_finite());
    let Some(median) = median(&mut known.collect::<Vec<f32>>()).map(f64::from) else {
        return Vec::new();
    };
    scene.neighbours(index, config.max_keyframes, |source_from_keyframe| {
        let center_in_this = source_from_keyframe.inverse().translation;
        let separation = center_in_this.norm() * median + source_from_keyframe.rotation.angle();
        (separation <= MAX_SEPARATION).then_some(separation)
    })
}
