//! What is known of one image: its corners, and of a keyframe their depths.

use crate::{Descriptor, Feature, FeatureExtractor};
use monogrid_geometry::{Pinhole, Vec2, Vec3};
use monogrid_image::{GrayImage, Image, Mask, Pyramid};

/// A measured inverse depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepth {
    /// Inverse depth, 1 / keyframe units.
    pub idepth: f32,
    /// Its variance.
    pub idepth_var: f32,
}

impl InverseDepth {
    /// Standard deviation over value.
    #[must_use]
    pub fn relative_sigma(&self) -> f64 {
        f64::from(self.idepth_var).sqrt() / f64::from(self.idepth)
    }
}

/// Semi-dense inverse depth of a keyframe, for looking up the depth of corners.
#[derive(Clone, Debug)]
pub struct DepthLookup {
    depths: Image<Option<InverseDepth>>,
}

/// Half width of the window in which the depth of a corner is looked up, px.
const WINDOW: i64 = 2;
/// Fewest depths in the window.
const MIN_DEPTHS: usize = 3;
/// Depths of one surface differ by less than this share.
const SAME_SURFACE: f32 = 0.1;

impl DepthLookup {
    /// Depths of pixels `(column, row, depth)` of a level-0 image; what lies outside, is not finite
    /// or not positive is left out.
    #[must_use]
    pub fn new(
        width: usize,
        height: usize,
        pixels: impl IntoIterator<Item = (u16, u16, InverseDepth)>,
    ) -> Self {
        let mut depths = Image::filled(width, height, None);
        for (x, y, depth) in pixels {
            let is_sound = depth.idepth.is_finite()
                && depth.idepth > 0.0
                && depth.idepth_var.is_finite()
                && depth.idepth_var >= 0.0;
            if is_sound && usize::from(x) < width && usize::from(y) < height {
                depths.set(x.into(), y.into(), Some(depth));
            }
        }
        Self { depths }
    }

    /// Median depth of the pixels around a corner; `None` when they are few or disagree, as on an
    /// edge between near and far.
    #[must_use]
    pub fn at(&self, pixel: &Vec2) -> Option<InverseDepth> {
        if !(pixel.x.is_finite() && pixel.y.is_finite()) {
            return None;
        }
        let (cx, cy) = (pixel.x.round() as i64, pixel.y.round() as i64);
        let (w, h) = (self.depths.width() as i64, self.depths.height() as i64);
        let mut near: Vec<InverseDepth> = Vec::new();
        for y in (cy - WINDOW).max(0)..(cy + WINDOW + 1).min(h) {
            for x in (cx - WINDOW).max(0)..(cx + WINDOW + 1).min(w) {
                near.extend(self.depths.at(x as usize, y as usize));
            }
        }
        let num_near = near.len();
        near.sort_by(|a, b| a.idepth.total_cmp(&b.idepth));
        let median = near.get(num_near / 2)?.idepth;
        near.retain(|d| (d.idepth - median).abs() < SAME_SURFACE * median);
        if near.len() < MIN_DEPTHS || 4 * near.len() < 3 * num_near {
            return None;
        }
        // neighbours share their errors: the variance of one, not of a mean
        near.sort_by(|a, b| a.idepth_var.total_cmp(&b.idepth_var));
        let idepth_var = near[near.len() / 2].idepth_var;
        Some(InverseDepth {
            idepth: median,
            idepth_var,
        })
    }
}

/// An image with its corners and what is needed to describe other pixels of it.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub features: Vec<Feature>,
    /// Smoothed levels.
    pub smooth: Vec<GrayImage>,
}

impl View {
    pub(super) fn new(
        extractor: &FeatureExtractor,
        pyramid: &Pyramid,
        mask: Option<&Mask>,
    ) -> Self {
        let smooth = extractor.smoothed_levels(pyramid);
        let features = extractor.extract_smoothed(pyramid, &smooth, mask);
        Self { features, smooth }
    }

    pub(super) fn descriptors(&self) -> Vec<Descriptor> {
        self.features.iter().map(|f| f.descriptor).collect()
    }
}

/// A corner with a position in space, in the units and the frame of its keyframe.
#[derive(Clone, Copy, Debug)]
pub(super) struct Landmark {
    pub feature: Feature,
    pub point: Vec3,
    pub relative_sigma: f64,
}

/// The landmark of each feature, where a usable depth is known.
pub(super) fn landmarks(
    features: &[Feature],
    depth: &DepthLookup,
    pinhole: &Pinhole,
    max_relative_sigma: f64,
) -> Vec<Option<Landmark>> {
    let landmark = |feature: &Feature| {
        let found = depth.at(&feature.pixel)?;
        let relative_sigma = found.relative_sigma();
        (relative_sigma <= max_relative_sigma).then(|| Landmark {
            feature: *feature,
            point: pinhole.unproject(&feature.pixel) / f64::from(found.idepth),
            relative_sigma,
        })
    };
    features.iter().map(landmark).collect()
}
