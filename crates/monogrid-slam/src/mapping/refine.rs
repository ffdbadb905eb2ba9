//! Better depth of all keyframes, when the poses are known in the end.
//!
//! In this order: dense depth beside that of the filter (`dense`) → both made better by the images around (`refine_depth`) → what is
//! precise enough, and plain surfaces between it (`scan`, `fill`) → filled depth that others contradict taken out (`agreement`) →
//! uncertainty as the agreement of keyframes has it (`certainty`) → one depth from all that see the same (`fusion`) → depth where a keyframe
//! has none from those that see the same (`completion`) → walls, floor and ceiling beyond what was measured of them (`envelope`) → less
//! certain beside what is farther (`rims`).

use super::agreement::{Blocks, View, kept};
use super::certainty::Certainty;
use super::completion::completed;
use super::dense::{dense_depths, merged};
use super::envelope::{Cloud, enclosed};
use super::fusion::fused;
use super::posed::{Keyframes, PosedKeyframe};
use super::scan::{Depths, KeptDepths};
use super::{
    CompletionConfig, FusionConfig, KeyframeCamera, KeyframeScan, MappingConfig, RefineConfig,
};
use crate::DepthPixel;
use crate::median::median;
use crate::store::{Kept, Store};
use monogrid_depth::{DenseDepth, PixelDepth, SourceView, epipolar_misfits, refine_depth};
use monogrid_geometry::Sim3;
use monogrid_image::Image;
use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

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
    final_scans_of(
        &keyframes,
        camera,
        config,
        threads,
        (&Store::default(), done),
    )
}

/// As [`final_scans_counted`], of keyframes that lie where there is room, and so do the scans, in the store.
pub(crate) fn final_scans_of(
    keyframes: &dyn Keyframes,
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
    (store, done): (&Store, &AtomicUsize),
) -> Vec<KeyframeScan> {
    let config = &*config.at_its_quality();
    let (count, is_dense) = (keyframes.len(), config.quality.has_dense_depth());
    let dense = match is_dense {
        true => dense_depths(keyframes, camera, &config.dense, threads, store),
        false => vec![None; count],
    };
    let found = for_each_keyframe(count, threads, |index| {
        let dense = dense[index].as_ref().and_then(Kept::get);
        let dense = dense.as_deref().map(|dense| &dense.0);
        let found = Found::of_keyframe(keyframes, index, dense, (camera, config), store);
        done.fetch_add(1, Ordering::Relaxed);
        found
    });
    let work = Work {
        keyframes,
        camera,
        config,
        threads,
    };
    let keep = |this: &Found, depths: Depths, _: usize| this.with_depths(depths, camera);
    let hand_over = |_: &Found, depths: Depths, index| {
        depths.joined(keyframes.id(index), camera, &config.rims, store)
    };
    let found = work.not_contradicted(found);
    if !is_dense {
        return work.agreed_upon(found, hand_over);
    }
    let found = work.agreed_upon(found, keep);
    let found = work.completed_by_others(found, keep);
    work.enclosed_by_planes(found, hand_over)
}

/// The steps that keyframes take together; each gives up what the one before has found.
struct Work<'a> {
    keyframes: &'a dyn Keyframes,
    camera: &'a KeyframeCamera,
    config: &'a MappingConfig,
    threads: usize,
}

