//! A street with house fronts, parked cars and traffic, driven through by a car that turns left
//! once.
//!
//! The street runs along +x to a crossing and on along +y. Above the roofs is a glowing box, the
//! sky: it has no texture, so nothing can be tracked on it, but it is a surface of the world, and
//! depth images and truth maps have it.

use crate::path::Waypoint;
use crate::patterns;
use crate::random::Random;
use crate::scene::{Material, MaterialId, Scene, place, place_tilted};
use crate::shapes::p;
use monogrid_geometry::{Rotation, Se3, Vec3};
use std::f32::consts::{FRAC_PI_2, PI};
use std::f64::consts::{FRAC_PI_2 as QUARTER_TURN, PI as HALF_TURN};

/// Middle line of the houses' fronts: half of the distance between both sides, m.
const FRONT_M: f32 = 8.0;
/// Half of the road with the parking strips, m.
const KERB_M: f32 = 5.5;
/// Middle of the street that is turned into (x, m).
const SECOND_X: f32 = 70.0;
/// Ends of the first street (x) and of the second (y), m.
const WEST_M: f32 = -12.0;
const ENDS_M: [f32; 2] = [-20.0, 92.0];
/// Depth of the houses, m.
const DEPTH_M: f32 = 8.0;
/// Height of the sky, m.
const SKY_M: f32 = 16.0;

/// Corners of the ground and the sky (x, y, m).
const CORNERS_M: [[f32; 2]; 2] = [
    [WEST_M - DEPTH_M - 1.0, ENDS_M[0] - DEPTH_M - 1.0],
    [
        SECOND_X + FRONT_M + DEPTH_M + 1.0,
        ENDS_M[1] + DEPTH_M + 1.0,
    ],
];

/// What houses and road are made of.
struct Materials {
    fronts: Vec<MaterialId>,
    glass: Vec<MaterialId>,
    light: MaterialId,
    dark: MaterialId,
    paving: MaterialId,
    wood: MaterialId,
    leaves: MaterialId,
}

impl Materials {
    fn new(s: &mut Scene) -> Self {
        let mut fronts: Vec<MaterialId> = [0.62, 0.5, 0.72].map(|tone| s.plain(tone)).into();
        fronts.push(s.tiled(patterns::bricks(0.32, 20, 701), 2.4, 1.6));
        fronts.push(s.tiled(patterns::rough(0.55, 0.35, 12, 0.7, 702), 4.0, 4.0));
        Self {
            fronts,
            glass: (0..4)
                .map(|k| s.material(Material::fitted(patterns::outdoors(710 + k)).glowing(0.22)))
                .collect(),
            light: s.plain(0.75),
            dark: s.plain(0.10),
            paving: s.tiled(patterns::tiles(0.42, 0.25, 8, 703), 4.0, 4.0),
            wood: s.tiled(patterns::wood(0.22, 0.8, 704), 0.8, 1.6),
            leaves: s.tiled(patterns::rough(0.22, 1.3, 9, 0.85, 705), 2.0, 2.0),
        }
    }
}

/// Builds the street without what moves in it.
pub(super) fn scene() -> Scene {
    let mut scene = Scene::default();
    let s = &mut scene;
    let m = Materials::new(s);
    ground(s, &m);
    sky(s);
    let mut random = Random::new(720);
    for (x, y, heading, length) in rows() {
        s.at(place(x, y, 0.0, heading), |s| {
            row(s, &m, length, &mut random);
        });
    }
    roadside(s, &m, &mut random);
    scene
}

/// Rows of houses: where they begin, along which direction they go, how far (m). Fronts are to the
/// right of it.
fn rows() -> [(f32, f32, f32, f32); 8] {
    let (west, east) = (SECOND_X - FRONT_M, SECOND_X + FRONT_M);
    let [south, north] = ENDS_M;
    let (length, corner) = (west - WEST_M, FRONT_M + DEPTH_M);
    [
        (WEST_M, FRONT_M, 0.0, length),
        (west, -FRONT_M, PI, length),
        (west, corner, FRAC_PI_2, north - corner),
        (west, south, FRAC_PI_2, -corner - south),
        (east, north, -FRAC_PI_2, north - south),
        (WEST_M, -FRONT_M, FRAC_PI_2, 2.0 * FRONT_M),
        (east, south, PI, 2.0 * FRONT_M),
        (west, north, 0.0, 2.0 * FRONT_M),
    ]
}

