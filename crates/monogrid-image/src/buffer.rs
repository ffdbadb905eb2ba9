//! The image type and how it is sampled and resized.

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

/// Bilinear value at `(x, y)`; `None` outside the square of pixel centres.
#[must_use]
#[inline]
pub fn bilinear(image: &GrayImage, x: f32, y: f32) -> Option<f32> {
    let (w, h) = (image.width, image.height);
    if !(x >= 0.0 && y >= 0.0 && x <= (w as f32 - 1.0) && y <= (h as f32 - 1.0)) {
        return None;
    }
    let (ix, iy) = (
        (x as usize).min(w.saturating_sub(2)),
        (y as usize).min(h.saturating_sub(2)),
    );
    if w < 2 || h < 2 {
        return Some(linear(&image.data, if w < 2 { y } else { x }));
    }
    let (fx, fy) = (x - ix as f32, y - iy as f32);
    let i = iy * w + ix;
    let top = image.data[i] + fx * (image.data[i + 1] - image.data[i]);
    let bottom = image.data[i + w] + fx * (image.data[i + w + 1] - image.data[i + w]);
    Some(top + fy * (bottom - top))
}

/// Value at `(x, y)` by cubic convolution (Keys 1981, a = -1/2), which blurs less than [`bilinear`]; outside the
/// image its border goes on. Within the range of the 16 pixels around, so that edges do not ring.
#[must_use]
#[inline]
pub fn bicubic(image: &GrayImage, x: f32, y: f32) -> f32 {
    let (w, h) = (image.width, image.height);
    if w == 0 || h == 0 {
        return 0.0;
    }
    let (x, y) = (x.clamp(0.0, w as f32 - 1.0), y.clamp(0.0, h as f32 - 1.0));
    let (left, top) = (x as usize, y as usize);
    let across = cubic_weights(x - left as f32);
    let down = cubic_weights(y - top as f32);
    if left >= 1 && top >= 1 && left + 2 < w && top + 2 < h {
        let first = (top - 1) * w + left - 1;
        return bicubic_inside(&image.data[first..], w, (across, down));
    }
    bicubic_at_border(image, (left, top), (across, down))
}

/// The same anywhere: samples beyond the border are those at it.
fn bicubic_at_border(
    image: &GrayImage,
    (left, top): (usize, usize),
    (across, down): ([f32; 4], [f32; 4]),
) -> f32 {
    let (w, h) = (image.width, image.height);
    let columns = [-1isize, 0, 1, 2].map(|d| left.saturating_add_signed(d).min(w - 1));
    let (mut sum, mut low, mut high) = (0.0f32, f32::INFINITY, f32::NEG_INFINITY);
    for (dy, weight) in [-1isize, 0, 1, 2].into_iter().zip(down) {
        let row = top.saturating_add_signed(dy).min(h - 1) * w;
        let mut line = 0.0;
        for (column, weight) in columns.into_iter().zip(across) {
            let value = image.data[row + column];
            (low, high) = (low.min(value), high.max(value));
            line += weight * value;
        }
        sum += weight * line;
    }
    sum.clamp(low, high)
}

/// The same where all sixteen samples are inside: those of four rows of an image of this width, from the first one on. The same bits.
#[inline]
fn bicubic_inside(data: &[f32], width: usize, (across, down): ([f32; 4], [f32; 4])) -> f32 {
    let (mut sum, mut low, mut high) = (0.0f32, [f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
    for (row, weight) in data.chunks(width).zip(down) {
        let Some(values) = row.first_chunk::<4>() else {
            continue;
        };
        let mut line = 0.0;
        for k in 0..4 {
            low[k] = low[k].min(values[k]);
            high[k] = high[k].max(values[k]);
            line += across[k] * values[k];
        }
        sum += weight * line;
    }
    let low = low.into_iter().fold(f32::INFINITY, f32::min);
    let high = high.into_iter().fold(f32::NEG_INFINITY, f32::max);
    sum.clamp(low, high)
}

/// Weights of the samples at -1, 0, 1, 2 for a place between 0 and 1.
#[inline]
fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
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
    let mut horizontal = Image::filled(size.width, image.height, 0.0f32);
    for y in 0..image.height {
        let source = image.row(y);
        for (x, out) in horizontal.row_mut(y).iter_mut().enumerate() {
            let (start, weights) = &columns[x];
            *out = weights
                .iter()
                .zip(&source[*start..])
                .map(|(w, v)| w * v)
                .sum();
        }
    }
    let mut output = Image::filled(size.width, size.height, 0.0f32);
    for (y, (start, weights)) in rows.iter().enumerate() {
        for (k, weight) in weights.iter().enumerate() {
            let source = &horizontal.data[(start + k) * size.width..][..size.width];
            for (out, value) in output.row_mut(y).iter_mut().zip(source) {
                *out += weight * value;
            }
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

    #[test]
    fn bicubic_inside_has_the_bits_of_bicubic_anywhere() {
        let image = GrayImage::from_fn(9, 7, |x, y| ((x * 37 + y * 101) % 251) as f32 * 0.7);
        for k in 0..4000 {
            let (x, y) = ((k % 80) as f32 * 0.1, (k / 80) as f32 * 0.12);
            let (left, top) = (x as usize, y as usize);
            let weights = (
                cubic_weights(x - left as f32),
                cubic_weights(y - top as f32),
            );
            let expected = bicubic_at_border(&image, (left, top), weights);
            assert_eq!(
                bicubic(&image, x, y).to_bits(),
                expected.to_bits(),
                "{x} {y}"
            );
        }
    }
}
