//! Better depth of all keyframes, when the poses are known in the end: they take the `stages`
//! together. And depth made better by the images of the keyframes around.

use super::certainty::Certainty;
use super::dense::neighbours;
use super::posed::{Neighbour, PosedKeyframe, Scene};
use super::stages::{Found, agreed, completed, found, mapped, matched};
use super::view::View;
use super::{KeyframeCamera, KeyframeScan, MappingConfig, RefineConfig};
use crate::DepthPixel;
use crate::fault;
use crate::median::median;
use crate::store::Store;
use monogrid_depth::{PixelDepth, SourceView, epipolar_misfits, refine_depth};
use monogrid_geometry::Sim3;
use monogrid_image::Image;
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How far the keyframes may be that one is compared with: distance over the median depth, plus
/// the angle of rotation in radians.
const MAX_SEPARATION: f64 = 1.0;

/// What of each keyframe is mapped: its depth, with dense depth ([`monogrid_depth::dense_depth`])
/// and made better by the images of the keyframes around it ([`monogrid_depth::refine_depth`]) if
/// the settings ask for it, filtered and filled as [`KeyframeScan::new`] does.
///
/// The result does not depend on the number of threads.
#[must_use]
pub fn final_scans(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
) -> Vec<KeyframeScan> {
    let rest = (&Store::default(), &AtomicUsize::new(0));
    final_scans_of(keyframes, camera, config, threads, rest)
}

/// As [`final_scans`], of keyframes that lie where there is room, and so do the scans, in the
/// store; `done` grows with every keyframe, for those who wait.
pub(crate) fn final_scans_of(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
    (store, done): (&Store, &AtomicUsize),
) -> Vec<KeyframeScan> {
    let config = &*config.at_its_quality();
    let scene = Scene {
        keyframes,
        views: &[],
        camera,
        config,
        threads,
    };
    let count = keyframes.len();
    let is_dense = config.quality.has_dense_depth();
    let neighbours = for_each_keyframe(count, threads, |index| match is_dense {
        true => neighbours(&scene, index),
        false => Vec::new(),
    });
    let dense = for_each_keyframe(count, threads, |index| match is_dense {
        true => matched(&scene, index, &neighbours[index], store),
        false => None,
    });
    let found = for_each_keyframe(count, threads, |index| {
        let dense = |index: usize| dense[index].as_ref()?.get();
        let found = found(&scene, index, &neighbours[index], dense, store);
        done.fetch_add(1, Ordering::Relaxed);
        found
    });
    drop(dense);
    let views = views_of(&found, |found| found);
    let seen = scene.seeing(&views);
    let certainty = Certainty::of_scene(&seen);
    let agreed = for_each_keyframe(count, threads, |index| {
        agreed(&seen, &found[index], index, certainty)
    });
    drop((views, found));
    let views = views_of(&agreed, |agreed| agreed);
    let seen = scene.seeing(&views);
    let completed = for_each_keyframe(count, threads, |index| {
        completed(&seen, &agreed[index], index)
    });
    drop((views, agreed));
    let views = views_of(&completed, |completed| &completed.found);
    let seen = scene.seeing(&views);
    for_each_keyframe(count, threads, |index| {
        let cloud = |index: usize| Some(&completed.get(index)?.cloud);
        mapped(&seen, &completed[index], index, cloud)
    })
}

/// Keyframes as others see them.
fn views_of<T>(all: &[T], found: impl Fn(&T) -> &Found) -> Vec<Option<View>> {
    all.iter().map(|this| found(this).view.clone()).collect()
}

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

/// Results of independent work in their order, on the threads of the pool if on several: each takes
/// the next that nobody has begun, so that those under way are neighbours, which share what is in
/// memory.
pub(super) fn for_each_keyframe<T: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> T + Sync,
) -> Vec<T> {
    let result = |index| {
        fault::pass("depth");
        (index, work(index))
    };
    let mut results: Vec<(usize, T)> = match threads {
        0 | 1 => (0..count).map(result).collect(),
        _ => (0..count).par_bridge().map(result).collect(),
    };
    results.sort_unstable_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Depth of a keyframe, and how far its patches are beside epipolar lines, px.
type Refined<'a> = (Cow<'a, [DepthPixel]>, Vec<f32>);

/// Depths of one keyframe, refined by the others; as they were without an image.
pub(super) fn refined<'a>(
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
    let (refined, _) = refine_depth(&image, pinhole, &seeds(&pixels), &sources, stereo);
    let misfits = epipolar_misfits(&image, pinhole, &refined, &sources, stereo);
    let pixel = |pixel: PixelDepth| DepthPixel {
        x: pixel.x,
        y: pixel.y,
        idepth: pixel.idepth,
        idepth_var: pixel.idepth_var,
    };
    (refined.into_iter().map(pixel).collect(), misfits)
}

/// Depth as stereo takes it.
pub(super) fn seeds(pixels: &[DepthPixel]) -> Vec<PixelDepth> {
    let seed = |pixel: &DepthPixel| PixelDepth {
        x: pixel.x,
        y: pixel.y,
        idepth: pixel.idepth,
        idepth_var: pixel.idepth_var,
        validity: 0,
    };
    pixels.iter().map(seed).collect()
}

