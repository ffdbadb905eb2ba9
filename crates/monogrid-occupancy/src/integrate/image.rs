//! Measurements of a scan as range images: what the rule `fused` looks cells up in.
//!
//! A scan that looks one way becomes one pinhole image, any other the six faces of a cube. Pixels
//! are as fine as the measurements are dense, but no finer than half a typical cell.

use std::ops::ControlFlow;

use super::IntegrationConfig;
use super::beam::total_sigma;
use super::depth_image::range_image;
use super::parallel::for_each;
use super::windows::{higher, lower};
use crate::error::MapError;
use crate::scan::{PointScan, Scan, ScanData};
use crate::sensor::table::{KnownTables, TableSet};

/// Pixels along the edge of a cell's footprint at the mean range.
pub(super) const PIXELS_PER_CELL: f64 = 2.5;
/// Measurements per pixel of a point cloud, on average: with one, a third of the pixels of randomly
/// spread measurements are empty, and gaps are left that nothing can close.
const POINTS_PER_PIXEL: f64 = 1.4;
/// Ranges that differ by less than this share of themselves are of one surface. A tenth would join
/// furniture with the wall behind it at a range where nothing is.
const ONE_SURFACE: f32 = 0.05;
/// A scan whose directions all lie within this slope of the forward axis is one image.
pub(super) const WIDEST_SLOPE: f32 = 2.5;
/// Slope of a cube's faces, with a margin for footprints that cross an edge.
const CUBE_SLOPE: f32 = 1.02;
/// Slopes that an image spans at least, along each of its axes.
pub(crate) const NARROWEST_SLOPES: f64 = 1e-3;
/// Most pixels of one image.
const MAX_PIXELS: f64 = 4e6;

/// Range marking a pixel without a measurement.
pub(crate) const HOLE: f32 = 0.0;

/// What is known in one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pixel {
    /// Range in map units, or [`HOLE`]; while the image is being filled, the sum of those that voted for it.
    pub range: f32,
    /// Evidence table of the measurement.
    pub table: u16,
    /// Votes for this range.
    votes: u16,
}

const EMPTY_PIXEL: Pixel = Pixel {
    range: HOLE,
    table: 0,
    votes: 0,
};

/// One pinhole image of ranges.
#[derive(Clone, Debug)]
pub(crate) struct RangeImage {
    /// Rows: the axes of the image (right, down, forward) in world coordinates.
    pub axes: [[f64; 3]; 3],
    pub width: usize,
    pub height: usize,
    /// Pixels per unit of slope, along u and v.
    pub focal: [f32; 2],
    /// Pixel of slope 0.
    pub center: [f32; 2],
    pub pixels: Vec<Pixel>,
    /// Measurements per filled pixel, at least 1.
    pub density: f32,
}

/// A measurement in an image: slopes, and range with its uncertainty in map units.
#[derive(Clone, Copy)]
struct Sample {
    u: f32,
    v: f32,
    range: f32,
    sigma: f32,
}

/// Measurements of one image, in their order: slopes, ranges and uncertainties.
struct Samples {
    u: Vec<f32>,
    v: Vec<f32>,
    ranges: Vec<f32>,
    sigmas: Vec<f32>,
    /// Least and greatest slopes.
    low: [f32; 2],
    high: [f32; 2],
    /// Sums of the ranges of the parts, and of those that belong to no part yet.
    part_sums: Vec<f64>,
    range_sum: f64,
}

impl Samples {
    fn with_capacity(count: usize) -> Self {
        Self {
            u: Vec::with_capacity(count),
            v: Vec::with_capacity(count),
            ranges: Vec::with_capacity(count),
            sigmas: Vec::with_capacity(count),
            low: [f32::MAX; 2],
            high: [f32::MIN; 2],
            part_sums: Vec::new(),
            range_sum: 0.0,
        }
    }

    fn end_part(&mut self) {
        self.part_sums.push(std::mem::take(&mut self.range_sum));
    }

    fn len(&self) -> usize {
        self.ranges.len()
    }

