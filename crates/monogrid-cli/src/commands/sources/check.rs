//! `monogrid check`: reads a source without running and says what would hurt tracking.

use clap::Args;
use monogrid_app::args::{JsonArg, SourceArgs};
use monogrid_app::camera::calibration_check::against_images;
use monogrid_app::input::image_files::spend;
use monogrid_app::input::readings::{ImuFacts, Inertial};
use monogrid_app::input::seen::{self, Motion, no_map};
use monogrid_app::input::{Images, Input};
use monogrid_app::process::failure::{CommandResult, Failure};
use monogrid_calibration::CameraMotion;
use monogrid_datasets::{FrameCheck, FrameChecker, FrameEntry, SequenceCheck};
use monogrid_geometry::median::median;
use monogrid_image::{GrayImage, WorkingSize};
use monogrid_pipeline::Unusable;
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;

/// `monogrid check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Folder in TUM RGB-D or EuRoC layout, or any folder of images
    pub source: PathBuf,
    #[command(flatten)]
    pub input: SourceArgs,
    #[command(flatten)]
    pub json: JsonArg,
}

#[derive(Debug, Serialize)]
struct CheckReport {
    source: String,
    layout: String,
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
    /// How the camera moves: `stands still`, `only turns`, `moves` or `unclear`.
    motion: &'static str,
    /// Where the picture lies within borders: left, top, width, height; `null` where nothing is
    /// fixed to the camera.
    picture: Option<[usize; 4]>,
    /// Numbers of frames.
    repeated: Vec<usize>,
    nearly_repeated: Vec<usize>,
    exposure_jumps: Vec<usize>,
    blurred: Vec<usize>,
    plain: Vec<usize>,
    overexposed: Vec<usize>,
    median_blur: f32,
    median_textured_share: f32,
    depth_images: usize,
    /// Frames of which the second camera of a stereo pair has an image.
    second_images: usize,
    has_ground_truth: bool,
    /// The inertial sensor beside the camera.
    imu: Option<ImuFacts>,
    imu_interpretation: Option<String>,
    warnings: Vec<String>,
}

/// Images decoded at once, with any number of threads: each may have 60 MB.
const CHUNK: usize = 4;

/// Number and time of a frame, and the working image.
type CheckedFrame = (usize, i64, Result<GrayImage, Unusable>);

/// All frames in order; files are decoded by all threads.
fn frames(input: &Input) -> Box<dyn Iterator<Item = CheckedFrame> + '_> {
    let in_order = || {
        Box::new(input.source(None).map(|frame| {
            let image = frame
                .image
                .and_then(|image| input.preparation.apply(&image));
            (frame.index, frame.timestamp_ns, image)
        }))
    };
    let Images::Files(dataset) = &input.images else {
        return in_order();
    };
    let masks = input.reading.masks.as_ref();
    if masks.is_some_and(|masks| !masks.is_any_known()) {
        return in_order();
    }
    let mut budget = dataset.pixel_budget();
    Box::new(input.frames.chunks(CHUNK).flat_map(move |chunk| {
        let read = chunk.par_iter().map(|frame| (frame, input.read(frame)));
        let read: Vec<(&FrameEntry, _)> = read.collect();
        // in their order, so that the same ones are too many with any number of threads
        let within = read.into_iter().map(|(frame, (size, image))| {
            let spent = spend(&mut budget, size);
            (frame.index, frame.timestamp_ns, spent.and(image))
        });
        within.collect::<Vec<_>>()
    }))
}

/// Reads all frames and reports.
pub fn execute(args: &CheckArgs) -> CommandResult {
    let (input, refused) = open(args)?;
    let seen = Seen::all(&input);
    let motion = Motion::of(&input).map_or(CameraMotion::Unclear, |motion| motion.did);
    let mut report = CheckReport::new((&input, motion), &seen);
    if refused.is_some() {
        "not understood".clone_into(&mut report.calibration);
    }
    let outcome = args.json.print(&report, || print_report(&report));
    match (seen.broke_off, refused) {
        (Some(reason), _) => Err(Failure::running(reason)),
        (None, Some(refused)) => Err(refused),
        (None, None) => outcome,
    }
}

/// Field of view with which images are looked at whose calibration is not understood, degrees.
const SOME_FOV_DEG: f64 = 62.0;

