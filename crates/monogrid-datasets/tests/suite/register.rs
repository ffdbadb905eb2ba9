//! Registered depth against ray casting of planes.

use monogrid_datasets::{DepthCalibration, DepthRegistration};
use monogrid_geometry::{Camera, Distortion, Pinhole, Se3, Vec2, Vec3, Vec6};
use monogrid_image::Image;

/// A plane `normal . point = distance` in the depth camera's frame.
#[derive(Clone, Copy)]
struct Plane {
    normal: Vec3,
    distance: f64,
}

impl Plane {
    /// Distance along `ray` from `origin`, infinite when missed.
    fn hit(&self, origin: &Vec3, ray: &Vec3) -> f64 {
        let t = (self.distance - self.normal.dot(origin)) / self.normal.dot(ray);
        if t > 0.0 { t } else { f64::INFINITY }
    }
}

fn depth_camera(distortion: Distortion) -> Camera {
    Camera::try_new(160, 120, Pinhole::new(146.0, 146.0, 80.0, 60.0), distortion).expect("a camera")
}

fn render(camera: &Camera, scene: impl Fn(&Vec3, &Vec3) -> f64) -> Image<f32> {
    Image::from_fn(camera.width, camera.height, |x, y| {
        let ray = camera
            .unproject(&Vec2::new(x as f64, y as f64))
            .expect("invertible");
        scene(&Vec3::zeros(), &ray) as f32
    })
}

fn calibration(camera: Camera, colour_from_depth: Se3) -> DepthCalibration {
    DepthCalibration {
        camera,
        units_per_metre: 5000.0,
        colour_from_depth,
    }
}

#[test]
fn a_slanted_plane_is_exact_and_dense_at_any_resolution() {
    let plane = Plane {
        normal: Vec3::new(0.3, -0.2, 1.0).normalize(),
        distance: 2.0,
    };
    let colour_from_depth = Se3::exp(&Vec6::new(0.05, -0.02, 0.03, 0.02, -0.03, 0.01));
    let radtan = Distortion::RadialTangential {
        k1: -0.1,
        k2: 0.02,
        p1: 0.001,
        p2: -0.001,
        k3: 0.0,
    };
    for distortion in [Distortion::None, radtan] {
        let camera = depth_camera(distortion);
        let depth = render(&camera, |origin, ray| plane.hit(origin, ray));
        let calibration = calibration(camera, colour_from_depth);
        // up to four times as many pixels per degree as the depth camera has
        for factor in [0.5, 1.0, 4.0] {
            let target = Pinhole::new(150.0, 150.0, 79.5, 59.5).scaled(factor, factor);
            let size = ((160.0 * factor) as usize, (120.0 * factor) as usize);
            let registered = DepthRegistration::new(&calibration, &target, size.0, size.1)
                .register(&depth)
                .expect("size");
            let depth_from_colour = colour_from_depth.inverse();
            let (mut inside, mut known) = (0, 0);
            for y in 0..size.1 {
                for x in 0..size.0 {
                    let ray = target.unproject(&Vec2::new(x as f64, y as f64));
                    let origin = depth_from_colour.translation;
                    let expected = plane.hit(&origin, &(depth_from_colour.rotation * ray));
                    // is the point well inside the depth image?
                    let point = origin + depth_from_colour.rotation * ray * expected;
                    let seen = camera
                        .project(&point)
                        .is_some_and(|p| p.x > 1.0 && p.y > 1.0 && p.x < 158.0 && p.y < 118.0);
                    let value = f64::from(registered.at(x, y));
                    if seen {
                        inside += 1;
                        known += usize::from(value.is_finite());
                        // lens distortion bends triangles, and rim pixels are points
                        assert!(
                            (value - expected).abs() < 2e-4 * expected,
                            "{factor} ({x}, {y}): {value} instead of {expected}"
                        );
                    }
                }
            }
            assert!(inside > size.0 * size.1 / 2);
            assert_eq!(known, inside, "dense at factor {factor}");
        }
    }
}

