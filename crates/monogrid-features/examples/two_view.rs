//! Tracks corners from a start frame until two views give a motion, and compares with the truth.
//!
//! `cargo run --release -p monogrid-features --example two_view -- FOLDER [start frames...]`
//! where FOLDER has the TUM layout (`rgb.txt`, `groundtruth.txt`, `calibration.txt`).
#![allow(clippy::print_stdout, reason = "a program for people")]

use monogrid_features::{
    CornerConfig, Match, TrackConfig, TwoView, TwoViewConfig, TwoViewOutcome, detect_corners,
    track_points, two_view,
};
use monogrid_geometry::nalgebra::Quaternion;
use monogrid_geometry::{Camera, Distortion, Pinhole, Rotation, Se3, Vec2, Vec3};
use monogrid_image::{GrayImage, Pyramid, Undistorter, WorkingSize};
use std::path::{Path, PathBuf};
use std::time::Instant;

type Failure = Box<dyn std::error::Error>;

struct Sequence {
    images: Vec<(f64, PathBuf)>,
    poses: Vec<(f64, Se3)>,
    undistorter: Undistorter,
}

fn numbers(line: &str) -> Vec<f64> {
    line.split_whitespace()
        .filter_map(|word| word.parse().ok())
        .collect()
}

fn lines(path: &Path) -> Result<Vec<String>, Failure> {
    let text = std::fs::read_to_string(path)?;
    let kept = text
        .lines()
        .filter(|l| !l.starts_with('#') && !l.is_empty());
    Ok(kept.map(str::to_owned).collect())
}

fn open(folder: &Path) -> Result<Sequence, Failure> {
    let calibration = lines(&folder.join("calibration.txt"))?;
    let v = numbers(calibration.first().ok_or("empty calibration")?);
    let (distortion, size) = match v.len() {
        6 => (Distortion::None, 4),
        10 => {
            let (k1, k2, p1, p2) = (v[4], v[5], v[6], v[7]);
            (
                Distortion::RadialTangential {
                    k1,
                    k2,
                    p1,
                    p2,
                    k3: 0.0,
                },
                8,
            )
        }
        n => return Err(format!("calibration has {n} numbers, expected 6 or 10").into()),
    };
    let pinhole = Pinhole::new(v[0], v[1], v[2], v[3]);
    let camera = Camera::try_new(v[size] as usize, v[size + 1] as usize, pinhole, distortion)?;
    let mut images = Vec::new();
    for line in lines(&folder.join("rgb.txt"))? {
        let mut words = line.split_whitespace();
        let (Some(time), Some(name)) = (words.next(), words.next()) else {
            continue;
        };
        images.push((time.parse()?, folder.join(name)));
    }
    let mut poses = Vec::new();
    for line in lines(&folder.join("groundtruth.txt"))? {
        let v = numbers(&line);
        let rotation = Rotation::from_quaternion(Quaternion::new(v[7], v[4], v[5], v[6]));
        poses.push((v[0], Se3::new(rotation, Vec3::new(v[1], v[2], v[3]))));
    }
    Ok(Sequence {
        images,
        poses,
        undistorter: Undistorter::new(&camera, WorkingSize::Automatic, None),
    })
}

impl Sequence {
    fn pyramid(&self, index: usize) -> Result<Pyramid, Failure> {
        let bytes = std::fs::read(&self.images[index].1)?;
        let gray = image::load_from_memory(&bytes)?.to_luma32f();
        let (w, h) = (gray.width() as usize, gray.height() as usize);
        let values = gray.into_raw().into_iter().map(|v| v * 255.0).collect();
        let raw = GrayImage::from_vec(w, h, values).ok_or("image size")?;
        let working = self
            .undistorter
            .apply(&raw)
            .ok_or("image of another size")?;
        Ok(Pyramid::new(working, 4))
    }

    /// The true pose nearest in time.
    fn world_from_camera(&self, index: usize) -> Se3 {
        let time = self.images[index].0;
        let distance = |p: &&(f64, Se3)| (p.0 - time).abs();
        let nearest = self
            .poses
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        nearest.map_or_else(Se3::identity, |p| p.1)
    }
}

