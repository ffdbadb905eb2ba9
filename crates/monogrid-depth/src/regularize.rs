//! Spatial smoothing, removal of lone pixels and filling of holes.

use crate::DepthMap;
use crate::config::DepthConfig;
use crate::map::MAX_VAR;
use crate::map::{Arrays, Candidates, FoundDepth, Hypothesis};
use monogrid_image::for_lanes;
use monogrid_image::lanes::{F32x8, LANES, Lanes};

/// Sum of the validities in 5x5 below which a pixel is dropped.
const MIN_SUPPORT_KEEP: u16 = 24;

/// Neighbours on either side.
const RADIUS: usize = 2;

/// Rows whose smoothed values are computed; reads the whole map, writes its own rows.
#[derive(Debug)]
pub struct RegularizeBand<'a> {
    arrays: &'a Arrays,
    candidates: &'a Candidates,
    width: usize,
    first_row: usize,
    num_rows: usize,
    smooth_idepth: &'a mut [f32],
    smooth_var: &'a mut [f32],
}

impl DepthMap {
    /// Bands for [`RegularizeBand::regularize`]; call [`DepthMap::remove_unsupported`] after all.
    pub fn regularize_bands(&mut self, rows_per_band: usize) -> Vec<RegularizeBand<'_>> {
        let rows = rows_per_band.max(1);
        let (width, height) = (self.host.width(), self.host.height());
        let (arrays, candidates) = (&self.arrays, &self.candidates);
        let smooth_vars = self.smooth_var.chunks_mut(rows * width);
        let smooth = self.smooth_idepth.chunks_mut(rows * width).zip(smooth_vars);
        let bands = smooth.enumerate();
        let bands = bands.map(|(band, (smooth_idepth, smooth_var))| RegularizeBand {
            arrays,
            candidates,
            width,
            first_row: band * rows,
            num_rows: rows.min(height - band * rows),
            smooth_idepth,
            smooth_var,
        });
        bands.collect()
    }

    /// Drops the pixels that the last regularisation left without a smoothed value.
    pub fn remove_unsupported(&mut self, config: &DepthConfig) {
        let rows = 0..self.host.height();
        let candidates = self.candidates.in_rows(rows, self.host.width());
        candidates.for_each(|(_, _, i)| {
            if self.arrays.var[i] > 0.0 && self.smooth_var[i] <= 0.0 {
                self.arrays.clear(i);
            }
        });
        self.limit_search(config);
    }

    /// Smooths all rows on the calling thread and drops what has no support.
    pub fn regularize(&mut self, config: &DepthConfig) {
        for mut band in self.regularize_bands(self.host.height()) {
            band.regularize(config);
        }
        self.remove_unsupported(config);
    }

    /// Candidate pixels of some rows without depth, but with confirmed neighbours, with the
    /// neighbours' depth, a variance that covers their spread and no confirmation. Reads only, so
    /// that rows can be searched side by side; [`DepthMap::fill`] stores what was found.
    #[must_use]
    pub fn holes(&self, rows: std::ops::Range<usize>, config: &DepthConfig) -> Vec<FoundDepth> {
        let rows = rows.start..rows.end.min(self.host.height());
        let candidates = self.candidates.in_rows(rows, self.host.width());
        let mut found = Vec::new();
        candidates.for_each(|(x, y, index)| {
            if self.arrays.var[index] <= 0.0
                && self.arrays.failures[index] <= 2
                && let Some(hypothesis) = self.hole(x, y, config)
            {
                found.push(FoundDepth { index, hypothesis });
            }
        });
        found
    }

    /// Stores what [`DepthMap::holes`] found.
    pub fn fill(&mut self, holes: &[FoundDepth]) {
        for hole in holes {
            // what failed before may fail again: its failures keep counting
            let failures = self.arrays.failures[hole.index];
            self.set(hole.index, hole.hypothesis);
            self.arrays.failures[hole.index] = failures;
        }
    }

    /// Fills the holes of all rows on the calling thread. Returns how many.
    pub fn fill_holes(&mut self, config: &DepthConfig) -> usize {
        let holes = self.holes(0..self.host.height(), config);
        self.fill(&holes);
        holes.len()
    }

    /// Inverse-variance mean of the 5x5 neighbours when they are confirmed enough.
    fn hole(&self, x: usize, y: usize, config: &DepthConfig) -> Option<Hypothesis> {
        let w = self.host.width();
        let arrays = &self.arrays;
        let around = |yy: usize| yy * w + x - RADIUS..yy * w + x + RADIUS + 1;
        // whether it is too far from anything known is found out without a division
        let rows = (y - RADIUS..=y + RADIUS).map(|yy| yy * w + x - RADIUS);
        let rows = rows.filter_map(|start| lanes(&arrays.validity, start));
        if sum_of_fives(rows) <= u32::from(config.min_support_fill) {
            return None;
        }
        let (mut sum_w, mut sum_d, mut sum_dd, mut num) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for row in (y - RADIUS..=y + RADIUS).map(around) {
            for j in row {
                if arrays.var[j] > 0.0 && arrays.validity[j] > 0 {
                    let weight = 1.0 / arrays.var[j];
                    sum_w += weight;
                    sum_d += weight * arrays.idepth[j];
                    sum_dd += weight * arrays.idepth[j] * arrays.idepth[j];
                    num += 1.0;
                }
            }
        }
        if sum_w <= 0.0 {
            return None;
        }
        let idepth = sum_d / sum_w;
        let spread = (sum_dd / sum_w - idepth * idepth).max(0.0);
        let var = num / sum_w + 2.0 * spread + config.fill_relative_var * idepth * idepth;
        Some(Hypothesis {
            idepth,
            var: var.min(MAX_VAR),
            prior_var: f32::INFINITY,
            validity: 0,
        })
    }
}

