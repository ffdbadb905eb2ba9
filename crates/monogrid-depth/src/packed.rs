//! The depth of a keyframe that is out of use, small, until it is used again.

use crate::map::Hypothesis;
use crate::{DepthConfig, DepthMap, HostFrame};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A pixel with a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct PackedPixel {
    x: u16,
    y: u16,
    idepth: f32,
    var: f32,
    /// Upper halves of the numbers' bits: they only bound variances.
    prior_var: u16,
    floor_var: u16,
    photo_px: u16,
    validity: u8,
}

/// What a [`DepthMap`] knows, without what follows from its image: 20 bytes per known pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PackedDepth {
    pixels: Vec<PackedPixel>,
    noise_var: f32,
    noise_measured: bool,
    is_measured: bool,
    near_limit: f32,
}

impl PackedDepth {
    /// Number of pixels with a hypothesis.
    #[must_use]
    pub fn num_known(&self) -> usize {
        self.pixels.len()
    }

    /// Heap memory, bytes.
    #[must_use]
    pub fn bytes_in_memory(&self) -> usize {
        self.pixels.capacity() * size_of::<PackedPixel>()
    }
}

fn upper_half(value: f32) -> u16 {
    (value.to_bits() >> 16) as u16
}

fn from_upper_half(bits: u16) -> f32 {
    f32::from_bits(u32::from(bits) << 16)
}

impl DepthMap {
    /// The hypotheses of all pixels; counts of failures are forgotten.
    #[must_use]
    pub fn packed(&self) -> PackedDepth {
        let mut pixels = Vec::with_capacity(self.num_known());
        let arrays = &self.arrays;
        let is_known = |candidate: &(_, _, usize)| arrays.var[candidate.2] > 0.0;
        for (x, y, i) in self.all_candidates().filter(is_known) {
            pixels.push(PackedPixel {
                x: x as u16,
                y: y as u16,
                idepth: arrays.idepth[i],
                var: arrays.var[i],
                prior_var: upper_half(arrays.prior_var[i]),
                floor_var: upper_half(arrays.floor_var[i]),
                photo_px: upper_half(arrays.photo_px[i]),
                validity: arrays.validity[i],
            });
        }
        pixels.shrink_to_fit();
        PackedDepth {
            pixels,
            noise_var: self.noise_var,
            noise_measured: self.noise_measured,
            is_measured: self.is_measured,
            near_limit: self.near_limit,
        }
    }

    /// The depth map of a keyframe from its image and hypotheses; not smoothed yet. Pixels of which
    /// the image says that they cannot carry a depth are left out.
    #[must_use]
    pub fn unpacked(host: Arc<HostFrame>, packed: &PackedDepth, config: &DepthConfig) -> Self {
        let mut depth = Self::empty(host, config);
        let width = depth.host.width();
        for pixel in &packed.pixels {
            let (x, y) = (usize::from(pixel.x), usize::from(pixel.y));
            if !depth.is_candidate(x, y) {
                continue;
            }
            let i = y * width + x;
            let hypothesis = Hypothesis {
                idepth: pixel.idepth,
                var: pixel.var,
                prior_var: from_upper_half(pixel.prior_var),
                validity: pixel.validity,
            };
            depth.set(i, hypothesis);
            depth.arrays.floor_var[i] = from_upper_half(pixel.floor_var);
            depth.arrays.photo_px[i] = from_upper_half(pixel.photo_px);
        }
        depth.noise_var = packed.noise_var;
        depth.noise_measured = packed.noise_measured;
        depth.is_measured = packed.is_measured;
        depth.near_limit = packed.near_limit;
        depth
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DepthPixel;
    use monogrid_geometry::Pinhole;
    use monogrid_image::{GrayImage, Mask};

    fn host() -> Arc<HostFrame> {
        let image = GrayImage::from_fn(64, 48, |x, y| ((x * 37 + y * 11) % 97) as f32 * 2.0);
        let pinhole = Pinhole::new(60.0, 60.0, 31.5, 23.5);
        Arc::new(HostFrame::new(image, Mask::filled(64, 48, 255), pinhole).unwrap())
    }

    #[test]
    fn what_is_known_comes_back() {
        let config = DepthConfig::default();
        let mut depth = DepthMap::empty(host(), &config);
        for (x, y) in [(10, 10), (20, 31), (50, 40), (33, 7)] {
            let pixel = DepthPixel {
                x,
                y,
                idepth: 0.5 + f32::from(x) * 0.01,
                idepth_var: 1e-3 * f32::from(y),
            };
            assert!(depth.seed_pixel(&pixel, x as u8));
        }
        let packed = depth.packed();
        assert_eq!(packed.num_known(), 4);
        assert!(packed.bytes_in_memory() <= 4 * 20);
        let back = DepthMap::unpacked(host(), &packed, &config);
        for y in 0..48 {
            for x in 0..64 {
                assert_eq!(depth.at(x, y), back.at(x, y));
            }
        }
        assert_eq!(depth.arrays.validity, back.arrays.validity);
        let (a, b) = (&depth.arrays.prior_var, &back.arrays.prior_var);
        for (a, b) in a.iter().zip(b).filter(|(a, _)| a.is_finite()) {
            assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
        }
        assert_eq!(back.packed(), packed);
    }
}
