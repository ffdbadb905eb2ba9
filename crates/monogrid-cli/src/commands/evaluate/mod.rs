//! `monogrid evaluate trajectory` and `monogrid evaluate depth`.

pub mod map;
pub mod truth;

use crate::commands::use_threads;
use clap::{Args, ValueEnum};
use monogrid_app::args::{JsonArg, Profile};
use monogrid_app::config::RunConfig;
use monogrid_app::input::depth_images::{depth_calibration, registered_depth};
use monogrid_app::output::{Inputs, OutputFile, result_at};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::recorded::{by_camera, cameras_of, scans_of};
use monogrid_app::run::align::{read_reference, stamped_all};
use monogrid_app::run::outputs::frame_times_ns;
use monogrid_app::run::sessions::Source;
use monogrid_datasets::{
    Dataset, DepthRegistration, RecordedCamera, Recording, Scale, SourceOptions, format_sim3,
    read_path,
};
use monogrid_evaluation::{
    DepthConfig, DepthEvaluator, DepthReport, KeyframeDepth, TrajectoryAlignment, TrajectoryConfig,
    TrajectoryReport, WrongPoseConfig, evaluate_trajectory,
};
use monogrid_geometry::{Camera, Distortion};
use monogrid_image::{GradientImage, GrayImage, Image};
use monogrid_mapping::{KeyframeScan, refined_depths};
use monogrid_occupancy::DepthPixel as Measurement;
use monogrid_slam::DepthPixel;
use serde::Serialize;
use std::path::PathBuf;

/// How an estimated trajectory is aligned to the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum AlignMode {
    /// Rotation, translation and scale
    Sim3,
    /// Rotation and translation
    Se3,
    /// As it is
    None,
}

