//! Camera models against the formulas as their authors print them, and as inverses of themselves.

#![allow(
    clippy::unwrap_used,
    reason = "a helper outside a test function unwraps too"
)]

use crate::common::Random;
use monogrid_geometry::{Camera, CameraError, Distortion, Pinhole, Vec2, Vec3};

fn camera(distortion: Distortion) -> Camera {
    let pinhole = Pinhole::new(517.3, 516.5, 318.6, 255.3);
    Camera::try_new(640, 480, pinhole, distortion).unwrap()
}

/// Calibrations of real cameras (TUM RGB-D, TUM mono, `EuRoC`-like and a fisheye) and corner cases.
fn cameras() -> Vec<Camera> {
    let mut out: Vec<_> = [
        Distortion::None,
        Distortion::RadialTangential {
            k1: 0.2624,
            k2: -0.9531,
            p1: -0.0054,
            p2: 0.0026,
            k3: 1.1633,
        },
        Distortion::RadialTangential {
            k1: -0.2834,
            k2: 0.0739,
            p1: 0.0002,
            p2: 1.8e-5,
            k3: 0.0,
        },
        Distortion::Fov { omega: 0.93 },
        Distortion::Fov { omega: 0.0 },
        Distortion::Fov { omega: 1e-3 },
        Distortion::Equidistant {
            k: [-0.013, 0.02, -0.012, 0.0025],
        },
        Distortion::Equidistant { k: [0.0; 4] },
        RATIONAL,
        Distortion::DoubleSphere {
            xi: -0.2,
            alpha: 0.59,
        },
        Distortion::ExtendedUnified {
            alpha: 0.6,
            beta: 1.1,
        },
        Distortion::Omnidirectional {
            xi: 0.9,
            k: [-0.11, 0.05],
            p: [-0.0003, 0.0008],
        },
    ]
    .into_iter()
    .map(camera)
    .collect();
    // A fisheye: 160 degrees across the diagonal.
    let mut wide = camera(Distortion::Equidistant {
        k: [-0.02, 0.003, -0.001, 0.0],
    });
    wide.pinhole = Pinhole::new(290.0, 290.0, 319.5, 239.5);
    out.push(wide);
    out.extend(wide_spheres());
    out
}

/// Sphere models that see as much as the fisheye.
fn wide_spheres() -> [Camera; 3] {
    [
        (
            220.0,
            Distortion::DoubleSphere {
                xi: -0.2,
                alpha: 0.6,
            },
        ),
        (
            340.0,
            Distortion::ExtendedUnified {
                alpha: 0.7,
                beta: 1.3,
            },
        ),
        (
            800.0,
            Distortion::Omnidirectional {
                xi: 1.8,
                k: [-0.06, 0.2],
                p: [-0.0017, 0.0013],
            },
        ),
    ]
    .map(|(focal, distortion)| {
        let mut wide = camera(distortion);
        wide.pinhole = Pinhole::new(focal, focal, 319.5, 239.5);
        wide
    })
}

/// A wide depth camera, of those whose factory calibration has six radial terms.
const RATIONAL: Distortion = Distortion::Rational {
    k: [0.6, -2.6, 1.5, 0.48, -2.42, 1.43],
    p: [0.0008, -0.0002],
};

#[test]
fn every_pixel_unprojects_and_projects_back() {
    let cameras = cameras();
    assert_eq!(cameras.len(), 16);
    for camera in cameras {
        for y in (0..480).step_by(19) {
            for x in (0..640).step_by(21) {
                let pixel = Vec2::new(f64::from(x), f64::from(y));
                let direction = camera.unproject(&pixel).unwrap();
                assert!(direction.z == 1.0);
                for depth in [0.1, 1.0, 40.0] {
                    let back = camera.project(&(direction * depth)).unwrap();
                    assert_close!(back, pixel, 1e-11, "{camera:?}");
                }
            }
        }
    }
}

#[test]
fn points_project_and_unproject_to_their_direction() {
    let mut random = Random(11);
    for camera in cameras() {
        let mut seen = 0;
        for _ in 0..2000 {
            let p = Vec3::new(random.signed() * 0.6, random.signed() * 0.4, 1.0);
            let Some(pixel) = camera.project(&(p * 3.0)) else {
                continue;
            };
            seen += 1;
            assert_close!(camera.unproject(&pixel).unwrap(), p, 1e-8, "{camera:?}");
        }
        assert!(seen > 1500, "{camera:?} saw {seen}");
    }
}

