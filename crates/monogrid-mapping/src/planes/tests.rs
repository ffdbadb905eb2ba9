//! The corner of a room.

use super::continued::is_line;
use super::*;
use crate::MappingConfig;
use crate::scene::View;
use crate::test_wall::CAMERA;
use crate::{DepthOf, ImageOf, PosedKeyframe};
use monogrid_geometry::{Rng, Rotation, Sim3, Vec3};
use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;

/// Distance of the wall ahead.
const AHEAD: f64 = 2.0;
/// That of the wall on the right.
const RIGHT: f64 = 0.6;
/// The column where they meet.
const CORNER: f64 = 121.5;

/// The inverse depth of the wall that a pixel sees, in a keyframe of that unit.
fn idepth(u: f64) -> f64 {
    f64::max(
        1.0 / AHEAD,
        (u - CAMERA.pinhole.cx) / CAMERA.pinhole.fx / RIGHT,
    )
}

fn plain() -> Image<u8> {
    Image::filled(CAMERA.width, CAMERA.height, 120)
}

fn textured() -> Image<u8> {
    Image::from_fn(CAMERA.width, CAMERA.height, |u, v| {
        40 + 160 * u8::from((u / 3 + v / 3) % 2 == 0)
    })
}

/// The unit of the keyframe.
const UNIT: f64 = 1.5;

/// Depth at the pixels that are known, 1 % uncertain.
fn measured(idepth: impl Fn(u16, u16) -> Option<f64>) -> Vec<Measurement> {
    let mut measured = Vec::new();
    for v in 0..CAMERA.height as u16 {
        for u in 0..CAMERA.width as u16 {
            if let Some(idepth) = idepth(u, v) {
                let idepth = (UNIT * idepth) as f32;
                measured.push(Measurement {
                    x: u,
                    y: v,
                    idepth,
                    sigma_idepth: 0.01 * idepth,
                });
            }
        }
    }
    measured
}

/// Does something with a keyframe that has these depths, and the planes in them.
fn with_planes<T>(
    image: &Image<u8>,
    depths: &Depths,
    config: &MappingConfig,
    work: impl FnOnce(&Scene, &Surroundings) -> T,
) -> T {
    let turned = Rotation::from_axis_angle(&Vec3::y_axis(), 0.7);
    let pose = Sim3::new(UNIT, turned, Vec3::new(3.0, -1.0, 2.0));
    let views = [Some(View::in_memory(depths, pose, &CAMERA))];
    let keyframes = [PosedKeyframe {
        id: 0,
        image: Some(ImageOf::Held(image)),
        depth: DepthOf::Held(&[]),
        world_from_keyframe: Some(pose),
    }];
    let clouds = [Cloud::new(views[0].as_ref(), &CAMERA, config)];
    let scene = Scene {
        keyframes: &keyframes,
        views: &views,
        camera: &CAMERA,
        config,
        threads: 1,
    };
    let surroundings = Surroundings::of(&scene, 0, |index| clouds.get(index)).unwrap();
    work(&scene, &surroundings)
}

/// What is added to depth of the walls at the pixels that are known.
fn added(image: &Image<u8>, idepth: impl Fn(u16, u16) -> Option<f64>) -> Vec<Measurement> {
    let depths = Depths {
        measured: measured(idepth),
        filled: Vec::new(),
    };
    let config = MappingConfig::default();
    let mut added = with_planes(image, &depths, &config, |scene, surroundings| {
        continued(scene, 0, surroundings)
    });
    for pixel in &mut added {
        pixel.idepth /= UNIT as f32;
        pixel.sigma_idepth /= UNIT as f32;
    }
    added
}

/// Depths before and after those on large planes were put on them, half of them measured, half
/// filled. Some pixels have none, so that the points that tell planes are not all in the same
/// columns.
fn straight(
    config: &MappingConfig,
    idepth: impl Fn(u16, u16) -> Option<f64>,
) -> Vec<(Measurement, Measurement)> {
    let some = |u: u16, v: u16| idepth(u, v).filter(|_| noise(v, u) < 0.7);
    let (measured, filled) = measured(some).into_iter().partition(|p| p.y % 2 == 0);
    let depths = Depths { measured, filled };
    let after = with_planes(&textured(), &depths, config, |scene, surroundings| {
        straightened(scene, 0, depths.clone(), surroundings)
    });
    let before = depths.measured.into_iter().chain(depths.filled);
    let pairs = before.zip(after.measured.into_iter().chain(after.filled));
    // how far to the rim a plane was measured depends on the points that tell it
    let is_inside = |p: &Measurement| (8..152).contains(&p.x) && (8..112).contains(&p.y);
    pairs.filter(|(before, _)| is_inside(before)).collect()
}

