//! `monogrid slice`: a map as one grey picture per layer of cells.

use clap::Args;
use monogrid_app::args::{JsonArg, positive};
use monogrid_app::mapfile;
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_datasets::encode_png;
use monogrid_report::picture::slice::{Window, draw_borders, slice};
use serde::Serialize;
use std::path::PathBuf;

/// Most pixels of all pictures together: a minute of work.
const MAX_PIXELS: usize = 1 << 28;

/// Longer side of a picture, px.
fn pixels(text: &str) -> Result<usize, String> {
    let pixels = text.parse().ok().filter(|n| (1..=16_384).contains(n));
    pixels.ok_or_else(|| "expected 1 to 16384".to_owned())
}

/// `monogrid slice`.
#[derive(Debug, Args)]
pub struct SliceArgs {
    /// Map (.ot, .bt, .mgo, or the folder of a run)
    pub map: PathBuf,
    /// Folder for the pictures; those of an earlier call are replaced
    pub out: PathBuf,
    /// Distance between slices [default: the edge of a cell]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub step: Option<f64>,
    /// Slices whose cells' centres are lower are left out
    #[arg(long, value_name = "Z", default_value_t = f64::NEG_INFINITY, hide_default_value = true)]
    pub min_height: f64,
    /// Slices whose cells' centres are higher are left out
    #[arg(long, value_name = "Z", default_value_t = f64::INFINITY, hide_default_value = true)]
    pub max_height: f64,
    /// Draw the borders of the octree's leaves: equal cells are one large cell
    #[arg(long)]
    pub leaves: bool,
    /// About the longer side of the pictures, px; a cell is at least one pixel
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = pixels)]
    pub pixels: usize,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `slice --json`.
#[derive(Debug, Serialize)]
struct SliceReport {
    slices: usize,
    resolution: f64,
    pixels_per_cell: usize,
    first_x: f64,
    first_y: f64,
    heights: Vec<f64>,
}

/// Writes the pictures.
pub fn execute(args: &SliceArgs) -> CommandResult {
    let (map, _) = mapfile::load(&args.map)?;
    let Some((first, last)) = map.key_bounds() else {
        return Err(Failure::input(format!(
            "{} knows no cell: there is nothing to slice",
            args.map.display()
        )));
    };
    let resolution = map.resolution();
    let window = Window::new([first.x, first.y], [last.x, last.y], args.pixels);
    let layers = layers(args, resolution, first.z, last.z);
    if layers.is_empty() {
        return Err(Failure::input(format!(
            "no layer of {} lies between --min-height and --max-height; its cells reach from {:.3} \
             to {:.3}",
            args.map.display(),
            f64::from(first.z) * resolution,
            f64::from(last.z + 1) * resolution
        )));
    }
    let cells = window.size.map(|cells| cells * window.scale);
    let pixels = cells[0].saturating_mul(cells[1]);
    if pixels.saturating_mul(layers.len()) > MAX_PIXELS {
        return Err(Failure::input(format!(
            "{} layers of {} x {} pixels are too many, expected at most {MAX_PIXELS} pixels in \
             all: take fewer layers (--min-height, --max-height), fewer --pixels, or a part \
             (`monogrid crop`)",
            layers.len(),
            cells[0],
            cells[1]
        )));
    }
    let inputs = Inputs::of("the map", &args.map);
    let folder = OutputFolder::replace(&args.out, args.force, &inputs)?;
    let leaves = args.leaves.then(|| map.octree_leaves()).transpose();
    let leaves = leaves.while_running("the leaves cannot be found")?;
    let leaves = leaves.unwrap_or_default();
    for (index, z) in layers.iter().enumerate() {
        let mut picture = slice(&map, &window, *z);
        draw_borders(&mut picture, &leaves, &window, *z);
        folder.write(&format!("slice_{index:04}.png"), encode_png(&picture))?;
    }
    let report = SliceReport {
        slices: layers.len(),
        resolution,
        pixels_per_cell: window.scale,
        first_x: f64::from(window.first[0]) * resolution,
        first_y: f64::from(window.first[1]) * resolution,
        heights: layers.iter().map(|z| height(*z, resolution)).collect(),
    };
    args.json.print(&report, || {
        let out = args.out.display();
        let [low, high] = [layers[0], layers[layers.len() - 1]].map(|z| height(z, resolution));
        println!(
            "{out}: {} slices from z = {low:.3} to {high:.3}, {} pixels per cell; black occupied, \
             white free, grey unknown",
            report.slices, report.pixels_per_cell
        );
    })
}

/// Height of the centres of a layer.
fn height(z: i32, resolution: f64) -> f64 {
    (f64::from(z) + 0.5) * resolution
}

/// Layers to draw, from below.
fn layers(args: &SliceArgs, resolution: f64, first: i32, last: i32) -> Vec<i32> {
    let step = (args.step.unwrap_or(resolution) / resolution)
        .round()
        .clamp(1.0, f64::from(i32::MAX)) as usize;
    (first..=last)
        .filter(|z| (args.min_height..=args.max_height).contains(&height(*z, resolution)))
        .step_by(step)
        .collect()
}
