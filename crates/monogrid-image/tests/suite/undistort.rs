//! Undistortion against the literal camera models, written out again from their publications.

use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2};
use monogrid_image::{GrayImage, Mask, Undistorter, WorkingSize};

const RADTAN: Distortion = Distortion::RadialTangential {
    k1: -0.28340811,
    k2: 0.07395907,
    p1: 0.00019359,
    p2: 1.76187114e-05,
    k3: 0.0,
};

const PINCUSHION: Distortion = Distortion::RadialTangential {
    k1: 0.15,
    k2: 0.02,
    p1: -0.002,
    p2: 0.003,
    k3: 0.01,
};

const FOV: Distortion = Distortion::Fov { omega: 0.93 };

const FISHEYE: Distortion = Distortion::Equidistant {
    k: [0.0034, 0.0007, -0.0021, 0.0002],
};

const RATIONAL: Distortion = Distortion::Rational {
    k: [0.6, -0.3, 0.1, 0.9, -0.2, 0.1],
    p: [0.0008, -0.0002],
};

const DOUBLE_SPHERE: Distortion = Distortion::DoubleSphere {
    xi: -0.2,
    alpha: 0.6,
};

fn camera(distortion: Distortion) -> Camera {
    let (fx, fy) = match distortion {
        Distortion::Equidistant { .. } | Distortion::DoubleSphere { .. } => (190.9, 190.8),
        _ => (458.654, 457.296),
    };
    let pinhole = Pinhole::new(fx, fy, 367.215, 248.375);
    Camera::try_new(752, 480, pinhole, distortion).expect("a camera")
}

fn cameras() -> Vec<Camera> {
    [
        Distortion::None,
        RADTAN,
        PINCUSHION,
        FOV,
        FISHEYE,
        RATIONAL,
        DOUBLE_SPHERE,
    ]
    .map(camera)
    .to_vec()
}

/// Pixel of the input in which a ray `(x, y, 1)` is seen.
fn literal_pixel(camera: &Camera, x: f64, y: f64) -> (f64, f64) {
    let r = (x * x + y * y).sqrt();
    if r == 0.0 {
        return (camera.pinhole.cx, camera.pinhole.cy);
    }
    let (xd, yd) = match camera.distortion {
        Distortion::None => (x, y),
        // OpenCV, camera calibration and 3D reconstruction
        Distortion::RadialTangential { k1, k2, p1, p2, k3 } => {
            let radial = 1.0 + k1 * r.powi(2) + k2 * r.powi(4) + k3 * r.powi(6);
            (
                x * radial + 2.0 * p1 * x * y + p2 * (r * r + 2.0 * x * x),
                y * radial + p1 * (r * r + 2.0 * y * y) + 2.0 * p2 * x * y,
            )
        }
        // Devernay and Faugeras, equation 13
        Distortion::Fov { omega } => {
            let rd = (2.0 * r * (omega / 2.0).tan()).atan() / omega;
            (x * rd / r, y * rd / r)
        }
        // Kannala and Brandt, equation 6, with k1 = 1
        Distortion::Equidistant { k } => {
            let t = r.atan();
            let rd = t + k[0] * t.powi(3) + k[1] * t.powi(5) + k[2] * t.powi(7) + k[3] * t.powi(9);
            (x * rd / r, y * rd / r)
        }
        // OpenCV again
        Distortion::Rational { k, p: [p1, p2] } => {
            let [k1, k2, k3, k4, k5, k6] = k;
            let radial = (1.0 + k1 * r.powi(2) + k2 * r.powi(4) + k3 * r.powi(6))
                / (1.0 + k4 * r.powi(2) + k5 * r.powi(4) + k6 * r.powi(6));
            (
                x * radial + 2.0 * p1 * x * y + p2 * (r * r + 2.0 * x * x),
                y * radial + p1 * (r * r + 2.0 * y * y) + 2.0 * p2 * x * y,
            )
        }
        // Usenko, Demmel and Cremers, equations 40 to 42
        Distortion::DoubleSphere { xi, alpha } => {
            let d1 = (r * r + 1.0).sqrt();
            let d2 = (r * r + (xi * d1 + 1.0).powi(2)).sqrt();
            let below = alpha * d2 + (1.0 - alpha) * (xi * d1 + 1.0);
            (x / below, y / below)
        }
        other => unreachable!("{other:?} is not tried"),
    };
    let Pinhole { fx, fy, cx, cy } = camera.pinhole;
    (fx * xd + cx, fy * yd + cy)
}

