//! The image type and how it is sampled and resized.

use crate::for_lanes;
use crate::lanes::{F32x8, I32x8, Lanes};
use wide::f32x4;

/// A dense row-major image.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Image<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

/// Grey image, values in [0, 255].
pub type GrayImage = Image<f32>;

/// Which pixels may be used: 255 valid, 0 not.
pub type Mask = Image<u8>;

impl<T: Copy> Image<T> {
    /// An image filled with `value`.
    #[must_use]
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            data: vec![value; width * height],
        }
    }

    /// An image from its pixels in row-major order; `None` unless there are `width * height` of
    /// them.
    #[must_use]
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Option<Self> {
        (data.len() == width * height).then_some(Self {
            width,
            height,
            data,
        })
    }

    /// An image whose pixels are `f(x, y)`.
    #[must_use]
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> T) -> Self {
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                data.push(f(x, y));
            }
        }
        Self {
            width,
            height,
            data,
        }
    }

    /// Width, px.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, px.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row-major.
    #[must_use]
    pub fn as_slice(&self) -> &[T] {
        &self.data
    }

    /// All pixels, row-major.
    #[must_use]
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// One row.
    #[must_use]
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// One row.
    #[must_use]
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.width..(y + 1) * self.width]
    }

    /// The pixel at column `x` and row `y`; panics outside the image like slice indexing.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> T {
        debug_assert!(x < self.width);
        self.data[y * self.width + x]
    }

    /// Sets the pixel at column `x` and row `y`; panics outside the image like slice indexing.
    pub fn set(&mut self, x: usize, y: usize, value: T) {
        debug_assert!(x < self.width);
        self.data[y * self.width + x] = value;
    }

    /// The image with every pixel mapped by `f`.
    #[must_use]
    pub fn map<U: Copy>(&self, f: impl FnMut(T) -> U) -> Image<U> {
        Image {
            width: self.width,
            height: self.height,
            data: self.data.iter().copied().map(f).collect(),
        }
    }

    /// Whether both images have the same size.
    #[must_use]
    pub fn same_size<U: Copy>(&self, other: &Image<U>) -> bool {
        self.width == other.width && self.height == other.height
    }
}

impl GrayImage {
    /// A grey image from 8-bit grey values in row-major order; `None` unless there are
    /// `width * height` of them.
    #[must_use]
    pub fn from_gray8(width: usize, height: usize, values: &[u8]) -> Option<Self> {
        Self::from_vec(
            width,
            height,
            values.iter().map(|v| f32::from(*v)).collect(),
        )
    }

    /// A grey image from 8-bit red, green and blue in row-major order; `None` unless there are
    /// `3 * width * height` of them.
    #[must_use]
    pub fn from_rgb8(width: usize, height: usize, values: &[u8]) -> Option<Self> {
        let (pixels, rest) = values.as_chunks::<3>();
        let luma = pixels.iter().map(|rgb| f32::from(luma_of_rgb(*rgb)));
        rest.is_empty()
            .then(|| Self::from_vec(width, height, luma.collect()))?
    }
}

/// ITU-601 luma of red, green and blue, rounded to 8 bits.
#[must_use]
pub fn luma_of_rgb(rgb: [u8; 3]) -> u8 {
    let [r, g, b] = rgb.map(u32::from);
    ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
}

/// A grey value rounded to 8 bits: what `round` and a conversion give, without a call for each
/// pixel.
#[must_use]
#[inline]
pub fn to_gray8(value: f32) -> u8 {
    let below = value as u8;
    below.saturating_add(u8::from(value - f32::from(below) >= 0.5))
}

/// Bilinear value at `(x, y)`; `None` outside the square of pixel centres.
#[must_use]
#[inline]
pub fn bilinear(image: &GrayImage, x: f32, y: f32) -> Option<f32> {
    let (w, h) = (image.width, image.height);
    if !(x >= 0.0 && y >= 0.0 && x <= (w as f32 - 1.0) && y <= (h as f32 - 1.0)) {
        return None;
    }
    Some(if w < 2 || h < 2 {
        linear(&image.data, if w < 2 { y } else { x })
    } else {
        bilinear_inside(image, x, y)
    })
}

/// The same at a place that is known to be inside, of an image of at least two pixels in both
/// directions.
#[must_use]
#[inline]
pub fn bilinear_inside(image: &GrayImage, x: f32, y: f32) -> f32 {
    let (w, h) = (image.width, image.height);
    let (ix, iy) = ((x as usize).min(w - 2), (y as usize).min(h - 2));
    let (fx, fy) = (x - ix as f32, y - iy as f32);
    let i = iy * w + ix;
    let (upper, lower) = (&image.data[i..i + 2], &image.data[i + w..i + w + 2]);
    let top = upper[0] + fx * (upper[1] - upper[0]);
    let bottom = lower[0] + fx * (lower[1] - lower[0]);
    top + fy * (bottom - top)
}

