//! Better depth of all keyframes, when the poses are known in the end.

use super::agreement::{Blocks, View, kept};
use super::certainty::Certainty;
use super::dense::{dense_depths, merged};
use super::scan::Depths;
use super::{KeyframeCamera, KeyframeScan, MapQuality, MappingConfig, RefineConfig};
use crate::{DepthPixel, KeyframeId};
use monogrid_depth::{DenseDepth, PixelDepth, SourceView, refine_depth};
use monogrid_geometry::Sim3;
use monogrid_image::Image;
use std::borrow::Cow;
use std::sync::atomic::{AtomicUsize, Ordering};
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

/// What of each keyframe is mapped: its depth, with dense depth ([`monogrid_depth::dense_depth`]) and made better by the images of the
/// keyframes around it ([`monogrid_depth::refine_depth`]) if the settings ask for it, filtered and filled as
/// [`KeyframeScan::new`] does, without filled depth that other keyframes contradict (module `agreement`).
///
/// The result does not depend on the number of threads.
#[must_use]
pub fn final_scans(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
) -> Vec<KeyframeScan> {
    final_scans_counted(keyframes, camera, config, threads, &AtomicUsize::new(0))
}

/// As [`final_scans`]; `done` grows with every keyframe, for those who wait.
#[must_use]
pub fn final_scans_counted(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
    done: &AtomicUsize,
) -> Vec<KeyframeScan> {
    let dense = match config.quality {
        MapQuality::Dense => dense_depths(keyframes, camera, &config.dense, threads),
        MapQuality::Fast => vec![None; keyframes.len()],
    };
    let depths = for_each_keyframe(keyframes.len(), threads, |index| {
        let keyframe = &keyframes[index];
        let pixels = final_pixels(keyframes, index, dense[index].as_ref(), camera, config);
        let depths = Depths::new(keyframe.id, &pixels, keyframe.image, camera, config);
        done.fetch_add(1, Ordering::Relaxed);
        depths
    });
    let agreed = agreed(keyframes, depths, camera, config, threads);
    let ids = keyframes.iter().map(|keyframe| keyframe.id);
    ids.zip(agreed)
        .map(|(id, depths)| depths.joined(id, camera))
        .collect()
}

/// The depth of each keyframe as the others have it: without filled depth that they contradict, and as certain as they agree.
fn agreed(
    keyframes: &[PosedKeyframe],
    mut depths: Vec<Depths>,
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
) -> Vec<Depths> {
    if config.fill.max_witnesses > 0 {
        let views = views(keyframes, &depths, camera, threads);
        let kept = for_each_keyframe(keyframes.len(), threads, |index| {
            kept(&views, index, camera, &config.fill)
        });
        drop(views);
        for (depths, kept) in depths.iter_mut().zip(kept) {
            let mut kept = kept.unwrap_or_default().into_iter();
            depths.filled.retain(|_| kept.next().unwrap_or(true));
            depths.filled.shrink_to_fit();
        }
    }
    if config.sigma_from_agreement {
        let views = views(keyframes, &depths, camera, threads);
        let certainty = Certainty::of_views(&views, camera, threads);
        drop(views);
        for depths in &mut depths {
            certainty.apply(depths, config.filter.max_agreed_sigma as f32);
        }
    }
    depths
}

/// The keyframes that have a pose.
fn views<'a>(
    keyframes: &[PosedKeyframe],
    depths: &'a [Depths],
    camera: &KeyframeCamera,
    threads: usize,
) -> Vec<Option<View<'a>>> {
    for_each_keyframe(keyframes.len(), threads, |index| {
        Some(View {
            depths: &depths[index],
            blocks: Blocks::new(&depths[index], camera),
            world_from_keyframe: keyframes[index].world_from_keyframe?,
        })
    })
}

/// The depth of one keyframe by all that the settings ask for: with dense depth, then refined.
fn final_pixels<'a>(
    keyframes: &[PosedKeyframe<'a>],
    index: usize,
    dense: Option<&DenseDepth>,
    camera: &KeyframeCamera,
    config: &MappingConfig,
) -> Cow<'a, [DepthPixel]> {
    let pixels = keyframes[index].pixels;
    let pixels = dense.map_or(Cow::Borrowed(pixels), |dense| {
        Cow::Owned(merged(pixels, dense, camera))
    });
    if config.refine.enabled {
        let sources = sources(keyframes, index, &config.refine);
        Cow::Owned(refined_pixels(
            &keyframes[index],
            &pixels,
            &sources,
            camera,
            &config.refine,
        ))
    } else {
        pixels
    }
}

/// The depth of each keyframe, made better by the images of the keyframes around it, whether or not the
/// settings are enabled; as it was where fewer than two of them agree.
///
/// The result does not depend on the number of threads.
#[must_use]
pub fn refined_depths(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &RefineConfig,
    threads: usize,
) -> Vec<Vec<DepthPixel>> {
    for_each_keyframe(keyframes.len(), threads, |index| {
        let keyframe = &keyframes[index];
        let sources = sources(keyframes, index, config);
        refined_pixels(keyframe, keyframe.pixels, &sources, camera, config)
    })
}

