//! Pictures of the maps of a sweep: slices, and views of the occupied cells.

use super::build::{Job, empty};
use super::plan::{Entry, Model};
use super::record::{PictureFile, PictureKind};
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_datasets::{encode_png, encode_png_rgb};
use monogrid_evaluation::TruthGrid;
use monogrid_image::Image;
use monogrid_mapping::{KeyframeScan, Mapper, MappingConfig};
use monogrid_occupancy::{MapError, Occupancy, OccupancyMap, VoxelKey, log_odds_from_probability};
use monogrid_report::picture::slice::{Window, slice};
use monogrid_report::picture::voxels::{Cube, View, render_coloured};

/// What is drawn of every map of a recording.
#[derive(Clone, Debug)]
pub struct PictureOrders {
    /// Box that is shown, metres.
    pub low: [f64; 3],
    /// See `low`.
    pub high: [f64; 3],
    /// Heights of the slices.
    pub heights: Vec<f64>,
    /// Cells above are left out of views, so that one looks into the room.
    pub cut_height: f64,
    /// Views are drawn of the maps of this resolution.
    pub view_resolution: f64,
}

/// About the longer side of a slice, px.
const SLICE_SIDE: usize = 480;
/// Heights of slices as shares of the height of the box.
const SLICE_SHARES: [f64; 3] = [0.25, 0.5, 0.75];
/// Share of the height of the box above which views are cut.
const CUT_SHARE: f64 = 0.8;
/// Octovis, which the thesis used, shows cells above this probability.
const VIEW_PROBABILITY: f64 = 0.7;
/// The models that views are drawn of: the thesis' three values of L (0.45 replaced by the nearest
/// of its table) and of k.
pub const VIEWED: [Model; 8] = [
    Model::None,
    Model::Thrun(0.05),
    Model::Thrun(0.5),
    Model::Thrun(1.0),
    Model::Andert(0.005),
    Model::Andert(0.05),
    Model::Andert(0.09),
    Model::Automatic,
];

/// Clamped after one measurement.
pub const AFTER_ONE: [u8; 3] = [205, 60, 45];
/// Clamped after several measurements.
pub const AFTER_SEVERAL: [u8; 3] = [50, 90, 175];
/// Above 0.7, not clamped.
pub const LIKELY: [u8; 3] = [150, 150, 150];

impl PictureOrders {
    /// Orders for a box.
    pub fn new(low: [f64; 3], high: [f64; 3], view_resolution: f64) -> Self {
        let at = |share: f64| low[2] + share * (high[2] - low[2]);
        Self {
            low,
            high,
            heights: SLICE_SHARES.map(at).to_vec(),
            cut_height: at(CUT_SHARE),
            view_resolution,
        }
    }

    fn window(&self, resolution: f64) -> Window {
        let index = |value: f64| (value / resolution).floor() as i32;
        Window::new(
            [index(self.low[0]), index(self.low[1])],
            [index(self.high[0]), index(self.high[1])],
            SLICE_SIDE,
        )
    }
}

/// A slice of the truth, drawn as those of the maps.
pub fn truth_slice(truth: &TruthGrid, orders: &PictureOrders, height: f64) -> Vec<u8> {
    let window = orders.window(truth.resolution());
    let z = (height / truth.resolution()).floor() as i32;
    encode_png(&window.picture(|[x, y]| match truth.state([x, y, z]) {
        Occupancy::Free => 255,
        Occupancy::Occupied => 0,
        Occupancy::Unknown => monogrid_report::picture::slice::UNKNOWN_GREY,
    }))
}

