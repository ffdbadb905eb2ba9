//! Rooms of exact planes, seen by cameras whose poses are known.

use super::*;
use crate::{KeyframeCamera, KeyframeScan, z_up_from_camera_world};
use monogrid_geometry::Pinhole;
use monogrid_occupancy::DepthPixel as Measurement;

const CAMERA: KeyframeCamera = KeyframeCamera {
    pinhole: Pinhole {
        fx: 140.0,
        fy: 140.0,
        cx: 79.5,
        cy: 59.5,
    },
    width: 160,
    height: 120,
};

/// Walls, floor and, where there is one, a table: a point is inside where `normal . point >
/// offset`.
struct Room {
    planes: Vec<(Vec3, f64)>,
    table_height: Option<f64>,
}

/// 6 m by 5 m by 2.5 m, the floor at z = 0.
fn room(table_height: Option<f64>) -> Room {
    Room {
        planes: vec![
            (Vec3::z(), 0.0),
            (-Vec3::z(), -2.5),
            (Vec3::x(), -3.0),
            (-Vec3::x(), -3.0),
            (Vec3::y(), -2.5),
            (-Vec3::y(), -2.5),
        ],
        table_height,
    }
}

impl Room {
    /// Distance along a ray in units of its length.
    fn hit(&self, origin: &Vec3, ray: &Vec3) -> f64 {
        let walls = self.planes.iter().filter_map(|(normal, offset)| {
            let along = normal.dot(ray);
            (along < 0.0).then(|| (offset - normal.dot(origin)) / along)
        });
        let table = self.table_height.and_then(|height| {
            let distance = (height - origin.z) / ray.z;
            let point = origin + ray * distance;
            (distance > 0.0 && point.x.abs() < 1.0 && point.y.abs() < 1.0).then_some(distance)
        });
        walls.chain(table).fold(f64::INFINITY, f64::min)
    }

    /// What a camera sees, every second pixel, with 0.5 % of noise.
    fn scan(&self, id: u32, room_from_camera: &Sim3) -> KeyframeScan {
        let mut state = id.wrapping_add(1);
        let mut pixels = Vec::new();
        for y in (0..CAMERA.height).step_by(2) {
            for x in (0..CAMERA.width).step_by(2) {
                let pixel = monogrid_geometry::Vec2::new(x as f64, y as f64);
                let ray = room_from_camera.rotation * CAMERA.pinhole.unproject(&pixel);
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
                let depth = self.hit(&room_from_camera.translation, &ray) * (1.0 + 0.01 * noise);
                pixels.push(Measurement {
                    x: x as u16,
                    y: y as u16,
                    idepth: (1.0 / depth) as f32,
                    sigma_idepth: (0.01 / depth) as f32,
                });
            }
        }
        KeyframeScan::of_measurements(id, CAMERA, pixels, 0)
    }
}

/// A camera at 1.4 m that turns, and looks down by `pitch_deg`, rolled by `roll_deg`.
fn room_from_cameras(count: usize, pitch_deg: f64, roll_deg: f64) -> Vec<Sim3> {
    let level = z_up_from_camera_world().rotation;
    (0..count)
        .map(|k| {
            let turn = Rotation::from_scaled_axis(Vec3::z() * (0.3 + 0.5 * k as f64));
            let pitch = Rotation::from_scaled_axis(-Vec3::x() * pitch_deg.to_radians());
            let roll = Rotation::from_scaled_axis(Vec3::z() * roll_deg.to_radians());
            let centre = Vec3::new(-1.5 + 0.2 * k as f64, 1.2, 1.4);
            Sim3::new(1.0, turn * level * pitch * roll, centre)
        })
        .collect()
}

/// How the first of such cameras is held.
fn moving_first(roll_deg: f64) -> Rotation {
    room_from_cameras(1, 15.0, roll_deg)[0].rotation
}

/// What is found when the first camera is the frame of the world, and up as it is.
fn found(room: &Room, room_from_cameras: &[Sim3], scale: f64) -> (Upright, Vec3) {
    seen(room, room_from_cameras, scale, |views, path| {
        upright(views, path).unwrap()
    })
}

