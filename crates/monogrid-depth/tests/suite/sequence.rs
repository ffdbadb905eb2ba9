//! A hand-held sequence with keyframe changes: density, accuracy, honesty, no drift of the scale.

use crate::world::{
    Normal, Quality, View, World, disturbed, frame, handheld, host, pinhole_of, quality, sensor,
};
use monogrid_depth::{DepthConfig, DepthMap, PixelFilter, StereoFrame};
use monogrid_geometry::Se3;
use monogrid_image::GrayImage;
use std::sync::OnceLock;

const SIZE: (usize, usize) = (320, 240);
const NUM_FRAMES: usize = 49;
const FRAMES_PER_KEYFRAME: usize = 12;
/// Error of each frame's pose relative to its keyframe.
const SIGMA_TRANS: f32 = 0.0003;
const SIGMA_ROT: f32 = 0.0002;

fn views(noise: f32) -> Vec<View> {
    let (world, pinhole) = (World::room(), pinhole_of(SIZE));
    (0..NUM_FRAMES)
        .map(|n| {
            let mut view = world.render(&pinhole, SIZE, &handheld(n as f64 / 30.0));
            view.image = sensor(&view.image, noise, n as u64 + 1);
            view
        })
        .collect()
}

/// The views that most tests share.
fn quiet_views() -> &'static [View] {
    static VIEWS: OnceLock<Vec<View>> = OnceLock::new();
    VIEWS.get_or_init(|| views(1.5))
}

fn stereo(image: &GrayImage, frame_from_keyframe: Se3, id: usize) -> StereoFrame<'_> {
    StereoFrame {
        pose_sigma_trans: SIGMA_TRANS,
        pose_sigma_rot: SIGMA_ROT,
        id: id as u32,
        ..frame(image, frame_from_keyframe)
    }
}

/// Runs the filter from nothing; returns the quality of each finished keyframe and the last map.
fn run(views: &[View], config: &DepthConfig) -> (Vec<Quality>, DepthMap) {
    let mut normal = Normal(5);
    let new_host = |n: usize| host(views[n].image.clone(), pinhole_of(SIZE));
    let relative = |frame: usize, keyframe: usize| {
        views[frame].world_from_camera.inverse() * views[keyframe].world_from_camera
    };
    let mut map = DepthMap::empty(new_host(0), config);
    let (mut keyframe, mut old) = (0usize, Vec::new());
    let mut finished = Vec::new();
    for n in 1..views.len() {
        if n % FRAMES_PER_KEYFRAME == 0 {
            finished.push(quality(&map, &views[keyframe].depth, 10));
            map = map.propagate(new_host(n), &relative(n, keyframe), config);
            old.insert(0, keyframe);
            old.truncate(3);
            keyframe = n;
            let frames: Vec<_> = old
                .iter()
                .map(|&k| stereo(&views[k].image, relative(k, n), k))
                .collect();
            map.observe(&frames, config);
        } else {
            let (trans, rot) = (f64::from(SIGMA_TRANS), f64::from(SIGMA_ROT));
            let pose = disturbed(&relative(n, keyframe), trans, rot, &mut normal);
            map.observe(&[stereo(&views[n].image, pose, n)], config);
        }
        map.fill_holes(config);
        map.regularize(config);
    }
    (finished, map)
}

#[test]
fn keyframes_become_dense_accurate_and_honest() {
    let (finished, _) = run(quiet_views(), &DepthConfig::default());
    for q in &finished {
        println!("{q:?}");
    }
    assert_eq!(finished.len(), 4);
    for q in &finished {
        assert!(q.normal_median.abs() <= 0.2, "{q:?}");
        assert!((0.6..=1.5).contains(&q.normal_deviation), "{q:?}");
        assert!(q.within_2_sigma >= 0.9, "{q:?}");
        assert!(q.bias.abs() < 0.005, "{q:?}");
        assert!(q.gross < 0.03, "{q:?}");
    }
    // the first keyframe starts from nothing, with a baseline of some centimetres
    assert!(finished[0].within_3 > 0.5, "{:?}", finished[0]);
    for q in &finished[1..] {
        assert!(q.within_3 >= 0.6, "{q:?}");
        assert!(q.dense >= 0.8, "{q:?}");
    }
}

#[test]
fn noise_is_learned_and_the_variance_stays_honest() {
    let (finished, map) = run(&views(4.0), &DepthConfig::default());
    for q in &finished {
        println!("{q:?}");
        assert!(q.normal_median.abs() <= 0.2, "{q:?}");
        assert!((0.7..=1.5).contains(&q.normal_deviation), "{q:?}");
        assert!(q.within_2_sigma >= 0.85, "{q:?}");
    }
    // sqrt(2) times 4, less what interpolation smooths away
    let noise = map.noise_sigma();
    assert!((3.0..6.0).contains(&noise), "{noise}");
}

#[test]
fn the_thesis_profile_works_too() {
    let (finished, _) = run(quiet_views(), &DepthConfig::thesis());
    let last = &finished[finished.len() - 1];
    println!("{last:?}");
    assert!(last.within_3 > 0.5 && last.gross < 0.05, "{last:?}");
}

#[test]
fn ten_forced_keyframes_keep_density_and_scale() {
    let views = quiet_views();
    let config = DepthConfig::default();
    let (finished, map) = run(views, &config);
    let steady = finished[finished.len() - 1].dense;
    // ten keyframes in a row without any observation between
    let start = NUM_FRAMES - 1;
    let mut map = map;
    let mut at = start;
    for k in 0..10 {
        let next = if k % 2 == 0 { start - 2 } else { start };
        let pose = views[next].world_from_camera.inverse() * views[at].world_from_camera;
        let next_host = host(views[next].image.clone(), pinhole_of(SIZE));
        map = map.propagate(next_host, &pose, &config);
        map.fill_holes(&config);
        map.regularize(&config);
        at = next;
    }
    let q = quality(&map, &views[at].depth, 10);
    println!("steady {steady:.3} after ten {q:?}");
    assert!(q.dense >= 0.8 * steady, "{q:?}");
    // no drift: ten changes move the scale by less than 0.5 %, not 0.5 % each
    assert!(q.bias.abs() < 0.005, "{q:?}");
}

#[test]
fn smoothed_values_are_published_on_request() {
    let views = quiet_views();
    let (_, map) = run(&views[..6], &DepthConfig::default());
    let read = |smoothed: bool| -> Vec<_> {
        let filter = PixelFilter {
            smoothed,
            ..PixelFilter::default()
        };
        map.pixels(filter).collect()
    };
    let (own, smooth) = (read(false), read(true));
    assert!(own.len() > 5_000 && smooth.len() > 5_000);
    let mean_var = |pixels: &[monogrid_depth::DepthPixel]| {
        pixels.iter().map(|p| f64::from(p.idepth_var)).sum::<f64>() / pixels.len() as f64
    };
    assert!(mean_var(&smooth) < mean_var(&own));
}
