use super::*;
use crate::map::{SeenPoints, SparsePoint};
use crate::store::Store;
use crate::view::{Exposure, KeyframeImage};
use crate::{Scale, SlamConfig};
use monogrid_geometry::{Pinhole, Sim3, Vec2};
use monogrid_image::{Image, Mask};
use std::sync::Arc;

#[test]
fn fused_pose_lies_between_by_information() {
    let a = Se3::exp(&Vec6::new(0.1, 0.2, -0.1, 0.02, -0.01, 0.03));
    let step = Vec6::new(0.01, -0.02, 0.03, 0.004, 0.003, -0.002);
    let b = Se3::exp(&step) * a;
    let (certain, vague) = (Mat6::identity() * 1e-4, Mat6::identity() * 3e-4);
    let fused = fuse((&a, &certain), (&b, &vague)).unwrap();
    let expected = Se3::exp(&(step * 0.25)) * a;
    assert!((fused * expected.inverse()).log().norm() < 1e-12);
    let nearly_b = fuse((&a, &vague), (&b, &(certain * 1e-6))).unwrap();
    assert!((nearly_b * b.inverse()).log().norm() < 1e-7);
}

/// Width and height of the images, px.
const SIZE: (usize, usize) = (320, 240);

fn pinhole() -> Pinhole {
    Pinhole {
        fx: 200.0,
        fy: 200.0,
        cx: 159.5,
        cy: 119.5,
    }
}

/// A plane at depth 1 with a pattern that does not repeat within some pixels.
fn plane() -> Arc<Pyramid> {
    let waves = [(0.31, 0.12), (-0.17, 0.29), (0.05, -0.41), (0.11, 0.07)];
    let image = Image::from_fn(SIZE.0, SIZE.1, |x, y| {
        let sum: f32 = waves
            .iter()
            .map(|(u, v)| (u * x as f32 + v * y as f32).sin())
            .sum();
        128.0 + 25.0 * sum
    });
    Arc::new(Pyramid::new(image, 4))
}

/// One keyframe at the origin that has anchored points every `step` px.
fn map(step: usize) -> Map {
    let columns = (20..SIZE.0 - 20).step_by(step);
    let points: Vec<SparsePoint> = columns
        .flat_map(|x| (20..SIZE.1 - 20).step_by(step).map(move |y| (x, y)))
        .map(|(x, y)| SparsePoint {
            host: 0,
            pixel: Vec2::new(x as f64, y as f64),
            idepth: 1.0,
            prior_idepth: 1.0,
            prior_sigma: 0.1,
            is_measured: false,
            pixel_size: 1.0,
            observations: Vec::new(),
            alive: true,
        })
        .collect();
    let store = Store::default();
    let keyframe = MapKeyframe {
        id: 0,
        fragment: 0,
        rank: 0,
        parent: None,
        frame_index: 0,
        timestamp_ns: 0,
        image: KeyframeImage::new(&store, plane().level(0)),
        exposure: Exposure::NEUTRAL,
        world_from_keyframe: Sim3::identity(),
        camera_from_world: Se3::identity(),
        pose_sigma: None,
        covariance: None,
        measured: None,
        depth: None,
        published: None,
        view: None,
        points: SeenPoints {
            anchored: 0..points.len(),
            ..SeenPoints::default()
        },
    };
    Map::restored(store, vec![keyframe], points, Scale::Arbitrary, 0)
}

/// Whether points confirm that a frame which shows what the keyframe shows was taken from `pose`.
fn is_confirmed(map: &Map, pose: &Se3) -> bool {
    let mask = Mask::filled(SIZE.0, SIZE.1, 255);
    let points = PointMap {
        map,
        keyframe: &map[0],
        setup: &Setup::new(SlamConfig::default(), pinhole(), mask, 0),
    };
    points.confirms(&plane(), pose)
}

/// A camera that is turned so that the centre of the image moves by so many pixels.
fn turned(px: f64) -> Se3 {
    Se3::exp(&Vec6::new(0.0, 0.0, 0.0, 0.0, px / pinhole().fx, 0.0))
}

#[test]
fn points_confirm_a_pose_that_is_right_to_a_pixel_and_no_other() {
    let map = map(20);
    let limit = PROBE_ERROR_PX;
    for px in [0.0, 0.7 * limit, -0.7 * limit] {
        assert!(is_confirmed(&map, &turned(px)), "{px} px");
    }
    for px in [1.2 * limit, -2.0 * limit, 20.0] {
        assert!(!is_confirmed(&map, &turned(px)), "{px} px");
    }
}

#[test]
fn few_points_confirm_nothing() {
    let few = map(60);
    assert!(few.points().len() < MIN_POINT_INLIERS);
    assert!(!is_confirmed(&few, &Se3::identity()));
}