/// Values at eight places `(x, y)` by cubic convolution (Keys 1981, a = -1/2), which blurs less
/// than [`bilinear`]; outside the image its border goes on. Within the range of the 16 pixels
/// around, so that edges do not ring.
#[must_use]
#[inline(always)]
pub fn bicubic<L: Lanes>(lanes: L, image: &GrayImage, xs: &[f32; 8], ys: &[f32; 8]) -> [f32; 8] {
    let (w, h) = (image.width, image.height);
    if w == 0 || h == 0 {
        return [0.0; 8];
    }
    let (lefts, across) = cubic_weights(lanes, xs, w);
    let (tops, down) = cubic_weights(lanes, ys, h);
    let ends_inside = is_inside(lefts[0], w) && is_inside(lefts[7], w) && is_inside(tops[0], h);
    let follows = |k: usize| (lefts[k], tops[k]) == (lefts[0] + k as i32, tops[0]);
    if ends_inside && (1..8).all(follows) {
        let first = (lefts[0] as usize, tops[0] as usize);
        return abreast(lanes, image, first, across, down);
    }
    let [across, down] = [across, down].map(|weights| weights.map(F32x8::to_array));
    apart(image, lefts, tops, [across, down])
}

/// Values at eight places that follow each other, the first after the pixel `left` of row `top`:
/// their samples do so too, and lie in the lanes in which their places do.
#[inline(always)]
fn abreast<L: Lanes>(
    lanes: L,
    image: &GrayImage,
    (left, top): (usize, usize),
    across: [L::F32; 4],
    down: [L::F32; 4],
) -> [f32; 8] {
    let width = image.width;
    let rows = &image.data[(top - 1) * width + left - 1..][..3 * width + 11];
    // never: rows are long enough
    let beyond = &[0.0; 8];
    let mut sum = lanes.splat(0.0);
    let (mut low, mut high) = (lanes.splat(f32::MAX), lanes.splat(f32::MIN));
    for (column, weight) in across.into_iter().enumerate() {
        let row = |row: usize| {
            let samples = rows[row * width + column..].first_chunk();
            lanes.f32s(samples.unwrap_or(beyond))
        };
        let (a, b, c, d) = (row(0), row(1), row(2), row(3));
        low = low.min(a.min(b).min(c.min(d)));
        high = high.max(a.max(b).max(c.max(d)));
        let [above, at, below, last] = down;
        let part = weight * (above * a + at * b + below * c + last * d);
        sum = if column == 0 { part } else { sum + part };
    }
    sum.max(low).min(high).to_array()
}

/// Values at eight places, each with rows of samples of its own: the same bits.
#[inline(never)]
fn apart(
    image: &GrayImage,
    lefts: [i32; 8],
    tops: [i32; 8],
    weights: [[[f32; 8]; 4]; 2],
) -> [f32; 8] {
    let (w, h) = (image.width, image.height);
    let mut values = [0.0; 8];
    for (half, values) in values.as_chunks_mut::<4>().0.iter_mut().enumerate() {
        let of_half = |of: [f32; 8]| four(&of[4 * half..]);
        let [across, down] = weights.map(|weights| f32x4::transpose(weights.map(of_half)));
        let (mut rows, mut low, mut high) = ([f32x4::ZERO; 4], [f32x4::ZERO; 4], [f32x4::ZERO; 4]);
        for k in 0..4 {
            let (left, top) = (lefts[4 * half + k], tops[4 * half + k]);
            let place = (left as usize, top as usize);
            let [a, b, c, d] = if is_inside(left, w) && is_inside(top, h) {
                samples_inside(image, place)
            } else {
                samples_at_border(image, place)
            };
            low[k] = a.fast_min(b).fast_min(c.fast_min(d));
            high[k] = a.fast_max(b).fast_max(c.fast_max(d));
            let [above, at, below, last] = down[k].to_array();
            rows[k] = across[k] * (above * a + at * b + below * c + last * d);
        }
        let low = f32x4::transpose(low).into_iter().reduce(f32x4::fast_min);
        let high = f32x4::transpose(high).into_iter().reduce(f32x4::fast_max);
        let within = (low.unwrap_or_default(), high.unwrap_or_default());
        let sums = sum_of_lanes(rows);
        *values = sums.fast_max(within.0).fast_min(within.1).to_array();
    }
    values
}

/// The first four values.
#[inline(always)]
fn four(values: &[f32]) -> f32x4 {
    f32x4::new([values[0], values[1], values[2], values[3]])
}