    #[inline]
    fn push(&mut self, sample: Sample) {
        let Sample { u, v, range, sigma } = sample;
        self.widen([u, v], [u, v]);
        self.range_sum += f64::from(range);
        self.u.push(u);
        self.v.push(v);
        self.ranges.push(range);
        self.sigmas.push(sigma);
    }

    /// Slopes are finite.
    #[inline]
    fn widen(&mut self, low: [f32; 2], high: [f32; 2]) {
        for axis in 0..2 {
            self.low[axis] = lower(low[axis], self.low[axis]);
            self.high[axis] = higher(high[axis], self.high[axis]);
        }
    }

    /// Adds points that are all usable, ahead and of one uncertainty, side by side; `false`, and nothing done, for others.
    fn push_chunk(&mut self, scan: &Scan, model: &mut RangeModel) -> bool {
        let ScanData::Points(PointScan { points, sigmas }) = scan.data else {
            return false;
        };
        let Ok(points) = <&[[f32; 3]; CHUNK]>::try_from(points) else {
            return false;
        };
        let sigma = sigmas[0];
        let is_one = sigmas.iter().fold(true, |all, &s| all & (s == sigma));
        let Some(chunk) = Chunk::new(points, scan.world_from_sensor.scale as f32) else {
            return false;
        };
        if scan.pose_sigma.rotation_rad != 0.0 || !(is_one && sigma > 0.0 && sigma < 1e9) {
            return false;
        }
        let (_, sigma) = model.range_and_sigma(1.0, f64::from(sigma));
        let bound = |of: &[f32; CHUNK], end: fn(f32, f32) -> f32| {
            let ends = of.chunks_exact(LANES).fold([of[0]; LANES], |ends, lanes| {
                std::array::from_fn(|l| end(lanes[l], ends[l]))
            });
            ends.into_iter().fold(of[0], end)
        };
        let bounds = |end| [bound(&chunk.u, end), bound(&chunk.v, end)];
        self.widen(bounds(lower), bounds(higher));
        self.range_sum += f64::from(chunk.ranges.iter().sum::<f32>());
        self.u.extend_from_slice(&chunk.u);
        self.v.extend_from_slice(&chunk.v);
        self.ranges.extend_from_slice(&chunk.ranges);
        self.sigmas.extend_from_slice(&[sigma; CHUNK]);
        true
    }
}

/// Points that are converted side by side.
const CHUNK: usize = 64;
/// Values that are compared side by side.
const LANES: usize = 8;

/// Slopes and ranges of points.
struct Chunk {
    u: [f32; CHUNK],
    v: [f32; CHUNK],
    ranges: [f32; CHUNK],
}

impl Chunk {
    /// `None` if one of the points is not usable or not ahead.
    fn new(points: &[[f32; 3]; CHUNK], scale: f32) -> Option<Self> {
        let [mut u, mut v, mut ranges] = [[0.0; CHUNK]; 3];
        for (i, [x, y, z]) in points.iter().enumerate() {
            let inverse = 1.0 / z;
            (u[i], v[i]) = (x * inverse, y * inverse);
            ranges[i] = (x * x + y * y + z * z).sqrt();
        }
        // Written so that NaN fails; a range is finite only if all of its point is.
        let is_ahead = (0..CHUNK).fold(true, |all, i| {
            let slopes = (u[i].abs() < WIDEST_SLOPE) & (v[i].abs() < WIDEST_SLOPE);
            all & slopes & (points[i][2] > 0.0) & (ranges[i] > 1e-9) & (ranges[i] < 1e9)
        });
        ranges.iter_mut().for_each(|range| *range *= scale);
        is_ahead.then_some(Self { u, v, ranges })
    }
}

/// A scan prepared for the rule `fused`.
#[derive(Clone, Debug)]
pub(crate) struct RangeImages {
    /// Place of the sensor in map units.
    pub origin: [f64; 3],
    pub images: Vec<RangeImage>,
    pub tables: TableSet,
    pub points: usize,
    /// How often a sample for an obstacle counts in addition.
    pub obstacle_weight: i32,
}