/// What a ramp of the input image is at an input pixel.
fn ramp(x: f64, y: f64) -> f64 {
    20.0 + 0.2 * x + 0.1 * y
}

fn input_image(camera: &Camera) -> GrayImage {
    GrayImage::from_fn(camera.width, camera.height, |x, y| {
        ramp(x as f64, y as f64) as f32
    })
}

const SIZES: [WorkingSize; 5] = [
    WorkingSize::AUTOMATIC,
    WorkingSize::Exact {
        width: 640,
        height: 480,
    },
    WorkingSize::Exact {
        width: 376,
        height: 240,
    },
    WorkingSize::Exact {
        width: 301,
        height: 301,
    },
    WorkingSize::Exact {
        width: 800,
        height: 600,
    },
];

#[test]
fn valid_pixels_show_what_the_literal_model_says() {
    for camera in cameras() {
        let image = input_image(&camera);
        for size in SIZES {
            let undistorter = Undistorter::new(&camera, size, None);
            let output = undistorter.apply(&image).expect("the right size");
            let (width, height) = undistorter.size();
            assert_eq!((output.width(), output.height()), (width, height));
            assert_eq!(
                (undistorter.mask().width(), undistorter.mask().height()),
                (width, height)
            );
            // averaging over 1.59 pixels shifts the centre of gravity by up to 0.08 of them
            let tolerance = if width == 301 { 0.03 } else { 0.01 };
            let mut checked = 0;
            for y in 0..height {
                for x in 0..width {
                    if undistorter.mask().at(x, y) == 0 {
                        continue;
                    }
                    let ray = undistorter
                        .pinhole()
                        .unproject(&Vec2::new(x as f64, y as f64));
                    let (px, py) = literal_pixel(&camera, ray.x, ray.y);
                    let expected = ramp(px, py);
                    let value = f64::from(output.at(x, y));
                    assert!(
                        (value - expected).abs() < tolerance,
                        "{:?} {size:?} ({x}, {y}): {value} instead of {expected}",
                        camera.distortion
                    );
                    checked += 1;
                }
            }
            assert!(
                checked * 10 > width * height * 6,
                "{:?} {size:?}: only {checked} valid pixels",
                camera.distortion
            );
        }
    }
}

#[test]
fn the_mask_is_the_literal_one_eroded_by_three_pixels() {
    for camera in cameras() {
        let undistorter = Undistorter::new(&camera, WorkingSize::AUTOMATIC, None);
        let (width, height) = undistorter.size();
        assert_eq!((width, height), (752, 480));
        // distance of the source to the border of the input, negative outside
        let margin: Vec<f64> = (0..width * height)
            .map(|i| {
                let pixel = Vec2::new((i % width) as f64, (i / width) as f64);
                let ray = undistorter.pinhole().unproject(&pixel);
                let (x, y) = literal_pixel(&camera, ray.x, ray.y);
                x.min(y).min(751.0 - x).min(479.0 - y)
            })
            .collect();
        let mut compared = 0;
        for y in 0..height {
            for x in 0..width {
                let mut least = f64::INFINITY;
                for yy in y.saturating_sub(3)..(y + 4).min(height) {
                    for xx in x.saturating_sub(3)..(x + 4).min(width) {
                        least = least.min(margin[yy * width + xx]);
                    }
                }
                // rounding decides on the border itself
                if least.abs() > 1e-3 {
                    let valid = undistorter.mask().at(x, y) == 255;
                    assert_eq!(valid, least > 0.0, "{:?} ({x}, {y})", camera.distortion);
                    compared += 1;
                }
            }
        }
        assert!(compared * 10 > width * height * 9);
    }
}

#[test]
fn without_distortion_everything_is_valid_and_unchanged() {
    let camera = camera(Distortion::None);
    let image = input_image(&camera);
    let undistorter = Undistorter::new(&camera, WorkingSize::AUTOMATIC, None);
    assert_eq!(undistorter.apply(&image), Some(image));
    assert_eq!(undistorter.pinhole(), &camera.pinhole);
    assert!(undistorter.mask().as_slice().iter().all(|&m| m == 255));
}

