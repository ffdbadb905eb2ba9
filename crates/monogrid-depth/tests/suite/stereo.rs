//! One stereo pair with exact poses: honest variance, no bias (R5), exposure, bands, odd input.

use crate::world::{Quality, View, World, frame, host, pinhole_of, quality, sensor};
use monogrid_depth::{
    DepthConfig, DepthMap, DepthPixel, MeasuredDepth, ObserveStats, PixelFilter, PixelOutcome,
    StereoFrame,
};
use monogrid_geometry::{Rotation, Se3, Vec3};
use monogrid_image::GrayImage;

const SIZE: (usize, usize) = (320, 240);

struct Pair {
    keyframe: View,
    keyframe_image: GrayImage,
    image: GrayImage,
    motion: Se3,
}

fn pair(motion: Se3, noise: f32) -> Pair {
    let world = World::room();
    let pinhole = pinhole_of(SIZE);
    let keyframe = world.render(&pinhole, SIZE, &Se3::identity());
    let other = world.render(&pinhole, SIZE, &motion.inverse());
    Pair {
        keyframe_image: sensor(&keyframe.image, noise, 1),
        image: sensor(&other.image, noise, 2),
        keyframe,
        motion,
    }
}

impl Pair {
    fn empty_map(&self, config: &DepthConfig) -> DepthMap {
        DepthMap::empty(host(self.keyframe_image.clone(), pinhole_of(SIZE)), config)
    }

    /// Observes the same frame a few times: the later ones only confirm.
    fn observe(&self, config: &DepthConfig) -> (DepthMap, Quality) {
        let mut map = self.empty_map(config);
        for _ in 0..4 {
            map.observe(&[frame(&self.image, self.motion)], config);
        }
        map.regularize(config);
        let quality = quality(&map, &self.keyframe.depth, 5);
        (map, quality)
    }
}

#[test]
fn a_stereo_pair_gives_unbiased_depth_with_honest_variance() {
    let config = DepthConfig {
        line_sigma_px: 0.0,
        ..DepthConfig::default()
    };
    let turned = Rotation::from_euler_angles(0.02, -0.03, 0.05);
    let motions = [
        Se3::new(Rotation::identity(), Vec3::new(0.02, 0.0, 0.0)),
        Se3::new(Rotation::identity(), Vec3::new(-0.015, 0.02, 0.0)),
        Se3::new(turned, Vec3::new(0.02, 0.01, -0.02)),
        Se3::new(Rotation::identity(), Vec3::new(0.0, 0.0, 0.06)),
    ];
    for motion in motions {
        let (_, q) = pair(motion, 2.0).observe(&config);
        println!("{:?} {q:.3?}", motion.translation);
        assert!(q.dense > 0.33, "{q:?}");
        assert!(q.normal_median.abs() < 0.1, "{q:?}");
        assert!((0.8..=1.3).contains(&q.normal_deviation), "{q:?}");
        assert!(q.bias.abs() < 0.005, "{q:?}");
        assert!(q.gross < 0.05, "{q:?}");
    }
}

#[test]
fn known_gain_and_bias_change_nothing() {
    let motion = Se3::new(Rotation::identity(), Vec3::new(0.02, 0.005, 0.0));
    let pair = pair(motion, 1.0);
    let config = DepthConfig::default();
    let (_, plain) = pair.observe(&config);
    let darker = pair.image.map(|v| 0.7 * v + 10.0);
    let mut map = pair.empty_map(&config);
    let adjusted = StereoFrame {
        gain: 0.7,
        bias: 10.0,
        ..frame(&darker, motion)
    };
    for _ in 0..4 {
        map.observe(&[adjusted], &config);
    }
    map.regularize(&config);
    let q = quality(&map, &pair.keyframe.depth, 5);
    assert!((q.dense - plain.dense).abs() < 0.005, "{q:?} {plain:?}");
    assert!((q.bias - plain.bias).abs() < 1e-4, "{q:?} {plain:?}");
}

fn pixels(map: &DepthMap) -> Vec<DepthPixel> {
    map.pixels(PixelFilter {
        min_validity: 0,
        ..PixelFilter::default()
    })
    .collect()
}

#[test]
fn the_result_does_not_depend_on_the_bands() {
    let motion = Se3::new(Rotation::identity(), Vec3::new(0.02, 0.005, 0.0));
    let pair = pair(motion, 1.0);
    let config = DepthConfig::default();
    let run = |rows: usize| {
        let mut map = pair.empty_map(&config);
        let mut stats = ObserveStats::default();
        // backwards, as threads may finish
        let mut parts: Vec<(usize, ObserveStats)> = Vec::new();
        for mut band in map.bands(rows).into_iter().rev() {
            let part = band.observe(&[frame(&pair.image, motion)], &config);
            parts.push((band.first_row(), part));
        }
        parts.sort_by_key(|(row, _)| *row);
        parts.iter().for_each(|(_, part)| stats.merge(part));
        assert_eq!(map.num_known(), stats.count(PixelOutcome::Created) as usize);
        (
            pixels(&map),
            stats.count(PixelOutcome::Created),
            stats.num_candidates(),
        )
    };
    let reference = run(SIZE.1);
    assert!(reference.0.len() > 10_000);
    for rows in [1, 7, 16] {
        assert_eq!(run(rows), reference, "{rows} rows per band");
    }
}

