//! `monogrid cameras`: the cameras of this computer.

use clap::Args;
use monogrid_app::args::JsonArg;
use monogrid_app::process::failure::CommandResult;
use serde::Serialize;

/// `monogrid cameras`.
#[derive(Debug, Args)]
pub struct CamerasArgs {
    #[command(flatten)]
    pub json: JsonArg,
}

#[derive(Serialize)]
struct Entry {
    path: String,
    name: String,
    modes: Vec<String>,
}

/// Lists them.
pub fn execute(args: &CamerasArgs) -> CommandResult {
    let cameras: Vec<Entry> = monogrid_video::list_cameras()
        .into_iter()
        .map(|camera| Entry {
            path: camera.path.display().to_string(),
            name: camera.name,
            modes: camera.modes,
        })
        .collect();
    args.json.print(&cameras, || {
        if cameras.is_empty() {
            println!("no camera that delivers YUYV, MJPEG or grey images (looked at /dev/video*)");
        }
        for Entry { path, name, modes } in &cameras {
            println!("{path}: {name}");
            modes.iter().for_each(|mode| println!("  {mode}"));
        }
    })
}
