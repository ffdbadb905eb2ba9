//! Connected regions of weak gradient.

use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;
use std::mem::take;

/// Largest smoothed gradient of plain regions, grey levels per pixel.
const MAX_GRADIENT: f64 = 3.0;
/// Smallest region, pixels.
pub(crate) const MIN_AREA_PX: usize = 30;

/// The label of pixels that belong to no region.
pub(crate) const NO_REGION: u32 = u32::MAX;

/// Plain regions of an image.
pub(crate) struct Regions {
    /// Region of each pixel.
    pub labels: Image<u32>,
    /// Number of regions; labels are less.
    pub count: usize,
}

impl Regions {
    /// Finds the regions of an image; measured pixels belong to none.
    ///
    /// Pixels connect over their *core*: those whose eight neighbours are plain too. A gap of two
    /// pixels in a faint edge therefore does not join the surfaces on both sides.
    pub fn new<'a>(image: &Image<u8>, measured: impl IntoIterator<Item = &'a Measurement>) -> Self {
        let mut plain = plain_pixels(image, MAX_GRADIENT);
        for point in measured {
            let (x, y) = (usize::from(point.x), usize::from(point.y));
            if x < plain.width() && y < plain.height() {
                plain.set(x, y, false);
            }
        }
        Self::of_pixels(&plain, MIN_AREA_PX)
    }

    /// The regions of these pixels, of at least so many.
    pub fn of_pixels(pixels: &Image<bool>, min_area: usize) -> Self {
        let mut this = Self {
            labels: pixels.map(|_| NO_REGION),
            count: 0,
        };
        this.connect(eroded(pixels), min_area);
        this.grow_by_one(pixels);
        this
    }

    /// Labels connected components of at least `min_area` pixels in the order of their first pixel.
    fn connect(&mut self, mut core: Image<bool>, min_area: usize) {
        let size = (core.width(), core.height());
        let is_left = core.as_mut_slice();
        let mut component = Vec::new();
        for start in 0..is_left.len() {
            if !take(&mut is_left[start]) {
                continue;
            }
            component.clear();
            component.push(start);
            let mut next = 0;
            while let Some(&index) = component.get(next) {
                next += 1;
                component.extend(neighbours(index, size).filter(|n| take(&mut is_left[*n])));
            }
            if component.len() >= min_area {
                for &index in &component {
                    self.labels.as_mut_slice()[index] = self.count as u32;
                }
                self.count += 1;
            }
        }
    }

    /// Gives back the rim that the erosion took.
    fn grow_by_one(&mut self, plain: &Image<bool>) {
        let size = (plain.width(), plain.height());
        let source = self.labels.clone();
        let labels = self.labels.as_mut_slice().iter_mut().enumerate();
        for ((index, label), is_plain) in labels.zip(plain.as_slice()) {
            if *label == NO_REGION && *is_plain {
                let mut beside = neighbours(index, size).map(|n| source.as_slice()[n]);
                *label = beside.find(|l| *l != NO_REGION).unwrap_or(NO_REGION);
            }
        }
    }
}

/// The up to four neighbours of a pixel.
fn neighbours(index: usize, (width, height): (usize, usize)) -> impl Iterator<Item = usize> {
    let (x, y) = (index % width, index / width);
    [
        (x > 0).then(|| index - 1),
        (x + 1 < width).then(|| index + 1),
        (y > 0).then(|| index - width),
        (y + 1 < height).then(|| index + width),
    ]
    .into_iter()
    .flatten()
}

/// Pixels whose gradient, after smoothing by (1 2 1)/4 in both directions, is weak.
fn plain_pixels(image: &Image<u8>, max_gradient: f64) -> Image<bool> {
    let mut plain = image.map(|_| false);
    if image.width() < 3 {
        return plain;
    }
    let smooth = smoothed(image);
    // smoothed values are 16 times the grey level, differences are over two pixels
    let limit = (32.0 * max_gradient).powi(2) as i32;
    for y in 1..image.height().saturating_sub(1) {
        let (above, own, below) = (smooth.row(y - 1), smooth.row(y), smooth.row(y + 1));
        let around = own.windows(3).zip(above[1..].iter().zip(&below[1..]));
        for (plain, (beside, (above, below))) in plain.row_mut(y)[1..].iter_mut().zip(around) {
            let dx = i32::from(beside[2]) - i32::from(beside[0]);
            let dy = i32::from(*below) - i32::from(*above);
            *plain = dx * dx + dy * dy <= limit;
        }
    }
    plain
}

/// 16 times the smoothed image, which has two columns at least.
fn smoothed(image: &Image<u8>) -> Image<u16> {
    let (last_row, last) = (image.height().saturating_sub(1), image.width() - 1);
    let mut rows = image.map(|_| 0_u16);
    for y in 0..image.height() {
        let (row, out) = (image.row(y), rows.row_mut(y));
        let mean =
            |left: u8, at: u8, right: u8| u16::from(left) + 2 * u16::from(at) + u16::from(right);
        for (out, around) in out[1..].iter_mut().zip(row.windows(3)) {
            *out = mean(around[0], around[1], around[2]);
        }
        out[0] = mean(row[0], row[0], row[1]);
        out[last] = mean(row[last - 1], row[last], row[last]);
    }
    let mut smooth = image.map(|_| 0_u16);
    for y in 0..image.height() {
        let (above, below) = (
            rows.row(y.saturating_sub(1)),
            rows.row((y + 1).min(last_row)),
        );
        let around = above.iter().zip(rows.row(y)).zip(below);
        for (out, ((above, at), below)) in smooth.row_mut(y).iter_mut().zip(around) {
            *out = above + 2 * at + below;
        }
    }
    smooth
}

/// Pixels whose 3x3 neighbourhood is set.
fn eroded(set: &Image<bool>) -> Image<bool> {
    let mut out = set.map(|_| false);
    for y in 1..set.height().saturating_sub(1) {
        let columns = set.row(y - 1).iter().zip(set.row(y)).zip(set.row(y + 1));
        let columns: Vec<bool> = columns.map(|((a, b), c)| a & b & c).collect();
        let inner = out.row_mut(y)[1..].iter_mut();
        for (out, around) in inner.zip(columns.windows(3)) {
            *out = around[0] & around[1] & around[2];
        }
    }
    out
}
