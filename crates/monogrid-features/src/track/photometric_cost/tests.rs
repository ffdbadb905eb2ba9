use super::*;
use crate::test_images::{Texture, add_noise};
use monogrid_image::GrayImage;

const SIZE: usize = 40;
/// Where the patch is in the reference.
const ANCHOR: Vec2 = Vec2::new(20.0, 19.0);

fn texture() -> Texture {
    Texture::new(5)
}

/// The texture moved by a shift, with another brightness.
fn image(shift: Vec2, gain: f32, bias: f32) -> GrayImage {
    let moved = texture().render(SIZE, SIZE, |x, y| (x - shift.x, y - shift.y));
    moved.map(|v| gain * v + bias)
}

fn photometric_cost() -> PhotometricCost {
    let reference = Pyramid::new(image(Vec2::zeros(), 1.0, 0.0), 2);
    PhotometricCost::new(&reference, &ANCHOR, &Matrix2::identity()).unwrap()
}

/// The cost itself, written out: least squares for gain and bias by their normal equations, the
/// kernel by its cases.
fn plain_cost(image: &GrayImage, pixel: &Vec2, config: &PhotometricCostConfig) -> f64 {
    let patch = |image: &GrayImage, at: &Vec2| -> Vec<f64> {
        let offset = |k: usize| Vec2::new((k % SIDE) as f64 - 3.5, (k / SIDE) as f64 - 3.5);
        (0..SIDE * SIDE)
            .map(|k| {
                let at = at + offset(k);
                let value = monogrid_image::bilinear(image, at.x as f32, at.y as f32);
                f64::from(value.unwrap())
            })
            .collect()
    };
    let t = patch(&self::image(Vec2::zeros(), 1.0, 0.0), &ANCHOR);
    let v = patch(image, pixel);
    let n = t.len() as f64;
    let (st, sv) = (t.iter().sum::<f64>(), v.iter().sum::<f64>());
    let stt: f64 = t.iter().map(|t| t * t).sum();
    let stv: f64 = t.iter().zip(&v).map(|(t, v)| t * v).sum();
    let gain = ((n * stv - st * sv) / (n * stt - st * st)).max(0.3);
    let bias = (sv - gain * st) / n;
    let kernel = f64::from(config.kernel);
    let rho = |r: f64| {
        if r.abs() <= kernel {
            r * r
        } else {
            2.0 * kernel * r.abs() - kernel * kernel
        }
    };
    let error = t
        .iter()
        .zip(&v)
        .map(|(t, v)| rho(v - gain * t - bias))
        .sum::<f64>()
        / n;
    0.5 * f64::from(config.independent_pixels)
        * (1.0 + error / f64::from(config.noise).powi(2)).ln()
}

/// Places near that of the patch, and images: as it is, brighter, and of hardly any contrast.
fn cases() -> Vec<(GrayImage, Vec2)> {
    let shift = Vec2::new(0.4, -1.3);
    let mut cases = Vec::new();
    for (gain, bias) in [(1.0, 0.0), (1.4, -30.0), (0.2, 90.0)] {
        let image = image(shift, gain, bias);
        for offset in [[0.0, 0.0], [0.45, 0.3], [-1.2, 0.8], [1.7, -1.6]] {
            cases.push((image.clone(), ANCHOR + shift + Vec2::from(offset)));
        }
    }
    cases
}

#[test]
fn the_cost_is_that_of_gain_bias_and_noise_at_their_best() {
    let config = PhotometricCostConfig::default();
    for (image, pixel) in cases() {
        let cost = photometric_cost().cost(&image, &pixel, &config).unwrap();
        let expected = plain_cost(&image, &pixel, &config);
        assert!(
            (cost - expected).abs() < 2e-3 * (1.0 + expected),
            "{cost} {expected}"
        );
        assert!(cost < config.largest_cost());
    }
}

#[test]
fn the_gradient_is_that_of_the_cost() {
    // of an image whose gradient does not change between pixels, so that differences of pixels are
    // its derivative
    let smooth = |x: f64, y: f64| 100.0 + 3.0 * x - 2.0 * y + 0.09 * (x - 15.0) * (y - 11.0);
    let current = GrayImage::from_fn(SIZE, SIZE, |x, y| smooth(x as f64, y as f64) as f32);
    for config in [
        PhotometricCostConfig::default(),
        PhotometricCostConfig {
            noise: 3.0,
            kernel: 100.0,
            independent_pixels: 40.0,
        },
    ] {
        for offset in [[0.2, 0.4], [3.3, -2.6], [-4.7, 1.1]] {
            let pixel = ANCHOR + Vec2::from(offset);
            let slope = photometric_cost().slope(&current, &pixel, &config).unwrap();
            let step = 0.02;
            let cost = |d: Vec2| {
                photometric_cost()
                    .cost(&current, &(pixel + d), &config)
                    .unwrap()
            };
            let numeric = Vec2::new(
                (cost(Vec2::new(step, 0.0)) - cost(Vec2::new(-step, 0.0))) / (2.0 * step),
                (cost(Vec2::new(0.0, step)) - cost(Vec2::new(0.0, -step))) / (2.0 * step),
            );
            let tolerance = 0.01 * numeric.norm() + 2e-3;
            assert!(
                (slope.gradient - numeric).norm() < tolerance,
                "{} {numeric}",
                slope.gradient
            );
        }
    }
}

