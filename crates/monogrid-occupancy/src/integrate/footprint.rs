//! The update of one cell by the rule `fused`, and bounds of the updates of a whole block.

use super::image::{HOLE, RangeImage, RangeImages};
use super::kernel::{
    BLOCK_CELLS, Block, FlatTables, Kernel, KernelImage, KernelPixel, Weights, evidence,
};
use super::pyramid::Pyramid;
use crate::sensor::table::EvidenceTable;

/// Depth below which nothing is projected, in cells.
const NEAREST_CELLS: f32 = 0.25;

/// A prepared scan with everything that an update needs.
pub(crate) struct Footprints<'a> {
    pub images: &'a RangeImages,
    pub pyramids: Vec<Pyramid>,
    pub max_range: f32,
    pub resolution: f32,
    kernel_images: Vec<KernelImage>,
    tables: FlatTables,
    /// The update of one measurement in free space.
    free: i16,
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

impl<'a> Footprints<'a> {
    pub(crate) fn new(images: &'a RangeImages, max_range: f64, resolution: f64) -> Self {
        let max_range = max_range as f32;
        let tables = images.tables.tables();
        let (flat, headers) = flatten(tables);
        Self {
            images,
            pyramids: images
                .images
                .iter()
                .map(|image| Pyramid::new(image, &images.tables, max_range))
                .collect(),
            max_range,
            resolution: resolution as f32,
            kernel_images: images
                .images
                .iter()
                .map(|image| kernel_image(image, &headers))
                .collect(),
            tables: flat,
            free: tables.first().map_or(0, |table| table.free),
        }
    }

    /// The image that a point (relative to the sensor, world axes) belongs to.
    #[inline]
    fn image_of(&self, point: [f32; 3]) -> Option<usize> {
        match &self.images.images[..] {
            [_] => Some(0),
            images => images.iter().position(|image| {
                let p = in_image(image, point);
                p[2] >= p[0].abs() && p[2] >= p[1].abs()
            }),
        }
    }

    /// The weights of cells around a block's centre (relative to the sensor, world axes).
    ///
    /// One value per block keeps uniform space uniform.
    pub(crate) fn weights(&self, center: [f32; 3]) -> Weights {
        let Some(index) = self.image_of(center) else {
            return Weights {
                single: 1.0,
                by_hits: std::array::from_fn(|i| 1.0 / (i + 1) as f32),
                obstacle: 0,
            };
        };
        let image = &self.images.images[index];
        let depth = in_image(image, center)[2].max(NEAREST_CELLS * self.resolution);
        let width = self.resolution * image.focal[0] / depth;
        let measurements = (width * width).max(1.0) * image.density;
        // [docs 4.2b] mean of the measurements' log-odds times sqrt(min(n, 4)).
        let weight = |hits: usize| (measurements * hits as f32 / 8.0).clamp(1.0, 4.0).sqrt();
        Weights {
            single: weight(8),
            by_hits: std::array::from_fn(|i| weight(i + 1) / (i + 1) as f32),
            obstacle: self.images.obstacle_weight,
        }
    }

    /// Evidence for 4 x 4 x 4 cells around `center` (relative to the sensor, world axes), x
    /// fastest; 0 where the scan says nothing.
    pub(crate) fn block_evidence(&self, center: [f32; 3], weights: &Weights) -> [i16; BLOCK_CELLS] {
        if let [image] = &self.images.images[..] {
            let block = self.block(image, center);
            return self.kernel(0).block(&block, weights);
        }
        // Around a sensor that looks everywhere, each cell has its own image.
        std::array::from_fn(|i| {
            let at = [i & 3, i >> 2 & 3, i >> 4];
            let point = std::array::from_fn(|a| center[a] + (at[a] as f32 - 1.5) * self.resolution);
            self.image_of(point).map_or(0, |index| {
                let block = self.block(&self.images.images[index], center);
                self.kernel(index).cell(&block, at, weights)
            })
        })
    }

    /// [`Footprints::block_evidence`] without vectors.
    #[cfg(test)]
    pub(crate) fn block_evidence_scalar(
        &self,
        center: [f32; 3],
        weights: &Weights,
    ) -> [i16; BLOCK_CELLS] {
        match &self.images.images[..] {
            [image] => self
                .kernel(0)
                .block_scalar(&self.block(image, center), weights),
            _ => self.block_evidence(center, weights),
        }
    }

    fn kernel(&self, index: usize) -> Kernel<'_> {
        Kernel {
            image: &self.kernel_images[index],
            tables: &self.tables,
        }
    }

    fn block(&self, image: &RangeImage, center: [f32; 3]) -> Block {
        let cell = self.resolution;
        let first = center.map(|c| c - 1.5 * cell);
        Block {
            first: in_image(image, first),
            steps: std::array::from_fn(|axis| image.axes.map(|a| a[axis] as f32 * cell)),
            cell,
            min_depth: NEAREST_CELLS * cell,
            max_range: self.max_range,
        }
    }

    /// The free update of a cell whose whole footprint is measured.
    pub(crate) fn free_evidence(&self, weights: &Weights) -> i16 {
        evidence(i32::from(self.free), weights.single)
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
                // Half a pixel more: truncation then finds the nearest pixel.
                let (focal, center) = (image.focal[axis], image.center[axis] + 0.5);
                (low * focal + center - 0.01, high * focal + center + 0.01)
            };
            let ((left, right), (top, bottom)) = (span(0), span(1));
            pyramid.bounds([left, top], [right, bottom])
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

/// Where a table is in the flat tables: start in space, entries per map unit, base and last.
struct TableHeader {
    start: f32,
    inv_step: f32,
    base: i32,
    last: f32,
}

fn flatten(tables: &[EvidenceTable]) -> (FlatTables, Vec<TableHeader>) {
    // The table of pixels without measurement: nothing in front, nothing behind.
    let mut entries = vec![0, 0];
    let headers = tables
        .iter()
        .map(|table| {
            let header = TableHeader {
                start: table.start as f32,
                inv_step: table.inv_step as f32,
                base: entries.len() as i32,
                last: (table.entries.len() + 1) as f32,
            };
            entries.push(table.free);
            entries.extend_from_slice(&table.entries);
            entries.push(0);
            header
        })
        .collect();
    entries.push(0);
    (FlatTables { entries }, headers)
}

fn kernel_image(image: &RangeImage, headers: &[TableHeader]) -> KernelImage {
    let pixels = image.pixels.iter().map(|pixel| {
        if pixel.range == HOLE {
            return KernelPixel {
                near: f32::INFINITY,
                inv_step: 1.0,
                last: 1.0,
                base: 0,
            };
        }
        let table = &headers[usize::from(pixel.table)];
        KernelPixel {
            near: pixel.range + table.start,
            inv_step: table.inv_step,
            last: table.last,
            base: table.base,
        }
    });
    KernelImage {
        width: image.width,
        height: image.height,
        focal: image.focal,
        center: image.center.map(|c| c + 0.5),
        pixels: pixels.collect(),
    }
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