impl DepthMap {
    /// Limits the search for new pixels to `config.near_search_factor` times the 98th percentile of
    /// what is known: a range that the scene does not have only adds false matches and time.
    pub(crate) fn limit_search(&mut self, config: &DepthConfig) {
        /// Bins per unit of inverse depth, and their number.
        const BINS_PER_UNIT: f32 = 8.0;
        const BINS: usize = 128;
        /// Fewer known pixels say nothing.
        const ENOUGH: u32 = 1000;
        let mut bins = [0u32; BINS];
        let mut total = 0u32;
        let Arrays {
            validity, idepth, ..
        } = &self.arrays;
        self.all_candidates().for_each(|(_, _, i)| {
            if validity[i] >= 10 {
                bins[((idepth[i] * BINS_PER_UNIT).max(0.0) as usize).min(BINS - 1)] += 1;
                total += 1;
            }
        });
        self.near_limit = config.max_idepth;
        if total < ENOUGH {
            return;
        }
        let mut beyond = 0;
        let nearest = (0..BINS).rev().find(|&bin| {
            beyond += bins[bin];
            50 * beyond > total
        });
        let percentile = (nearest.unwrap_or(BINS) + 1) as f32 / BINS_PER_UNIT;
        let limit = config.near_search_factor * percentile.max(1.0);
        self.near_limit = config.max_idepth.min(limit);
    }
}

impl RegularizeBand<'_> {
    /// Computes the smoothed values of the band's rows.
    pub fn regularize(&mut self, config: &DepthConfig) {
        let first_needed = self.first_row.saturating_sub(RADIUS) * self.width;
        let end = (self.first_row + self.num_rows + RADIUS) * self.width;
        let validity = &self.arrays.validity;
        let needed = validity[first_needed..end.min(validity.len())].iter();
        // converted once, not once for each of the 25 pixels that look at it
        let validity: Vec<f32> = needed.map(|v| f32::from(*v)).collect();
        let validity = (first_needed, validity.as_slice());
        let candidates = self.candidates;
        for row in 0..self.num_rows {
            let y = self.first_row + row;
            for &x in candidates.row(y) {
                let x = usize::from(x);
                let out = row * self.width + x;
                self.smooth_var[out] = 0.0;
                if self.arrays.var[y * self.width + x] > 0.0
                    && let Some(smoothed) = smoothed(self, (x, y), validity, config)
                {
                    (self.smooth_idepth[out], self.smooth_var[out]) = smoothed;
                }
            }
        }
    }
}

