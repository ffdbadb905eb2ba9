//! `monogrid thesis sensor-model`: the curves of the thesis' chapter 5, and those of any model.

use crate::curves::{Figure, curve, figure, plot, thesis_figures, thrun_forms};
use clap::{Args, ValueEnum};
use monogrid_app::args::{JsonArg, positive};
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::failure::{CommandResult, Failure};
use monogrid_occupancy::{AndertForm, Buffer, SensorModel, Significance, ThrunForm};
use monogrid_report::Page;
use monogrid_report::svg::{COLOURS, number};
use std::path::PathBuf;

/// Models with all their forms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CurveModel {
    /// Free before, occupied in the band
    Ideal,
    /// Thrun's, tending to 1/2 behind the obstacle
    Thrun,
    /// Thrun's in the thesis' closed form
    ThrunThesis,
    /// Thrun's with a Gaussian in inverse depth
    ThrunInverseDepth,
    /// Andert's for one camera
    Andert,
    /// Andert's for a stereo camera: sigma grows along the ray
    AndertStereo,
}

/// `monogrid thesis sensor-model`.
#[derive(Debug, Args)]
pub struct SensorModelArgs {
    /// Folder for the curves: .svg, .csv and a page
    #[arg(long, value_name = "DIR")]
    pub plot: PathBuf,
    /// Also draw this model
    #[arg(long, value_enum)]
    pub sensor_model: Option<CurveModel>,
    /// Measured ranges of that model
    #[arg(
        long, value_name = "Z,...", value_delimiter = ',', value_parser = positive,
        default_value = "2"
    )]
    pub range: Vec<f64>,
    /// Standard deviations of the range at 1 m
    #[arg(
        long, value_name = "S,...", value_delimiter = ',', value_parser = positive,
        default_value = "0.05"
    )]
    pub sigma: Vec<f64>,
    /// Let sigma grow with the square of the measured range
    #[arg(long)]
    pub range_dependent: bool,
    /// Thickness L of ideal and thrun [default: 2.5 sigma]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub buffer: Option<f64>,
    /// Significance k of andert
    #[arg(long, value_name = "K", value_parser = positive, default_value_t = 0.05)]
    pub significance: f64,
    /// Probability of free space of andert
    #[arg(long, value_name = "P", value_parser = positive, default_value_t = 0.3)]
    pub p_min: f64,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
    /// Output for programs
    #[command(flatten)]
    pub json: JsonArg,
}

/// Draws the curves.
pub fn execute(args: &SensorModelArgs) -> CommandResult {
    let mut figures = thesis_figures();
    figures.push(thrun_forms());
    if let Some(model) = args.sensor_model {
        figures.push(chosen(args, model)?);
    }
    let folder = OutputFolder::replace(&args.plot, args.force, &Inputs::default())?;
    let mut page = Page::default();
    for Figure { name, note, plot } in &figures {
        folder.write(&format!("{name}.svg"), plot.file())?;
        folder.write(&format!("{name}.csv"), plot.csv())?;
        page.plot(plot);
        page.note(note);
    }
    let html = page.finish(
        "Inverse sensor models",
        "How likely a cell at a range along the ray is occupied, given a measured range. The \
         curves of the thesis' chapter 5.",
    );
    folder.write("sensor-models.html", html)?;
    let file = args.plot.join("sensor-models.html");
    let names: Vec<&str> = figures.iter().map(|figure| figure.name.as_str()).collect();
    let report = serde_json::json!({ "figures": names, "page": file });
    args.json.print(&report, || {
        println!("{}: {} figures", file.display(), figures.len());
    })
}

/// The model that the user asks for.
fn chosen(args: &SensorModelArgs, model: CurveModel) -> Result<Figure, Failure> {
    let buffer = args.buffer.map_or(Buffer::AUTO, Buffer::Fixed);
    let thrun = |form| SensorModel::Thrun { buffer, form };
    let andert = |form| SensorModel::Andert {
        significance: Significance::Fixed(args.significance),
        p_min: args.p_min,
        form,
    };
    let sensor = match model {
        CurveModel::Ideal => SensorModel::Ideal { buffer },
        CurveModel::Thrun => thrun(ThrunForm::Exact),
        CurveModel::ThrunThesis => thrun(ThrunForm::Thesis),
        CurveModel::ThrunInverseDepth => thrun(ThrunForm::InverseDepth),
        CurveModel::Andert => andert(AndertForm::Monocular),
        CurveModel::AndertStereo => andert(AndertForm::Stereo),
    };
    sensor.validate().map_err(Failure::input)?;
    let farthest = args.range.iter().copied().fold(0.0, f64::max);
    let mut series = Vec::new();
    for &z in &args.range {
        for &sigma_at_1 in &args.sigma {
            let sigma = match args.range_dependent {
                true => sigma_at_1 * z * z,
                false => sigma_at_1,
            };
            let name = format!("z = {}, sigma = {}", number(z), number(sigma));
            let colour = COLOURS[(series.len() * 2) % COLOURS.len()];
            series.push(curve(name, colour, &sensor, z, sigma, 2.0 * farthest));
        }
    }
    let plot = plot("The chosen model", series, 2.0 * farthest);
    Ok(figure("chosen", &format!("{sensor:?}"), plot))
}
