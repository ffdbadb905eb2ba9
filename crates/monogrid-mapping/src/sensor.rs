//! From the depth of a keyframe to the measurements that are mapped.
//!
//! What is not precise enough is left out here and not by the depth filter: recordings keep all
//! depth, for maps by other rules.

use crate::planes::fill_plain_regions;
use crate::scene::{DepthImage, Depths, KeyframeScan, measurement};
use crate::{DepthFilterConfig, KeyframeCamera, MappingConfig};
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
        let limit = config.filter.max_relative_sigma;
        let depths = Depths::new(id, pixels, image, camera, (config, limit));
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
    /// The measurements that pass the filter, and depth on the plain surfaces between them, of at
    /// most that relative standard deviation.
    pub fn new(
        id: KeyframeId,
        pixels: &[DepthPixel],
        image: Option<&Image<u8>>,
        camera: &KeyframeCamera,
        (config, max_filled_sigma): (&MappingConfig, f64),
    ) -> Self {
        let mut measured = measured(id, pixels, camera, &config.filter);
        measured.shrink_to_fit();
        let mut filled = match image {
            Some(image) if config.fill.enabled => {
                fill_plain_regions(image, &measured, max_filled_sigma)
            }
            _ => Vec::new(),
        };
        filled.shrink_to_fit();
        Self { measured, filled }
    }
}

/// The measurements that pass the filter.
fn measured(
    id: KeyframeId,
    pixels: &[DepthPixel],
    camera: &KeyframeCamera,
    config: &DepthFilterConfig,
) -> Vec<Measurement> {
    if (id as usize) < config.skip_keyframes {
        return Vec::new();
    }
    let mut image = DepthImage::new(camera);
    for pixel in pixels {
        let depth = [pixel.idepth, pixel.idepth_var];
        image.set(pixel.x.into(), pixel.y.into(), depth);
    }
    let is_supported = |pixel: &DepthPixel| {
        config.min_support <= 1 || support(&image, pixel) >= config.min_support
    };
    pixels
        .iter()
        .filter(|pixel| is_precise(pixel, config) && is_supported(pixel))
        .map(|pixel| Measurement {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            sigma_idepth: pixel.idepth_var.sqrt(),
        })
        .collect()
}

/// Whether a depth exists and is certain enough.
fn is_precise(pixel: &DepthPixel, config: &DepthFilterConfig) -> bool {
    let (idepth, variance) = (f64::from(pixel.idepth), f64::from(pixel.idepth_var));
    // NaN fails every comparison
    idepth > 0.0
        && variance > 0.0
        && variance.is_finite()
        && variance.sqrt() <= config.max_relative_sigma * idepth
}

/// How many of the 3x3 pixels around one agree with it within two standard deviations.
fn support(image: &DepthImage, pixel: &DepthPixel) -> usize {
    let agrees = |(_, _, [idepth, variance]): &(usize, usize, [f32; 2])| {
        (pixel.idepth - idepth).powi(2) <= 4.0 * (pixel.idepth_var + variance)
    };
    let around = image.around(pixel.x.into(), pixel.y.into());
    around.filter(agrees).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(x: u16, y: u16, idepth: f32) -> DepthPixel {
        DepthPixel {
            x,
            y,
            idepth,
            idepth_var: 1e-4,
        }
    }

    const CAMERA: KeyframeCamera = KeyframeCamera {
        pinhole: Pinhole {
            fx: 10.0,
            fy: 10.0,
            cx: 10.0,
            cy: 5.0,
        },
        width: 20,
        height: 10,
    };

    #[test]
    fn lonely_and_imprecise_measurements_are_dropped_by_default_and_kept_by_the_thesis() {
        // nine neighbours in the middle, six at the edges, four at the corners
        let patch = (4..7).flat_map(|y| (4..7).map(move |x| pixel(x, y, 1.0)));
        let lonely = pixel(12, 5, 1.0);
        let contradicted = pixel(7, 5, 3.0);
        let imprecise = DepthPixel {
            idepth_var: 0.25,
            ..pixel(15, 8, 1.0)
        };
        let invalid = [
            pixel(0, 0, -1.0),
            pixel(0, 1, f32::NAN),
            DepthPixel {
                idepth_var: f32::NAN,
                ..pixel(0, 2, 1.0)
            },
        ];
        let mut pixels = vec![lonely, contradicted, imprecise];
        pixels.extend(invalid);
        pixels.extend(patch);
        let count = |config: &DepthFilterConfig| measured(3, &pixels, &CAMERA, config).len();
        assert_eq!(count(&DepthFilterConfig::default()), 5);
        assert_eq!(count(&MappingConfig::thesis().filter), 12);
        let late = DepthFilterConfig {
            skip_keyframes: 4,
            ..DepthFilterConfig::default()
        };
        assert_eq!(count(&late), 0);
    }

    #[test]
    fn support_agrees_with_a_search_over_all_pairs() {
        // a slanted patch with noise from a fixed sequence
        let mut state = 7u32;
        let mut pixels = Vec::new();
        for y in 0..10u16 {
            for x in 0..20u16 {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if state >> 30 != 0 {
                    let noise = (state >> 16) as f32 / 65536.0 - 0.5;
                    pixels.push(pixel(x, y, 1.0 + 0.01 * f32::from(x) + 0.05 * noise));
                }
            }
        }
        let config = DepthFilterConfig::default();
        let expected: Vec<(u16, u16)> = pixels
            .iter()
            .filter(|p| {
                let agreeing = pixels.iter().filter(|q| {
                    p.x.abs_diff(q.x) <= 1
                        && p.y.abs_diff(q.y) <= 1
                        && (p.idepth - q.idepth).powi(2) <= 4.0 * (p.idepth_var + q.idepth_var)
                });
                agreeing.count() >= config.min_support
            })
            .map(|p| (p.x, p.y))
            .collect();
        let kept = measured(0, &pixels, &CAMERA, &config);
        let found: Vec<(u16, u16)> = kept.iter().map(|p| (p.x, p.y)).collect();
        assert_eq!(found, expected);
        assert!(found.len() > 20 && found.len() < pixels.len());
    }
}
