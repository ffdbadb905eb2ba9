//! How well the sources agree with each plane: the cost volume.

use super::DenseConfig;
use super::warp::{LANES, Source, WarpOfPlane, padded, sums_of_four};
use monogrid_image::Image;
use wide::{f32x8, i16x8, i32x8};

/// Half the edge of the compared windows, px.
pub(super) const RADIUS: usize = 2;
/// Edge of the windows, px.
const EDGE: usize = 2 * RADIUS + 1;
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
    /// One less the normalised correlation of windows of the keyframe with those of the sources at half their size, the mean of the
    /// two best: in others the surface may be covered.
    pub fn new(
        image: &Image<u8>,
        sources: &[Source],
        idepths: Vec<f32>,
        config: &DenseConfig,
    ) -> Self {
        let image = sums_of_four(image);
        let (width, height) = (image.width(), image.height());
        let windows = Windows::new(&image, config);
        let mut strips: Vec<Strip> = sources.iter().map(|_| Strip::new(width)).collect();
        let mut best = Best(std::array::from_fn(|_| vec![f32::INFINITY; padded(width)]));
        let planes = idepths.len();
        // by row, plane and column, as they are found
        let mut costs = vec![MAX_COST; width * height * planes];
        for (k, idepth) in idepths.iter().enumerate() {
            let warps: Vec<WarpOfPlane<'_>> = sources.iter().map(|s| s.at(*idepth)).collect();
            strips.iter_mut().for_each(Strip::clear);
            for y in 0..height {
                best.0.iter_mut().for_each(|b| b.fill(f32::INFINITY));
                // the row in the middle of the windows that end with this one
                let middle = y.checked_sub(RADIUS).filter(|middle| *middle >= RADIUS);
                for (strip, warp) in strips.iter_mut().zip(&warps) {
                    strip.take_row(y, warp, &windows);
                    if let Some(middle) = middle {
                        strip.compare(middle, &windows, &mut best);
                    }
                }
                if let Some(middle) = middle {
                    let row = (middle * planes + k) * width;
                    best.costs(&mut costs[row + RADIUS..row + width - RADIUS]);
                }
            }
        }
        by_pixel(&mut costs, width, planes);
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

/// From costs by plane and column to costs by column and plane, row by row.
fn by_pixel(costs: &mut [u8], width: usize, planes: usize) {
    let mut of_row = vec![0; width * planes];
    for row in costs.chunks_exact_mut(width * planes) {
        of_row.copy_from_slice(row);
        for (x, pixel) in row.chunks_exact_mut(planes).enumerate() {
            for (to, of) in pixel.iter_mut().zip(of_row[x..].iter().step_by(width)) {
                *to = *of;
            }
        }
    }
}

/// The keyframe and its windows, in rows that are a multiple of the lanes long. Grey levels are in quarters, so that all sums are
/// whole numbers and exact.
struct Windows {
    /// Length of the rows.
    row: usize,
    /// Variance of the noise of a window times the square of its pixels.
    noise: f32,
    grey: Vec<i16>,
    /// The sum of the window *from* each pixel to the right, around its row.
    sums: Vec<i16>,
    /// One over the root of the variance of the same times the square of its pixels.
    inverse_deviations: Vec<f32>,
}

/// Pixels of a window.
const WINDOW: i32 = (EDGE * EDGE) as i32;
/// Parts of a grey level.
const QUARTERS: f64 = 4.0;

impl Windows {
    fn new(image: &Image<u16>, config: &DenseConfig) -> Self {
        let (row, height) = (padded(image.width()), image.height());
        let grey_sigma = QUARTERS * config.grey_sigma * f64::from(WINDOW);
        let mut windows = Self {
            row,
            noise: (grey_sigma * grey_sigma) as f32,
            grey: vec![0; row * height],
            sums: vec![0; row * height],
            inverse_deviations: vec![0.0; row * height],
        };
        for (y, grey) in windows.grey.chunks_exact_mut(row).enumerate() {
            let own = grey.iter_mut().zip(image.row(y));
            own.for_each(|(grey, own)| *grey = *own as i16);
        }
        for y in RADIUS..height.saturating_sub(RADIUS) {
            for x in 0..(image.width() + 1).saturating_sub(EDGE) {
                let (mut sum, mut squares) = (0, 0);
                for other in y - RADIUS..=y + RADIUS {
                    for value in &image.row(other)[x..x + EDGE] {
                        sum += i32::from(*value);
                        squares += i32::from(*value).pow(2);
                    }
                }
                let variance = (WINDOW * squares - sum * sum) as f32 + windows.noise;
                windows.sums[y * row + x] = sum as i16;
                windows.inverse_deviations[y * row + x] = 1.0 / variance.sqrt();
            }
        }
        windows
    }

    /// A row of one of the images.
    fn row<'a, T>(&self, of: &'a [T], y: usize) -> &'a [[T; LANES]] {
        of[y * self.row..(y + 1) * self.row].as_chunks().0
    }
}

/// The last rows of a warped source, and the sums over their columns.
struct Strip {
    /// Grey levels of the last rows, each where its number modulo their count says.
    rows: [Vec<i16>; EDGE],
    /// 0 where the source sees the pixel, else infinite; likewise.
    unseen: [Vec<f32>; EDGE],
    /// The row that comes.
    next: Vec<i16>,
    /// By column, over the rows of a window: sums of the warped source, ...
    sums: Vec<i16>,
    /// ... of its squares, and of its products with the keyframe.
    squares: Vec<i32>,
    products: Vec<i32>,
}

