use super::{CameraMotion, MotionWatch};
use monogrid_geometry::Rng;
use monogrid_geometry::{Camera, Distortion, Pinhole, Rotation, Vec2, Vec3, rotation_exp};
use monogrid_image::GrayImage;

const SIZE: (usize, usize) = (320, 240);
const NUM: usize = 60;

/// A texture without an end: smooth between random grey levels at whole numbers.
fn texture(x: f64, y: f64) -> f32 {
    let level = |x: f64, y: f64| {
        let mixed = (x as i64 as u64)
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .wrapping_add((y as i64 as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F));
        Rng::new(mixed).uniform() * 220.0 + 20.0
    };
    let (left, top) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - left), smooth(y - top));
    let across = |y: f64| level(left, y) * (1.0 - u) + level(left + 1.0, y) * u;
    (across(top) * (1.0 - v) + across(top + 1.0) * v) as f32
}

/// A camera somewhere in a room with walls of that texture at x = 4 and -4, z = 4 and -4 and no end
/// up and down.
fn view(camera: &Camera, at: &Vec3, world_from_camera: &Rotation) -> GrayImage {
    // about ten pixels from one level to the next, so that there are corners with any lens
    let fine = camera.pinhole.fx / 43.0;
    let mut image = GrayImage::filled(SIZE.0, SIZE.1, 0.0);
    for y in 0..SIZE.1 {
        for (x, pixel) in image.row_mut(y).iter_mut().enumerate() {
            let Some(ray) = camera.unproject(&Vec2::new(x as f64, y as f64)) else {
                continue;
            };
            let ray = world_from_camera * ray;
            let until = |at: f64, step: f64| match step > 0.0 {
                true => (4.0 - at) / step,
                false => (-4.0 - at) / step,
            };
            let (to_x, to_z) = (until(at.x, ray.x), until(at.z, ray.z));
            let hit = at + ray * to_x.min(to_z);
            let along = if to_x < to_z { hit.z } else { hit.x };
            *pixel = texture(fine * along + 40.0 * f64::from(to_x < to_z), fine * hit.y);
        }
    }
    image
}

fn camera(focal: f64, k1: f64) -> Camera {
    let pinhole = Pinhole::centred(focal, SIZE.0, SIZE.1);
    let distortion = match k1 == 0.0 {
        true => Distortion::None,
        false => Distortion::RadialTangential {
            k1,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        },
    };
    Camera::try_new(SIZE.0, SIZE.1, pinhole, distortion).unwrap()
}

/// How this camera moves, which is known or not, on a path of positions and rotations from 0 to 1.
fn motion(
    camera: &Camera,
    is_given: bool,
    path: impl Fn(f64) -> (Vec3, Vec3),
    change: impl Fn(usize, &mut GrayImage),
) -> CameraMotion {
    let mut watch = MotionWatch::new(SIZE, is_given.then_some(camera), None);
    for k in 0..NUM {
        let (at, turn) = path(k as f64 / NUM as f64);
        let mut image = view(camera, &at, &rotation_exp(&turn));
        change(k, &mut image);
        watch.add(&image);
    }
    watch.conclusion()
}

fn unchanged(_: usize, _: &mut GrayImage) {}

#[test]
fn a_camera_that_only_turns_is_told_with_any_focal_length() {
    for (focal, k1) in [(900.0, 0.0), (300.0, 0.0), (180.0, 0.0), (260.0, -0.15)] {
        let camera = camera(focal, k1);
        let angle = 250.0 / focal;
        let pan = |t: f64| {
            let turn = Vec3::new(0.1 * angle * (9.0 * t).sin(), angle * (t - 0.5), 0.02 * t);
            (Vec3::new(0.3, 0.0, 0.2), turn)
        };
        for is_given in [false, true] {
            let found = motion(&camera, is_given, pan, unchanged);
            assert_eq!(found, CameraMotion::OnlyTurns, "{focal} {k1} {is_given}");
        }
    }
}

