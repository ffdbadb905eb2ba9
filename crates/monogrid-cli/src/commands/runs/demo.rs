//! `monogrid demo`: a built-in world from rendering to the report, compared with the exact truth.

use crate::commands::evaluate::add_keyframe;
use crate::commands::evaluate::truth::triangles_of;
use crate::commands::use_threads;
use clap::Args;
use monogrid_app::args::{JsonArg, Profile};
use monogrid_app::config::RunConfig;
use monogrid_app::input::{Images, Input};
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::console::is_drawn;
use monogrid_app::process::failure::{CommandResult, Failure};
use monogrid_app::run::RunSettings;
use monogrid_app::run::align::Align;
use monogrid_app::run::conclusion::conclude;
use monogrid_app::run::outputs::path_of;
use monogrid_app::run::tracking::tracked::Tracked;
use monogrid_app::run::whole::{Extras, run_all};
use monogrid_datasets::TimedPose;
use monogrid_evaluation::{
    DepthConfig, DepthEvaluator, DepthReport, MapEvaluationConfig, MapReport, TruthConfig,
    evaluate_map, truth_from_triangles,
};
use monogrid_geometry::{Camera, Distortion};
use monogrid_mapping::Maps;
use monogrid_worlds::{Renderer, SynthSequence};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// `monogrid demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Output folder [default: a new one, runs/demo or runs/demo-2 ...]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
    /// Render at most this many frames
    #[arg(long, value_name = "N")]
    pub max_frames: Option<usize>,
    /// Complete set of settings to start from [default: default]
    #[arg(long, value_enum)]
    pub profile: Option<Profile>,
    /// Seed of everything random
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Threads of computation [default: all cores]; the results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Runs the command.
pub fn execute(args: &DemoArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let mut config = RunConfig::resolve(args.profile, None, &[])?;
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    if args.max_frames == Some(0) {
        return Err(Failure::input("--max-frames is 0, expected at least 1"));
    }
    let (out, inputs) = (args.out.as_deref(), Inputs::default());
    let folder = OutputFolder::named_or_new(out, "demo", args.force, &inputs)?;
    let folder = Arc::new(folder);
    eprintln!("building a furnished living room");
    let mut sequence = SynthSequence::demo().map_err(Failure::running)?;
    if let Some(frames) = args.max_frames {
        sequence = sequence.shortened(frames);
    }
    let align = Align::Trajectory {
        path: "the exact truth".into(),
        poses: true_poses(&sequence),
    };
    let input = Input::rendered(sequence, config.working_size());
    eprintln!(
        "rendering and tracking {} frames as a hand-held camera would see them",
        input.frames.len()
    );
    let settings = RunSettings {
        show_progress: is_drawn(),
        ..RunSettings::new(config, threads)
    };
    let finished = run_all(&input, &folder, &settings, &align, |tracked, maps| {
        eprintln!("comparing depth and map with the truth");
        Ok(Extras {
            depth: compare_depth(&input, tracked)?,
            map: compare_map(&input, maps)?,
            warnings: vec![
                "The frames were rendered during the run: speed and CPU times include that.".into(),
            ],
        })
    })?;
    conclude(&finished, &folder, args.json.json)
}

fn true_poses(sequence: &SynthSequence) -> Vec<TimedPose> {
    let pose = |k| {
        Some(TimedPose {
            timestamp_ns: sequence.timestamp_ns(k)?,
            world_from_camera: sequence.world_from_camera(k)?,
        })
    };
    (0..sequence.len()).filter_map(pose).collect()
}

/// The global map against the voxelised surfaces of the world; `None` without a map.
fn compare_map(input: &Input, maps: Option<&Maps>) -> Result<Option<MapReport>, Failure> {
    let (Images::Rendered(sequence), Some(maps)) = (&input.images, maps) else {
        return Ok(None);
    };
    let world = sequence.world();
    let triangles = triangles_of(&world.mesh(), Path::new(world.name()))?;
    let cameras = path_of(&true_poses(sequence));
    let config = TruthConfig::with_resolution(maps.global.resolution());
    let truth = truth_from_triangles(&triangles, &cameras, &config).map_err(Failure::running)?;
    evaluate_map(&maps.global, &truth.grid, &MapEvaluationConfig::default())
        .map(Some)
        .map_err(Failure::running)
}

/// Depth of the keyframes against the exact depth; `None` without keyframes.
fn compare_depth(input: &Input, tracked: &Tracked) -> Result<Option<DepthReport>, Failure> {
    let Images::Rendered(sequence) = &input.images else {
        return Ok(None);
    };
    let (width, height) = input.preparation.size();
    let pinhole = *input.preparation.pinhole();
    let working = Camera::try_new(width, height, pinhole, Distortion::None);
    let renderer = Renderer::new(&working.map_err(Failure::running)?, 1.0);
    let mut evaluator = DepthEvaluator::new(DepthConfig::default());
    let mut has_compared = false;
    for keyframe in tracked.run.slam.keyframes() {
        let pose = tracked.run.poses.in_main_map(keyframe.id);
        let true_depth = sequence.depth_through(&renderer, keyframe.frame_index);
        let (Some(pose), Some(true_depth), Some(keyframe)) = (pose, true_depth, keyframe.load())
        else {
            continue;
        };
        let measured = (&keyframe.image, keyframe.pixels.as_slice(), pose.scale);
        add_keyframe(&mut evaluator, keyframe.id, measured, &true_depth)?;
        has_compared = true;
    }
    if !has_compared {
        return Ok(None);
    }
    evaluator.finish().map(Some).map_err(Failure::input)
}
