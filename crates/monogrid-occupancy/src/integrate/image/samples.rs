//! From measurements one by one to range images.
//!
//! How fine an image is depends on all measurements, so they are looked at twice. Points are
//! converted again the second time, which takes less than to write them down and read them; pixels
//! of a camera and the faces of a cube are kept.

use crate::integrate::IntegrationConfig;
use crate::integrate::image::chunks::{Chunk, Extent, RangeModel, Sample, extent_of};
use crate::integrate::image::range_image::{
    FORWARD, Filling, NARROWEST_SLOPES, PIXELS_PER_CELL, RangeImage,
};
use crate::integrate::parallel::for_each;
use crate::scan::{Scan, ScanData};
use crate::sensor::table::TableSet;

/// Measurements per pixel of a point cloud, on average: with one, a third of the pixels of randomly
/// spread measurements are empty, and gaps are left that nothing can close.
const POINTS_PER_PIXEL: f64 = 1.4;
/// Slope of a cube's faces, with a margin for footprints that cross an edge.
const CUBE_SLOPE: f32 = 1.02;

/// Axes of the six faces of a cube around the sensor.
const CUBE: [[[f64; 3]; 3]; 6] = [
    [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
    [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
    FORWARD,
    [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
];

/// Axes (right, down, forward) of an image.
type Axes = [[f64; 3]; 3];

/// The images of a scan of single measurements, and how many of those are usable.
pub(super) fn point_images(
    scan: &Scan,
    config: &IntegrationConfig,
    resolution: f64,
    threads: usize,
    in_world: &dyn Fn(Axes) -> Axes,
    tables: &mut TableSet,
) -> (Vec<RangeImage>, usize) {
    let measured = Measured {
        scan,
        config,
        resolution,
    };
    let build = |axes, extent: &Extent| measured.filling(in_world(axes), extent);
    if let Some((extent, kept)) = measured.look_forward(threads) {
        if extent.count == 0 {
            return (Vec::new(), 0);
        }
        let mut image = build(FORWARD, &extent);
        let vote = |chunk: &Chunk| image.vote_all(chunk, tables);
        match kept {
            Some(chunks) => chunks.iter().for_each(vote),
            None => measured.each_chunk(vote),
        }
        return (vec![image.finish(extent.count)], extent.count);
    }
    let (faces, points) = measured.look_around();
    let images = faces.iter().map(|(axes, chunks)| {
        let extents = chunks.iter().map(extent_of);
        let extent = extents.fold(Extent::NONE, |all, one| all.join(&one));
        let mut image = build(*axes, &extent);
        chunks
            .iter()
            .for_each(|chunk| image.vote_all(chunk, tables));
        image.finish(extent.count)
    });
    (images.collect(), points)
}

/// Measurements whose ranges are summed together: the same for any number of threads, as sums are
/// rounded.
const PART: usize = 8192;

/// A scan of measurements.
struct Measured<'a> {
    scan: &'a Scan<'a>,
    config: &'a IntegrationConfig,
    resolution: f64,
}

impl Measured<'_> {
    /// The extent of the samples of a sensor that looks forward, and themselves unless they are
    /// read again; `None` if some direction is too far off.
    fn look_forward(&self, threads: usize) -> Option<(Extent, Option<Vec<Chunk>>)> {
        let parts = (0..self.scan.len()).step_by(PART);
        let mut parts: Vec<(Scan, Option<Part>)> = parts
            .map(|first| {
                Some((
                    self.scan.part(first..(first + PART).min(self.scan.len()))?,
                    None,
                ))
            })
            .collect::<Option<_>>()?;
        for_each(&mut parts, threads, |_, (scan, part)| {
            *part = self.part(scan);
        });
        let mut extent = Extent::NONE;
        let mut chunks = Vec::new();
        for (_, part) in parts {
            let part = part?;
            extent = extent.join(&part.extent);
            chunks.extend(part.kept);
        }
        Some((extent, (!self.is_read_again()).then_some(chunks)))
    }

    fn is_read_again(&self) -> bool {
        matches!(self.scan.data, ScanData::Points(_))
    }

    fn part(&self, scan: &Scan) -> Option<Part> {
        let mut model = RangeModel::new(scan, self.resolution);
        let mut chunk = Chunk::EMPTY;
        let mut part = Part {
            extent: Extent::NONE,
            kept: Vec::new(),
        };
        for first in (0..scan.len()).step_by(Chunk::LEN) {
            let few = scan.part(first..(first + Chunk::LEN).min(scan.len()))?;
            if chunk.read(&few, &mut model, self.config).is_break() {
                return None;
            }
            if chunk.len > 0 {
                part.extent = part.extent.join(&extent_of(&chunk));
                if !self.is_read_again() {
                    part.kept.push(chunk.clone());
                }
            }
        }
        Some(part)
    }

    /// Reads samples that all look forward again.
    fn each_chunk(&self, mut take: impl FnMut(&Chunk)) {
        let mut model = RangeModel::new(self.scan, self.resolution);
        let mut chunk = Chunk::EMPTY;
        for first in (0..self.scan.len()).step_by(Chunk::LEN) {
            let end = (first + Chunk::LEN).min(self.scan.len());
            if let Some(few) = self.scan.part(first..end) {
                let _is_forward = chunk.read(&few, &mut model, self.config);
                take(&chunk);
            }
        }
    }

    /// The samples of the six faces of a cube; those near an edge belong to both faces.
    fn look_around(&self) -> (Vec<(Axes, Vec<Chunk>)>, usize) {
        let mut model = RangeModel::new(self.scan, self.resolution);
        let mut faces: Vec<_> = CUBE.iter().map(|axes| (*axes, Vec::new())).collect();
        let mut points = 0;
        for index in 0..self.scan.len() {
            let Some(measured) = self.scan.measurement(index, self.config.sigma_mode) else {
                continue;
            };
            points += 1;
            let (range, sigma) = model.range_and_sigma(measured.range, measured.sigma);
            for (axes, chunks) in &mut faces {
                let [x, y, z] = axes.map(|a| (0..3).map(|i| a[i] * measured.point[i]).sum::<f64>());
                let (u, v) = ((x / z) as f32, (y / z) as f32);
                if z > 0.0 && u.abs() <= CUBE_SLOPE && v.abs() <= CUBE_SLOPE {
                    push(chunks, Sample { u, v, range, sigma });
                }
            }
        }
        (faces, points)
    }

    /// An image for samples of that extent, with as many measurements per pixel as leave few gaps,
    /// or the camera's own pixels.
    fn filling(&self, axes: Axes, extent: &Extent) -> Filling {
        let Extent { low, high, .. } = *extent;
        let native = self.scan.focal().unwrap_or_else(|| {
            let pixels = extent.count as f64 / POINTS_PER_PIXEL;
            let slopes = [0, 1].map(|i| f64::from(high[i] - low[i]).max(NARROWEST_SLOPES));
            [(pixels / (slopes[0] * slopes[1])).sqrt(); 2]
        });
        let mean_range = extent.range_sum / extent.count as f64;
        let finest = PIXELS_PER_CELL * mean_range / self.resolution;
        Filling::new(axes, [low, high], native, finest)
    }
}

/// Some of the samples.
struct Part {
    extent: Extent,
    kept: Vec<Chunk>,
}

fn push(chunks: &mut Vec<Chunk>, sample: Sample) {
    match chunks.last_mut() {
        Some(chunk) if chunk.len < Chunk::LEN => chunk.push(sample),
        _ => {
            chunks.push(Chunk::EMPTY);
            chunks
                .iter_mut()
                .last()
                .into_iter()
                .for_each(|chunk| chunk.push(sample));
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
        (0..3 * Chunk::LEN + 7).map(point).collect()
    }

    /// The samples of points one after the other, and their extent.
    fn collected(points: &[[f32; 3]], sigmas: &[f32]) -> Option<(Vec<Sample>, Extent)> {
        let pose = Similarity {
            scale: 2.5,
            ..Similarity::IDENTITY
        };
        let measured = Measured {
            scan: &Scan::of_points(0, pose, points, sigmas),
            config: &IntegrationConfig::default(),
            resolution: 0.1,
        };
        let (extent, kept) = measured.look_forward(1)?;
        assert!(kept.is_none());
        let mut samples = Vec::new();
        measured.each_chunk(|chunk| {
            samples.extend((0..chunk.len).map(|i| Sample {
                u: chunk.u[i],
                v: chunk.v[i],
                range: chunk.ranges[i],
                sigma: chunk.sigmas[i],
            }));
        });
        Some((samples, extent))
    }

    #[test]
    fn points_side_by_side_are_those_one_by_one() {
        let points = points();
        let (samples, extent) = collected(&points, &[0.02]).unwrap();
        assert_eq!((samples.len(), extent.count), (points.len(), points.len()));
        let exact = points.iter().map(|p| p.map(f64::from));
        for (i, ([x, y, z], found)) in exact.zip(&samples).enumerate() {
            let range = 2.5 * (x * x + y * y + z * z).sqrt();
            let expected = [x / z, y / z, range, 0.05].map(|c| c as f32);
            let found = [found.u, found.v, found.range, found.sigma];
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() <= 3e-7 * expected.abs(), "{i}");
            }
        }
        let end = |of: fn(&Sample) -> f32, end: fn(f32, f32) -> f32| {
            samples.iter().map(of).reduce(end).unwrap()
        };
        let ends = |join| [end(|s| s.u, join), end(|s| s.v, join)];
        assert_eq!((extent.low, extent.high), (ends(f32::min), ends(f32::max)));
        let sum: f64 = samples.iter().map(|s| f64::from(s.range)).sum();
        assert!((extent.range_sum - sum).abs() < 1e-6 * sum);
    }

    #[test]
    fn unusable_points_are_left_out_others_keep_their_uncertainty_and_none_may_lie_behind() {
        let mut points = points();
        let mut sigmas: Vec<f32> = points.iter().map(|p| 0.01 * p[2]).collect();
        let (found, _) = collected(&points, &sigmas).unwrap();
        assert!((found[70].sigma - 2.5 * sigmas[70]).abs() < 1e-7);
        points[5][1] = f32::NAN;
        points[70] = [0.0; 3];
        points[71][0] = f32::INFINITY;
        sigmas[130] = 0.0;
        let (found, extent) = collected(&points, &sigmas).unwrap();
        assert_eq!((found.len(), extent.count), (points.len() - 4, found.len()));
        assert!(found.iter().all(|s| (s.u + s.range).is_finite()));
        points[100][2] = -1.0;
        assert!(collected(&points, &sigmas).is_none());
    }
}
