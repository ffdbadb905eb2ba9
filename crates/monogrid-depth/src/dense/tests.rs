use super::aggregate::aggregate;
use super::sweep::GREY_SIGMA;
use super::warp::{padded, warp_row, warp_row_with};
use super::*;
use crate::MeasuredDepth;
use monogrid_geometry::{Rotation, Se3, Sim3, Vec2, Vec3};
use monogrid_image::lanes::Baseline;

const WIDTH: usize = 128;
const HEIGHT: usize = 96;
const CAMERA: Pinhole = Pinhole {
    fx: 110.0,
    fy: 110.0,
    cx: 63.5,
    cy: 47.5,
};

/// A textured slanted wall, z = 2 + 0.3 x, with a textured square at z = 1.2 before it.
fn depth_of_ray(ray: &Vec3, eye_x: f64, has_square: bool) -> f64 {
    // eye + z ray on z = 2 + 0.3 x
    let wall = (2.0 + 0.3 * eye_x) / (1.0 - 0.3 * ray.x);
    let [x, y] = [eye_x + 1.2 * ray.x, 1.2 * ray.y];
    let is_square = has_square && x.abs() < 0.25 && y.abs() < 0.25;
    if is_square { 1.2 } else { wall }
}

/// What a camera `eye_x` to the right sees.
fn picture(eye_x: f64, has_square: bool) -> Image<u8> {
    Image::from_fn(WIDTH, HEIGHT, |u, v| {
        let ray = CAMERA.unproject(&Vec2::new(u as f64, v as f64));
        grey_of(eye_x, &ray, depth_of_ray(&ray, eye_x, has_square))
    })
}

/// The grey level of the point that the ray of a camera meets at this depth.
fn grey_of(eye_x: f64, ray: &Vec3, z: f64) -> u8 {
    let (x, y) = (eye_x + z * ray.x, z * ray.y);
    let grey = 128.0
        + 45.0 * (21.0 * x + 7.0 * y + 9.0 * z).sin()
        + 45.0 * (15.0 * x - 19.0 * y - 4.0 * z).cos();
    grey as u8
}

/// Depths over the range of the scene.
fn seeds() -> Vec<DepthPixel> {
    (0..200)
        .map(|i| DepthPixel {
            x: 0,
            y: 0,
            idepth: 1.0 / (1.2 + 0.007 * i as f32),
            idepth_var: 1e-4,
        })
        .collect()
}

fn at(eye_x: f64) -> Sim3 {
    Sim3::new(1.0, Rotation::identity(), Vec3::new(-eye_x, 0.0, 0.0))
}

const EYES: [f64; 4] = [-0.24, -0.12, 0.12, 0.24];

fn depth_at(eye_x: f64, has_square: bool) -> DenseDepth {
    let images = EYES.map(|other| picture(eye_x + other, has_square));
    let sources: Vec<SourceView> = images
        .iter()
        .zip(EYES)
        .map(|(image, other)| SourceView {
            image,
            source_from_keyframe: at(other),
        })
        .collect();
    let image = picture(eye_x, has_square);
    dense_depth(&image, &CAMERA, &seeds(), &sources, &DenseConfig::default()).unwrap()
}

/// Share of the pixels of the half image that have a depth, and of these that are within 2 % of the
/// truth.
fn shares(depth: &DenseDepth, has_square: bool) -> (f64, f64) {
    let (mut known, mut right) = (0, 0);
    for y in 0..HEIGHT / 2 {
        for x in 0..WIDTH / 2 {
            let ray = CAMERA.half().unproject(&Vec2::new(x as f64, y as f64));
            let truth = depth_of_ray(&ray, 0.0, has_square);
            let idepth = f64::from(depth.idepth.at(x, y));
            known += i32::from(idepth > 0.0);
            right += i32::from((idepth * truth - 1.0).abs() < 0.02);
        }
    }
    let all = (WIDTH * HEIGHT / 4) as f64;
    (f64::from(known) / all, f64::from(right) / f64::from(known))
}