/// The source; where its calibration is not understood, the images all the same, and why `run`
/// refuses it.
fn open(args: &CheckArgs) -> Result<(Input, Option<Failure>), Failure> {
    let open = |how: &SourceArgs| Input::open(&args.source, how, WorkingSize::AUTOMATIC);
    let refused = match open(&args.input) {
        Ok(input) => return Ok((input, None)),
        Err(refused) => refused,
    };
    let can_be_opened_again = args.source.is_file() || args.source.is_dir();
    if !can_be_opened_again || !matches!(refused, Failure::Input(_)) {
        return Err(refused);
    }
    let without = SourceArgs {
        calibration: None,
        fov: Some(SOME_FOV_DEG),
        ..args.input.clone()
    };
    match open(&without) {
        Ok(input) => Ok((input, Some(refused))),
        // it is not the calibration
        Err(_) => Err(refused),
    }
}

/// What the frames of a source say.
#[derive(Default)]
struct Seen {
    /// Of all frames, seconds.
    times: Vec<f64>,
    /// Of those that can be used.
    checks: Vec<FrameCheck>,
    numbers: Vec<usize>,
    /// Why the others cannot.
    unreadable: Vec<String>,
    /// Why there are no more, where that is not the end of the source.
    broke_off: Option<Unusable>,
}

impl Seen {
    fn all(input: &Input) -> Self {
        let mut checker = FrameChecker::default();
        let mut seen = Self::default();
        for (index, timestamp_ns, image) in frames(input) {
            if let Err(reason @ Unusable::BrokeOff(_)) = image {
                seen.broke_off = Some(reason);
                break;
            }
            seen.times.push(timestamp_ns as f64 * 1e-9);
            match image {
                Ok(image) => {
                    seen.checks.push(checker.check(&image));
                    seen.numbers.push(index);
                }
                Err(error) => seen.unreadable.push(format!("frame {index}: {error}")),
            }
        }
        seen
    }
}

/// The median and the largest of the differences of successive times.
fn gaps(times: &[f64]) -> (f64, f64) {
    let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let mut gaps: Vec<f64> = gaps.collect();
    let largest = gaps.iter().copied().fold(0.0, f64::max);
    (median(&mut gaps).unwrap_or(0.0), largest)
}

impl CheckReport {
    fn new((input, motion): (&Input, CameraMotion), seen: &Seen) -> Self {
        let dataset = match &input.images {
            Images::Files(dataset) => Some(dataset),
            Images::Video(_) | Images::Rendered(_) => None,
        };
        let sequence = SequenceCheck::new(&seen.checks);
        let in_source = |positions: &[usize]| positions.iter().map(|&i| seen.numbers[i]).collect();
        let jumps: Vec<usize> = sequence.exposure_jumps.iter().map(|jump| jump.0).collect();
        let valid = input.mask().as_slice().iter().filter(|&&m| m > 0).count();
        let (width, height) = input.size();
        let times = &seen.times;
        let seconds = times.last().unwrap_or(&0.0) - times.first().unwrap_or(&0.0);
        let (usual_gap, largest_gap) = gaps(times);
        let inertial = input.inertial.as_ref();
        let mut report = Self {
            source: input.name.clone(),
            layout: input.layout().to_owned(),
            frames: times.len(),
            seconds,
            frames_per_second: match seconds > 0.0 {
                true => (times.len() - 1) as f64 / seconds,
                false => 0.0,
            },
            largest_gap_seconds: largest_gap,
            image_size: [input.camera().width, input.camera().height],
            working_size: [width, height],
            calibration: input.interpretation.clone(),
            horizontal_fov_deg: input.camera().horizontal_fov_deg(),
            usable_pixels: valid as f64 / (width * height) as f64,
            unreadable: seen.unreadable.len(),
            motion: seen::name(motion),
            picture: input.fixed.as_ref().map(|fixed| fixed.picture.into()),
            repeated: in_source(&sequence.repeated),
            nearly_repeated: in_source(&sequence.nearly_repeated),
            exposure_jumps: in_source(&jumps),
            blurred: in_source(&sequence.blurred),
            plain: in_source(&sequence.plain),
            overexposed: in_source(&sequence.overexposed),
            median_blur: sequence.median_blur,
            median_textured_share: sequence.median_textured_share,
            depth_images: dataset.map_or(0, |dataset| dataset.depths.len()),
            second_images: dataset.map_or(0, |dataset| dataset.num_second_images()),
            has_ground_truth: dataset.is_some_and(|dataset| dataset.ground_truth.is_some()),
            imu: inertial.map(|inertial| inertial.facts),
            imu_interpretation: inertial.map(|inertial| inertial.interpretation.clone()),
            warnings: input.warnings.clone(),
        };
        let warnings = &mut report.warnings;
        warnings.extend(inertial.into_iter().flat_map(Inertial::findings));
        if let [first, ..] = seen.unreadable.as_slice() {
            let count = seen.unreadable.len();
            warnings.push(format!("{count} images cannot be used, first {first}"));
        }
        warnings.extend(input.faults());
        warnings.extend(no_map(motion).map(str::to_owned));
        warnings.extend(sequence.findings());
        if input.own_calibration.is_none() {
            warnings.extend(against_images(input));
        }
        report.add_slow_or_narrow(usual_gap);
        report
    }

