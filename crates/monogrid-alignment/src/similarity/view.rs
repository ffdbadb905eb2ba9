//! A keyframe as both sides of an alignment need it.

use crate::{DepthPixel, Reference, ReferenceLevel, Target, TargetLevel};
use monogrid_geometry::Pinhole;
use monogrid_image::Pyramid;
use monogrid_image::lanes::{F32x8, Lanes};

/// Inverse depth per pixel of one level; a variance of 0 says unknown.
#[derive(Clone, Debug, Default)]
pub struct DepthLevel {
    width: usize,
    /// `[inverse depth, variance]`, row-major.
    values: Vec<[f32; 2]>,
}

impl DepthLevel {
    /// Puts the points of a level back into their pixels.
    fn new(points: &ReferenceLevel, image: &TargetLevel) -> Self {
        let mut values = vec![[0.0; 2]; image.width * image.height];
        let [fx, fy, cx, cy] = image.intrinsics;
        for i in 0..points.len() {
            let u = (points.x[i] * fx + cx).round().max(0.0) as usize;
            let v = (points.y[i] * fy + cy).round().max(0.0) as usize;
            if let Some(value) = values.get_mut(v * image.width + u) {
                *value = [points.idepth[i], points.idepth_var[i]];
            }
        }
        Self {
            width: image.width,
            values,
        }
    }

    /// Inverse depths and variances at the nearest pixels, for those of the mask; variance 0 where
    /// nothing is known.
    #[inline(always)]
    pub(crate) fn nearest_lanes<L: Lanes>(
        &self,
        lanes: L,
        u: L::F32,
        v: L::F32,
        mask: L::F32,
    ) -> [L::F32; 2] {
        let (u, v, mask) = (u.to_array(), v.to_array(), mask.bits());
        let mut out = [[0.0; 8]; 2];
        for l in (0..8).filter(|l| mask >> l & 1 == 1) {
            let i = (v[l] + 0.5) as usize * self.width + (u[l] + 0.5) as usize;
            if let Some(&[idepth, var]) = self.values.get(i) {
                [out[0][l], out[1][l]] = [idepth, var];
            }
        }
        [lanes.f32s(&out[0]), lanes.f32s(&out[1])]
    }
}

/// Points, image and depth of a keyframe on the levels of an alignment.
#[derive(Clone, Debug, Default)]
pub struct KeyframeView {
    /// Points, as the side that is projected.
    pub reference: Reference,
    /// Image, as the side that is projected into.
    pub target: Target,
    /// Depth, as the side that is projected into.
    pub depth: Vec<DepthLevel>,
}

impl KeyframeView {
    /// Prepares the levels `finest..=coarsest` of a keyframe with semi-dense inverse depth.
    #[must_use]
    pub fn new(
        pyramid: &Pyramid,
        pinhole: &Pinhole,
        samples: &[DepthPixel],
        finest: usize,
        coarsest: usize,
    ) -> Self {
        let reference = Reference::new(pyramid, pinhole, samples, finest, coarsest);
        let target = Target::new(pyramid, pinhole, finest, coarsest);
        let depth = reference.levels.iter().zip(&target.levels);
        Self {
            depth: depth
                .map(|(points, image)| DepthLevel::new(points, image))
                .collect(),
            reference,
            target,
        }
    }

    /// Points of the finest prepared level.
    #[must_use]
    pub fn num_points(&self) -> usize {
        self.reference
            .levels
            .iter()
            .map(ReferenceLevel::len)
            .find(|n| *n > 0)
            .unwrap_or(0)
    }
}
