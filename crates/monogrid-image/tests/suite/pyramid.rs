//! Pyramids: pixels and intrinsics follow one half-pixel rule, at odd sizes too.

use monogrid_geometry::{Pinhole, Vec3};
use monogrid_image::{GrayImage, Pyramid, half_size, pyramid_intrinsics};

const SIZES: [(usize, usize); 6] = [
    (640, 480),
    (641, 479),
    (1226, 370),
    (613, 185),
    (364, 674),
    (127, 33),
];

fn ramp(x: f64, y: f64) -> f64 {
    0.11 * x + 0.07 * y + 3.0
}

#[test]
fn a_ramp_stays_where_it_is_on_every_level() {
    for (width, height) in SIZES {
        let image = GrayImage::from_fn(width, height, |x, y| ramp(x as f64, y as f64) as f32);
        let pyramid = Pyramid::new(image, 6);
        assert!(pyramid.num_levels() >= 2);
        for level in 0..pyramid.num_levels() {
            let image = pyramid.level(level);
            let factor = f64::from(1u32 << level);
            for y in 0..image.height() {
                for x in 0..image.width() {
                    // centre of the pixel in the finest level
                    let fine_x = (x as f64 + 0.5) * factor - 0.5;
                    let fine_y = (y as f64 + 0.5) * factor - 0.5;
                    let difference = f64::from(image.at(x, y)) - ramp(fine_x, fine_y);
                    assert!(
                        difference.abs() < 1e-3,
                        "level {level} ({x}, {y}): {difference}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_point_projects_to_the_same_place_on_every_level() {
    let finest = Pinhole::new(707.0912, 705.3, 601.8873, 183.1104);
    let levels = pyramid_intrinsics(&finest, 6);
    assert_eq!(levels.len(), 6);
    for point in [
        Vec3::new(0.3, -0.2, 2.0),
        Vec3::new(-1.0, 0.5, 1.5),
        Vec3::new(0.0, 0.0, 1.0),
    ] {
        let fine = finest.project(&point);
        for (level, pinhole) in levels.iter().enumerate() {
            let factor = f64::from(1u32 << level);
            let coarse = pinhole.project(&point);
            assert!(((coarse.x + 0.5) * factor - 0.5 - fine.x).abs() < 1e-9);
            assert!(((coarse.y + 0.5) * factor - 0.5 - fine.y).abs() < 1e-9);
        }
    }
}

#[test]
fn halving_averages_four_pixels_and_drops_an_odd_rim() {
    for (width, height) in [(7, 5), (6, 4), (1, 4), (2, 2), (3, 1)] {
        let image = GrayImage::from_fn(width, height, |x, y| ((x * 31 + y * 57) % 200) as f32);
        let half = half_size(&image);
        assert_eq!((half.width(), half.height()), (width / 2, height / 2));
        for y in 0..height / 2 {
            for x in 0..width / 2 {
                let sum = image.at(2 * x, 2 * y)
                    + image.at(2 * x + 1, 2 * y)
                    + image.at(2 * x, 2 * y + 1)
                    + image.at(2 * x + 1, 2 * y + 1);
                assert_eq!(half.at(x, y), sum / 4.0);
            }
        }
    }
}

#[test]
fn no_level_is_smaller_than_sixteen_pixels() {
    for (width, height) in SIZES {
        let pyramid = Pyramid::new(GrayImage::filled(width, height, 1.0), 20);
        for level in 1..pyramid.num_levels() {
            let image = pyramid.level(level);
            assert!(image.width() >= 16 && image.height() >= 16);
            assert_eq!(image.width(), pyramid.level(level - 1).width() / 2);
        }
    }
    assert_eq!(
        Pyramid::new(GrayImage::filled(10, 10, 0.0), 5).num_levels(),
        1
    );
    assert_eq!(
        Pyramid::new(GrayImage::filled(640, 480, 0.0), 0).num_levels(),
        1
    );
}
