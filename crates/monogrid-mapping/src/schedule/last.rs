//! Better depth of all keyframes, when the poses are known in the end: they take the `stages`
//! together.

use super::stages::{Progress, Stage, mapped, taken, views_of};
use crate::scene::{Depths, PosedKeyframe, Scene, for_each_keyframe};
use crate::{KeyframeCamera, KeyframeScan, MapQuality, MappingConfig};
use monogrid_slam::Slam;
use monogrid_slam::store::Store;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What of each keyframe is mapped: its depth, with dense depth ([`monogrid_depth::dense_depth`])
/// or made better by the images of the keyframes around it ([`monogrid_depth::refine_depth`]) as
/// the quality asks for, filtered and filled as [`KeyframeScan::new`] does.
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
    scans_in(keyframes, camera, config, threads, rest)
}

/// The depth of all finished keyframes of a system as it is mapped in the end ([`final_scans`]) at
/// the newest poses, by identity; it lies where there is room. `done` grows with every keyframe,
/// for those who wait.
#[must_use]
pub fn final_scans_of(
    slam: &Slam,
    config: &MappingConfig,
    threads: usize,
    done: &AtomicUsize,
) -> Vec<KeyframeScan> {
    let (finished, poses) = (slam.keyframes(), slam.snapshot());
    let keyframes = finished.iter().map(|k| PosedKeyframe::kept(k, &poses));
    let keyframes: Vec<PosedKeyframe> = keyframes.collect();
    let rest = (slam.store(), done);
    scans_in(&keyframes, &slam.camera(), config, threads, rest)
}

/// As [`final_scans`]; the scans lie in the store.
fn scans_in(
    keyframes: &[PosedKeyframe],
    camera: &KeyframeCamera,
    config: &MappingConfig,
    threads: usize,
    (store, done): (&Store, &AtomicUsize),
) -> Vec<KeyframeScan> {
    let scene = Scene {
        keyframes,
        views: &[],
        camera,
        config,
        threads,
    };
    let count = keyframes.len();
    if config.quality == MapQuality::Raw {
        return for_each_keyframe(count, threads, |index| {
            done.fetch_add(1, Ordering::Relaxed);
            raw(&scene, index, store)
        });
    }
    let mut all = vec![Progress::default(); count];
    for stage in Stage::ALL {
        let before: Vec<Option<&Progress>> = all.iter().map(Some).collect();
        let views = views_of(&before);
        let scene = scene.seeing(&views);
        let rest = (stage.certainty(&scene), store);
        all = for_each_keyframe(count, threads, |index| {
            let progress = taken(stage, &scene, index, &before, rest);
            // the stage that takes longest
            if stage == Stage::Found {
                done.fetch_add(1, Ordering::Relaxed);
            }
            progress
        });
    }
    let before: Vec<Option<&Progress>> = all.iter().map(Some).collect();
    let views = views_of(&before);
    let scene = scene.seeing(&views);
    for_each_keyframe(count, threads, |index| {
        mapped(&scene, index, &before, store)
    })
}

/// What of a keyframe is mapped, by the depth of the filter alone.
fn raw(scene: &Scene, index: usize, store: &Store) -> KeyframeScan {
    let Scene { camera, config, .. } = *scene;
    let keyframe = &scene.keyframes[index];
    let (pixels, image) = (keyframe.depth.get(), keyframe.image());
    let limit = config.filter.max_relative_sigma;
    let depths = Depths::new(keyframe.id, &pixels, image.as_deref(), config, limit);
    depths.joined(keyframe.id, camera, store)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_wall::{CAMERA, depths, share_right, wall};
    use crate::{DepthOf, FillConfig, ImageOf};
    use monogrid_geometry::{Rotation, Sim3, Vec3};
    use monogrid_slam::KeyframeId;
    use monogrid_slam::MemoryConfig;

    fn config() -> MappingConfig {
        MappingConfig {
            quality: MapQuality::Fast,
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
        // and none does in quality `raw`
        let off = MappingConfig {
            quality: MapQuality::Raw,
            ..config()
        };
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
    fn what_a_depth_camera_measured_is_mapped_whatever_images_say() {
        let places = [0.0, 0.2, -0.2];
        let images = places.map(wall);
        let with_sigma = |sigma: f32| {
            let mut pixels = depths(1.0);
            for pixel in &mut pixels {
                pixel.idepth_var = (sigma * pixel.idepth).powi(2);
            }
            let keyframe = |i: usize| PosedKeyframe {
                id: i as KeyframeId,
                image: Some(ImageOf::Held(&images[i])),
                depth: DepthOf::Held(&pixels),
                world_from_keyframe: Some(Sim3::new(
                    1.0,
                    Rotation::identity(),
                    Vec3::new(places[i], 0.0, 0.0),
                )),
            };
            let keyframes = [0, 1, 2].map(keyframe);
            let dense = MappingConfig {
                quality: MapQuality::Default,
                ..config()
            };
            let scans = final_scans(&keyframes, &CAMERA, &dense, 1);
            (share_right(&scans[0], 1.0), scans[0].num_pixels)
        };
        // the depth is 4 % too large
        let (of_images, _) = with_sigma(0.03);
        let (of_depth_camera, num_pixels) = with_sigma(0.005);
        assert!(
            of_images > 0.5 && of_depth_camera == 0.0,
            "{of_images} {of_depth_camera}"
        );
        assert!(num_pixels * 10 > CAMERA.width * CAMERA.height * 9);
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
        let spilled = scans_in(&keyframes, &CAMERA, &dense, 2, store);
        assert!(spilled == scans && no_room.bytes().file > 0);
        let fast = final_scans(&keyframes, &CAMERA, &config(), 2);
        let all = CAMERA.width * CAMERA.height;
        assert!(8 * fast[0].num_pixels <= all && 2 * scans[0].num_pixels > all);
        assert!(share_right(&scans[0], 1.0) > 0.9);
    }
}