/// Draws what is ordered of one map and writes it beside its record.
pub fn draw(
    job: &Job,
    entry: &Entry,
    map: &OccupancyMap,
    mapper: &Mapper,
    scans: &[KeyframeScan],
) -> Result<Vec<PictureFile>, Failure> {
    let orders = job.orders;
    let mut files = Vec::new();
    let mut write = |file: String, kind: PictureKind, png: &[u8]| {
        job.out.write(&format!("{}/{file}", job.name), png)?;
        files.push(PictureFile { kind, file });
        Ok::<(), Failure>(())
    };
    let window = orders.window(entry.resolution);
    for (index, height) in orders.heights.iter().enumerate() {
        let z = (height / entry.resolution).floor() as i32;
        let png = encode_png(&slice(map, &window, z));
        let file = format!("slice-{}-{index}.png", entry.name());
        write(file, PictureKind::Slice(*height), &png)?;
    }
    let is_viewed = (entry.resolution / orders.view_resolution - 1.0).abs() < 1e-6;
    if is_viewed && VIEWED.contains(&entry.model) {
        let counts = match entry.model {
            // one update of the default settings never clamps
            Model::Automatic => None,
            _ => {
                let counted = count_hits(job, mapper, scans, map.config().memory_budget_bytes);
                Some(counted.while_running("the hits of a map cannot be counted")?)
            }
        };
        let picture = view(map, counts.as_ref(), orders);
        let file = format!("view-{}.png", entry.name());
        write(file, PictureKind::View, &encode_png_rgb(&picture))?;
    }
    Ok(files)
}

/// What one hit adds to the counting map, log-odds; as large as the evidence that ends a ray.
const HIT: f64 = 0.02;

/// A map in which every measurement that speaks for an obstacle adds [`HIT`] and no other counts.
fn count_hits(
    job: &Job,
    mapper: &Mapper,
    scans: &[KeyframeScan],
    budget: usize,
) -> Result<OccupancyMap, MapError> {
    let config = MappingConfig {
        // too little for a step of evidence
        update_limits: [-1e-9, HIT],
        updates_to_belief: [0, 0],
        tail_log_odds: HIT,
        clamp: [-7.9, 7.9],
        ..mapper.config().clone()
    };
    let counter = Mapper::new(config.clone(), 1);
    let mut counts = empty(&config, budget)?;
    for (scan, map_from_keyframe) in job.recorded.posed(scans) {
        counter.integrate(&mut counts, scan, &map_from_keyframe)?;
    }
    Ok(counts)
}

/// The likely cells of a map, coloured by how they became so.
fn view(
    map: &OccupancyMap,
    counts: Option<&OccupancyMap>,
    orders: &PictureOrders,
) -> Image<[u8; 3]> {
    let likely = log_odds_from_probability(VIEW_PROBABILITY) as f32;
    let resolution = map.resolution();
    let is_likely = |key: VoxelKey| map.log_odds_of(key).is_some_and(|l| l > likely);
    let clamp = map.config().clamp_max - 1e-3;
    let (mut cubes, mut colours) = (Vec::new(), Vec::new());
    let high = [orders.high[0], orders.high[1], orders.cut_height];
    for cell in map.cells_in_box(orders.low, high) {
        let center = cell.key.center(resolution);
        if cell.log_odds <= likely || center[2] > orders.cut_height {
            continue;
        }
        let is_at_cut = center[2] + resolution > orders.cut_height;
        if !is_at_cut && is_enclosed(cell.key, &is_likely) {
            continue;
        }
        let sum = counts.and_then(|counts| counts.log_odds_of(cell.key));
        let num_hits = sum.map(|sum| (f64::from(sum) / HIT).round());
        colours.push(match num_hits {
            _ if cell.log_odds < clamp => LIKELY,
            Some(hits) if hits <= 1.0 => AFTER_ONE,
            _ => AFTER_SEVERAL,
        });
        cubes.push(Cube {
            center,
            size: resolution,
        });
    }
    let view = View {
        width: 640,
        height: 480,
        frame: Some([orders.low, high]),
        ..View::default()
    };
    render_coloured(&cubes, &colours, &view)
}

/// Whether all six neighbours hide a cell.
fn is_enclosed(key: VoxelKey, is_likely: &impl Fn(VoxelKey) -> bool) -> bool {
    (0..3).all(|axis| {
        [-1, 1].into_iter().all(|step| {
            let mut neighbour = key.to_array();
            neighbour[axis] += step;
            is_likely(VoxelKey::from_array(neighbour))
        })
    })
}