#[test]
fn radial_tangential_is_opencvs_formula() {
    let (k1, k2, p1, p2, k3) = (0.1, -0.05, 0.003, -0.002, 0.01);
    let distortion = Distortion::RadialTangential { k1, k2, p1, p2, k3 };
    let mut random = Random(12);
    for _ in 0..100 {
        let (x, y) = (random.signed(), random.signed());
        // docs.opencv.org, "Camera Calibration and 3D Reconstruction", with k4 = k5 = k6 = 0
        let r = (x * x + y * y).sqrt();
        let radial = 1.0 + k1 * r.powi(2) + k2 * r.powi(4) + k3 * r.powi(6);
        let x2 = x * radial + 2.0 * p1 * x * y + p2 * (r.powi(2) + 2.0 * x.powi(2));
        let y2 = y * radial + p1 * (r.powi(2) + 2.0 * y.powi(2)) + 2.0 * p2 * x * y;
        let found = distortion.distort(&Vec2::new(x, y)).unwrap();
        assert_close!(found, Vec2::new(x2, y2), 1e-14);
    }
}

#[test]
fn equidistant_is_opencvs_fisheye_formula() {
    let k = [0.02, -0.01, 0.004, -0.0007];
    let distortion = Distortion::Equidistant { k };
    let mut random = Random(13);
    for _ in 0..100 {
        let (a, b) = (random.signed() * 2.0, random.signed() * 2.0);
        let r = (a * a + b * b).sqrt();
        let theta = r.atan();
        let theta_d = theta
            * (1.0
                + k[0] * theta.powi(2)
                + k[1] * theta.powi(4)
                + k[2] * theta.powi(6)
                + k[3] * theta.powi(8));
        let found = distortion.distort(&Vec2::new(a, b)).unwrap();
        assert_close!(found, Vec2::new(theta_d / r * a, theta_d / r * b), 1e-14);
    }
}

#[test]
fn rational_is_opencvs_formula() {
    let ([k1, k2, k3, k4, k5, k6], [p1, p2]) =
        ([0.1, -0.05, 0.01, 0.2, 0.03, -0.004], [0.003, -0.002]);
    let coefficients = [k1, k2, p1, p2, k3, k4, k5, k6];
    let distortion = Distortion::from_name("rational_polynomial", &coefficients).unwrap();
    let mut random = Random(21);
    for _ in 0..100 {
        let (x, y) = (random.signed(), random.signed());
        // docs.opencv.org, "Camera Calibration and 3D Reconstruction"
        let r = (x * x + y * y).sqrt();
        let radial = (1.0 + k1 * r.powi(2) + k2 * r.powi(4) + k3 * r.powi(6))
            / (1.0 + k4 * r.powi(2) + k5 * r.powi(4) + k6 * r.powi(6));
        let x2 = x * radial + 2.0 * p1 * x * y + p2 * (r.powi(2) + 2.0 * x.powi(2));
        let y2 = y * radial + p1 * (r.powi(2) + 2.0 * y.powi(2)) + 2.0 * p2 * x * y;
        let found = distortion.distort(&Vec2::new(x, y)).unwrap();
        assert_close!(found, Vec2::new(x2, y2), 1e-14);
    }
}

#[test]
fn sphere_models_are_the_formulas_of_their_authors() {
    let mut random = Random(22);
    for _ in 0..200 {
        let (x, y, z) = (
            random.signed() * 2.0,
            random.signed() * 2.0,
            0.3 + random.signed().abs(),
        );
        let point = Vec3::new(x, y, z);
        let camera = |name, values: &[f64]| {
            camera(Distortion::from_name(name, values).unwrap()).project(&point)
        };
        let pixel = |mx: f64, my: f64| Vec2::new(517.3 * mx + 318.6, 516.5 * my + 255.3);
        let squared = x * x + y * y;
        // `[USENKO18]` equations 40 to 42
        let (xi, alpha) = (-0.18, 0.57);
        let d1 = (squared + z * z).sqrt();
        let d2 = (squared + (xi * d1 + z).powi(2)).sqrt();
        let below = alpha * d2 + (1.0 - alpha) * (xi * d1 + z);
        let expected = pixel(x / below, y / below);
        assert_close!(camera("ds", &[xi, alpha]).unwrap(), expected, 1e-10);
        // `[EUCM16]`
        let (alpha, beta) = (0.63, 1.12);
        let d = (beta * squared + z * z).sqrt();
        let below = alpha * d + (1.0 - alpha) * z;
        let expected = pixel(x / below, y / below);
        assert_close!(camera("eucm", &[alpha, beta]).unwrap(), expected, 1e-10);
        // Mei and Rives, as OpenCV's omnidir has it
        let (xi, [k1, k2, p1, p2]) = (1.3, [-0.1, 0.2, 0.003, -0.004]);
        let (mx, my) = (x / (z + xi * d1), y / (z + xi * d1));
        let r2 = mx * mx + my * my;
        let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
        let expected = pixel(
            mx * radial + 2.0 * p1 * mx * my + p2 * (r2 + 2.0 * mx * mx),
            my * radial + p1 * (r2 + 2.0 * my * my) + 2.0 * p2 * mx * my,
        );
        let found = camera("mei", &[xi, k1, k2, p1, p2]).unwrap();
        assert_close!(found, expected, 1e-10);
    }
}

