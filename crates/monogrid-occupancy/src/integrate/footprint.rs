//! The update of one cell by the rule `fused`, and bounds of the updates of a whole block.

use super::image::{HOLE, RangeImage, RangeImages};
use super::pyramid::Pyramid;
use crate::sensor::table::EvidenceTable;

/// Samples in a footprint wider than [`SINGLE_SAMPLE_PX`], as offsets in units of its width: a
/// Latin square, so that each row and column of an 8 x 8 raster has one.
const SAMPLES: [[f32; 2]; 8] = [
    [-0.4375, -0.1875],
    [-0.3125, 0.3125],
    [-0.1875, -0.4375],
    [-0.0625, 0.0625],
    [0.0625, 0.4375],
    [0.1875, -0.0625],
    [0.3125, -0.3125],
    [0.4375, 0.1875],
];
/// Footprints up to this wide take the nearest pixel alone.
const SINGLE_SAMPLE_PX: f32 = 1.5;
/// Depth below which nothing is projected, in cells.
const NEAREST_CELLS: f32 = 0.25;

/// A prepared scan with everything that an update needs.
pub(crate) struct Footprints<'a> {
    pub images: &'a RangeImages,
    pub pyramids: Vec<Pyramid>,
    pub max_range: f32,
    pub resolution: f32,
    headers: Vec<TableHeader<'a>>,
}

/// A table in the precision of the look-up.
struct TableHeader<'a> {
    start: f32,
    inv_step: f32,
    free: i16,
    entries: &'a [i16],
}

/// What a block of cells can get from a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BlockClass {
    /// Nothing.
    Untouched,
    /// Every cell the same free update.
    Free,
    /// Anything.
    Mixed,
}

/// Weight of an update from how many measurements it stands for, by samples that hit, in 1/256.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Weights([i32; 9]);

impl<'a> Footprints<'a> {
    pub(crate) fn new(images: &'a RangeImages, max_range: f64, resolution: f64) -> Self {
        let max_range = max_range as f32;
        Self {
            images,
            pyramids: images
                .images
                .iter()
                .map(|image| Pyramid::new(image, &images.tables, max_range))
                .collect(),
            max_range,
            resolution: resolution as f32,
            headers: images
                .tables
                .tables()
                .iter()
                .map(TableHeader::new)
                .collect(),
        }
    }

    /// The image that a point (relative to the sensor, world axes) belongs to, with the point in
    /// its axes.
    #[inline]
    fn image_of(&self, point: [f32; 3]) -> Option<(&RangeImage, [f32; 3])> {
        match &self.images.images[..] {
            [image] => Some((image, in_image(image, point))),
            images => images.iter().find_map(|image| {
                let p = in_image(image, point);
                (p[2] >= p[0].abs() && p[2] >= p[1].abs()).then_some((image, p))
            }),
        }
    }

    /// The weights of cells around a block's centre (relative to the sensor, world axes).
    ///
    /// One value per block keeps uniform space uniform.
    pub(crate) fn weights(&self, center: [f32; 3]) -> Weights {
        let Some((image, p)) = self.image_of(center) else {
            return Weights([256; 9]);
        };
        let width = self.footprint_px(image, p[2]);
        let measurements = (width * width).max(1.0) * image.density;
        Weights(std::array::from_fn(|hits| {
            // [docs 4.2b] mean of the measurements' log-odds times sqrt(min(n, 4)).
            let n = (measurements * hits as f32 / 8.0).clamp(1.0, 4.0);
            (n.sqrt() * 256.0).round() as i32
        }))
    }

    #[inline]
    fn footprint_px(&self, image: &RangeImage, depth: f32) -> f32 {
        let nearest = NEAREST_CELLS * self.resolution;
        self.resolution * image.focal[0] / depth.max(nearest)
    }

    /// Evidence for a cell whose centre lies at `point` (relative to the sensor, world axes); 0
    /// if the scan says nothing about it.
    #[inline]
    pub(crate) fn cell_evidence(&self, point: [f32; 3], weights: &Weights) -> i16 {
        match self.image_of(point) {
            Some((image, p)) => self.evidence_in_image(image, p, weights),
            None => 0,
        }
    }

    #[inline]
    fn evidence_in_image(&self, image: &RangeImage, p: [f32; 3], weights: &Weights) -> i16 {
        let [x, y, z] = p;
        let range = (x * x + y * y + z * z).sqrt();
        if z <= NEAREST_CELLS * self.resolution || range > self.max_range {
            return 0;
        }
        let inverse = 1.0 / z;
        let u = x * inverse * image.focal[0] + image.center[0];
        let v = y * inverse * image.focal[1] + image.center[1];
        let width = self.resolution * image.focal[0] * inverse;
        if width <= SINGLE_SAMPLE_PX {
            let delta = self.sample(image, u, v, range);
            return scaled(i32::from(delta) * weights.0[8], 1);
        }
        let (mut sum, mut hits) = (0, 0);
        for [du, dv] in SAMPLES {
            let delta = self.sample(image, u + du * width, v + dv * width, range);
            sum += i32::from(delta);
            hits += i32::from(delta != 0);
        }
        scaled(sum * weights.0[hits as usize], hits.max(1))
    }

