//! Runs the depth filter alone on a sequence with its true poses, compares with the true depth and
//! writes the depth of each keyframe as a colour picture. The sequence is a folder in TUM layout, or
//! `demo` for the built-in living room.
//!
//! ```text
//! cargo run --release -p monogrid-depth --example posed_sequence -- \
//!     demo /tmp/depth [frames per keyframe] [max frames] [first frame] [thesis]
//! ```
#![allow(clippy::print_stdout, reason = "an example reports on the terminal")]

use monogrid_datasets::synth::{Carrier, LightingConfig, SynthConfig, SynthSequence};
use monogrid_depth::{DepthConfig, DepthMap, HostFrame, ObserveStats, PixelFilter, StereoFrame};
use monogrid_geometry::nalgebra::Quaternion;
use monogrid_geometry::{Camera, Distortion, Pinhole, Rotation, Se3, Vec2, Vec3};
use monogrid_image::{GrayImage, Mask, Undistorter, WorkingSize, bilinear};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

struct Folder {
    /// Time, image, camera pose.
    frames: Vec<(f64, PathBuf, Se3)>,
    depths: Vec<(f64, PathBuf)>,
    undistorter: Undistorter,
    depth_pinhole: Pinhole,
    units_per_metre: f32,
}

fn numbers(path: &Path) -> Result<Vec<Vec<String>>> {
    Ok(std::fs::read_to_string(path)?
        .lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(|line| line.split_whitespace().map(str::to_owned).collect())
        .collect())
}

fn values(row: &[String]) -> Result<Vec<f64>> {
    Ok(row
        .iter()
        .map(|s| s.parse())
        .collect::<std::result::Result<_, _>>()?)
}

fn read_folder(folder: &Path) -> Result<Folder> {
    let c = values(&numbers(&folder.join("calibration.txt"))?[0])?;
    let (distortion, size) = if c.len() > 6 {
        let radial = Distortion::RadialTangential {
            k1: c[4],
            k2: c[5],
            p1: c[6],
            p2: c[7],
            k3: 0.0,
        };
        (radial, (c[8], c[9]))
    } else {
        (Distortion::None, (c[4], c[5]))
    };
    let camera = Camera {
        pinhole: Pinhole::new(c[0], c[1], c[2], c[3]),
        distortion,
        width: size.0 as usize,
        height: size.1 as usize,
    };
    let depth_file = numbers(&folder.join("calibration_depth.txt"))?;
    let d = values(&depth_file[0])?;
    let poses: Vec<(f64, Se3)> = numbers(&folder.join("groundtruth.txt"))?
        .iter()
        .map(|row| {
            let v = values(row)?;
            let rotation = Rotation::from_quaternion(Quaternion::new(v[7], v[4], v[5], v[6]));
            Ok((v[0], Se3::new(rotation, Vec3::new(v[1], v[2], v[3]))))
        })
        .collect::<Result<_>>()?;
    let listed = |name: &str| -> Result<Vec<(f64, PathBuf)>> {
        numbers(&folder.join(name))?
            .iter()
            .map(|row| Ok((row[0].parse()?, folder.join(&row[1]))))
            .collect()
    };
    let frames = listed("rgb.txt")?
        .into_iter()
        .filter_map(|(time, path)| {
            let pose = poses.iter().find(|(t, _)| (t - time).abs() < 0.004)?;
            Some((time, path, pose.1))
        })
        .collect();
    Ok(Folder {
        frames,
        depths: listed("depth.txt")?,
        undistorter: Undistorter::new(&camera, WorkingSize::Automatic, None),
        depth_pinhole: Pinhole::new(d[0], d[1], d[2], d[3]),
        units_per_metre: values(&depth_file[1])?[0] as f32,
    })
}

impl Folder {
    fn image(&self, n: usize) -> Result<GrayImage> {
        let gray = image::ImageReader::open(&self.frames[n].1)?
            .with_guessed_format()?
            .decode()?
            .to_luma8();
        let (w, h) = gray.dimensions();
        let raw = GrayImage::from_vec(
            w as usize,
            h as usize,
            gray.into_raw().into_iter().map(f32::from).collect(),
        )
        .ok_or("image size")?;
        Ok(self
            .undistorter
            .apply(&raw)
            .ok_or("image size differs from the calibration")?)
    }

