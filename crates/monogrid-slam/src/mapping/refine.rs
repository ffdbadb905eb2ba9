//! Better depth of all keyframes, when the poses are known in the end.

use super::{KeyframeCamera, KeyframeScan, MappingConfig, RefineConfig};
use crate::{DepthPixel, KeyframeId};
use monogrid_depth::{PixelDepth, SourceView, refine_depth};
use monogrid_geometry::Sim3;
use monogrid_image::Image;
use std::thread;

/// A finished keyframe, with its final pose where it is known.
#[derive(Clone, Copy, Debug)]
pub struct PosedKeyframe<'a> {
    /// Identity.
    pub id: KeyframeId,
    /// Its image; without one it is mapped as it was measured.
    pub image: Option<&'a Image<u8>>,
    /// Its depth, row-major, in its own units.
    pub pixels: &'a [DepthPixel],
    /// Its pose in a world that all share.
    pub world_from_keyframe: Option<Sim3>,
}

/// What of each keyframe is mapped: its depth, made better by the images of the keyframes around it if
/// the settings ask for it ([`monogrid_depth::refine_depth`]), filtered and filled as
/// [`KeyframeScan::new`] does.
///
/// The result does not depend on the number of threads.
#[must_use]
pub fn final_scans(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
) -> Vec<KeyframeScan> {
    let threads = threads.clamp(1, keyframes.len().max(1));
    let scan = |index: usize| {
        let keyframe = &keyframes[index];
        let refined;
        let pixels = if config.refine.enabled {
            refined = refined_pixels(keyframes, index, camera, &config.refine);
            &refined
        } else {
            keyframe.pixels
        };
        KeyframeScan::new(keyframe.id, pixels, keyframe.image, camera, config)
    };
    let of_thread = |thread: usize| -> Vec<KeyframeScan> {
        (thread..keyframes.len())
            .step_by(threads)
            .map(scan)
            .collect()
    };
    // keyframes in turn: neighbours cost about the same
    let mut parts: Vec<std::vec::IntoIter<KeyframeScan>> = thread::scope(|scope| {
        let others: Vec<_> = (1..threads)
            .map(|thread| scope.spawn(move || of_thread(thread)))
            .collect();
        let first = of_thread(0);
        std::iter::once(first)
            .chain(others.into_iter().enumerate().map(|(i, other)| {
                // a thread that failed: its share again, here
                other.join().unwrap_or_else(|_| of_thread(i + 1))
            }))
            .map(Vec::into_iter)
            .collect()
    });
    (0..keyframes.len())
        .filter_map(|index| parts[index % threads].next())
        .collect()
}

/// The depth of one keyframe, refined by the others; as it was without pose or image.
fn refined_pixels(
    keyframes: &[PosedKeyframe],
    index: usize,
    camera: &KeyframeCamera,
    config: &RefineConfig,
) -> Vec<DepthPixel> {
    let keyframe = &keyframes[index];
    let Some(image) = keyframe.image else {
        return keyframe.pixels.to_vec();
    };
    let sources = sources(keyframes, index, config);
    let pixels: Vec<PixelDepth> = keyframe
        .pixels
        .iter()
        .map(|pixel| PixelDepth {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            idepth_var: pixel.idepth_var,
            validity: 0,
        })
        .collect();
    let (refined, _) = refine_depth(image, &camera.pinhole, &pixels, &sources, &config.stereo);
    refined
        .into_iter()
        .map(|pixel| DepthPixel {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            idepth_var: pixel.idepth_var,
        })
        .collect()
}

/// The nearest keyframes with image and pose, nearest first.
fn sources<'a>(
    keyframes: &[PosedKeyframe<'a>],
    index: usize,
    config: &RefineConfig,
) -> Vec<SourceView<'a>> {
    let this = &keyframes[index];
    let (Some(world_from_this), Some(median)) =
        (this.world_from_keyframe, median_idepth(this.pixels))
    else {
        return Vec::new();
    };
    let mut near: Vec<(f64, SourceView)> = keyframes
        .iter()
        .enumerate()
        .filter(|(other, _)| *other != index)
        .filter_map(|(_, other)| {
            let source_from_keyframe = other.world_from_keyframe?.inverse() * world_from_this;
            let center_in_this = source_from_keyframe.inverse().translation;
            let separation = center_in_this.norm() * median + source_from_keyframe.rotation.angle();
            let source = SourceView {
                image: other.image?,
                source_from_keyframe,
            };
            (separation <= config.max_separation).then_some((separation, source))
        })
        .collect();
    // stable: equal ones in the order of the keyframes
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(config.max_keyframes);
    near.into_iter().map(|(_, source)| source).collect()
}

fn median_idepth(pixels: &[DepthPixel]) -> Option<f64> {
    let mut idepths: Vec<f32> = pixels
        .iter()
        .map(|p| p.idepth)
        .filter(|d| *d > 0.0 && d.is_finite())
        .collect();
    let middle = idepths.len() / 2;
    (!idepths.is_empty())
        .then(|| f64::from(*idepths.select_nth_unstable_by(middle, f32::total_cmp).1))
}
