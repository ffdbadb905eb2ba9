//! Two small recordings that can be joined with anything, which says whether something else can be.

use monogrid_datasets::{
    DatasetError, DepthPixel, KeyframeRecord, PoseSnapshot, RecordingWriter, Scale, SessionInfo,
};
use monogrid_geometry::{Pinhole, Rotation, Sim3, Vec3};
use monogrid_image::Image;
use std::path::{Path, PathBuf};

/// Width and height of the images, px.
const SIZE: (usize, usize) = (160, 120);
/// Keyframes of each.
const KEYFRAMES: u32 = 3;

/// Writes them into a folder, which is made anew; the files.
pub fn write(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let at = |error| DatasetError::io("make", folder, error);
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(at(error)),
        _ => std::fs::create_dir_all(folder).map_err(at)?,
    }
    let file = |number: u32| -> Result<PathBuf, DatasetError> {
        let path = folder.join(format!("companion_{number}.mgk"));
        recording(&path, number)?;
        Ok(path)
    };
    [1, 2].map(file).into_iter().collect()
}

/// A camera that moves sideways before a wall, all of another texture.
fn recording(path: &Path, number: u32) -> Result<(), DatasetError> {
    let (width, height) = SIZE;
    let session = SessionInfo {
        pinhole: Pinhole::new(120.0, 120.0, 79.5, 59.5),
        width,
        height,
        scale: Scale::Arbitrary,
        seed: 1,
        profile: String::new(),
        source: format!("companion_{number}"),
        config: String::new(),
    };
    let mut writer = RecordingWriter::create(path, &session)?;
    let noise = |x: u32, y: u32| {
        let mixed = (x / 4 + 4099 * (y / 4) + 1_000_003 * number).wrapping_mul(2_654_435_761);
        (mixed >> 24) as u8
    };
    for id in 0..KEYFRAMES {
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let places = places.filter(|(x, y)| x % 4 == 0 && y % 4 == 0);
        let pixels = places.map(|(x, y)| DepthPixel {
            x: x as u16,
            y: y as u16,
            idepth: 0.5,
            idepth_var: 1e-4,
        });
        writer.append_keyframe(KeyframeRecord {
            id,
            frame_index: u64::from(id),
            timestamp_ns: i64::from(id) * 1_000_000_000,
            camera: None,
            image: Some(Image::from_fn(width, height, |x, y| {
                noise(x as u32 + 6 * id, y as u32)
            })),
            pixels: pixels.collect(),
        })?;
    }
    let pose = |id: u32| {
        let at = Vec3::new(0.1 * f64::from(id), 0.0, 0.0);
        (id, Sim3::new(1.0, Rotation::identity(), at))
    };
    writer.append_poses(PoseSnapshot {
        revision: 1,
        poses: (0..KEYFRAMES).map(pose).collect(),
    })
}