#[test]
fn a_slanted_wall_and_what_stands_before_it_are_found() {
    // beside the square, one side of it covers the wall in each source, and windows hold both
    for (has_square, min_right) in [(false, 0.93), (true, 0.85)] {
        let (known, right) = shares(&depth_at(0.0, has_square), has_square);
        // the windows at the edges of the image have no depth
        let is_enough = known > 0.7 && right > min_right;
        assert!(is_enough, "{has_square}: {known} {right}");
    }
}

#[test]
fn depth_that_others_contradict_goes_and_the_rest_keeps_its_own() {
    let depth = depth_at(0.0, false);
    let others = EYES.map(|eye| depth_at(eye, false));
    let supporting = |moved: f64| -> Vec<SupportingView<'_>> {
        others
            .iter()
            .zip(EYES)
            .map(|(depth, eye)| SupportingView {
                depth,
                view_from_keyframe: Sim3::new(moved, Rotation::identity(), Vec3::zeros()) * at(eye),
            })
            .collect()
    };
    let config = DenseConfig::default();
    let agreed = depth.agreed(&supporting(1.0), &CAMERA, &config);
    // what holds keeps its depth: a mean would agree with what it is made of
    let mut depths = agreed.idepth.as_slice().iter().zip(depth.idepth.as_slice());
    assert!(depths.all(|(held, own)| *held <= 0.0 || held == own));
    let (known, right) = shares(&agreed, false);
    assert!(known > 0.6 && right > 0.98, "{known} {right}");
    let (mut inside, mut all) = (0, 0);
    for (pixel, idepth) in agreed.idepth.as_slice().iter().enumerate() {
        if *idepth > 0.0 {
            let (x, y) = (pixel % (WIDTH / 2), pixel / (WIDTH / 2));
            let ray = CAMERA.half().unproject(&Vec2::new(x as f64, y as f64));
            let truth = 1.0 / depth_of_ray(&ray, 0.0, false) as f32;
            all += 1;
            inside += i32::from((idepth - truth).abs() < 2.0 * agreed.sigma.as_slice()[pixel]);
        }
    }
    assert!(inside * 10 > all * 9, "{inside} of {all} within two sigma");
    // the others have all depths 6 % larger
    let moved = depth.agreed(&supporting(1.0 / 1.06), &CAMERA, &config);
    let (known, _) = shares(&moved, false);
    assert!(known < 0.05, "{known}");
}

/// An image whose half is 4 x + 3 y, so that any interpolation is right.
fn ramp(width: usize, height: usize) -> Image<u8> {
    Image::from_fn(2 * width, 2 * height, |x, y| (x / 2 * 4 + y / 2 * 3) as u8)
}

fn source(image: &Image<u8>, source_from_keyframe: Sim3, camera: &Pinhole) -> Source {
    let view = SourceView {
        image,
        source_from_keyframe,
    };
    Source::new(&view, camera)
}

#[test]
fn sources_are_warped_as_their_pixels_are_projected() {
    // a width that is no multiple of the pixels that are looked up together
    let camera = Pinhole::new(40.0, 42.0, 22.0, 14.5);
    let turned = Rotation::from_euler_angles(0.02, -0.05, 0.03);
    let pose = Sim3::new(1.5, turned, Vec3::new(0.3, -0.1, 0.05));
    let source = source(&ramp(45, 30), pose, &camera);
    let (mut grey, mut unseen) = (vec![0; padded(45)], vec![0.0; padded(45)]);
    let mut seen = 0;
    for (idepth, y) in [0.2, 1.1]
        .into_iter()
        .flat_map(|d| (0..30).map(move |y| (d, y)))
    {
        let (mut same, mut same_unseen) = (grey.clone(), unseen.clone());
        warp_row(&source.at(idepth), y, &mut grey, &mut unseen);
        warp_row_with(Baseline, &source.at(idepth), y, &mut same, &mut same_unseen);
        assert!(
            same == grey && same_unseen == unseen,
            "other bits on other vectors"
        );
        for (x, (grey, unseen)) in grey.iter().zip(&unseen).take(45).enumerate() {
            let at = [x as f64, y as f64];
            let [u, v] = source.project(at, idepth.into()).unwrap();
            let is_inside = u > 2.0 && v > 2.0 && u < 41.99 && v < 26.99;
            let is_outside = u < 1.99 || v < 1.99 || u > 42.01 || v > 27.01;
            assert!(
                *unseen <= 0.0 || !is_inside,
                "{at:?} is not seen at {u} {v}"
            );
            assert!(*unseen > 0.0 || !is_outside, "{at:?} is seen at {u} {v}");
            if *unseen <= 0.0 {
                seen += 1;
                let expected = 4.0 * u + 3.0 * v;
                let error = (f64::from(*grey) / 4.0 - expected).abs();
                assert!(error < 0.13, "{grey} {expected}");
            }
        }
    }
    assert!((600..2600).contains(&seen), "{seen}");
}