    fn add_slow_or_narrow(&mut self, usual_gap: f64) {
        let (gap, view) = (self.largest_gap_seconds, self.horizontal_fov_deg);
        if gap > LONG_GAP_SECONDS && gap > MANY_GAPS * usual_gap {
            let hole = format!(
                "{gap:.1} s pass between two frames, usually {usual_gap:.3} s: the camera was off, \
                 images are missing, or its clock was set"
            );
            self.warnings.push(hole);
        }
        if self.frames > 1 && usual_gap * LOW_RATE > 1.0 {
            let rate = 1.0 / usual_gap;
            let slow = format!("{rate:.1} frames per second: the camera must move slowly");
            self.warnings.push(slow);
        }
        if view < NARROW_DEG {
            let narrow =
                format!("the field of view is {view:.0} degrees; 60 and more track better");
            self.warnings.push(narrow);
        }
    }
}

/// Times between frames that are said: longer than this, s, and than so many of the usual ones.
const LONG_GAP_SECONDS: f64 = 2.0;
const MANY_GAPS: f64 = 20.0;
/// Frames per second below which the camera must move slowly.
const LOW_RATE: f64 = 15.0;
/// Horizontal field of view below which little overlaps, degrees.
const NARROW_DEG: f64 = 50.0;

fn print_report(report: &CheckReport) {
    println!("{}: {} layout", report.source, report.layout);
    println!(
        "frames       {} in {:.1} s, {:.2} per second, largest gap {:.3} s",
        report.frames, report.seconds, report.frames_per_second, report.largest_gap_seconds
    );
    let [image, working] =
        [report.image_size, report.working_size].map(|[width, height]| format!("{width}x{height}"));
    let usable = 100.0 * report.usable_pixels;
    println!("images       {image} pixels, working size {working}, {usable:.1} % of it usable");
    println!("calibration  {}", report.calibration);
    let view = report.horizontal_fov_deg;
    println!("view         {view:.1} degrees horizontally");
    println!("motion       {}", report.motion);
    match report.picture {
        Some([left, top, width, height]) => {
            println!("borders      the picture is {width}x{height} pixels at ({left}, {top})");
        }
        None => println!("borders      none found"),
    }
    let texture = 100.0 * report.median_textured_share;
    println!("texture      {texture:.1} % of the pixels in the median frame");
    let repeats = [&report.repeated, &report.nearly_repeated];
    let [repeated, nearly] = repeats.map(Vec::len);
    let [jumps, blurred] = [&report.exposure_jumps, &report.blurred].map(Vec::len);
    let [plain, overexposed] = [&report.plain, &report.overexposed].map(Vec::len);
    println!(
        "frames that  cannot be read {}, repeat {repeated} ({nearly} more nearly), jump in \
         brightness {jumps}, are blurred {blurred}, plain {plain}, overexposed {overexposed}",
        report.unreadable
    );
    let (depths, has_truth) = (report.depth_images, report.has_ground_truth);
    let has_truth = if has_truth { "yes" } else { "no" };
    println!("depth images {depths}, ground truth {has_truth}");
    if report.second_images > 0 {
        let frames = report.second_images;
        println!("stereo       {frames} of the frames have a second image (run --stereo)");
    }
    if let (Some(imu), Some(interpretation)) = (&report.imu, &report.imu_interpretation) {
        println!(
            "inertial     {} readings in {:.1} s, {:.0} per second, largest gap {:.3} s, {} \
             saturated",
            imu.readings, imu.seconds, imu.rate_hz, imu.largest_gap_seconds, imu.saturated
        );
        println!("             {interpretation}");
    }
    if report.warnings.is_empty() {
        println!("nothing that would hurt tracking was found");
    }
    for warning in &report.warnings {
        println!("warning: {warning}");
    }
}
