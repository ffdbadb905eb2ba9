//! Resampling and sampling against sums over areas.

use monogrid_image::lanes::Baseline;
use monogrid_image::{GrayImage, Resize, bicubic, bilinear, for_lanes, resize_area};

fn picture(width: usize, height: usize) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        ((x * 37 + y * 91 + x * y) % 251) as f32
    })
}

/// Average over the area of one output pixel, by summing overlaps of squares.
fn area_average(image: &GrayImage, size: Resize, x: usize, y: usize) -> f64 {
    let (rx, ry) = (
        image.width() as f64 / size.width as f64,
        image.height() as f64 / size.height as f64,
    );
    let overlap =
        |i: usize, from: f64, to: f64| (to.min(i as f64 + 1.0) - from.max(i as f64)).max(0.0);
    let mut sum = 0.0;
    for yy in 0..image.height() {
        for xx in 0..image.width() {
            let weight = overlap(xx, x as f64 * rx, (x + 1) as f64 * rx)
                * overlap(yy, y as f64 * ry, (y + 1) as f64 * ry);
            sum += weight * f64::from(image.at(xx, yy));
        }
    }
    sum / (rx * ry)
}

#[test]
fn each_pixel_is_the_average_of_its_area() {
    let image = picture(23, 17);
    for (width, height) in [
        (11, 8),
        (10, 5),
        (23, 17),
        (1, 1),
        (22, 16),
        (7, 17),
        (30, 20),
    ] {
        let size = Resize { width, height };
        let resized = resize_area(&image, size);
        assert_eq!((resized.width(), resized.height()), (width, height));
        for y in 0..height {
            for x in 0..width {
                let expected = area_average(&image, size, x, y);
                let value = f64::from(resized.at(x, y));
                assert!(
                    (value - expected).abs() < 1e-3,
                    "{width}x{height} ({x}, {y})"
                );
            }
        }
    }
}

#[test]
fn halving_by_area_is_the_pyramid() {
    let image = picture(40, 26);
    let size = Resize {
        width: 20,
        height: 13,
    };
    let half = monogrid_image::half_size(&image);
    let resized = resize_area(&image, size);
    for (a, b) in half.as_slice().iter().zip(resized.as_slice()) {
        assert!((a - b).abs() < 1e-3);
    }
}

#[test]
fn an_empty_image_resizes_to_black() {
    let empty = GrayImage::filled(0, 0, 0.0);
    let resized = resize_area(
        &empty,
        Resize {
            width: 3,
            height: 2,
        },
    );
    assert_eq!(resized, GrayImage::filled(3, 2, 0.0));
}

#[test]
fn bilinear_is_exact_on_ramps_and_none_outside_the_centres() {
    for (width, height) in [(7, 5), (1, 5), (7, 1), (1, 1), (2, 2)] {
        let image = GrayImage::from_fn(width, height, |x, y| 3.0 * x as f32 + 10.0 * y as f32);
        let (right, bottom) = (width as f32 - 1.0, height as f32 - 1.0);
        for step_y in 0..=10 {
            for step_x in 0..=10 {
                let (x, y) = (right * step_x as f32 / 10.0, bottom * step_y as f32 / 10.0);
                let value = bilinear(&image, x, y).expect("inside");
                assert!(
                    (value - 3.0 * x - 10.0 * y).abs() < 1e-3,
                    "{width}x{height} ({x}, {y})"
                );
            }
        }
        for (x, y) in [
            (-0.001, 0.0),
            (0.0, -0.001),
            (right + 0.001, 0.0),
            (0.0, bottom + 0.001),
            (f32::NAN, 0.0),
            (0.0, f32::NAN),
            (f32::INFINITY, 0.0),
        ] {
            assert_eq!(bilinear(&image, x, y), None, "({x}, {y})");
        }
    }
    assert_eq!(bilinear(&GrayImage::filled(0, 0, 0.0), 0.0, 0.0), None);
}

/// One value, at whichever of the eight places it is asked for.
fn cubic_at(image: &GrayImage, x: f32, y: f32) -> f32 {
    let xs = [x, 2.5, x, -1.0, 2.5, x, -1.0, x];
    let ys = [y, 1.0, y, 3.25, 1.0, y, 3.25, y];
    let [a, b, c, d, e, f, g, h] = bicubic(Baseline, image, &xs, &ys);
    assert_eq!([a, b, c, d], [f, e, h, g]);
    assert_eq!([a, f], [c, h]);
    a
}

