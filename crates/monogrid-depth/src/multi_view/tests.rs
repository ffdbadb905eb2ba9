//! A slanted textured wall, whose depth in every pixel and images from everywhere are known.

use super::*;
use monogrid_geometry::{Rotation, Vec2, Vec3};
use monogrid_image::lanes::Baseline;

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

fn camera() -> Pinhole {
    Pinhole::new(140.0, 142.0, 79.5, 59.5)
}

/// Inverse depth of the wall in the keyframe: n . K^-1 (x, y, 1).
fn wall(x: f64, y: f64) -> f64 {
    let ray = camera().unproject(&Vec2::new(x, y));
    Vec3::new(0.12, -0.08, 0.5).dot(&ray)
}

/// Grey value of the wall at a point of it, in the coordinates of the keyframe.
fn texture(p: &Vec3) -> f64 {
    let (u, v) = (p.x, p.y + 0.3 * p.x);
    128.0
        + 40.0 * (9.0 * u).sin() * (7.0 * v + 1.0).cos()
        + 30.0 * (23.0 * u + 5.0 * v).sin()
        + 20.0 * (17.0 * v - 11.0 * u).cos()
}

/// What a camera at `source_from_keyframe` sees, gain and bias changed.
fn view(source_from_keyframe: &Sim3, gain: f64, bias: f64) -> Image<u8> {
    view_of(texture, source_from_keyframe, gain, bias)
}

/// The same of a wall with another texture.
fn view_of(
    texture: fn(&Vec3) -> f64,
    source_from_keyframe: &Sim3,
    gain: f64,
    bias: f64,
) -> Image<u8> {
    let keyframe_from_source = source_from_keyframe.inverse();
    let origin = keyframe_from_source.translation;
    let normal = Vec3::new(0.12, -0.08, 0.5);
    Image::from_fn(WIDTH, HEIGHT, |x, y| {
        let ray = camera().unproject(&Vec2::new(x as f64, y as f64));
        let direction = keyframe_from_source.rotation * ray;
        // n . (origin + t direction) = 1
        let t = (1.0 - normal.dot(&origin)) / normal.dot(&direction);
        let grey = gain * texture(&(origin + direction * t)) + bias;
        grey.round().clamp(0.0, 255.0) as u8
    })
}

fn pose(x: f64, y: f64, z: f64, turn: f64, scale: f64) -> Sim3 {
    let rotation = Rotation::from_scaled_axis(Vec3::new(0.3 * turn, turn, 0.2 * turn));
    Sim3::new(scale, rotation, Vec3::new(x, y, z))
}

/// Sources beside, above and behind the keyframe; one has another unit of length.
fn poses() -> Vec<Sim3> {
    vec![
        pose(0.5, 0.1, 0.0, -0.05, 1.0),
        pose(-0.4, 0.3, 0.1, 0.04, 1.0),
        pose(0.1, -0.5, 0.2, 0.02, 1.0),
        pose(-1.8, -0.6, -0.3, 0.06, 3.0),
    ]
}

/// Depths of the wall that are wrong by `error`, relatively, with the deviation `sigma`.
fn depths(sigma: f64, error: impl Fn(usize, usize) -> f64) -> Vec<DepthPixel> {
    let mut pixels = Vec::new();
    for y in 3..HEIGHT {
        for x in 3..WIDTH {
            let idepth = wall(x as f64, y as f64) * (1.0 + error(x, y));
            pixels.push(DepthPixel {
                x: x as u16,
                y: y as u16,
                idepth: idepth as f32,
                idepth_var: (sigma * idepth).powi(2) as f32,
            });
        }
    }
    pixels
}

fn relative_error(p: &DepthPixel) -> f64 {
    f64::from(p.idepth) / wall(p.x.into(), p.y.into()) - 1.0
}

fn sources<'a>(images: &'a [Image<u8>], poses: &[Sim3]) -> Vec<SourceView<'a>> {
    let source = |(image, pose): (&'a Image<u8>, &Sim3)| SourceView {
        image,
        source_from_keyframe: *pose,
    };
    images.iter().zip(poses).map(source).collect()
}