/// Relative noise of a pixel, evenly within 1.
fn noise(u: u16, v: u16) -> f64 {
    let mut rng = Rng::new(u64::from(u) * 1009 + u64::from(v));
    2.0 * rng.uniform() - 1.0
}

/// Both walls, but for the corner, where nothing was measured between columns 106 and 145, rows 30
/// and 100.
fn without_corner(u: u16, v: u16) -> Option<f64> {
    let is_open = (106..145).contains(&u) && (30..100).contains(&v);
    (!is_open).then(|| idepth(u.into()))
}

#[test]
fn walls_are_continued_to_where_they_meet() {
    let added = added(&plain(), without_corner);
    // as far as planes are continued: most of it
    let ahead = added.iter().filter(|p| f64::from(p.x) < CORNER).count();
    let areas = (ahead, added.len() - ahead);
    assert!(areas.0 > 900 && areas.1 > 100, "{areas:?}");
    for pixel in &added {
        let (u, expected) = (f64::from(pixel.x), idepth(pixel.x.into()));
        assert!((106.0..145.0).contains(&u) && (30..100).contains(&pixel.y));
        let off = f64::from(pixel.idepth) / expected - 1.0;
        // beside the corner either wall will do
        assert!(off.abs() < 0.01 || (u - CORNER).abs() < 1.0, "{u}: {off}");
        assert!(pixel.sigma_idepth > 0.01 * pixel.idepth);
    }
}

#[test]
fn a_plane_that_something_lies_behind_ends_where_it_was_measured() {
    // a doorway in the wall ahead, through which one sees farther
    let with_door = |u: u16, v: u16| match (20..60).contains(&u) && (20..110).contains(&v) {
        true => Some(0.5 / AHEAD),
        false => without_corner(u, v),
    };
    let added = added(&plain(), with_door);
    let ahead = |p: &&Measurement| f64::from(p.x) < CORNER - 2.0;
    assert_eq!(added.iter().filter(ahead).count(), 0);
}

#[test]
fn a_plain_region_beyond_an_edge_may_be_another_surface() {
    // the upper half is a ceiling that nobody measured, or the wall goes on
    let lower = |_: u16, v: u16| (v >= 60).then_some(1.0 / AHEAD);
    assert!(added(&plain(), lower).is_empty());
    // where there is texture, it is as far as planes are continued: 0.15 of the range is 21 px of
    // 140
    let added = added(&textured(), lower);
    let first = added.iter().map(|p| p.y).min().unwrap();
    assert!((34..48).contains(&first), "{first}");
    let expected = (60 - usize::from(first)) * CAMERA.width;
    assert!(
        10 * added.len() > 6 * expected,
        "{} of {expected}",
        added.len()
    );
}

#[test]
fn a_region_whose_outline_is_elsewhere_stays_open() {
    // something stands before most of the corner
    let with_box = |u: u16, v: u16| {
        let is_rim = (100..151).contains(&u) && (24..106).contains(&v);
        let idepth = without_corner(u, v)?;
        Some(if is_rim && v > 40 {
            1.4 * idepth
        } else {
            idepth
        })
    };
    let added = added(&textured(), with_box);
    assert!(added.is_empty(), "{}", added.len());
}

#[test]
fn points_along_a_line_are_a_line() {
    let line: Vec<[f64; 2]> = (0..100)
        .map(|i| [f64::from(i), 0.5 * f64::from(i)])
        .collect();
    assert!(is_line(&line) && is_line(&[]) && is_line(&line[..2]));
    let corner = line
        .iter()
        .map(|[x, _]| [*x, 0.0])
        .chain(line.iter().map(|[x, _]| [0.0, *x]));
    assert!(!is_line(&corner.collect::<Vec<_>>()));
}