/// The cost of a plane at a pixel, window by window in double precision.
fn plain_cost(half: &Image<f32>, warped: &[Warped], [x, y]: [usize; 2]) -> f64 {
    let window = |image: &dyn Fn(usize, usize) -> f32| -> Vec<f64> {
        let pixels = (y - 2..=y + 2).flat_map(|v| (x - 2..=x + 2).map(move |u| (u, v)));
        let values: Vec<f64> = pixels.map(|(u, v)| image(u, v).into()).collect();
        let mean = values.iter().sum::<f64>() / 25.0;
        values.iter().map(|value| value - mean).collect()
    };
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let own = window(&|u, v| half.at(u, v));
    let noise = 25.0 * GREY_SIGMA.powi(2);
    let mut costs: Vec<f64> = warped
        .iter()
        .filter(|warped| warped.unseen[y][x] <= 0.0)
        .map(|warped| {
            let other = window(&|u, v| f32::from(warped.grey[v][u]) / 4.0);
            let [own_var, other_var] = [&own, &other].map(|window| product(window, window) + noise);
            1.0 - product(&own, &other) / (own_var * other_var).sqrt()
        })
        .collect();
    costs.sort_by(f64::total_cmp);
    costs.truncate(2);
    let sum: f64 = costs.iter().sum();
    // no source sees it: as if nothing correlated
    let mean = if costs.is_empty() {
        1.0
    } else {
        sum / costs.len() as f64
    };
    60.0 * mean.min(1.0)
}

#[test]
fn costs_are_those_of_windows_compared_one_by_one() {
    let camera = CAMERA.half();
    let image = picture(0.0, true);
    let sources: Vec<Source> = EYES[..3]
        .iter()
        .map(|eye| source(&picture(*eye, true), at(*eye), &camera))
        .collect();
    let half = half_size(&image.map(f32::from));
    let idepths = vec![0.3, 0.4, 0.55];
    let volume = CostVolume::new(&image, &sources, idepths.clone());
    let (width, height) = (half.width(), half.height());
    for (k, idepth) in idepths.iter().enumerate() {
        let warped: Vec<Warped> = sources
            .iter()
            .map(|s| Warped::new(s, *idepth, &half))
            .collect();
        for y in 0..height {
            for x in 0..width {
                let is_inner = x >= 2 && y >= 2 && x < width - 2 && y < height - 2;
                let cost = f64::from(volume.at(y * width + x)[k]);
                let expected = if is_inner {
                    plain_cost(&half, &warped, [x, y])
                } else {
                    60.0
                };
                assert!(
                    (cost - expected).abs() < 0.6,
                    "{x} {y} {k}: {cost} {expected}"
                );
            }
        }
    }
}

/// The costs of the way that comes to a pixel by a step.
fn way(at: (i64, i64), step: (i64, i64), of: (&CostVolume, &Image<f32>, &DenseConfig)) -> Vec<i32> {
    let (volume, image, config) = of;
    let index = |(x, y): (i64, i64)| y as usize * volume.width + x as usize;
    let costs = volume.at(index(at)).iter().map(|c| i32::from(*c));
    let from = (at.0 - step.0, at.1 - step.1);
    let is_inside =
        (0..volume.width as i64).contains(&from.0) && (0..volume.height as i64).contains(&from.1);
    if !is_inside {
        return costs.collect();
    }
    let before = way(from, step, of);
    let least = before.iter().min().copied().unwrap();
    let grey = |at| image.as_slice()[index(at)];
    let edge = 1.0 + (grey(at) - grey(from)).abs() / 8.0;
    let small = i32::from(config.small_step_cost);
    let jump = ((f32::from(config.jump_cost) / edge) as i32).max(small);
    let best = |k: usize| {
        let beside = [k.checked_sub(1), Some(k + 1)].into_iter().flatten();
        let beside = beside.filter_map(|k| before.get(k)).map(|c| c + small);
        beside.chain([before[k], least + jump]).min().unwrap()
    };
    costs
        .enumerate()
        .map(|(k, cost)| cost + best(k) - least)
        .collect()
}