    /// Evidence of the measurement in the pixel nearest to `(u, v)`; 0 if it says nothing.
    #[inline]
    fn sample(&self, image: &RangeImage, u: f32, v: f32, range: f32) -> i16 {
        let (column, row) = (u + 0.5, v + 0.5);
        let inside =
            column >= 0.0 && row >= 0.0 && column < image.width as f32 && row < image.height as f32;
        if !inside {
            return 0;
        }
        let pixel = image.pixels[row as usize * image.width + column as usize];
        if pixel.range == HOLE {
            return 0;
        }
        let table = &self.headers[usize::from(pixel.table)];
        let offset = (range - (pixel.range + table.start)) * table.inv_step;
        if offset < 0.0 {
            table.free
        } else {
            table.entries.get(offset as usize).copied().unwrap_or(0)
        }
    }

    /// The free update of a cell whose whole footprint is measured.
    pub(crate) fn free_evidence(&self, weights: &Weights) -> i16 {
        let free = self.headers.first().map_or(0, |table| table.free);
        scaled(i32::from(free) * weights.0[8], 1)
    }

    /// What the cells of a cube with centre `center` (relative to the sensor, world axes) and
    /// half edge `half` can get. Conservative: `Mixed` where it is not certain.
    pub(crate) fn classify(&self, center: [f32; 3], half: f32) -> BlockClass {
        let mut nearest_sq = 0.0;
        let mut farthest_sq = 0.0;
        for c in center {
            let near = (c.abs() - half).max(0.0);
            nearest_sq += near * near;
            farthest_sq += (c.abs() + half) * (c.abs() + half);
        }
        match &self.images.images[..] {
            [] => BlockClass::Untouched,
            [image] => self.classify_in(0, image, center, half, (nearest_sq, farthest_sq)),
            images => {
                // A cube that belongs to one face of the sensor's cube is judged there.
                for (index, image) in images.iter().enumerate() {
                    let (p, e) = extent_in_image(image, center, half);
                    let side = (p[0].abs() + e[0]).max(p[1].abs() + e[1]);
                    if p[2] - e[2] > side {
                        let range_sq = (nearest_sq, farthest_sq);
                        return self.classify_in(index, image, center, half, range_sq);
                    }
                }
                let farthest = self.pyramids.iter().map(|p| p.whole().changes_until);
                if nearest_sq.sqrt() > farthest.fold(f32::MIN, f32::max) {
                    BlockClass::Untouched
                } else {
                    BlockClass::Mixed
                }
            }
        }
    }

    fn classify_in(
        &self,
        index: usize,
        image: &RangeImage,
        center: [f32; 3],
        half: f32,
        (nearest_sq, farthest_sq): (f32, f32),
    ) -> BlockClass {
        // Half a cell more: footprints stick out of the block. A little more: rounding.
        let half = (half + 0.55 * self.resolution) * 1.0001;
        let (p, e) = extent_in_image(image, center, half);
        let (near, far) = (p[2] - e[2], p[2] + e[2]);
        let pyramid = &self.pyramids[index];
        let bounds = if near <= 2.0 * NEAREST_CELLS * self.resolution {
            if far <= 0.0 {
                return BlockClass::Untouched;
            }
            let whole = pyramid.whole();
            if nearest_sq.sqrt() > whole.changes_until {
                return BlockClass::Untouched;
            }
            return BlockClass::Mixed;
        } else {
            let span = |axis: usize| {
                let (low, high) = (p[axis] - e[axis], p[axis] + e[axis]);
                let low = low / if low < 0.0 { near } else { far };
                let high = high / if high > 0.0 { near } else { far };
                let (focal, center) = (image.focal[axis], image.center[axis] + 0.5);
                (low * focal + center - 0.01, high * focal + center + 0.01)
            };
            let ((left, right), (top, bottom)) = (span(0), span(1));
            pyramid.bounds([left.floor(), top.floor()], [right.floor(), bottom.floor()])
        };
        let Some(bounds) = bounds else {
            return BlockClass::Untouched;
        };
        // Relative margins against rounding of ranges in f32.
        if nearest_sq.sqrt() > bounds.changes_until * 1.00001 {
            BlockClass::Untouched
        } else if farthest_sq.sqrt() < bounds.free_until * 0.99999 {
            BlockClass::Free
        } else {
            BlockClass::Mixed
        }
    }

    /// No cell farther than this from the sensor changes.
    pub(crate) fn farthest_change(&self) -> f32 {
        self.pyramids
            .iter()
            .map(|p| p.whole().changes_until)
            .fold(0.0, f32::max)
    }
}

impl<'a> TableHeader<'a> {
    fn new(table: &'a EvidenceTable) -> Self {
        Self {
            start: table.start as f32,
            inv_step: table.inv_step as f32,
            free: table.free,
            entries: &table.entries,
        }
    }
}

/// `sum / (256 count)` as evidence; never 0 for a sum that is not.
#[inline]
fn scaled(sum: i32, count: i32) -> i16 {
    let value = sum / (256 * count);
    let value = if value == 0 { sum.signum() } else { value };
    value.clamp(-i32::from(i16::MAX), i32::from(i16::MAX)) as i16
}

#[inline]
fn in_image(image: &RangeImage, point: [f32; 3]) -> [f32; 3] {
    image.axes.map(|axis| {
        axis[0] as f32 * point[0] + axis[1] as f32 * point[1] + axis[2] as f32 * point[2]
    })
}

/// Centre and half extents of a cube along an image's axes.
#[inline]
fn extent_in_image(image: &RangeImage, center: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
    let extents = image
        .axes
        .map(|axis| (axis[0].abs() + axis[1].abs() + axis[2].abs()) as f32 * half);
    (in_image(image, center), extents)
}
