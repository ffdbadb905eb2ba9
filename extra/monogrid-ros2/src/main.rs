//! `monogrid-ros2`: see the library of the same name.

use anyhow::Context as _;
use futures::channel::mpsc;
use futures::{StreamExt, future, pin_mut};
use monogrid_app::config::RunConfig;
use monogrid_datasets::{Calibration, ImuCalibration, printable, read_transform};
use monogrid_geometry::{Se3, Sim3, Vec3};
use monogrid_inertial::Imu;
use monogrid_pipeline::Settings;
use monogrid_ros2::args::Args;
use monogrid_ros2::clock::Clock;
use monogrid_ros2::load::Loaded;
use monogrid_ros2::local::Local;
use monogrid_ros2::log::{Log, LogForm, Severity};
use monogrid_ros2::maps::Maps;
use monogrid_ros2::node::{RosNode, connect};
use monogrid_ros2::serve::{Inputs, options};
use monogrid_ros2::topics::MapTopics;
use monogrid_ros2::tracking::{Beginning, PosePublisher, Tracking};
use monogrid_ros2::work::{AtEnd, Counts, way_to_work};
use std::io::{Write, stderr};
use std::panic::set_hook;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread;

/// News that may wait for the thread of the maps: those of some seconds.
const NEWS_AHEAD: usize = 256;

fn main() -> ExitCode {
    let args = match Args::read(std::env::args_os()) {
        Ok(args) => args,
        // the help of the program, which holds nothing from outside
        Err(help) if !help.use_stderr() => help.exit(),
        Err(error) => return failed(&printable(&error.to_string()), 2),
    };
    let (form, name) = (args.log, args.logger());
    if form == LogForm::Json {
        let name = name.clone();
        set_hook(Box::new(move |panic| {
            let line = form.line(
                Clock::default().now(),
                Severity::Fatal,
                &name,
                &panic.to_string(),
            );
            // what cannot be said is lost
            let _ = writeln!(stderr(), "{line}");
        }));
    }
    match (run(args), form) {
        (Ok(()), _) => ExitCode::SUCCESS,
        (Err(error), LogForm::Human) => failed(&printable(&format!("Error: {error:?}")), 1),
        (Err(error), LogForm::Json) => {
            let said = format!("{error:#}");
            failed(
                &form.line(Clock::default().now(), Severity::Fatal, &name, &said),
                1,
            )
        }
    }
}

/// Says why: names of files and topics come from outside, and a terminal must not obey them.
fn failed(line: &str, code: u8) -> ExitCode {
    let _ = writeln!(stderr(), "{line}");
    ExitCode::from(code)
}

fn run(args: Args) -> anyhow::Result<()> {
    let begin = beginning(&args)?;
    let context = connect().context("the ROS domain cannot be joined")?;
    let (work_sender, work) = way_to_work();
    let (news_sender, news) = sync_channel(NEWS_AHEAD);
    let counts = Arc::new(Counts::default());
    let clock = Arc::new(Clock::default());
    clock.simulate(args.use_sim_time);
    let options = options(&args, work_sender.clone());
    let mut node = RosNode::new(&context, &args.namespace, &args.name, options)?;
    node.remap(&args.remap)?;
    let log = Arc::new(Log::new(&mut node, &args, Arc::clone(&clock))?);
    let publisher = PosePublisher::new(&mut node, &args.frames)?;
    let topics = MapTopics::new(&mut node, &args.frames.map_frame)?;
    let local = Local::new(&mut node, &args)?;
    let inputs = Inputs::new(&mut node, &args)?;

    let map_from_world = begin.settings.map_from_world;
    say_beginning(&log, &args, begin.loaded.as_ref());
    let tracking = Tracking::new(
        begin,
        &args,
        (publisher, local),
        news_sender,
        Arc::clone(&log),
    );
    let maps = Maps::new(args, map_from_world, topics, &counts, &log, &clock);
    let (stop, mut stopped) = mpsc::unbounded();
    let named = |name: &str| thread::Builder::new().name(name.to_owned());
    let ends = AtEnd::new(&stop);
    let tracking = named("tracking").spawn(move || ends.after(|| tracking.run(&work)))?;
    let ends = AtEnd::new(&stop);
    let maps = named("maps").spawn(move || ends.after(|| maps.run(&news)))?;

    ctrlc::set_handler(move || {
        // after the first one the node is ending
        let _ = stop.unbounded_send(());
    })?;
    let spinner = node.node.spinner()?;
    {
        let serving = future::join(
            spinner.spin(),
            inputs.serve(&node.node, &work_sender, &counts, &clock),
        );
        pin_mut!(serving);
        futures::executor::block_on(future::select(serving, stopped.next()));
    }
    // the parameter's action holds a sender as long as there is a node
    drop((node, work_sender));
    tracking.join().ok().context("tracking failed")?;
    maps.join().ok().context("the maps failed")?;
    Ok(())
}

