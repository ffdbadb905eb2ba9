//! The depth of one keyframe as a structure of arrays.

use crate::config::{DepthConfig, GradientSelection};
use crate::stats::ObserveStats;
use crate::{DepthPixel, HostFrame};
use std::ops::Range;
use std::sync::Arc;

/// Width of the border without hypotheses, px: the patch reaches so far.
pub(crate) const BORDER: usize = 6;
/// Variance of a difference of pixels is at least this, grey levels²: whole grey levels differ by
/// it.
const MIN_NOISE_VAR: f32 = 1.0 / 6.0;
/// Blocked pixels have at most this many in `failures`.
pub(crate) const MAX_FAILURES: u8 = 100;

/// Hypotheses with a larger variance are dropped, 1/u².
pub(crate) const MAX_VAR: f32 = 0.25;

/// Per-pixel state, all row-major. A pixel is known when `var > 0`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Arrays {
    /// Inverse depth, 1/u.
    pub(crate) idepth: Vec<f32>,
    /// Its variance, 1/u²; 0 = unknown.
    pub(crate) var: Vec<f32>,
    /// Variance that the hypothesis brought from an earlier keyframe; infinite when it was created
    /// here.
    pub(crate) prior_var: Vec<f32>,
    /// Variance that observations of this keyframe can reach, given what they share.
    pub(crate) floor_var: Vec<f32>,
    /// Photometric variance of the last match, px²; 0 before one.
    pub(crate) photo_px: Vec<f32>,
    /// Confirmation; 0 where unknown.
    pub(crate) validity: Vec<u8>,
    /// Failures in a row.
    pub(crate) failures: Vec<u8>,
}

/// The hypothesis that is written into a pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hypothesis {
    pub(crate) idepth: f32,
    pub(crate) var: f32,
    pub(crate) prior_var: f32,
    pub(crate) validity: u8,
}

/// A hypothesis that was found for a pixel.
#[derive(Clone, Copy, Debug)]
pub struct FoundDepth {
    pub(crate) index: usize,
    pub(crate) hypothesis: Hypothesis,
}

impl Arrays {
    fn new(len: usize) -> Self {
        Self {
            idepth: vec![0.0; len],
            var: vec![0.0; len],
            prior_var: vec![f32::INFINITY; len],
            floor_var: vec![f32::INFINITY; len],
            photo_px: vec![0.0; len],
            validity: vec![0; len],
            failures: vec![0; len],
        }
    }

    pub(crate) fn set(&mut self, i: usize, hypothesis: Hypothesis) {
        self.idepth[i] = hypothesis.idepth;
        self.var[i] = hypothesis.var;
        self.prior_var[i] = hypothesis.prior_var;
        self.floor_var[i] = f32::INFINITY;
        self.photo_px[i] = 0.0;
        self.validity[i] = hypothesis.validity;
        self.failures[i] = 0;
    }

    pub(crate) fn clear(&mut self, i: usize) {
        self.var[i] = 0.0;
        self.validity[i] = 0;
        self.photo_px[i] = 0.0;
    }
}

/// Candidate columns of each row.
#[derive(Clone, Debug, Default)]
pub(crate) struct Candidates {
    starts: Vec<usize>,
    columns: Vec<u16>,
}

impl Candidates {
    fn select(host: &HostFrame, config: &DepthConfig) -> Self {
        let (w, h) = (host.width(), host.height());
        let mut this = Self::default();
        let min_sq = config.min_gradient * config.min_gradient;
        for y in 0..h {
            this.starts.push(this.columns.len());
            if y < BORDER || y + BORDER >= h {
                continue;
            }
            let (gx, gy) = (host.gradient.gx.row(y), host.gradient.gy.row(y));
            let (dilated, mask) = (host.max_gradient.row(y), host.mask.row(y));
            for x in BORDER..w - BORDER {
                let strong = match config.selection {
                    GradientSelection::Own => gx[x] * gx[x] + gy[x] * gy[x] >= min_sq,
                    GradientSelection::Dilated => dilated[x] >= config.min_gradient,
                };
                if strong && mask[x] != 0 {
                    this.columns.push(x as u16);
                }
            }
        }
        this.starts.push(this.columns.len());
        this
    }

    /// Candidate columns of row `y`, ascending.
    pub(crate) fn row(&self, y: usize) -> &[u16] {
        &self.columns[self.starts[y]..self.starts[y + 1]]
    }

    /// Column, row and index of each candidate of some rows.
    pub(crate) fn in_rows(
        &self,
        rows: Range<usize>,
        width: usize,
    ) -> impl Iterator<Item = (usize, usize, usize)> {
        rows.flat_map(move |y| {
            let columns = self.row(y).iter().map(|x| usize::from(*x));
            columns.map(move |x| (x, y, y * width + x))
        })
    }
}

