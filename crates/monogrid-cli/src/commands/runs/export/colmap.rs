//! COLMAP's model of a scene: cameras, images and points, as text and as its binary form.
//!
//! <https://colmap.github.io/format.html>. Identities begin at one, the centre of the top-left
//! pixel is (0.5, 0.5), and poses take points of the world to the camera.

use super::reconstruction::{Reconstruction, View};
use monogrid_app::output::OutputFolder;
use monogrid_app::process::failure::Failure;
use monogrid_datasets::RecordedCamera;
use std::fmt::Write;

/// Where readers look for the model.
const FOLDER: &str = "sparse/0";
/// COLMAP's number of the camera without distortion and with two focal lengths.
const PINHOLE: u32 = 1;
/// The centre of the top-left pixel.
const HALF_PIXEL: f64 = 0.5;

/// Writes the model in both forms; readers prefer the binary one, people read the text.
pub fn write(folder: &OutputFolder, scene: &Reconstruction) -> Result<(), Failure> {
    let files: [(&str, Vec<u8>); 6] = [
        ("cameras.txt", cameras_text(scene).into_bytes()),
        ("images.txt", images_text(scene).into_bytes()),
        ("points3D.txt", points_text(scene).into_bytes()),
        ("cameras.bin", cameras_binary(scene)),
        ("images.bin", images_binary(scene)),
        ("points3D.bin", points_binary(scene)),
    ];
    for (name, content) in files {
        folder.write(&format!("{FOLDER}/{name}"), content)?;
    }
    Ok(())
}

/// Focal lengths and principal point.
fn parameters(camera: &RecordedCamera) -> [f64; 4] {
    let pinhole = camera.pinhole;
    let (cx, cy) = (pinhole.cx + HALF_PIXEL, pinhole.cy + HALF_PIXEL);
    [pinhole.fx, pinhole.fy, cx, cy]
}

/// Quaternion (w, x, y, z) and translation.
fn pose(view: &View) -> [f64; 7] {
    let [x, y, z, w] = view.camera_from_map.rotation.coords.into();
    let [tx, ty, tz] = view.camera_from_map.translation.into();
    [w, x, y, z, tx, ty, tz]
}

fn joined(numbers: &[f64]) -> String {
    let numbers: Vec<String> = numbers.iter().map(f64::to_string).collect();
    numbers.join(" ")
}

fn cameras_text(scene: &Reconstruction) -> String {
    let mut text = "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n".to_owned();
    for (index, camera) in scene.cameras.iter().enumerate() {
        let (width, height) = (camera.width, camera.height);
        let parameters = joined(&parameters(camera));
        _ = writeln!(text, "{} PINHOLE {width} {height} {parameters}", index + 1);
    }
    text
}

fn images_text(scene: &Reconstruction) -> String {
    let mut text = "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n\
                    # POINTS2D[] as X Y POINT3D_ID\n"
        .to_owned();
    for (index, view) in scene.views.iter().enumerate() {
        let (pose, camera) = (joined(&pose(view)), view.camera + 1);
        _ = writeln!(text, "{} {pose} {camera} {}", index + 1, view.name);
        let features = view.features.iter().map(|(at, point)| {
            let (x, y) = (at.x + HALF_PIXEL, at.y + HALF_PIXEL);
            format!("{x} {y} {}", point + 1)
        });
        text += &features.collect::<Vec<String>>().join(" ");
        text.push('\n');
    }
    text
}

fn points_text(scene: &Reconstruction) -> String {
    let mut text = "# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX\n".to_owned();
    for (index, point) in scene.points.iter().enumerate() {
        let [red, green, blue] = point.colour;
        let place = joined(point.place.as_slice());
        _ = write!(
            text,
            "{} {place} {red} {green} {blue} {}",
            index + 1,
            point.error
        );
        for (view, feature) in &point.track {
            _ = write!(text, " {} {feature}", view + 1);
        }
        text.push('\n');
    }
    text
}

/// Little-endian numbers one after the other.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn count(&mut self, value: usize) {
        self.0.extend((value as u64).to_le_bytes());
    }

    fn id(&mut self, index: usize) {
        self.0.extend((index as u32 + 1).to_le_bytes());
    }

    fn numbers(&mut self, values: &[f64]) {
        self.0
            .extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
}

fn cameras_binary(scene: &Reconstruction) -> Vec<u8> {
    let mut bytes = Bytes::default();
    bytes.count(scene.cameras.len());
    for (index, camera) in scene.cameras.iter().enumerate() {
        bytes.id(index);
        bytes.0.extend(PINHOLE.to_le_bytes());
        bytes.count(camera.width);
        bytes.count(camera.height);
        bytes.numbers(&parameters(camera));
    }
    bytes.0
}

fn images_binary(scene: &Reconstruction) -> Vec<u8> {
    let mut bytes = Bytes::default();
    bytes.count(scene.views.len());
    for (index, view) in scene.views.iter().enumerate() {
        bytes.id(index);
        bytes.numbers(&pose(view));
        bytes.id(view.camera);
        bytes.0.extend(view.name.bytes().chain([0]));
        bytes.count(view.features.len());
        for (at, point) in &view.features {
            bytes.numbers(&[at.x + HALF_PIXEL, at.y + HALF_PIXEL]);
            bytes.count(point + 1);
        }
    }
    bytes.0
}

fn points_binary(scene: &Reconstruction) -> Vec<u8> {
    let mut bytes = Bytes::default();
    bytes.count(scene.points.len());
    for (index, point) in scene.points.iter().enumerate() {
        bytes.count(index + 1);
        bytes.numbers(point.place.as_slice());
        bytes.0.extend(point.colour);
        bytes.numbers(&[point.error]);
        bytes.count(point.track.len());
        for (view, feature) in &point.track {
            bytes.id(*view);
            bytes.0.extend((*feature as u32).to_le_bytes());
        }
    }
    bytes.0
}