/// Asphalt, pavements and the dashed line in the middle.
fn ground(s: &mut Scene, m: &Materials) {
    s.object("road");
    let [south, north] = ENDS_M;
    let asphalt = s.tiled(patterns::rough(0.20, 0.45, 24, 0.8, 706), 6.0, 6.0);
    let [[x0, y0], [x1, y1]] = CORNERS_M;
    s.floor([x0, y0, 0.0], [x1 - x0, y1 - y0], asphalt);
    s.object("pavements");
    let (near, far) = (SECOND_X - KERB_M, SECOND_X + KERB_M);
    for (min, max) in [
        ([WEST_M, KERB_M], [near, FRONT_M]),
        ([WEST_M, -FRONT_M], [near, -KERB_M]),
        ([SECOND_X - FRONT_M, FRONT_M], [near, north]),
        ([SECOND_X - FRONT_M, south], [near, -FRONT_M]),
        ([far, south], [SECOND_X + FRONT_M, north]),
    ] {
        s.cuboid([min[0], min[1], -0.01], [max[0], max[1], 0.12], m.paving);
    }
    s.object("markings");
    for k in 0..13 {
        let x = WEST_M + 2.0 + 5.5 * k as f32;
        s.floor([x, -0.07, 0.006], [2.5, 0.14], m.light);
    }
    for k in 0..15 {
        let y = 9.0 + 5.5 * k as f32;
        s.floor([SECOND_X - 0.07, y, 0.006], [0.14, 2.5], m.light);
    }
}

/// The glowing box around all, and lamps as large as streets below its lid: an overcast day.
fn sky(s: &mut Scene) {
    s.object("sky");
    let glow = s.material(Material::plain(0.9).glowing(0.85));
    let [[x0, y0], [x1, y1]] = CORNERS_M;
    let (along_x, along_y) = (p(x1 - x0, 0.0, 0.0), p(0.0, y1 - y0, 0.0));
    let (corner, up) = (p(x0, y0, 0.0), p(0.0, 0.0, SKY_M));
    s.quad(corner + up, along_y, along_x, glow);
    s.quad(corner, up, along_x, glow);
    s.quad(corner + along_y, along_x, up, glow);
    s.quad(corner, along_y, up, glow);
    s.quad(corner + along_x, up, along_y, glow);
    let z = SKY_M - 0.1;
    for k in 0..4 {
        let x = WEST_M + 20.5 * k as f32;
        s.light_below([x, -10.0, z], [20.5, 20.0], 1.0);
    }
    for k in 0..5 {
        let y = ENDS_M[0] + 22.4 * k as f32;
        s.light_below([SECOND_X - 10.0, y, z], [20.0, 22.4], 1.0);
    }
}

/// Houses along +x from the origin, fronts to -y, until a length is filled.
fn row(s: &mut Scene, m: &Materials, length: f32, random: &mut Random) {
    let count = (length / 9.0).round().max(1.0);
    let width = length / count;
    for k in 0..count as usize {
        let pose = place(width * (k as f32 + 0.5), random.range(0.0, 0.35), 0.0, 0.0);
        s.object_at("house", pose);
        house(s, m, width, random);
    }
}

/// A house of three or four storeys: door, windows with sills, a cornice.
fn house(s: &mut Scene, m: &Materials, width: f32, random: &mut Random) {
    let front = m.fronts[random.below(m.fronts.len())];
    let storeys = 3 + random.below(2);
    let height = 3.1 * storeys as f32 + random.range(0.4, 1.2);
    let half = 0.5 * width;
    s.cuboid([-half, 0.0, 0.0], [half, DEPTH_M - 0.4, height], front);
    s.cuboid([-half, -0.25, height - 0.3], [half, 0.0, height], m.light);
    s.cuboid([-half, -0.04, 0.0], [half, 0.0, 0.6], m.dark);
    let columns = (width / random.range(1.9, 2.9)) as usize;
    let door = random.below(columns);
    for column in 0..columns {
        let x = -half + width * (column as f32 + 0.5) / columns as f32;
        for storey in 0..storeys {
            let z = 1.0 + 3.1 * storey as f32;
            if storey == 0 && column == door {
                s.cuboid([x - 0.55, -0.06, 0.12], [x + 0.55, 0.0, 2.4], m.wood);
            } else {
                let glass = m.glass[random.below(m.glass.len())];
                s.at(place(x, 0.0, z, 0.0), |s| window(s, m, glass));
            }
        }
    }
}