impl Work<'_> {
    /// A step of each keyframe beside what was found of all.
    fn each<T: Send>(
        &self,
        found: Vec<Found>,
        step: impl Fn(&Found, &[Option<View>], usize) -> T + Sync,
    ) -> Vec<T> {
        let views = views(&found);
        for_each_keyframe(found.len(), self.threads, |index| {
            step(&found[index], &views, index)
        })
    }

    /// Without filled depth that other keyframes contradict.
    fn not_contradicted(&self, found: Vec<Found>) -> Vec<Found> {
        if self.config.fill.max_witnesses == 0 {
            return found;
        }
        self.each(found, |this, views, index| {
            this.without_contradicted(views, index, self.camera, self.config)
        })
    }

    /// As certain as keyframes agree, and the mean of those that do.
    fn agreed_upon<T: Send>(
        &self,
        found: Vec<Found>,
        then: impl Fn(&Found, Depths, usize) -> T + Sync,
    ) -> Vec<T> {
        let (camera, config) = (self.camera, self.config);
        let certainty = Certainty::asked_for(&views(&found), camera, config, self.threads);
        self.each(found, |this, views, index| {
            let depths = this.certain(certainty, views, index, camera, &config.fusion);
            then(this, depths, index)
        })
    }

    /// With depth where keyframes have none, from those that see the same.
    fn completed_by_others(
        &self,
        found: Vec<Found>,
        then: impl Fn(&Found, Depths, usize) -> Found + Sync,
    ) -> Vec<Found> {
        let config = &self.config.completion;
        self.each(found, |this, views, index| {
            let depths = this.completed(self.keyframes, views, index, self.camera, config);
            then(this, depths, index)
        })
    }

    /// With depth of large planes beyond what was measured of them.
    fn enclosed_by_planes<T: Send>(
        &self,
        found: Vec<Found>,
        then: impl Fn(&Found, Depths, usize) -> T + Sync,
    ) -> Vec<T> {
        let (camera, config) = (self.camera, self.config);
        let clouds = for_each_keyframe(found.len(), self.threads, |index| {
            Cloud::new(found[index].view.as_ref(), camera, config)
        });
        self.each(found, |this, views, index| {
            let around = (views, |other: usize| clouds.get(other));
            let depths = this.enclosed(self.keyframes, around, index, camera, config);
            then(this, depths, index)
        })
    }
}

fn views(found: &[Found]) -> Vec<Option<View>> {
    found.iter().map(|found| found.view.clone()).collect()
}

/// What was found of a keyframe.
#[derive(Clone, Debug)]
pub(super) struct Found {
    depths: KeptDepths,
    /// As others see it, where it has a pose.
    pub view: Option<View>,
}

impl Found {
    /// From its depth by all that the settings ask for.
    pub fn of_keyframe(
        keyframes: &dyn Keyframes,
        index: usize,
        dense: Option<&DenseDepth>,
        (camera, config): (&KeyframeCamera, &MappingConfig),
        store: &Store,
    ) -> Self {
        let Refined { pixels, misfits } = final_pixels(keyframes, index, dense, camera, config);
        let image = keyframes.image(index);
        let id = keyframes.id(index);
        // how certain a plane is, keyframes tell together
        let limit = match config.sigma_from_agreement {
            true => config.fill.max_stated_sigma,
            false => config.filter.max_relative_sigma,
        };
        let depths = Depths::new(id, &pixels, image.as_deref(), camera, (config, limit));
        let known = keyframes.world_from_keyframe(index);
        Self::new(depths, known.zip(Some(misfits.into())), camera, store)
    }

    /// `known`: its pose, and how far its patches are beside epipolar lines.
    fn new(
        depths: Depths,
        known: Option<(Sim3, Arc<[f32]>)>,
        camera: &KeyframeCamera,
        store: &Store,
    ) -> Self {
        let blocks = known
            .is_some()
            .then(|| Arc::new(Blocks::new(&depths, camera)));
        let depths = KeptDepths::new(store, depths);
        let view = known.zip(blocks);
        Self {
            view: view.map(|((world_from_keyframe, misfits), blocks)| View {
                depths: depths.clone(),
                blocks,
                world_from_keyframe,
                misfits,
            }),
            depths,
        }
    }

    /// Without filled depth that others contradict; `views[index]` is its own view.
    pub fn without_contradicted(
        &self,
        views: &[Option<View>],
        index: usize,
        camera: &KeyframeCamera,
        config: &MappingConfig,
    ) -> Self {
        let mut depths = self.depths();
        if let Some(kept) = kept(views, index, camera, &config.fill) {
            let mut kept = kept.into_iter();
            depths.filled.retain(|_| kept.next().unwrap_or(true));
            depths.filled.shrink_to_fit();
        }
        self.with_depths(depths, camera)
    }

    /// Its depths.
    pub fn depths(&self) -> Depths {
        self.depths.depths()
    }

