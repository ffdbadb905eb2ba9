//! A complete depth image as a range image: pixel by pixel in their order, without a list of
//! measurements.

use crate::integrate::image::chunks::{RangeModel, WIDEST_SLOPE};
use crate::integrate::image::range_image::{Filling, PIXELS_PER_CELL, RangeImage};
use crate::scan::{DepthImage, Scan, ScanData};
use crate::sensor::table::TableSet;

/// Measurements along the edge of a pixel, at least: where the camera's pixels are so much finer,
/// some stand for all. Their mean is then known better than a cell is large.
const SAMPLES_PER_PIXEL: f64 = 3.0;
/// The mean range, which decides how fine the image is, is that of one row in so many.
const ROWS_PER_MEAN: usize = 8;

/// The image of a scan that is a depth image, none if nothing is measured, and the number of its
/// measurements; `None` for other scans and for cameras that see too much for one image.
pub(super) fn range_image(
    scan: &Scan,
    axes: [[f64; 3]; 3],
    resolution: f64,
    tables: &mut TableSet,
) -> Option<(Vec<RangeImage>, usize)> {
    let ScanData::Image(camera) = scan.data else {
        return None;
    };
    let slopes = |size: u32, center: f64, focal: f64| -> Vec<f32> {
        let slope = |i| ((f64::from(i) - center) / focal) as f32;
        (0..size).map(slope).collect()
    };
    let columns = slopes(camera.width, camera.cx, camera.fx);
    let rows = slopes(camera.height, camera.cy, camera.fy);
    if columns
        .iter()
        .chain(&rows)
        .any(|slope| slope.abs() >= WIDEST_SLOPE)
    {
        return None;
    }
    let count = (0..camera.depths.len())
        .filter(|&index| camera.measured(index).is_some())
        .count();
    if count == 0 {
        return Some((Vec::new(), 0));
    }
    let depths = Depths {
        camera,
        columns: &columns,
        rows: &rows,
    };
    let native = [camera.fx, camera.fy];
    let mean_range = depths.mean_range() * scan.world_from_sensor.scale;
    let bound = |end: fn(f32, f32) -> f32| {
        [&columns, &rows].map(|slopes| slopes.iter().copied().reduce(end).unwrap_or(0.0))
    };
    let extent = [bound(f32::min), bound(f32::max)];
    let finest = PIXELS_PER_CELL * mean_range / resolution;
    let mut filling = Filling::new(axes, extent, native, finest);
    let image = &filling.image;
    let step = camera.fx.abs() / f64::from(image.focal[0]) / SAMPLES_PER_PIXEL;
    let column_of: Vec<u32> = columns.iter().map(|&u| image.column_of(u)).collect();
    let row_of: Vec<u32> = rows.iter().map(|&v| image.row_of(v)).collect();
    let mut model = RangeModel::new(scan, resolution);
    depths.each([step.max(1.0) as usize; 2], |x, y, range, sigma| {
        let (range, sigma) = model.range_and_sigma(range, sigma);
        filling.vote(
            (row_of[y] + column_of[x]) as usize,
            range,
            tables.prepare(range, sigma),
        );
    });
    Some((vec![filling.finish(count)], count))
}

/// A depth image with the slopes of its columns and rows.
struct Depths<'a> {
    camera: DepthImage<'a>,
    columns: &'a [f32],
    rows: &'a [f32],
}

impl Depths<'_> {
    /// Column, row, range and its standard deviation (in sensor units) of the measurements in each
    /// so manyth column and row.
    #[inline]
    fn each(&self, steps: [usize; 2], mut take: impl FnMut(usize, usize, f64, f64)) {
        for (y, v) in self.rows.iter().enumerate().step_by(steps[1]) {
            let row = y * self.columns.len();
            for (x, u) in self.columns.iter().enumerate().step_by(steps[0]) {
                if let Some((depth, sigma)) = self.camera.measured(row + x) {
                    let per_depth = (u * u + v * v + 1.0).sqrt();
                    take(x, y, f64::from(depth * per_depth), f64::from(sigma));
                }
            }
        }
    }

    /// In sensor units.
    fn mean_range(&self) -> f64 {
        for rows in [ROWS_PER_MEAN, 1] {
            let (mut sum, mut count) = (0.0, 0.0);
            self.each([1, rows], |_, _, range, _| {
                sum += range;
                count += 1.0;
            });
            if count > 0.0 {
                return sum / count;
            }
        }
        0.0
    }
}
