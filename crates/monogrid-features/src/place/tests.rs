use super::*;
use crate::Rng;
use crate::test_images::{Texture, add_noise};
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3, Vec6};
use monogrid_image::{GrayImage, Pyramid};
use std::sync::Arc;

const W: usize = 320;
const H: usize = 240;
const PINHOLE: Pinhole = Pinhole {
    fx: 260.0,
    fy: 260.0,
    cx: 159.5,
    cy: 119.5,
};

/// Two walls in a corner, `z = 3 - 0.4 |x|`, with a texture each: what a ray of a camera hits.
struct Room {
    left: Texture,
    right: Texture,
}

impl Room {
    fn new(left: u64, right: u64) -> Self {
        Self {
            left: Texture::new(left),
            right: Texture::new(right),
        }
    }

    /// Point in the world that a pixel shows.
    fn hit(world_from_camera: &Se3, pixel: &Vec2) -> Vec3 {
        let origin = world_from_camera.translation;
        let ray = world_from_camera.rotation * PINHOLE.unproject(pixel);
        let points = [1.0, -1.0].map(|side| {
            // 3 - 0.4 side x = z along origin + t ray
            let t = (3.0 - 0.4 * side * origin.x - origin.z) / (ray.z + 0.4 * side * ray.x);
            (t, origin + ray * t)
        });
        // the solid is convex towards the camera: the nearer wall is seen
        let nearest = if points[0].0 < points[1].0 { 0 } else { 1 };
        points[nearest].1
    }

    fn render(&self, world_from_camera: &Se3, seed: u64) -> GrayImage {
        let mut image = GrayImage::from_fn(W, H, |x, y| {
            let p = Self::hit(world_from_camera, &Vec2::new(x as f64, y as f64));
            let wall = if p.x < 0.0 { &self.left } else { &self.right };
            wall.at(90.0 * p.x, 90.0 * p.y) as f32
        });
        add_noise(&mut image, 1.0, seed);
        image
    }

    fn pyramid(&self, world_from_camera: &Se3, seed: u64) -> Arc<Pyramid> {
        Arc::new(Pyramid::new(self.render(world_from_camera, seed), 3))
    }

    /// Depth of every pixel in units of `unit`, with 2 % of noise.
    fn depth(world_from_camera: &Se3, unit: f64, seed: u64) -> DepthLookup {
        let mut rng = Rng::new(seed);
        let camera_from_world = world_from_camera.inverse();
        let mut pixels = Vec::new();
        for y in 0..H as u16 {
            for x in 0..W as u16 {
                let pixel = Vec2::new(f64::from(x), f64::from(y));
                let z = (camera_from_world * Self::hit(world_from_camera, &pixel)).z;
                let idepth = (unit / z * (1.0 + 0.02 * rng.normal())) as f32;
                let idepth_var = (0.02 * idepth).powi(2);
                pixels.push((x, y, InverseDepth { idepth, idepth_var }));
            }
        }
        DepthLookup::new(W, H, pixels)
    }
}

fn camera(v: [f64; 6]) -> Se3 {
    Se3::exp(&Vec6::from_column_slice(&v))
}

/// A memory of three rooms (identities 0 to 2), seen from the origin; the unit of each is its depth
/// divided by 1.5.
fn memory() -> (PlaceMemory, Vec<Room>) {
    let mut memory = PlaceMemory::new(PINHOLE, PlaceMemoryConfig::default());
    let rooms: Vec<Room> = (0..3).map(|i| Room::new(10 + 2 * i, 11 + 2 * i)).collect();
    for (id, room) in (0u64..).zip(&rooms) {
        let pyramid = room.pyramid(&Se3::identity(), id);
        let depth = Room::depth(&Se3::identity(), 1.5, id);
        assert!(memory.insert(id, &pyramid, None, &depth, &PINHOLE));
    }
    (memory, rooms)
}

#[test]
fn a_frame_is_found_in_the_right_room_at_the_right_pose() {
    let (memory, rooms) = memory();
    for (seed, v) in [
        (50, [0.1, -0.05, 0.2, 0.0, 0.1, 0.0]),
        (51, [-0.2, 0.1, 0.1, 0.05, -0.1, 0.1]),
        (52, [0.3, 0.0, -0.2, 0.0, -0.05, 0.0]),
    ] {
        let world_from_frame = camera(v);
        for (id, room) in (0u64..).zip(&rooms) {
            let frame = room.pyramid(&world_from_frame, seed + 10 * id);
            let found = memory.relocalise(&frame, None, |_| true);
            let best = found.first().expect("not recognised");
            assert_eq!(best.keyframe, id);
            let mut metric = best.frame_from_keyframe;
            metric.translation *= 1.5;
            let error = (metric * world_from_frame).log();
            assert!(error.norm() < 0.03, "room {id}: {error}");
            let deviation = best.covariance.diagonal().map(f64::sqrt);
            for k in 0..6 {
                let unit = if k < 3 { 1.5 } else { 1.0 };
                assert!(
                    error[k].abs() < 5.0 * unit * deviation[k] + 0.003,
                    "{k}: {error}"
                );
            }
            assert!(memory.relocalise(&frame, None, |k| k != id).is_empty());
            assert_eq!(
                found,
                memory.relocalise(&frame, None, |_| true),
                "not reproducible"
            );
        }
    }
}