#[test]
fn special_cases_of_a_model_are_the_simpler_model() {
    let ideal = Vec2::new(0.4, -0.7);
    let same = |a: (&str, &[f64]), b: (&str, &[f64])| {
        let seen = |(name, values): (&str, &[f64])| {
            let distortion = Distortion::from_name(name, values).unwrap();
            distortion.distort(&ideal).unwrap()
        };
        assert_close!(seen(a), seen(b), 1e-15, "{a:?} {b:?}");
    };
    let radtan = [-0.2, 0.05, 0.001, 0.002, 0.01];
    let rational = [-0.2, 0.05, 0.001, 0.002, 0.01, 0.0, 0.0, 1e-300];
    same(("radtan", &radtan), ("rational", &rational));
    same(("ds", &[0.0, 0.0]), ("none", &[]));
    same(("eucm", &[0.0, 1.0]), ("none", &[]));
    same(("omni", &[0.0]), ("none", &[]));
    // a sphere around the origin alone is the unified model, whose xi is alpha / (1 - alpha)
    same(("ds", &[0.0, 0.6]), ("eucm", &[0.6, 1.0]));
}

#[test]
fn the_enlargement_on_the_axis_is_the_slope_there() {
    for (name, values, expected) in [
        ("pinhole", &[][..], 1.0),
        ("equidistant", &[0.1, 0.0, 0.0, 0.0], 1.0),
        (
            "rational",
            &[0.6, -2.6, 0.001, 0.0, 1.5, 0.48, -2.4, 1.4],
            1.0,
        ),
        ("fov", &[0.9], 2.0 * 0.45_f64.tan() / 0.9),
        ("ds", &[-0.2, 0.6], 1.0 / 0.8),
        ("omni", &[1.8], 1.0 / 2.8),
    ] {
        let distortion = Distortion::from_name(name, values).unwrap();
        let found = distortion.enlargement_on_axis();
        assert!((found - expected).abs() < 1e-8, "{name}: {found}");
    }
}

#[test]
fn models_have_their_names_and_as_many_coefficients() {
    for camera in cameras() {
        let values: Vec<f64> = camera.distortion.parameters().iter().map(|p| p.1).collect();
        // an unbent fov is no distortion
        if values != [0.0] {
            let again = Distortion::from_name(camera.distortion.name(), &values);
            assert_eq!(again, Ok(camera.distortion));
        }
    }
    let said = |name: &str, values: &[f64]| {
        Distortion::from_name(name, values)
            .expect_err(name)
            .to_string()
    };
    assert!(said("scaramuzza", &[]).contains("camera model scaramuzza is not supported"));
    assert!(said("Equirectangular", &[]).contains("v360=equirect"));
    assert!(said("pinhole", &[0.1, 0.0, 0.0, 0.0]).contains("4 coefficients"));
    assert!(said("equidistant", &[0.1]).contains("k1 k2 k3 k4"));
    assert!(said("radtan", &[0.1, 0.2]).contains("OpenCV's order"));
    let mut thin = [0.1; 14];
    thin[12..].fill(0.0);
    assert!(said("rational_polynomial", &thin).contains("thin prism"));
    thin[13] = 0.2;
    assert!(said("rational_polynomial", &thin).contains("tilted"));
    thin[8..].fill(0.0);
    let rational = Distortion::from_name("plumb_bob", &thin).unwrap();
    assert!(matches!(rational, Distortion::Rational { .. }));
    let none = Distortion::from_name("plumb_bob", &[0.0; 5]);
    assert_eq!(none, Ok(Distortion::None));
}

