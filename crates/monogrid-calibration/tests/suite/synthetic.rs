//! Cameras with known intrinsics that move through points.
#![allow(clippy::unwrap_used, reason = "tests")]

use monogrid_calibration::{
    AdjustConfig, Estimate, EstimateConfig, Intrinsics, Prior, Scene, Sighting, Track, Window,
    adjust, estimate_intrinsics, refine_intrinsics,
};
use monogrid_features::Rng;
use monogrid_geometry::ReadoutDirection::{self, Down, Left, Right};
use monogrid_geometry::{Distortion, Pinhole, Se3, Vec2, Vec3, Vec6};

const SIZE: (usize, usize) = (640, 480);

fn lens(focal: f64, k1: f64) -> Intrinsics {
    Intrinsics {
        radial: [k1, 0.0],
        ..Intrinsics::centred(focal, SIZE)
    }
}

/// Where a lens sees a point; nothing outside the image.
fn pixel(lens: &Intrinsics, point: &Vec3) -> Option<Vec2> {
    let camera = lens.camera(SIZE).unwrap();
    let pixel = camera.project(point)?;
    let inside = (0.0..640.0).contains(&pixel.x) && (0.0..480.0).contains(&pixel.y);
    inside.then_some(pixel)
}

/// A window of `motion(view)` through points two to six units away, with corners good to 0.3 px.
fn window(lens: &Intrinsics, seed: u64, motion: impl Fn(f64) -> Vec6) -> Window {
    let mut rng = Rng::new(seed);
    let mut tracks = Vec::new();
    for _ in 0..700 {
        let mut within = |low: f64, high: f64| low + (high - low) * rng.uniform();
        let point = Vec3::new(within(-4.0, 4.0), within(-3.0, 3.0), within(2.0, 6.0));
        let mut track = Track::default();
        for view in 0..20 {
            let camera_from_world = Se3::exp(&motion(view as f64 / 19.0));
            if let Some(pixel) = pixel(lens, &(camera_from_world * point)) {
                let noise = Vec2::new(rng.normal(), rng.normal()) * 0.3;
                track.pixels.push((view, pixel + noise));
            }
        }
        if track.pixels.len() >= 3 {
            tracks.push(track);
        }
    }
    Window {
        size: SIZE,
        num_views: 20,
        tracks,
        ..Window::default()
    }
}

/// A hand: sideways and up, while turning.
fn hand(sign: f64) -> impl Fn(f64) -> Vec6 {
    move |t| {
        Vec6::new(
            sign * 1.0 * t,
            0.3 * (3.0 * t).sin(),
            0.4 * t,
            0.25 * (2.0 * t).sin(),
            sign * 0.5 * t,
            0.3 * t,
        )
    }
}

fn estimate(windows: &[Window]) -> Estimate {
    let prior = Prior::ordinary(62.0, SIZE);
    estimate_intrinsics(windows, SIZE, &prior, &EstimateConfig::default())
}

#[test]
fn a_hand_held_camera_shows_its_focal_length_and_distortion() {
    for (seed, focal, k1) in [(1, 420.0, 0.0), (2, 520.0, -0.2), (3, 760.0, 0.1)] {
        let lens = lens(focal, k1);
        let windows = [
            window(&lens, seed, hand(1.0)),
            window(&lens, seed + 9, hand(-1.0)),
        ];
        let estimate = estimate(&windows);
        let error = estimate.intrinsics.focal / focal - 1.0;
        assert!(estimate.is_determined(), "{estimate:?}");
        assert!(error.abs() < 0.02, "{focal}: {estimate:?}");
        let k1_error = estimate.intrinsics.radial[0] - k1;
        assert!(k1_error.abs() < 0.03, "{estimate:?}");
        let (low, high) = estimate.focal_interval_px();
        assert!((low..=high).contains(&focal), "{estimate:?}");
    }
}

