//! Geometric consistency: depth that the depth of other keyframes confirms.

use super::{DenseConfig, DenseDepth};
use monogrid_geometry::{Pinhole, Sim3, Vec2, Vec3};

/// Relative difference of two depths of one surface.
const TOLERANCE: f64 = 0.02;

/// Pairs of depths that differ by less than this share tell how well two keyframes agree: beyond,
/// one of them is wrong altogether.
const COMPARABLE: f32 = 0.1;
/// Least relative standard deviation that all pixels of a keyframe share.
const MIN_SHARED_SIGMA: f32 = 0.003;
/// Bins of differences, up to [`COMPARABLE`].
const BINS: usize = 400;

/// Another keyframe and its depth.
#[derive(Clone, Copy, Debug)]
pub struct SupportingView<'a> {
    /// Its depth.
    pub depth: &'a DenseDepth,
    /// From the coordinates of the keyframe in question (in its units) to those of the other.
    pub view_from_keyframe: Sim3,
}

/// What the supporting views say about one pixel.
#[derive(Default)]
struct Opinions {
    /// Those that agree, and sums of their differences and squares of them.
    agreeing: usize,
    sum: f32,
    squares: f32,
    /// Those that see through the point.
    against: usize,
    /// Those that see something before it: covered, as it may be, or wrong.
    before: usize,
}

impl DenseDepth {
    /// The inverse depth of the pixel in which a point in the own frame is seen; `None` where that
    /// is unknown, outside of the image, and behind it. `camera` is that of the half image.
    pub(super) fn at_point(&self, point: &Vec3, camera: &Pinhole) -> Option<f32> {
        if point.z <= 1e-9 {
            return None;
        }
        let at = camera.project(point);
        let (x, y) = (at.x + 0.5, at.y + 0.5);
        let (width, height) = (self.idepth.width() as f64, self.idepth.height() as f64);
        let is_inside = x >= 0.0 && y >= 0.0 && x < width && y < height;
        let idepth = is_inside.then(|| self.idepth.at(x as usize, y as usize))?;
        (idepth > 0.0).then_some(idepth)
    }

    /// The depth of the pixels that at least `config.min_agreeing` supporting views confirm to
    /// within 2 % (one less where they agree closely) and are not outvoted by others, with the
    /// variance of the own costs, of the disagreement at the pixel, and of the disagreement that
    /// all pixels share. It is not the mean with that of the supporting views: a mean agrees with
    /// what it is made of, and how far keyframes disagree is what tells the uncertainty of the map.
    ///
    /// `camera` is that of the full image.
    #[must_use]
    pub fn agreed(
        &self,
        supporting: &[SupportingView],
        camera: &Pinhole,
        config: &DenseConfig,
    ) -> Self {
        let camera = camera.half();
        let (width, height) = (self.idepth.width(), self.idepth.height());
        let mut agreed = Self::unknown(width, height);
        let mut differences = Differences([0; BINS]);
        for y in 0..height {
            for x in 0..width {
                let idepth = self.idepth.at(x, y);
                if idepth <= 0.0 {
                    continue;
                }
                let point = camera.unproject(&Vec2::new(x as f64, y as f64)) / f64::from(idepth);
                let opinions = heard(&point, supporting, &camera, &mut differences);
                if opinions.is_held(config) {
                    let own = self.sigma.at(x, y) / idepth;
                    agreed.idepth.set(x, y, idepth);
                    let variance = 0.5 * own * own + opinions.spread();
                    agreed.sigma.set(x, y, variance.sqrt());
                }
            }
        }
        let shared = differences.sigma();
        let sigmas = agreed.sigma.as_mut_slice().iter_mut();
        for (sigma, idepth) in sigmas.zip(agreed.idepth.as_slice()) {
            *sigma = (*sigma * *sigma + shared * shared).sqrt() * idepth;
        }
        agreed
    }
}