impl Strip {
    fn new(width: usize) -> Self {
        // windows begin up to the end of a row and reach beyond it
        let columns = padded(width) + LANES;
        Self {
            rows: std::array::from_fn(|_| vec![0; padded(width)]),
            unseen: std::array::from_fn(|_| vec![0.0; columns]),
            next: vec![0; padded(width)],
            sums: vec![0; columns],
            squares: vec![0; columns],
            products: vec![0; columns],
        }
    }

    fn clear(&mut self) {
        self.rows.iter_mut().for_each(|row| row.fill(0));
        self.sums.fill(0);
        self.squares.fill(0);
        self.products.fill(0);
    }

    /// Warps the next row; the sums of the columns are then those of it and the four before.
    fn take_row(&mut self, y: usize, warp: &WarpOfPlane<'_>, windows: &Windows) {
        let place = y % EDGE;
        warp.row(y, &mut self.next, &mut self.unseen[place]);
        // what leaves is 0 until there are rows enough
        let left = windows.row(&windows.grey, y.saturating_sub(EDGE));
        let own = windows.row(&windows.grey, y);
        let came = self.next.as_chunks::<LANES>().0;
        let went = self.rows[place].as_chunks::<LANES>().0;
        let sums = self.sums.as_chunks_mut::<LANES>().0.iter_mut();
        let squares = self.squares.as_chunks_mut::<LANES>().0;
        let columns = sums.zip(squares).zip(self.products.as_chunks_mut().0);
        let grey = came.iter().zip(went).zip(own.iter().zip(left));
        for (((sum, square), product), ((came, went), (own, left))) in columns.zip(grey) {
            let [came, went, own, left] = [came, went, own, left].map(|lanes| i16x8::new(*lanes));
            *sum = (i16x8::new(*sum) + came - went).to_array();
            let squares = came.widening_mul(came) - went.widening_mul(went);
            *square = (i32x8::new(*square) + squares).to_array();
            let products = came.widening_mul(own) - went.widening_mul(left);
            *product = (i32x8::new(*product) + products).to_array();
        }
        std::mem::swap(&mut self.rows[place], &mut self.next);
    }

    /// Puts the costs of the windows around a row among the two best of each.
    fn compare(&self, middle: usize, windows: &Windows, best: &mut Best) {
        let unseen = &self.unseen[middle % EDGE];
        let own = windows.row(&windows.sums, middle).iter();
        let own = own.zip(windows.row(&windows.inverse_deviations, middle));
        let [first, second] = best.0.each_mut().map(|b| b.as_chunks_mut::<LANES>().0);
        let best = first.iter_mut().zip(second);
        for (eight, ((own_sum, own_inverse), (first, second))) in own.zip(best).enumerate() {
            let x = eight * LANES;
            let unseen = f32x8::new(lanes_from(unseen, x + RADIUS));
            if unseen.simd_gt(f32x8::ONE).all() {
                continue;
            }
            let sum = sum_of_window(|i| i16x8::new(lanes_from(&self.sums, x + i)));
            let squares = sum_of_window(|i| i32x8::new(lanes_from(&self.squares, x + i)));
            let products = sum_of_window(|i| i32x8::new(lanes_from(&self.products, x + i)));
            let own_sum = i16x8::new(*own_sum);
            let covariance = f32x8::from_i32x8(times_window(products) - own_sum.widening_mul(sum));
            let variance = f32x8::from_i32x8(times_window(squares) - sum.widening_mul(sum));
            // with the deviations that noise makes: plain windows correlate with nothing
            let deviation = (variance + windows.noise).sqrt();
            let correlation = covariance * f32x8::new(*own_inverse) / deviation;
            let cost = f32x8::ONE - correlation + unseen;
            let before = f32x8::new(*first);
            *first = before.fast_min(cost).to_array();
            let later = f32x8::new(*second).fast_min(before.fast_max(cost));
            *second = later.to_array();
        }
    }
}

/// Eight values from a place on, which need not be a multiple of eight; nothing beyond the end.
#[inline]
fn lanes_from<T: Copy + Default>(values: &[T], x: usize) -> [T; LANES] {
    match values[x..].first_chunk() {
        Some(lanes) => *lanes,
        None => [T::default(); LANES],
    }
}

/// The sum over the columns of a window.
#[inline]
fn sum_of_window<T: std::ops::Add<Output = T>>(column: impl Fn(usize) -> T) -> T {
    let [a, b, c, d, e]: [T; EDGE] = std::array::from_fn(column);
    (a + b) + (c + d) + e
}

/// The 25-fold, by what every processor has.
#[inline]
fn times_window(x: i32x8) -> i32x8 {
    const { assert!(WINDOW == 16 + 8 + 1) };
    (x << 4) + (x << 3) + x
}

/// The costs by the two best sources of the windows of a row.
struct Best([Vec<f32>; 2]);

impl Best {
    /// The cost by the two best sources, or by the only one.
    fn costs(&self, costs: &mut [u8]) {
        let [first, second] = &self.0;
        for ((cost, first), second) in costs.iter_mut().zip(first).zip(second) {
            let mean = if second.is_finite() {
                0.5 * (first + second)
            } else {
                *first
            };
            *cost = (mean.min(1.0) * f32::from(MAX_COST) + 0.5) as u8;
        }
    }
}