/// The convolution of Keys in double precision, sample by sample.
fn keys(image: &GrayImage, x: f32, y: f32) -> f64 {
    let kernel = |t: f64| match t.abs() {
        t if t < 1.0 => 1.5 * t.powi(3) - 2.5 * t.powi(2) + 1.0,
        t if t < 2.0 => -0.5 * t.powi(3) + 2.5 * t.powi(2) - 4.0 * t + 2.0,
        _ => 0.0,
    };
    let last = |length: usize| length as i32 - 1;
    let (right, bottom) = (last(image.width()), last(image.height()));
    let (x, y) = (x.clamp(0.0, right as f32), y.clamp(0.0, bottom as f32));
    let around = |place: f32| (place as i32 - 1)..(place as i32 + 3);
    let (mut sum, mut low, mut high) = (0.0, f64::INFINITY, f64::NEG_INFINITY);
    for row in around(y) {
        for column in around(x) {
            let at = |place: i32, last: i32| place.clamp(0, last) as usize;
            let value = f64::from(image.at(at(column, right), at(row, bottom)));
            let weight = |place: f32, sample: i32| kernel(f64::from(place) - f64::from(sample));
            sum += weight(x, column) * weight(y, row) * value;
            (low, high) = (low.min(value), high.max(value));
        }
    }
    sum.clamp(low, high)
}

#[test]
fn bicubic_is_the_convolution_of_keys_also_at_the_border() {
    let image = picture(9, 7);
    for k in 0..4000 {
        let (x, y) = ((k % 80) as f32 * 0.13 - 1.0, (k / 80) as f32 * 0.17 - 1.0);
        let error = f64::from(cubic_at(&image, x, y)) - keys(&image, x, y);
        assert!(error.abs() < 1e-3, "{x} {y}: {error}");
    }
}

for_lanes! {
    fn on_the_widest = bicubic, (
        image: &GrayImage,
        xs: &[f32; 8],
        ys: &[f32; 8],
    ) -> [f32; 8];
}

#[test]
fn places_that_follow_each_other_have_the_bits_that_each_has_alone() {
    let image = picture(14, 9);
    for k in 0..3000 {
        let (x, y) = ((k % 60) as f32 * 0.17 - 1.0, (k / 60) as f32 * 0.19 - 1.0);
        // a row, one that is sheared into the next, and one that is stretched past a pixel
        for (across, down) in [(1.0, 0.0), (0.98, 0.003), (1.0, 0.1), (1.1, 0.0)] {
            let xs: [f32; 8] = std::array::from_fn(|k| x + across * k as f32);
            let ys: [f32; 8] = std::array::from_fn(|k| y + down * k as f32);
            let alone: [f32; 8] = std::array::from_fn(|k| cubic_at(&image, xs[k], ys[k]));
            assert_eq!(bicubic(Baseline, &image, &xs, &ys), alone, "{xs:?} {ys:?}");
            assert_eq!(on_the_widest(&image, &xs, &ys), alone, "{xs:?} {ys:?}");
        }
    }
}

#[test]
fn bicubic_is_exact_on_slopes_sharper_than_bilinear_and_does_not_ring() {
    let ramp = GrayImage::from_fn(12, 9, |x, y| 3.0 * x as f32 + 10.0 * y as f32);
    for (x, y) in [(4.0, 4.0), (4.3, 5.9), (7.5, 2.5)] {
        assert!((cubic_at(&ramp, x, y) - 3.0 * x - 10.0 * y).abs() < 1e-3);
    }
    let wave = |x: f32| 100.0 + 50.0 * (0.9 * x).sin();
    let image = GrayImage::from_fn(40, 3, |x, _| wave(x as f32));
    let errors = |value: &dyn Fn(f32) -> f32| {
        let places = (20..300).map(|k| 2.0 + 0.1 * k as f32);
        places.map(|x| (value(x) - wave(x)).abs()).sum::<f32>()
    };
    let cubic = errors(&|x| cubic_at(&image, x, 1.0));
    let linear = errors(&|x| bilinear(&image, x, 1.0).expect("inside"));
    assert!(cubic < 0.4 * linear, "{cubic} {linear}");
    let edge = GrayImage::from_fn(12, 9, |x, _| if x < 6 { 20.0 } else { 200.0 });
    for k in -50..200 {
        let value = cubic_at(&edge, 0.1 * k as f32, 4.2);
        assert!((20.0..=200.0).contains(&value), "{value}");
    }
    assert_eq!(cubic_at(&GrayImage::filled(0, 0, 0.0), 1.0, 1.0), 0.0);
    assert_eq!(cubic_at(&GrayImage::filled(1, 1, 7.0), 1.0, -3.0), 7.0);
}
