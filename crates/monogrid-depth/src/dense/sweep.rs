//! How well the sources agree with each plane: the cost volume.

use super::DenseConfig;
use super::warp::{Source, Warped};
use monogrid_image::GrayImage;

/// Half the edge of the compared windows, px.
pub(super) const RADIUS: usize = 2;
/// Pixels of a window.
const WINDOW: f32 = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
/// The cost of windows that do not correlate at all, and of those that no source sees.
pub(super) const MAX_COST: u8 = 60;

/// The cost of every plane at every pixel.
#[derive(Debug)]
pub(super) struct CostVolume {
    pub width: usize,
    pub height: usize,
    /// Inverse depths of the planes, ascending in equal steps.
    pub idepths: Vec<f32>,
    /// By row, column and plane: 0 (the sources look the same) to [`MAX_COST`].
    pub costs: Vec<u8>,
}

impl CostVolume {
    /// One less the normalised correlation of windows of the keyframe with those of the sources, the mean of the
    /// two best: in others the surface may be covered.
    pub fn new(
        image: &GrayImage,
        sources: &[Source],
        idepths: Vec<f32>,
        config: &DenseConfig,
    ) -> Self {
        let (width, height) = (image.width(), image.height());
        let mut correlation = Correlation::new(image, config);
        let mut warped = Warped::new(width, height);
        let mut best = vec![[f32::INFINITY; 2]; width * height];
        let mut costs = vec![MAX_COST; width * height * idepths.len()];
        for (k, idepth) in idepths.iter().enumerate() {
            best.fill([f32::INFINITY; 2]);
            for source in sources {
                source.warp(*idepth, &mut warped);
                correlation.with_source(&warped, &mut best);
            }
            let of_plane = costs.iter_mut().skip(k).step_by(idepths.len());
            for (cost, best) in of_plane.zip(&best) {
                *cost = joined(*best);
            }
        }
        Self {
            width,
            height,
            idepths,
            costs,
        }
    }

    /// The costs of the planes at a pixel.
    pub fn at(&self, pixel: usize) -> &[u8] {
        let count = self.idepths.len();
        &self.costs[pixel * count..(pixel + 1) * count]
    }
}

/// The cost by the two best sources, or by the only one.
fn joined([first, second]: [f32; 2]) -> u8 {
    let cost = if second.is_finite() {
        0.5 * (first + second)
    } else {
        first
    };
    (cost.min(1.0) * f32::from(MAX_COST) + 0.5) as u8
}

/// Correlation of the windows of a keyframe with those of warped sources.
struct Correlation<'a> {
    image: &'a GrayImage,
    /// Variance of the noise of a window times its pixels.
    noise: f32,
    /// Sum and inverse deviation of each window of the keyframe.
    windows: Vec<[f32; 2]>,
    /// By column, over the rows of a window: sums of the warped image, its squares, and its products with the keyframe.
    columns: [Vec<f32>; 3],
}

impl<'a> Correlation<'a> {
    fn new(image: &'a GrayImage, config: &DenseConfig) -> Self {
        let (width, height) = (image.width(), image.height());
        let noise = WINDOW * (config.grey_sigma * config.grey_sigma) as f32;
        let mut windows = vec![[0.0; 2]; width * height];
        for y in RADIUS..height.saturating_sub(RADIUS) {
            for x in RADIUS..width.saturating_sub(RADIUS) {
                let (mut sum, mut squares) = (0.0, 0.0);
                for row in y - RADIUS..=y + RADIUS {
                    for value in &image.row(row)[x - RADIUS..=x + RADIUS] {
                        sum += value;
                        squares += value * value;
                    }
                }
                windows[y * width + x] = [sum, 1.0 / deviation(sum, squares, noise)];
            }
        }
        Self {
            image,
            noise,
            windows,
            columns: std::array::from_fn(|_| vec![0.0; width]),
        }
    }

    /// Puts the costs by one source among the two best of each pixel.
    fn with_source(&mut self, warped: &Warped, best: &mut [[f32; 2]]) {
        let (width, height) = (self.image.width(), self.image.height());
        self.columns.iter_mut().for_each(|sums| sums.fill(0.0));
        for y in 0..height {
            self.add_row(1.0, y, warped);
            let Some(middle) = y.checked_sub(RADIUS).filter(|m| *m >= RADIUS) else {
                continue;
            };
            let inner = middle * width + RADIUS..(middle + 1) * width - RADIUS;
            self.compare_row(
                &self.windows[inner.clone()],
                &warped.is_seen[inner.clone()],
                &mut best[inner],
            );
            self.add_row(-1.0, middle - RADIUS, warped);
        }
    }

    /// Adds a row to the sums of the columns, or takes it away.
    fn add_row(&mut self, sign: f32, y: usize, warped: &Warped) {
        let width = self.image.width();
        let own = self.image.row(y);
        let grey = &warped.grey[y * width..(y + 1) * width];
        let [sums, squares, products] = &mut self.columns;
        for ((((sum, square), product), own), value) in sums
            .iter_mut()
            .zip(squares)
            .zip(products)
            .zip(own)
            .zip(grey)
        {
            let signed = sign * value;
            *sum += signed;
            *square += signed * value;
            *product += signed * own;
        }
    }

    /// The costs of the windows around one row.
    fn compare_row(&self, windows: &[[f32; 2]], is_seen: &[bool], best: &mut [[f32; 2]]) {
        let [sums, squares, products] = &self.columns;
        let there = sums_of_windows(sums)
            .zip(sums_of_windows(squares))
            .zip(sums_of_windows(products));
        let here = windows.iter().zip(is_seen).zip(best);
        for ((([own_sum, own_inverse], is_seen), best), ((sum, squares), products)) in
            here.zip(there)
        {
            let covariance = products - own_sum * sum / WINDOW;
            let correlation = covariance * own_inverse / deviation(sum, squares, self.noise);
            let cost = if *is_seen {
                1.0 - correlation
            } else {
                f32::INFINITY
            };
            *best = [best[0].min(cost), best[1].min(best[0].max(cost))];
        }
    }
}

/// Root of the sum of the squared deviations in a window, with those that noise makes: plain windows correlate with
/// nothing.
#[inline]
fn deviation(sum: f32, squares: f32, noise: f32) -> f32 {
    ((squares - sum * sum / WINDOW).max(0.0) + noise).sqrt()
}

/// Sums over the columns of a window.
fn sums_of_windows(columns: &[f32]) -> impl Iterator<Item = f32> + '_ {
    columns
        .windows(2 * RADIUS + 1)
        .map(|w| (w[0] + w[1]) + (w[2] + w[3]) + w[4])
}