#[test]
fn sums_are_those_of_the_best_ways_one_by_one() {
    let (width, height, planes) = (7, 5, 9);
    let mut state = 5_u32;
    let mut random = |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % below
    };
    let volume = CostVolume {
        width,
        height,
        idepths: (0..planes).map(|k| 0.1 * k as f32).collect(),
        costs: (0..width * height * planes)
            .map(|_| random(61) as u8)
            .collect(),
    };
    let image = Image::from_fn(width, height, |_, _| random(40) as f32);
    for (small_step_cost, jump_cost) in [(6, 40), (63, 63), (0, 0)] {
        let config = DenseConfig {
            small_step_cost,
            jump_cost,
            ..DenseConfig::default()
        };
        let mut num_told = 0;
        aggregate(&volume, &image, &config, |pixel, sums| {
            num_told += 1;
            let at = ((pixel % width) as i64, (pixel / width) as i64);
            let mut expected = vec![0; planes];
            for step in [
                (1, 0),
                (1, 1),
                (0, 1),
                (-1, 1),
                (-1, 0),
                (-1, -1),
                (0, -1),
                (1, -1),
            ] {
                let way = way(at, step, (&volume, &image, &config));
                expected.iter_mut().zip(way).for_each(|(sum, c)| *sum += c);
            }
            let sums: Vec<i32> = sums.iter().map(|sum| i32::from(*sum)).collect();
            assert_eq!(sums, expected, "{pixel}");
        });
        assert_eq!(num_told, width * height);
    }
}

/// A warped source: its grey levels in quarters, and where it does not see.
struct Warped {
    grey: Vec<Vec<i16>>,
    unseen: Vec<Vec<f32>>,
}

impl Warped {
    fn new(source: &Source, idepth: f32, half: &Image<f32>) -> Self {
        let row = padded(half.width());
        let mut warped = Self {
            grey: vec![vec![0; row]; half.height()],
            unseen: vec![vec![0.0; row]; half.height()],
        };
        let warp = source.at(idepth);
        let rows = warped.grey.iter_mut().zip(&mut warped.unseen);
        for (y, (grey, unseen)) in rows.enumerate() {
            warp_row(&warp, y, grey, unseen);
        }
        warped
    }
}

#[test]
fn without_sources_or_depths_around_which_to_look_there_is_none() {
    let image = picture(0.0, false);
    let config = DenseConfig::default();
    assert!(dense_depth(&image, &CAMERA, &seeds(), &[], &config).is_none());
    let source = SourceView {
        image: &image,
        source_from_keyframe: at(0.1),
    };
    assert!(dense_depth(&image, &CAMERA, &seeds()[..50], &[source], &config).is_none());
}

#[test]
fn slanted_depth_is_interpolated_and_edges_stay() {
    let of = |idepth| DenseDepth {
        sigma: Image::filled(50, 40, 0.01),
        idepth,
    };
    let slanted = of(Image::from_fn(50, 40, |x, _| 1.0 + 0.01 * x as f32));
    // the middle of pixel 10 of the half image is at 20.5 of the full one
    for (x, expected) in [(20, 1.0975), (21, 1.1025)] {
        let found = slanted.at_full_size(x, 30).unwrap();
        assert!((found - expected).abs() < 1e-5, "{x}: {found}");
    }
    let edge = of(Image::from_fn(
        50,
        40,
        |x, _| if x < 10 { 1.0 } else { 2.0 },
    ));
    assert_eq!(edge.at_full_size(19, 30), Some(1.0));
    assert_eq!(edge.at_full_size(20, 30), Some(2.0));
    assert_eq!(DenseDepth::unknown(50, 40).at_full_size(20, 30), None);
}

/// How far the second camera is to the right, m.
const PAIR_BASELINE: f64 = 0.2;