impl RangeImages {
    /// Prepares a scan for a map with cells of edge `resolution`.
    pub(crate) fn new(
        scan: &Scan,
        config: &IntegrationConfig,
        resolution: f64,
        threads: usize,
        known_tables: &KnownTables,
    ) -> Result<Self, MapError> {
        let mut tables = known_tables.set(config, resolution)?;
        let rotation = scan.world_from_sensor.rotation;
        // Columns of world_from_sensor are the sensor's axes in the world.
        let in_world = |axes: [[f64; 3]; 3]| {
            axes.map(|axis| std::array::from_fn(|i| (0..3).map(|j| rotation[i][j] * axis[j]).sum()))
        };
        let (images, points) =
            if let Some(found) = range_image(scan, in_world(FORWARD), resolution, &mut tables) {
                found
            } else {
                let (faces, points) = match collect_forward(scan, config, resolution, threads) {
                    Some(pieces) => {
                        let points = pieces.iter().map(Samples::len).sum();
                        (vec![(FORWARD, pieces)], points)
                    }
                    None => collect_cube(scan, config, resolution),
                };
                let images = faces
                    .into_iter()
                    .filter(|(_, pieces)| pieces.iter().any(|samples| samples.len() > 0))
                    .map(|(axes, pieces)| {
                        build_image(
                            in_world(axes),
                            &pieces,
                            scan.focal(),
                            resolution,
                            &mut tables,
                        )
                    })
                    .collect();
                (images, points)
            };
        Ok(Self {
            origin: scan.world_from_sensor.translation,
            images,
            tables,
            points,
            obstacle_weight: i32::from(config.obstacle_weight),
        })
    }
}

/// Axes (right, down, forward) of the image of a forward-looking sensor.
const FORWARD: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Axes of the six faces of a cube around the sensor.
const CUBE: [[[f64; 3]; 3]; 6] = [
    [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
    [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
    FORWARD,
    [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
];

/// Scale and pose uncertainty applied to one measurement.
pub(super) struct RangeModel<'a> {
    scan: &'a Scan<'a>,
    resolution: f64,
    /// The last uncertainty of a range, and with that of the pose: most sensors state one for all.
    last: (f64, f64),
}

impl<'a> RangeModel<'a> {
    pub(super) fn new(scan: &'a Scan<'a>, resolution: f64) -> Self {
        Self {
            scan,
            resolution,
            last: (f64::NAN, f64::NAN),
        }
    }

    #[inline]
    pub(super) fn range_and_sigma(&mut self, range: f64, sigma: f64) -> (f32, f32) {
        let scale = self.scan.world_from_sensor.scale;
        let range = range * scale;
        if sigma != self.last.0 || self.scan.pose_sigma.rotation_rad != 0.0 {
            let total = total_sigma(sigma * scale, range, self.scan, self.resolution);
            self.last = (sigma, total);
        }
        (range as f32, self.last.1 as f32)
    }
}

/// Measurements whose ranges are summed together: the same for any number of threads, as sums are
/// rounded.
const PART: usize = 8192;

/// The samples of a sensor that looks forward, a piece per thread; `None` if some direction is too
/// far off.
fn collect_forward(
    scan: &Scan,
    config: &IntegrationConfig,
    resolution: f64,
    threads: usize,
) -> Option<Vec<Samples>> {
    let parts = scan.len().div_ceil(PART);
    let count = PART * parts.div_ceil(threads).max(1);
    let mut pieces: Vec<(Scan, Option<Samples>)> = (0..scan.len())
        .step_by(count)
        .map(|first| Some((scan.part(first..(first + count).min(scan.len()))?, None)))
        .collect::<Option<_>>()?;
    for_each(&mut pieces, threads, |_, (piece, samples)| {
        *samples = collect_piece(piece, config, resolution);
    });
    pieces.into_iter().map(|(_, samples)| samples).collect()
}

fn collect_piece(scan: &Scan, config: &IntegrationConfig, resolution: f64) -> Option<Samples> {
    let mut model = RangeModel::new(scan, resolution);
    let mut samples = Samples::with_capacity(scan.len());
    for first in (0..scan.len()).step_by(CHUNK) {
        if first > 0 && first.is_multiple_of(PART) {
            samples.end_part();
        }
        let chunk = scan.part(first..(first + CHUNK).min(scan.len()))?;
        if samples.push_chunk(&chunk, &mut model) {
            continue;
        }
        let end = chunk.each_measurement(config.sigma_mode, |measured| {
            let [x, y, z] = measured.point;
            let inverse = 1.0 / z;
            let (u, v) = ((x * inverse) as f32, (y * inverse) as f32);
            if !(z > 0.0 && u.abs() < WIDEST_SLOPE && v.abs() < WIDEST_SLOPE) {
                return ControlFlow::Break(());
            }
            let (range, sigma) = model.range_and_sigma(measured.range, measured.sigma);
            samples.push(Sample { u, v, range, sigma });
            ControlFlow::Continue(())
        });
        if end.is_break() {
            return None;
        }
    }
    samples.end_part();
    Some(samples)
}

/// The samples of the six faces of a cube; those near an edge belong to both faces.
#[allow(
    clippy::type_complexity,
    reason = "faces with their samples, used once"
)]
fn collect_cube(
    scan: &Scan,
    config: &IntegrationConfig,
    resolution: f64,
) -> (Vec<([[f64; 3]; 3], Vec<Samples>)>, usize) {
    let mut model = RangeModel::new(scan, resolution);
    let mut faces: Vec<_> = CUBE
        .iter()
        .map(|axes| (*axes, vec![Samples::with_capacity(0)]))
        .collect();
    let mut points = 0;
    for index in 0..scan.len() {
        let Some(measured) = scan.measurement(index, config.sigma_mode) else {
            continue;
        };
        points += 1;
        let (range, sigma) = model.range_and_sigma(measured.range, measured.sigma);
        for (axes, samples) in &mut faces {
            let [x, y, z] = axes.map(|a| (0..3).map(|i| a[i] * measured.point[i]).sum::<f64>());
            let (u, v) = ((x / z) as f32, (y / z) as f32);
            if z > 0.0 && u.abs() <= CUBE_SLOPE && v.abs() <= CUBE_SLOPE {
                samples[0].push(Sample { u, v, range, sigma });
            }
        }
    }
    (faces, points)
}