/// Results of independent work in their order, on several threads: each takes every n-th, since neighbours
/// cost about the same.
pub(super) fn for_each_keyframe<T: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> T + Sync,
) -> Vec<T> {
    let threads = threads.clamp(1, count.max(1));
    let of_thread =
        |thread: usize| -> Vec<T> { (thread..count).step_by(threads).map(&work).collect() };
    let mut parts: Vec<std::vec::IntoIter<T>> = thread::scope(|scope| {
        let of_thread = &of_thread;
        let others: Vec<_> = (1..threads)
            .map(|thread| scope.spawn(move || of_thread(thread)))
            .collect();
        let first = of_thread(0);
        let rest = others.into_iter().enumerate().map(|(i, other)| {
            // a thread that failed: its share again, here
            other.join().unwrap_or_else(|_| of_thread(i + 1))
        });
        std::iter::once(first)
            .chain(rest)
            .map(Vec::into_iter)
            .collect()
    });
    (0..count)
        .filter_map(|index| parts[index % threads].next())
        .collect()
}

/// Depths of one keyframe, refined by the others; as they were without an image.
fn refined_pixels(
    keyframe: &PosedKeyframe,
    pixels: &[DepthPixel],
    sources: &[SourceView],
    camera: &KeyframeCamera,
    config: &RefineConfig,
) -> Vec<DepthPixel> {
    let Some(image) = keyframe.image else {
        return pixels.to_vec();
    };
    let pixels: Vec<PixelDepth> = pixels.iter().map(PixelDepth::from).collect();
    let (refined, _) = refine_depth(image, &camera.pinhole, &pixels, sources, &config.stereo);
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

impl From<&DepthPixel> for PixelDepth {
    fn from(pixel: &DepthPixel) -> Self {
        Self {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            idepth_var: pixel.idepth_var,
            validity: 0,
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::FillConfig;
    use monogrid_geometry::{Pinhole, Rotation, Vec2, Vec3};

    const CAMERA: KeyframeCamera = KeyframeCamera {
        pinhole: Pinhole {
            fx: 140.0,
            fy: 140.0,
            cx: 79.5,
            cy: 59.5,
        },
        width: 160,
        height: 120,
    };

    /// A textured wall two units before the first camera, as a camera beside it sees it.
    fn wall(x: f64) -> Image<u8> {
        Image::from_fn(CAMERA.width, CAMERA.height, |u, v| {
            let ray = CAMERA.pinhole.unproject(&Vec2::new(u as f64, v as f64));
            let (a, b) = (2.0 * ray.x + x, 2.0 * ray.y);
            let grey =
                128.0 + 50.0 * (31.0 * a + 9.0 * b).sin() + 50.0 * (23.0 * a - 17.0 * b).cos();
            grey as u8
        })
    }

    /// Depths that are all 4 % too large, in a keyframe whose unit is `scale`.
    fn depths(scale: f64) -> Vec<DepthPixel> {
        let idepth = (0.96 * scale / 2.0) as f32;
        (0..CAMERA.height as u16)
            .flat_map(|y| (0..CAMERA.width as u16).map(move |x| (x, y)))
            .map(|(x, y)| DepthPixel {
                x,
                y,
                idepth,
                idepth_var: (0.03 * idepth).powi(2),
            })
            .collect()
    }

    fn config() -> MappingConfig {
        MappingConfig {
            sigma_from_agreement: false,
            fill: FillConfig {
                enabled: false,
                ..FillConfig::default()
            },
            ..MappingConfig::default()
        }
    }

    /// Share of the mapped depths of a keyframe of that unit that are right to within 2 %.
    fn share_right(scan: &KeyframeScan, scale: f64) -> f64 {
        let is_right = |idepth: f32| (f64::from(idepth) * 2.0 / scale - 1.0).abs() < 0.02;
        let num_right = scan.pixels.iter().filter(|p| is_right(p.idepth)).count();
        num_right as f64 / scan.pixels.len() as f64
    }

    #[test]
    fn keyframes_make_each_other_better_whatever_their_units_and_the_threads() {
        let places = [(0.0, 1.0), (0.35, 1.2), (-0.35, 0.7), (0.6, 1.0)];
        let images = places.map(|(x, _)| wall(x));
        let pixels = places.map(|(_, scale)| depths(scale));
        let mut keyframes: Vec<PosedKeyframe> = (0..4)
            .map(|i| PosedKeyframe {
                id: i as KeyframeId,
                image: Some(&images[i]),
                pixels: &pixels[i],
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
        keyframes[2].image = Some(&images[2]);
        for (keyframe, scan) in keyframes
            .iter()
            .zip(final_scans(&keyframes, &CAMERA, &off, 2))
        {
            let alone =
                KeyframeScan::new(keyframe.id, keyframe.pixels, keyframe.image, &CAMERA, &off);
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
                image: Some(image),
                pixels: &pixels,
                world_from_keyframe: Some(Sim3::new(
                    1.0,
                    Rotation::identity(),
                    Vec3::new(*x, 0.0, 0.0),
                )),
            })
            .collect();
        let dense = MappingConfig {
            quality: MapQuality::Dense,
            ..config()
        };
        let scans = final_scans(&keyframes, &CAMERA, &dense, 1);
        assert_eq!(final_scans(&keyframes, &CAMERA, &dense, 3), scans);
        let fast = final_scans(&keyframes, &CAMERA, &config(), 2);
        let all = CAMERA.width * CAMERA.height;
        assert!(fast[0].pixels.is_empty() && 2 * scans[0].pixels.len() > all);
        assert!(share_right(&scans[0], 1.0) > 0.9);
    }
}
