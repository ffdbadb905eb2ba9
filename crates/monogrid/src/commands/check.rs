//! `monogrid check`: reads a source without running and says what would hurt tracking.

use super::print_json;
use crate::cli::CheckArgs;
use crate::failure::{CommandResult, Failure, Outcome};
use crate::input::{Images, Input};
use crate::picture::colour::quantile;
use monogrid_image::{GradientImage, GrayImage};
use rayon::prelude::*;
use serde::Serialize;

/// What is measured in one image.
#[derive(Clone, Copy, Debug)]
struct Measured {
    mean: f64,
    /// Share of pixels with enough gradient to be tracked.
    textured: f64,
    /// Mean square of the Laplacian over the mean square of the gradient: falls with blur.
    sharpness: f64,
    fingerprint: u64,
}

#[derive(Debug, Serialize)]
struct CheckReport {
    source: String,
    layout: &'static str,
    frames: usize,
    seconds: f64,
    frames_per_second: f64,
    largest_gap_seconds: f64,
    image_size: [usize; 2],
    working_size: [usize; 2],
    calibration: String,
    horizontal_fov_deg: f64,
    usable_pixels: f64,
    unreadable: usize,
    repeated: usize,
    exposure_jumps: usize,
    blurred: usize,
    textured_median: f64,
    textured_worst: f64,
    depth_images: usize,
    has_ground_truth: bool,
    warnings: Vec<String>,
}

/// Grey levels per pixel that tracking needs.
const TEXTURE_GRADIENT: f32 = 5.0;
/// Brightness between frames that is more than flicker.
const EXPOSURE_JUMP: f64 = 1.1;
/// Sharpness below this share of the median is blur.
const BLUR_SHARE: f64 = 0.5;
/// Texture below this share of the pixels is too little.
const MIN_TEXTURED: f64 = 0.02;

/// Reads all frames and reports.
pub fn execute(args: &CheckArgs) -> CommandResult {
    let input = Input::open(&args.source, &args.input)?;
    let Images::Files(dataset) = &input.images else {
        return Err(Failure::input("expected a source of files"));
    };
    let measured: Vec<Result<Measured, String>> = input
        .frames
        .par_iter()
        .map(|frame| {
            input
                .read(frame)
                .map(|image| measure(&image))
                .map_err(|error| format!("frame {}: {error}", frame.index))
        })
        .collect();
    let good: Vec<Measured> = measured
        .iter()
        .filter_map(|m| m.as_ref().ok())
        .copied()
        .collect();
    let times: Vec<f64> = input
        .frames
        .iter()
        .map(|f| f.timestamp_ns as f64 * 1e-9)
        .collect();
    let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let seconds = times.last().unwrap_or(&0.0) - times.first().unwrap_or(&0.0);
    let sharpness = median(good.iter().map(|m| m.sharpness));
    let valid = input.mask().as_slice().iter().filter(|&&m| m > 0).count();
    let pairs = || good.windows(2);
    let jump = |pair: &&[Measured]| {
        let ratio = pair[1].mean.max(1.0) / pair[0].mean.max(1.0);
        !(1.0 / EXPOSURE_JUMP..=EXPOSURE_JUMP).contains(&ratio)
    };
    let (width, height) = input.size();
    let mut report = CheckReport {
        source: input.name.clone(),
        layout: dataset.layout.name(),
        frames: input.frames.len(),
        seconds,
        frames_per_second: if seconds > 0.0 {
            (input.frames.len() - 1) as f64 / seconds
        } else {
            0.0
        },
        largest_gap_seconds: gaps.fold(0.0, f64::max),
        image_size: [input.camera.width, input.camera.height],
        working_size: [width, height],
        calibration: input.interpretation.clone(),
        horizontal_fov_deg: input.camera.horizontal_fov_deg(),
        usable_pixels: valid as f64 / (width * height) as f64,
        unreadable: measured.len() - good.len(),
        repeated: pairs()
            .filter(|p| p[0].fingerprint == p[1].fingerprint)
            .count(),
        exposure_jumps: pairs().filter(jump).count(),
        blurred: good
            .iter()
            .filter(|m| m.sharpness < BLUR_SHARE * sharpness)
            .count(),
        textured_median: median(good.iter().map(|m| m.textured)),
        textured_worst: good.iter().map(|m| m.textured).fold(1.0, f64::min),
        depth_images: dataset.depths.len(),
        has_ground_truth: dataset.ground_truth.is_some(),
        warnings: input.warnings.clone(),
    };
    let first_error = measured.into_iter().find_map(Result::err);
    add_warnings(&mut report, first_error);
    if args.json.json {
        print_json(&report)?;
    } else {
        print_report(&report);
    }
    Ok(Outcome::Done)
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(&mut values.collect::<Vec<f64>>(), 0.5)
}

