//! What the page of a run answers: `/live/VERSION/PATH/CELLS`, see `docs/formats.md`.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Deserialize;

/// What has changed.
#[derive(Debug, Deserialize)]
pub struct News {
    /// What to ask from next.
    pub version: u64,
    /// Whether nothing more comes.
    #[serde(default)]
    pub ended: bool,
    /// Frames per second since the start.
    pub rate: f64,
    pub camera: Camera,
    pub frame: Option<Frame>,
    /// Frame, x, y, z of the camera, from the position that was asked for.
    pub path: Vec<(usize, f32, f32, f32)>,
    pub keyframes: Vec<Keyframe>,
    /// Identity, unit, and the rows of the pose, of all keyframes; nothing if none has changed.
    pub poses: Vec<(u32, f64, Pose)>,
    pub cells: Option<Cells>,
}

/// The rows of rotation and translation.
pub type Pose = [f64; 12];

#[derive(Debug, Deserialize)]
pub struct Camera {
    /// Focal lengths and principal point, px.
    pub intrinsics: [f32; 4],
    /// Width and height, px.
    pub size: [f32; 2],
}

#[derive(Debug, Deserialize)]
pub struct Frame {
    pub index: i64,
    pub state: String,
    pub reason: Option<String>,
    pub pose: Option<Pose>,
    /// JPEG in base64.
    pub image: Option<String>,
}

/// A keyframe whose depth is new.
#[derive(Debug, Deserialize)]
pub struct Keyframe {
    pub id: u32,
    /// JPEG in base64.
    pub image: String,
    pub cloud: Cloud,
}

/// Points as steps from a corner.
#[derive(Debug, Deserialize)]
pub struct Cloud {
    low: [f32; 3],
    step: f32,
    points: String,
}

/// Cubes of cells.
#[derive(Debug, Deserialize)]
pub struct Cells {
    edge: f32,
    first: [i32; 3],
    occupied: String,
}

/// The bytes of a block; nothing of one that is damaged.
pub fn bytes(block: &str) -> Vec<u8> {
    STANDARD.decode(block).unwrap_or_default()
}

/// Three numbers of 16 bits and two bytes each.
fn records(block: &str) -> Vec<([u16; 3], [u8; 2])> {
    let bytes = bytes(block);
    let (records, _) = bytes.as_chunks::<8>();
    let place = |r: &[u8; 8]| [0, 2, 4].map(|k| u16::from_le_bytes([r[k], r[k + 1]]));
    records.iter().map(|r| (place(r), [r[6], r[7]])).collect()
}

impl Cloud {
    /// Points in the frame and unit of the keyframe, with their grey levels.
    pub fn points(&self) -> Vec<([f32; 3], u8)> {
        let point = |(steps, [grey, _]): ([u16; 3], [u8; 2])| {
            let point =
                std::array::from_fn(|axis| self.low[axis] + self.step * f32::from(steps[axis]));
            (point, grey)
        };
        records(&self.points).into_iter().map(point).collect()
    }
}

impl Cells {
    /// Middle and half the edge of each occupied cube.
    pub fn cubes(&self) -> Vec<([f32; 3], f32)> {
        let cube = |(cell, [_, level]): ([u16; 3], [u8; 2])| {
            let half = 0.5 * self.edge * 2f32.powi(level.min(16).into());
            let middle = |axis: usize| {
                let first = i64::from(self.first[axis]) + i64::from(cell[axis]);
                self.edge * first as f32 + half
            };
            (std::array::from_fn(middle), half)
        };
        records(&self.occupied).into_iter().map(cube).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(record: [u8; 8]) -> String {
        STANDARD.encode(record)
    }

    #[test]
    fn points_and_cubes_lie_where_the_page_has_them() {
        let cloud = Cloud {
            low: [-1.0, 0.0, 2.0],
            step: 0.5,
            points: block([1, 0, 2, 0, 0, 1, 77, 255]),
        };
        assert_eq!(cloud.points(), vec![([-0.5, 1.0, 130.0], 77)]);
        let cells = Cells {
            edge: 0.1,
            first: [-2, 0, 10],
            occupied: block([0, 0, 2, 0, 0, 0, 200, 1]),
        };
        let cubes = cells.cubes();
        assert_eq!(cubes.len(), 1);
        let (middle, half) = cubes[0];
        assert!((half - 0.1).abs() < 1e-6, "two cells long");
        for (found, expected) in middle.iter().zip([-0.1, 0.3, 1.1]) {
            assert!((found - expected).abs() < 1e-6, "{middle:?}");
        }
        // half a record, and what is no base64
        let cut = Cloud {
            points: STANDARD.encode([1u8; 5]),
            ..cloud
        };
        assert!(cut.points().is_empty());
        assert!(bytes("?").is_empty());
    }
}
