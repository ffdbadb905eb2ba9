//! The corner of a room.

use super::*;
use crate::mapping::agreement::View;
use crate::mapping::scan::Depths;
use crate::mapping::test_wall::CAMERA;
use crate::mapping::{DepthOf, ImageOf, PosedKeyframe};
use monogrid_geometry::Rotation;
use monogrid_image::Image;

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

/// What is added to depth of the walls at the pixels that are known, in a keyframe whose unit is 1.5.
fn added(image: &Image<u8>, idepth: impl Fn(u16, u16) -> Option<f64>) -> Vec<Measurement> {
    let unit = 1.5;
    let mut measured = Vec::new();
    for v in 0..CAMERA.height as u16 {
        for u in 0..CAMERA.width as u16 {
            if let Some(idepth) = idepth(u, v) {
                let idepth = (unit * idepth) as f32;
                measured.push(Measurement {
                    x: u,
                    y: v,
                    idepth,
                    sigma_idepth: 0.01 * idepth,
                });
            }
        }
    }
    let depths = Depths {
        measured,
        filled: Vec::new(),
    };
    let turned = Rotation::from_axis_angle(&Vec3::y_axis(), 0.7);
    let pose = Sim3::new(unit, turned, Vec3::new(3.0, -1.0, 2.0));
    let views = [Some(View::in_memory(&depths, pose, &CAMERA))];
    let keyframes = [PosedKeyframe {
        id: 0,
        image: Some(ImageOf::Held(image)),
        depth: DepthOf::Held(&[]),
        world_from_keyframe: Some(pose),
    }];
    let config = MappingConfig::default();
    let clouds = [Cloud::new(views[0].as_ref(), &CAMERA, &config)];
    let scene = Scene {
        keyframes: &keyframes,
        views: &views,
        camera: &CAMERA,
        config: &config,
        threads: 1,
    };
    let mut added = enclosed(&scene, 0, |index| clouds.get(index));
    for pixel in &mut added {
        pixel.idepth /= unit as f32;
        pixel.sigma_idepth /= unit as f32;
    }
    added
}

/// Both walls, but for the corner, where nothing was measured between columns 106 and 145, rows 30 and 100.
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
    // where there is texture, it is as far as planes are continued: 0.15 of the range is 21 px of 140
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
