//! The image type and how it is sampled and resized.

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

    /// An image from its pixels in row-major order; `None` unless there are `width * height` of them.
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
    /// A grey image from 8-bit grey values in row-major order; `None` unless there are `width * height` of them.
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

/// A grey value rounded to 8 bits: what `round` and a conversion give, without a call for each pixel.
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

/// The same at a place that is known to be inside, of an image of at least two pixels in both directions.
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

/// Values at four places `(x, y)` by cubic convolution (Keys 1981, a = -1/2), which blurs less than [`bilinear`]; outside the
/// image its border goes on. Within the range of the 16 pixels around, so that edges do not ring.
#[must_use]
#[inline]
pub fn bicubic(image: &GrayImage, xs: [f32; 4], ys: [f32; 4]) -> [f32; 4] {
    let (w, h) = (image.width, image.height);
    if w == 0 || h == 0 {
        return [0.0; 4];
    }
    let (lefts, across) = cubic_weights(xs, w);
    let (tops, down) = cubic_weights(ys, h);
    let inside = lefts
        .iter()
        .zip(tops)
        .all(|(left, top)| is_inside(*left, w) && is_inside(top, h));
    let place = |k: usize| (lefts[k] as usize, tops[k] as usize);
    if !inside {
        let around = std::array::from_fn(|k| samples_at_border(image, place(k)));
        return apart(around, across, down);
    }
    if (0..4).all(|k| (lefts[k], tops[k]) == (lefts[0] + k as i32, tops[0])) {
        return abreast(image, place(0), across, down);
    }
    let around = std::array::from_fn(|k| samples_inside(image, place(k)));
    apart(around, across, down)
}

/// Values at four places, each with rows of samples of its own; weights of the samples in the order of [`cubic_weights`].
#[inline(always)]
fn apart(around: [[f32x4; 4]; 4], across: [f32x4; 4], down: [f32x4; 4]) -> [f32; 4] {
    let (across, down) = (f32x4::transpose(across), f32x4::transpose(down));
    let (mut rows, mut low, mut high) = ([f32x4::ZERO; 4], [f32x4::ZERO; 4], [f32x4::ZERO; 4]);
    for k in 0..4 {
        let [a, b, c, d] = around[k];
        low[k] = a.fast_min(b).fast_min(c.fast_min(d));
        high[k] = a.fast_max(b).fast_max(c.fast_max(d));
        let [above, at, below, last] = down[k].to_array();
        rows[k] = across[k] * (above * a + at * b + below * c + last * d);
    }
    let low = f32x4::transpose(low).into_iter().reduce(f32x4::fast_min);
    let high = f32x4::transpose(high).into_iter().reduce(f32x4::fast_max);
    let within = (low.unwrap_or_default(), high.unwrap_or_default());
    let values = sum_of_lanes(rows);
    values.fast_max(within.0).fast_min(within.1).to_array()
}

/// The same bits where the places follow each other, the first after the pixel `left` of row `top`: their samples do so too,
/// and lie in the lanes in which their places do.
#[inline(always)]
fn abreast(
    image: &GrayImage,
    (left, top): (usize, usize),
    across: [f32x4; 4],
    down: [f32x4; 4],
) -> [f32; 4] {
    let width = image.width;
    let rows = &image.data[(top - 1) * width + left - 1..][..3 * width + 7];
    let mut sum = f32x4::ZERO;
    let (mut low, mut high) = (f32x4::splat(f32::MAX), f32x4::splat(f32::MIN));
    for (column, weight) in across.into_iter().enumerate() {
        let samples = |row: usize| four(&rows[row * width + column..]);
        let (a, b, c, d) = (samples(0), samples(1), samples(2), samples(3));
        low = low.fast_min(a.fast_min(b).fast_min(c.fast_min(d)));
        high = high.fast_max(a.fast_max(b).fast_max(c.fast_max(d)));
        let [above, at, below, last] = down;
        let part = weight * (above * a + at * b + below * c + last * d);
        sum = if column == 0 { part } else { sum + part };
    }
    sum.fast_max(low).fast_min(high).to_array()
}

/// The first four values.
#[inline(always)]
fn four(values: &[f32]) -> f32x4 {
    f32x4::new([values[0], values[1], values[2], values[3]])
}

/// Whether a line of this many pixels has one before this place and two behind it.
#[inline]
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

/// The sixteen samples around the place between this pixel and the next ones; those beyond the border are those at it.
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

/// The pixels before four places on a line of this many pixels, and the weights of the samples at -1, 0, 1, 2, places in the lanes.
#[inline]
fn cubic_weights(places: [f32; 4], length: usize) -> ([i32; 4], [f32x4; 4]) {
    let last = f32x4::splat(length as f32 - 1.0);
    let places = f32x4::new(places).fast_max(f32x4::ZERO).fast_min(last);
    let before = places.fast_trunc_int();
    let t = places - f32x4::from_i32x4(before);
    let (t2, t3) = (t * t, t * t * t);
    let weights: [f32x4; 4] = [
        2.0 * t2 - t3 - t,
        3.0 * t3 - 5.0 * t2 + 2.0,
        4.0 * t2 - 3.0 * t3 + t,
        t3 - t2,
    ];
    (before.to_array(), weights.map(|w| 0.5 * w))
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
/// aliases nor shifts the image.
#[must_use]
pub fn resize_area(image: &GrayImage, size: Resize) -> GrayImage {
    if size.width == image.width && size.height == image.height {
        return image.clone();
    }
    if image.data.is_empty() {
        return Image::filled(size.width, size.height, 0.0);
    }
    let columns = area_weights(image.width, size.width);
    let rows = area_weights(image.height, size.height);
    let mut output = Image::filled(size.width, size.height, 0.0f32);
    // down before across: whole rows are added, and fewer are left
    let mut line = vec![0.0f32; image.width];
    for (y, (first, weights)) in rows.iter().enumerate() {
        line.fill(0.0);
        for (k, weight) in weights.iter().enumerate() {
            for (sum, value) in line.iter_mut().zip(image.row(first + k)) {
                *sum += weight * value;
            }
        }
        for (out, (first, weights)) in output.row_mut(y).iter_mut().zip(&columns) {
            let covered = weights.iter().zip(&line[*first..]);
            *out = covered.map(|(w, v)| w * v).sum();
        }
    }
    output
}

/// For each output pixel the first input pixel it covers and the normalised overlap with each.
fn area_weights(input: usize, output: usize) -> Vec<(usize, Vec<f32>)> {
    let ratio = input as f64 / output as f64;
    (0..output)
        .map(|i| {
            let (from, to) = (i as f64 * ratio, (i as f64 + 1.0) * ratio);
            let first = from.floor() as usize;
            let last = (to.ceil() as usize).clamp(first + 1, input);
            let weights = (first..last)
                .map(|k| ((to.min(k as f64 + 1.0) - from.max(k as f64)).max(0.0) / ratio) as f32)
                .collect();
            (first, weights)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
