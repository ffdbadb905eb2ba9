//! Where the first depth of a keyframe comes from.

use crate::map::{DepthMap, DepthState, Hypothesis};
use monogrid_image::GrayImage;

impl DepthMap {
    /// Random inverse depths in [0.5, 1.5] with variance 0.125 (LSD-SLAM's start).
    pub fn initialize_random(&mut self, seed: u64) {
        let mut state = seed;
        self.initialize_with(|_, _| {
            Some(Hypothesis {
                idepth: 0.5 + unit_random(&mut state),
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

/// Next number of `SplitMix64` in [0, 1).
fn unit_random(state: &mut u64) -> f32 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^= z >> 31;
    (z >> 40) as f32 / (1u32 << 24) as f32
}
