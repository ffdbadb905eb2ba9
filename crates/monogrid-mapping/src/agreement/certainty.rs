//! Whether depth is as certain as it says: from how well keyframes agree.
//!
//! Where two keyframes see the same surface, the difference of their depths over its standard deviation is a standard normal number
//! if the deviations are right. The median of its absolute value over that of a normal (0.6745) is then what deviations have to
//! be multiplied by. Keyframes share errors, since the same images measured them, and agree better with each other than with
//! the truth. How much better, images tell that do not fit across epipolar lines, where no depth hides it: [`shared_errors`]. Measured depth
//! has one factor for the whole map, and filled depth has one.

use crate::scene::{DepthImage, Depths, KeptDepths, Scene, View, for_each_keyframe};
use monogrid_geometry::median::median;
use monogrid_occupancy::DepthPixel as Measurement;

/// How much farther the truth is than another keyframe, for each px that patches are off across their epipolar lines (robust deviation). The middle of
/// the errors alone would have 3.4 to 5.3 in six rendered sequences, of which one has a rolling shutter and one blur as well, and two real ones with a
/// depth camera; this much makes two standard deviations hold nine tenths, since errors have tails (`docs/studies.md`).
const SHARED_PER_PX: f32 = 7.5;
/// What it is taken for: depths that share nothing would be as far from the truth as from each other.
const SHARED_ERRORS: std::ops::RangeInclusive<f32> = 1.0..=5.6;
/// The same where too few patches tell: of real videos.
const USUAL_SHARED_ERRORS: f32 = 2.75;
/// Fewest patches that tell it.
const MIN_PATCHES: usize = 50;
/// Factors beyond these say that something else is wrong.
const FACTORS: std::ops::RangeInclusive<f32> = 0.25..=3.75;
/// Relative deviation that always remains: of the camera's model and of the pixels' size.
const LEAST_RELATIVE_SIGMA: f32 = 0.003;
/// Every so many pixels of a keyframe are compared.
const STRIDE: usize = 11;
/// Depths that differ by more are of two surfaces.
const MAX_RELATIVE_DIFFERENCE: f32 = 0.1;
/// Fewest comparisons that say anything.
const MIN_COMPARED: usize = 200;
/// Keyframes that each is compared with.
const MAX_WITNESSES: usize = 24;
/// Median of the absolute value of a standard normal number.
const NORMAL_MEDIAN: f32 = 0.674_49;

/// What the standard deviations of all depths have to be multiplied by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Certainty {
    pub measured: f32,
    pub filled: f32,
    /// Smallest relative deviation.
    pub least: f32,
    /// Depths that are less certain than this do not count.
    pub most: f32,
}

impl Certainty {
    /// Leaves deviations as they are.
    pub const UNCHANGED: Self = Self {
        measured: 1.0,
        filled: 1.0,
        least: 0.0,
        most: f32::INFINITY,
    };

    /// From how well keyframes with poses agree; 1 where too little is seen twice. As they are if the settings do not ask for it.
    pub fn of_scene(scene: &Scene) -> Self {
        if !scene.config.sigma_from_agreement {
            return Self::UNCHANGED;
        }
        let count = scene.views.len();
        let mine = for_each_keyframe(count, scene.threads, |index| {
            let depths = &scene.views[index].as_ref()?.depths;
            let witnesses = scene.witnesses(index, MAX_WITNESSES).into_iter();
            Some(Compared {
                sampled: depths.kinds().map(|kind| sampled(&kind)),
                witnesses: witnesses.map(|(other, _)| other).collect(),
            })
        });
        // so that the depth of each is needed once
        let differences = for_each_keyframe(count, scene.threads, |other| {
            differences_from(scene, other, &mine)
        });
        let shared = shared_errors(scene.views);
        let [measured, filled] = [0, 1].map(|kind| {
            let of_kind = differences.iter().flat_map(|kinds| &kinds[kind]);
            factor(&mut of_kind.copied().collect::<Vec<f32>>(), shared)
        });
        Self {
            measured,
            filled,
            least: LEAST_RELATIVE_SIGMA,
            most: scene.config.filter.max_agreed_sigma as f32,
        }
    }

    /// The depths of a keyframe, as certain as they are, without those that are too uncertain.
    pub fn apply(self, depths: &KeptDepths) -> Depths {
        let [measured, filled] = depths.kinds();
        Depths {
            measured: self.measured(&measured).collect(),
            filled: self.filled(&filled).collect(),
        }
    }

    /// Measured depths, as certain as they are, without those that are too uncertain.
    pub fn measured(self, pixels: &[Measurement]) -> impl Iterator<Item = Measurement> {
        self.corrected(self.measured, pixels)
    }