/// What tracking begins with, by the options.
fn beginning(args: &Args) -> anyhow::Result<Beginning> {
    let calibration = args.calibration.as_deref();
    let calibration = calibration.map(|path| Calibration::read(path, None));
    let calibration = calibration.transpose()?;
    let told_ms = calibration.as_ref().and_then(|known| known.readout_ms);
    let (config, mut settings) = settings(args)?;
    settings.readout_ms = args.rolling_shutter.or(told_ms).unwrap_or(0.0);
    let camera = match calibration {
        Some(calibration) => Ok(calibration.camera),
        None => Err(format!("no calibration has come on {} yet", args.info)),
    };
    let loaded = args.load_path.as_deref().map(Loaded::read).transpose();
    Ok(Beginning {
        settings,
        config,
        camera,
        loaded: loaded.map_err(anyhow::Error::msg)?,
    })
}

fn say_beginning(log: &Log, args: &Args, loaded: Option<&Loaded>) {
    let version = env!("CARGO_PKG_VERSION");
    let said = format!("monogrid {version} waits for images on {}", args.image);
    log.say(Severity::Info, &said);
    if let Some(loaded) = loaded {
        loaded.say(log);
    }
    if !args.ignored.is_empty() {
        let said = format!("no parameters of this node: {}", args.ignored.join(", "));
        log.say(Severity::Warn, &said);
    }
}

fn settings(args: &Args) -> anyhow::Result<(RunConfig, Settings)> {
    let config = RunConfig::resolve(args.profile, args.config.as_deref(), &[]);
    let config = config.map_err(|f| anyhow::Error::from_boxed(f.into_error()))?;
    let settings = Settings::default();
    let axes = args.frames.mount().rotation;
    let settings = Settings {
        slam: config.slam.clone(),
        mapping: config.mapping.clone(),
        seed: config.seed,
        working_size: config.working_size(),
        threads: match args.threads {
            0 => settings.threads,
            threads => threads,
        },
        imu: args.imu.as_ref().map(|_| imu(args)).transpose()?,
        map_from_world: Sim3::new(1.0, axes, Vec3::zeros()),
        ..settings
    };
    Ok((config, settings))
}

/// The inertial sensor, before its first reading. The body of its file is the base of the robot.
fn imu(args: &Args) -> anyhow::Result<Arc<Imu>> {
    let calibration = args.imu_calibration.as_deref().map(ImuCalibration::read);
    let calibration = calibration.transpose()?.unwrap_or_default();
    let imu_from_camera = match &args.imu_from_camera {
        Some(path) => read_transform(path)?,
        None => {
            let base_from_imu = calibration.body_from_imu.unwrap_or_else(Se3::identity);
            base_from_imu.inverse() * args.frames.mount()
        }
    };
    let noise = calibration.noise.unwrap_or_default();
    Ok(Arc::new(Imu::new(Vec::new(), noise, imu_from_camera)))
}
