//! Connected regions of weak gradient.

use super::FillConfig;
use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;

/// The label of pixels that belong to no region.
pub(in crate::mapping) const NO_REGION: u32 = u32::MAX;

/// Plain regions of an image.
pub(in crate::mapping) struct Regions {
    pub width: usize,
    pub height: usize,
    /// Region of each pixel, row-major.
    pub labels: Vec<u32>,
    /// Number of regions; labels are less.
    pub count: usize,
}

impl Regions {
    /// Finds the regions of an image; measured pixels belong to none.
    ///
    /// Pixels connect over their *core*: those whose eight neighbours are plain too. A gap of two pixels
    /// in a faint edge therefore does not join the surfaces on both sides.
    pub fn new<'a>(
        image: &Image<u8>,
        measured: impl IntoIterator<Item = &'a Measurement>,
        config: &FillConfig,
    ) -> Self {
        let (width, height) = (image.width(), image.height());
        let mut plain = plain_pixels(image, config.max_gradient);
        for point in measured {
            let (x, y) = (usize::from(point.x), usize::from(point.y));
            if x < width && y < height {
                plain[y * width + x] = false;
            }
        }
        Self::of_pixels(&plain, (width, height), config.min_area_px)
    }

    /// The regions of these pixels, row-major, of at least so many.
    pub fn of_pixels(pixels: &[bool], (width, height): (usize, usize), min_area: usize) -> Self {
        let core = eroded(pixels, width, height);
        let mut this = Self {
            width,
            height,
            labels: vec![NO_REGION; width * height],
            count: 0,
        };
        this.connect(&core, min_area);
        this.grow_by_one(pixels);
        this
    }

    /// Label of a pixel; outside the image none.
    pub fn at(&self, x: i32, y: i32) -> u32 {
        let inside = x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height;
        if inside {
            self.labels[y as usize * self.width + x as usize]
        } else {
            NO_REGION
        }
    }

    /// Labels connected components of at least `min_area` pixels in the order of their first pixel.
    fn connect(&mut self, core: &[bool], min_area: usize) {
        let mut is_visited = vec![false; core.len()];
        let mut component = Vec::new();
        for start in 0..core.len() {
            if !core[start] || is_visited[start] {
                continue;
            }
            component.clear();
            component.push(start);
            is_visited[start] = true;
            let mut next = 0;
            while let Some(&index) = component.get(next) {
                next += 1;
                for neighbour in neighbours(index, self.width, self.height) {
                    if core[neighbour] && !is_visited[neighbour] {
                        is_visited[neighbour] = true;
                        component.push(neighbour);
                    }
                }
            }
            if component.len() >= min_area {
                for &index in &component {
                    self.labels[index] = self.count as u32;
                }
                self.count += 1;
            }
        }
    }

    /// Gives back the rim that the erosion took.
    fn grow_by_one(&mut self, plain: &[bool]) {
        let source = self.labels.clone();
        for (index, label) in self.labels.iter_mut().enumerate() {
            if *label == NO_REGION && plain[index] {
                *label = neighbours(index, self.width, self.height)
                    .map(|n| source[n])
                    .find(|l| *l != NO_REGION)
                    .unwrap_or(NO_REGION);
            }
        }
    }
}

/// The up to four neighbours of a pixel.
fn neighbours(index: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
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
fn plain_pixels(image: &Image<u8>, max_gradient: f64) -> Vec<bool> {
    let (width, height) = (image.width(), image.height());
    let smooth = smoothed(image);
    // smoothed values are 16 times the grey level, differences are over two pixels
    let limit = (32.0 * max_gradient).powi(2) as i32;
    let mut plain = vec![false; width * height];
    if width < 3 {
        return plain;
    }
    for y in 1..height.saturating_sub(1) {
        let row = |y: usize| &smooth[y * width..(y + 1) * width];
        let (above, own, below) = (row(y - 1), row(y), row(y + 1));
        let around = own.windows(3).zip(above[1..].iter().zip(&below[1..]));
        for (plain, (beside, (above, below))) in plain[y * width + 1..].iter_mut().zip(around) {
            let dx = i32::from(beside[2]) - i32::from(beside[0]);
            let dy = i32::from(*below) - i32::from(*above);
            *plain = dx * dx + dy * dy <= limit;
        }
    }
    plain
}

/// 16 times the smoothed image.
fn smoothed(image: &Image<u8>) -> Vec<u16> {
    let (width, height) = (image.width(), image.height());
    let mut rows = vec![0u16; width * height];
    for (y, out) in rows.chunks_exact_mut(width.max(1)).enumerate() {
        let row = image.row(y);
        let mean =
            |left: u8, at: u8, right: u8| u16::from(left) + 2 * u16::from(at) + u16::from(right);
        for (out, around) in out[1..].iter_mut().zip(row.windows(3)) {
            *out = mean(around[0], around[1], around[2]);
        }
        let last = width - 1;
        out[0] = mean(row[0], row[0], row[last.min(1)]);
        out[last] = mean(row[last.saturating_sub(1)], row[last], row[last]);
    }
    let mut smooth = vec![0u16; width * height];
    for (y, out) in smooth.chunks_exact_mut(width.max(1)).enumerate() {
        let row = |y: usize| &rows[y * width..(y + 1) * width];
        let (above, below) = (row(y.saturating_sub(1)), row((y + 1).min(height - 1)));
        let around = above.iter().zip(row(y)).zip(below);
        for (out, ((above, at), below)) in out.iter_mut().zip(around) {
            *out = above + 2 * at + below;
        }
    }
    smooth
}

/// Pixels whose 3x3 neighbourhood is set.
fn eroded(set: &[bool], width: usize, height: usize) -> Vec<bool> {
    let mut out = vec![false; set.len()];
    for y in 1..height.saturating_sub(1) {
        let row = |y: usize| &set[y * width..(y + 1) * width];
        let columns = row(y - 1).iter().zip(row(y)).zip(row(y + 1));
        let columns: Vec<bool> = columns.map(|((a, b), c)| a & b & c).collect();
        let inner = out[y * width + 1..].iter_mut();
        for (out, around) in inner.zip(columns.windows(3)) {
            *out = around[0] & around[1] & around[2];
        }
    }
    out
}