fn measure(image: &GrayImage) -> Measured {
    let pixels = image.as_slice();
    let gradient = GradientImage::new(image).magnitude();
    let textured = gradient
        .as_slice()
        .iter()
        .filter(|&&g| g >= TEXTURE_GRADIENT)
        .count();
    let gradient_energy: f64 = gradient.as_slice().iter().map(|&g| f64::from(g * g)).sum();
    let mut laplacian_energy = 0.0;
    for y in 1..image.height().saturating_sub(1) {
        let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
        for x in 1..image.width().saturating_sub(1) {
            let laplacian = row[x - 1] + row[x + 1] + above[x] + below[x] - 4.0 * row[x];
            laplacian_energy += f64::from(laplacian * laplacian);
        }
    }
    let fingerprint = pixels
        .iter()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, value| {
            (hash ^ u64::from(value.to_bits())).wrapping_mul(0x0100_0000_01b3)
        });
    Measured {
        mean: pixels.iter().map(|&v| f64::from(v)).sum::<f64>() / pixels.len().max(1) as f64,
        textured: textured as f64 / pixels.len().max(1) as f64,
        sharpness: laplacian_energy / gradient_energy.max(1.0),
        fingerprint,
    }
}

/// What would hurt tracking, in sentences.
fn add_warnings(report: &mut CheckReport, first_error: Option<String>) {
    let mut warn = |is_true: bool, text: String| {
        if is_true {
            report.warnings.push(text);
        }
    };
    if let Some(error) = first_error {
        warn(
            true,
            format!("{} images cannot be used, first {error}", report.unreadable),
        );
    }
    warn(
        report.repeated > 0,
        format!(
            "{} frames repeat the one before; they get its pose and add nothing",
            report.repeated
        ),
    );
    warn(
        report.exposure_jumps * 20 > report.frames,
        format!(
            "brightness jumps by more than 10 % between {} pairs of frames; switch automatic exposure off if you can",
            report.exposure_jumps
        ),
    );
    warn(
        report.blurred * 20 > report.frames,
        format!(
            "{} frames are much less sharp than the others; move slower or use more light",
            report.blurred
        ),
    );
    warn(
        report.textured_median < MIN_TEXTURED,
        format!(
            "only {:.1} % of the pixels have texture in the median frame; tracking needs about {:.0} %",
            100.0 * report.textured_median,
            100.0 * MIN_TEXTURED
        ),
    );
    warn(
        report.frames > 1 && report.frames_per_second < 15.0,
        format!(
            "{:.1} frames per second: the camera must move slowly",
            report.frames_per_second
        ),
    );
    warn(
        report.horizontal_fov_deg < 50.0,
        format!(
            "the field of view is {:.0} degrees; 60 and more track better",
            report.horizontal_fov_deg
        ),
    );
}

fn print_report(report: &CheckReport) {
    println!("{}: {} layout", report.source, report.layout);
    println!(
        "frames       {} in {:.1} s, {:.2} per second, largest gap {:.3} s",
        report.frames, report.seconds, report.frames_per_second, report.largest_gap_seconds
    );
    println!(
        "images       {}x{} pixels, working size {}x{}, {:.1} % of it usable",
        report.image_size[0],
        report.image_size[1],
        report.working_size[0],
        report.working_size[1],
        100.0 * report.usable_pixels
    );
    println!("calibration  {}", report.calibration);
    println!(
        "view         {:.1} degrees horizontally",
        report.horizontal_fov_deg
    );
    println!(
        "texture      {:.1} % of the pixels in the median frame, {:.1} % in the worst",
        100.0 * report.textured_median,
        100.0 * report.textured_worst
    );
    println!(
        "unreadable {}, repeated {}, exposure jumps {}, blurred {}",
        report.unreadable, report.repeated, report.exposure_jumps, report.blurred
    );
    println!(
        "depth images {}, ground truth {}",
        report.depth_images,
        if report.has_ground_truth { "yes" } else { "no" }
    );
    if report.warnings.is_empty() {
        println!("nothing that would hurt tracking was found");
    }
    for warning in &report.warnings {
        println!("warning: {warning}");
    }
}