fn build_image(
    axes: [[f64; 3]; 3],
    pieces: &[Samples],
    native: Option<[f64; 2]>,
    resolution: f64,
    tables: &mut TableSet,
) -> RangeImage {
    let joined = |of: fn(&Samples) -> [f32; 2], join: fn(f32, f32) -> f32| {
        let all = pieces.iter().map(of);
        all.reduce(|a, b| [join(a[0], b[0]), join(a[1], b[1])])
            .unwrap_or_default()
    };
    let low = joined(|piece| piece.low, f32::min);
    let high = joined(|piece| piece.high, f32::max);
    let count = pieces.iter().map(Samples::len).sum::<usize>();
    let sums = pieces
        .iter()
        .flat_map(|p| p.part_sums.iter().chain([&p.range_sum]));
    let mean_range = sums.sum::<f64>() / count as f64;
    // As many measurements per pixel as leave few gaps, or the camera's own pixels.
    let native = native.unwrap_or_else(|| {
        let pixels = count as f64 / POINTS_PER_PIXEL;
        let extent = [0, 1].map(|i| f64::from(high[i] - low[i]).max(NARROWEST_SLOPES));
        [(pixels / (extent[0] * extent[1])).sqrt(); 2]
    });
    let mut image = RangeImage::empty(
        axes,
        [low, high],
        native,
        PIXELS_PER_CELL * mean_range / resolution,
    );
    for piece in pieces {
        let slopes = piece.u.chunks(CHUNK).zip(piece.v.chunks(CHUNK));
        let measured = piece.ranges.chunks(CHUNK).zip(piece.sigmas.chunks(CHUNK));
        for ((u, v), (ranges, sigmas)) in slopes.zip(measured) {
            let mut pixels = [0; CHUNK];
            for ((pixel, &u), &v) in pixels.iter_mut().zip(u).zip(v) {
                *pixel = image.row_of(v) + image.column_of(u);
            }
            for ((&at, &range), &sigma) in pixels.iter().zip(ranges).zip(sigmas) {
                image.vote(at as usize, range, tables.prepare(range, sigma));
            }
        }
    }
    image.finish(count);
    image
}

