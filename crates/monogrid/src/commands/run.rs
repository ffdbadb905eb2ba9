//! `monogrid run`: what the command line asks for, put together and checked before anything is computed.

use super::use_threads;
use crate::cli::RunArgs;
use crate::config::RunConfig;
use crate::depth_images::{dataset_seed_depth, depth_calibration};
use crate::failure::{CommandResult, Failure};
use crate::input::{Images, Input};
use crate::output::OutputFolder;
use crate::run::RunSettings;
use crate::run::align::Align;
use crate::run::conclusion::conclude;
use crate::run::sessions::{Continued, Earlier};
use crate::run::whole::{Extras, run_all};
use monogrid_image::GrayImage;
use monogrid_slam::Purpose;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// Runs the command.
pub fn execute(args: &RunArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let continue_from = args.continue_from.as_deref();
    let earlier = continue_from.map(Earlier::read).transpose()?;
    let config = configuration(args, earlier.as_ref())?;
    let align = alignment(args, earlier.as_ref())?;
    let input = open(args, earlier.as_ref())?;
    let seed_depth = seed_depth(&input, args)?;
    let folder = output_folder(args, &input.name)?;
    let settings = RunSettings {
        seed_depth,
        continued: earlier.map(|earlier| continued(earlier, args)),
        realtime: args.realtime,
        show_progress: std::io::stderr().is_terminal(),
        ..RunSettings::new(config, threads)
    };
    describe_input(&input);
    let finished = run_all(&input, &folder, &settings, &align, |_, _| {
        Ok(Extras::default())
    })?;
    conclude(&finished, &folder, args.json.json)
}

/// All settings; options of the command line win.
fn configuration(args: &RunArgs, earlier: Option<&Earlier>) -> Result<RunConfig, Failure> {
    let mut config = base_configuration(args, earlier)?;
    config.apply(&args.mapping);
    if let Some(radius) = args.local_radius {
        config.mapping.local_radius = radius;
    }
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    config.validate()?;
    Ok(config)
}

/// Profile, file and `--set`; the settings of the continued run where no profile or file is named.
fn base_configuration(args: &RunArgs, earlier: Option<&Earlier>) -> Result<RunConfig, Failure> {
    if let Some(earlier) = earlier
        && args.config.is_none()
        && args.profile.is_none()
    {
        let recorded = RunConfig::recorded(&earlier.session.config).ok_or_else(|| {
            Failure::input(format!(
                "the settings in {} cannot be understood by this version; choose some with --profile or --config",
                earlier.path.display()
            ))
        })?;
        return recorded.with_settings(&args.set);
    }
    RunConfig::resolve(
        args.profile.map(Into::into),
        args.config.as_deref(),
        &args.set,
    )
}

/// What `--align` says, else the frame of the continued run.
fn alignment(args: &RunArgs, earlier: Option<&Earlier>) -> Result<Align, Failure> {
    let align = Align::parse(args.align.as_deref())?;
    Ok(match (align, earlier) {
        (Align::FirstCamera, Some(earlier)) => Align::Map {
            map_from_world: earlier.map_from_world,
            description: earlier.frame_description.clone(),
            is_metric: earlier.is_metric,
        },
        (align, _) => align,
    })
}

/// The source, with images of the size of the continued run.
fn open(args: &RunArgs, earlier: Option<&Earlier>) -> Result<Input, Failure> {
    let Some(earlier) = earlier else {
        return Input::open(&args.source, &args.input);
    };
    let mut source = args.input.clone();
    let size = (earlier.session.width, earlier.session.height);
    source.size = source.size.or(Some(size));
    let mut input = Input::open(&args.source, &source)?;
    earlier.check_camera(&input)?;
    input.warnings.extend(earlier.warnings.iter().cloned());
    Ok(input)
}

/// The depth to start with and its frame.
fn seed_depth(input: &Input, args: &RunArgs) -> Result<Option<(usize, GrayImage)>, Failure> {
    let (Some(argument), Images::Files(dataset)) = (&args.seed_depth, &input.images) else {
        return Ok(None);
    };
    let calibration_file = args.depth_calibration.as_deref();
    let calibration = depth_calibration(dataset, calibration_file, &input.camera)?;
    if argument != "dataset" {
        let first = input.frames.first().map_or(0, |frame| frame.index);
        let depth = input.read_depth(Path::new(argument), &calibration)?;
        return Ok(Some((first, depth)));
    }
    let seed = dataset_seed_depth(input, calibration_file)?;
    if seed.is_none() {
        return Err(Failure::input(format!(
            "--seed-depth dataset: {} has no depth image for any of the frames to use",
            dataset.root.display()
        )));
    }
    Ok(seed)
}

/// The output folder, empty; what the run reads is never emptied.
fn output_folder(args: &RunArgs, source_name: &str) -> Result<OutputFolder, Failure> {
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from("runs").join(source_name));
    refuse_to_empty(&out, &args.source, "the source")?;
    if let Some(continued) = &args.continue_from {
        refuse_to_empty(&out, continued, "the run to continue")?;
    }
    OutputFolder::prepare(&out, args.force)
}

/// An output folder that holds what is read, or is it, must not be emptied.
fn refuse_to_empty(out: &Path, read: &Path, what: &str) -> Result<(), Failure> {
    let (Ok(out), Ok(read)) = (out.canonicalize(), read.canonicalize()) else {
        return Ok(());
    };
    if read.starts_with(&out) {
        return Err(Failure::input(format!(
            "the output folder {} holds {what}; choose another with --out",
            out.display()
        )));
    }
    Ok(())
}

fn continued(earlier: Earlier, args: &RunArgs) -> Continued {
    let purpose = if args.localise_only {
        Purpose::LocaliseOnly
    } else {
        Purpose::Extend
    };
    Continued { earlier, purpose }
}

fn describe_input(input: &Input) {
    let (width, height) = input.size();
    eprintln!(
        "{}: {} frames of {}x{} pixels, working size {width}x{height}",
        input.name,
        input.frames.len(),
        input.camera.width,
        input.camera.height
    );
    if !input.interpretation.is_empty() {
        eprintln!("calibration: {}", input.interpretation);
    }
    for warning in &input.warnings {
        eprintln!("warning: {warning}");
    }
}