/// Whether a line of this many pixels has one before this place and two behind it.
#[inline(always)]
fn is_inside(before: i32, length: usize) -> bool {
    before >= 1 && before as usize + 2 < length
}

/// The sixteen samples around the place between this pixel and the next ones, [inside](is_inside).
#[inline(always)]
fn samples_inside(image: &GrayImage, (left, top): (usize, usize)) -> [f32x4; 4] {
    let rows = &image.data[(top - 1) * image.width + left - 1..][..3 * image.width + 4];
    let samples = |row: usize| four(&rows[row * image.width..]);
    [samples(0), samples(1), samples(2), samples(3)]
}

/// The sixteen samples around the place between this pixel and the next ones; those beyond the
/// border are those at it.
#[cold]
fn samples_at_border(image: &GrayImage, (left, top): (usize, usize)) -> [f32x4; 4] {
    let (w, h) = (image.width, image.height);
    let columns = [-1isize, 0, 1, 2].map(|d| left.saturating_add_signed(d).min(w - 1));
    [-1isize, 0, 1, 2].map(|d| {
        let row = image.row(top.saturating_add_signed(d).min(h - 1));
        f32x4::new(columns.map(|column| row[column]))
    })
}

/// Sum of the lanes of each of four vectors, from the first lane to the last.
#[inline]
fn sum_of_lanes(vectors: [f32x4; 4]) -> f32x4 {
    let [a, b, c, d] = f32x4::transpose(vectors);
    a + b + c + d
}

/// The pixels before eight places on a line of this many pixels, and the weights of the samples at
/// -1, 0, 1, 2, places in the lanes.
#[inline(always)]
fn cubic_weights<L: Lanes>(lanes: L, places: &[f32; 8], length: usize) -> ([i32; 8], [L::F32; 4]) {
    let last = lanes.splat(length as f32 - 1.0);
    let places = lanes.f32s(places).max(lanes.splat(0.0)).min(last);
    let before = places.truncated();
    let t = places - before.to_f32();
    let (t2, t3) = (t * t, t * t * t);
    let weights = [
        (t2 * 2.0 - t3 - t) * 0.5,
        (t3 * 3.0 - t2 * 5.0 + 2.0) * 0.5,
        (t2 * 4.0 - t3 * 3.0 + t) * 0.5,
        (t3 - t2) * 0.5,
    ];
    (before.to_array(), weights)
}

/// Linear value between the samples of a line; `position` lies within them.
fn linear(samples: &[f32], position: f32) -> f32 {
    let index = position as usize;
    let next = samples[(index + 1).min(samples.len() - 1)];
    samples[index] + (position - index as f32) * (next - samples[index])
}

/// How the working image is taken from the input image: crop, then resample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resize {
    /// Output width, px.
    pub width: usize,
    /// Output height, px.
    pub height: usize,
}

/// Resamples by averaging the area that each output pixel covers (exact box filter), which neither
/// aliases nor shifts the image. Pixels are finite: others may spread to the pixels beside those
/// that cover them.
#[must_use]
pub fn resize_area(image: &GrayImage, size: Resize) -> GrayImage {
    if size.width == image.width && size.height == image.height {
        return image.clone();
    }
    if image.data.is_empty() {
        return Image::filled(size.width, size.height, 0.0);
    }
    averages(image, size)
}

/// The mask at another size: each pixel is the one of the mask that lies in its middle.
#[must_use]
pub fn resize_mask(mask: &Mask, size: Resize) -> Mask {
    let mut output = Mask::filled(size.width, size.height, 0);
    if mask.data.is_empty() {
        return output;
    }
    let middle = |at: usize, of: usize, from: usize| (2 * at + 1) * from / (2 * of);
    for y in 0..size.height {
        let row = mask.row(middle(y, size.height, mask.height));
        for (x, pixel) in output.row_mut(y).iter_mut().enumerate() {
            *pixel = row[middle(x, size.width, mask.width)];
        }
    }
    output
}

for_lanes! {
    fn averages = averages_with, (image: &GrayImage, size: Resize) -> GrayImage;
}