/// The nearest whole number of a value below 2^23, of one below 0 that is 0: without a conversion, of which a processor does one
/// at a time.
#[inline]
fn nearest(value: f32) -> u32 {
    const SHIFT: f32 = 8_388_608.0;
    (higher(value, 0.0) + SHIFT)
        .to_bits()
        .wrapping_sub(SHIFT.to_bits())
}

impl RangeImage {
    /// An image without measurements between two slopes, with the focal lengths `native`, or in their proportion less: at most
    /// `finest` along u.
    pub(super) fn empty(
        axes: [[f64; 3]; 3],
        [low, high]: [[f32; 2]; 2],
        native: [f64; 2],
        finest: f64,
    ) -> Self {
        let extent = [0, 1].map(|i| f64::from(high[i] - low[i]).max(NARROWEST_SLOPES));
        let aspect = (native[1] / native[0]).abs();
        let focal_u = native[0]
            .abs()
            .min(finest)
            .min((MAX_PIXELS / (extent[0] * extent[1] * aspect)).sqrt())
            .max(1.0);
        let focal = [focal_u as f32, (focal_u * aspect) as f32];
        let size = [0, 1].map(|i| ((high[i] - low[i]) * focal[i]).round() as usize + 1);
        Self {
            axes,
            width: size[0],
            height: size[1],
            focal,
            center: [-low[0] * focal[0], -low[1] * focal[1]],
            pixels: vec![EMPTY_PIXEL; size[0] * size[1]],
            density: 1.0,
        }
    }

    /// The column of a slope.
    #[inline]
    pub(super) fn column_of(&self, u: f32) -> u32 {
        nearest(u * self.focal[0] + self.center[0]).min(self.width as u32 - 1)
    }

    /// Where the row of a slope begins.
    #[inline]
    pub(super) fn row_of(&self, v: f32) -> u32 {
        nearest(v * self.focal[1] + self.center[1]).min(self.height as u32 - 1) * self.width as u32
    }

    /// Adds a measurement to the pixel `index`. Ranges of one surface are averaged; where they
    /// are not, the majority stays (Boyer and Moore's vote).
    #[inline]
    pub(super) fn vote(&mut self, index: usize, range: f32, table: u16) {
        let pixel = &mut self.pixels[index];
        let votes = f32::from(pixel.votes);
        // Also the first of a pixel: one branch that is nearly always taken.
        if (range * votes - pixel.range).abs() <= ONE_SURFACE * pixel.range {
            if pixel.votes < u16::MAX {
                pixel.table = if pixel.votes == 0 { table } else { pixel.table };
                pixel.range += range;
                pixel.votes += 1;
            }
        } else if pixel.votes == 0 {
            (pixel.range, pixel.table, pixel.votes) = (range, table, 1);
        } else {
            if pixel.votes > 1 {
                pixel.range -= pixel.range / votes;
            }
            pixel.votes -= 1;
        }
    }

    /// Ends the filling of the image with `count` measurements.
    pub(super) fn finish(&mut self, count: usize) {
        let mut filled = 0;
        for pixel in &mut self.pixels {
            pixel.range /= f32::from(pixel.votes.max(1));
            filled += usize::from(pixel.range != HOLE);
        }
        self.density = (count as f32 / filled.max(1) as f32).max(1.0);
        self.fill_gaps();
    }