#[test]
fn sphere_models_that_see_nothing_are_refused() {
    let pinhole = Pinhole::new(300.0, 300.0, 320.0, 240.0);
    for (name, values, said) in [
        ("ds", &[-1.0, 0.5][..], "xi is -1"),
        ("ds", &[0.1, 1.5], "alpha is 1.5"),
        ("eucm", &[-0.1, 1.0], "alpha is -0.1"),
        ("eucm", &[0.5, 0.0], "beta is 0"),
        ("omni", &[-1.5], "xi is -1.5"),
        ("omni", &[f64::NAN], "xi is NaN"),
    ] {
        let distortion = Distortion::from_name(name, values).unwrap();
        let error = Camera::try_new(640, 480, pinhole, distortion).unwrap_err();
        assert!(error.to_string().contains(said), "{error}");
    }
}

#[test]
fn fov_is_the_formula_of_devernay_and_faugeras() {
    let omega = 0.9_f64;
    let distortion = Distortion::Fov { omega };
    for r in [1e-12, 1e-6, 0.01, 0.5, 2.0, 100.0] {
        let found = distortion.distort(&Vec2::new(0.0, r)).unwrap();
        let expected = (2.0 * r * (omega / 2.0).tan()).atan() / omega;
        assert!((found.y - expected).abs() <= 1e-14 * expected.max(1e-3));
        assert!(found.x == 0.0);
    }
}

#[test]
fn fov_cannot_see_beyond_its_largest_radius() {
    let omega = 0.9;
    let distortion = Distortion::Fov { omega };
    let limit = std::f64::consts::FRAC_PI_2 / omega;
    let inside = Vec2::new(limit * 0.999, 0.0);
    assert!(distortion.undistort(&inside).is_some());
    for outside in [limit, limit * 1.001, 10.0] {
        assert_eq!(distortion.undistort(&Vec2::new(outside, 0.0)), None);
    }
}

#[test]
fn a_fov_of_almost_zero_is_a_pinhole() {
    let p = Vec2::new(0.4, -0.3);
    for omega in [0.0, 1e-9, 1e-5] {
        let distortion = Distortion::Fov { omega };
        assert_close!(distortion.distort(&p).unwrap(), p, 1e-9);
        assert_close!(distortion.undistort(&p).unwrap(), p, 1e-9);
    }
}

/// Radius of the first fold, by walking outwards in small steps.
fn first_fold(distortion: &Distortion, r_max: f64) -> Option<f64> {
    let raw = |r: f64| match *distortion {
        Distortion::RadialTangential { k1, k2, k3, .. } => {
            r * (1.0 + k1 * r.powi(2) + k2 * r.powi(4) + k3 * r.powi(6))
        }
        Distortion::Equidistant { k } => {
            let t = r.atan();
            t * (1.0 + k[0] * t.powi(2) + k[1] * t.powi(4) + k[2] * t.powi(6) + k[3] * t.powi(8))
        }
        Distortion::Rational { k, .. } => {
            r * (1.0 + k[0] * r.powi(2) + k[1] * r.powi(4) + k[2] * r.powi(6))
                / (1.0 + k[3] * r.powi(2) + k[4] * r.powi(4) + k[5] * r.powi(6))
        }
        _ => r,
    };
    let step = 1e-4;
    let n = (r_max / step) as usize;
    (1..n)
        .map(|i| i as f64 * step)
        .find(|&r| raw(r + step) <= raw(r))
}

#[test]
fn nothing_is_seen_beyond_the_first_fold_even_where_the_model_grows_again() {
    let rt = |k1, k2, k3| Distortion::RadialTangential {
        k1,
        k2,
        p1: 0.0,
        p2: 0.0,
        k3,
    };
    let rational = |k| Distortion::Rational { k, p: [0.0; 2] };
    let models = [
        rt(-0.3, 0.0, 0.0),
        rt(-0.5, 0.1, 0.0), // folds at 1, grows again from sqrt 2 on
        rt(-0.5, 0.12, 0.0),
        rt(-0.28, 0.07, 0.0),
        rt(0.26, -0.95, 1.16),
        rt(0.1, 0.2, -0.3),
        Distortion::Equidistant {
            k: [-0.5, 0.1, 0.0, 0.0],
        },
        Distortion::Equidistant {
            k: [0.0, 0.0, 0.0, -0.05],
        },
        rational([-0.3, 0.0, 0.0, 0.1, 0.0, 0.0]), // folds, as what is above decreases
        rational([0.5, 0.1, 0.01, 0.6, 0.12, 0.005]),
    ];
    let mut folding = 0;
    for model in models {
        let fold = first_fold(&model, 4.0);
        folding += usize::from(fold.is_some());
        for i in 1..400 {
            let r = f64::from(i) * 0.01;
            let point = Vec2::new(0.6 * r, -0.8 * r);
            let seen = model.distort(&point);
            let expected = fold.is_none_or(|fold| r < fold - 2e-4);
            if fold.is_some_and(|fold| (r - fold).abs() < 2e-4) {
                continue;
            }
            assert_eq!(seen.is_some(), expected, "{model:?} at {r}, fold {fold:?}");
            let Some(seen) = seen else { continue };
            if fold.is_none_or(|fold| r < 0.97 * fold) {
                let back = model.undistort(&seen);
                assert!(back.is_some(), "{model:?} cannot invert radius {r}");
                assert_close!(back.unwrap(), point, 1e-8, "{model:?}");
            }
        }
        if let Some(fold) = fold {
            let edge = model.distort(&Vec2::new(fold - 1e-3, 0.0)).unwrap();
            assert_eq!(model.undistort(&(edge * 1.05)), None, "{model:?}");
        }
    }
    assert_eq!(folding, 6);
}

