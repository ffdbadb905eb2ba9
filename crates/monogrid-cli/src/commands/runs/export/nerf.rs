//! `transforms.json`: images with poses as instant-ngp, nerfstudio and trainers of Gaussian splats
//! read them.
//!
//! <https://docs.nerf.studio/quickstart/data_conventions.html>. Cameras look along -z with y up,
//! the centre of the top-left pixel is (0.5, 0.5), and poses take points of the camera to the
//! world.

use super::images::FOLDER;
use super::reconstruction::{Reconstruction, View};
use crate::commands::runs::cloud_of;
use monogrid_app::output::OutputFolder;
use monogrid_app::process::failure::Failure;
use monogrid_datasets::RecordedCamera;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Points to begin with.
const POINTS: &str = "points.ply";

/// Writes `transforms.json`, and the cloud of the run where there is one.
pub fn write(folder: &OutputFolder, scene: &Reconstruction, run: &Path) -> Result<(), Failure> {
    let mut transforms = transforms(scene);
    if let Some(cloud) = cloud_of(run) {
        folder.write(POINTS, cloud)?;
        transforms.insert("ply_file_path".to_owned(), POINTS.into());
    }
    let text = serde_json::to_string_pretty(&transforms).map_err(Failure::running)?;
    folder.write("transforms.json", text + "\n")
}

fn transforms(scene: &Reconstruction) -> Map<String, Value> {
    let mut transforms = Map::new();
    transforms.insert("camera_model".to_owned(), "PINHOLE".into());
    // the images of several cameras have one each
    let shared = match &scene.cameras[..] {
        [camera] => Some(intrinsics(camera)),
        _ => None,
    };
    let is_shared = shared.is_some();
    transforms.extend(shared.unwrap_or_default());
    let frames = scene.views.iter().map(|view| {
        let mut frame = match is_shared {
            true => Map::new(),
            false => intrinsics(&scene.cameras[view.camera]),
        };
        frame.insert(
            "file_path".to_owned(),
            format!("{FOLDER}/{}", view.name).into(),
        );
        frame.insert("transform_matrix".to_owned(), json!(matrix(view)));
        Value::Object(frame)
    });
    transforms.insert("frames".to_owned(), frames.collect());
    transforms
}

fn intrinsics(camera: &RecordedCamera) -> Map<String, Value> {
    let pinhole = camera.pinhole;
    let values = [
        ("fl_x", pinhole.fx),
        ("fl_y", pinhole.fy),
        ("cx", pinhole.cx + 0.5),
        ("cy", pinhole.cy + 0.5),
    ];
    let sizes = [("w", camera.width), ("h", camera.height)];
    let values = values.map(|(name, value)| (name.to_owned(), value.into()));
    let sizes = sizes.map(|(name, size)| (name.to_owned(), size.into()));
    values.into_iter().chain(sizes).collect()
}

/// From a camera that looks along -z, y up, to the frame of maps.
fn matrix(view: &View) -> [[f64; 4]; 4] {
    let map_from_camera = view.camera_from_map.inverse();
    let rotation = map_from_camera.rotation.to_rotation_matrix();
    let place = map_from_camera.translation;
    let row = |k: usize| {
        let [right, down, forward] = [0, 1, 2].map(|column| rotation[(k, column)]);
        [right, -down, -forward, place[k]]
    };
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}