/// The same window as a rolling shutter sees it that takes a share of the time from frame to frame;
/// frames are a quarter of the way from view to view apart. The hand shakes by this angle, rad.
fn rolling(
    lens: &Intrinsics,
    (readout, direction): (f64, ReadoutDirection),
    shake: f64,
    seed: u64,
    sign: f64,
) -> Window {
    let mut window = Window {
        size: SIZE,
        direction,
        num_views: 20,
        tracks: Vec::new(),
    };
    let mut rng = Rng::new(seed);
    for _ in 0..700 {
        let mut within = |low: f64, high: f64| low + (high - low) * rng.uniform();
        let point = Vec3::new(within(-4.0, 4.0), within(-3.0, 3.0), within(2.0, 6.0));
        let mut track = Track::default();
        for view in 0..20 {
            let at = |frames: f64| {
                let views = f64::from(view) + frames / 4.0;
                let shaken = Vec3::new((1.3 * views).sin(), (1.7 * views).cos(), 0.0) * shake;
                let turn = Se3::exp(&Vec6::new(0.0, 0.0, 0.0, shaken.x, shaken.y, 0.0));
                let pose = turn * Se3::exp(&hand(sign)(views / 19.0));
                pixel(lens, &(pose * point))
            };
            let (Some(back), Some(middle), Some(ahead)) = (at(-1.0), at(0.0), at(1.0)) else {
                continue;
            };
            let phase = match direction {
                ReadoutDirection::Down => (middle.y - 239.5) / 480.0,
                ReadoutDirection::Up => (239.5 - middle.y) / 480.0,
                ReadoutDirection::Right => (middle.x - 319.5) / 640.0,
                ReadoutDirection::Left => (319.5 - middle.x) / 640.0,
            };
            let Some(seen) = at(readout * phase) else {
                continue;
            };
            let noise = Vec2::new(rng.normal(), rng.normal()) * 0.3;
            track.pixels.push((view as usize, seen + noise));
            track.steps.push((ahead - back) / 2.0);
        }
        if track.pixels.len() >= 3 {
            window.tracks.push(track);
        }
    }
    window
}

#[test]
fn a_rolling_shutter_is_found_with_the_camera_and_none_where_there_is_none() {
    let lens = lens(520.0, 0.0);
    for (readout, direction, seed) in [
        (0.75, Down, 11),
        (-0.6, Down, 12),
        (0.0, Down, 13),
        (0.75, Left, 14),
        (0.6, Right, 15),
    ] {
        let found = estimate(&[rolling(&lens, (readout, direction), 0.02, seed, 1.0)]);
        let error = found.intrinsics.focal / 520.0 - 1.0;
        assert!(error.abs() < 0.02, "{readout}: {found:?}");
        match found.readout() {
            Some((share, sigma)) => {
                assert!((share - readout).abs() < 0.1, "{readout}: {found:?}");
                assert!(
                    (share - readout).abs() < 4.0 * sigma,
                    "{readout}: {found:?}"
                );
            }
            None => assert!(
                readout == 0.0 && found.intrinsics.readout.abs() < 1e-3,
                "{readout}: {found:?}"
            ),
        }
    }
    // a hand that moves evenly bends all images alike, as another camera would
    let even = estimate(&[rolling(&lens, (0.75, Down), 0.0, 11, 1.0)]);
    assert_eq!(even.readout(), None, "{even:?}");
}

#[test]
fn straight_ahead_determines_nothing() {
    let lens = lens(420.0, 0.0);
    let ahead = |t: f64| Vec6::new(0.0, 0.0, -0.4 * t, 0.0, 0.0, 0.0);
    let estimate = estimate(&[window(&lens, 4, ahead)]);
    assert!(!estimate.is_determined(), "{estimate:?}");
    let (low, high) = estimate.focal_interval_px();
    assert!((low..=high).contains(&420.0), "{estimate:?}");
}

#[test]
fn without_windows_the_prior_is_kept() {
    let estimate = estimate(&[]);
    assert!(!estimate.is_determined());
    let expected = 320.0 / 31_f64.to_radians().tan();
    assert!((estimate.intrinsics.focal - expected).abs() < 1e-9);
    assert_eq!((estimate.num_windows, estimate.num_given), (0, 0));
}

#[test]
fn a_window_that_contradicts_the_others_does_not_count() {
    let (lens, other) = (lens(520.0, 0.0), lens(900.0, 0.0));
    let mut windows = vec![window(&other, 5, hand(1.0))];
    windows.extend((6..10).map(|seed| window(&lens, seed, hand(1.0))));
    let estimate = estimate(&windows);
    let error = estimate.intrinsics.focal / 520.0 - 1.0;
    assert!(error.abs() < 0.02, "{estimate:?}");
}

#[test]
fn an_estimate_for_larger_images() {
    let lens = lens(520.0, 0.0);
    let small = estimate(&[window(&lens, 11, hand(1.0))]);
    let large = small.scaled(3.0, (1920, 1440));
    assert!((large.intrinsics.focal - 3.0 * small.intrinsics.focal).abs() < 1e-9);
    assert!((large.intrinsics.centre - Vec2::new(959.5, 719.5)).norm() < 30.0);
    assert_eq!((large.size, large.sigma[0]), ((1920, 1440), small.sigma[0]));
}