#[test]
fn frames_that_cannot_be_used_are_ignored() {
    let pair = pair(
        Se3::new(Rotation::identity(), Vec3::new(0.02, 0.0, 0.0)),
        1.0,
    );
    let config = DepthConfig::default();
    let mut map = pair.empty_map(&config);
    let small = GrayImage::filled(32, 32, 0.0);
    let nan = Se3::new(Rotation::identity(), Vec3::new(f64::NAN, 0.0, 0.0));
    let useless = [
        frame(&small, pair.motion),
        frame(&pair.image, nan),
        StereoFrame {
            gain: 0.0,
            ..frame(&pair.image, pair.motion)
        },
    ];
    assert_eq!(map.observe(&useless, &config).num_candidates(), 0);
    // no baseline, looking away, image without content
    let away = Se3::new(Rotation::from_euler_angles(0.0, 3.0, 0.0), Vec3::zeros());
    let blank = GrayImage::filled(SIZE.0, SIZE.1, 100.0);
    let poor = [
        frame(&pair.image, Se3::identity()),
        frame(&pair.image, away),
        frame(&blank, pair.motion),
    ];
    let stats = map.observe(&poor, &config);
    assert_eq!(stats.num_candidates() as usize, map.num_candidates());
    let num_known = map.num_known();
    assert!(
        num_known * 100 < map.num_candidates(),
        "{num_known} from a blank image"
    );
}

#[test]
fn the_thesis_profile_observes_every_frame_and_ours_only_for_gain() {
    let pair = pair(
        Se3::new(Rotation::identity(), Vec3::new(0.02, 0.0, 0.0)),
        1.0,
    );
    let updated = |config: &DepthConfig| {
        let mut map = pair.empty_map(config);
        let mut last = ObserveStats::default();
        for _ in 0..8 {
            last = map.observe(&[frame(&pair.image, pair.motion)], config);
        }
        (
            last.count(PixelOutcome::Updated),
            last.count(PixelOutcome::NoGain),
        )
    };
    let (thesis_updated, thesis_skipped) = updated(&DepthConfig::thesis());
    let (default_updated, default_skipped) = updated(&DepthConfig::default());
    assert!(thesis_updated > 10_000 && thesis_skipped == 0);
    assert!(
        default_updated < thesis_updated / 10,
        "{default_updated} {thesis_updated}"
    );
    assert!(default_skipped > 10_000, "{default_skipped}");
}

#[test]
fn an_observation_chooses_the_longer_baseline_that_still_sees_the_pixel() {
    let world = World::room();
    let pinhole = pinhole_of(SIZE);
    let keyframe = world.render(&pinhole, SIZE, &Se3::identity());
    let config = DepthConfig::default();
    let motions = [0.02, 0.08].map(|x| Se3::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)));
    let images: Vec<GrayImage> = motions
        .iter()
        .enumerate()
        .map(|(k, motion)| {
            let view = world.render(&pinhole, SIZE, &motion.inverse());
            sensor(&view.image, 1.5, 10 + k as u64)
        })
        .collect();
    let run = |which: &[usize]| {
        let mut map = DepthMap::empty(host(sensor(&keyframe.image, 1.5, 1), pinhole), &config);
        // a start that is wrong by 5 %
        let mut normal = crate::world::Normal(3);
        let wrong = keyframe
            .depth
            .map(|z| z * (1.0 + 0.05 * normal.next() as f32));
        map.initialize_from_depth(&wrong, 0.05);
        let frames: Vec<_> = which
            .iter()
            .map(|&k| frame(&images[k], motions[k]))
            .collect();
        map.observe(&frames, &config);
        quality(&map, &keyframe.depth, 30)
    };
    let (short, both) = (run(&[0]), run(&[0, 1]));
    assert!(both.precise > short.precise + 0.05, "{short:?} {both:?}");
}

#[test]
fn measured_depth_of_what_moves_is_dropped_and_of_what_stands_still_stays() {
    let motion = Se3::new(Rotation::identity(), Vec3::new(0.001, 0.0, 0.0));
    let pair = pair(motion, 1.5);
    let config = DepthConfig::default();
    let known = |map: &DepthMap| {
        let is_right = |pixel: &DepthPixel| usize::from(pixel.x) >= SIZE.0 / 2;
        let right = pixels(map).iter().filter(|p| is_right(p)).count();
        [map.num_known() - right, right]
    };
    // what is to be seen on the right goes on by two pixels a frame
    let observed = |mut map: DepthMap| {
        let before = known(&map);
        for k in 1..=10 {
            let image = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
                let moved = if x < SIZE.0 / 2 { 0 } else { 2 * k };
                pair.image.at((x + moved).min(SIZE.0 - 1), y)
            });
            map.observe(&[frame(&image, motion)], &config);
        }
        let after = known(&map);
        [0, 1].map(|half| after[half] as f32 / before[half] as f32)
    };
    let mut measured = pair.empty_map(&config);
    let depth = MeasuredDepth::new(&pair.keyframe.depth, 0.002);
    measured.fuse_measured(&depth, 1.0);
    let [still, moving] = observed(measured);
    assert!(still > 0.98 && moving < 0.5, "{still} {moving}");
    // other depth is doubted where a search fails alone
    let mut given = pair.empty_map(&config);
    given.initialize_from_depth(&pair.keyframe.depth, 0.002);
    let [still, moving] = observed(given);
    assert!(still > 0.98 && moving > 0.9, "{still} {moving}");
}
