//! A pinhole image of ranges, filled by votes of measurements.

use crate::for_avx2::for_avx2;
use crate::integrate::image::chunks::Chunk;
use crate::integrate::image::extremes::higher;
use crate::sensor::table::TableSet;

/// Axes (right, down, forward) of the image of a forward-looking sensor.
pub(super) const FORWARD: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// Pixels along the edge of a cell's footprint at the mean range.
pub(super) const PIXELS_PER_CELL: f64 = 2.5;
/// Ranges that differ by less than this share of themselves are of one surface. A tenth would join
/// furniture with the wall behind it at a range where nothing is.
pub(super) const ONE_SURFACE: f32 = 0.05;
/// Slopes that an image spans at least, along each of its axes.
pub(crate) const NARROWEST_SLOPES: f64 = 1e-3;
/// Most pixels of one image.
const MAX_PIXELS: f64 = 4e6;

/// Range marking a pixel without a measurement.
pub(crate) const HOLE: f32 = 0.0;

/// What was measured in a pixel of an image that is being filled.
#[derive(Clone, Copy, Debug, Default)]
struct Ballot {
    /// Sum of the ranges that voted for it.
    sum: f32,
    /// Votes for this range, a whole number.
    votes: f32,
}

/// Votes of a pixel, at most: sums of more would be too inexact.
const MOST_VOTES: f32 = 65_535.0;

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
    /// Range of each pixel in map units, or [`HOLE`].
    pub ranges: Vec<f32>,
    /// Evidence table of each pixel's measurement; empty if all have the first.
    pub tables: Vec<u16>,
    /// Measurements per filled pixel, at least 1.
    pub density: f32,
}

/// The nearest whole number of a value below 2^23, of one below 0 that is 0: without a conversion,
/// of which a processor does one at a time.
#[inline(always)]
fn nearest(value: f32) -> u32 {
    const SHIFT: f32 = 8_388_608.0;
    (higher(value, 0.0) + SHIFT)
        .to_bits()
        .wrapping_sub(SHIFT.to_bits())
}

impl RangeImage {
    /// The column of a slope.
    #[inline(always)]
    pub(super) fn column_of(&self, u: f32) -> u32 {
        nearest(u * self.focal[0] + self.center[0]).min(self.width as u32 - 1)
    }

    /// Where the row of a slope begins.
    #[inline(always)]
    pub(super) fn row_of(&self, v: f32) -> u32 {
        nearest(v * self.focal[1] + self.center[1]).min(self.height as u32 - 1) * self.width as u32
    }

    /// Closes gaps of one pixel between opposite measurements of one surface, at the
    /// mean of their inverse ranges (exact on planes).
    fn fill_gaps(&mut self) {
        let (width, height) = (self.width, self.height);
        if width < 3 || height < 3 {
            return;
        }
        let source = self.ranges.clone();
        for row in 1..height - 1 {
            for at in row * width + 1..(row + 1) * width - 1 {
                if source[at] != HOLE {
                    continue;
                }
                let pairs = [
                    (at - 1, at + 1),
                    (at - width, at + width),
                    (at - width - 1, at + width + 1),
                    (at - width + 1, at + width - 1),
                ];
                let agree = |&(a, b): &(usize, usize)| {
                    let (a, b) = (source[a], source[b]);
                    a != HOLE && b != HOLE && (a - b).abs() <= ONE_SURFACE * a.min(b)
                };
                if let Some((a, b)) = pairs.into_iter().find(agree) {
                    if !self.tables.is_empty() {
                        self.tables[at] = self.tables[a];
                    }
                    let (a, b) = (source[a], source[b]);
                    self.ranges[at] = 2.0 * a * b / (a + b);
                }
            }
        }
    }
}

impl Ballot {
    /// Ranges of one surface are averaged; where they are not, the majority stays (Boyer and
    /// Moore's vote).
    #[inline(always)]
    fn with_vote_for(self, range: f32) -> Self {
        let Self { sum, votes } = self;
        // Also the first of a pixel: one branch that is nearly always taken.
        if (range * votes - sum).abs() <= ONE_SURFACE * sum {
            let added = if votes < MOST_VOTES { range } else { 0.0 };
            return Self {
                sum: sum + added,
                votes: (votes + 1.0).min(MOST_VOTES),
            };
        }
        let taken = if votes > 1.0 { sum / votes } else { 0.0 };
        Self {
            sum: if votes == 0.0 { range } else { sum - taken },
            // One less, but for a new range one.
            votes: (votes - 1.0).abs(),
        }
    }
}

for_avx2! {
    /// Adds measurements to pixels.
    fn vote_for_each(ballots: &mut [Ballot], pixels: &[u32], ranges: &[f32]) {
        for (&pixel, &range) in pixels.iter().zip(ranges) {
            let ballot = &mut ballots[pixel as usize];
            *ballot = ballot.with_vote_for(range);
        }
    }
}