    /// Depth (m) seen by the pixels of the working image, NaN where unknown; `None` without an image.
    fn depth(&self, n: usize) -> Result<Option<GrayImage>> {
        let time = self.frames[n].0;
        let Some((_, path)) = self.depths.iter().find(|(t, _)| (t - time).abs() < 0.004) else {
            return Ok(None);
        };
        let raw = image::open(path)?.to_luma16();
        let (w, h) = self.undistorter.size();
        let pinhole = self.undistorter.pinhole();
        Ok(Some(GrayImage::from_fn(w, h, |x, y| {
            let ray = pinhole.unproject(&Vec2::new(x as f64, y as f64));
            let pixel = self.depth_pinhole.project(&ray);
            let (u, v) = (pixel.x.round(), pixel.y.round());
            let inside =
                u >= 0.0 && v >= 0.0 && u < f64::from(raw.width()) && v < f64::from(raw.height());
            let value = if inside {
                raw.get_pixel(u as u32, v as u32).0[0]
            } else {
                0
            };
            if value == 0 || value == u16::MAX {
                f32::NAN
            } else {
                f32::from(value) / self.units_per_metre
            }
        })))
    }
}

/// Where frames come from.
enum Sequence {
    Folder(Box<Folder>),
    Demo(Box<SynthSequence>),
}

impl Sequence {
    fn open(name: &str) -> Result<Self> {
        if name == "demo" {
            let quick = LightingConfig::quick();
            let demo = SynthConfig::demo();
            let world = SynthSequence::built_in_with("living-room", Carrier::Hand, demo, &quick)?;
            return Ok(Self::Demo(Box::new(world)));
        }
        Ok(Self::Folder(Box::new(read_folder(Path::new(name))?)))
    }

    fn len(&self) -> usize {
        match self {
            Self::Folder(folder) => folder.frames.len(),
            Self::Demo(world) => world.len(),
        }
    }

    fn camera(&self) -> (Pinhole, Mask) {
        match self {
            Self::Folder(folder) => (
                *folder.undistorter.pinhole(),
                folder.undistorter.mask().clone(),
            ),
            Self::Demo(world) => {
                let camera = world.camera();
                (
                    camera.pinhole,
                    Mask::filled(camera.width, camera.height, 255),
                )
            }
        }
    }

    fn pose(&self, n: usize) -> Result<Se3> {
        match self {
            Self::Folder(folder) => Ok(folder.frames[n].2),
            Self::Demo(world) => Ok(world.world_from_camera(n).ok_or("frame beyond the end")?),
        }
    }

    fn image(&self, n: usize) -> Result<GrayImage> {
        match self {
            Self::Folder(folder) => folder.image(n),
            Self::Demo(world) => Ok(world.frame(n).ok_or("frame beyond the end")?.image),
        }
    }

    fn depth(&self, n: usize) -> Result<Option<GrayImage>> {
        match self {
            Self::Folder(folder) => folder.depth(n),
            Self::Demo(world) => Ok(world.depth(n)),
        }
    }
}

