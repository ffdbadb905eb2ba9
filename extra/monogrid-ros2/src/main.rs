//! `monogrid-ros2`: see the library of the same name.

use anyhow::Context as _;
use clap::Parser;
use futures::channel::mpsc;
use futures::{StreamExt, future, pin_mut};
use monogrid_datasets::Calibration;
use monogrid_geometry::{Sim3, Vec3};
use monogrid_pipeline::Settings;
use monogrid_ros2::args::Args;
use monogrid_ros2::frames::Frames;
use monogrid_ros2::maps::{MapOptions, Maps};
use monogrid_ros2::node::{RosNode, connect};
use monogrid_ros2::serve::{Inputs, options};
use monogrid_ros2::settings::read_settings;
use monogrid_ros2::topics::MapTopics;
use monogrid_ros2::tracking::{FrameNames, PosePublisher, Tracking};
use monogrid_ros2::work::{Counts, WORK_AHEAD};
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;

/// News that may wait for the thread of the maps: those of some seconds.
const NEWS_AHEAD: usize = 256;

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let camera = match &args.calibration {
        Some(path) => Ok(Calibration::read(path, None)?.camera),
        None => Err(format!("no calibration has come on {} yet", args.info)),
    };
    let base_from_camera = args.frames.mount();
    let scale = args.metres_per_unit.unwrap_or(1.0);
    let frames = Frames::new(base_from_camera, scale);

    let context = connect().context("the ROS domain cannot be joined")?;
    let (work_sender, work) = sync_channel(WORK_AHEAD);
    let (news_sender, news) = sync_channel(NEWS_AHEAD);
    let counts = Arc::new(Counts::default());
    let options = options(&args, work_sender.clone());
    let mut node = RosNode::new(&context, &args.namespace, &args.name, options)?;
    let publisher = PosePublisher::new(&mut node, frame_names(&args), base_from_camera)?;
    let topics = MapTopics::new(&mut node, &args.frames.map_frame)?;
    let inputs = Inputs::new(&mut node, &args)?;

    let tracking = Tracking::new(settings(&args)?, frames, camera, publisher, news_sender);
    let maps = Maps::new(map_options(&args), topics, Arc::clone(&counts));
    let named = |name: &str| thread::Builder::new().name(name.to_owned());
    let tracking = named("tracking").spawn(move || tracking.run(&work))?;
    let maps = named("maps").spawn(move || maps.run(&news))?;

    let (stop, mut stopped) = mpsc::unbounded();
    ctrlc::set_handler(move || {
        // after the first one the node is ending
        let _ = stop.unbounded_send(());
    })?;
    let spinner = node.node.spinner()?;
    {
        let serving = future::join(spinner.spin(), inputs.serve(&work_sender, &counts));
        pin_mut!(serving);
        futures::executor::block_on(future::select(serving, stopped.next()));
    }
    // the parameter's action holds a sender as long as there is a node
    drop((node, work_sender));
    tracking.join().ok().context("tracking failed")?;
    maps.join().ok().context("the maps failed")?;
    Ok(())
}

fn settings(args: &Args) -> anyhow::Result<Settings> {
    let settings = match &args.config {
        Some(path) => read_settings(path)?,
        None => Settings::default(),
    };
    let axes = args.frames.mount().rotation;
    Ok(Settings {
        threads: match args.threads {
            0 => settings.threads,
            threads => threads,
        },
        map_from_world: Sim3::new(1.0, axes, Vec3::zeros()),
        ..settings
    })
}

fn frame_names(args: &Args) -> FrameNames {
    let frames = &args.frames;
    FrameNames {
        map: frames.map_frame.clone(),
        odom: frames.odom_frame.clone(),
        base: frames.base_frame.clone(),
        has_tf: !frames.no_tf,
        has_camera_tf: !frames.no_tf && !frames.no_camera_tf,
    }
}

fn map_options(args: &Args) -> MapOptions {
    MapOptions {
        name: args.name.clone(),
        base_from_camera: args.frames.mount(),
        height_band: args.height_band,
        period: Duration::from_secs_f64(args.map_period),
        metres_per_unit: args.metres_per_unit,
        save_dir: args.save_dir.clone(),
    }
}
