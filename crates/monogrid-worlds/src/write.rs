//! Writes a sequence as a data set in TUM layout, and meshes as PLY.

use super::imu::{ImuConfig, imu_samples};
use super::render::Renderer;
use super::sequence::{SynthConfig, SynthSequence};
use super::triangle_mesh::TriangleMesh;
use monogrid_datasets::{
    Calibration, DatasetError, TimedPose, encode_png, encode_png_16, format_seconds,
    write_atomically, write_atomically_with, write_imu, write_tum,
};
use monogrid_geometry::{Camera, Distortion, Pinhole};
use monogrid_image::GrayImage;
use rayon::prelude::*;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WriteConfig {
    /// A depth image with every n-th frame; 0 for none. Default 1.
    pub depth_every: usize,
    /// Whether the mesh of the world is written too. Default yes.
    pub with_mesh: bool,
    /// How far to the right of the first camera a second one is, m; 0 for none. Default 0.
    pub baseline_m: f64,
}

impl Default for WriteConfig {
    fn default() -> Self {
        Self {
            depth_every: 1,
            with_mesh: true,
            baseline_m: 0.0,
        }
    }
}

/// Writes `rgb/`, `depth/`, their lists, `groundtruth.txt`, both calibrations and `mesh.ply`. The
/// images of two cameras are in `image_0/` and `image_1/`, and KITTI's `calib.txt` says how far
/// these are apart; it does not hold for a lens.
///
/// `progress` is called after each frame with the number of frames done.
///
/// # Errors
/// When a file cannot be written.
pub fn write_tum_layout(
    sequence: &SynthSequence,
    folder: &Path,
    config: &WriteConfig,
    mut progress: impl FnMut(usize),
) -> Result<(), DatasetError> {
    let second = (config.baseline_m > 0.0).then(|| sequence.beside(config.baseline_m));
    let images = match &second {
        Some(_) => ["image_0", "image_1", "depth"].as_slice(),
        None => &["rgb", "depth"],
    };
    for sub in images {
        let path = folder.join(sub);
        std::fs::create_dir_all(&path).map_err(|e| DatasetError::io("create", &path, e))?;
    }
    let units_per_m = depth_units(sequence);
    let depth_camera = write_calibrations(sequence.config(), units_per_m, folder)?;
    let depth_renderer = Renderer::new(&depth_camera, 1.0);
    let coded = |k: usize| {
        let frame = sequence.frame(k)?;
        let image = encode_png(&frame.image.map(|v| v as u8));
        let has_depth = config.depth_every > 0 && k.is_multiple_of(config.depth_every);
        let depth = has_depth.then(|| sequence.depth_through(&depth_renderer, k));
        let depth = depth.flatten();
        let depth = depth.map(|depth| encode_png_16(&encode_depth(&depth, units_per_m)));
        let second = second.as_ref().and_then(|second| second.frame(k));
        let second = second.map(|frame| encode_png(&frame.image.map(|v| v as u8)));
        Some((frame, image, second, depth))
    };
    if config.with_mesh {
        write_ply(&folder.join("mesh.ply"), &sequence.world().mesh())?;
    }
    let mut colour_list = String::from("# timestamp filename\n");
    let mut depth_list = colour_list.clone();
    let mut poses = Vec::with_capacity(sequence.len());
    for first in (0..sequence.len()).step_by(CHUNK) {
        let last = (first + CHUNK).min(sequence.len());
        let frames: Vec<_> = (first..last).into_par_iter().filter_map(coded).collect();
        for (frame, image, second, depth) in frames {
            let time = format_seconds(frame.timestamp_ns);
            let name = format!("{}/{:06}.png", images[0], frame.index);
            write_atomically(&folder.join(&name), &image)?;
            // writing into a string cannot fail
            let _ = writeln!(colour_list, "{time} {name}");
            if let Some(second) = second {
                let name = format!("{}/{:06}.png", images[1], frame.index);
                write_atomically(&folder.join(&name), &second)?;
            }
            if let Some(depth) = depth {
                let name = format!("depth/{:06}.png", frame.index);
                write_atomically(&folder.join(&name), &depth)?;
                let _ = writeln!(depth_list, "{time} {name}");
            }
            poses.push(TimedPose {
                timestamp_ns: frame.timestamp_ns,
                world_from_camera: frame.world_from_camera,
            });
            progress(poses.len());
        }
    }
    if second.is_some() {
        let text = projections(&sequence.config().camera.pinhole, config.baseline_m);
        write_text(folder, "calib.txt", &text)?;
    }
    write_text(folder, "rgb.txt", &colour_list)?;
    write_text(folder, "depth.txt", &depth_list)?;
    write_tum(&folder.join("groundtruth.txt"), &poses)
}