for_lanes! {
    /// `[SDVO13]` section 2.4: mean over the consistent neighbours, weighted by `1 / (V + (slope
    /// distance)²)`; `None` when too few neighbours are valid. The validities of the band and the
    /// rows beside it begin at the index `first` of the map.
    ///
    /// For each pixel one call: in one function with the loop over them the vectors do not stay in
    /// registers.
    fn smoothed = smoothed_with, (
        band: &RegularizeBand<'_>,
        pixel: (usize, usize),
        validity: (usize, &[f32]),
        config: &DepthConfig,
    ) -> Option<(f32, f32)>;
}

#[inline(always)]
fn smoothed_with<L: Lanes>(
    eight: L,
    band: &RegularizeBand<'_>,
    (x, y): (usize, usize),
    (first, validity): (usize, &[f32]),
    config: &DepthConfig,
) -> Option<(f32, f32)> {
    let arrays = band.arrays;
    let w = band.width;
    let i = y * w + x;
    let (idepth, var) = (arrays.idepth[i], arrays.var[i]);
    let slope = config.smoothing_per_px * idepth;
    let slope_sq = eight.splat(slope * slope);
    let (idepth_lanes, var_lanes) = (eight.splat(idepth), eight.splat(var));
    let (zero, one) = (eight.splat(0.0), eight.splat(1.0));
    let (column_sq, column_used) = (eight.f32s(&COLUMN_SQ), eight.f32s(&COLUMN_USED));
    let (mut sum_w, mut sum_d, mut support, mut all) = (zero, zero, zero, zero);
    for (dy, row_sq) in ROW_SQ.into_iter().enumerate() {
        let start = (y + dy - RADIUS) * w + x - RADIUS;
        let vars = eight.f32s(lanes(&arrays.var, start)?);
        let gaps = eight.f32s(lanes(&arrays.idepth, start)?) - idepth_lanes;
        let validities = eight.f32s(lanes(validity, start - first)?);
        let known = vars.gt(zero) & column_used.gt(zero);
        let used = known & (gaps * gaps).le(var_lanes + vars);
        let weights = used & (one / (vars + slope_sq * (column_sq + row_sq)));
        sum_w += weights;
        sum_d += used & (weights * gaps);
        support += used & validities;
        all += known & validities;
    }
    // a filled pixel has no validity of its own and lives from its neighbours
    let supporting = support.sum();
    if supporting < f32::from(MIN_SUPPORT_KEEP) || supporting < config.min_support_share * all.sum()
    {
        return None;
    }
    let weight = sum_w.sum();
    let smooth_var = (1.0 / weight).max(var / config.max_smoothing_gain);
    Some((idepth + sum_d.sum() / weight, smooth_var))
}

/// Columns are processed together, five neighbours and three idle ones, so that the loop has no
/// branches.
const COLUMN_USED: [f32; LANES] = [1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
const COLUMN_SQ: [f32; LANES] = [4.0, 1.0, 0.0, 1.0, 4.0, 0.0, 0.0, 0.0];
const ROW_SQ: [f32; 2 * RADIUS + 1] = [4.0, 1.0, 0.0, 1.0, 4.0];

/// The sum of the first five bytes of rows, at most five of them; what is unknown has no validity.
#[inline]
fn sum_of_fives<'a>(rows: impl Iterator<Item = &'a [u8; LANES]>) -> u32 {
    const FIVE: u64 = 0xff_ffff_ffff;
    const EVEN: u64 = 0x00ff_00ff_00ff_00ff;
    let words = rows.map(|row| u64::from_le_bytes(*row) & FIVE);
    // four sums of 16 bits side by side
    let sums: u64 = words.map(|word| (word & EVEN) + (word >> 8 & EVEN)).sum();
    (sums.wrapping_mul(0x0001_0001_0001_0001) >> 48) as u32
}