/// What is found in views of a room, whose world has units of `scale`, and the true up there.
fn seen<T>(
    room: &Room,
    room_from_cameras: &[Sim3],
    scale: f64,
    find: impl Fn(&[UprightView], &[Se3]) -> T,
) -> (T, Vec3) {
    let first = &room_from_cameras[0];
    let scaled = Sim3::new(1.0 / scale, Rotation::identity(), Vec3::zeros());
    let world_from_room = scaled * first.inverse();
    let scans: Vec<KeyframeScan> = (0..)
        .zip(room_from_cameras)
        .map(|(id, pose)| room.scan(id, pose))
        .collect();
    let views: Vec<UprightView> = scans
        .iter()
        .zip(room_from_cameras)
        .map(|(scan, pose)| UprightView {
            scan,
            image: None,
            world_from_keyframe: world_from_room * *pose,
        })
        .collect();
    let path: Vec<Se3> = views
        .iter()
        .map(|v| v.world_from_keyframe.to_se3())
        .collect();
    (find(&views, &path), first.rotation.inverse() * Vec3::z())
}

fn angle_deg(a: &Vec3, b: &Vec3) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

#[test]
fn a_room_is_level_however_it_was_entered() {
    // a run that starts tilted by up to 60 degrees about any axis, or upside down, and is held as
    // usual afterwards
    for k in 0..10 {
        let angle = if k == 9 {
            180.0
        } else {
            60.0 - 5.0 * f64::from(k)
        };
        let axis = Vec3::new(f64::from(k).cos(), 0.3, f64::from(k).sin()).normalize();
        let mut cameras = room_from_cameras(8, 20.0, 3.0);
        cameras[0].rotation *= Rotation::from_scaled_axis(axis * f64::to_radians(angle));
        let (found, up) = found(&room(Some(0.7)), &cameras, 2.5);
        let off = angle_deg(&found.up_in_world, &up);
        assert!(off < 0.5, "start {k}: {off} degrees");
        assert!(found.confidence > 0.2, "start {k}: {found:?}");
        let floor = found.floor.unwrap();
        assert!((floor.camera_height * 2.5 - 1.4).abs() < 0.03, "{floor:?}");
        // the origin is the first camera
        assert!((floor.height * 2.5 + 1.4).abs() < 0.03, "{floor:?}");
    }
}

#[test]
fn a_floor_is_level_although_the_up_that_is_known_is_off_by_degrees() {
    let cameras = room_from_cameras(8, 20.0, 3.0);
    let (_, up) = found(&room(None), &cameras, 2.5);
    for tilt_deg in [0.0_f64, 3.0, 6.0] {
        let tilt = Rotation::from_scaled_axis(Vec3::z() * tilt_deg.to_radians());
        let floor =
            |views: &[UprightView], path: &[Se3]| floor_below(views, path, &(tilt * up)).unwrap();
        let (floor, _) = seen(&room(None), &cameras, 2.5, floor);
        // the cameras are at 1.4 m, and the first is the origin of the world
        let [height, camera_height] = [floor.height, floor.camera_height].map(|h| 2.5 * h);
        assert!((camera_height - 1.4).abs() < 0.02, "{tilt_deg}: {floor:?}");
        assert!((height + 1.4).abs() < 0.03, "{tilt_deg}: {floor:?}");
        assert!(floor.share > 0.9, "{tilt_deg}: {floor:?}");
    }
}

#[test]
fn a_table_is_not_the_floor_but_is_all_that_there_is_without_one() {
    let cameras = room_from_cameras(6, 35.0, 0.0);
    let (with_table, _) = found(&room(Some(0.7)), &cameras, 1.0);
    let floor = with_table.floor.unwrap();
    assert!((floor.camera_height - 1.4).abs() < 0.03, "{floor:?}");
    assert!(floor.is_floor(), "{floor:?}");
    // a wall to the left and one ahead: nothing is level
    let mut without = room(None);
    without.planes.retain(|(normal, _)| normal.z.abs() < 0.5);
    let (found, _) = found(&without, &cameras, 1.0);
    assert_eq!(found.floor, None);
}