    /// Closes gaps of one pixel between opposite measurements of one surface, at the
    /// mean of their inverse ranges (exact on planes).
    fn fill_gaps(&mut self) {
        let (width, height) = (self.width, self.height);
        if width < 3 || height < 3 {
            return;
        }
        let source = self.pixels.clone();
        for row in 1..height - 1 {
            for column in 1..width - 1 {
                let at = row * width + column;
                if source[at].range != HOLE {
                    continue;
                }
                let pairs = [
                    (at - 1, at + 1),
                    (at - width, at + width),
                    (at - width - 1, at + width + 1),
                    (at - width + 1, at + width - 1),
                ];
                for (a, b) in pairs {
                    let (a, b) = (source[a], source[b]);
                    let agree = a.range != HOLE
                        && b.range != HOLE
                        && (a.range - b.range).abs() <= ONE_SURFACE * a.range.min(b.range);
                    if agree {
                        self.pixels[at] = Pixel {
                            range: 2.0 * a.range * b.range / (a.range + b.range),
                            table: a.table,
                            votes: 0,
                        };
                        break;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Similarity;

    fn points() -> Vec<[f32; 3]> {
        let unit = |i: usize, step: f32| (i as f32 * step).fract();
        let point = |i| {
            [
                unit(i, 0.377) * 3.0 - 1.0,
                unit(i, 0.617) - 0.7,
                1.0 + unit(i, 0.271),
            ]
        };
        (0..3 * CHUNK + 7).map(point).collect()
    }

    fn collected(points: &[[f32; 3]], sigmas: &[f32]) -> Option<Samples> {
        let pose = Similarity {
            scale: 2.5,
            ..Similarity::IDENTITY
        };
        let scan = Scan::of_points(0, pose, points, sigmas);
        collect_piece(&scan, &IntegrationConfig::default(), 0.1)
    }

    #[test]
    fn points_side_by_side_are_those_one_by_one() {
        let points = points();
        let found = collected(&points, &[0.02]).unwrap();
        assert_eq!(found.len(), points.len());
        for (i, [x, y, z]) in points.iter().map(|p| p.map(f64::from)).enumerate() {
            let range = 2.5 * (x * x + y * y + z * z).sqrt();
            let expected = [x / z, y / z, range, 0.05].map(|c| c as f32);
            let found = [found.u[i], found.v[i], found.ranges[i], found.sigmas[i]];
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() <= 3e-7 * expected.abs(), "{i}");
            }
        }
        let ends = |of: &[f32], end: fn(f32, f32) -> f32| of.iter().copied().reduce(end).unwrap();
        assert_eq!(found.low, [&found.u, &found.v].map(|of| ends(of, f32::min)));
        assert_eq!(
            found.high,
            [&found.u, &found.v].map(|of| ends(of, f32::max))
        );
        let mean = found.part_sums.iter().sum::<f64>() / found.len() as f64;
        let expected = found.ranges.iter().map(|r| f64::from(*r)).sum::<f64>() / found.len() as f64;
        assert!((mean - expected).abs() < 1e-6 * expected);
    }

    #[test]
    fn unusable_points_are_left_out_others_keep_their_uncertainty_and_none_may_lie_behind() {
        let mut points = points();
        let mut sigmas: Vec<f32> = points.iter().map(|p| 0.01 * p[2]).collect();
        let found = collected(&points, &sigmas).unwrap();
        assert!((found.sigmas[70] - 2.5 * sigmas[70]).abs() < 1e-7);
        points[5][1] = f32::NAN;
        points[70] = [0.0; 3];
        points[71][0] = f32::INFINITY;
        sigmas[130] = 0.0;
        let found = collected(&points, &sigmas).unwrap();
        assert_eq!(found.len(), points.len() - 4);
        assert!(
            found
                .u
                .iter()
                .chain(&found.ranges)
                .all(|value| value.is_finite())
        );
        points[100][2] = -1.0;
        assert!(collected(&points, &sigmas).is_none());
    }

    #[test]
    fn the_nearest_pixel_is_found_without_a_conversion() {
        for (value, expected) in [
            (-3.0, 0),
            (-0.2, 0),
            (0.49, 0),
            (0.51, 1),
            (7.6, 8),
            (4e6, 4_000_000),
        ] {
            assert_eq!(nearest(value), expected);
        }
    }
}