for_avx2! {
    /// The pixels of measurements.
    fn pixels_of(image: &RangeImage, chunk: &Chunk, pixels: &mut [u32; Chunk::LEN]) {
        for (i, pixel) in pixels.iter_mut().enumerate() {
            *pixel = image.row_of(chunk.v[i]) + image.column_of(chunk.u[i]);
        }
    }
}

for_avx2! {
    /// Means of votes.
    fn means(ballots: &[Ballot]) -> Vec<f32> {
        ballots.iter().map(|ballot| ballot.sum / higher(ballot.votes, 1.0)).collect()
    }
}

/// An image that is being filled.
pub(super) struct Filling {
    pub image: RangeImage,
    ballots: Vec<Ballot>,
}

impl Filling {
    /// An image without measurements between two slopes, with the focal lengths `native`, or in
    /// their proportion less: at most `finest` along u.
    pub(super) fn new(
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
        let image = RangeImage {
            axes,
            width: size[0],
            height: size[1],
            focal,
            center: [-low[0] * focal[0], -low[1] * focal[1]],
            ranges: Vec::new(),
            tables: Vec::new(),
            density: 1.0,
        };
        Self {
            image,
            ballots: vec![Ballot::default(); size[0] * size[1]],
        }
    }

    /// Adds measurements.
    pub(super) fn vote_all(&mut self, chunk: &Chunk, tables: &mut TableSet) {
        let mut pixels = [0; Chunk::LEN];
        pixels_of(&self.image, chunk, &mut pixels);
        let (pixels, ranges) = (&pixels[..chunk.len], &chunk.ranges[..chunk.len]);
        let common = chunk
            .common_sigma
            .and_then(|sigma| tables.prepare_for_all(sigma));
        if common == Some(0) && self.image.tables.is_empty() {
            return vote_for_each(&mut self.ballots, pixels, ranges);
        }
        for (i, (&pixel, &range)) in pixels.iter().zip(ranges).enumerate() {
            let table = common.unwrap_or_else(|| tables.prepare(range, chunk.sigmas[i]));
            self.vote(pixel as usize, range, table);
        }
    }

    /// Adds a measurement to the pixel `index`.
    #[inline]
    pub(super) fn vote(&mut self, index: usize, range: f32, table: u16) {
        let ballot = &mut self.ballots[index];
        let is_first = ballot.votes == 0.0;
        *ballot = ballot.with_vote_for(range);
        // The first vote for a range brings its table.
        let tables = &mut self.image.tables;
        if table != 0 && tables.is_empty() {
            *tables = vec![0; self.ballots.len()];
        }
        if is_first && !tables.is_empty() {
            tables[index] = table;
        }
    }

    /// The image of `count` measurements.
    pub(super) fn finish(self, count: usize) -> RangeImage {
        let mut image = self.image;
        image.ranges = means(&self.ballots);
        let filled = image.ranges.iter().filter(|&&range| range != HOLE).count();
        image.density = (count as f32 / filled.max(1) as f32).max(1.0);
        image.fill_gaps();
        image
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn votes_side_by_side_are_those_one_by_one_and_the_first_for_a_range_brings_its_table() {
        // Ranges of two surfaces, in four pixels.
        let votes: Vec<(usize, f32, u16)> = (0..200_u16)
            .map(|i| {
                let range = 2.0 + 0.01 * f32::from(i % 7) + f32::from(u8::from(i % 5 > 2));
                (usize::from(i / 3 % 4), range, i % 3)
            })
            .collect();
        let new = || Filling::new(FORWARD, [[0.0; 2], [1.0; 2]], [1.0; 2], 1.0);
        let mut found = new();
        votes
            .iter()
            .for_each(|&(pixel, range, table)| found.vote(pixel, range, table));
        let (pixels, ranges): (Vec<u32>, Vec<f32>) = votes
            .iter()
            .map(|&(pixel, range, _)| (pixel as u32, range))
            .unzip();
        let mut side_by_side = new();
        vote_for_each(&mut side_by_side.ballots, &pixels, &ranges);
        for pixel in 0..4 {
            // Mean, votes and table of the range that holds the pixel.
            let (mut mean, mut count, mut table) = (0.0_f64, 0, 0);
            for &(_, range, of) in votes.iter().filter(|vote| vote.0 == pixel) {
                let range = f64::from(range);
                if count == 0 {
                    (mean, table) = (range, of);
                }
                let agrees = (range - mean).abs() <= f64::from(ONE_SURFACE) * mean;
                if agrees {
                    mean += (range - mean) / f64::from(count + 1);
                }
                count += if agrees { 1 } else { -1 };
            }
            let Ballot { sum, votes } = found.ballots[pixel];
            assert_eq!(votes, count as f32);
            let expected = mean * f64::from(count.max(1));
            assert!((f64::from(sum) - expected).abs() < 1e-5 * expected);
            assert_eq!(found.image.tables[pixel], table);
            let alike = side_by_side.ballots[pixel];
            assert_eq!((alike.sum, alike.votes), (sum, votes));
        }
    }
}
