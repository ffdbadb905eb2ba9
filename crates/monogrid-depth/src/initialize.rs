//! Where the first depth of a keyframe comes from.

use crate::DepthPixel;
use crate::map::{DepthMap, Hypothesis};
use monogrid_geometry::Rng;
use monogrid_image::GrayImage;

impl DepthMap {
    /// Random inverse depths in [0.5, 1.5] with variance 0.125 (LSD-SLAM's start).
    pub fn initialize_random(&mut self, seed: u64) {
        let mut words = Rng::new(seed);
        // the upper 24 bits, as many as a fraction has
        let mut fraction = || (words.next_u64() >> 40) as f32 / (1u32 << 24) as f32;
        self.initialize_with(|_, _| Some(newly_made(0.5 + fraction(), 0.125)));
    }

    /// The same inverse depth (1/u) and variance (1/u²) at every candidate.
    pub fn initialize_constant(&mut self, idepth: f32, idepth_var: f32) {
        self.initialize_with(|_, _| Some(newly_made(idepth, idepth_var)));
    }

    /// Inverse depth of every candidate from an image of depths `z` in u (NaN, infinite or not
    /// positive = unknown) with the given relative standard deviation. Returns how many were set;
    /// none when the image has another size.
    ///
    /// A pixel beside a depth discontinuity (a neighbour differs by more than 5 %) gets a ten times
    /// larger standard deviation: its texture may belong to either side.
    pub fn initialize_from_depth(&mut self, depth: &GrayImage, relative_sigma: f32) -> usize {
        if !depth.same_size(&self.host.image) {
            return 0;
        }
        self.initialize_with(|x, y| {
            let z = depth.at(x, y);
            if !(z.is_finite() && z > 0.0) {
                return None;
            }
            let continuous = (y - 1..=y + 1)
                .flat_map(|yy| (x - 1..=x + 1).map(move |xx| (xx, yy)))
                .all(|(xx, yy)| (depth.at(xx, yy) - z).abs() < 0.05 * z);
            let sigma = relative_sigma / z * if continuous { 1.0 } else { 10.0 };
            Some(Hypothesis {
                idepth: 1.0 / z,
                var: sigma * sigma,
                prior_var: sigma * sigma,
                validity: 50,
            })
        })
    }

    /// Sets every candidate to what `hypothesis(x, y)` says and returns how many are known.
    fn initialize_with(
        &mut self,
        mut hypothesis: impl FnMut(usize, usize) -> Option<Hypothesis>,
    ) -> usize {
        let mut num_known = 0;
        let candidates: Vec<_> = self.all_candidates().collect();
        for (x, y, i) in candidates {
            match hypothesis(x, y) {
                Some(known) => {
                    self.set(i, known);
                    num_known += 1;
                }
                None => self.arrays.clear(i),
            }
        }
        num_known
    }

    /// Sets one pixel, for starts that bring their own depth (triangulated points); `false` when it
    /// is not a candidate or the values are not usable. Validity above `mature_validity` counts as
    /// confirmed.
    pub fn seed_pixel(&mut self, pixel: &DepthPixel, validity: u8) -> bool {
        let (x, y) = (usize::from(pixel.x), usize::from(pixel.y));
        let (idepth, var) = (pixel.idepth, pixel.idepth_var);
        let usable = idepth.is_finite() && var > 0.0 && var.is_finite();
        let is_seeded = usable && self.is_candidate(x, y);
        if is_seeded {
            let seed = Hypothesis {
                idepth,
                var,
                prior_var: var,
                validity,
            };
            self.set(y * self.host.width() + x, seed);
        }
        is_seeded
    }
}

