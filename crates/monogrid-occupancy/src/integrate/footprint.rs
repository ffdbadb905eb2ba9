//! The update of one cell by the rule `fused`, and bounds of the updates of a whole block.

use super::image::{HOLE, RangeImage, RangeImages};
use super::kernel::{
    BLOCK_CELLS, Block, FlatTables, Kernel, KernelImage, KernelPixel, Weights, cell_of, evidence,
};
use super::octants::{Cube, Octants, View};
use super::windows::Windows;
use crate::sensor::table::EvidenceTable;

/// Depth below which nothing is projected, in cells.
const NEAREST_CELLS: f32 = 0.25;

/// A prepared scan with everything that an update needs.
pub(crate) struct Footprints {
    pub images: RangeImages,
    windows: Vec<Windows>,
    pub max_range: f32,
    pub resolution: f32,
    kernel_images: Vec<KernelImage>,
    tables: FlatTables,
    /// The update of one measurement in free space.
    free: i16,
}

impl Footprints {
    pub(crate) fn new(images: RangeImages, max_range: f64, resolution: f64) -> Self {
        let max_range = max_range as f32;
        let tables = images.tables.tables();
        let (flat, headers) = flatten(tables);
        Self {
            windows: images
                .images
                .iter()
                .map(|image| Windows::new(image, &images.tables, max_range))
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
            images,
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

    /// Evidence for those octants of 4 x 4 x 4 cells around `center` (relative to the sensor, world
    /// axes) that are `wanted`; 0 where the scan says nothing. Cells as [`cell_of`] orders them.
    pub(crate) fn block_evidence(
        &self,
        center: [f32; 3],
        weights: &Weights,
        wanted: u8,
        evidence: &mut [i16; BLOCK_CELLS],
    ) {
        let cube = Cube {
            center,
            half: 2.0 * self.resolution,
        };
        if let Some(index) = self.image_of_cube(cube) {
            let block = self.block(&self.images.images[index], center);
            self.kernel(index).block(&block, weights, wanted, evidence);
            return;
        }
        // Where the images of a sensor that looks everywhere meet, each cell has its own.
        for (i, value) in evidence.iter_mut().enumerate() {
            if wanted >> (i >> 3) & 1 != 0 {
                *value = self.cell_evidence(center, cell_of(i), weights);
            }
        }
    }

    /// Evidence of one cell of a block.
    fn cell_evidence(&self, center: [f32; 3], at: [usize; 3], weights: &Weights) -> i16 {
        let point = std::array::from_fn(|a| center[a] + (at[a] as f32 - 1.5) * self.resolution);
        self.image_of(point).map_or(0, |index| {
            let block = self.block(&self.images.images[index], center);
            self.kernel(index).cell(&block, at, weights)
        })
    }

    /// [`Footprints::block_evidence`] cell by cell, without vectors.
    #[cfg(test)]
    pub(crate) fn block_evidence_scalar(
        &self,
        center: [f32; 3],
        weights: &Weights,
    ) -> [i16; BLOCK_CELLS] {
        std::array::from_fn(|i| self.cell_evidence(center, cell_of(i), weights))
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

    /// The image that all points of a cube belong to, if there is one.
    fn image_of_cube(&self, cube: Cube) -> Option<usize> {
        match &self.images.images[..] {
            [_] => Some(0),
            images => images.iter().position(|image| {
                let (p, e) = extent_in_image(image, cube.center, 1.001 * cube.half);
                p[2] - e[2] > (p[0].abs() + e[0]).max(p[1].abs() + e[1])
            }),
        }
    }

    /// What the cells of the eight halves of a cube can get.
    pub(crate) fn judge(&self, cube: Cube) -> Octants {
        match self.image_of_cube(cube) {
            Some(index) => self.judge_in(index, cube),
            None => self.judge_between_images(cube),
        }
    }

    /// What they can get from one image.
    fn judge_in(&self, index: usize, cube: Cube) -> Octants {
        let view = View {
            image: &self.images.images[index],
            windows: &self.windows[index],
            cell: self.resolution,
            nearest: 2.0 * NEAREST_CELLS * self.resolution,
        };
        #[cfg(target_arch = "x86_64")]
        if let Some(octants) = super::octants_avx2::judge(&view, cube) {
            return octants;
        }
        view.judge(cube)
    }

    /// The octants that something in those images can reach that they have points in.
    fn judge_between_images(&self, cube: Cube) -> Octants {
        let mut octants = Octants::default();
        for (index, image) in self.images.images.iter().enumerate() {
            if !may_belong(image, cube) {
                continue;
            }
            let touched = self.judge_in(index, cube).touched;
            octants.touched |= bits_where(touched, |octant| may_belong(image, cube.octant(octant)));
        }
        octants
    }

    /// No cell farther than this from the sensor changes.
    pub(crate) fn farthest_change(&self) -> f32 {
        self.windows
            .iter()
            .map(Windows::farthest_change)
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

/// Whether some point of a cube can belong to one of several images: those of a sensor that looks
/// everywhere share directions by their longest axis.
fn may_belong(image: &RangeImage, cube: Cube) -> bool {
    let (p, e) = extent_in_image(image, cube.center, 1.001 * cube.half);
    p[2] + e[2] >= (p[0].abs() - e[0]).max(p[1].abs() - e[1])
}

/// Those bits that are set and satisfy a condition.
fn bits_where(bits: u8, condition: impl Fn(usize) -> bool) -> u8 {
    (0..8)
        .filter(|&bit| bits >> bit & 1 != 0 && condition(bit))
        .fold(0, |kept, bit| kept | 1 << bit)
}

/// Centre and half extents of a cube along an image's axes.
#[inline]
fn extent_in_image(image: &RangeImage, center: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
    let extents = image
        .axes
        .map(|axis| (axis[0].abs() + axis[1].abs() + axis[2].abs()) as f32 * half);
    (in_image(image, center), extents)
}