fn refined(
    pixels: &[DepthPixel],
    images: &[Image<u8>],
    poses: &[Sim3],
    config: &MultiViewConfig,
) -> (Vec<DepthPixel>, usize) {
    let keyframe = view(&Sim3::identity(), 1.0, 0.0);
    let sources = sources(images, poses);
    refine_depth(&keyframe, &camera(), pixels, &sources, config)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn wrong_depths_become_right_whatever_the_exposure_and_the_unit() {
    let pixels = depths(0.06, |x, y| {
        if (x / 3 + y / 3) % 2 == 0 {
            0.05
        } else {
            -0.04
        }
    });
    let poses = poses();
    let images: Vec<Image<u8>> = poses
        .iter()
        .enumerate()
        .map(|(i, pose)| view(pose, 0.8 + 0.1 * i as f64, 10.0 - 4.0 * i as f64))
        .collect();
    let (refined, count) = refined(&pixels, &images, &poses, &MultiViewConfig::default());
    assert_eq!(refined.len(), pixels.len());
    assert!(5 * count > 2 * pixels.len(), "{count} of {}", pixels.len());
    let changed: Vec<&DepthPixel> = refined
        .iter()
        .zip(&pixels)
        .filter(|(after, before)| after != before)
        .map(|(after, _)| after)
        .collect();
    assert_eq!(changed.len(), count);
    let error = median(changed.iter().map(|p| relative_error(p).abs()).collect());
    assert!(error < 0.01, "{error}");
    let beyond_2_percent = changed.iter().filter(|p| relative_error(p).abs() > 0.02);
    assert!(10 * beyond_2_percent.count() < count);
    // as certain as it says
    let within_2_sigma = changed.iter().filter(|p| {
        relative_error(p).abs() * f64::from(p.idepth) <= 2.0 * f64::from(p.idepth_var).sqrt()
    });
    assert!(10 * within_2_sigma.count() > 9 * count);
    for (after, before) in refined.iter().zip(&pixels) {
        assert_eq!((after.x, after.y), (before.x, before.y));
    }
}

#[test]
fn pixels_between_refined_ones_take_their_mean_where_it_is_flat() {
    let pixels = depths(0.06, |_, _| 0.04);
    let poses = poses();
    let images: Vec<Image<u8>> = poses.iter().map(|pose| view(pose, 1.0, 0.0)).collect();
    let each = MultiViewConfig {
        interpolate: false,
        ..MultiViewConfig::default()
    };
    let (all, count_all) = refined(&pixels, &images, &poses, &each);
    let (half, count_half) = refined(&pixels, &images, &poses, &MultiViewConfig::default());
    assert!(count_half >= count_all, "{count_half} {count_all}");
    let mut num_means = 0;
    for ((before, own), mean) in pixels.iter().zip(&all).zip(&half) {
        if (before.x + before.y).is_multiple_of(2) {
            assert_eq!(own, mean);
        } else if own != mean {
            num_means += 1;
        }
    }
    assert!(4 * num_means > count_half);
    let error = |refined: &[DepthPixel]| {
        let changed = refined.iter().zip(&pixels).filter(|(a, b)| a != b);
        median(changed.map(|(a, _)| relative_error(a).abs()).collect())
    };
    assert!(
        error(&half) < 1.2 * error(&all),
        "{} {}",
        error(&half),
        error(&all)
    );
}

#[test]
fn what_no_two_sources_agree_about_stays_as_it_was() {
    let pixels = depths(0.03, |_, _| 0.03);
    let poses = poses();
    let config = MultiViewConfig::default();
    let images: Vec<Image<u8>> = poses.iter().map(|pose| view(pose, 1.0, 0.0)).collect();
    // a single source
    let (one, count) = refined(&pixels, &images[..1], &poses[..1], &config);
    assert!(count == 0 && one == pixels);
    // images of something else: the wall turned upside down
    let others: Vec<Image<u8>> = images
        .iter()
        .map(|image| {
            Image::from_fn(WIDTH, HEIGHT, |x, y| {
                image.row(HEIGHT - 1 - y)[WIDTH - 1 - x]
            })
        })
        .collect();
    let (_, count) = refined(&pixels, &others, &poses, &config);
    assert!(10 * count < pixels.len(), "{count}");
    // a plain wall
    let plain = Image::from_fn(WIDTH, HEIGHT, |_, _| 90u8);
    let sources: Vec<SourceView> = poses
        .iter()
        .map(|pose| SourceView {
            image: &plain,
            source_from_keyframe: *pose,
        })
        .collect();
    let (same, count) = refine_depth(&plain, &camera(), &pixels, &sources, &config);
    assert!(count == 0 && same == pixels);
    // no depth, depth at the border, an image of another size
    let odd = [f32::NAN, -1.0, 0.5].map(|idepth| DepthPixel {
        x: 0,
        y: 1,
        idepth,
        ..pixels[0]
    });
    let (after, count) = refined(&odd, &images, &poses, &config);
    assert!(count == 0 && after.len() == 3);
    let small = Image::from_fn(10, 10, |_, _| 90u8);
    let sources = [SourceView {
        image: &small,
        source_from_keyframe: poses[0],
    }; 3];
    let (_, count) = refine_depth(&plain, &camera(), &pixels, &sources, &config);
    assert_eq!(count, 0);
}

#[test]
fn all_vectors_give_the_same_bits() {
    let poses = poses();
    let images: Vec<Image<u8>> = poses.iter().map(|pose| view(pose, 0.9, 5.0)).collect();
    let image = view(&Sim3::identity(), 1.0, 0.0);
    let config = MultiViewConfig::default();
    let sources = sources(&images, &poses);
    let sources = pixel_projection::Projected::of_sources(&image, &camera(), &sources);
    let mut search = search::Search::new(&image, &sources, &config);
    let mut compared = 0;
    for pixel in depths(0.02, |_, _| 0.003) {
        let Some(patch) = search::Patch::around(&image, &pixel) else {
            continue;
        };
        if search.find_projections(&pixel).is_some() {
            let (projections, idepth) = (&search.projections, f64::from(pixel.idepth));
            let widest = search::normal_equation(projections, idepth, &patch);
            let plain = search::normal_equation_with(Baseline, projections, idepth, &patch);
            assert_eq!(widest, plain);
            compared += 1;
        }
    }
    assert!(compared > 100, "{compared}");
}

#[test]
fn motion_of_the_match_is_the_derivative_by_the_logarithm() {
    let image = view(&Sim3::identity(), 1.0, 0.0);
    for pose in poses() {
        let source = SourceView {
            image: &image,
            source_from_keyframe: pose,
        };
        let projected = pixel_projection::Projected::new(&source, &camera());
        let idepth = wall(80.0, 60.0);
        let config = MultiViewConfig {
            min_disparity_px: 0.1,
            ..MultiViewConfig::default()
        };
        let projection = pixel_projection::PixelProjection::new(
            &projected,
            [80.0, 60.0],
            idepth,
            [1.0, 0.0],
            &config,
        );
        let projection = projection.unwrap();
        // against the projection of the point
        let point = camera().unproject(&Vec2::new(80.0, 60.0)) / idepth;
        let expected = camera().project(&(pose * point));
        let [x, y] = projection.center(idepth).unwrap();
        assert!((Vec2::new(x, y) - expected).norm() < 1e-9);
        let h = 1e-6;
        let (a, b) = (
            projection.center(idepth * (1.0 - h)).unwrap(),
            projection.center(idepth * (1.0 + h)).unwrap(),
        );
        let motion = projection.motion(idepth);
        for axis in 0..2 {
            let numeric = (b[axis] - a[axis]) / (2.0 * h);
            assert!(
                (motion[axis] - numeric).abs() < 1e-4,
                "{motion:?} {numeric}"
            );
        }
    }
}