#[test]
fn exact_sightings_give_the_exact_camera() {
    let truth = lens(500.0, -0.15);
    let mut rng = Rng::new(12);
    let motion = hand(1.0);
    let poses: Vec<Se3> = (0..6)
        .map(|v| Se3::exp(&motion(f64::from(v) / 5.0)))
        .collect();
    let (mut points, mut sightings) = (Vec::new(), Vec::new());
    for _ in 0..80 {
        let mut within = |low: f64, high: f64| low + (high - low) * rng.uniform();
        let place = Vec3::new(within(-2.0, 2.0), within(-1.5, 1.5), within(3.0, 6.0));
        for (view, pose) in poses.iter().enumerate() {
            if let Some(pixel) = pixel(&truth, &(*pose * place)) {
                let point = points.len();
                sightings.push(Sighting {
                    view,
                    point,
                    pixel,
                    bend: Vec2::zeros(),
                });
            }
        }
        let noise = Vec3::new(rng.normal(), rng.normal(), rng.normal());
        points.push(place + noise * 0.01);
    }
    let scene = Scene {
        intrinsics: lens(430.0, 0.0),
        poses,
        points,
        sightings,
    };
    let ordinary = Prior::ordinary(62.0, SIZE);
    let prior = Prior {
        sigma: ordinary.sigma * 100.0,
        ..ordinary
    };
    let config = AdjustConfig {
        max_iterations: 100,
        min_relative_decrease: 1e-9,
        ..AdjustConfig::default()
    };
    let adjusted = adjust(scene, &prior, &config);
    let found = adjusted.scene.intrinsics;
    assert!((found.focal - 500.0).abs() < 0.5, "{found:?}");
    assert!((found.radial[0] + 0.15).abs() < 2e-3, "{found:?}");
    assert!((found.centre - truth.centre).norm() < 0.5, "{found:?}");
    assert!(adjusted.chi2.iter().all(|&chi2| chi2 < 1e-2));
    let information = adjusted.information;
    assert!((information - information.transpose()).norm() < 1e-6 * information.norm());
    assert!(information.diagonal().iter().all(|&i| i > 0.0));
}

#[test]
fn the_camera_that_is_returned() {
    let camera = lens(500.0, -0.1).camera(SIZE).unwrap();
    assert_eq!(camera.pinhole, Pinhole::new(500.0, 500.0, 319.5, 239.5));
    let Distortion::RadialTangential { k1, .. } = camera.distortion else {
        panic!("{camera:?}");
    };
    assert!((k1 + 0.1).abs() < 1e-12);
    let ideal = lens(500.0, 0.0).camera(SIZE).unwrap();
    assert_eq!(ideal.distortion, Distortion::None);
    assert_eq!(lens(1e9, 0.0).camera(SIZE), None);
}

/// The window's points and poses as a map has them that was made with another focal length: bent by
/// it.
fn mapped(lens: &Intrinsics, guess: &Intrinsics, seed: u64) -> Scene {
    let mut rng = Rng::new(seed);
    let poses: Vec<Se3> = (0..20u8)
        .map(|view| Se3::exp(&hand(1.0)(f64::from(view) / 19.0)))
        .collect();
    let mut scene = Scene {
        intrinsics: *guess,
        poses,
        points: Vec::new(),
        sightings: Vec::new(),
    };
    for _ in 0..700 {
        let mut within = |low: f64, high: f64| low + (high - low) * rng.uniform();
        let point = Vec3::new(within(-4.0, 4.0), within(-3.0, 3.0), within(2.0, 6.0));
        let index = scene.points.len();
        let mut seen = Vec::new();
        for (view, pose) in scene.poses.iter().enumerate() {
            if let Some(pixel) = pixel(lens, &(*pose * point)) {
                let pixel = pixel + Vec2::new(rng.normal(), rng.normal()) * 0.3;
                seen.push(Sighting {
                    view,
                    point: index,
                    pixel,
                    bend: Vec2::zeros(),
                });
            }
        }
        if seen.len() >= 3 {
            scene.sightings.extend(seen);
            let stretch = guess.focal / lens.focal;
            scene
                .points
                .push(Vec3::new(point.x, point.y, point.z * stretch));
        }
    }
    scene
}

#[test]
fn a_map_shows_the_camera_though_it_was_made_with_another() {
    let prior = Prior::ordinary(62.0, SIZE);
    let config = EstimateConfig::default();
    for (guess_px, k1) in [(480.0, 0.0), (560.0, -0.1)] {
        let lens = lens(520.0, k1);
        let guess = Intrinsics::centred(guess_px, SIZE);
        let pieces: Vec<Scene> = mapped(&lens, &guess, 5).pieces(10).collect();
        assert_eq!(pieces.len(), 2);
        let shown = refine_intrinsics(pieces, SIZE, &prior, &config);
        let error = shown.intrinsics.focal / 520.0 - 1.0;
        assert!(error.abs() < 0.02, "{guess_px}: {error}");
        assert!(shown.is_determined() && shown.num_windows == 2, "{shown:?}");
        assert!((shown.intrinsics.radial[0] - k1).abs() < 0.03, "{shown:?}");
        let (low, high) = shown.focal_interval_px();
        assert!((low..high).contains(&520.0));
    }
    let nothing = refine_intrinsics(Vec::new(), SIZE, &prior, &config);
    assert!(!nothing.is_determined());
}
