//! Whether a view looks as a pose predicts: corners that should be seen against what is there.

use super::view::{Landmark, View};
use crate::{Descriptor, FeatureExtractor};
use monogrid_geometry::{Pinhole, Sim3, Vec2};

/// What was predicted and what was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Support {
    /// Corners that should be in view, of those that were compared.
    pub num_visible: usize,
    /// Those whose surroundings look as they should.
    pub num_agreeing: usize,
    /// Parts of the image (of 6 x 4) where several corners should be.
    pub cells_visible: usize,
    /// Those of them where hardly one looks as it should.
    pub cells_contradicting: usize,
}

impl Support {
    /// Share of the visible corners that agree; 0 when none is visible.
    #[must_use]
    pub fn agreement(&self) -> f64 {
        self.num_agreeing as f64 / self.num_visible.max(1) as f64
    }

    /// Share of the parts of the image that contradict; 0 when nothing could.
    #[must_use]
    pub fn contradiction(&self) -> f64 {
        self.cells_contradicting as f64 / self.cells_visible.max(1) as f64
    }
}

/// Parts of the image.
const CELLS: [usize; 2] = [6, 4];
/// Corners that make a part count.
const MIN_IN_CELL: usize = 3;
/// A part contradicts when fewer than this share of its corners agree.
const MIN_CELL_AGREEMENT: f64 = 0.25;
/// Largest change of size, in octaves, at which a descriptor can be expected to agree.
const MAX_OCTAVES: f64 = 1.0;
/// Offsets at which the corner is looked for beside its predicted pixel, px of its level: the pose
/// is not exact.
const OFFSETS_PX: [[f64; 2]; 8] = [
    [-2.0, 0.0],
    [2.0, 0.0],
    [0.0, -2.0],
    [0.0, 2.0],
    [-2.0, -2.0],
    [2.0, -2.0],
    [-2.0, 2.0],
    [2.0, 2.0],
];
/// About as many landmarks are compared, evenly chosen: more cost time and say the same.
const MAX_COMPARED: usize = 300;

/// Index of the part of an image in which a pixel lies.
pub(super) fn cell_of(pixel: &Vec2, width: usize, height: usize) -> usize {
    let part = |v: f64, size: usize, count: usize| {
        ((v / size as f64 * count as f64) as usize).min(count - 1)
    };
    part(pixel.y, height, CELLS[1]) * CELLS[0] + part(pixel.x, width, CELLS[0])
}

/// Compares the landmarks of one view with what another shows at their predicted pixels.
pub(super) fn support(
    landmarks: &[Option<Landmark>],
    view: &View,
    view_from_keyframe: &Sim3,
    extractor: &FeatureExtractor,
    pinhole: &Pinhole,
    max_distance: u32,
) -> Support {
    let Some(finest) = view.smooth.first() else {
        return Support::default();
    };
    let (width, height) = (finest.width(), finest.height());
    let mut cells = [(0usize, 0usize); CELLS[0] * CELLS[1]];
    let known = landmarks.iter().flatten().count();
    let stride = known.div_ceil(MAX_COMPARED).max(1);
    for landmark in landmarks.iter().flatten().step_by(stride) {
        let point = *view_from_keyframe * landmark.point;
        if point.z < Pinhole::MIN_DEPTH {
            continue;
        }
        let pixel = pinhole.project(&point);
        // how much larger the patch appears
        let octaves = (view_from_keyframe.scale * landmark.point.z / point.z).log2();
        let level = landmark.feature.level as f64 + octaves;
        let level = level.round().clamp(0.0, (view.smooth.len() - 1) as f64) as usize;
        if octaves.abs() > MAX_OCTAVES {
            continue;
        }
        let smooth = &view.smooth[level];
        let Some(centre) = extractor.describe_at(smooth, pixel, level) else {
            continue;
        };
        let is_like =
            |found: Descriptor| found.distance(&landmark.feature.descriptor) <= max_distance;
        let step = (1usize << level) as f64;
        let agrees = is_like(centre)
            || OFFSETS_PX.iter().any(|offset| {
                let near = pixel + Vec2::new(offset[0], offset[1]) * step;
                extractor
                    .describe_at(smooth, near, level)
                    .is_some_and(is_like)
            });
        let cell = &mut cells[cell_of(&pixel, width, height)];
        cell.0 += 1;
        cell.1 += usize::from(agrees);
    }
    let counted = cells.iter().filter(|(visible, _)| *visible >= MIN_IN_CELL);
    let contradicts = |(visible, agreeing): &(usize, usize)| {
        (*agreeing as f64) < MIN_CELL_AGREEMENT * *visible as f64
    };
    Support {
        num_visible: cells.iter().map(|c| c.0).sum(),
        num_agreeing: cells.iter().map(|c| c.1).sum(),
        cells_visible: counted.clone().count(),
        cells_contradicting: counted.filter(|c| contradicts(c)).count(),
    }
}