/// Semi-dense depth of one keyframe.
#[derive(Clone, Debug)]
pub struct DepthMap {
    pub(crate) host: Arc<HostFrame>,
    pub(crate) candidates: Candidates,
    pub(crate) arrays: Arrays,
    /// Regularised inverse depth and variance; variance 0 = none.
    pub(crate) smooth_idepth: Vec<f32>,
    pub(crate) smooth_var: Vec<f32>,
    /// Variance of the difference of two matching pixels, grey levels².
    pub(crate) noise_var: f32,
    /// Whether `noise_var` comes from observations.
    pub(crate) noise_measured: bool,
    /// Whether a depth camera or a stereo pair measured some of it.
    pub(crate) is_measured: bool,
    /// Nearest inverse depth that a pixel without neighbours is searched for, 1/u.
    pub(crate) near_limit: f32,
}

impl DepthMap {
    /// A keyframe without any depth; its candidate pixels are chosen here.
    #[must_use]
    pub fn empty(host: Arc<HostFrame>, config: &DepthConfig) -> Self {
        let len = host.width() * host.height();
        let candidates = Candidates::select(&host, config);
        Self {
            host,
            candidates,
            arrays: Arrays::new(len),
            smooth_idepth: vec![0.0; len],
            smooth_var: vec![0.0; len],
            noise_var: 2.0 * config.sensor_sigma * config.sensor_sigma,
            noise_measured: false,
            is_measured: false,
            near_limit: config.max_idepth,
        }
    }

    /// Whether pixel `(x, y)` has enough gradient to carry a depth.
    #[must_use]
    pub fn is_candidate(&self, x: usize, y: usize) -> bool {
        y < self.host.height()
            && u16::try_from(x).is_ok_and(|x| self.candidates.row(y).binary_search(&x).is_ok())
    }

    /// The candidates of all rows.
    pub(crate) fn all_candidates(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        let rows = 0..self.host.height();
        self.candidates.in_rows(rows, self.host.width())
    }

    /// Writes a hypothesis into a pixel, which is not smoothed yet.
    pub(crate) fn set(&mut self, index: usize, hypothesis: Hypothesis) {
        self.arrays.set(index, hypothesis);
        self.smooth_idepth[index] = hypothesis.idepth;
        self.smooth_var[index] = hypothesis.var;
    }

    /// The keyframe this depth belongs to.
    #[must_use]
    pub fn host(&self) -> &Arc<HostFrame> {
        &self.host
    }

    /// The hypothesis of pixel `(x, y)`, honest and unsmoothed; `None` without one and outside the
    /// image.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> Option<DepthPixel> {
        if x >= self.host.width() || y >= self.host.height() {
            return None;
        }
        let i = y * self.host.width() + x;
        (self.arrays.var[i] > 0.0).then(|| DepthPixel {
            x: x as u16,
            y: y as u16,
            idepth: self.arrays.idepth[i],
            idepth_var: self.arrays.var[i],
        })
    }

    /// Number of pixels that can carry a depth.
    #[must_use]
    pub fn num_candidates(&self) -> usize {
        self.candidates.columns.len()
    }

    /// Number of pixels with a hypothesis.
    #[must_use]
    pub fn num_known(&self) -> usize {
        self.arrays.var.iter().filter(|v| **v > 0.0).count()
    }

    /// Estimated standard deviation of the difference of two matching pixels, grey levels.
    #[must_use]
    pub fn noise_sigma(&self) -> f32 {
        self.noise_var.sqrt()
    }

    /// Learns the image noise from the observations of a frame (the merged counters of all bands).
    pub fn finish_observation(&mut self, stats: &ObserveStats) {
        const ENOUGH: u32 = 500;
        if stats.num_residuals >= ENOUGH {
            let measured = (stats.residual_sq_sum / f64::from(stats.num_residuals)) as f32;
            let weight = if self.noise_measured { 0.3 } else { 1.0 };
            self.noise_var += weight * (measured.max(MIN_NOISE_VAR) - self.noise_var);
            self.noise_measured = true;
        }
    }

    /// Multiplies every inverse depth by `factor` (lengths are divided by it). Ignored unless
    /// finite and positive.
    pub fn rescale(&mut self, factor: f32) {
        if !(factor.is_finite() && factor > 0.0) {
            return;
        }
        self.near_limit *= factor;
        let factor_sq = factor * factor;
        for values in [&mut self.arrays.idepth, &mut self.smooth_idepth] {
            values.iter_mut().for_each(|v| *v *= factor);
        }
        let (arrays, smooth_var) = (&mut self.arrays, &mut self.smooth_var);
        let own = arrays.var.iter_mut().chain(&mut arrays.prior_var);
        let vars = own.chain(&mut arrays.floor_var).chain(smooth_var);
        vars.for_each(|var| *var *= factor_sq);
    }

    /// Median inverse depth of all known pixels, 1/u.
    #[must_use]
    pub fn median_idepth(&self) -> Option<f32> {
        let known = self.arrays.idepth.iter().zip(&self.arrays.var);
        let mut values: Vec<f32> = known.filter(|(_, v)| **v > 0.0).map(|(d, _)| *d).collect();
        if values.is_empty() {
            return None;
        }
        let middle = values.len() / 2;
        Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
    }
}