#[test]
fn an_image_of_another_size_is_refused() {
    let undistorter = Undistorter::new(&camera(RADTAN), WorkingSize::AUTOMATIC, None);
    for (width, height) in [(751, 480), (752, 481), (480, 752), (0, 0)] {
        assert_eq!(
            undistorter.apply(&GrayImage::filled(width, height, 0.0)),
            None
        );
    }
}

#[test]
fn a_mask_of_the_user_is_carried_over() {
    let hidden = |x: f64, y: f64, grow: f64| {
        x > 100.0 - grow && x < 220.0 + grow && y > 300.0 - grow && y < 420.0 + grow
    };
    let mask = Mask::from_fn(752, 480, |x, y| {
        if hidden(x as f64, y as f64, 0.0) {
            0
        } else {
            255
        }
    });
    for camera in cameras() {
        for size in [
            WorkingSize::AUTOMATIC,
            WorkingSize::Exact {
                width: 376,
                height: 240,
            },
        ] {
            let plain = Undistorter::new(&camera, size, None);
            let masked = Undistorter::new(&camera, size, Some(&mask));
            let (width, height) = masked.size();
            let mut lost = 0;
            for y in 0..height {
                for x in 0..width {
                    let ray = masked.pinhole().unproject(&Vec2::new(x as f64, y as f64));
                    let (px, py) = literal_pixel(&camera, ray.x, ray.y);
                    let valid = masked.mask().at(x, y) == 255;
                    if hidden(px, py, 0.0) {
                        assert!(!valid, "{:?} ({x}, {y})", camera.distortion);
                        lost += 1;
                    }
                    // 3 pixels of erosion are at most 30 input pixels here
                    if !hidden(px, py, 30.0) {
                        assert_eq!(valid, plain.mask().at(x, y) == 255);
                    }
                }
            }
            assert!(lost > 100, "{:?}", camera.distortion);
        }
    }
}

#[test]
fn a_fisheye_keeps_a_field_of_view_that_a_pinhole_can_show() {
    // 190 degrees across: a pinhole that shows all of it does not exist
    let pinhole = Pinhole::new(226.0, 226.0, 375.5, 239.5);
    let wide = Camera::try_new(752, 480, pinhole, FISHEYE).expect("a camera");
    let undistorter = Undistorter::new(&wide, WorkingSize::AUTOMATIC, None);
    let half_angle = (375.5 / undistorter.pinhole().fx).atan().to_degrees();
    assert!((45.0..=65.0).contains(&half_angle), "{half_angle}");
    let output = undistorter.apply(&input_image(&wide)).expect("size");
    assert!(output.as_slice().iter().all(|v| v.is_finite()));
    let valid = undistorter
        .mask()
        .as_slice()
        .iter()
        .filter(|&&m| m == 255)
        .count();
    assert!(valid * 10 > 752 * 480 * 8, "{valid}");
}

#[test]
fn fewer_pixels_are_asked_for_and_images_that_have_no_more_stay() {
    let size = WorkingSize::Pixels(120_000);
    assert_eq!(size.resolve(640, 480), (400, 300));
    assert_eq!(size.resolve(1920, 1080), (462, 260));
    // a fifth above is no reason to resample
    assert_eq!(size.resolve(440, 320), (440, 320));
    assert_eq!(size.resolve(320, 240), (320, 240));
}

#[test]
fn the_automatic_size_keeps_the_aspect_ratio_and_the_budget() {
    for (width, height) in [
        (640, 480),
        (752, 480),
        (1226, 370),
        (1920, 1080),
        (364, 674),
        (4000, 3000),
        (20, 5000),
    ] {
        let (w, h) = WorkingSize::AUTOMATIC.resolve(width, height);
        assert!(w <= width.max(16) && h <= height);
        assert!((w * h) as f64 <= 1.25 * 640.0 * 480.0, "{w}x{h}");
        let ratio = (w as f64 / h as f64) / (width as f64 / height as f64);
        assert!(
            (ratio - 1.0).abs() < 0.02 || w == 16,
            "{width}x{height} -> {w}x{h}"
        );
        let pinhole = Pinhole::new(
            width as f64,
            width as f64,
            width as f64 / 2.0,
            height as f64 / 2.0,
        );
        if let Ok(camera) = Camera::try_new(width, height, pinhole, Distortion::None) {
            let undistorter = Undistorter::new(&camera, WorkingSize::AUTOMATIC, None);
            assert_eq!(undistorter.size(), (w, h));
        }
    }
}
