//! The keyframe as points per pyramid level.

use monogrid_geometry::Pinhole;
use monogrid_image::{DepthPixel, Pyramid, pyramid_intrinsics};
use rayon::prelude::*;

/// Points of one level, structure of arrays. Positions are viewing directions with z = 1.
#[derive(Clone, Debug, Default)]
pub struct ReferenceLevel {
    /// x of the viewing direction.
    pub x: Vec<f32>,
    /// y of the viewing direction.
    pub y: Vec<f32>,
    /// Inverse depth.
    pub idepth: Vec<f32>,
    /// Variance of the inverse depth.
    pub idepth_var: Vec<f32>,
    /// Grey value in the keyframe.
    pub intensity: Vec<f32>,
}

impl ReferenceLevel {
    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    fn with_capacity(count: usize) -> Self {
        let [x, y, idepth, idepth_var, intensity] = [(); 5].map(|()| Vec::with_capacity(count));
        Self {
            x,
            y,
            idepth,
            idepth_var,
            intensity,
        }
    }

    /// Takes the points of a row of pixels, and leaves their sums empty.
    fn take_row(&mut self, y: usize, cells: &mut [Cell], grey: &[f32], pinhole: &Pinhole) {
        let (inv_fx, inv_fy) = (1.0 / pinhole.fx as f32, 1.0 / pinhole.fy as f32);
        let (cx, cy) = (pinhole.cx as f32, pinhole.cy as f32);
        for (x, (cell, grey)) in cells.iter_mut().zip(grey).enumerate() {
            if cell.count == 0 {
                continue;
            }
            let Cell {
                information,
                weighted,
                weighted_sq,
                count,
            } = std::mem::take(cell);
            let idepth = weighted / information;
            let spread = (weighted_sq / information - idepth * idepth).max(0.0);
            self.push(
                (x as f32 - cx) * inv_fx,
                (y as f32 - cy) * inv_fy,
                idepth,
                f32::from(count) / information + spread,
                *grey,
            );
        }
    }

    fn push(&mut self, x: f32, y: f32, idepth: f32, idepth_var: f32, intensity: f32) {
        self.x.push(x);
        self.y.push(y);
        self.idepth.push(idepth);
        self.idepth_var.push(idepth_var);
        self.intensity.push(intensity);
    }
}

/// A keyframe prepared as the reference of an alignment.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// Levels, finest first.
    pub levels: Vec<ReferenceLevel>,
}

/// Sums over the samples that fall into one pixel of a coarser level.
#[derive(Clone, Copy, Default)]
struct Cell {
    information: f32,
    weighted: f32,
    weighted_sq: f32,
    count: u16,
}

impl Cell {
    fn add(&mut self, sample: &DepthPixel) {
        let information = 1.0 / sample.idepth_var;
        self.information += information;
        self.weighted += information * sample.idepth;
        self.weighted_sq += information * sample.idepth * sample.idepth;
        self.count += 1;
    }
}

impl Reference {
    /// Points for the levels `finest..=coarsest` from the semi-dense depth of a keyframe.
    ///
    /// Samples come row by row.
    ///
    /// On level n a point stands for all samples in a block of 2^n pixels: the mean weighted by
    /// information, with the variance of *one* of them (their errors are shared) plus the spread
    /// between them, so that a block across a depth edge counts little.
    #[must_use]
    pub fn new(
        pyramid: &Pyramid,
        pinhole: &Pinhole,
        samples: &[DepthPixel],
        finest: usize,
        coarsest: usize,
    ) -> Self {
        let intrinsics = pyramid_intrinsics(pinhole, pyramid.num_levels());
        let levels = (0..pyramid.num_levels())
            .into_par_iter()
            .map(|level| {
                if level < finest || level > coarsest {
                    return ReferenceLevel::default();
                }
                level_points(pyramid, &intrinsics[level], samples, level)
            })
            .collect();
        Self { levels }
    }

    /// Every pixel of one level as a point at infinity, for the estimation of a rotation alone.
    #[must_use]
    pub fn at_infinity(pyramid: &Pyramid, pinhole: &Pinhole, level: usize) -> Self {
        let intrinsics = pyramid_intrinsics(pinhole, pyramid.num_levels());
        let mut levels = vec![ReferenceLevel::default(); pyramid.num_levels()];
        if let (Some(image), Some(k)) = (pyramid.levels.get(level), intrinsics.get(level)) {
            let points = &mut levels[level];
            for y in 2..image.height().saturating_sub(2) {
                for x in 2..image.width().saturating_sub(2) {
                    let direction_x = (x as f32 - k.cx as f32) / k.fx as f32;
                    let direction_y = (y as f32 - k.cy as f32) / k.fy as f32;
                    points.push(direction_x, direction_y, 0.0, 0.0, image.at(x, y));
                }
            }
        }
        Self { levels }
    }

    /// The coarsest level with points.
    #[must_use]
    pub fn coarsest_level(&self) -> usize {
        self.levels
            .iter()
            .rposition(|level| !level.is_empty())
            .unwrap_or(0)
    }
}

/// Points of one level. Samples come in rows, so that sums are needed for one row of pixels at a
/// time.
fn level_points(
    pyramid: &Pyramid,
    pinhole: &Pinhole,
    samples: &[DepthPixel],
    level: usize,
) -> ReferenceLevel {
    let image = pyramid.level(level);
    let mut cells = vec![Cell::default(); image.width()];
    let mut points = ReferenceLevel::with_capacity(samples.len() >> level);
    let row_of = |sample: &DepthPixel| usize::from(sample.y) >> level;
    for row in samples.chunk_by(|a, b| row_of(a) == row_of(b)) {
        let y = row_of(&row[0]);
        // an odd last row or column has no pixel on the coarser level
        if y >= image.height() {
            break;
        }
        for sample in row {
            if let Some(cell) = cells.get_mut(usize::from(sample.x) >> level) {
                cell.add(sample);
            }
        }
        points.take_row(y, &mut cells, image.row(y), pinhole);
    }
    points
}
