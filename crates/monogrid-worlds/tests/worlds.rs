//! Synthetic worlds against analytic geometry, measured statistics and themselves.
#![allow(clippy::unwrap_used, reason = "a test may fail by panic")]

use monogrid_datasets::{
    Calibration, Dataset, DepthCalibration, SourceOptions, read_depth, read_trajectory,
};
use monogrid_geometry::{Camera, Distortion, Pinhole, Se3, Vec2, Vec3};
use monogrid_worlds::scene::{Material, Scene};
use monogrid_worlds::{
    Bounds, CameraPath, Carrier, EffectsConfig, LightingConfig, MOTION_NAMES, Motion, Mover, P3,
    Renderer, SynthConfig, SynthSequence, WORLD_NAMES, World, WriteConfig, look_at,
    write_tum_layout,
};
use std::path::PathBuf;
use std::sync::{Arc, LazyLock, OnceLock};

/// A recording below the folder that MONOGRID_DATA names.
fn data(name: &str) -> PathBuf {
    let folder = std::env::var_os("MONOGRID_DATA");
    let folder = folder.expect("MONOGRID_DATA names the folder of recorded sequences");
    let path = PathBuf::from(folder).join(name);
    assert!(path.exists(), "{} is absent", path.display());
    path
}

/// A built-in world, lit quickly; each is made once.
fn built_in(name: &str) -> Arc<World> {
    static WORLDS: [OnceLock<Arc<World>>; WORLD_NAMES.len()] =
        [const { OnceLock::new() }; WORLD_NAMES.len()];
    let index = WORLD_NAMES.iter().position(|n| *n == name).unwrap();
    let make = || Arc::new(World::by_name_with(name, &LightingConfig::quick()).unwrap());
    Arc::clone(WORLDS[index].get_or_init(make))
}

/// `SynthSequence::small_demo` with the world that others share.
static DEMO: LazyLock<SynthSequence> = LazyLock::new(|| {
    let (name, config) = ("living-room", SynthConfig::small());
    let path = SynthSequence::path_for(name, Carrier::Hand.into(), &config).unwrap();
    SynthSequence::new(built_in(name), path, config).unwrap()
});

fn camera(distortion: Distortion) -> Camera {
    Camera::try_new(160, 120, Pinhole::new(120.0, 121.0, 80.3, 58.9), distortion).unwrap()
}

/// A room of 4 x 3 x 2.5 m with bare walls of different tone and one lamp.
fn bare_room() -> World {
    let mut scene = Scene::default();
    scene.object("room");
    let p = P3::new;
    let (x, y, z) = (p(4.0, 0.0, 0.0), p(0.0, 3.0, 0.0), p(0.0, 0.0, 2.5));
    let tones: Vec<_> = [0.2, 0.8, 0.3, 0.4, 0.5, 0.6]
        .map(|a| scene.material(Material::plain(a)))
        .into();
    scene.quad(P3::zeros(), x, y, tones[0]);
    scene.quad(z, y, x, tones[1]);
    scene.quad(P3::zeros(), y, z, tones[2]);
    scene.quad(x, z, y, tones[3]);
    scene.quad(P3::zeros(), z, x, tones[4]);
    scene.quad(y, x, z, tones[5]);
    scene.light(p(1.5, 1.0, 2.45), p(0.0, 1.0, 0.0), p(1.0, 0.0, 0.0), 5.0);
    World::new("bare room", &scene, &LightingConfig::quick())
}

/// Distance to the inside of the box [0, size] along a direction, in lengths of it.
fn leave_box(origin: &Vec3, direction: &Vec3, size: &Vec3) -> f64 {
    (0..3)
        .map(|a| {
            let wall = if direction[a] > 0.0 { size[a] } else { 0.0 };
            (wall - origin[a]) / direction[a]
        })
        .fold(f64::INFINITY, f64::min)
}

const RATIONAL: Distortion = Distortion::Rational {
    k: [0.6, -0.3, 0.1, 0.7, -0.2, 0.1],
    p: [0.0008, -0.0002],
};
const DOUBLE_SPHERE: Distortion = Distortion::DoubleSphere {
    xi: -0.2,
    alpha: 0.6,
};