    /// With other depths.
    pub fn with_depths(&self, depths: Depths, camera: &KeyframeCamera) -> Self {
        let view = self.view.as_ref();
        let known = view.map(|view| (view.world_from_keyframe, view.misfits.clone()));
        Self::new(depths, known, camera, self.depths.store())
    }

    /// Its depths, as certain as they are, each fused with those of others that agree; `views[index]` is its own view.
    pub fn certain(
        &self,
        certainty: Certainty,
        views: &[Option<View>],
        index: usize,
        camera: &KeyframeCamera,
        config: &FusionConfig,
    ) -> Depths {
        let depths = certainty.apply(&self.depths);
        match config.max_witnesses {
            0 => depths,
            _ => fused(views, index, depths, certainty, camera, config),
        }
    }

    /// Its depths, with those that others have and it has not; `views[index]` is its own view.
    pub fn completed(
        &self,
        keyframes: &dyn Keyframes,
        views: &[Option<View>],
        index: usize,
        camera: &KeyframeCamera,
        config: &CompletionConfig,
    ) -> Depths {
        let added = completed(keyframes, views, index, camera, config);
        self.depths().with_filled(added)
    }

    /// Its depths, with large planes beyond what was measured of them; views and clouds as [`enclosed`] takes them.
    pub fn enclosed<'a>(
        &self,
        keyframes: &dyn Keyframes,
        around: (&[Option<View>], impl Fn(usize) -> Option<&'a Cloud>),
        index: usize,
        camera: &KeyframeCamera,
        config: &MappingConfig,
    ) -> Depths {
        let added = enclosed(keyframes, around, index, camera, config);
        self.depths().with_filled(added)
    }
}

/// Depth of a keyframe, and how far its patches are beside epipolar lines, px.
struct Refined<'a> {
    pixels: Cow<'a, [DepthPixel]>,
    misfits: Vec<f32>,
}

impl<'a> Refined<'a> {
    /// Depth as it was.
    fn unchanged(pixels: Cow<'a, [DepthPixel]>) -> Self {
        Self {
            pixels,
            misfits: Vec::new(),
        }
    }
}

/// The depth of one keyframe by all that the settings ask for: with dense depth, then refined.
fn final_pixels<'a>(
    keyframes: &'a dyn Keyframes,
    index: usize,
    dense: Option<&DenseDepth>,
    camera: &KeyframeCamera,
    config: &MappingConfig,
) -> Refined<'a> {
    let pixels = keyframes.pixels(index);
    let pixels = match dense {
        Some(dense) => Cow::Owned(merged(&pixels, dense, camera)),
        None => pixels,
    };
    if config.refine.enabled {
        refined(keyframes, index, pixels, camera, &config.refine)
    } else {
        Refined::unchanged(pixels)
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
        let pixels = keyframes[index].pixels.into();
        let refined = refined(&keyframes, index, pixels, camera, config);
        refined.pixels.into_owned()
    })
}

/// Results of independent work in their order, on several threads: each takes the next that nobody has begun.
pub(super) fn for_each_keyframe<T: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> T + Sync,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let of_thread = || -> Vec<(usize, T)> {
        std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed))
            .take_while(|index| *index < count)
            .map(|index| (index, work(index)))
            .collect()
    };
    let mut results: Vec<Option<T>> = std::iter::repeat_with(|| None).take(count).collect();
    thread::scope(|scope| {
        let others: Vec<_> = (1..threads.min(count))
            .map(|_| scope.spawn(of_thread))
            .collect();
        let first = of_thread();
        let rest = others
            .into_iter()
            .flat_map(|other| other.join().unwrap_or_default());
        for (index, result) in first.into_iter().chain(rest) {
            results[index] = Some(result);
        }
    });
    // what a thread had that failed: again, here
    let results = results.into_iter().enumerate();
    results
        .map(|(index, result)| result.unwrap_or_else(|| work(index)))
        .collect()
}