#[test]
fn a_stereo_pair_measures_metres_from_its_baseline() {
    let images = [0.0, PAIR_BASELINE].map(|eye| picture(eye, true).map(f32::from));
    let pair = [&images[0], &images[1]];
    let pose = Se3::new(Rotation::identity(), Vec3::new(-PAIR_BASELINE, 0.0, 0.0));
    let measured = MeasuredDepth::of_pair(pair, &CAMERA, &pose);
    // in disparities, px
    let error = |pixel: &DepthPixel| {
        let ray = CAMERA.unproject(&Vec2::new(pixel.x.into(), pixel.y.into()));
        let truth = 1.0 / depth_of_ray(&ray, 0.0, true);
        CAMERA.fx * PAIR_BASELINE * (f64::from(pixel.idepth) - truth)
    };
    let errors: Vec<f64> = measured.pixels(1.0).map(|pixel| error(&pixel)).collect();
    assert!(errors.len() > WIDTH * HEIGHT / 2, "{}", errors.len());
    let right = errors.iter().filter(|e| e.abs() < 0.5).count();
    assert!(
        right as f64 > 0.9 * errors.len() as f64,
        "{right} of {}",
        errors.len()
    );
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean.abs() < 0.05, "{mean}");
    let stated = f64::from(measured.sigma()) * CAMERA.fx * PAIR_BASELINE;
    assert!((0.1..1.0).contains(&stated), "{stated}");
}

#[test]
fn a_second_camera_that_turns_sees_the_same_depth() {
    let turn = Rotation::from_axis_angle(&Vec3::y_axis(), 0.05);
    let images = [picture(0.0, false), turned(PAIR_BASELINE, &turn)].map(|i| i.map(f32::from));
    let centre = Vec3::new(PAIR_BASELINE, 0.0, 0.0);
    let second_from_first = Se3::new(turn.inverse(), -(turn.inverse() * centre));
    let measured = MeasuredDepth::of_pair([&images[0], &images[1]], &CAMERA, &second_from_first);
    let is_right = |pixel: &DepthPixel| {
        let ray = CAMERA.unproject(&Vec2::new(pixel.x.into(), pixel.y.into()));
        let truth = 1.0 / depth_of_ray(&ray, 0.0, false);
        CAMERA.fx * PAIR_BASELINE * (f64::from(pixel.idepth) - truth).abs() < 0.5
    };
    let all = measured.pixels(1.0).count();
    let right = measured.pixels(1.0).filter(is_right).count();
    assert!(
        all > WIDTH * HEIGHT / 2 && right as f64 > 0.9 * all as f64,
        "{right} of {all}"
    );
}

/// [`picture`] without the square, of a camera that is turned.
fn turned(eye_x: f64, turn: &Rotation) -> Image<u8> {
    Image::from_fn(WIDTH, HEIGHT, |u, v| {
        let ray = turn * CAMERA.unproject(&Vec2::new(u as f64, v as f64));
        let ray = ray / ray.z;
        grey_of(eye_x, &ray, depth_of_ray(&ray, eye_x, false))
    })
}

#[test]
fn a_pair_says_nothing_where_it_can_say_nothing() {
    let image = picture(0.0, true).map(f32::from);
    let at_one_place = MeasuredDepth::of_pair([&image, &image], &CAMERA, &Se3::identity());
    assert_eq!(at_one_place.pixels(1.0).count(), 0);
    // what is as near as 40 px of disparity allow is seen, the same picture twice is infinitely far
    let pose = Se3::new(Rotation::identity(), Vec3::new(-0.2, 0.0, 0.0));
    let far = MeasuredDepth::of_pair([&image, &image], &CAMERA, &pose);
    assert_eq!(far.pixels(1.0).count(), 0);
    let small = GrayImage::filled(20, 20, 7.0);
    assert_eq!(
        MeasuredDepth::of_pair([&small, &small], &CAMERA, &pose)
            .pixels(1.0)
            .count(),
        0
    );
    let other = MeasuredDepth::of_pair([&image, &small], &CAMERA, &pose);
    assert_eq!(
        (other.size(), other.pixels(1.0).count()),
        ((WIDTH, HEIGHT), 0)
    );
}
