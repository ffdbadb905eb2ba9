//! From the depth of a keyframe to the measurements that are mapped.
//!
//! What is not precise enough is left out here and not by the depth filter: recordings keep all
//! depth, for maps by other rules.

use crate::planes::fill_plain_regions;
use crate::scene::{Depths, KeyframeScan, measurement};
use crate::{KeyframeCamera, MappingConfig};
use monogrid_geometry::Pinhole;
use monogrid_image::{GrayImage, Image};
use monogrid_occupancy::DepthPixel as Measurement;
use monogrid_slam::store::Store;
use monogrid_slam::{DepthPixel, KeyframeId};

impl KeyframeScan {
    /// The measurements of a keyframe that pass the filter and, if the settings ask for it and
    /// there is an image, depth on the plain surfaces between them.
    #[must_use]
    pub fn new(
        id: KeyframeId,
        pixels: &[DepthPixel],
        image: Option<&Image<u8>>,
        camera: &KeyframeCamera,
        config: &MappingConfig,
    ) -> Self {
        let depths = Depths::new(id, pixels, image, config, config.filter.max_relative_sigma);
        depths.joined(id, camera, &Store::default())
    }

    /// All known pixels of a depth image (z, NaN where unknown), at a constant relative
    /// uncertainty.
    #[must_use]
    pub fn from_depth_image(
        id: KeyframeId,
        depth: &GrayImage,
        pinhole: Pinhole,
        config: &MappingConfig,
    ) -> Self {
        let (width, relative_sigma) = (depth.width(), config.depth_image_sigma as f32);
        let pixels = depth.as_slice().iter().enumerate();
        let known = pixels.filter(|(_, z)| z.is_finite() && **z > 0.0);
        let pixels = known.map(|(index, z)| {
            measurement((index % width, index / width), 1.0 / z, relative_sigma / z)
        });
        let camera = KeyframeCamera::new(pinhole, (width, depth.height()));
        Self::of_measurements(id, camera, pixels.collect(), 0)
    }
}

impl Depths {
    /// The measurements, and depth on the plain surfaces between them, both of at most that
    /// relative standard deviation.
    pub fn new(
        id: KeyframeId,
        pixels: &[DepthPixel],
        image: Option<&Image<u8>>,
        config: &MappingConfig,
        max_relative_sigma: f64,
    ) -> Self {
        let is_skipped = (id as usize) < config.filter.skip_keyframes;
        let pixels = if is_skipped { &[] } else { pixels };
        let mut measured = measured(pixels, max_relative_sigma);
        measured.shrink_to_fit();
        let mut filled = match image {
            Some(image) if config.fill.enabled => {
                fill_plain_regions(image, &measured, max_relative_sigma)
            }
            _ => Vec::new(),
        };
        filled.shrink_to_fit();
        Self { measured, filled }
    }
}

/// The measurements of at most that relative standard deviation.
fn measured(pixels: &[DepthPixel], max_relative_sigma: f64) -> Vec<Measurement> {
    let pixels = pixels.iter();
    let pixels = pixels.filter(|pixel| is_precise(pixel, max_relative_sigma));
    pixels
        .map(|pixel| Measurement {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            sigma_idepth: pixel.idepth_var.sqrt(),
        })
        .collect()
}

/// Whether a depth exists and is certain enough.
fn is_precise(pixel: &DepthPixel, max_relative_sigma: f64) -> bool {
    let (idepth, variance) = (f64::from(pixel.idepth), f64::from(pixel.idepth_var));
    // NaN fails every comparison
    idepth > 0.0
        && variance > 0.0
        && variance.is_finite()
        && variance.sqrt() <= max_relative_sigma * idepth
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(x: u16, idepth: f32, idepth_var: f32) -> DepthPixel {
        DepthPixel {
            x,
            y: 0,
            idepth,
            idepth_var,
        }
    }

    #[test]
    fn imprecise_measurements_are_dropped_by_default_and_kept_by_the_thesis() {
        let pixels = [
            pixel(0, 1.0, 0.03_f32.powi(2)),
            pixel(1, 2.0, 0.06_f32.powi(2)),
            pixel(2, 1.0, 0.04_f32.powi(2)),
            pixel(3, 1.0, 0.25),
            // what no rule keeps
            pixel(4, -1.0, 1e-4),
            pixel(5, f32::NAN, 1e-4),
            pixel(6, 1.0, f32::NAN),
            pixel(7, 1.0, 0.0),
        ];
        let kept = |id: KeyframeId, config: &MappingConfig| -> Vec<u16> {
            let limit = config.filter.max_relative_sigma;
            let kept = Depths::new(id, &pixels, None, config, limit).measured;
            kept.iter().map(|measurement| measurement.x).collect()
        };
        assert_eq!(kept(3, &MappingConfig::default()), [0, 1]);
        let mut thesis = MappingConfig::thesis();
        assert_eq!(kept(3, &thesis), [0, 1, 2, 3]);
        thesis.filter.skip_keyframes = 4;
        assert_eq!(kept(3, &thesis), [0_u16; 0]);
        assert_eq!(kept(4, &thesis), [0, 1, 2, 3]);
    }
}
