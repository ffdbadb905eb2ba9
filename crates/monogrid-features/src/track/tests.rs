use super::*;
use crate::test_images::{Texture, add_noise, blotches};
use crate::{CornerConfig, detect_corners};
use monogrid_geometry::nalgebra::Matrix2;
use monogrid_geometry::{Pinhole, Se3, Vec6};
use monogrid_image::{GrayImage, Pyramid};

const W: usize = 320;
const H: usize = 240;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn pyramid(image: GrayImage) -> Pyramid {
    Pyramid::new(image, 4)
}

fn corners(pyramid: &Pyramid) -> Vec<Vec2> {
    let config = CornerConfig {
        max_corners: 200,
        num_coarser: 2,
        ..CornerConfig::default()
    };
    detect_corners(pyramid, None, &[], &config)
        .iter()
        .map(|c| c.pixel)
        .collect()
}

/// Tracks corners of an unmoved texture into one shifted by `shift` with gain, bias and noise.
fn shift_errors(shift: Vec2, gain: f32, bias: f32, noise: f64) -> (Vec<f64>, usize) {
    let texture = Texture::new(3);
    let mut reference = texture.render(W, H, |x, y| (x, y));
    let mut current = texture
        .render(W, H, |x, y| (x - shift.x, y - shift.y))
        .map(|v| gain * v + bias);
    add_noise(&mut reference, noise, 1);
    add_noise(&mut current, noise, 2);
    let (reference, current) = (pyramid(reference), pyramid(current));
    let points = corners(&reference);
    let outcomes = track_points(
        &reference,
        &current,
        &points,
        &points,
        &TrackConfig::default(),
    );
    let errors = points
        .iter()
        .zip(&outcomes)
        .filter_map(|(p, o)| Some((o.pixel()? - p - shift).norm()))
        .collect();
    (errors, points.len())
}

/// Faint blotches before and after a shift, in noise of two grey levels.
fn faint(shift: Vec2) -> [Pyramid; 2] {
    let image = |seed: u64, shift: Vec2| {
        let mut image = blotches(W, H, |x, y| (x - shift.x, y - shift.y));
        add_noise(&mut image, 2.0, seed);
        pyramid(image)
    };
    [image(1, Vec2::zeros()), image(2, shift)]
}

#[test]
fn faint_blotches_are_followed_on_the_level_on_which_they_stand_out_of_the_noise() {
    let shift = Vec2::new(3.3, -2.6);
    let [reference, current] = faint(shift);
    let points = corners(&reference);
    assert!(points.len() > 60, "{} corners", points.len());
    let config = TrackConfig::default();
    let found = track_points(&reference, &current, &points, &points, &config);
    let predicted: Vec<Vec2> = points.iter().map(|p| p + shift).collect();
    // the blotches are all alike: no wider than from one to the next
    let search = PatchSearchConfig {
        radius_px: 6.0,
        ..PatchSearchConfig::default()
    };
    let find = |(p, predicted): (&Vec2, &Vec2)| {
        let warp = Matrix2::identity();
        find_patch(&reference, p, &warp, &current, predicted, &search)
    };
    let searched: Vec<TrackOutcome> = points.iter().zip(&predicted).map(find).collect();
    for outcomes in [found, searched] {
        let errors = points.iter().zip(&outcomes);
        let errors = errors.filter_map(|(p, o)| Some((o.pixel()? - p - shift).norm()));
        let errors: Vec<f64> = errors.collect();
        assert!(
            errors.len() * 2 > points.len(),
            "{} of {}",
            errors.len(),
            points.len()
        );
        let middle = median(errors);
        assert!(middle < 0.7, "median error {middle} px");
    }
}