/// A window in a wall at y = 0: glass in which the other side is seen as if printed, frame, sill.
fn window(s: &mut Scene, m: &Materials, glass: MaterialId) {
    s.panel([0.0, -0.01, 0.0], 1.1, 1.5, glass);
    for x in [-0.6, -0.03, 0.54] {
        s.cuboid([x, -0.06, 0.0], [x + 0.06, 0.0, 1.5], m.light);
    }
    s.cuboid([-0.7, -0.16, -0.08], [0.7, 0.0, 0.0], m.light);
    s.cuboid([-0.65, -0.06, 1.5], [0.65, 0.0, 1.6], m.light);
}

/// Parked cars, lamp posts and trees on both sides of both streets.
fn roadside(s: &mut Scene, m: &Materials, random: &mut Random) {
    let paints = [0.05, 0.12, 0.35, 0.6, 0.75].map(|tone| s.plain(tone));
    let first = (0..9).map(|k| (WEST_M + 4.0 + 7.0 * k as f32, 0.0f32));
    let second = (0..10).map(|k| (18.0 + 7.0 * k as f32, FRAC_PI_2));
    for (along, heading) in first.chain(second) {
        for side in [-1.0f32, 1.0] {
            let paint = paints[random.below(paints.len())];
            let (shift, is_taken) = (random.range(-0.8, 0.8), random.unit() < 0.7);
            let (has_tree, has_post) = (random.unit() < 0.35, random.unit() < 0.45);
            let at = |along: f32, across: f32| match heading == 0.0 {
                true => place(along, across, 0.0, heading),
                false => place(SECOND_X - across, along, 0.0, heading),
            };
            if is_taken {
                let pose = at(along + shift, side * (KERB_M - 1.05));
                s.object_at("parked car", pose);
                car(s, paint, m.dark, m.light);
            }
            if has_tree {
                let pose = at(along + 3.4, side * (KERB_M + 0.7));
                s.object_at("tree", pose);
                tree(s, m, random);
            }
            if has_post {
                let pose = at(along + 1.5, side * (KERB_M + 0.4));
                s.object_at("lamp post", pose);
                post(s, m);
            }
        }
    }
}

fn tree(s: &mut Scene, m: &Materials, random: &mut Random) {
    s.lathe(&[0.09, 0.12, 0.17], &[3.2, 1.5, 0.0], 16, m.wood);
    for _ in 0..4 {
        let (x, y) = (random.range(-0.7, 0.7), random.range(-0.6, 0.6));
        let (z, radius) = (random.range(3.2, 4.8), random.range(0.8, 1.2));
        s.sphere([x, y, z], radius, m.leaves);
    }
}

fn post(s: &mut Scene, m: &Materials) {
    s.cylinder(0.07, 6.0, m.dark);
    s.cuboid([-0.2, -0.12, 6.0], [0.6, 0.12, 6.12], m.light);
    s.cuboid([-0.02, -0.3, 2.1], [0.0, 0.3, 2.7], m.light);
}

/// A car around its own middle on the road, its front to +x; 4.2 m long.
fn car(s: &mut Scene, paint: MaterialId, dark: MaterialId, light: MaterialId) {
    s.rounded_box([0.0, 0.0, 0.58], [4.2, 1.75, 0.62], 0.14, paint);
    s.rounded_box([-0.25, 0.0, 1.10], [2.3, 1.55, 0.62], 0.22, dark);
    s.rounded_box([-0.3, 0.0, 1.42], [1.6, 1.40, 0.08], 0.04, paint);
    for (x, y) in [(1.3, 0.82), (1.3, -0.66), (-1.3, 0.82), (-1.3, -0.66)] {
        s.at(place_tilted(x, y, 0.32, [FRAC_PI_2, 0.0, 0.0]), |s| {
            s.cylinder(0.32, 0.16, dark);
        });
    }
    for x in [-2.08, 2.08] {
        for y in [-0.62, 0.62] {
            let (min, max) = ([x - 0.03, y - 0.16, 0.62], [x + 0.03, y + 0.16, 0.76]);
            s.cuboid(min, max, light);
        }
        s.cuboid([x - 0.04, -0.26, 0.42], [x + 0.04, 0.26, 0.53], light);
    }
}

