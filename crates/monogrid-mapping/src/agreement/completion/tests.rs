//! A textured wall that keyframes side by side see.

use super::*;
use crate::scene::Depths;
use crate::scene::View;
use crate::test_wall::{CAMERA, wall};
use crate::{DepthOf, ImageOf, MappingConfig, PosedKeyframe};
use monogrid_geometry::{Rotation, Sim3, Vec3};

/// Distance of the wall.
const WALL: f32 = 2.0;

/// A keyframe at a place beside the first, with a unit of its own.
struct Taken {
    image: Image<u8>,
    depths: Depths,
    pose: Sim3,
}

/// Keyframes that see the wall, with the inverse depth of the point that each has at a pixel; 0:
/// none.
fn taken(count: usize, idepth: impl Fn(usize, f32, f32) -> f32) -> Vec<Taken> {
    (0..count)
        .map(|keyframe| {
            let (x, unit) = (0.08 * keyframe as f64, 1.0 + 0.25 * keyframe as f64);
            let mut measured = Vec::new();
            for v in 0..CAMERA.height as u16 {
                for u in 0..CAMERA.width as u16 {
                    let idepth = unit as f32 * idepth(keyframe, u.into(), v.into());
                    if idepth > 0.0 {
                        measured.push(Measurement {
                            x: u,
                            y: v,
                            idepth,
                            sigma_idepth: 0.01 * idepth,
                        });
                    }
                }
            }
            Taken {
                image: wall(x),
                depths: Depths {
                    measured,
                    filled: Vec::new(),
                },
                pose: Sim3::new(unit, Rotation::identity(), Vec3::new(x, 0.0, 0.0)),
            }
        })
        .collect()
}

fn is_hole(u: f32, v: f32) -> bool {
    (60.0..100.0).contains(&u) && (40.0..80.0).contains(&v)
}

const HOLE_AREA: usize = 40 * 40;

/// All of the wall, but for a hole in the first keyframe.
fn with_hole(keyframe: usize, u: f32, v: f32) -> f32 {
    match keyframe == 0 && is_hole(u, v) {
        true => 0.0,
        false => 1.0 / WALL,
    }
}

fn completed_first(taken: &[Taken], rules: &Rules) -> Vec<Measurement> {
    let views: Vec<Option<View>> = taken
        .iter()
        .map(|t| Some(View::in_memory(&t.depths, t.pose, &CAMERA)))
        .collect();
    let keyframes: Vec<PosedKeyframe> = taken
        .iter()
        .enumerate()
        .map(|(id, t)| PosedKeyframe {
            id: id as u32,
            image: Some(ImageOf::Held(&t.image)),
            depth: DepthOf::Held(&[]),
            world_from_keyframe: Some(t.pose),
        })
        .collect();
    let config = MappingConfig::default();
    let scene = Scene {
        keyframes: &keyframes,
        views: &views,
        camera: &CAMERA,
        config: &config,
        threads: 1,
    };
    completed_by(rules, &scene, 0)
}

/// Whether a depth of the first keyframe is that of the wall.
fn is_wall(pixel: &Measurement) -> bool {
    (pixel.idepth * WALL - 1.0).abs() < 0.01
}

#[test]
fn a_hole_has_the_depth_of_keyframes_that_see_the_same() {
    let found = completed_first(&taken(3, with_hole), &RULES);
    assert!(100 * found.len() > 95 * HOLE_AREA, "{}", found.len());
    for pixel in &found {
        assert!(is_hole(pixel.x.into(), pixel.y.into()) && is_wall(pixel));
        let sigma = pixel.sigma_idepth / pixel.idepth;
        // less certain than the 1 % that those have
        assert!((sigma - 0.013).abs() < 1e-4, "{sigma}");
    }
    // one alone may be wrong
    assert_eq!(completed_first(&taken(2, with_hole), &RULES), []);
    let one = Rules {
        min_support: 1,
        ..RULES
    };
    assert!(!completed_first(&taken(2, with_hole), &one).is_empty());
}

#[test]
fn what_looks_different_keeps_its_hole() {
    let mut taken = taken(4, with_hole);
    // a post that stands before the wall, of which nobody has the depth
    for v in 40..80 {
        for u in 70..90 {
            taken[0].image.set(u, v, 255);
        }
    }
    let is_post = |p: &&Measurement| (72..88).contains(&p.x);
    let found = completed_first(&taken, &RULES);
    let on_post = found.iter().filter(is_post).count();
    assert!(on_post < 16, "{on_post}");
    assert!(found.len() - on_post > HOLE_AREA / 3);
    let blind = Rules {
        max_difference: 255.0,
        ..RULES
    };
    let found = completed_first(&taken, &blind);
    assert!(found.iter().filter(is_post).count() > 500);
}

#[test]
fn what_others_see_through_is_not_taken_over() {
    // two keyframes have a false patch half way to the wall, at the same place; two see the wall
    // behind it
    let with_patch = |keyframe: usize, u: f32, v: f32| {
        let (x, y) = ((u - 79.5) / 140.0, (v - 59.5) / 140.0);
        let beside = 0.08 * keyframe as f32;
        let is_patch = (x + beside).abs() < 0.1 && y.abs() < 0.1;
        match (1..3).contains(&keyframe) && is_patch {
            true => 2.0 / WALL,
            false => with_hole(keyframe, u, v),
        }
    };
    let taken = taken(5, with_patch);
    let blind = Rules {
        max_difference: 255.0,
        ..RULES
    };
    let found = completed_first(&taken, &blind);
    assert!(100 * found.len() > 90 * HOLE_AREA, "{}", found.len());
    assert!(found.iter().all(is_wall));
    let credulous = Rules {
        max_against: 10.0,
        ..blind
    };
    let found = completed_first(&taken, &credulous);
    assert!(found.iter().filter(|p| !is_wall(p)).count() > 300);
}

#[test]
fn the_first_of_two_surfaces_is_seen() {
    // a board half way to the wall, which all others have
    let with_board = |keyframe: usize, u: f32, v: f32| {
        let x = (u - 79.5) / 140.0 + 0.08 * keyframe as f32;
        match (x.abs() < 0.1, keyframe == 0 && is_hole(u, v)) {
            (_, true) => 0.0,
            (true, false) => 2.0 / WALL,
            (false, false) => 1.0 / WALL,
        }
    };
    let blind = Rules {
        max_difference: 255.0,
        ..RULES
    };
    let found = completed_first(&taken(4, with_board), &blind);
    let on_board = found.iter().filter(|p| (67..92).contains(&p.x));
    let (near, all) = on_board.fold((0, 0), |(near, all), p| {
        (near + u32::from(!is_wall(p)), all + 1)
    });
    assert!(all > 900 && 100 * near > 95 * all, "{near} of {all}");
}