/// Depths of one keyframe, refined by the others; as they were without an image.
fn refined<'a>(
    keyframes: &dyn Keyframes,
    index: usize,
    pixels: Cow<'a, [DepthPixel]>,
    camera: &KeyframeCamera,
    config: &RefineConfig,
) -> Refined<'a> {
    let Some(image) = keyframes.image(index) else {
        return Refined::unchanged(pixels);
    };
    let near: Vec<(Cow<Image<u8>>, Sim3)> = near(keyframes, index, config)
        .into_iter()
        .filter_map(|(other, source_from_keyframe)| {
            Some((keyframes.image(other)?, source_from_keyframe))
        })
        .collect();
    let sources = source_views(&near);
    let pixels: Vec<PixelDepth> = pixels.iter().map(PixelDepth::from).collect();
    let (pinhole, stereo) = (&camera.pinhole, &config.stereo);
    let (refined, _) = refine_depth(&image, pinhole, &pixels, &sources, stereo);
    Refined {
        misfits: epipolar_misfits(&image, pinhole, &refined, &sources, stereo),
        pixels: refined.into_iter().map(DepthPixel::from).collect(),
    }
}

impl From<PixelDepth> for DepthPixel {
    fn from(pixel: PixelDepth) -> Self {
        Self {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            idepth_var: pixel.idepth_var,
        }
    }
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

/// Images, with `source_from_keyframe`, as stereo takes them.
pub(super) fn source_views<'a>(images: &'a [(Cow<'_, Image<u8>>, Sim3)]) -> Vec<SourceView<'a>> {
    let view = |(image, source_from_keyframe): &'a (Cow<'_, Image<u8>>, Sim3)| SourceView {
        image: image.as_ref(),
        source_from_keyframe: *source_from_keyframe,
    };
    images.iter().map(view).collect()
}

/// The nearest keyframes with image and pose, nearest first, with `source_from_keyframe`.
fn near(keyframes: &dyn Keyframes, index: usize, config: &RefineConfig) -> Vec<(usize, Sim3)> {
    let (Some(world_from_this), Some(median)) = (
        keyframes.world_from_keyframe(index),
        median_idepth(&keyframes.pixels(index)),
    ) else {
        return Vec::new();
    };
    let mut near: Vec<(f64, usize, Sim3)> = (0..keyframes.len())
        .filter(|other| *other != index && keyframes.has_image(*other))
        .filter_map(|other| {
            let world_from_other = keyframes.world_from_keyframe(other)?;
            let source_from_keyframe = world_from_other.inverse() * world_from_this;
            let center_in_this = source_from_keyframe.inverse().translation;
            let separation = center_in_this.norm() * median + source_from_keyframe.rotation.angle();
            let is_near = separation <= config.max_separation;
            is_near.then_some((separation, other, source_from_keyframe))
        })
        .collect();
    // stable: equal ones in the order of the keyframes
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(config.max_keyframes);
    near.into_iter()
        .map(|(_, other, pose)| (other, pose))
        .collect()
}

fn median_idepth(pixels: &[DepthPixel]) -> Option<f64> {
    let mut idepths: Vec<f32> = pixels
        .iter()
        .map(|p| p.idepth)
        .filter(|d| *d > 0.0 && d.is_finite())
        .collect();
    median(&mut idepths).map(f64::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KeyframeId;
    use crate::MemoryConfig;
    use crate::mapping::test_wall::{CAMERA, depths, share_right, wall};
    use crate::mapping::{FillConfig, FusionConfig, MapQuality};
    use monogrid_geometry::{Rotation, Vec3};

    fn config() -> MappingConfig {
        MappingConfig {
            quality: MapQuality::Fast,
            sigma_from_agreement: false,
            fusion: FusionConfig {
                max_witnesses: 0,
                ..FusionConfig::default()
            },
            fill: FillConfig {
                enabled: false,
                ..FillConfig::default()
            },
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
        let spilled = final_scans_of(&keyframes.as_slice(), &CAMERA, &dense, 2, store);
        assert!(spilled == scans && no_room.bytes().file > 0);
        let fast = final_scans(&keyframes, &CAMERA, &config(), 2);
        let all = CAMERA.width * CAMERA.height;
        assert!(fast[0].num_pixels == 0 && 2 * scans[0].num_pixels > all);
        assert!(share_right(&scans[0], 1.0) > 0.9);
    }
}
