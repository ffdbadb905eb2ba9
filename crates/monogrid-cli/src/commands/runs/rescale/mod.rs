//! `monogrid rescale`: a run in metres, when its scale becomes known afterwards.

mod gps;
mod scale;
mod tables;

use crate::commands::runs::{CLOUD, cloud_of, unreadable};
use crate::commands::use_threads;
use clap::Args;
use gps::Georeference;
use monogrid_app::args::{WriteArgs, positive};
use monogrid_app::output::{Content, Inputs, OutputFolder};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::recorded::Recorded;
use monogrid_app::run::align::{Align, Up, UpSummary};
use monogrid_app::run::outputs::{Ground, Surface, lowest_and_highest, path_of, write_global};
use monogrid_app::run::sessions::{MAP_FROM_WORLD, RECORDING, Source, files_of};
use monogrid_datasets::{
    ColourRecord, DepthRevision, KeyframeRecord, PoseSnapshot, Record, RecordedCamera,
    RecordedKeyframe, Recording, RecordingWriter, Scale, SessionInfo, format_sim3, read_sim3,
    read_text, read_trajectory,
};
use monogrid_geometry::Sim3;
use monogrid_report::Page;
use monogrid_report::colours::Colours;
use monogrid_report::explorer::{Cells, PageMesh, PathPoint, Scene, write_section};
use scale::{Results, ScaleFrom};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// `monogrid rescale`.
#[derive(Debug, Args)]
pub struct RescaleArgs {
    /// Folder of a run of unknown scale
    pub run: PathBuf,
    /// Where the scale comes from: camera-height=1.5m (over the floor, median), distance:A,B=1.2m
    /// (points X:Y:Z of the results or pixels kID:X:Y of keyframes), trajectory:FILE in metres,
    /// gps:PATH (subtitles of a drone, .srt, the video of a GoPro, or the folder of photographs
    /// with places in their Exif blocks), or factor=F metres per map unit
    #[arg(long, value_name = "SOURCE", value_parser = ScaleFrom::parse)]
    pub scale_from: ScaleFrom,
    /// Output folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Edge length of a cell, metres [default: the run's]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub resolution: Option<f64>,
    /// Threads of computation [default: all cores]; the results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// Text files of a run and how they are scaled.
type Scaler = fn(&str, f64) -> Option<String>;
const TABLES: [(&str, Scaler); 6] = [
    ("trajectory.txt", tables::trajectory),
    ("trajectory_live.txt", tables::trajectory),
    ("trajectory_odometry.txt", tables::trajectory),
    ("trajectory_earlier.txt", tables::trajectory),
    ("keyframes.txt", tables::keyframes),
    ("graph.g2o", tables::graph),
];
/// What says of which scale a run is.
pub const SUMMARY: &str = "summary.json";
/// Files without lengths.
const COPIED: [&str; 3] = ["frames.csv", "calibration.txt", "config.toml"];

/// Writes everything that has lengths into a new folder, in metres.
pub fn execute(args: &RescaleArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let names = TABLES.map(|(name, _)| name).into_iter().chain(COPIED);
    let names = names.chain([RECORDING, MAP_FROM_WORLD, SUMMARY, CLOUD]);
    let mut inputs = Inputs::of("the run", &args.run)
        .and_all("the run", names.map(|name| args.run.join(name)))
        .and_all("the run", files_of(&args.run));
    match &args.scale_from {
        ScaleFrom::Trajectory(path) => inputs = inputs.and("the trajectory", path),
        ScaleFrom::Gps(path) if path.is_dir() => inputs = inputs.and_dataset(path)?,
        ScaleFrom::Gps(path) => inputs = inputs.and("the places", path),
        _ => {}
    }
    let recording = Source::find(&args.run)?.read()?;
    let summary = summary(&args.run)?;
    if recording.session.scale == Scale::Metric || summary["scale"] == "metric" {
        return Err(Failure::input(format!(
            "{} is in metres already; expected a run of unknown scale",
            args.run.display()
        )));
    }
    let map_from_world = read_sim3(&args.run.join(MAP_FROM_WORLD)).bad_input()?;
    let is_up_certain = UpSummary::read(&summary["up"]).is_certain;
    let camera_height = summary["floor"]["camera_height"].as_f64();
    let (factor, georeference) = args.scale_from.factor(&Results {
        recording: &recording,
        map_from_world,
        camera_height: camera_height.filter(|_| is_up_certain),
        is_up_certain,
        is_over_surface: !summary["level_surface"].is_null(),
        run: args.run.clone(),
    })?;
    let folder = OutputFolder::replace(&args.out, args.write.force, &inputs)?;
    write_tables(&args.run, &folder, factor)?;
    let moved = Sim3 {
        translation: map_from_world.translation * factor,
        ..map_from_world
    };
    folder.write(MAP_FROM_WORLD, format_sim3(&moved))?;
    write_recording(&folder, recording, factor)?;
    let poses = read_trajectory(&folder.path().join("trajectory.txt")).bad_input()?;
    let mut summary = rescaled_summary(summary, factor);
    summary["georeference"] = json!(georeference.as_ref().map(Georeference::summary));
    let path = path_of(&poses);
    let run = args.run.display();
    let lead = format!("In metres: one map unit of {run} is {factor:.4} m.");
    // a cell that followed from the scene is as large as it was
    let of_scene = summary["map"]["cell"]["edge"].as_f64();
    let resolution = args.resolution.or(of_scene.map(|edge| edge * factor));
    let summary = write_maps(&folder, (summary, &lead), &path, resolution, threads)?;
    let report = json!({
        "metres_per_map_unit": factor,
        "map": summary["map"],
        "georeference": summary["georeference"],
    });
    args.write.json.print(&report, || {
        let (out, edge) = (args.out.display(), &summary["map"]["resolution"]);
        println!("{out}: one map unit is {factor:.6} m; cells of {edge} m");
        if let Some(georeference) = &georeference {
            println!("{}", georeference.finding());
        }
    })
}

fn summary(run: &Path) -> Result<Value, Failure> {
    let path = run.join(SUMMARY);
    let text = read_text(&path).map_err(|error| unreadable(&error))?;
    let summary: Option<Value> = serde_json::from_str(&text).ok().filter(Value::is_object);
    summary.ok_or_else(|| Failure::input(format!("{} is damaged", path.display())))
}

/// Numbers with lengths, times `factor`; errors against a reference are of the old unit and left
/// out.
fn rescaled_summary(mut summary: Value, factor: f64) -> Value {
    summary["scale"] = "metric".into();
    summary["metres_per_map_unit"] = factor.into();
    for level in ["floor", "level_surface"] {
        if let Some(height) = summary[level]["camera_height"].as_f64() {
            summary[level]["camera_height"] = (height * factor).into();
        }
    }
    if let Some(summary) = summary.as_object_mut() {
        for key in ["trajectory", "depth", "map_error"] {
            summary.remove(key);
        }
    }
    summary
}

fn write_tables(run: &Path, folder: &OutputFolder, factor: f64) -> Result<(), Failure> {
    let read = |name: &str| -> Result<Option<String>, Failure> {
        let path = run.join(name);
        path.exists()
            .then(|| read_text(&path).bad_input())
            .transpose()
    };
    for (name, scaled) in TABLES {
        if let Some(text) = read(name)? {
            let text = scaled(&text, factor).ok_or_else(|| {
                Failure::input(format!("{} is damaged", run.join(name).display()))
            })?;
            folder.write(name, text)?;
        }
    }
    if let Some(ply) = cloud_of(run) {
        match tables::cloud(&ply, factor) {
            Some(scaled) => folder.write(CLOUD, scaled)?,
            None => eprintln!("warning: {CLOUD} is not of this version and is left out"),
        }
    }
    for name in COPIED {
        if let Some(text) = read(name)? {
            folder.write(name, text)?;
        }
    }
    Ok(())
}

/// The recording with its keyframes and points in a world of metres; edges and frames are in units
/// of keyframes.
fn write_recording(
    folder: &OutputFolder,
    recording: Recording,
    factor: f64,
) -> Result<(), Failure> {
    let doing = "the recording cannot be written";
    let session = SessionInfo {
        scale: Scale::Metric,
        ..recording.session
    };
    let writer = RecordingWriter::create(&folder.begin(RECORDING)?, &session);
    let mut writer = writer.while_running(doing)?;
    let mut poses = PoseSnapshot {
        revision: recording.pose_revision.unwrap_or(0),
        poses: Vec::new(),
    };
    for keyframe in recording.keyframes {
        if let Some(pose) = keyframe.world_from_keyframe {
            let (scale, translation) = (pose.scale * factor, pose.translation * factor);
            let pose = Sim3::new(scale, pose.rotation, translation);
            poses.poses.push((keyframe.id, pose));
        }
        append(&mut writer, keyframe, session.camera()).while_running(doing)?;
    }
    writer.append_poses(poses).while_running(doing)?;
    if let Some(mut continuation) = recording.continuation {
        for point in &mut continuation.points {
            point.idepth = point.idepth.map(|per_unit| per_unit / factor);
        }
        let record = Record::Continuation(continuation);
        writer.append(&record).while_running(doing)?;
    }
    if let Some(end) = recording.end {
        writer.finish(end).while_running(doing)?;
    }
    folder.list(RECORDING, Content::Whole)
}

fn append(
    writer: &mut RecordingWriter,
    keyframe: RecordedKeyframe,
    of_session: RecordedCamera,
) -> Result<(), monogrid_datasets::DatasetError> {
    let revision = (keyframe.depth_revision > 0).then(|| DepthRevision {
        keyframe_id: keyframe.id,
        revision: keyframe.depth_revision,
        pixels: keyframe.pixels.clone(),
    });
    writer.append_keyframe(KeyframeRecord {
        id: keyframe.id,
        frame_index: keyframe.frame_index,
        timestamp_ns: keyframe.timestamp_ns,
        camera: (keyframe.camera != of_session).then_some(keyframe.camera),
        image: keyframe.image,
        pixels: keyframe.pixels,
    })?;
    if let Some(jpeg) = keyframe.colour {
        let keyframe_id = keyframe.id;
        writer.append(&Record::Colour(ColourRecord { keyframe_id, jpeg }))?;
    }
    revision.map_or(Ok(()), |revision| writer.append_depth(revision))
}

/// A place of the path as pages have it.
fn path_point((number, place): (usize, &[f64; 3])) -> PathPoint {
    let [x, y, z] = place.map(|value| value as f32);
    (number, x, y, z)
}

/// Builds the maps of the recording in a folder, beside which its frame lies, around where the
/// camera was, and writes `summary.json` with what is known and facts about the maps, and a report
/// that begins with `lead`; that summary.
pub fn write_maps(
    folder: &OutputFolder,
    (mut summary, lead): (Value, &str),
    path: &[[f64; 3]],
    resolution: Option<f64>,
    threads: usize,
) -> Result<Value, Failure> {
    // the maps are built in the frame that stands beside the recording
    folder.write(SUMMARY, summary.to_string())?;
    let recorded = Recorded::read(&folder.path().join(RECORDING), &Align::Level(Up::Scene))?;
    let frame = &recorded.frame;
    let ground = Ground {
        has_floor: frame.floor.is_some(),
        has_level_surface: frame.level_surface.is_some(),
        is_up_certain: frame.up.is_certain,
        cameras: lowest_and_highest(recorded.paths().iter().flatten().chain(path)),
        is_metric: summary["scale"] == "metric",
    };
    let config = recorded.config.clone().map(|config| config.mapping);
    let mut config = config.unwrap_or_default();
    config.resolution = resolution.unwrap_or(config.resolution);
    let doing = "the map cannot be built";
    let scans = recorded.scans(&config, threads);
    let built = recorded.map(&scans, &config, threads);
    let (mut global, _, _) = built.while_running(doing)?;
    global.pack(threads);
    let centre = path.last().copied().unwrap_or_default();
    let local = global.within(centre, config.local_radius);
    let local = local.while_running(doing)?;
    let colours = &recorded.cell_colours(&scans, global.resolution());
    let surface = Surface {
        colours,
        config: &config.mesh,
        views: &recorded.surface_views(),
        images: &Colours::of(&recorded.keyframes),
    };
    let (_, pictures) = write_global(folder, [&global, &local], path, ground, surface)?;
    let (scene, _) = recorded.scene();
    let mesh = pictures.mesh.as_ref();
    let scene = Scene {
        cells: Some(Cells::new(&global, Some(colours)).while_running(doing)?),
        mesh: mesh.and_then(|mesh| PageMesh::new(mesh, global.resolution())),
        plan: pictures.plan.clone(),
        cut: pictures.cut,
        path: path.iter().enumerate().map(path_point).collect(),
        ..scene
    };
    folder.write_with("report.html", |out| {
        let title = format!("monogrid: {}", recorded.session.source);
        let explorer = |out: &mut dyn Write| write_section(out, &scene);
        let page = Page::default();
        Ok(page.write_around(out, (&title, lead), explorer, &page)?)
    })?;
    summary["map"] = json!({
        "resolution": global.resolution(),
        "leaves": global.leaf_count(),
        "bytes_in_memory": global.bytes_in_memory(),
        "cell": null,
        "band": pictures.plan.map(|plan| plan.band),
    });
    let text = serde_json::to_string_pretty(&summary).map_err(Failure::running)?;
    folder.write(SUMMARY, text + "\n")?;
    Ok(summary)
}