#[test]
fn nothing_is_seen_beyond_where_a_rational_model_divides_by_zero() {
    // what is below is 0 at a radius of sqrt 5
    let k = [0.1, 0.0, 0.0, -0.2, 0.0, 0.0];
    let distortion = Distortion::Rational { k, p: [0.0; 2] };
    for (radius, is_seen) in [(2.2, true), (2.23, true), (2.24, false), (3.0, false)] {
        let point = Vec2::new(0.0, radius);
        let seen = distortion.distort(&point);
        assert_eq!(seen.is_some(), is_seen, "{radius}");
        if let Some(seen) = seen {
            assert_close!(distortion.undistort(&seen).unwrap(), point, 1e-8);
        }
    }
}

#[test]
fn points_behind_the_camera_are_not_seen() {
    for camera in cameras() {
        for z in [0.0, -1e-9, -1.0, f64::NAN] {
            assert_eq!(camera.project(&Vec3::new(0.1, 0.1, z)), None, "{camera:?}");
        }
    }
}

#[test]
fn half_scale_and_crop_keep_rays() {
    let full = Pinhole::new(517.3, 516.5, 318.6, 255.3);
    let half = full.half();
    // The centre of the half pixel (x, y) covers the full pixels 2x, 2x + 1: centre 2x + 0.5.
    for (x, y) in [(0.0, 0.0), (7.0, 100.0), (319.0, 239.0)] {
        let ray = half.unproject(&Vec2::new(x, y));
        let same = full.unproject(&Vec2::new(2.0 * x + 0.5, 2.0 * y + 0.5));
        assert_close!(ray, same, 1e-14);
        let cropped = full.cropped(12.0, 5.0);
        assert_close!(
            cropped.unproject(&Vec2::new(x, y)),
            full.unproject(&Vec2::new(x + 12.0, y + 5.0)),
            1e-14
        );
    }
    let twice = full.half().half();
    let quarter = full.scaled(0.25, 0.25);
    assert!((twice.cx - quarter.cx).abs() < 1e-12 && (twice.fx - quarter.fx).abs() < 1e-12);
    // A resampled image's borders stay where they were.
    let wide = full.scaled(0.5, 2.0);
    let left = wide.unproject(&Vec2::new(-0.5, -0.5));
    assert_close!(left, full.unproject(&Vec2::new(-0.5, -0.5)), 1e-14);
}

#[test]
fn field_of_view_is_that_of_the_outer_pixel_edges() {
    let mut camera = camera(Distortion::None);
    camera.pinhole = Pinhole::new(320.0, 320.0, 319.5, 239.5);
    assert!((camera.horizontal_fov_deg() - 90.0).abs() < 1e-12);
    camera.distortion = Distortion::Equidistant { k: [0.0; 4] };
    assert!((camera.horizontal_fov_deg() - 2.0_f64.to_degrees()).abs() < 1e-9);
}

#[test]
fn bad_calibrations_say_what_was_found() {
    let good = Pinhole::new(500.0, 500.0, 320.0, 240.0);
    let check = |w, h, p, d| Camera::try_new(w, h, p, d).unwrap_err();
    assert!(matches!(
        check(0, 480, good, Distortion::None),
        CameraError::Size { .. }
    ));
    let relative = Pinhole::new(0.8, 1.1, 0.5, 0.5);
    let message = check(640, 480, relative, Distortion::None).to_string();
    assert!(
        message.contains("0.8") && message.contains("relative"),
        "{message}"
    );
    let nan = Distortion::Fov { omega: f64::NAN };
    assert!(check(640, 480, good, nan).to_string().contains("omega"));
    let off = Pinhole::new(500.0, 500.0, 2000.0, 240.0);
    assert!(matches!(
        check(640, 480, off, Distortion::None),
        CameraError::PrincipalPoint { .. }
    ));
}