/// Writes what an inertial sensor beside the camera measures as `mav0/imu0`, EuRoC's layout, with
/// the camera as the body.
///
/// # Errors
/// When a file cannot be written.
pub fn write_sequence_imu(
    sequence: &SynthSequence,
    folder: &Path,
    config: &ImuConfig,
) -> Result<usize, DatasetError> {
    let folder = folder.join("mav0/imu0");
    std::fs::create_dir_all(&folder).map_err(|e| DatasetError::io("create", &folder, e))?;
    let last = sequence.timestamp_ns(sequence.len().wrapping_sub(1));
    let until_secs = last.unwrap_or(0) as f64 * 1e-9 + AFTER_LAST_SECS;
    let samples = imu_samples(sequence.path(), config, sequence.config().seed, until_secs);
    let (noise, pose) = (&config.noise, &config.camera_from_imu);
    write_imu(&folder, &samples, noise, pose, config.rate_hz)?;
    Ok(samples.len())
}

/// Readings go on after the last image.
const AFTER_LAST_SECS: f64 = 0.05;

/// Frames that are rendered and compressed side by side.
const CHUNK: usize = 8;

fn write_text(folder: &Path, name: &str, text: &str) -> Result<(), DatasetError> {
    write_atomically(&folder.join(name), text.as_bytes())
}

/// KITTI's projection matrices of two cameras in a row.
fn projections(pinhole: &Pinhole, baseline_m: f64) -> String {
    let Pinhole { fx, fy, cx, cy } = pinhole;
    let row = |camera: usize, offset: f64| {
        format!("P{camera}: {fx} 0 {cx} {offset} 0 {fy} {cy} 0 0 0 1 0\n")
    };
    row(0, 0.0) + &row(1, -fx * baseline_m)
}

/// Finest of the usual units (5000, 2000, 1000, ... per metre) in which the longest line of sight
/// in the world fits into 16 bits.
fn depth_units(sequence: &SynthSequence) -> u32 {
    let size = sequence.world().bounds().size();
    let longest_m = size.iter().map(|s| s * s).sum::<f32>().sqrt();
    [5000, 2000, 1000, 500, 200, 100]
        .into_iter()
        .find(|&units| longest_m * units as f32 <= 65_000.0)
        .unwrap_or(50)
}

/// 16-bit depth, 0 where there is none.
fn encode_depth(depth: &GrayImage, units_per_m: u32) -> monogrid_image::Image<u16> {
    depth.map(|z| match (z * units_per_m as f32).round() {
        units @ 1.0..=65_535.0 => units as u16,
        _ => 0,
    })
}

/// One line as the readers understand it; `None` for a lens that this form cannot describe.
fn calibration_line(camera: &Camera) -> Option<String> {
    let p = &camera.pinhole;
    let distortion = match camera.distortion {
        Distortion::None => String::new(),
        Distortion::RadialTangential { k1, k2, p1, p2, k3 } => format!("{k1} {k2} {p1} {p2} {k3} "),
        Distortion::Fov { omega } => format!("{omega} "),
        _ => return None,
    };
    Some(format!(
        "{} {} {} {} {distortion}{} {}\n",
        p.fx, p.fy, p.cx, p.cy, camera.width, camera.height
    ))
}

/// Writes both calibrations and returns the camera of the depth images: the same one, or its
/// pinhole without the lens where the file for depth cannot describe the lens.
fn write_calibrations(
    config: &SynthConfig,
    units_per_m: u32,
    folder: &Path,
) -> Result<Camera, DatasetError> {
    let camera = &config.camera;
    let readout_ms = Some(config.effects.readout_secs * 1e3).filter(|ms| *ms > 0.0);
    let depth_camera = match calibration_line(camera) {
        Some(line) => {
            let shutter = readout_ms.map(|ms| format!("rolling_shutter_ms {ms}\n"));
            let text = line + &shutter.unwrap_or_default();
            write_text(folder, "calibration.txt", &text)?;
            *camera
        }
        None => {
            let text = Calibration::to_toml(camera, readout_ms);
            write_text(folder, "calibration.toml", &text)?;
            Camera {
                distortion: Distortion::None,
                ..*camera
            }
        }
    };
    let line = calibration_line(&depth_camera).unwrap_or_default();
    let text = format!("{line}{units_per_m}\n");
    write_text(folder, "calibration_depth.txt", &text)?;
    Ok(depth_camera)
}

/// Writes a mesh as binary PLY with grey vertex colours.
///
/// # Errors
/// When the file cannot be written.
pub fn write_ply(path: &Path, mesh: &TriangleMesh) -> Result<(), DatasetError> {
    let has_albedo = mesh.albedo.len() == mesh.vertices.len();
    write_atomically_with(path, |file| {
        let colours = match has_albedo {
            true => "property uchar red\nproperty uchar green\nproperty uchar blue\n",
            false => "",
        };
        let header = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\n\
             property float y\nproperty float z\n{colours}element face {}\n\
             property list uchar int vertex_indices\nend_header\n",
            mesh.vertices.len(),
            mesh.triangles.len()
        );
        let mut bytes = header.into_bytes();
        for (k, vertex) in mesh.vertices.iter().enumerate() {
            bytes.extend(vertex.iter().flat_map(|v| v.to_le_bytes()));
            if has_albedo {
                // as displayed: gamma 2.2, undone by the reader
                let shown = mesh.albedo[k].clamp(0.0, 1.0).powf(1.0 / 2.2);
                bytes.extend([(255.0 * shown).round() as u8; 3]);
            }
        }
        for triangle in &mesh.triangles {
            bytes.push(3);
            bytes.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
        }
        file.write_all(&bytes)
    })
}