    /// The same of filled depths.
    pub fn filled(self, pixels: &[Measurement]) -> impl Iterator<Item = Measurement> {
        self.corrected(self.filled, pixels)
    }

    fn corrected(self, factor: f32, pixels: &[Measurement]) -> impl Iterator<Item = Measurement> {
        pixels.iter().filter_map(move |pixel| {
            let least = self.least * pixel.idepth;
            let sigma_idepth = (factor * pixel.sigma_idepth).max(least);
            (sigma_idepth <= self.most * pixel.idepth).then_some(Measurement {
                sigma_idepth,
                ..*pixel
            })
        })
    }
}

/// How much farther the truth is than another keyframe, by how far patches are off across their epipolar lines.
fn shared_errors(views: &[Option<View>]) -> f32 {
    let misfits = views.iter().flatten().flat_map(|view| view.misfits.iter());
    let mut misfits: Vec<f32> = misfits.map(|px| px.abs()).collect();
    if misfits.len() < MIN_PATCHES {
        return USUAL_SHARED_ERRORS;
    }
    (SHARED_PER_PX * robust_deviation(&mut misfits))
        .clamp(*SHARED_ERRORS.start(), *SHARED_ERRORS.end())
}

fn factor(differences: &mut [f32], shared: f32) -> f32 {
    if differences.len() < MIN_COMPARED {
        return 1.0;
    }
    (shared * robust_deviation(differences)).clamp(*FACTORS.start(), *FACTORS.end())
}

/// The standard deviation of normal numbers with the median of these absolute values, of which there is one.
fn robust_deviation(magnitudes: &mut [f32]) -> f32 {
    median(magnitudes).map_or(f32::NAN, |median| median / NORMAL_MEDIAN)
}

/// What of a keyframe is compared with others.
struct Compared {
    /// Some of the depths that were measured, and of those that were filled in.
    sampled: [Vec<Measurement>; 2],
    /// The others, by their index.
    witnesses: Vec<usize>,
}

fn sampled(pixels: &[Measurement]) -> Vec<Measurement> {
    pixels.iter().step_by(STRIDE).copied().collect()
}

/// Absolute differences, in standard deviations, of the depths of all keyframes from those of a witness: measured from measured depth,
/// filled from filled.
fn differences_from(scene: &Scene, other: usize, mine: &[Option<Compared>]) -> [Vec<f32>; 2] {
    let mut differences = [Vec::new(), Vec::new()];
    let Some(witness) = &scene.views[other] else {
        return differences;
    };
    let theirs = witness.depths.kinds().map(|kind| {
        let mut image = DepthImage::new(scene.camera);
        image.show(kind.iter().copied());
        image
    });
    let views = scene.views.iter().flatten().zip(mine.iter().flatten());
    for (this, mine) in views.filter(|(_, mine)| mine.witnesses.contains(&other)) {
        let other_from_this = this.transfer_to(witness, scene.camera);
        let kinds = mine.sampled.iter().zip(&theirs);
        for (differences, (mine, theirs)) in differences.iter_mut().zip(kinds) {
            differences.extend(mine.iter().filter_map(|pixel| {
                let seen = other_from_this.of(pixel.x.into(), pixel.y.into(), pixel.idepth)?;
                let (x, y) = seen.pixel();
                difference(pixel, seen.idepth, theirs.at(x, y)?)
            }));
        }
    }
    differences
}