/// Images, with `source_from_keyframe`, as stereo takes them.
pub(super) fn source_views<'a>(images: &'a [(Cow<'_, Image<u8>>, Sim3)]) -> Vec<SourceView<'a>> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KeyframeId;
    use crate::MemoryConfig;
    use crate::mapping::test_wall::{CAMERA, depths, share_right, wall};
    use crate::mapping::{DepthOf, FillConfig, FusionConfig, ImageOf, MapQuality};
    use monogrid_geometry::{Rotation, Vec3};

    fn config() -> MappingConfig {
        MappingConfig {
            quality: MapQuality::Fast,
            sigma_from_agreement: false,
            fusion: FusionConfig { max_witnesses: 0 },
            fill: FillConfig { enabled: false },
            ..MappingConfig::default()
        }
    }

    #[test]
    fn keyframes_make_each_other_better_whatever_their_units_and_the_threads() {
        let places = [(0.0, 1.0), (0.35, 1.2), (-0.35, 0.7), (0.6, 1.0)];
        let images = places.map(|(x, _)| wall(x));
        let pixels = places.map(|(_, scale)| depths(scale));
        let mut keyframes: Vec<PosedKeyframe> = (0..4)
            .map(|i| PosedKeyframe {
                id: i as KeyframeId,
                image: Some(ImageOf::Held(&images[i])),
                depth: DepthOf::Held(&pixels[i]),
                world_from_keyframe: Some(Sim3::new(
                    places[i].1,
                    Rotation::identity(),
                    Vec3::new(places[i].0, 0.0, 0.0),
                )),
            })
            .collect();
        let scans = final_scans(&keyframes, &CAMERA, &config(), 1);
        for threads in [2, 3, 9] {
            assert_eq!(final_scans(&keyframes, &CAMERA, &config(), threads), scans);
        }
        for (i, scan) in scans.iter().enumerate() {
            assert_eq!(scan.id, i as KeyframeId);
            // the others have no gradient along their epipolar lines, or are out of view
            let share = share_right(scan, places[i].1);
            assert!(share > 0.25, "keyframe {i}: {share}");
        }
        // a keyframe that nobody knows the place of neither gets nor gives
        keyframes[1].world_from_keyframe = None;
        keyframes[2].image = None;
        let without = final_scans(&keyframes, &CAMERA, &config(), 2);
        for (scan, (_, scale)) in without.iter().zip(places) {
            // for the other two, one source is not enough
            assert!(share_right(scan, scale) <= 0.0);
        }
        // and none does if it is switched off
        let mut off = config();
        off.refine.enabled = false;
        keyframes[2].image = Some(ImageOf::Held(&images[2]));
        for (keyframe, scan) in keyframes
            .iter()
            .zip(final_scans(&keyframes, &CAMERA, &off, 2))
        {
            let (pixels, image) = (keyframe.depth.get(), keyframe.image());
            let alone = KeyframeScan::new(keyframe.id, &pixels, image.as_deref(), &CAMERA, &off);
            assert_eq!(scan, alone);
        }
    }

    #[test]
    fn dense_depth_covers_what_the_filter_does_not_have_on_any_number_of_threads() {
        let places = [0.0, 0.2, -0.2, 0.35, -0.35];
        let images = places.map(wall);
        // the filter knows every ninth pixel
        let mut pixels = depths(1.0);
        pixels.retain(|p| p.x % 3 == 0 && p.y % 3 == 0);
        let keyframes: Vec<PosedKeyframe> = places
            .iter()
            .zip(&images)
            .enumerate()
            .map(|(i, (x, image))| PosedKeyframe {
                id: i as KeyframeId,
                image: Some(ImageOf::Held(image)),
                depth: DepthOf::Held(&pixels),
                world_from_keyframe: Some(Sim3::new(
                    1.0,
                    Rotation::identity(),
                    Vec3::new(*x, 0.0, 0.0),
                )),
            })
            .collect();
        let dense = MappingConfig {
            quality: MapQuality::Default,
            ..config()
        };
        let scans = final_scans(&keyframes, &CAMERA, &dense, 1);
        assert_eq!(final_scans(&keyframes, &CAMERA, &dense, 3), scans);
        let no_room = Store::new(&MemoryConfig {
            keyframes_mb: 0.0,
            prepared_mb: 0.0,
        });
        no_room.spill_into(tempfile::tempfile().unwrap());
        let store = (&no_room, &AtomicUsize::new(0));
        let spilled = final_scans_of(&keyframes, &CAMERA, &dense, 2, store);
        assert!(spilled == scans && no_room.bytes().file > 0);
        let fast = final_scans(&keyframes, &CAMERA, &config(), 2);
        let all = CAMERA.width * CAMERA.height;
        assert!(fast[0].num_pixels == 0 && 2 * scans[0].num_pixels > all);
        assert!(share_right(&scans[0], 1.0) > 0.9);
    }
}