#[test]
fn a_patch_is_found_on_the_finest_level_on_which_it_stands_out() {
    let config = PatchSearchConfig::default();
    let mean_level = |image: &Pyramid| {
        let points = corners(image);
        let levels = points.iter().map(|p| patch_level(image, p, &config));
        levels.sum::<usize>() as f64 / points.len() as f64
    };
    let strong = pyramid(Texture::new(3).render(W, H, |x, y| (x, y)));
    assert_eq!(mean_level(&strong), 0.0);
    let [weak, _] = faint(Vec2::zeros());
    let weak = mean_level(&weak);
    assert!((0.9..=2.0).contains(&weak), "{weak}");
    let nothing = pyramid(GrayImage::filled(W, H, 128.0));
    let middle = Vec2::new(W as f64 / 2.0, H as f64 / 2.0);
    assert_eq!(patch_level(&nothing, &middle, &config), config.search_level);
}

#[test]
fn what_only_noise_shows_is_not_followed() {
    let mut flat = [1, 2].map(|seed| {
        let mut image = GrayImage::filled(W, H, 128.0);
        add_noise(&mut image, 2.0, seed);
        pyramid(image)
    });
    let points: Vec<Vec2> = (2..18)
        .flat_map(|x| (2..13).map(move |y| Vec2::new(16.0 * f64::from(x), 16.0 * f64::from(y))))
        .collect();
    let [reference, current] = &mut flat;
    let outcomes = track_points(
        reference,
        current,
        &points,
        &points,
        &TrackConfig::default(),
    );
    let found = outcomes.iter().filter(|o| o.fit().is_some()).count();
    assert!(found * 20 < points.len(), "{found} of {}", points.len());
}

#[test]
fn shifts_are_found_with_sub_pixel_precision_despite_gain_and_bias() {
    for (shift, gain, bias) in [
        (Vec2::new(0.0, 0.0), 1.0, 0.0),
        (Vec2::new(0.3, -0.7), 1.0, 0.0),
        (Vec2::new(3.25, 1.6), 0.7, 20.0),
        (Vec2::new(-9.4, 7.7), 1.3, -25.0),
        (Vec2::new(15.2, -11.9), 1.1, 5.0),
    ] {
        let (errors, num_points) = shift_errors(shift, gain, bias, 0.0);
        assert!(num_points > 100, "{num_points} corners");
        let tracked = errors.len() as f64 / num_points as f64;
        // what leaves the image cannot be found: 15 px of 240 at two sides
        assert!(tracked > 0.75, "shift {shift}: {tracked} tracked");
        // 19 px are about what four levels of 8x8 patches can bridge: a few slip elsewhere
        let wrong = errors.iter().filter(|e| **e > 0.15).count();
        let middle = median(errors);
        assert!(middle < 0.03, "shift {shift}: median error {middle}");
        assert!(
            wrong * 20 < num_points,
            "shift {shift}: {wrong} of {num_points} wrong"
        );
    }
}

#[test]
fn noise_of_two_grey_levels_costs_less_than_a_tenth_of_a_pixel() {
    let (errors, num_points) = shift_errors(Vec2::new(2.4, -3.3), 0.9, 8.0, 2.0);
    assert!(errors.len() * 10 > num_points * 9);
    let middle = median(errors);
    assert!(middle < 0.1, "median error {middle}");
}

#[test]
fn another_image_is_not_tracked() {
    let reference = pyramid(Texture::new(3).render(W, H, |x, y| (x, y)));
    let current = pyramid(Texture::new(4).render(W, H, |x, y| (x, y)));
    let points = corners(&reference);
    let outcomes = track_points(
        &reference,
        &current,
        &points,
        &points,
        &TrackConfig::default(),
    );
    let tracked = outcomes.iter().filter(|o| o.fit().is_some()).count();
    assert!(
        tracked * 5 < points.len(),
        "{tracked} of {} found in another image",
        points.len()
    );
}

#[test]
fn flat_images_and_borders_are_reported_as_such() {
    let flat = pyramid(GrayImage::filled(W, H, 100.0));
    let points = [
        Vec2::new(100.0, 100.0),
        Vec2::new(1.0, 1.0),
        Vec2::new(f64::NAN, 3.0),
        Vec2::new(1e30, -1e30),
    ];
    let outcomes = track_points(&flat, &flat, &points, &points, &TrackConfig::default());
    assert_eq!(outcomes[0], TrackOutcome::NoTexture);
    assert!(outcomes[1..].iter().all(|o| *o == TrackOutcome::OutOfImage));
    let config = PatchSearchConfig::default();
    for point in &points {
        let outcome = find_patch(&flat, point, &Matrix2::identity(), &flat, point, &config);
        assert!(outcome.fit().is_none());
    }
}