/// The eight values from `start`; the border of the candidates keeps them inside the row.
#[inline]
fn lanes<T>(values: &[T], start: usize) -> Option<&[T; LANES]> {
    values.get(start..start + LANES)?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HostFrame;
    use monogrid_geometry::Pinhole;
    use monogrid_image::lanes::Baseline;
    use monogrid_image::{GrayImage, Mask};
    use std::sync::Arc;

    fn textured() -> Arc<HostFrame> {
        let image =
            GrayImage::from_fn(64, 48, |x, y| 100.0 + 40.0 * ((x * 7 + y * 3) as f32).sin());
        let pinhole = Pinhole::new(60.0, 60.0, 31.5, 23.5);
        Arc::new(HostFrame::new(image, Mask::filled(64, 48, 255), pinhole).expect("valid"))
    }

    /// The same sum, neighbour by neighbour.
    fn plain(map: &DepthMap, x: usize, y: usize, config: &DepthConfig) -> Option<(f32, f32)> {
        let at = |x: usize, y: usize| {
            let i = y * 64 + x;
            (
                map.arrays.idepth[i],
                map.arrays.var[i],
                f32::from(map.arrays.validity[i]),
            )
        };
        let (idepth, var, _) = at(x, y);
        let (mut weights, mut sum, mut support, mut all) = (0.0, 0.0, 0.0, 0.0);
        for yy in y - 2..=y + 2 {
            for xx in x - 2..=x + 2 {
                let (d, v, validity) = at(xx, yy);
                if v <= 0.0 {
                    continue;
                }
                all += validity;
                if (d - idepth).powi(2) > var + v {
                    continue;
                }
                support += validity;
                let dist_sq = (xx.abs_diff(x).pow(2) + yy.abs_diff(y).pow(2)) as f32;
                let weight = 1.0 / (v + (config.smoothing_per_px * idepth).powi(2) * dist_sq);
                weights += weight;
                sum += weight * d;
            }
        }
        let kept =
            support >= f32::from(MIN_SUPPORT_KEEP) && support >= config.min_support_share * all;
        kept.then_some((
            sum / weights,
            (1.0 / weights).max(var / config.max_smoothing_gain),
        ))
    }

    #[test]
    fn sums_of_fives_are_those_of_single_bytes() {
        for seed in 0..50_u8 {
            let byte = |k: u8| k.wrapping_mul(73).wrapping_add(seed.wrapping_mul(31)) | seed << 6;
            let rows: [[u8; LANES]; 5] =
                std::array::from_fn(|row| std::array::from_fn(|k| byte((8 * row + k) as u8)));
            let plain = rows.iter().flat_map(|row| &row[..5]);
            let plain: u32 = plain.map(|byte| u32::from(*byte)).sum();
            assert_eq!(sum_of_fives(rows.iter()), plain);
        }
        assert_eq!(sum_of_fives([[255; LANES]; 5].iter()), 25 * 255);
    }

    #[test]
    fn smoothing_in_lanes_equals_the_plain_sum_for_any_bands() {
        for config in [DepthConfig::default(), DepthConfig::thesis()] {
            let mut map = DepthMap::empty(textured(), &config);
            map.initialize_random(3);
            // holes and different certainties
            for i in 0..map.arrays.var.len() {
                map.arrays.var[i] *= [0.0, 0.001, 0.3, 1.0, 0.02][i % 5];
                map.arrays.validity[i] = (i % 7) as u8;
            }
            let mut expected = Vec::new();
            for y in 0..48 {
                for &x in map.candidates.row(y) {
                    let x = usize::from(x);
                    if map.arrays.var[y * 64 + x] > 0.0 {
                        expected.push((y * 64 + x, plain(&map, x, y, &config)));
                    }
                }
            }
            let validity: Vec<f32> = map.arrays.validity.iter().map(|v| f32::from(*v)).collect();
            for band in map.regularize_bands(48) {
                for (i, _) in &expected {
                    let (pixel, validity) = ((i % 64, i / 64), (0, validity.as_slice()));
                    let widest = smoothed(&band, pixel, validity, &config);
                    let baseline = smoothed_with(Baseline, &band, pixel, validity, &config);
                    assert_eq!(widest, baseline);
                }
            }
            for rows in [1, 5, 48] {
                for mut band in map.regularize_bands(rows) {
                    band.regularize(&config);
                }
                let (mut kept, mut dropped) = (0, 0);
                for (i, value) in &expected {
                    let got = (map.smooth_idepth[*i], map.smooth_var[*i]);
                    if let Some((d, v)) = value {
                        assert!((got.0 - d).abs() < 1e-5, "{got:?} {d} {v}");
                        assert!((got.1 / v - 1.0).abs() < 1e-4, "{got:?} {d} {v}");
                        kept += 1;
                    } else {
                        assert!(got.1 == 0.0);
                        dropped += 1;
                    }
                }
                assert!(kept > 100 && dropped > 10, "{kept} {dropped}");
            }
        }
    }

    /// Mean and number of confirmed neighbours, neighbour by neighbour, when they are confirmed
    /// enough.
    fn plain_hole(map: &DepthMap, index: usize, config: &DepthConfig) -> Option<f32> {
        let (mut support, mut weights, mut sum) = (0u32, 0.0, 0.0);
        for j in (0..25).map(|k| index + 64 * (k / 5) + k % 5 - 2 * 64 - 2) {
            let (var, validity) = (map.arrays.var[j], map.arrays.validity[j]);
            if var > 0.0 && validity > 0 {
                support += u32::from(validity);
                weights += 1.0 / var;
                sum += 1.0 / var * map.arrays.idepth[j];
            }
        }
        (support > u32::from(config.min_support_fill)).then(|| sum / weights)
    }

    #[test]
    fn holes_are_those_that_a_plain_count_finds() {
        let (mut filled, mut left) = (0, 0);
        for min_support_fill in [30, 55, 70] {
            let config = DepthConfig {
                min_support_fill,
                ..DepthConfig::default()
            };
            let mut map = DepthMap::empty(textured(), &config);
            map.initialize_random(5);
            for i in 0..map.arrays.var.len() {
                map.arrays.var[i] *= [0.0, 0.001, 0.3, 1.0, 0.02][i % 5];
                let is_known = u8::from(map.arrays.var[i] > 0.0);
                map.arrays.validity[i] = (i * i % 11 % 7) as u8 * is_known;
            }
            let found = map.holes(0..48, &config);
            let mut found = found.iter().peekable();
            for y in 0..48 {
                for index in map
                    .candidates
                    .row(y)
                    .iter()
                    .map(|x| y * 64 + usize::from(*x))
                {
                    if map.arrays.var[index] > 0.0 || map.arrays.failures[index] > 2 {
                        continue;
                    }
                    let hole = found.next_if(|hole| hole.index == index);
                    let expected = plain_hole(&map, index, &config);
                    assert_eq!(hole.map(|hole| hole.hypothesis.idepth), expected);
                    (filled, left) = match expected {
                        Some(_) => (filled + 1, left),
                        None => (filled, left + 1),
                    };
                }
            }
            assert!(found.next().is_none());
        }
        assert!(filled > 100 && left > 100, "{filled} filled, {left} left");
    }

    #[test]
    fn a_hole_gets_the_depth_of_its_neighbours_without_their_confirmation() {
        let config = DepthConfig::default();
        let mut map = DepthMap::empty(textured(), &config);
        map.initialize_constant(0.8, 1e-4);
        let x = usize::from(map.candidates.row(20)[10]);
        map.arrays.clear(20 * 64 + x);
        assert_eq!(map.fill_holes(&config), 1);
        let filled = map.at(x, 20).expect("filled");
        assert!((filled.idepth - 0.8).abs() < 1e-5 && map.arrays.validity[20 * 64 + x] == 0);
        assert!(filled.idepth_var > 1e-4);
    }

    #[test]
    fn a_pixel_that_disagrees_with_all_its_neighbours_is_dropped() {
        let config = DepthConfig::default();
        let mut map = DepthMap::empty(textured(), &config);
        map.initialize_constant(0.8, 1e-4);
        let before = map.num_known();
        let x = usize::from(map.candidates.row(20)[10]);
        map.arrays.idepth[20 * 64 + x] = 1.3;
        map.regularize(&config);
        assert_eq!(map.at(x, 20), None);
        assert_eq!(map.num_known(), before - 1);
    }
}
