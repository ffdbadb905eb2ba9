//! Where the first depth of a keyframe comes from.

use crate::map::{DepthMap, DepthState, Hypothesis};
use monogrid_geometry::Rng;
use monogrid_image::GrayImage;

impl DepthMap {
    /// Random inverse depths in [0.5, 1.5] with variance 0.125 (LSD-SLAM's start).
    pub fn initialize_random(&mut self, seed: u64) {
        let mut words = Rng::new(seed);
        self.initialize_with(|_, _| {
            Some(Hypothesis {
                // the upper 24 bits, as many as a fraction has
                idepth: 0.5 + (words.next_u64() >> 40) as f32 / (1u32 << 24) as f32,
                var: 0.125,
                prior_var: f32::INFINITY,
                validity: 20,
            })
        });
    }

    /// The same inverse depth (1/u) and variance (1/u²) at every candidate.
    pub fn initialize_constant(&mut self, idepth: f32, idepth_var: f32) {
        self.initialize_with(|_, _| {
            Some(Hypothesis {
                idepth,
                var: idepth_var,
                prior_var: f32::INFINITY,
                validity: 20,
            })
        });
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
        let w = self.host.width();
        let mut num_known = 0;
        for y in 0..self.host.height() {
            for &x in self.candidates.row(y) {
                let i = y * w + usize::from(x);
                match hypothesis(usize::from(x), y) {
                    Some(h) => {
                        self.arrays.set(i, h);
                        self.smooth_idepth[i] = h.idepth;
                        self.smooth_var[i] = h.var;
                        num_known += 1;
                    }
                    None => self.arrays.clear(i),
                }
            }
        }
        num_known
    }

    /// Sets one pixel, for starts that bring their own depth (triangulated points); `false` when it
    /// is not a candidate or the values are not usable. Validity above `mature_validity` counts as
    /// confirmed.
    pub fn seed_pixel(&mut self, x: usize, y: usize, state: DepthState) -> bool {
        let DepthState::Known {
            idepth,
            idepth_var,
            validity,
        } = state
        else {
            return false;
        };
        let usable = idepth.is_finite() && idepth_var > 0.0 && idepth_var.is_finite();
        if !usable || !self.is_candidate(x, y) {
            return false;
        }
        let i = y * self.host.width() + x;
        self.arrays.set(
            i,
            Hypothesis {
                idepth,
                var: idepth_var,
                prior_var: idepth_var,
                validity,
            },
        );
        self.smooth_idepth[i] = idepth;
        self.smooth_var[i] = idepth_var;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DepthConfig, GradientSelection, HostError, HostFrame, PixelFilter};
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
        assert!(
            start(1)
                .iter()
                .all(|p| (0.5..1.5).contains(&p.idepth) && p.validity == 20)
        );
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
        let seed = |idepth| DepthState::Known {
            idepth,
            idepth_var: 0.01,
            validity: 30,
        };
        assert!(map.seed_pixel(31, 10, seed(0.7)));
        assert!(!map.seed_pixel(30, 10, seed(0.7)));
        assert!(!map.seed_pixel(32, 10, seed(f32::NAN)));
        assert!(!map.seed_pixel(1000, 1000, seed(0.7)));
        assert_eq!(map.num_known(), 1);
    }

    #[test]
    fn a_host_that_makes_no_sense_is_refused() {
        let image = GrayImage::filled(64, 48, 1.0);
        let pinhole = Pinhole::new(60.0, 60.0, 31.5, 23.5);
        let mask = Mask::filled(64, 40, 255);
        let error = HostFrame::new(image.clone(), mask, pinhole).expect_err("sizes differ");
        assert!(matches!(error, HostError::MaskSize { .. }));
        let bad = Pinhole::new(f64::NAN, 60.0, 31.5, 23.5);
        let error = HostFrame::new(image, Mask::filled(64, 48, 255), bad).expect_err("no focal");
        assert!(matches!(error, HostError::Intrinsics { .. }));
    }
}