/// Compares inverse depths with the depth image of the frame, if it has one: ratio of scales and
/// robust relative spread. The two cameras are taken to be in one place.
fn compare_depth(folder: &Path, time: f64, pixels: &[Vec2], found: &TwoView, pinhole: &Pinhole) {
    let (Ok(list), Ok(calibration)) = (
        lines(&folder.join("depth.txt")),
        lines(&folder.join("calibration_depth.txt")),
    ) else {
        return;
    };
    let v = numbers(&calibration[0]);
    let depth_pinhole = Pinhole::new(v[0], v[1], v[2], v[3]);
    let units = calibration.last().and_then(|l| numbers(l).pop());
    let units = units.unwrap_or(1000.0);
    let Some(name) = list.iter().find_map(|line| {
        let mut words = line.split_whitespace();
        let at: f64 = words.next()?.parse().ok()?;
        ((at - time).abs() < 0.01).then(|| words.next()).flatten()
    }) else {
        return;
    };
    let Ok(bytes) = std::fs::read(folder.join(name)) else {
        return;
    };
    let Ok(picture) = image::load_from_memory(&bytes) else {
        return;
    };
    let picture = picture.to_luma16();
    let mut ratios = Vec::new();
    for (pixel, point) in pixels.iter().zip(&found.points) {
        let Some(point) = point else { continue };
        let at = depth_pinhole.project(&pinhole.unproject(pixel));
        let (x, y) = (at.x.round(), at.y.round());
        if x < 0.0 || y < 0.0 || x >= f64::from(picture.width()) || y >= f64::from(picture.height())
        {
            continue;
        }
        let depth = f64::from(picture.get_pixel(x as u32, y as u32).0[0]) / units;
        if depth > 0.1 && depth < 20.0 {
            ratios.push(point.idepth * depth);
        }
    }
    ratios.sort_by(f64::total_cmp);
    if ratios.len() < 10 {
        return;
    }
    let middle = ratios[ratios.len() / 2];
    let mut spread: Vec<f64> = ratios.iter().map(|r| (r / middle - 1.0).abs()).collect();
    spread.sort_by(f64::total_cmp);
    println!(
        "      {} depths: baseline {middle:.4} m, half of the depths within {:.1} %, 80 % within {:.1} %",
        ratios.len(),
        100.0 * spread[spread.len() / 2],
        100.0 * spread[spread.len() * 8 / 10]
    );
}

fn describe(name: &str, found: &TwoView, truth: &Se3) {
    let rotation = found
        .b_from_a
        .rotation
        .angle_to(&truth.rotation)
        .to_degrees();
    let direction = found
        .b_from_a
        .translation
        .angle(&truth.translation)
        .to_degrees();
    println!(
        "    {name}: rotation {rotation:.2} deg, direction {direction:.1} deg off (claims {:.1}); {} inliers, \
         parallax {:.1} deg, residual {:.2} px, cost {:.2}, depth sigma {:.2}, R_H {:.2}",
        found.direction_sigma_deg,
        found.num_inliers,
        found.parallax_deg,
        found.residual_px,
        found.cost_per_match,
        found.relative_idepth_sigma,
        found.homography_share,
    );
}

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("which folder?")?);
    let sequence = open(&folder)?;
    let mut starts: Vec<usize> = arguments.filter_map(|a| a.parse().ok()).collect();
    if starts.is_empty() {
        starts = vec![0];
    }
    for start in starts {
        let begun = Instant::now();
        let reference = sequence.pyramid(start)?;
        let load_ms = begun.elapsed().as_secs_f64() * 1e3;
        let begun = Instant::now();
        let corners = detect_corners(
            &reference,
            Some(sequence.undistorter.mask()),
            &[],
            &CornerConfig::default(),
        );
        println!(
            "start {start}: {} corners in {:.1} ms (loading {load_ms:.1})",
            corners.len(),
            begun.elapsed().as_secs_f64() * 1e3
        );
        let points: Vec<Vec2> = corners.iter().map(|c| c.pixel).collect();
        run(&folder, &sequence, start, &reference, &points)?;
    }
    Ok(())
}

fn run(
    folder: &Path,
    sequence: &Sequence,
    start: usize,
    reference: &Pyramid,
    points: &[Vec2],
) -> Result<(), Failure> {
    let mut guesses = points.to_vec();
    let last = (start + 90).min(sequence.images.len() - 1);
    for index in start + 1..=last {
        let current = sequence.pyramid(index)?;
        let begun = Instant::now();
        let outcomes = track_points(
            reference,
            &current,
            points,
            &guesses,
            &TrackConfig::default(),
        );
        let track_ms = begun.elapsed().as_secs_f64() * 1e3;
        let mut matches = Vec::new();
        for ((point, outcome), guess) in points.iter().zip(&outcomes).zip(&mut guesses) {
            if let Some(b) = outcome.pixel() {
                *guess = b;
                matches.push(Match { a: *point, b });
            }
        }
        let begun = Instant::now();
        let outcome = two_view(
            &matches,
            sequence.undistorter.pinhole(),
            &TwoViewConfig::default(),
        );
        let ms = begun.elapsed().as_secs_f64() * 1e3;
        let truth = sequence.world_from_camera(index).inverse() * sequence.world_from_camera(start);
        let line = format!(
            "  +{}: {} matches ({track_ms:.1} ms), {ms:.1} ms, true baseline {:.3}",
            index - start,
            matches.len(),
            truth.translation.norm()
        );
        match &outcome {
            TwoViewOutcome::Accepted(best) => {
                println!("{line}");
                describe("accepted", best, &truth);
                let pixels: Vec<Vec2> = matches.iter().map(|m| m.a).collect();
                let time = sequence.images[start].0;
                compare_depth(folder, time, &pixels, best, sequence.undistorter.pinhole());
                return Ok(());
            }
            TwoViewOutcome::Ambiguous { candidates } => {
                println!("{line}");
                for candidate in candidates {
                    describe("ambiguous", candidate, &truth);
                }
            }
            other => {
                if (index - start).is_multiple_of(5) {
                    println!("{line}: {other:?}");
                }
            }
        }
    }
    println!("  no motion within 90 frames");
    Ok(())
}