/// Gain and bias of a frame against the keyframe, over the pixels whose depth is known.
fn exposure(map: &DepthMap, image: &GrayImage, frame_from_keyframe: &Se3) -> (f32, f32) {
    let host = map.host();
    let pairs: Vec<(f64, f64)> = map
        .pixels(PixelFilter::default())
        .filter_map(|p| {
            let pixel = Vec2::new(f64::from(p.x), f64::from(p.y));
            let point = host.pinhole.unproject(&pixel) / f64::from(p.idepth);
            let seen = host.pinhole.project(&(*frame_from_keyframe * point));
            let value = bilinear(image, seen.x as f32, seen.y as f32)?;
            Some((
                f64::from(host.image.at(p.x.into(), p.y.into())),
                f64::from(value),
            ))
        })
        .collect();
    let (mut gain, mut bias) = (1.0, 0.0);
    if pairs.len() < 1000 {
        return (1.0, 0.0);
    }
    for limit in [60.0, 30.0, 15.0] {
        let (mut n, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (a, b) in &pairs {
            if (b - gain * a - bias).abs() < limit {
                (n, x, y, xx, xy) = (n + 1.0, x + a, y + b, xx + a * a, xy + a * b);
            }
        }
        let denominator = n * xx - x * x;
        if denominator > 0.0 {
            gain = (n * xy - x * y) / denominator;
            bias = (y - gain * x) / n;
        }
    }
    (gain as f32, bias as f32)
}

/// Prints density and errors of a map against a depth image (m).
fn report(map: &DepthMap, depth: &GrayImage, unit_m: f32, label: &str) {
    let gradient = map.host().gradient.magnitude();
    let with_truth = gradient.as_slice().iter().zip(depth.as_slice());
    let textured = with_truth
        .filter(|(g, z)| **g >= 5.0 && z.is_finite())
        .count();
    let (mut relative, mut normal) = (Vec::new(), Vec::new());
    for p in map.pixels(PixelFilter::default()) {
        let z = depth.at(usize::from(p.x), usize::from(p.y));
        if gradient.at(usize::from(p.x), usize::from(p.y)) < 5.0 || !z.is_finite() {
            continue;
        }
        let truth = unit_m / z;
        relative.push((p.idepth - truth) / truth);
        normal.push((p.idepth - truth) / p.idepth_var.sqrt());
    }
    let known = relative.len().max(1) as f32;
    let share = |count: usize, of: f32| 100.0 * count as f32 / of;
    let close = relative.iter().filter(|e| e.abs() < 0.03).count();
    let gross = relative.iter().filter(|e| e.abs() > 0.2).count();
    let two = normal.iter().filter(|e| e.abs() < 2.0).count();
    let (bias, _) = spread(&mut relative);
    let (middle, deviation) = spread(&mut normal);
    println!(
        "{label}: known {} of {textured} textured ({:.1} %), within 3 %: {:.1} % of textured, \
         {:.1} % of known; beyond 20 %: {:.1} %; bias {:.2} %; normalised: median {middle:.2} \
         deviation {deviation:.2}, within 2 sigma {:.1} %",
        relative.len(),
        share(relative.len(), textured.max(1) as f32),
        share(close, textured.max(1) as f32),
        share(close, known),
        share(gross, known),
        100.0 * bias,
        share(two, known),
    );
}

/// Median and robust deviation.
fn spread(values: &mut [f32]) -> (f32, f32) {
    if values.is_empty() {
        return (f32::NAN, f32::NAN);
    }
    let half = values.len() / 2;
    let middle = *values.select_nth_unstable_by(half, f32::total_cmp).1;
    let mut gaps: Vec<f32> = values.iter().map(|v| (v - middle).abs()).collect();
    (
        middle,
        1.4826 * *gaps.select_nth_unstable_by(half, f32::total_cmp).1,
    )
}

/// The grey image with the depth in colour: red near, blue far; dark where uncertain.
fn picture(map: &DepthMap, path: &Path) -> Result<()> {
    let host = map.host();
    let (w, h) = (host.width() as u32, host.height() as u32);
    let mut out = image::RgbImage::from_fn(w, h, |x, y| {
        let v = (0.5 * host.image.at(x as usize, y as usize)) as u8;
        image::Rgb([v, v, v])
    });
    for p in map.pixels(PixelFilter::default()) {
        let t = (p.idepth / 2.0).clamp(0.0, 1.0);
        let ramp = |centre: f32| (255.0 * (1.5 - 4.0 * (t - centre).abs()).clamp(0.0, 1.0)) as u8;
        out.put_pixel(
            u32::from(p.x),
            u32::from(p.y),
            image::Rgb([ramp(0.75), ramp(0.5), ramp(0.25)]),
        );
    }
    Ok(out.save(path)?)
}

#[derive(Default)]
struct Timing {
    observe: f64,
    fill: f64,
    regularize: f64,
    propagate: f64,
    host: f64,
    frames: usize,
    keyframes: usize,
}

/// CPU time of this process where the system tells it (so that a busy machine does not matter), else 0.
fn cpu_seconds() -> f64 {
    std::fs::read_to_string("/proc/self/schedstat")
        .ok()
        .and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok())
        .map_or(0.0, |ns| 1e-9 * ns)
}

fn timed<T>(total: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = cpu_seconds();
    let result = work();
    *total += cpu_seconds() - start;
    result
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let name = arguments
        .get(1)
        .ok_or("usage: posed_sequence FOLDER|demo OUT")?;
    let out = PathBuf::from(
        arguments
            .get(2)
            .ok_or("usage: posed_sequence FOLDER|demo OUT")?,
    );
    let per_keyframe: usize = arguments.get(3).map_or(Ok(12), |s| s.parse())?;
    let max_frames: usize = arguments.get(4).map_or(Ok(usize::MAX), |s| s.parse())?;
    let start: usize = arguments.get(5).map_or(Ok(0), |s| s.parse())?;
    let config = if arguments.get(6).is_some_and(|s| s == "thesis") {
        DepthConfig::thesis()
    } else {
        DepthConfig::default()
    };
    std::fs::create_dir_all(&out)?;
    let sequence = Sequence::open(name)?;
    let first_depth = sequence
        .depth(0)?
        .ok_or("no depth image for the first frame")?;
    let mut finite: Vec<f32> = first_depth
        .as_slice()
        .iter()
        .copied()
        .filter(|z| z.is_finite())
        .collect();
    let unit_m = spread(&mut finite).0;
    println!("unit {unit_m} m");
    run(
        &sequence,
        &config,
        unit_m,
        (per_keyframe, start, max_frames),
        &out,
    )
}

