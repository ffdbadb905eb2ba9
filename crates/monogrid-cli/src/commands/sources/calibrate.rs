//! `monogrid calibrate`: a camera from a video of a chessboard or a grid of tags.

use clap::{Args, ValueEnum};
use monogrid_app::args::{JsonArg, SourceArgs};
use monogrid_app::camera::self_calibration::OwnCalibration;
use monogrid_app::input::RawInput;
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_calibration::target::{
    BoardCollector, BoardSize, CornerError, LensModel, TagGrid, TargetCalibration, TargetConfig,
    calibrate,
};
use monogrid_geometry::Vec2;
use monogrid_report::svg::{COLOURS, Plot, Series};
use serde::Serialize;
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// How the lens is described.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ModelArg {
    /// OpenCV's k1 k2 p1 p2: ordinary lenses
    RadialTangential,
    /// Kannala and Brandt's k1 k2 k3 k4: wide lenses and fisheyes
    Equidistant,
}

/// `monogrid calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// Video, or folder of images, that shows a chessboard or a grid of AprilTags from many sides
    pub source: PathBuf,
    /// Output folder [default: a new one under runs]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
    /// Inner corners of the board, where four squares meet [default: as most images show]
    #[arg(long, value_name = "NxM", value_parser = board_size)]
    pub board: Option<BoardSize>,
    /// Look for a grid of AprilTags (36h11, small black squares between them) of so many columns
    /// and rows, of which a part may be seen
    #[arg(long, value_name = "NxM", value_parser = tag_columns_and_rows, conflicts_with = "board")]
    pub aprilgrid: Option<BoardSize>,
    /// Gap between two tags over the side of a tag
    #[arg(
        long, value_name = "R", value_parser = tag_spacing, default_value_t = 0.3,
        requires = "aprilgrid"
    )]
    pub tag_spacing: f64,
    /// Lens model [default: the one with the smaller error]
    #[arg(long, value_enum)]
    pub model: Option<ModelArg>,
    /// First frame to use
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub start: usize,
    /// Use only every N-th frame [default: 1]
    #[arg(long, value_name = "N")]
    pub every: Option<NonZeroUsize>,
    /// Use at most this many frames
    #[arg(long, value_name = "N")]
    pub max_frames: Option<usize>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Numbers of inner corners on both sides.
fn board_size(text: &str) -> Result<BoardSize, String> {
    let size = two_numbers(text, 3..=100).and_then(|(a, b)| BoardSize::new(a, b));
    let expected =
        "expected the numbers of inner corners on both sides, from 3 to 100, such as 9x6";
    size.ok_or_else(|| expected.to_owned())
}

/// Numbers of tags: along a row, and of rows.
fn tag_columns_and_rows(text: &str) -> Result<BoardSize, String> {
    // the family has 587 tags
    let size = two_numbers(text, 1..=24).filter(|(a, b)| (4..=587).contains(&(a * b)));
    size.map(|(columns, rows)| BoardSize { columns, rows })
        .ok_or_else(|| "expected columns and rows of 4 to 587 tags, such as 6x6".to_owned())
}

/// `NxM`, both in a range.
fn two_numbers(text: &str, range: RangeInclusive<usize>) -> Option<(usize, usize)> {
    let (a, b) = text.split_once(['x', 'X'])?;
    let number = |text: &str| text.parse().ok().filter(|n| range.contains(n));
    number(a).zip(number(b))
}

fn tag_spacing(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|r| (0.05..=1.0).contains(r));
    value.ok_or_else(|| "expected 0.05 to 1".to_owned())
}

/// `calibrate --json`.
#[derive(Debug, Serialize)]
struct CalibrateReport {
    images: usize,
    board: String,
    views_found: usize,
    views_used: usize,
    model: String,
    size: [usize; 2],
    /// `fx fy cx cy`, px, and 1.96 standard deviations of each.
    intrinsics: [f64; 4],
    within_95_percent: [f64; 4],
    distortion: Vec<f64>,
    rms_px: f64,
    /// Of the other model, where it was tried.
    other_rms_px: Option<f64>,
    out: PathBuf,
}

/// Finds the board in all frames, calibrates, and writes `calibration.txt` (or `.toml`) and
/// `residuals.svg`.
pub fn execute(args: &CalibrateArgs) -> CommandResult {
    let source = SourceArgs {
        start: args.start,
        every: args.every,
        max_frames: args.max_frames,
        ..SourceArgs::default()
    };
    let config = TargetConfig {
        board: args.board,
        tags: args.aprilgrid.map(|size| TagGrid {
            size,
            spacing: args.tag_spacing,
        }),
        model: args.model.map(|model| match model {
            ModelArg::RadialTangential => LensModel::RadialTangential,
            ModelArg::Equidistant => LensModel::Equidistant,
        }),
        ..TargetConfig::default()
    };
    let input = RawInput::open(&args.source, &source)?;
    let inputs = Inputs::of("the source", &args.source);
    let inputs = match input.dataset() {
        Some(dataset) => inputs.and_files_of(dataset),
        None => inputs,
    };
    let (mut collector, mut size, mut num_images) = (BoardCollector::new(config), None, 0);
    let mut broke_off = None;
    for image in input.images(|reason| broke_off = Some(reason)) {
        let found = (image.width(), image.height());
        if *size.get_or_insert(found) == found {
            collector.add(&image);
            num_images += 1;
        }
    }
    if let Some(reason) = broke_off {
        return Err(Failure::running(reason));
    }
    let size = size.ok_or_else(|| Failure::input("none of the images can be read"))?;
    let views = collector.finish().bad_input()?;
    let found = calibrate(&views, size, &config).bad_input()?;
    let name = format!("{}-calibration", input.name);
    let folder = OutputFolder::named_or_new(args.out.as_deref(), &name, args.force, &inputs)?;
    let own = own_calibration(&found, args.aprilgrid.is_some());
    let (name, text) = own.file();
    folder.write(name, text)?;
    folder.write("residuals.svg", residuals(&found).file())?;
    let report = report(&found, num_images, folder.path().to_owned());
    args.json
        .print(&report, || print_report(&report, &own, name))
}