impl Opinions {
    /// Whether enough supporting views agree and they are not outvoted: what sees through the point
    /// counts as one, what sees something before it as a half. One view less will do if none sees
    /// through the point and the others agree twice as closely.
    fn is_held(&self, config: &DenseConfig) -> bool {
        let tolerance = 0.5 * TOLERANCE as f32;
        let is_close = self.squares <= self.agreeing as f32 * tolerance * tolerance;
        let missing = usize::from(self.against == 0 && is_close);
        let needed = config.min_agreeing.saturating_sub(missing).max(1);
        self.agreeing >= needed && 2 * self.agreeing >= 2 * self.against + self.before
    }

    /// Variance of the differences, with the own one of 0.
    fn spread(&self) -> f32 {
        let count = self.agreeing as f32 + 1.0;
        let mean = self.sum / count;
        (self.squares / count - mean * mean).max(0.0)
    }
}

/// What the supporting views have where they see a point.
fn heard(
    point: &Vec3,
    supporting: &[SupportingView],
    camera: &Pinhole,
    differences: &mut Differences,
) -> Opinions {
    let mut opinions = Opinions::default();
    for view in supporting {
        let Some(difference) = difference(point, view, camera) else {
            continue;
        };
        differences.add(difference);
        if difference.abs() <= TOLERANCE as f32 {
            opinions.agreeing += 1;
            opinions.sum += difference;
            opinions.squares += difference * difference;
        } else if difference < 0.0 {
            opinions.against += 1;
        } else {
            opinions.before += 1;
        }
    }
    opinions
}

/// The inverse depth of a supporting view where it sees a point over that of the point, less 1;
/// `None` where it has none.
fn difference(point: &Vec3, view: &SupportingView, camera: &Pinhole) -> Option<f32> {
    let seen = view.view_from_keyframe * *point;
    let idepth = view.depth.at_point(&seen, camera)?;
    Some(idepth * seen.z as f32 - 1.0)
}

/// How much the pixels of a keyframe and its supporting views differ.
struct Differences([u32; BINS]);

impl Differences {
    fn add(&mut self, difference: f32) {
        let bin = (difference.abs() / COMPARABLE * BINS as f32) as usize;
        if let Some(count) = self.0.get_mut(bin) {
            *count += 1;
        }
    }

    /// Relative standard deviation of one keyframe: of the difference, which 68 % are below, each
    /// has half the variance.
    fn sigma(&self) -> f32 {
        let all: u32 = self.0.iter().sum();
        let mut below = 0;
        let bin = self.0.iter().position(|count| {
            below += count;
            f64::from(below) >= 0.683 * f64::from(all)
        });
        let at = COMPARABLE * (bin.unwrap_or(0) as f32 + 0.5) / BINS as f32;
        (at / 2.0_f32.sqrt()).max(MIN_SHARED_SIGMA)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_held_by_two_that_agree_or_by_one_that_agrees_closely_and_never_outvoted() {
        let config = DenseConfig::default();
        let held = |agreeing: usize, difference: f32, [against, before]: [usize; 2]| {
            let opinions = Opinions {
                agreeing,
                sum: agreeing as f32 * difference,
                squares: agreeing as f32 * difference * difference,
                against,
                before,
            };
            opinions.is_held(&config)
        };
        assert!(!held(0, 0.0, [0, 0]));
        // within half the tolerance of 2 %, and none sees through it
        assert!(held(1, 0.009, [0, 0]) && !held(1, 0.011, [0, 0]));
        assert!(!held(1, 0.001, [1, 0]));
        assert!(held(1, 0.001, [0, 2]) && !held(1, 0.001, [0, 3]));
        assert!(held(2, 0.019, [0, 0]) && held(2, 0.019, [2, 0]));
        assert!(!held(2, 0.019, [3, 0]) && !held(2, 0.019, [2, 1]));
        assert!(held(4, 0.019, [3, 2]) && !held(4, 0.019, [3, 3]));
        let three = DenseConfig {
            min_agreeing: 3,
            ..config
        };
        let opinions = |agreeing, against| Opinions {
            agreeing,
            against,
            ..Opinions::default()
        };
        assert!(opinions(2, 0).is_held(&three) && !opinions(2, 1).is_held(&three));
        assert!(!opinions(1, 0).is_held(&three) && opinions(3, 1).is_held(&three));
    }
}