#[test]
fn a_camera_that_moves_is_not_called_turning() {
    let camera = camera(260.0, 0.0);
    let turn = |t: f64| Vec3::new(0.0, 0.6 * t, 0.0);
    // past a corner, straight ahead into it, and along one wall without a turn
    let sideways = |t: f64| (Vec3::new(2.5 - 2.0 * t, 0.0, 1.5), turn(t));
    let ahead = |t: f64| {
        (
            Vec3::new(1.0 + 1.5 * t, 0.0, 1.0 + 1.5 * t),
            Vec3::new(0.0, 0.7, 0.0),
        )
    };
    let along = |t: f64| (Vec3::new(2.0 * t - 1.0, 0.0, 2.0), Vec3::zeros());
    for is_given in [false, true] {
        assert_eq!(
            motion(&camera, is_given, sideways, unchanged),
            CameraMotion::Moves
        );
        assert_eq!(
            motion(&camera, is_given, ahead, unchanged),
            CameraMotion::Moves
        );
        let along = motion(&camera, is_given, along, unchanged);
        assert_ne!(along, CameraMotion::OnlyTurns, "given: {is_given}");
    }
}

#[test]
fn a_camera_that_stands_still_is_told_whatever_moves_before_it() {
    let camera = camera(260.0, 0.0);
    let still = |_: f64| (Vec3::zeros(), Vec3::zeros());
    assert_eq!(
        motion(&camera, false, still, unchanged),
        CameraMotion::StandsStill
    );
    // something small, and something before which little else is seen
    for (wide, high) in [(110, 60..200), (200, 20..220)] {
        let passes = |k: usize, image: &mut GrayImage| {
            let left = k * (SIZE.0 - wide) / NUM;
            for y in high.clone() {
                for (x, pixel) in image.row_mut(y)[left..left + wide].iter_mut().enumerate() {
                    *pixel = texture(0.1 * x as f64 + 900.0, 0.1 * y as f64);
                }
            }
        };
        assert_eq!(
            motion(&camera, false, still, passes),
            CameraMotion::StandsStill,
            "{wide} px wide"
        );
    }
}

#[test]
fn what_shows_nothing_is_left_open() {
    let watch = MotionWatch::new(SIZE, None, None);
    assert_eq!(watch.conclusion(), CameraMotion::Unclear);
    let camera = camera(260.0, 0.0);
    let turns = |t: f64| (Vec3::zeros(), Vec3::new(0.0, t, 0.0));
    let plain = |_: usize, image: &mut GrayImage| *image = GrayImage::filled(SIZE.0, SIZE.1, 90.0);
    assert_eq!(motion(&camera, false, turns, plain), CameraMotion::Unclear);
}

#[test]
fn corners_on_what_is_masked_do_not_count() {
    let camera = camera(260.0, 0.0);
    let sideways = |t: f64| {
        (
            Vec3::new(2.5 - 2.0 * t, 0.0, 1.5),
            Vec3::new(0.0, 0.6 * t, 0.0),
        )
    };
    let mut mask = monogrid_image::Mask::filled(SIZE.0, SIZE.1, 255);
    for y in 0..SIZE.1 {
        mask.row_mut(y)[..180].fill(0);
    }
    let mut watches = [None, Some(&mask)].map(|mask| MotionWatch::new(SIZE, None, mask));
    for k in 0..NUM {
        let (at, turn) = sideways(k as f64 / NUM as f64);
        let mut image = view(&camera, &at, &rotation_exp(&turn));
        for y in 0..SIZE.1 {
            for (x, pixel) in image.row_mut(y)[..180].iter_mut().enumerate() {
                *pixel = texture(0.2 * x as f64, 0.2 * y as f64 + 500.0);
            }
        }
        for watch in &mut watches {
            watch.add(&image);
        }
    }
    let [whole, masked] = watches.map(MotionWatch::conclusion);
    assert_eq!(masked, CameraMotion::Moves);
    assert_eq!(whole, CameraMotion::StandsStill, "the border stands still");
}