/// Relative difference of two inverse depths in standard deviations; `None` for two surfaces.
fn difference(pixel: &Measurement, expected: f32, [other, its_sigma]: [f32; 2]) -> Option<f32> {
    let relative = (other / expected - 1.0).abs();
    let sigma = (pixel.sigma_idepth / pixel.idepth).hypot(its_sigma);
    (relative < MAX_RELATIVE_DIFFERENCE && sigma > 0.0).then(|| relative / sigma)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DepthFilterConfig, KeyframeCamera, MappingConfig};
    use monogrid_geometry::{Pinhole, Rotation, Sim3, Vec3};

    const CAMERA: KeyframeCamera = KeyframeCamera {
        pinhole: Pinhole {
            fx: 60.0,
            fy: 60.0,
            cx: 39.5,
            cy: 29.5,
        },
        width: 80,
        height: 60,
    };

    /// A wall at 2 seen by keyframes side by side, with errors of this relative deviation, of which they say `said`.
    fn wall(errors: f32, said: f32) -> Vec<(Depths, Sim3)> {
        let mut state = 7_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        // the sum of twelve has a variance of one
        let mut normal = || (0..12).map(|_| random()).sum::<f32>();
        let mut pixels = || -> Vec<Measurement> {
            (0..60 * 80)
                .map(|k| {
                    let idepth = 0.5 * (1.0 + errors * normal());
                    Measurement {
                        x: k % 80,
                        y: k / 80,
                        idepth,
                        sigma_idepth: said * idepth,
                    }
                })
                .collect()
        };
        (0..6)
            .map(|k| {
                let depths = Depths {
                    measured: pixels(),
                    filled: Vec::new(),
                };
                let centre = Vec3::new(0.05 * f64::from(k), 0.0, 0.0);
                (depths, Sim3::new(1.0, Rotation::identity(), centre))
            })
            .collect()
    }

    fn views(keyframes: &[(Depths, Sim3)], misfits: &[f32]) -> Vec<Option<View>> {
        let view = |(depths, pose): &(Depths, Sim3)| {
            Some(View {
                misfits: misfits.into(),
                ..View::in_memory(depths, *pose, &CAMERA)
            })
        };
        keyframes.iter().map(view).collect()
    }

    /// From keyframes with these misfits.
    fn certainty_with(keyframes: &[(Depths, Sim3)], misfits: &[f32]) -> Certainty {
        let config = MappingConfig {
            filter: DepthFilterConfig {
                max_agreed_sigma: 0.05,
                ..DepthFilterConfig::default()
            },
            ..MappingConfig::default()
        };
        Certainty::of_scene(&Scene {
            keyframes: &[],
            views: &views(keyframes, misfits),
            camera: &CAMERA,
            config: &config,
            threads: 2,
        })
    }

    fn certainty(keyframes: &[(Depths, Sim3)]) -> Certainty {
        certainty_with(keyframes, &[])
    }

    #[test]
    fn the_truth_is_farther_than_keyframes_where_patches_are_farther_from_their_lines() {
        let keyframes = wall(0.01, 0.01);
        // with a median of 0.2 px: a robust deviation of 0.3 px
        let misfits = [-0.9, 0.2, -0.2, 0.1, 0.2, -0.1, 0.5, 0.2, -0.2];
        let factor = |scale: f32| {
            let misfits = misfits.map(|px| scale * px);
            certainty_with(&keyframes, &misfits).measured
        };
        let usual = certainty(&keyframes).measured / USUAL_SHARED_ERRORS;
        let expected = SHARED_PER_PX * 0.2 / NORMAL_MEDIAN;
        assert!((factor(1.0) / usual - expected).abs() < 1e-4);
        assert!((factor(1.5) / usual - 1.5 * expected).abs() < 1e-4);
        assert!((factor(0.01) / usual - SHARED_ERRORS.start()).abs() < 1e-4);
        assert!((factor(9.0) - (SHARED_ERRORS.end() * usual).min(*FACTORS.end())).abs() < 1e-4);
        // 48 of them say nothing
        let few = certainty_with(&keyframes, &misfits[..8]);
        assert!((few.measured / usual - USUAL_SHARED_ERRORS).abs() < 1e-4);
    }

    #[test]
    fn deviations_become_those_of_the_differences() {
        for (errors, said, expected) in [(0.01, 0.01, 1.0), (0.01, 0.02, 0.5), (0.012, 0.01, 1.2)] {
            let found = certainty(&wall(errors, said));
            let factor = found.measured / USUAL_SHARED_ERRORS;
            assert!(
                (factor / expected - 1.0).abs() < 0.05,
                "{errors} {said}: {factor}"
            );
            // nothing was filled
            assert!((found.filled - 1.0).abs() < 1e-6);
        }
        // one keyframe knows nothing about itself
        assert!((certainty(&wall(0.01, 0.01)[..1]).measured - 1.0).abs() < 1e-6);
    }

    #[test]
    fn factors_stay_within_their_bounds_and_deviations_above_the_least() {
        let mut keyframes = wall(0.03, 0.002);
        assert!((certainty(&keyframes).measured - FACTORS.end()).abs() < 1e-6);
        let certain = certainty(&wall(0.0, 0.01));
        assert!((certain.measured - FACTORS.start()).abs() < 1e-6);
        let depths = &mut keyframes[0].0;
        depths.measured[0].sigma_idepth = 0.3 * depths.measured[0].idepth;
        let applied: Vec<Measurement> = certain.measured(&depths.measured).collect();
        assert_eq!(applied.len(), 60 * 80 - 1);
        for pixel in &applied {
            assert!((pixel.sigma_idepth / pixel.idepth - LEAST_RELATIVE_SIGMA).abs() < 1e-6);
        }
    }
}