#[test]
fn the_nearer_surface_hides_the_farther_and_nothing_spans_the_gap() {
    let camera = depth_camera(Distortion::None);
    // a board at 1 m covering the left half, a wall at 3 m behind it
    let depth = render(&camera, |_, ray| if ray.x < 0.0 { 1.0 } else { 3.0 });
    // the colour camera sits 10 cm to the left: the board's edge moves to the right
    let colour_from_depth = Se3::new(Default::default(), Vec3::new(0.1, 0.0, 0.0));
    let target = camera.pinhole;
    let registered =
        DepthRegistration::new(&calibration(camera, colour_from_depth), &target, 160, 120)
            .register(&depth)
            .expect("size");
    for value in registered.as_slice().iter().filter(|v| v.is_finite()) {
        assert!(
            (value - 1.0).abs() < 1e-5 || (value - 3.0).abs() < 1e-5,
            "{value}"
        );
    }
    // in the row of the centre the board ends at cx + f * 0.1 / 1, where the wall would project to
    // f * 0.1 / 3 already: the board wins
    let edge = 80.0 + 146.0 * 0.1;
    for x in 16..160 {
        let value = registered.at(x, 60);
        if (x as f64) < edge - 1.5 {
            assert!((value - 1.0).abs() < 1e-5, "{x}: {value}");
        } else if (x as f64) > edge + 1.5 {
            assert!((value - 3.0).abs() < 1e-5, "{x}: {value}");
        }
    }
}

#[test]
fn unknown_depth_stays_unknown() {
    let camera = depth_camera(Distortion::None);
    let depth = Image::from_fn(160, 120, |x, y| {
        if (40..60).contains(&x) && (40..60).contains(&y) {
            f32::NAN
        } else {
            2.0
        }
    });
    let identity = calibration(camera, Se3::identity());
    let registered = DepthRegistration::new(&identity, &camera.pinhole, 160, 120)
        .register(&depth)
        .expect("size");
    for (a, b) in registered.as_slice().iter().zip(depth.as_slice()) {
        assert_eq!(a.is_nan(), b.is_nan());
    }
    let other = Image::filled(10, 10, 1.0f32);
    assert!(
        DepthRegistration::new(&identity, &camera.pinhole, 160, 120)
            .register(&other)
            .is_none()
    );
}

#[test]
fn what_lies_behind_the_colour_camera_is_not_drawn() {
    let camera = depth_camera(Distortion::None);
    let depth = Image::filled(160, 120, 0.5f32);
    let ahead = Se3::new(Default::default(), Vec3::new(0.0, 0.0, -1.0));
    let registered = DepthRegistration::new(&calibration(camera, ahead), &camera.pinhole, 160, 120)
        .register(&depth)
        .expect("size");
    assert!(registered.as_slice().iter().all(|v| v.is_nan()));
}

#[test]
fn a_camera_of_any_size_costs_nothing_until_an_image_of_it_is_there() {
    for distortion in [Distortion::None, Distortion::Fov { omega: 0.9 }] {
        let camera = depth_camera(distortion);
        // more than any memory holds
        let endless = Camera {
            width: 1 << 31,
            height: 1 << 31,
            ..camera
        };
        let calibration = calibration(endless, Se3::identity());
        let registration = DepthRegistration::new(&calibration, &camera.pinhole, 160, 120);
        let depth = Image::filled(160, 120, 1.0f32);
        assert!(registration.register(&depth).is_none());
    }
}

#[test]
fn images_of_the_same_camera_stay_as_they_are() {
    let camera = depth_camera(Distortion::None);
    let depth = Image::from_fn(160, 120, |x, y| match (x + y) % 3 {
        0 => 0.7 + 0.01 * x as f32,
        1 => 0.0,
        _ => f32::NAN,
    });
    let calibration = calibration(camera, Se3::identity());
    let same = DepthRegistration::new(&calibration, &camera.pinhole, 160, 120);
    let registered = same.register(&depth).unwrap();
    for (found, given) in registered.as_slice().iter().zip(depth.as_slice()) {
        assert!(if *given > 0.0 {
            found == given
        } else {
            found.is_nan()
        });
    }
    // another camera sees something else
    let other = Pinhole::new(150.0, 146.0, 80.0, 60.0);
    let other = DepthRegistration::new(&calibration, &other, 160, 120);
    assert!(other.register(&depth).unwrap() != registered);
}
