//! How well the sources agree with each plane: the cost volume.

use super::warp::{Source, WarpOfPlane, padded, sums_of_four, warp_row};
use monogrid_image::lanes::{F32x8, I32x8, LANES, Lanes};
use monogrid_image::{Image, for_lanes};
use wide::i16x8;

/// Noise of the images, grey levels: windows with less contrast correlate with nothing.
pub(super) const GREY_SIGMA: f64 = 2.0;

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
    /// One less the normalised correlation of windows of the keyframe with those of the sources at
    /// half their size, the mean of the two best: in others the surface may be covered.
    pub fn new(image: &Image<u8>, sources: &[Source], idepths: Vec<f32>) -> Self {
        let image = sums_of_four(image);
        let (width, height) = (image.width(), image.height());
        let windows = Windows::new(&image);
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
                    warp_row(warp, y, &mut strip.next, &mut strip.unseen[y % EDGE]);
                    take_row(strip, y, &windows);
                    if let Some(middle) = middle {
                        compare(strip, middle, &windows, &mut best);
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

/// The keyframe and its windows, in rows that are a multiple of the lanes long. Grey levels are in
/// quarters, so that all sums are whole numbers and exact.
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
    fn new(image: &Image<u16>) -> Self {
        let (row, height) = (padded(image.width()), image.height());
        let grey_sigma = QUARTERS * GREY_SIGMA * f64::from(WINDOW);
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
}

for_lanes! {
    /// Takes the next row, which was warped; the sums of the columns are then those of it and the
    /// four before.
    fn take_row = take_row_with, (strip: &mut Strip, y: usize, windows: &Windows);
    /// Puts the costs of the windows around a row among the two best of each.
    fn compare = compare_with, (
        strip: &Strip,
        middle: usize,
        windows: &Windows,
        best: &mut Best,
    );
}

#[inline(always)]
fn take_row_with<L: Lanes>(eight: L, strip: &mut Strip, y: usize, windows: &Windows) {
    let place = y % EDGE;
    // what leaves is 0 until there are rows enough
    let left = windows.row(&windows.grey, y.saturating_sub(EDGE));
    let own = windows.row(&windows.grey, y);
    let came = strip.next.as_chunks::<LANES>().0;
    let went = strip.rows[place].as_chunks::<LANES>().0;
    let sums = strip.sums.as_chunks_mut::<LANES>().0.iter_mut();
    let squares = strip.squares.as_chunks_mut::<LANES>().0;
    let columns = sums.zip(squares).zip(strip.products.as_chunks_mut().0);
    let grey = came.iter().zip(went).zip(own.iter().zip(left));
    for (((sum, square), product), ((came, went), (own, left))) in columns.zip(grey) {
        *sum = (i16x8::new(*sum) + i16x8::new(*came) - i16x8::new(*went)).to_array();
        let squares = eight.products(came, came) - eight.products(went, went);
        *square = (eight.i32s(square) + squares).to_array();
        let products = eight.products(came, own) - eight.products(went, left);
        *product = (eight.i32s(product) + products).to_array();
    }
    std::mem::swap(&mut strip.rows[place], &mut strip.next);
}

#[inline(always)]
fn compare_with<L: Lanes>(
    eight: L,
    strip: &Strip,
    middle: usize,
    windows: &Windows,
    best: &mut Best,
) {
    let one = eight.splat(1.0);
    let unseen = &strip.unseen[middle % EDGE];
    let own = windows.row(&windows.sums, middle).iter();
    let own = own.zip(windows.row(&windows.inverse_deviations, middle));
    let [first, second] = best.0.each_mut().map(|b| b.as_chunks_mut::<LANES>().0);
    let best = first.iter_mut().zip(second);
    for (index, ((own_sum, own_inverse), (first, second))) in own.zip(best).enumerate() {
        let x = index * LANES;
        let unseen = eight.f32s(lanes_from(unseen, x + RADIUS, &[0.0; LANES]));
        if unseen.gt(one).bits() == 0xff {
            continue;
        }
        let column = |i: usize| i16x8::new(*lanes_from(&strip.sums, x + i, &[0; LANES]));
        let sum = sum_of_window([0, 1, 2, 3, 4].map(column)).to_array();
        let squares = sum_of_columns(eight, &strip.squares, x);
        let products = sum_of_columns(eight, &strip.products, x);
        let covariance = times_window(products) - eight.products(own_sum, &sum);
        let variance = times_window(squares) - eight.products(&sum, &sum);
        // with the deviations that noise makes: plain windows correlate with nothing
        let deviation = (variance.to_f32() + windows.noise).sqrt();
        let correlation = covariance.to_f32() * eight.f32s(own_inverse) / deviation;
        let cost = one - correlation + unseen;
        let before = eight.f32s(first);
        *first = before.min(cost).to_array();
        *second = eight.f32s(second).min(before.max(cost)).to_array();
    }
}

/// Eight values from a place on, which need not be a multiple of eight; the others where so many do
/// not follow, which is nowhere in rows as long as those of a [`Strip`].
#[inline(always)]
fn lanes_from<'a, T>(values: &'a [T], x: usize, beyond: &'a [T; LANES]) -> &'a [T; LANES] {
    values[x..].first_chunk().unwrap_or(beyond)
}

/// The sum over the columns of a window.
#[inline(always)]
fn sum_of_window<T: std::ops::Add<Output = T>>([a, b, c, d, e]: [T; EDGE]) -> T {
    (a + b) + (c + d) + e
}

/// The same of eight windows that begin at a place and after.
#[inline(always)]
fn sum_of_columns<L: Lanes>(eight: L, columns: &[i32], x: usize) -> L::I32 {
    let column = |i: usize| eight.i32s(lanes_from(columns, x + i, &[0; LANES]));
    sum_of_window([column(0), column(1), column(2), column(3), column(4)])
}

/// The 25-fold, by what every processor has.
#[inline(always)]
fn times_window<V: I32x8>(x: V) -> V {
    const { assert!(WINDOW == 16 + 8 + 1) };
    x.shl::<4>() + x.shl::<3>() + x
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