fn stereo<'a>(
    map: &DepthMap,
    image: &'a GrayImage,
    frame_from_keyframe: Se3,
    frame: usize,
) -> StereoFrame<'a> {
    let (gain, bias) = exposure(map, image, &frame_from_keyframe);
    StereoFrame {
        image,
        frame_from_keyframe,
        gain,
        bias,
        residual_rms: 3.0,
        pose_sigma_trans: 0.0003,
        pose_sigma_rot: 0.0003,
        id: frame as u32,
    }
}

fn run(
    sequence: &Sequence,
    config: &DepthConfig,
    unit_m: f32,
    (per_keyframe, start, max_frames): (usize, usize, usize),
    out: &Path,
) -> Result<()> {
    let (pinhole, mask) = sequence.camera();
    let mut timing = Timing::default();
    let mut current: Option<(DepthMap, usize)> = None;
    let mut old: Vec<(GrayImage, usize)> = Vec::new();
    let mut totals = ObserveStats::default();
    let relative = |frame: usize, keyframe: usize| {
        let mut pose = sequence.pose(frame)?.inverse() * sequence.pose(keyframe)?;
        pose.translation /= f64::from(unit_m);
        Result::Ok(pose)
    };
    for n in start..sequence.len().min(start.saturating_add(max_frames)) {
        let image = sequence.image(n)?;
        let Some((map, keyframe)) = &mut current else {
            let host = Arc::new(HostFrame::new(image, mask.clone(), pinhole)?);
            current = Some((DepthMap::empty(host, config), n));
            continue;
        };
        if (n - start) % per_keyframe == 0 {
            if let Some(depth) = sequence.depth(*keyframe)? {
                report(
                    map,
                    &depth,
                    unit_m,
                    &format!("keyframe {keyframe} finished"),
                );
            }
            picture(map, &out.join(format!("keyframe-{keyframe:04}.png")))?;
            let host = timed(&mut timing.host, || {
                HostFrame::new(image, mask.clone(), pinhole).map(Arc::new)
            })?;
            let pose = relative(n, *keyframe)?;
            let (next, propagated) =
                timed(&mut timing.propagate, || map.propagate(host, &pose, config));
            println!("  {propagated:?} candidates {}", next.num_candidates());
            old.insert(0, (map.host().image.clone(), *keyframe));
            old.truncate(3);
            (*map, *keyframe) = (next, n);
            if let Some(depth) = sequence.depth(n)? {
                report(map, &depth, unit_m, "  propagated");
            }
            timing.keyframes += 1;
            let frames: Vec<_> = old
                .iter()
                .map(|(image, k)| Ok(stereo(map, image, relative(*k, n)?, *k)))
                .collect::<Result<_>>()?;
            totals.merge(&timed(&mut timing.observe, || map.observe(&frames, config)));
            timed(&mut timing.fill, || map.fill_holes(config));
            timed(&mut timing.regularize, || map.regularize(config));
            if let Some(depth) = sequence.depth(n)? {
                report(map, &depth, unit_m, "  with old keyframes");
            }
            continue;
        }
        let frames = [stereo(map, &image, relative(n, *keyframe)?, n)];
        totals.merge(&timed(&mut timing.observe, || map.observe(&frames, config)));
        timed(&mut timing.fill, || map.fill_holes(config));
        timed(&mut timing.regularize, || map.regularize(config));
        timing.frames += 1;
    }
    let ms = |seconds: f64, times: usize| 1e3 * seconds / times.max(1) as f64;
    println!(
        "ms: observe {:.2} fill {:.2} regularize {:.2} per frame; propagate {:.2} host {:.2} per keyframe",
        ms(timing.observe, timing.frames),
        ms(timing.fill, timing.frames),
        ms(timing.regularize, timing.frames),
        ms(timing.propagate, timing.keyframes),
        ms(timing.host, timing.keyframes),
    );
    println!("{totals:?}");
    Ok(())
}