/// A hypothesis that no earlier keyframe knew.
fn newly_made(idepth: f32, var: f32) -> Hypothesis {
    Hypothesis {
        idepth,
        var,
        prior_var: f32::INFINITY,
        validity: 20,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DepthConfig, GradientSelection, HostFrame, PixelFilter};
    use monogrid_geometry::Pinhole;
    use monogrid_image::Mask;
    use std::sync::Arc;

    fn host() -> Arc<HostFrame> {
        let image = GrayImage::from_fn(64, 48, |x, _| if x < 32 { 50.0 } else { 150.0 });
        let mask = Mask::from_fn(64, 48, |_, y| if y < 24 { 255 } else { 0 });
        let pinhole = Pinhole::new(60.0, 60.0, 31.5, 23.5);
        Arc::new(HostFrame::new(image, mask, pinhole).expect("valid"))
    }

    #[test]
    fn candidates_are_pixels_with_gradient_inside_mask_and_border() {
        let own = DepthMap::empty(host(), &DepthConfig::default());
        let rows = 24 - 6;
        assert_eq!(own.num_candidates(), 2 * rows);
        assert!(own.is_candidate(31, 10) && own.is_candidate(32, 10));
        assert!(!own.is_candidate(30, 10) && !own.is_candidate(31, 30));
        let config = DepthConfig {
            selection: GradientSelection::Dilated,
            ..DepthConfig::default()
        };
        assert_eq!(DepthMap::empty(host(), &config).num_candidates(), 4 * rows);
    }

    #[test]
    fn random_start_depends_on_the_seed_alone() {
        let config = DepthConfig::thesis();
        let start = |seed| {
            let mut map = DepthMap::empty(host(), &config);
            map.initialize_random(seed);
            map.pixels(PixelFilter::default()).collect::<Vec<_>>()
        };
        assert_eq!(start(1), start(1));
        assert_ne!(start(1), start(2));
        assert!(start(1).iter().all(|p| (0.5..1.5).contains(&p.idepth)));
    }

    #[test]
    fn a_depth_image_seeds_where_it_is_known() {
        let mut map = DepthMap::empty(host(), &DepthConfig::default());
        let depth = GrayImage::from_fn(64, 48, |_, y| if y < 12 { 2.0 } else { f32::NAN });
        assert_eq!(map.initialize_from_depth(&depth, 0.02), 2 * 6);
        assert!(map.pixels(PixelFilter::default()).all(|p| p.idepth == 0.5));
        assert_eq!(
            map.initialize_from_depth(&GrayImage::filled(8, 8, 1.0), 0.02),
            0
        );
        map.rescale(2.0);
        assert_eq!(map.median_idepth(), Some(1.0));
    }

    #[test]
    fn seeds_are_refused_off_the_candidates_and_when_not_finite() {
        let mut map = DepthMap::empty(host(), &DepthConfig::default());
        let mut is_seeded = |x, y, idepth| {
            let pixel = DepthPixel {
                x,
                y,
                idepth,
                idepth_var: 0.01,
            };
            map.seed_pixel(&pixel, 30)
        };
        assert!(is_seeded(31, 10, 0.7));
        assert!(!is_seeded(30, 10, 0.7));
        assert!(!is_seeded(32, 10, f32::NAN));
        assert!(!is_seeded(1000, 1000, 0.7));
        assert_eq!(map.num_known(), 1);
    }

    #[test]
    fn a_host_that_makes_no_sense_is_refused() {
        let image = GrayImage::filled(64, 48, 1.0);
        let pinhole = Pinhole::new(60.0, 60.0, 31.5, 23.5);
        let mask = Mask::filled(64, 40, 255);
        assert!(HostFrame::new(image.clone(), mask, pinhole).is_none());
        let bad = Pinhole::new(f64::NAN, 60.0, 31.5, 23.5);
        let mask = Mask::filled(64, 48, 255);
        assert!(HostFrame::new(image.clone(), mask.clone(), bad).is_none());
        let small = GrayImage::filled(15, 48, 1.0);
        assert!(HostFrame::new(small, Mask::filled(15, 48, 255), pinhole).is_none());
        assert!(HostFrame::new(image, mask, pinhole).is_some());
    }
}
