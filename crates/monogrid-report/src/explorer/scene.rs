//! What there is to explore.

use super::{Cells, Cloud, PageMesh};
use crate::picture::base64;
use crate::picture::plan::Plan;
use monogrid_datasets::encode_png_rgb;
use monogrid_geometry::{Pinhole, Sim3};
use serde::Serialize;

/// Everything that a page can show of a map or a run; what is not there is left out. Lengths are in
/// `unit`, z is up.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Scene {
    /// Name of the unit of length.
    pub unit: String,
    /// Cells of the map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cells: Option<Cells>,
    /// Measured points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cloud: Option<Cloud>,
    /// Surface of the map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh: Option<PageMesh>,
    /// The map from above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plan: Option<PagePlan>,
    /// Camera of the keyframes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<Camera>,
    /// Keyframes of the main map.
    pub keyframes: Vec<Keyframe>,
    /// Pairs of positions in `keyframes` that the graph holds together although they do not follow
    /// each other.
    pub links: Vec<[usize; 2]>,
    /// Where the camera was, in the order of time.
    pub path: Vec<PathPoint>,
    /// Where it was by the reference.
    pub reference: Vec<[f64; 3]>,
    /// What became of each frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<Frames>,
    /// Height above which cells hide the room.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cut: Option<f64>,
}

/// The map from above, as `plan.png` shows it.
#[derive(Clone, Debug, Serialize)]
pub struct PagePlan {
    /// Lower left corner.
    pub low: [f64; 2],
    /// Width and height.
    pub size: [f64; 2],
    /// Lowest and highest z of the cells.
    pub band: [f64; 2],
    /// Obstacles, free space and the unknown in three tones, PNG in base64.
    pub image: String,
}

impl PagePlan {
    /// The plan of the cells between two heights.
    pub fn new(plan: &Plan, band: [f64; 2]) -> Self {
        let cells = plan.cells();
        let sides = [cells.picture.width(), cells.picture.height()];
        Self {
            low: cells.low,
            size: sides.map(|pixels| pixels as f64 * cells.edge),
            band,
            image: base64(&encode_png_rgb(&cells.picture)),
        }
    }
}

/// A camera without distortion.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Camera {
    /// Focal lengths and principal point `[fx, fy, cx, cy]`, px.
    pub intrinsics: [f64; 4],
    /// Width and height, px.
    pub size: [usize; 2],
}

impl Camera {
    /// The camera of images of this size.
    pub fn new(pinhole: &Pinhole, size: [usize; 2]) -> Self {
        Self {
            intrinsics: [pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy],
            size,
        }
    }
}

/// A keyframe.
#[derive(Clone, Debug, Serialize)]
pub struct Keyframe {
    /// Identity.
    pub id: u32,
    /// Index of its frame in the source.
    pub frame: u64,
    /// Time, seconds since the first frame.
    pub time: f64,
    /// `map_from_camera` without its scale: three rows of four numbers.
    pub pose: [f64; 12],
    /// First of its points in the cloud, and their number.
    pub points: [usize; 2],
    /// Its image, JPEG in base64.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image: Option<String>,
}

impl Keyframe {
    /// The numbers of a pose as [`Keyframe::pose`] has them.
    pub fn rows(map_from_keyframe: &Sim3) -> [f64; 12] {
        let rotation = map_from_keyframe.to_se3().rotation_matrix();
        let centre = map_from_keyframe.translation;
        std::array::from_fn(|i| {
            let (row, column) = (i / 4, i % 4);
            let value = if column == 3 {
                centre[row]
            } else {
                rotation[(row, column)]
            };
            // six digits are more than a screen shows
            (value * 1e6).round() / 1e6
        })
    }
}

/// Centre of the camera in a frame: index of the frame, x, y, z.
pub type PathPoint = (usize, f32, f32, f32);

/// What became of each frame, as columns.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Frames {
    /// Names and colours of states.
    pub legend: Vec<(&'static str, &'static str)>,
    /// Index in the source.
    pub index: Vec<usize>,
    /// Seconds since the first frame.
    pub time: Vec<f64>,
    /// Position in `legend`.
    pub state: Vec<usize>,
    /// Why the pose is not good, by index of the frame, where that changes; an empty text where it
    /// is good.
    pub reasons: Vec<(usize, String)>,
    /// Share of pixels that agree, per cent; -1 where unknown.
    pub good: Vec<i16>,
    /// Time of computation, milliseconds; -1 where unknown.
    pub milliseconds: Vec<f32>,
    /// Keyframe on which it was tracked; -1 for none.
    pub keyframe: Vec<i64>,
    /// Distance from the reference, units of length; -1 where unknown. Empty without a reference.
    pub error: Vec<f32>,
}

/// Seconds from one time to another, to the millisecond.
pub fn seconds_since(begin_ns: i64, timestamp_ns: i64) -> f64 {
    let milliseconds = timestamp_ns.saturating_sub(begin_ns) as f64 * 1e-6;
    milliseconds.round() / 1e3
}