/// `monogrid evaluate trajectory`.
#[derive(Debug, Args)]
pub struct EvaluateTrajectoryArgs {
    /// Estimated trajectory, TUM format, or the folder of a run
    pub estimate: PathBuf,
    /// True trajectory, TUM format (or EuRoC .csv), or a data set with poses
    pub truth: PathBuf,
    /// How the estimate is aligned to the truth
    #[arg(long, value_enum, default_value = "sim3")]
    pub align: AlignMode,
    /// Write the alignment (target_from_source): scale tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE")]
    pub write_sim3: Option<PathBuf>,
    /// Replace the file of --write-sim3 if it exists; never one that is read
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid evaluate depth`.
#[derive(Debug, Args)]
pub struct EvaluateDepthArgs {
    /// Recording of a run (.mgk), submaps (submaps.json), or the folder of a run
    pub recording: PathBuf,
    /// Folder in TUM layout with true depth images
    pub truth: PathBuf,
    /// Intrinsics and scale of the depth images [default: calibration_depth.txt in the folder]
    #[arg(long, value_name = "FILE")]
    pub depth_calibration: Option<PathBuf>,
    /// Compare depth made better by the keyframes around each, at the final poses
    #[arg(long, conflicts_with = "mapped")]
    pub refined: bool,
    /// Compare the depth that the final map is made of: refined, filled where surfaces are plain,
    /// fused and filtered
    #[arg(long)]
    pub mapped: bool,
    /// With --mapped, change one setting of the map, e.g. --set mapping.quality=fast
    #[arg(long, value_name = "KEY=VALUE", requires = "mapped")]
    pub set: Vec<String>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Compares an estimated trajectory with the true one.
pub fn trajectory(args: &EvaluateTrajectoryArgs) -> CommandResult {
    let path = result_at(&args.estimate, "trajectory.txt");
    let inputs = Inputs::of("the estimate", &path).and("the truth", &args.truth);
    let file = |path: &PathBuf| OutputFile::new(path, args.force, &inputs);
    let sim3 = args.write_sim3.as_ref().map(file).transpose()?;
    let estimate = read_path(&path).bad_input()?;
    let truth = read_reference(&args.truth)?;
    let folder = path.parent();
    // where the results of its run lie beside it, coverage counts all frames of that
    let frame_times = folder.and_then(|folder| frame_times_ns(&folder.join("frames.csv")).ok());
    let frame_times: Option<Vec<i64>> = frame_times.map(|times| times.into_values().collect());
    let config = TrajectoryConfig {
        alignment: match args.align {
            AlignMode::Sim3 => TrajectoryAlignment::Sim3,
            AlignMode::Se3 => TrajectoryAlignment::Se3,
            AlignMode::None => TrajectoryAlignment::None,
        },
        frame_times_ns: frame_times.as_deref(),
        ..TrajectoryConfig::default()
    };
    let report =
        evaluate_trajectory(&stamped_all(&estimate), &stamped_all(&truth), &config).bad_input()?;
    if let Some(file) = &sim3 {
        file.write(format_sim3(&report.gt_from_est).as_bytes())?;
    }
    args.json.print(&report, || print_trajectory(&report))
}

fn print_trajectory(report: &TrajectoryReport) {
    let of = match report.frames {
        Some(frames) => format!("{frames} frames with a true pose"),
        None => "true poses".to_owned(),
    };
    let covered = 100.0 * report.coverage;
    println!(
        "{} poses compared over a path of {:.3}; the estimate covers {covered:.1} % of the {of}; \
         lengths in the unit of the truth",
        report.matched, report.path_length
    );
    println!(
        "ATE   rmse {:.6}  mean {:.6}  median {:.6}  std {:.6}  max {:.6}",
        report.ate_rmse, report.ate_mean, report.ate_median, report.ate_std, report.ate_max
    );
    let rotation = match report.has_orientations {
        true => format!("rotation rmse {:.4} degrees", report.rpe_rot_rmse_deg),
        false => "rotation unknown: one of both has positions alone".to_owned(),
    };
    println!(
        "RPE   translation rmse {:.6}  {rotation} (over one frame)",
        report.rpe_trans_rmse
    );
    println!(
        "scale {:.6}, drift {:.3} (largest over smallest of windows of 3 s)",
        report.scale, report.scale_drift
    );
    let wrong = WrongPoseConfig::default();
    let [share, of_path] = [report.wrong_share, wrong.path_share].map(|share| 100.0 * share);
    println!(
        "{share:.1} % of the poses are off by more than {of_path:.0} % of the path or {} degrees",
        wrong.degrees
    );
}

/// `evaluate depth --json`.
#[derive(Debug, Serialize)]
struct Compared {
    #[serde(flatten)]
    report: DepthReport,
    /// Keyframes that were given true depth and are therefore left out.
    seeded_left_out: usize,
}

/// Compares the depth of a recording with true depth images.
pub fn depth(args: &EvaluateDepthArgs) -> CommandResult {
    let recording = Source::find(&args.recording)?.read()?;
    let dataset = Dataset::open(&args.truth, SourceOptions::default()).bad_input()?;
    if dataset.depths.is_empty() {
        return Err(Failure::input(format!(
            "{} has no depth images: expected depth.txt and depth/",
            args.truth.display()
        )));
    }
    let report = compare(&recording, &dataset, args)?;
    args.json.print(&report, || {
        print_depth(&report.report);
        if report.seeded_left_out > 0 {
            println!("the keyframe that was given true depth is left out");
        }
    })
}

fn compare(
    recording: &Recording,
    dataset: &Dataset,
    args: &EvaluateDepthArgs,
) -> Result<Compared, Failure> {
    let session = &recording.session;
    let colour = Camera {
        width: session.width,
        height: session.height,
        pinhole: session.pinhole,
        distortion: Distortion::None,
    };
    let calibration = depth_calibration(dataset, args.depth_calibration.as_deref(), &colour)?;
    let registration = |camera: RecordedCamera| {
        let (width, height) = (camera.width, camera.height);
        let registration = DepthRegistration::new(&calibration, &camera.pinhole, width, height);
        (camera, registration)
    };
    let cameras = cameras_of(&recording.keyframes).into_iter();
    let registrations: Vec<_> = cameras.map(registration).collect();
    let mut evaluator = DepthEvaluator::new(DepthConfig::default());
    let (mut num_compared, mut seeded_left_out) = (0, 0);
    for (keyframe, pixels) in recording.keyframes.iter().zip(depths(recording, args)?) {
        let (Some(image), Some(pose), Some(truth)) = (
            &keyframe.image,
            &keyframe.world_from_keyframe,
            dataset.depth_of_frame(keyframe.timestamp_ns),
        ) else {
            continue;
        };
        // a run is metric because its first keyframe was given true depth: that would be compared
        // with itself
        if keyframe.id == 0 && session.scale == Scale::Metric {
            seeded_left_out += 1;
            continue;
        }
        let registration = registrations.iter().find(|(c, _)| *c == keyframe.camera);
        let Some((_, registration)) = registration else {
            continue;
        };
        let truth = registered_depth(&truth.path, &calibration, registration)?;
        let measured = (image, pixels.as_slice(), pose.scale);
        add_keyframe(&mut evaluator, keyframe.id, measured, &truth)?;
        num_compared += 1;
    }
    if num_compared == 0 {
        return Err(Failure::input(format!(
            "none of the {} keyframes of {} that was not given true depth has a depth image of its \
             time in {}",
            recording.keyframes.len(),
            args.recording.display(),
            args.truth.display()
        )));
    }
    Ok(Compared {
        report: evaluator.finish().map_err(Failure::input)?,
        seeded_left_out,
    })
}

/// Adds a keyframe, its image, depth and length of its unit, and its true depth (z, NaN where
/// unknown, in its camera).
pub fn add_keyframe(
    evaluator: &mut DepthEvaluator,
    id: u32,
    (image, pixels, world_scale): (&Image<u8>, &[DepthPixel], f64),
    true_depth: &GrayImage,
) -> Result<(), Failure> {
    let gradient = GradientImage::new(&image.map(f32::from)).magnitude();
    let keyframe = KeyframeDepth {
        id: u64::from(id),
        width: image.width(),
        height: image.height(),
        estimates: pixels,
        world_scale,
        true_depth: true_depth.as_slice(),
        gradient: gradient.as_slice(),
    };
    evaluator.add_keyframe(&keyframe).map_err(Failure::input)
}

/// The depth of the keyframes as it was recorded, or as the final map has it.
fn depths(
    recording: &Recording,
    args: &EvaluateDepthArgs,
) -> Result<Vec<Vec<DepthPixel>>, Failure> {
    let keyframes = &recording.keyframes;
    if args.mapped {
        return mapped_depths(recording, args);
    }
    if !args.refined {
        return Ok(keyframes.iter().map(|k| k.pixels.clone()).collect());
    }
    let threads = use_threads(None)?;
    Ok(by_camera(keyframes, |posed, camera| {
        refined_depths(posed, camera, threads)
    }))
}

/// The depth of the keyframes as the final map has it.
fn mapped_depths(
    recording: &Recording,
    args: &EvaluateDepthArgs,
) -> Result<Vec<Vec<DepthPixel>>, Failure> {
    let config = RunConfig::recorded_mapping(&recording.session.config)
        .unwrap_or_else(|| RunConfig::of(Profile::Default))
        .with_settings(&args.set)?;
    config.validate()?;
    let threads = use_threads(None)?;
    let scans = scans_of(&recording.keyframes, &config.mapping, threads);
    let pixel = |pixel: &Measurement| DepthPixel {
        x: pixel.x,
        y: pixel.y,
        idepth: pixel.idepth,
        idepth_var: pixel.sigma_idepth.powi(2),
    };
    let pixels = |scan: &KeyframeScan| scan.pixels().iter().map(pixel).collect();
    Ok(scans.iter().map(pixels).collect())
}

fn print_depth(report: &DepthReport) {
    println!(
        "{} keyframes with true depth, {} estimates; scale {:.6}",
        report.keyframes, report.estimates, report.scale
    );
    for (pixels, what, shares) in [
        (report.gradient_pixels, "texture", &report.shares),
        (report.known_pixels, "a true depth", &report.shares_of_known),
    ] {
        println!(
            "of {pixels} pixels with {what}: {:.1} % have a depth, {:.1} % within 3 %, {:.1} % \
             within 10 %",
            100.0 * shares.density,
            100.0 * shares.within_3_percent,
            100.0 * shares.within_10_percent
        );
    }
    println!(
        "of the estimates: {:.1} % within 3 %, {:.1} % within 10 %; bias {:+.2} %",
        100.0 * report.estimates_within_3_percent,
        100.0 * report.estimates_within_10_percent,
        100.0 * report.bias
    );
    let error = &report.normalised_error;
    println!(
        "error over its own sigma: median {:+.3}, robust deviation {:.3}, {:.1} % within 2",
        error.median,
        error.robust_deviation,
        100.0 * error.within_2_sigma
    );
}