#[test]
fn depth_equals_analytic_intersection_for_every_lens() {
    let world = bare_room();
    let size = Vec3::new(4.0, 3.0, 2.5);
    let lenses = [
        Distortion::None,
        Distortion::RadialTangential {
            k1: -0.25,
            k2: 0.06,
            p1: 0.001,
            p2: -0.002,
            k3: 0.0,
        },
        Distortion::Fov { omega: 0.9 },
        Distortion::Equidistant {
            k: [0.01, -0.02, 0.003, 0.0],
        },
        RATIONAL,
        DOUBLE_SPHERE,
    ];
    for lens in lenses {
        let camera = camera(lens);
        let renderer = Renderer::new(&camera, 1.0);
        for target in [
            Vec3::new(3.9, 2.0, 1.0),
            Vec3::new(0.1, 0.2, 0.4),
            Vec3::new(2.0, 2.9, 2.4),
        ] {
            let pose = look_at(&Vec3::new(1.7, 1.3, 1.2), &target);
            let depth = renderer.depth(&world, &[], &[pose]);
            for y in 0..camera.height {
                for x in 0..camera.width {
                    let ray = camera.unproject(&Vec2::new(x as f64, y as f64)).unwrap();
                    let expected = leave_box(&pose.translation, &(pose.rotation * ray), &size);
                    let found = f64::from(depth.at(x, y));
                    assert!(
                        (found / expected - 1.0).abs() < 3e-6,
                        "{lens:?} {x} {y}: {found} {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn depth_of_what_moves_equals_that_of_single_rays_through_every_world() {
    let room = bare_room();
    let mut scene = Scene::default();
    let tone = scene.plain(0.5);
    scene.cuboid([-0.3, -0.2, -0.4], [0.3, 0.2, 0.4], tone);
    let cube = World::new("box", &scene, &LightingConfig::quick());
    let pose = |x: f64, y: f64, turn: f64| {
        let rotation = monogrid_geometry::rotation_exp(&Vec3::new(0.2, 0.0, turn));
        Se3::new(rotation, Vec3::new(x, y, 1.0))
    };
    // the second stands partly behind the first
    let movers = [pose(2.6, 1.6, 0.4), pose(3.2, 1.5, -0.9)].map(|world_from_mover| Mover {
        world: &cube,
        world_from_mover,
    });
    let camera = camera(Distortion::None);
    let eye = look_at(&Vec3::new(0.7, 1.3, 1.2), &Vec3::new(3.0, 1.7, 1.0));
    let depth = Renderer::new(&camera, 1.0).depth(&room, &movers, &[eye]);
    let mut num_moved = 0;
    for y in 0..camera.height {
        for x in 0..camera.width {
            let ray = camera.unproject(&Vec2::new(x as f64, y as f64)).unwrap();
            let cast = |world: &World, from_world: &Se3| {
                let origin = *from_world * eye.translation;
                let direction = from_world.rotation * (eye.rotation * ray);
                world.cast(origin.into(), direction.into())
            };
            let behind = cast(&room, &Se3::identity()).unwrap();
            let nearest = movers
                .iter()
                .filter_map(|m| cast(m.world, &m.world_from_mover.inverse()))
                .fold(behind, f64::min);
            num_moved += usize::from(nearest < behind);
            let found = f64::from(depth.at(x, y));
            assert!(
                (found / nearest - 1.0).abs() < 1e-5,
                "{x} {y}: {found} {nearest}"
            );
        }
    }
    assert!(num_moved > 1500, "{num_moved}");
}

#[test]
fn cars_are_in_the_pictures_of_the_street_and_not_in_its_mesh() {
    let config = SynthConfig {
        camera: camera(Distortion::None),
        frames: 600,
        effects: EffectsConfig::default(),
        ..SynthConfig::small()
    };
    let street = built_in("street");
    let of_motion = |name: &str| {
        let motion = Motion::by_name(name).unwrap();
        let path = SynthSequence::path_for("street", motion, &config).unwrap();
        SynthSequence::new(Arc::clone(&street), path, config.clone()).unwrap()
    };
    // the same film from its end
    let (car, back) = (of_motion("car"), of_motion("car-back"));
    let renderer = Renderer::new(&config.camera, 1.0);
    let nearer_than_the_street = |sequence: &SynthSequence, k: usize| {
        let pose = sequence.world_from_camera(k).unwrap();
        let street = renderer.depth(sequence.world(), &[], &[pose]);
        let all = sequence.depth(k).unwrap();
        let pairs = all.as_slice().iter().zip(street.as_slice());
        pairs.filter(|(a, s)| **a < **s - 0.3).count()
    };
    for k in [0, 150, 300, 450, 599] {
        let (there, back) = (
            nearer_than_the_street(&car, k),
            nearer_than_the_street(&back, 599 - k),
        );
        assert!(there > 150 && back > 150, "{k}: {there}, {back}");
    }
}

#[test]
fn a_known_edge_appears_at_its_projection() {
    // half of a wall dark, half bright; lit evenly because it glows by itself
    let mut scene = Scene::default();
    scene.object("wall");
    let dark = scene.material(Material::plain(0.1).glowing(1.0));
    let bright = scene.material(Material::plain(0.9).glowing(1.0));
    let (up, side) = (P3::new(0.0, 0.0, 4.0), P3::new(4.0, 0.0, 0.0));
    scene.quad(P3::new(-4.0, 3.0, -2.0), side, up, dark);
    scene.quad(P3::new(0.0, 3.0, -2.0), side, up, bright);
    let world = World::new("edge", &scene, &LightingConfig::quick());
    let camera = camera(Distortion::None);
    let renderer = Renderer::new(&camera, 1.0);
    // a slight roll lets the edge cross the grid of samples at all phases
    let roll = monogrid_geometry::rotation_exp(&Vec3::new(0.0, 0.0, 0.05));
    let level = look_at(&Vec3::new(0.2, 0.0, 0.1), &Vec3::new(0.1, 3.0, 0.0));
    let pose = Se3::new(level.rotation * roll, level.translation);
    let image = renderer.render(&world, &pose).image;
    let mut error_sum = 0.0;
    for y in 0..camera.height {
        // bright pixels, counted with fractions, begin at the edge
        let dark_part: f32 = image
            .row(y)
            .iter()
            .map(|v| (0.9 * 255.0 - v) / (0.8 * 255.0))
            .sum();
        let edge_x = f64::from(dark_part) - 0.5;
        // where the edge x = 0, y = 3 crosses this row, by bisection on its height
        let (mut low, mut high) = (-2.0, 2.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let seen = camera
                .project(&(pose.inverse() * Vec3::new(0.0, 3.0, middle)))
                .unwrap();
            if seen.y > y as f64 {
                low = middle;
            } else {
                high = middle;
            }
        }
        let expected = camera
            .project(&(pose.inverse() * Vec3::new(0.0, 3.0, low)))
            .unwrap()
            .x;
        assert!((edge_x - expected).abs() < 0.26, "{y}: {edge_x} {expected}");
        error_sum += edge_x - expected;
    }
    let bias = error_sum / camera.height as f64;
    assert!(bias.abs() < 0.02, "{bias}");
}

#[test]
fn frames_do_not_depend_on_the_number_of_threads() {
    let render = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let sequence = SynthSequence::small_demo().unwrap();
            (
                sequence.frame(400).unwrap().image,
                sequence.depth(400).unwrap(),
            )
        })
    };
    let (one, three) = (render(1), render(3));
    assert_eq!(one.0, three.0);
    assert_eq!(one.1, three.1);
}

#[test]
fn no_path_hits_anything() {
    for name in WORLD_NAMES {
        let world = built_in(name);
        for motion_name in MOTION_NAMES {
            let motion = Motion::by_name(motion_name).unwrap();
            let config = SynthConfig {
                frames: 1500,
                ..SynthConfig::small()
            };
            let path = SynthSequence::path_for(name, motion, &config).unwrap();
            let length_m = path.length_m(30.0);
            // what shakes goes a longer way
            let least_m = match (name, motion.carrier) {
                ("corridor-loop", _) => 64.0,
                (_, Carrier::Car) => 14.5,
                _ => 15.0,
            };
            assert!(length_m >= least_m, "{name} {motion_name}: {length_m} m");
            for k in 0..250 {
                let pose = path.world_from_camera(0.2 * f64::from(k));
                let clear_m = clearance_m(&world, &pose.translation);
                assert!(
                    clear_m > 0.2,
                    "{name} {motion_name} at {k}: {clear_m} m at {}",
                    pose.translation
                );
            }
        }
    }
}

/// Distance to the nearest surface in 26 directions.
fn clearance_m(world: &World, eye: &Vec3) -> f64 {
    let mut nearest = f64::INFINITY;
    for k in 0..27 {
        let d = Vec3::new(
            f64::from(k % 3) - 1.0,
            f64::from(k / 3 % 3) - 1.0,
            f64::from(k / 9) - 1.0,
        );
        let Some(d) = d.try_normalize(0.5) else {
            continue;
        };
        let origin = [eye.x, eye.y, eye.z];
        nearest = nearest.min(world.cast(origin, [d.x, d.y, d.z]).unwrap_or(0.0));
    }
    nearest
}

#[test]
fn the_demo_looks_at_things_in_range_and_every_pixel_has_depth() {
    for k in (0..DEMO.len()).step_by(100) {
        let depth = DEMO.depth(k).unwrap();
        let mut values: Vec<f32> = depth.as_slice().to_vec();
        assert!(values.iter().all(|z| z.is_finite() && *z > 0.2), "{k}");
        values.sort_by(f32::total_cmp);
        let median = values[values.len() / 2];
        assert!((1.3..4.5).contains(&median), "{k}: {median}");
    }
}

#[test]
fn pictures_use_the_range_of_grey_values_and_have_a_natural_spectrum() {
    let (mut power, mut rows) = (vec![0.0f64; 81], 0);
    let mut histogram = [0usize; 256];
    for k in (0..DEMO.len()).step_by(60) {
        let image = DEMO.frame(k).unwrap().image;
        for v in image.as_slice() {
            histogram[*v as usize] += 1;
        }
        for y in (0..image.height()).step_by(8) {
            add_power(image.row(y), &mut power);
            rows += 1;
        }
    }
    assert!(rows > 500);
    // slope of log power over log frequency, per octave means, from 4 to 64 periods per picture
    let octave = |f: usize| power[f..2 * f].iter().sum::<f64>() / f as f64;
    let slopes: Vec<f64> = [4, 8, 16]
        .iter()
        .map(|&f| (octave(2 * f) / octave(f)).log2())
        .collect();
    let mean = slopes.iter().sum::<f64>() / slopes.len() as f64;
    assert!((-2.8..-1.2).contains(&mean), "{slopes:?}");
    let total: usize = histogram.iter().sum();
    let share =
        |from: usize, to: usize| histogram[from..to].iter().sum::<usize>() as f64 / total as f64;
    assert!(
        share(0, 30) + share(250, 256) < 0.10,
        "{} {}",
        share(0, 30),
        share(250, 256)
    );
    assert!(share(60, 200) > 0.5, "{}", share(60, 200));
}

/// Adds the power of the first frequencies of a row (Hann window).
fn add_power(row: &[f32], power: &mut [f64]) {
    let n = row.len();
    let mean = row.iter().map(|&v| f64::from(v)).sum::<f64>() / n as f64;
    for (f, total) in power.iter_mut().enumerate() {
        let (mut re, mut im) = (0.0, 0.0);
        for (x, &v) in row.iter().enumerate() {
            let angle = std::f64::consts::TAU * x as f64 / n as f64;
            let value = (f64::from(v) - mean) * (0.5 - 0.5 * angle.cos());
            re += value * (angle * f as f64).cos();
            im += value * (angle * f as f64).sin();
        }
        *total += re * re + im * im;
    }
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn the_built_in_hand_moves_like_that_of_real_data() {
    let path = data("trajectories/handheld-desk.txt");
    let recorded = CameraPath::recorded(&read_trajectory(&path).unwrap(), 40.0).unwrap();
    let built_in = DEMO.path();
    let (a, b) = (speeds(&recorded), speeds(built_in));
    for ((name, found), expected) in ["m/s", "rad/s", "m/s², 1 Hz up", "rad/s², 1 Hz up"]
        .iter()
        .zip(b)
        .zip(a)
    {
        let ratio = found / expected;
        assert!(
            (0.4..2.5).contains(&ratio),
            "{name}: built in {found}, recorded {expected}"
        );
    }
}

/// Mean speed, mean rate of turning, and root mean square of their changes over 0.1 s.
fn speeds(path: &CameraPath) -> [f64; 4] {
    let dt = 0.1;
    let count = ((path.duration_secs() / dt) as usize).min(480);
    let twists: Vec<_> = (0..count - 1)
        .map(|k| {
            let at = |k: usize| path.world_from_camera(k as f64 * dt);
            (at(k).inverse() * at(k + 1)).log() / dt
        })
        .collect();
    let mean = |f: &dyn Fn(usize) -> f64, n: usize| (0..n).map(f).sum::<f64>() / n as f64;
    let n = twists.len();
    [
        mean(&|k| twists[k].fixed_rows::<3>(0).norm(), n),
        mean(&|k| twists[k].fixed_rows::<3>(3).norm(), n),
        mean(
            &|k| {
                ((twists[k + 1] - twists[k]) / dt)
                    .fixed_rows::<3>(0)
                    .norm_squared()
            },
            n - 1,
        )
        .sqrt(),
        mean(
            &|k| {
                ((twists[k + 1] - twists[k]) / dt)
                    .fixed_rows::<3>(3)
                    .norm_squared()
            },
            n - 1,
        )
        .sqrt(),
    ]
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn motions_of_real_data_of_both_formats_move_the_camera() {
    let folder = data("trajectories");
    for name in ["handheld-xyz.txt", "mav-v102.csv"] {
        let poses = read_trajectory(&folder.join(name)).unwrap();
        let path = CameraPath::recorded(&poses, 20.0).unwrap();
        let start = poses[0].timestamp_ns;
        let mut worst: f64 = 0.0;
        for pose in poses.iter().step_by(97) {
            let secs = (pose.timestamp_ns - start) as f64 * 1e-9;
            let error =
                path.world_from_camera(secs).translation - pose.world_from_camera.translation;
            worst = worst.max(error.norm());
        }
        assert!(worst < 0.03, "{name}: {worst} m");
    }
}

#[test]
fn rows_of_a_rolling_shutter_are_those_of_their_own_pose() {
    let world = DEMO.world();
    let renderer = Renderer::new(&camera(Distortion::None), 2.2);
    let poses: Vec<Se3> = (0..120)
        .map(|row| DEMO.path().world_from_camera(3.0 + 0.002 * f64::from(row)))
        .collect();
    let rolling = renderer.radiance(world, &[], &poses);
    let depth = renderer.depth(world, &[], &poses);
    for row in [0, 57, 119] {
        let global = renderer.radiance(world, &[], &[poses[row]]);
        assert_eq!(rolling.row(row), global.row(row));
        assert_eq!(
            depth.row(row),
            renderer.depth(world, &[], &[poses[row]]).row(row)
        );
    }
    assert_ne!(rolling, renderer.radiance(world, &[], &[poses[0]]));
}

#[test]
fn harsh_effects_change_pictures_but_not_the_truth() {
    let world = built_in("living-room");
    let config = |effects| SynthConfig {
        camera: camera(Distortion::None),
        frames: 200,
        effects,
        ..SynthConfig::small()
    };
    let make = |effects| {
        let path =
            SynthSequence::path_for("living-room", Motion::from(Carrier::Hand), &config(effects))
                .unwrap();
        SynthSequence::new(world.clone(), path, config(effects)).unwrap()
    };
    let (clean, harsh) = (make(EffectsConfig::default()), make(EffectsConfig::harsh()));
    assert!(
        harsh.len() < clean.len() && harsh.len() > 180,
        "{}",
        harsh.len()
    );
    let at_time = |ns| (0..harsh.len()).find(|&k| harsh.timestamp_ns(k) == Some(ns));
    let at = at_time(clean.timestamp_ns(60).unwrap()).unwrap();
    let (a, b) = (clean.frame(60).unwrap(), harsh.frame(at).unwrap());
    assert_eq!(a.world_from_camera, b.world_from_camera);
    assert_eq!((a.index, a.timestamp_ns), (b.index, b.timestamp_ns));
    assert_ne!(a.image, b.image);
    // the walker passes: depth differs where it is, and is nearer there
    let nearer = (0..clean.len()).step_by(10).any(|index| {
        let Some(k) = at_time(clean.timestamp_ns(index).unwrap()) else {
            return false;
        };
        let (free, full) = (clean.depth(index).unwrap(), harsh.depth(k).unwrap());
        let count = free
            .as_slice()
            .iter()
            .zip(full.as_slice())
            .filter(|(f, w)| **w < **f - 0.3)
            .count();
        count > 300
    });
    assert!(nearer);
}

#[test]
fn a_written_sequence_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = DEMO.clone().shortened(4);
    let config = WriteConfig {
        depth_every: 2,
        with_mesh: true,
        ..WriteConfig::default()
    };
    let mut done = 0;
    write_tum_layout(&sequence, folder.path(), &config, |k| done = k).unwrap();
    assert_eq!(done, 4);
    let dataset = Dataset::open(folder.path(), SourceOptions::default()).unwrap();
    assert_eq!(dataset.frames.len(), 4);
    let poses = read_trajectory(&folder.path().join("groundtruth.txt")).unwrap();
    for (k, pose) in poses.iter().enumerate() {
        let error = (pose.world_from_camera * sequence.world_from_camera(k).unwrap().inverse())
            .log()
            .norm();
        assert!(error < 1e-8, "{error}");
        assert_eq!(pose.timestamp_ns, sequence.timestamp_ns(k).unwrap());
        let image = monogrid_datasets::read_gray(&dataset.frames[k].path).unwrap();
        assert_eq!(image, sequence.frame(k).unwrap().image);
    }
    let truth = sequence.depth(2).unwrap();
    let coded = read_depth(&folder.path().join("depth/000002.png"), 5000.0).unwrap();
    for (a, b) in truth.as_slice().iter().zip(coded.as_slice()) {
        assert!((a - b).abs() <= 0.000_11, "{a} {b}");
    }
}

#[test]
fn the_written_calibration_is_that_of_the_camera_for_every_lens() {
    let lenses = [
        Distortion::None,
        Distortion::RadialTangential {
            k1: -0.2,
            k2: 0.05,
            p1: 0.001,
            p2: -0.002,
            k3: 0.01,
        },
        Distortion::Fov { omega: 0.9 },
        Distortion::Equidistant {
            k: [0.01, -0.02, 0.003, 0.0],
        },
        RATIONAL,
        DOUBLE_SPHERE,
    ];
    for lens in lenses {
        let folder = tempfile::tempdir().unwrap();
        let config = SynthConfig {
            camera: camera(lens),
            frames: 1,
            ..SynthConfig::small()
        };
        let world = Arc::new(bare_room());
        let ways = [
            ([1.0, 1.0, 1.2], [3.9, 2.0, 1.0]),
            ([1.5, 1.0, 1.2], [3.9, 2.0, 1.0]),
        ];
        let path = CameraPath::scripted(&ways, Carrier::Rails, 1.0, 0).unwrap();
        let sequence = SynthSequence::new(world, path, config).unwrap();
        write_tum_layout(&sequence, folder.path(), &WriteConfig::default(), |_| ()).unwrap();
        let dataset = Dataset::open(folder.path(), SourceOptions::default()).unwrap();
        let read = Calibration::read(&dataset.calibration_path.unwrap(), None).unwrap();
        assert_eq!(read.camera, camera(lens));
        let depth = DepthCalibration::read(&folder.path().join("calibration_depth.txt")).unwrap();
        let coded = read_depth(
            &folder.path().join("depth/000000.png"),
            depth.units_per_metre,
        )
        .unwrap();
        // the depth image fits to the camera that was written for it
        let pose = sequence.world_from_camera(0).unwrap();
        let ray = depth.camera.unproject(&Vec2::new(20.0, 30.0)).unwrap();
        let expected = leave_box(
            &pose.translation,
            &(pose.rotation * ray),
            &Vec3::new(4.0, 3.0, 2.5),
        );
        assert!((f64::from(coded.at(20, 30)) - expected).abs() < 2e-4);
    }
}

#[test]
fn the_world_is_closed_around_the_camera() {
    let Bounds { min, max } = DEMO.world().bounds();
    assert!(
        min[2] > -0.01 && max[2] < 2.61 && max[0] < 6.1 && max[1] < 5.1,
        "{min:?} {max:?}"
    );
    for k in 0..200 {
        let angle = 0.31 * f64::from(k);
        let direction = [angle.cos(), angle.sin(), (0.7 * f64::from(k)).sin()];
        assert!(DEMO.world().cast([3.0, 2.2, 1.4], direction).is_some());
    }
}