#[test]
fn an_unknown_room_is_not_found() {
    let (memory, _) = memory();
    for seed in 0..4 {
        let stranger = Room::new(100 + 2 * seed, 101 + 2 * seed);
        let frame = stranger.pyramid(&Se3::identity(), seed);
        assert!(memory.relocalise(&frame, None, |_| true).is_empty());
    }
    let blank = Pyramid::new(GrayImage::filled(W, H, 90.0), 3);
    assert!(memory.relocalise(&blank, None, |_| true).is_empty());
    assert!(
        memory
            .relocalise(&Pyramid::default(), None, |_| true)
            .is_empty()
    );
}

#[test]
fn two_keyframes_of_a_room_give_pose_and_ratio_of_units() {
    let (mut memory, rooms) = memory();
    for (id, unit, v) in [
        (7, 1.5, [0.1, -0.05, 0.2, 0.0, 0.1, 0.0]),
        (8, 0.6, [-0.2, 0.1, 0.1, 0.05, -0.1, 0.1]),
        (9, 4.0, [0.0, 0.0, 0.0, 0.0, 0.05, 0.0]),
    ] {
        let world_from_this = camera(v);
        let pyramid = rooms[1].pyramid(&world_from_this, id);
        let depth = Room::depth(&world_from_this, unit, id);
        memory.insert(id, &pyramid, None, &depth, &PINHOLE);
        let pyramid_of = |other: u64| match rooms.get(other as usize) {
            Some(room) => Some(room.pyramid(&Se3::identity(), other)),
            None => (other == id).then(|| Arc::clone(&pyramid)),
        };
        let found = memory.find_loops(id, |other| other < 3, pyramid_of);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].keyframe, 1);
        // metres: unit_this * (this_from_other * p) = this_from_world * (unit_other * p)
        let fit = found[0].this_from_other;
        assert!((fit.scale * unit / 1.5).ln().abs() < 0.01, "{}", fit.scale);
        let metric = Se3::new(fit.rotation, fit.translation * unit);
        let error = (metric * world_from_this).log();
        assert!(error.norm() < 0.03, "{error}");
        assert!(found[0].covariance.diagonal().iter().all(|v| *v > 0.0));
        // two rooms apart: nothing
        assert!(
            memory
                .find_loops(id, |other| other == 0 || other == 2, pyramid_of)
                .is_empty()
        );
        // without its image nothing can be verified
        let without = |image: u64| pyramid_of(image).filter(|_| image != 1);
        assert!(memory.find_loops(id, |other| other < 3, without).is_empty());
    }
    assert!(memory.find_loops(999, |_| true, |_| None).is_empty());
}

#[test]
fn the_same_furniture_beside_another_wall_is_another_room() {
    // half of the picture is shared: enough inliers for a pose, and still not this place
    let (mut memory, known) = memory();
    let twin = Room::new(10, 77);
    let pyramid = twin.pyramid(&camera([0.05, 0.0, 0.1, 0.0, 0.02, 0.0]), 3);
    assert!(memory.relocalise(&pyramid, None, |_| true).is_empty());
    let depth = Room::depth(&Se3::identity(), 1.0, 4);
    memory.insert(5, &pyramid, None, &depth, &PINHOLE);
    let pyramid_of = |id: u64| {
        let room = known.get(id as usize);
        let known = room.map(|room| room.pyramid(&Se3::identity(), id));
        known.or_else(|| (id == 5).then(|| Arc::clone(&pyramid)))
    };
    assert!(memory.find_loops(5, |_| true, pyramid_of).is_empty());
    // without the comparison of what should be seen it would have been taken for one
    let config = PlaceMemoryConfig {
        min_agreement: 0.0,
        max_contradiction: 1.0,
        ..PlaceMemoryConfig::default()
    };
    let mut gullible = PlaceMemory::new(PINHOLE, config);
    let known = Room::new(10, 11).pyramid(&Se3::identity(), 0);
    let depth = Room::depth(&Se3::identity(), 1.5, 0);
    gullible.insert(0, &known, None, &depth, &PINHOLE);
    assert_eq!(gullible.relocalise(&pyramid, None, |_| true).len(), 1);
}