#[inline(always)]
fn averages_with<L: Lanes>(_: L, image: &GrayImage, size: Resize) -> GrayImage {
    let columns = Areas::new(image.width, size.width);
    let rows = Areas::new(image.height, size.height);
    let mut output = Image::filled(size.width, size.height, 0.0f32);
    // down before across: whole rows are added, and fewer are left; some weights of 0 are for what
    // is beyond the end
    let mut line = vec![0.0f32; image.width + columns.most];
    for (y, (first, weights)) in rows.iter().enumerate() {
        let covered = (first..image.height).zip(weights);
        for (k, (row, weight)) in covered.enumerate() {
            let values = line.iter_mut().zip(image.row(row));
            if k == 0 {
                values.for_each(|(sum, value)| *sum = weight * value);
            } else {
                values.for_each(|(sum, value)| *sum += weight * value);
            }
        }
        let out = output.row_mut(y);
        match columns.most {
            1 => columns.sums_of::<1>(&line, out),
            2 => columns.sums_of::<2>(&line, out),
            3 => columns.sums_of::<3>(&line, out),
            4 => columns.sums_of::<4>(&line, out),
            _ => columns.sums(&line, out),
        }
    }
    output
}

/// For each output pixel of a line the first input pixel that it covers and the normalised overlap
/// with each; 0 with those that are only there since other pixels cover more.
struct Areas {
    first: Vec<usize>,
    weights: Vec<f32>,
    /// Input pixels that one pixel covers, at most.
    most: usize,
}

impl Areas {
    fn new(input: usize, output: usize) -> Self {
        let ratio = input as f64 / output as f64;
        let covered = |i: usize| {
            let (from, to) = (i as f64 * ratio, (i as f64 + 1.0) * ratio);
            let first = from.floor() as usize;
            let last = (to.ceil() as usize).clamp(first + 1, input);
            let overlap = move |k: usize| (to.min(k as f64 + 1.0) - from.max(k as f64)).max(0.0);
            (first, last, overlap)
        };
        let counts = (0..output)
            .map(covered)
            .map(|(first, last, _)| last - first);
        let most = counts.max().unwrap_or(1);
        let weights = (0..output).flat_map(|i| {
            let (first, last, overlap) = covered(i);
            let weight = move |k| {
                if k < last {
                    (overlap(k) / ratio) as f32
                } else {
                    0.0
                }
            };
            (first..first + most).map(weight)
        });
        Self {
            weights: weights.collect(),
            first: (0..output).map(|i| covered(i).0).collect(),
            most,
        }
    }

    fn iter(&self) -> impl Iterator<Item = (usize, &[f32])> {
        let first = self.first.iter().copied();
        first.zip(self.weights.chunks_exact(self.most))
    }

    /// The weighted sums of a line, of which each has so many weights.
    #[inline(always)]
    fn sums_of<const N: usize>(&self, line: &[f32], out: &mut [f32]) {
        let weights = self.weights.as_chunks::<N>().0;
        for ((out, first), weights) in out.iter_mut().zip(&self.first).zip(weights) {
            let covered = weights.iter().zip(&line[*first..*first + N]);
            *out = covered.map(|(w, v)| w * v).sum();
        }
    }

    #[inline(always)]
    fn sums(&self, line: &[f32], out: &mut [f32]) {
        for (out, (first, weights)) in out.iter_mut().zip(self.iter()) {
            let covered = weights.iter().zip(&line[first..]);
            *out = covered.map(|(w, v)| w * v).sum();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Baseline;

    #[test]
    fn all_vectors_give_the_same_means() {
        let image = GrayImage::from_fn(53, 41, |x, y| ((37 * x + 101 * y + x * y) % 251) as f32);
        for (width, height) in [(31, 23), (53, 20), (9, 41), (7, 5), (80, 50), (1, 1)] {
            let size = Resize { width, height };
            assert_eq!(
                averages(&image, size),
                averages_with(Baseline, &image, size)
            );
        }
    }

    #[test]
    fn rounding_is_that_of_the_library() {
        let tenths = (-30..2600_i16).map(|tenth| f32::from(tenth) * 0.1);
        let rest = [
            0.499_999_97,
            0.5,
            254.5,
            255.5,
            f32::NAN,
            f32::INFINITY,
            -1e9,
        ];
        for value in tenths
            .chain((0..255_u8).map(|v| f32::from(v) + 0.5))
            .chain(rest)
        {
            let expected = value.round().clamp(0.0, 255.0) as u8;
            assert_eq!(to_gray8(value), expected, "{value}");
        }
    }

    #[test]
    fn bytes_become_grey_values() {
        let grey = GrayImage::from_gray8(2, 1, &[0, 255]).unwrap();
        assert_eq!(grey.as_slice(), [0.0, 255.0]);
        assert!(GrayImage::from_gray8(2, 2, &[0; 3]).is_none());
        let colours = [255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255];
        let rgb = GrayImage::from_rgb8(2, 2, &colours).unwrap();
        assert_eq!(rgb.as_slice(), [76.0, 150.0, 29.0, 255.0]);
        assert!(GrayImage::from_rgb8(2, 2, &colours[..11]).is_none());
        assert!(GrayImage::from_rgb8(1, 2, &colours[..7]).is_none());
    }
}
