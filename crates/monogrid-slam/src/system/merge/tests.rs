//! Keyframes of one camera as another one sees them.

use super::*;
use crate::{Keyframe, MAIN_MAP, Scale};
use monogrid_geometry::Sim3;

#[test]
fn a_keyframe_shown_by_a_wider_camera_has_everything_where_its_rays_go() {
    let own = Pinhole::new(60.0, 60.0, 15.5, 11.5);
    let wider = KeyframeCamera::new(Pinhole::new(30.0, 30.0, 31.5, 23.5), (64, 48));
    let depth = DepthPixel {
        x: 20,
        y: 6,
        idepth: 0.5,
        idepth_var: 0.01,
    };
    let point = StoredPoint {
        host: 0,
        pixel: [20.0, 6.0],
        idepth: 0.5,
        prior: [0.5, 0.1],
        observations: vec![(0, [10.0, 12.0])],
    };
    let map = StoredMap {
        scale: Scale::Arbitrary,
        pose_revision: 0,
        keyframes: vec![StoredKeyframe {
            keyframe: Keyframe {
                id: 0,
                frame_index: 0,
                timestamp_ns: 0,
                revision: 0,
                image: Image::from_fn(32, 24, |x, y| (4 * x + 2 * y) as u8),
                pixels: vec![depth],
            },
            pinhole: own,
            fragment: MAIN_MAP,
            world_from_keyframe: Sim3::identity(),
            parent: None,
            gain: 1.0,
            bias: 0.0,
        }],
        edges: Vec::new(),
        points: vec![point],
    };
    let shown = through(&map, &wider);
    // (20 - 15.5) / 60 * 30 + 31.5, (6 - 11.5) / 60 * 30 + 23.5
    let is_at = |pixel: [f64; 2], x, y| (Vec2::from(pixel) - Vec2::new(x, y)).norm() < 1e-9;
    assert!(is_at(shown.points[0].pixel, 33.75, 20.75));
    let keyframe = &shown.keyframes[0].keyframe;
    assert_eq!(keyframe.size(), (64, 48));
    assert_eq!((keyframe.pixels[0].x, keyframe.pixels[0].y), (34, 21));
    // 4 x + 2 y at (20.5, 6.5), which the pixel (34, 21) shows
    assert_eq!(keyframe.image.at(34, 21), 95);
    let back = moved(shown.points[0].clone(), |_, pixel| {
        seen_by(&own, &wider.pinhole, pixel)
    });
    assert!(is_at(back.pixel, 20.0, 6.0) && is_at(back.observations[0].1, 10.0, 12.0));
    // what the other camera does not see is left out of what is looked for
    let narrow = KeyframeCamera::new(own, (15, 24));
    assert_eq!(through(&map, &narrow).points[0].observations.len(), 1);
    assert!(!narrow.contains(&Vec2::new(20.0, 6.0)));
}