#[test]
fn a_warped_patch_is_found_from_a_wrong_prediction() {
    // a view rotated by 25 degrees and enlarged by 1.25 about the image centre
    let texture = Texture::new(9);
    let (sin, cos) = 25.0f64.to_radians().sin_cos();
    let reference_from_current = Matrix2::new(cos, sin, -sin, cos) / 1.25;
    let centre = Vec2::new(160.0, 120.0);
    let to_reference = |p: Vec2| reference_from_current * (p - centre) + centre;
    let reference = pyramid(texture.render(W, H, |x, y| (x, y)));
    let current = pyramid(
        texture
            .render(W, H, |x, y| {
                let q = to_reference(Vec2::new(x, y));
                (q.x, q.y)
            })
            .map(|v| 0.8 * v + 15.0),
    );
    let current_from_reference = reference_from_current.try_inverse().unwrap();
    let (mut errors, mut looked_for) = (Vec::new(), 0);
    for point in corners(&reference) {
        let truth = current_from_reference * (point - centre) + centre;
        let inside = |v: f64, n: usize| v > 30.0 && v < n as f64 - 30.0;
        if !inside(truth.x, W) || !inside(truth.y, H) || !inside(point.x, W) || !inside(point.y, H)
        {
            continue;
        }
        looked_for += 1;
        let outcome = find_patch(
            &reference,
            &point,
            &reference_from_current,
            &current,
            &(truth + Vec2::new(11.0, -9.0)),
            &PatchSearchConfig::default(),
        );
        errors.extend(outcome.pixel().map(|p| (p - truth).norm()));
    }
    assert!(looked_for > 40);
    assert!(
        errors.len() * 10 > looked_for * 8,
        "{} of {looked_for} found",
        errors.len()
    );
    let wrong = errors.iter().filter(|e| **e > 0.5).count();
    assert!(wrong * 50 < looked_for, "{wrong} of {looked_for} wrong");
    let middle = median(errors);
    assert!(middle < 0.05, "median error {middle}");
}

#[test]
fn patch_warp_is_the_derivative_of_the_projection() {
    let pinhole = Pinhole::new(500.0, 480.0, 160.0, 120.0);
    let current_from_reference = Se3::exp(&Vec6::new(0.2, -0.1, 0.3, 0.05, 0.1, -0.2));
    let (pixel, idepth) = (Vec2::new(200.0, 70.0), 0.6);
    let warp = patch_warp(&pinhole, &pixel, idepth, &current_from_reference).unwrap();
    let project =
        |p: Vec2| pinhole.project(&(current_from_reference * (pinhole.unproject(&p) / idepth)));
    let h = 1e-4;
    let dx = (project(pixel + Vec2::new(h, 0.0)) - project(pixel)) / h;
    let dy = (project(pixel + Vec2::new(0.0, h)) - project(pixel)) / h;
    let product = warp * Matrix2::from_columns(&[dx, dy]);
    assert!((product - Matrix2::identity()).norm() < 1e-3, "{product}");
    // a point at infinity sees the rotation only
    assert!(patch_warp(&pinhole, &pixel, 0.0, &current_from_reference).is_some());
}

#[test]
fn levels_round_trip() {
    let pixel = Vec2::new(13.25, 7.5);
    for level in 0..5 {
        assert!((finest_pixel(&level_pixel(&pixel, level), level) - pixel).norm() < 1e-12);
    }
    // the centre of pixel (0, 0) of level 1 lies between the first two pixels
    assert_eq!(finest_pixel(&Vec2::new(0.0, 0.0), 1), Vec2::new(0.5, 0.5));
}