#[test]
fn steps_of_gauss_and_newton_find_the_place_whatever_the_brightness() {
    let config = PhotometricCostConfig::default();
    let shift = Vec2::new(-0.7, 1.4);
    for (gain, bias) in [(1.0, 0.0), (0.6, 50.0), (1.5, -60.0)] {
        let mut current = image(shift, gain, bias);
        add_noise(&mut current, 0.5, 3);
        let mut pixel = ANCHOR + shift + Vec2::new(0.6, -0.5);
        for _ in 0..10 {
            let slope = photometric_cost().slope(&current, &pixel, &config).unwrap();
            pixel -= slope.information.try_inverse().unwrap() * slope.gradient;
        }
        let error = (pixel - ANCHOR - shift).norm();
        assert!(error < 0.05, "gain {gain}: {error} px");
    }
}

#[test]
fn pixels_that_show_something_else_move_a_patch_little() {
    let (shift, config) = (Vec2::new(0.3, 0.2), PhotometricCostConfig::default());
    let mut current = image(shift, 1.0, 0.0);
    for (x, y) in [(22, 17), (18, 21), (23, 18)] {
        current.set(x, y, current.at(x, y) - 40.0);
    }
    let found = |config: &PhotometricCostConfig| {
        let mut pixel = ANCHOR + shift;
        for _ in 0..20 {
            let slope = photometric_cost().slope(&current, &pixel, config).unwrap();
            let step = slope.information.try_inverse().unwrap() * slope.gradient;
            pixel -= step * (0.3 / step.norm().max(0.3));
        }
        (pixel - ANCHOR - shift).norm()
    };
    let quadratic = found(&PhotometricCostConfig {
        kernel: 255.0,
        ..config
    });
    let robust = found(&config);
    assert!(
        robust < 0.5 * quadratic,
        "{robust} px, without a kernel {quadratic} px"
    );
}

#[test]
fn a_plain_wall_is_not_like_a_patch() {
    let config = PhotometricCostConfig::default();
    let wall = GrayImage::filled(SIZE, SIZE, 128.0);
    let at_home = photometric_cost()
        .cost(&image(Vec2::zeros(), 1.0, 0.0), &ANCHOR, &config)
        .unwrap();
    let at_wall = photometric_cost().cost(&wall, &ANCHOR, &config).unwrap();
    assert!(at_wall > at_home + 5.0, "{at_wall} {at_home}");
}

#[test]
fn a_patch_that_fits_worse_says_less() {
    let config = PhotometricCostConfig::default();
    let information = |noise: f64| {
        let mut current = image(Vec2::zeros(), 1.0, 0.0);
        add_noise(&mut current, noise, 9);
        let slope = photometric_cost()
            .slope(&current, &ANCHOR, &config)
            .unwrap();
        slope.information.trace()
    };
    assert!(information(1.0) > 3.0 * information(2.5));
}

#[test]
fn bytes_are_as_good_as_floats_and_nothing_is_said_at_the_border() {
    let config = PhotometricCostConfig::default();
    let current = image(Vec2::new(0.2, 0.1), 1.0, 0.0).map(f32::round);
    let bytes = current.map(|v| v as u8);
    let pixel = ANCHOR + Vec2::new(0.3, 0.3);
    assert_eq!(
        photometric_cost().cost(&current, &pixel, &config),
        photometric_cost().cost(&bytes, &pixel, &config)
    );
    assert_eq!(
        photometric_cost().slope(&current, &pixel, &config),
        photometric_cost().slope(&bytes, &pixel, &config)
    );
    let outside = Vec2::new(2.0, 20.0);
    assert_eq!(photometric_cost().cost(&current, &outside, &config), None);
    assert_eq!(photometric_cost().slope(&current, &outside, &config), None);
    assert_eq!(photometric_cost().correlation(&current, &outside), None);
    let flat = Pyramid::new(GrayImage::filled(SIZE, SIZE, 7.0), 1);
    assert!(PhotometricCost::new(&flat, &ANCHOR, &Matrix2::identity()).is_none());
}
