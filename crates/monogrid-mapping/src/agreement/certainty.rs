//! Whether depth is as certain as it says: from how well keyframes agree.
//!
//! Where two keyframes see the same surface, the difference of their depths over its standard
//! deviation is a standard normal number if the deviations are right. The median of its absolute
//! value over that of a normal (0.6745) is then what deviations have to be multiplied by. Keyframes
//! share errors, since the same images measured them, and agree better with each other than with
//! the truth by a usual factor. Measured depth has one factor for the whole map, and filled depth
//! has one.

use crate::scene::{DepthImage, Depths, KeptDepths, Scene, for_each_keyframe};
use monogrid_geometry::median::median;
use monogrid_occupancy::DepthPixel as Measurement;

/// How much farther the truth is than another keyframe: depths that share nothing would be as far
/// from the truth as from each other. In six rendered sequences and two real ones with a depth
/// camera, two standard deviations then hold nine tenths.
const SHARED_ERRORS: f32 = 2.75;
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
const MAX_COVISIBLE: usize = 24;
/// Median of the absolute value of a standard normal number.
const NORMAL_MEDIAN: f32 = 0.674_49;

/// What the standard deviations of all depths have to be multiplied by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Certainty {
    pub measured: f32,
    pub filled: f32,
    /// Smallest relative deviation.
    pub least: f32,
    /// Depths with a larger relative deviation do not count: the limit of the settings, or that of
    /// half of the measured depth where it is larger.
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

    /// From how well keyframes with poses agree; 1 where too little is seen twice.
    pub fn of_scene(scene: &Scene) -> Self {
        let count = scene.views.len();
        let mine = for_each_keyframe(count, scene.threads, |index| {
            let depths = &scene.views[index].as_ref()?.depths;
            let covisible = scene.covisible(index, MAX_COVISIBLE).into_iter();
            Some(Compared {
                sampled: depths.kinds().map(|kind| sampled(&kind)),
                covisible: covisible.map(|(other, _)| other).collect(),
            })
        });
        // so that the depth of each is needed once
        let differences = for_each_keyframe(count, scene.threads, |other| {
            differences_from(scene, other, &mine)
        });
        let [measured, filled] = [0, 1].map(|kind| {
            let of_kind = differences.iter().flat_map(|kinds| &kinds[kind]);
            factor(&mut of_kind.copied().collect::<Vec<f32>>())
        });
        let sampled = mine.iter().flatten().flat_map(|kept| &kept.sampled[0]);
        let relative = sampled.map(|pixel| measured * pixel.sigma_idepth / pixel.idepth);
        let typical = median(&mut relative.collect::<Vec<f32>>());
        Self {
            measured,
            filled,
            least: LEAST_RELATIVE_SIGMA,
            most: typical
                .unwrap_or(0.0)
                .max(scene.config.filter.max_relative_sigma as f32),
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

fn factor(differences: &mut [f32]) -> f32 {
    if differences.len() < MIN_COMPARED {
        return 1.0;
    }
    (SHARED_ERRORS * robust_deviation(differences)).clamp(*FACTORS.start(), *FACTORS.end())
}

/// The standard deviation of normal numbers with the median of these absolute values, of which
/// there is one.
fn robust_deviation(magnitudes: &mut [f32]) -> f32 {
    median(magnitudes).map_or(f32::NAN, |median| median / NORMAL_MEDIAN)
}

/// What of a keyframe is compared with others.
struct Compared {
    /// Some of the depths that were measured, and of those that were filled in.
    sampled: [Vec<Measurement>; 2],
    /// The others, by their index.
    covisible: Vec<usize>,
}

fn sampled(pixels: &[Measurement]) -> Vec<Measurement> {
    pixels.iter().step_by(STRIDE).copied().collect()
}

/// Absolute differences, in standard deviations, of the depths of all keyframes from those of
/// another one: measured from measured depth, filled from filled.
fn differences_from(scene: &Scene, other: usize, mine: &[Option<Compared>]) -> [Vec<f32>; 2] {
    let mut differences = [Vec::new(), Vec::new()];
    let Some(view) = &scene.views[other] else {
        return differences;
    };
    let theirs = view.depths.kinds().map(|kind| {
        let mut image = DepthImage::new(scene.camera);
        image.show(kind.iter().copied());
        image
    });
    let views = scene.views.iter().flatten().zip(mine.iter().flatten());
    for (this, mine) in views.filter(|(_, mine)| mine.covisible.contains(&other)) {
        let other_from_this = this.transfer_to(view, scene.camera);
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
    use crate::scene::View;
    use crate::{KeyframeCamera, MappingConfig};
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

    /// A wall at 2 seen by keyframes side by side, with errors of this relative deviation, of which
    /// they say `said`.
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

    fn certainty(keyframes: &[(Depths, Sim3)]) -> Certainty {
        let view = |(depths, pose): &(Depths, Sim3)| Some(View::in_memory(depths, *pose, &CAMERA));
        let views: Vec<Option<View>> = keyframes.iter().map(view).collect();
        Certainty::of_scene(&Scene {
            keyframes: &[],
            views: &views,
            camera: &CAMERA,
            config: &MappingConfig::default(),
            threads: 2,
        })
    }

    #[test]
    fn deviations_become_those_of_the_differences() {
        for (errors, said, expected) in [(0.01, 0.01, 1.0), (0.01, 0.02, 0.5), (0.012, 0.01, 1.2)] {
            let found = certainty(&wall(errors, said));
            let factor = found.measured / SHARED_ERRORS;
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
    fn at_least_half_of_the_depth_is_mapped_however_uncertain_it_is() {
        let mut keyframes = wall(0.04, 0.012);
        let kept = |keyframes: &[(Depths, Sim3)]| {
            let found = certainty(keyframes);
            assert!((found.measured - FACTORS.end()).abs() < 1e-6);
            found.measured(&keyframes[0].0.measured).count()
        };
        // all pixels of a third of the columns are more uncertain than the rest
        for pixel in &mut keyframes[0].0.measured {
            pixel.sigma_idepth *= [0.9, 1.0, 1.5][usize::from(pixel.x % 3)];
        }
        let count = kept(&keyframes);
        assert!((2400..=3240).contains(&count), "{count} of 4800");
        // where most is certain enough, the limit does not depend on it
        let certain = certainty(&wall(0.01, 0.01));
        assert!((certain.most - 0.035).abs() < 1e-6);
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