#[test]
fn a_table_is_no_floor_where_something_lies_below_it() {
    // the floor itself is not seen, only walls that go on below the table
    let mut room = room(Some(0.7));
    room.planes.retain(|(normal, _)| normal.z < 0.5);
    let mut cameras = room_from_cameras(60, 25.0, 0.0);
    for camera in &mut cameras {
        // all look at the middle of the table
        let ahead = camera.rotation * Vec3::z();
        let away = Vec3::new(ahead.x, ahead.y, 0.0).normalize() * 1.5;
        camera.translation = Vec3::new(-away.x, -away.y, 1.4);
    }
    let (over_table, _) = found(&room, &cameras, 1.7);
    let table = over_table.floor.unwrap();
    assert!((table.camera_height * 1.7 - 0.7).abs() < 0.03, "{table:?}");
    assert!(!table.is_floor(), "{table:?}");
}

#[test]
fn how_a_camera_moves_says_what_is_up_however_it_is_held() {
    let mut cameras = room_from_cameras(8, 15.0, 60.0);
    let (moving, up) = found(&room(None), &cameras, 1.0);
    let off = angle_deg(&moving.up_in_world, &up);
    assert!(off < 0.5 && moving.confidence > 0.8, "{off}: {moving:?}");
    // one that stays where it is, and trembles
    for (k, camera) in cameras.iter_mut().enumerate() {
        let tremble = Rotation::from_scaled_axis(Vec3::ith(k % 3, 0.01));
        *camera = Sim3::new(1.0, tremble * moving_first(60.0), Vec3::new(-1.5, 1.2, 1.4));
    }
    let (still, _) = found(&room(None), &cameras, 1.0);
    assert!(still.confidence < 0.8, "{still:?}");
}

#[test]
fn a_camera_that_is_held_level_is_surer_than_one_that_is_rolled() {
    let [level, rolled] = [0.0, 30.0].map(|roll_deg| {
        let cameras = room_from_cameras(6, 15.0, roll_deg);
        found(&room(None), &cameras, 1.0).0.confidence
    });
    assert!(rolled < level - 0.03, "{rolled} {level}");
}

#[test]
fn nothing_that_votes_is_no_direction() {
    assert_eq!(upright(&[], &[]), None);
    let scan = KeyframeScan::of_measurements(0, CAMERA, Vec::new(), 0);
    let view = UprightView {
        scan: &scan,
        image: None,
        world_from_keyframe: Sim3::identity(),
    };
    assert_eq!(upright(&[view], &[Se3::identity()]), None);
}

#[test]
fn the_level_frame_has_up_as_z_and_ahead_as_x() {
    // as the first camera was held: the frame of unaligned results
    let first = level_from_world(&-Vec3::y(), None);
    let expected = z_up_from_camera_world();
    assert!(first.rotation.angle_to(&expected.rotation) < 1e-12);
    let floor = Floor {
        height: -1.5,
        camera_height: 1.4,
        share: 1.0,
        below: 0.0,
    };
    for up in [
        Vec3::new(0.1, -0.9, -0.3),
        Vec3::new(0.0, 1.0, 0.2),
        -Vec3::z(),
        Vec3::z(),
    ] {
        let frame = level_from_world(&up, Some(&floor));
        let up = up.normalize();
        assert!((frame.rotation * up - Vec3::z()).norm() < 1e-12);
        // points of the floor are at z = 0
        assert!((frame * (up * -1.5)).z.abs() < 1e-12);
        assert!((frame.rotation * Vec3::z()).y.abs() < 1e-12);
        assert!((frame.rotation.to_rotation_matrix().matrix().determinant() - 1.0).abs() < 1e-12);
    }
    // a camera that looks straight down: what is above in its image is ahead
    let down = level_from_world(&-Vec3::z(), None);
    assert!((down.rotation * -Vec3::y() - Vec3::x()).norm() < 1e-12);
}
