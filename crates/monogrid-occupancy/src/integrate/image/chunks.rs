//! Measurements of one image side by side, as slopes and ranges.

use std::ops::ControlFlow;

use crate::for_avx2::for_avx2;
use crate::integrate::IntegrationConfig;
use crate::integrate::image::extremes::{higher, lower};
use crate::integrate::rays::beam::total_sigma;
use crate::scan::{PointScan, Scan, ScanData};

/// A scan whose directions all lie within this slope of the forward axis is one image.
pub(super) const WIDEST_SLOPE: f32 = 2.5;

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

/// A measurement in an image: slopes, and range with its uncertainty in map units.
#[derive(Clone, Copy)]
pub(super) struct Sample {
    pub u: f32,
    pub v: f32,
    pub range: f32,
    pub sigma: f32,
}

/// Up to [`Chunk::LEN`] measurements. Behind them slopes are those of the first, and ranges 0.
#[derive(Clone)]
pub(super) struct Chunk {
    pub u: [f32; Self::LEN],
    pub v: [f32; Self::LEN],
    pub ranges: [f32; Self::LEN],
    pub sigmas: [f32; Self::LEN],
    pub len: usize,
    /// The uncertainty of all of them, if it is known to be one.
    pub common_sigma: Option<f32>,
}

/// Values that are compared and added side by side.
const LANES: usize = 8;

impl Chunk {
    pub(super) const LEN: usize = 64;

    pub(super) const EMPTY: Self = Self {
        u: [0.0; Self::LEN],
        v: [0.0; Self::LEN],
        ranges: [0.0; Self::LEN],
        sigmas: [0.0; Self::LEN],
        len: 0,
        common_sigma: None,
    };

    /// Adds a measurement to one that is not full.
    pub(super) fn push(&mut self, sample: Sample) {
        let Sample { u, v, range, sigma } = sample;
        if self.len == 0 {
            *self = Self::EMPTY;
            (self.u, self.v) = ([u; Self::LEN], [v; Self::LEN]);
        }
        (self.u[self.len], self.v[self.len]) = (u, v);
        (self.ranges[self.len], self.sigmas[self.len]) = (range, sigma);
        self.len += 1;
    }

    /// Becomes those of a scan of as many at most; breaks off if some direction is too far off.
    pub(super) fn read(
        &mut self,
        scan: &Scan,
        model: &mut RangeModel,
        config: &IntegrationConfig,
    ) -> ControlFlow<()> {
        if self.read_points(scan, model) {
            return ControlFlow::Continue(());
        }
        self.len = 0;
        scan.each_measurement(config.sigma_mode, |measured| {
            let [x, y, z] = measured.point;
            let inverse = 1.0 / z;
            let (u, v) = ((x * inverse) as f32, (y * inverse) as f32);
            if !(z > 0.0 && u.abs() < WIDEST_SLOPE && v.abs() < WIDEST_SLOPE) {
                return ControlFlow::Break(());
            }
            let (range, sigma) = model.range_and_sigma(measured.range, measured.sigma);
            self.push(Sample { u, v, range, sigma });
            ControlFlow::Continue(())
        })
    }

    /// Becomes a full chunk of points that are all usable, ahead and of one uncertainty, side by
    /// side; `false` for others.
    fn read_points(&mut self, scan: &Scan, model: &mut RangeModel) -> bool {
        let ScanData::Points(PointScan { points, sigmas }) = scan.data else {
            return false;
        };
        let Ok(points) = <&[[f32; 3]; Self::LEN]>::try_from(points) else {
            return false;
        };
        let sigma = sigmas[0];
        let is_one = sigmas.iter().fold(true, |all, &s| all & (s == sigma));
        if scan.pose_sigma.rotation_rad != 0.0 || !(is_one && sigma > 0.0 && sigma < 1e9) {
            return false;
        }
        let (_, sigma) = model.range_and_sigma(1.0, f64::from(sigma));
        self.len = Self::LEN;
        self.common_sigma = Some(sigma);
        self.sigmas = [sigma; Self::LEN];
        convert(points, scan.world_from_sensor.scale as f32, self)
    }
}

for_avx2! {
    /// Slopes and ranges of points; `false` if one of them is not usable or not ahead.
    fn convert(points: &[[f32; 3]; Chunk::LEN], scale: f32, chunk: &mut Chunk) -> bool {
        let mut is_ahead = true;
        for (i, &[x, y, z]) in points.iter().enumerate() {
            let inverse = 1.0 / z;
            let (u, v) = (x * inverse, y * inverse);
            let range = (x * x + y * y + z * z).sqrt();
            // Written so that NaN fails; a range is finite only if all of its point is.
            let slopes = (u.abs() < WIDEST_SLOPE) & (v.abs() < WIDEST_SLOPE);
            is_ahead &= slopes & (z > 0.0) & (range > 1e-9) & (range < 1e9);
            (chunk.u[i], chunk.v[i]) = (u, v);
            chunk.ranges[i] = range * scale;
        }
        is_ahead
    }
}

/// How far measurements reach.
#[derive(Clone, Copy)]
pub(super) struct Extent {
    /// Least and greatest slopes, which are finite.
    pub low: [f32; 2],
    pub high: [f32; 2],
    pub range_sum: f64,
    pub count: usize,
}

impl Extent {
    pub(super) const NONE: Self = Self {
        low: [f32::MAX; 2],
        high: [f32::MIN; 2],
        range_sum: 0.0,
        count: 0,
    };

    pub(super) fn join(&self, other: &Self) -> Self {
        let joined =
            |a: [f32; 2], b: [f32; 2], end: fn(f32, f32) -> f32| [end(a[0], b[0]), end(a[1], b[1])];
        Self {
            low: joined(other.low, self.low, lower),
            high: joined(other.high, self.high, higher),
            range_sum: self.range_sum + other.range_sum,
            count: self.count + other.count,
        }
    }
}

for_avx2! {
    /// The extent of a chunk that is not empty.
    pub(super) fn extent_of(chunk: &Chunk) -> Extent {
        let folded = |of: &[f32; Chunk::LEN], begin: f32, join: fn(f32, f32) -> f32| {
            let lanes = of.chunks_exact(LANES).fold([begin; LANES], |all, lanes| {
                std::array::from_fn(|l| join(lanes[l], all[l]))
            });
            lanes.into_iter().fold(begin, join)
        };
        let least = |of: &[f32; Chunk::LEN]| folded(of, of[0], lower);
        let greatest = |of: &[f32; Chunk::LEN]| folded(of, of[0], higher);
        Extent {
            low: [least(&chunk.u), least(&chunk.v)],
            high: [greatest(&chunk.u), greatest(&chunk.v)],
            range_sum: folded(&chunk.ranges, 0.0, |a, b| a + b).into(),
            count: chunk.len,
        }
    }
}