#[test]
fn noise_of_a_wall_is_averaged_away_and_half_of_the_deviation_stays() {
    let noisy = |u: u16, v: u16| Some(idepth(u.into()) * (1.0 + 0.004 * noise(u, v)));
    let pixels = straight(&MappingConfig::default(), noisy);
    let error = |p: &Measurement| f64::from(p.idepth) / (UNIT * idepth(p.x.into())) - 1.0;
    let is_inside = |p: &&(Measurement, Measurement)| (f64::from(p.0.x) - CORNER).abs() > 6.0;
    let inside: Vec<_> = pixels.iter().filter(is_inside).collect();
    let square = |of: &dyn Fn(&(Measurement, Measurement)) -> f64| {
        inside.iter().map(|p| of(p).powi(2)).sum::<f64>() / inside.len() as f64
    };
    let (before, after) = (square(&|p| error(&p.0)), square(&|p| error(&p.1)));
    // 36 and 100 parts: what is left of a pixel is 0.26 of its error, but where no point told the
    // plane
    assert!(after < 0.2 * before, "{before} {after}");
    let moved: Vec<_> = inside.iter().filter(|p| p.0 != p.1).collect();
    assert!(10 * moved.len() > 9 * inside.len());
    for (before, after) in moved {
        let kept = f64::from(after.sigma_idepth / before.sigma_idepth);
        let expected = 0.5 + 0.5 * 0.6 / 0.6_f64.hypot(1.0);
        assert!((kept - expected).abs() < 0.01, "{kept}");
    }
}

#[test]
fn a_pixel_and_its_plane_weigh_by_their_variances() {
    let pixel = Measurement {
        x: 3,
        y: 4,
        idepth: 1.0,
        sigma_idepth: 0.04,
    };
    let mean = straight::averaged(pixel, 1.1, 0.03);
    assert!((mean.idepth - (1.0 * 9.0 + 1.1 * 16.0) / 25.0).abs() < 1e-6);
    assert!((mean.sigma_idepth - 0.5 * (0.04 + 0.024)).abs() < 1e-6);
    assert_eq!((mean.x, mean.y), (3, 4));
}

/// The wall ahead, of which some pixels are elsewhere.
fn wall_but(elsewhere: impl Fn(u16, u16) -> Option<f64>) -> impl Fn(u16, u16) -> Option<f64> {
    move |u, v| elsewhere(u, v).or(Some(1.0 / AHEAD))
}

#[test]
fn what_stands_before_a_wall_stays_there() {
    let config = MappingConfig::default();
    let is_picture = |u: u16, v: u16| (40..70).contains(&u) && (40..80).contains(&v);
    // two standard deviations of both are 0.0233
    for (before, stays) in [(1.022, false), (1.025, true)] {
        let picture = |u, v| is_picture(u, v).then_some(before / AHEAD);
        let pixels = straight(&config, wall_but(picture));
        let (on_picture, on_wall): (Vec<_>, Vec<_>) =
            pixels.iter().partition(|p| is_picture(p.0.x, p.0.y));
        let share_moved = |pixels: &[&(Measurement, Measurement)]| {
            pixels.iter().filter(|p| p.0 != p.1).count() as f64 / pixels.len() as f64
        };
        assert!(share_moved(&on_wall) > 0.9);
        match stays {
            true => assert!(share_moved(&on_picture) == 0.0),
            // on the wall there is less that tells where it was measured
            false => assert!(share_moved(&on_picture) > 0.2),
        }
    }
}

#[test]
fn what_is_not_flat_or_alone_stays() {
    let config = MappingConfig::default();
    let curtain = |u: u16, _: u16| Some((1.0 + 0.014 * (f64::from(u) / 3.0).sin()) / AHEAD);
    assert!(straight(&config, curtain).iter().all(|(a, b)| a == b));
    // as flat as it takes to be a wall
    let flatter = |u: u16, _: u16| Some((1.0 + 0.004 * (f64::from(u) / 3.0).sin()) / AHEAD);
    let moved = straight(&config, flatter);
    assert!(moved.iter().filter(|(a, b)| a != b).count() > moved.len() / 2);
    // one pixel far from where the wall was measured
    let alone = |u: u16, v: u16| (u < 60 || (u, v) == (150, 60)).then_some(1.0 / AHEAD);
    let pixels = straight(&config, alone);
    let still: Vec<_> = pixels.iter().filter(|(a, b)| a == b).collect();
    assert_eq!(still.len(), 1);
    assert_eq!((still[0].0.x, still[0].0.y), (150, 60));
}