fn model_name(model: LensModel) -> &'static str {
    match model {
        LensModel::RadialTangential => "radial-tangential",
        LensModel::Equidistant => "equidistant",
    }
}

fn own_calibration(found: &TargetCalibration, has_tags: bool) -> OwnCalibration {
    let (used, _) = found.num_views;
    let target = match has_tags {
        true => format!("a grid of {} tags", found.board),
        false => format!("a chessboard of {} inner corners", found.board),
    };
    OwnCalibration {
        camera: found.camera,
        readout_ms: None,
        interpretation: format!(
            "from {used} views of {target}, {} lens, error {:.3} px",
            model_name(found.model),
            found.rms_px
        ),
        is_assumed: false,
        focal_sigma: None,
        warnings: Vec::new(),
    }
}

fn report(found: &TargetCalibration, images: usize, out: PathBuf) -> CalibrateReport {
    let (camera, (used, given)) = (found.camera, found.num_views);
    let pinhole = camera.pinhole;
    let distortion = camera.distortion.parameters();
    CalibrateReport {
        images,
        board: found.board.to_string(),
        views_found: given,
        views_used: used,
        model: model_name(found.model).to_owned(),
        size: [camera.width, camera.height],
        intrinsics: [pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy],
        within_95_percent: found.sigma_px.map(|sigma| 1.96 * sigma),
        distortion: distortion.iter().map(|(_, value)| *value).collect(),
        rms_px: found.rms_px,
        other_rms_px: found.other_rms_px,
        out,
    }
}

fn print_report(report: &CalibrateReport, own: &OwnCalibration, name: &str) {
    println!(
        "{}; {} images, {} views that differ",
        own.interpretation, report.images, report.views_found
    );
    let names = ["fx", "fy", "cx", "cy"];
    let values = report.intrinsics.iter().zip(report.within_95_percent);
    for (name, (value, within)) in names.iter().zip(values) {
        println!("{name} {value:.2} px, 95 %: within {within:.2} px");
    }
    for (name, value) in own.camera.distortion.parameters() {
        println!("{name} {value:.5}");
    }
    if let Some(other) = report.other_rms_px {
        println!("the other lens model leaves an error of {other:.3} px");
    }
    let out = report.out.display();
    println!("{out}: {name}, residuals.svg (what is left at each corner, times {ENLARGED})");
}

/// How much longer errors are drawn than they are.
const ENLARGED: f64 = 100.0;

/// The corners of all views, and what is left between each and the camera found, enlarged.
fn residuals(found: &TargetCalibration) -> Plot {
    let (width, height) = (found.camera.width as f64, found.camera.height as f64);
    // drawn as the image lies: rows downwards
    let place = |x: f64, y: f64| [x, height - y];
    let line = |from: Vec2, to: Vec2| [place(from.x, from.y), place(to.x, to.y), [f64::NAN; 2]];
    let error = |corner: &CornerError| line(corner.pixel, corner.pixel + corner.error * ENLARGED);
    let across = Vec2::new(0.8, 0.0);
    let dot = |corner: &CornerError| line(corner.pixel - across, corner.pixel + across);
    let corners = &found.errors;
    let dots: Vec<[f64; 2]> = corners.iter().flat_map(dot).collect();
    let lines: Vec<[f64; 2]> = corners.iter().flat_map(error).collect();
    Plot {
        title: format!(
            "What is left at {} corners, times {ENLARGED}: {:.3} px",
            corners.len(),
            found.rms_px
        ),
        x_label: "px".to_owned(),
        y_label: "px from below".to_owned(),
        series: [
            whole_series("corners", 1, &dots),
            whole_series("errors", 8, &lines),
        ]
        .concat(),
        equal_axes: true,
        ranges: Some([[0.0, width], [0.0, height]]),
        ..Plot::default()
    }
}

/// Lines of two points each as series so short that none of them is thinned; the first has the
/// name.
fn whole_series(name: &str, colour: usize, points: &[[f64; 2]]) -> Vec<Series> {
    let chunks = points.chunks(900).enumerate();
    chunks
        .map(|(k, points)| Series {
            name: if k == 0 { name.into() } else { "".into() },
            colour: COLOURS[colour],
            points: points.to_vec(),
            is_dashed: false,
        })
        .collect()
}
