//! The updates of the cells of a brick by the rule `fused`, and bounds of those of a whole cube.

use crate::integrate::fused::octants::{Cube, View};
use crate::integrate::image::RangeImages;
use crate::integrate::image::range_image::{HOLE, RangeImage};
use crate::integrate::image::windows::Windows;
use crate::integrate::kernel::kernel_image::KernelImage;
use crate::integrate::kernel::scalar::{
    FlatTables, Kernel, Placed, Weights, bits_of, cells_of, evidence, index_of,
};
use crate::integrate::octants::Octants;
use crate::key::BRICK_CELLS;
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
                .map(|image| kernel_image(image, tables))
                .collect(),
            tables: flatten(tables, images.obstacle_weight),
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

    /// The weights of cells around a brick's centre (relative to the sensor, world axes).
    ///
    /// One value per brick keeps uniform space uniform.
    pub(crate) fn weights(&self, center: [f32; 3]) -> Weights {
        let Some(index) = self.image_of(center) else {
            return Weights {
                single: 1.0,
                by_hits: std::array::from_fn(|i| 1.0 / (i + 1) as f32),
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
        }
    }

    /// Writes the evidence for the touched octants of the brick around `center` (relative to the
    /// sensor, world axes) into that of its cells; 0 where the scan says nothing.
    pub(crate) fn evidence(
        &self,
        center: [f32; 3],
        weights: &Weights,
        octants: Octants,
        cells: &mut [i16; BRICK_CELLS],
    ) {
        let half = 4.0 * self.resolution;
        let brick = Cube { center, half };
        if let Some(index) = self.image_of_cube(brick) {
            return self.evidence_in(index, center, weights, octants, cells);
        }
        for octant in bits_of(octants.touched) {
            if let Some(index) = self.image_of_cube(brick.octant(usize::from(octant))) {
                let octants = octants.only(octant);
                self.evidence_in(index, center, weights, octants, cells);
                continue;
            }
            // Where the images of a sensor that looks everywhere meet, each cell has its own.
            for cell in cells_of(octant) {
                cells[index_of(cell)] = self.cell_evidence(center, cell, weights);
            }
        }
    }

    /// [`Footprints::evidence`] from one image.
    fn evidence_in(
        &self,
        index: usize,
        center: [f32; 3],
        weights: &Weights,
        octants: Octants,
        cells: &mut [i16; BRICK_CELLS],
    ) {
        let brick = self.placed(&self.images.images[index], center);
        self.kernel(index).brick(&brick, weights, octants, cells);
    }

    /// Evidence of a cell of a brick.
    pub(crate) fn cell_evidence(
        &self,
        center: [f32; 3],
        cell: [usize; 3],
        weights: &Weights,
    ) -> i16 {
        let point = std::array::from_fn(|a| center[a] + (cell[a] as f32 - 3.5) * self.resolution);
        self.image_of(point).map_or(0, |image| {
            let brick = self.placed(&self.images.images[image], center);
            self.kernel(image).cell(&brick, cell, weights)
        })
    }

    fn kernel(&self, index: usize) -> Kernel<'_> {
        Kernel {
            image: &self.kernel_images[index],
            tables: &self.tables,
        }
    }

    fn placed(&self, image: &RangeImage, center: [f32; 3]) -> Placed {
        let cell = self.resolution;
        let first = center.map(|c| c - 3.5 * cell);
        Placed {
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
            nearest: NEAREST_CELLS * self.resolution,
        };
        #[cfg(target_arch = "x86_64")]
        if let Some(octants) = crate::integrate::fused::octants_avx2::judge(&view, cube) {
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

fn flatten(tables: &[EvidenceTable], obstacle: i32) -> FlatTables {
    let mut flat = FlatTables::default();
    for table in tables {
        flat.push(table.inv_step as f32, table.free, &table.entries, obstacle);
    }
    flat
}

fn kernel_image(image: &RangeImage, tables: &[EvidenceTable]) -> KernelImage {
    let starts: Vec<f32> = tables.iter().map(|table| table.start as f32).collect();
    let near = |range, start| match range {
        HOLE => f32::NEG_INFINITY,
        range => range + start,
    };
    let near: Vec<f32> = if image.tables.is_empty() {
        let start = starts.first().copied().unwrap_or(0.0);
        image
            .ranges
            .iter()
            .map(|&range| near(range, start))
            .collect()
    } else {
        let pixels = image.ranges.iter().zip(&image.tables);
        pixels
            .map(|(&range, &table)| near(range, starts[usize::from(table)]))
            .collect()
    };
    KernelImage::new(
        [image.width, image.height],
        [image.focal, image.center],
        &near,
        &image.tables,
    )
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