#[test]
fn depth_is_looked_up_only_where_neighbours_agree() {
    let known = |idepth: f32| InverseDepth {
        idepth,
        idepth_var: 1e-4,
    };
    let plane = (0..5u16).flat_map(|y| (0..5u16).map(move |x| (x, y, known(0.5))));
    let lookup = DepthLookup::new(20, 20, plane.chain([(12, 12, known(0.5))]));
    assert_eq!(lookup.at(&Vec2::new(2.0, 2.0)), Some(known(0.5)));
    assert_eq!(lookup.at(&Vec2::new(12.0, 12.0)), None, "one alone");
    assert_eq!(lookup.at(&Vec2::new(-50.0, 2.0)), None);
    assert_eq!(lookup.at(&Vec2::new(f64::NAN, 2.0)), None);
    let edge = (0..5u16)
        .flat_map(|y| (0..5u16).map(move |x| (x, y, known(if x < 3 { 0.5 } else { 1.0 }))));
    assert_eq!(
        DepthLookup::new(20, 20, edge).at(&Vec2::new(2.0, 2.0)),
        None
    );
    let unsound = [f32::NAN, 0.0, -1.0].map(|v| (1u16, 1u16, known(v)));
    let outside = [(99u16, 1u16, known(1.0))];
    let empty = DepthLookup::new(20, 20, unsound.into_iter().chain(outside));
    assert_eq!(empty.at(&Vec2::new(1.0, 1.0)), None);
}

/// Corners that are only bytes, or lost.
#[derive(Debug)]
struct Written(Option<Vec<u8>>);

impl KeptCorners for Written {
    fn get(&self) -> Option<Arc<PlaceCorners>> {
        PlaceCorners::from_bytes(self.0.as_ref()?).map(Arc::new)
    }
}

#[test]
fn corners_that_are_kept_elsewhere_verify_the_same() {
    let (whole, rooms) = memory();
    let mut written = PlaceMemory::new(PINHOLE, PlaceMemoryConfig::default());
    let mut lost = written.clone();
    for (id, room) in (0u64..).zip(&rooms) {
        let pyramid = room.pyramid(&Se3::identity(), id);
        let depth = Room::depth(&Se3::identity(), 1.5, id);
        let view = (&*pyramid, None);
        let write = |corners: PlaceCorners| Arc::new(Written(Some(corners.to_bytes()))) as _;
        assert!(written.insert_kept(id, view, &depth, &PINHOLE, write));
        assert!(!written.insert_kept(id, view, &depth, &PINHOLE, write));
        assert!(lost.insert_kept(id, view, &depth, &PINHOLE, |_| Arc::new(Written(None))));
        assert!(!lost.insert_kept(id, view, &depth, &PINHOLE, write));
    }
    let frame = rooms[1].pyramid(&camera([0.1, -0.05, 0.2, 0.0, 0.1, 0.0]), 50);
    let found = whole.relocalise(&frame, None, |_| true);
    assert!(!found.is_empty());
    assert_eq!(written.relocalise(&frame, None, |_| true), found);
    assert!(lost.relocalise(&frame, None, |_| true).is_empty());
}

#[test]
fn other_bytes_are_no_corners() {
    let (memory, _) = memory();
    let bytes = memory.corners(0).unwrap().to_bytes();
    assert!(PlaceCorners::from_bytes(&bytes).is_some());
    assert!(PlaceCorners::from_bytes(&bytes[..bytes.len() - 8]).is_none());
    assert!(PlaceCorners::from_bytes(&[bytes.as_slice(), &[0; 8]].concat()).is_none());
    assert!(PlaceCorners::from_bytes(&[0xff; 80]).is_none());
    assert!(PlaceCorners::from_bytes(&[]).is_none());
}

#[test]
fn a_keyframe_can_get_new_depths() {
    let mut memory = PlaceMemory::new(PINHOLE, PlaceMemoryConfig::default());
    assert!(memory.is_empty());
    let pyramid = Room::new(10, 11).pyramid(&Se3::identity(), 0);
    let nothing = DepthLookup::new(W, H, []);
    assert!(memory.insert(0, &pyramid, None, &nothing, &PINHOLE));
    assert!(memory.relocalise(&pyramid, None, |_| true).is_empty());
    let depth = Room::depth(&Se3::identity(), 1.0, 0);
    assert!(!memory.insert(0, &pyramid, None, &depth, &PINHOLE));
    assert_eq!(memory.len(), 1);
    assert_eq!(memory.relocalise(&pyramid, None, |_| true).len(), 1);
}