/// A car of the traffic under a sky of its own, as bright as a paint.
pub(crate) fn traffic_car(paint: f32) -> Scene {
    let mut scene = Scene::default();
    let s = &mut scene;
    s.object("car");
    let (paint, dark, light) = (s.plain(paint), s.plain(0.06), s.plain(0.75));
    car(s, paint, dark, light);
    s.light_below([-6.0, -6.0, 10.0], [12.0; 2], 1.0);
    scene
}

/// Radius of the turn, and where it begins (x); it ends as far above the first street (y, m).
const TURN_M: f64 = 11.75;
const TURN_X: f64 = 60.0;
/// Where the way begins (x), and how long it is, m.
const START_X: f64 = -4.0;
pub(super) const WAY_M: f64 = 64.0 + QUARTER_TURN * TURN_M + 55.0;
/// From the middle of a lane to the middle of the other, m.
const LANES_M: f64 = 3.5;
/// Height of the camera on the car, m.
const EYE_M: f64 = 1.6;

/// A point of the lane, a distance after the start of the way, and its heading (rad); straight on
/// before and after it.
fn on_lane(distance_m: f64, to_the_left_m: f64) -> ([f64; 2], f64) {
    let straight = TURN_X - START_X;
    let arc = QUARTER_TURN * TURN_M;
    let turned = ((distance_m - straight) / TURN_M).clamp(0.0, QUARTER_TURN);
    let radius = TURN_M - to_the_left_m;
    let centre = [TURN_X, TURN_M - 0.5 * LANES_M];
    let before = (distance_m - straight).min(0.0);
    let after = (distance_m - straight - arc).max(0.0);
    let x = centre[0] + radius * turned.sin() + before;
    let y = centre[1] - radius * turned.cos() + after;
    ([x, y], turned)
}

/// Along the right lane, looking ahead.
pub(super) fn way() -> Vec<Waypoint> {
    let count = WAY_M as usize;
    let waypoint = |k| {
        let at_m = WAY_M * k as f64 / count as f64;
        let ([x, y], _) = on_lane(at_m, 0.0);
        let ([a, b], _) = on_lane(at_m + 9.0, 0.0);
        ([x, y, EYE_M], [a, b, EYE_M - 0.2])
    };
    (0..=count).map(waypoint).collect()
}

/// Paints of the cars that drive, in the order of [`traffic`].
pub(crate) const PAINTS: [f32; 8] = [0.35, 0.7, 0.12, 0.6, 0.05, 0.5, 0.75, 0.2];

/// Where cars are when the camera has gone a part of its way, in [0, 1]: two ahead at about its
/// speed, six that come towards it.
pub(crate) fn traffic(progress: f64) -> [Se3; PAINTS.len()] {
    std::array::from_fn(|k| {
        let gone_m = WAY_M * progress;
        if k < 2 {
            let gap_m = 11.0 + 13.0 * k as f64 + 2.5 * (9.0 * progress + k as f64).sin();
            on_road(gone_m + gap_m, 0.0)
        } else {
            let start_m = 22.0 + 37.0 * (k - 2) as f64;
            on_road(start_m - 0.85 * gone_m, LANES_M)
        }
    })
}

/// Pose of a car on the lane of the camera, or on that to the left of it, where it comes back.
fn on_road(distance_m: f64, to_the_left_m: f64) -> Se3 {
    let ([x, y], heading) = on_lane(distance_m, to_the_left_m);
    let back = if to_the_left_m > 0.0 { HALF_TURN } else { 0.0 };
    let heading = Rotation::from_axis_angle(&Vec3::z_axis(), heading + back);
    Se3::new(heading, Vec3::new(x, y, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cars_keep_clear_of_the_camera_and_of_each_other_and_drive_where_they_look() {
        for k in 0..500 {
            let progress = f64::from(k) / 499.0;
            let ([x, y], _) = on_lane(WAY_M * progress, 0.0);
            let cars = traffic(progress);
            let next = traffic(progress + 1e-4);
            for (i, car) in cars.iter().enumerate() {
                let own = (car.translation - Vec3::new(x, y, 0.0)).norm();
                assert!(own > 3.2, "{i} at {progress}: {own} m from the camera");
                let ahead = car.inverse() * next[i].translation;
                assert!(
                    ahead.x > 0.001 && ahead.y.abs() < 0.2 * ahead.x,
                    "{i}: {ahead}"
                );
                for other in &cars[..i] {
                    let between = (car.translation - other.translation).norm();
                    assert!(between > 3.2, "{i} at {progress}: {between} m");
                }
            }
        }
    }
}
