//! One depth from those of all keyframes that see a point.
//!
//! Keyframes measure a surface again and again, each with errors of its own beside those that all of them share (poses, the images that
//! they have in common). The weighted mean of the depths that agree has less of the former. What a pixel says of a point that other
//! keyframes look at, and none of them confirms, is most often wrong, and left out.

use super::agreement::{View, witnesses};
use super::certainty::Certainty;
use super::scan::{Depths, KeptDepths};
use super::transfer::{Seen, Transfer};
use super::{FusionConfig, KeyframeCamera};
use monogrid_occupancy::DepthPixel as Measurement;

/// The depths of keyframe `index`, each fused with those of other keyframes that agree, as certain as they are; as they are for one
/// without a pose.
pub(super) fn fused(
    views: &[Option<View>],
    index: usize,
    depths: Depths,
    certainty: Certainty,
    camera: &KeyframeCamera,
    config: &FusionConfig,
) -> Depths {
    let Some(this) = &views[index] else {
        return depths;
    };
    let means =
        |pixels: Vec<Measurement>| -> Vec<Mean> { pixels.into_iter().map(Mean::of).collect() };
    let (mut measured, mut filled) = (means(depths.measured), means(depths.filled));
    let witnesses = witnesses(views, index, camera, config.max_witnesses);
    let mut grid = Grid::new(camera);
    let tolerance = Tolerance::new(config);
    for other in witnesses.into_iter().filter_map(|w| views[w].as_ref()) {
        grid.fill(&other.depths, certainty);
        let other_from_this = other.world_from_keyframe.inverse() * this.world_from_keyframe;
        let other_from_this = Transfer::new(&other_from_this, camera);
        for mean in measured.iter_mut().chain(&mut filled) {
            mean.hear(&grid, &other_from_this, &tolerance);
        }
    }
    let taken = |means: Vec<Mean>| -> Vec<Measurement> {
        let taken = means.iter().filter_map(|mean| mean.result(config));
        taken.collect()
    };
    Depths {
        measured: taken(measured),
        filled: taken(filled),
    }
}

/// A pixel and what is known of its point.
struct Mean {
    pixel: Measurement,
    /// Of the ratios of inverse depths to that of the pixel, by their weights.
    sum_of_ratios: f32,
    weights: f32,
    /// Keyframes that have this depth.
    support: u16,
    /// Whether another keyframe has any depth there.
    is_looked_at: bool,
}

impl Mean {
    /// Of the pixel alone.
    fn of(pixel: Measurement) -> Self {
        let weight = (pixel.idepth / pixel.sigma_idepth).powi(2);
        Self {
            pixel,
            sum_of_ratios: weight,
            weights: weight,
            support: 1,
            is_looked_at: false,
        }
    }

    /// Takes what a keyframe says of the point.
    fn hear(&mut self, grid: &Grid, other_from_this: &Transfer, tolerance: &Tolerance) {
        let Measurement { x, y, idepth, .. } = self.pixel;
        let Some(seen) = other_from_this.of(x.into(), y.into(), idepth) else {
            return;
        };
        let sigma = self.pixel.sigma_idepth / self.pixel.idepth;
        match grid.confirming(&seen, sigma, tolerance) {
            Answer::Nothing => {}
            Answer::Other => self.is_looked_at = true,
            Answer::Same { ratio, sigma } => {
                let weight = 1.0 / (sigma * sigma);
                self.sum_of_ratios += weight * ratio;
                self.weights += weight;
                self.support += 1;
                self.is_looked_at = true;
            }
        }
    }

    /// The pixel with the mean of the depths that agree with it; `None` where others look and too few of them do.
    fn result(&self, config: &FusionConfig) -> Option<Measurement> {
        if self.is_looked_at && usize::from(self.support) < config.min_support {
            return None;
        }
        let idepth = self.pixel.idepth * self.sum_of_ratios / self.weights;
        // that of a typical one: what all keyframes share, no mean takes away, and it is most of what remains
        let sigma = (f32::from(self.support) / self.weights).sqrt();
        Some(Measurement {
            idepth,
            sigma_idepth: sigma * idepth,
            ..self.pixel
        })
    }
}

/// What a keyframe says of a point.
enum Answer {
    /// It has no depth there.
    Nothing,
    /// It has another depth there.
    Other,
    /// It has the same depth, but for this ratio of inverse depths, with this relative standard deviation.
    Same { ratio: f32, sigma: f32 },
}

/// How far depths may differ that agree, squared.
struct Tolerance {
    sigmas_sq: f32,
    least_sq: f32,
}

impl Tolerance {
    fn new(config: &FusionConfig) -> Self {
        Self {
            sigmas_sq: (config.sigmas * config.sigmas) as f32,
            least_sq: (config.min_tolerance * config.min_tolerance) as f32,
        }
    }
}

/// The depths of a keyframe by their place in its image.
struct Grid {
    width: usize,
    height: usize,
    /// Inverse depth and its relative standard deviation, row-major; 0 where there is none.
    pixels: Vec<[f32; 2]>,
}

impl Grid {
    /// Without depth.
    fn new(camera: &KeyframeCamera) -> Self {
        Self {
            width: camera.width,
            height: camera.height,
            pixels: vec![[0.0; 2]; camera.width * camera.height],
        }
    }

    /// With the depth of one keyframe alone; measured depth wins where there are both.
    fn fill(&mut self, depths: &KeptDepths, certainty: Certainty) {
        self.pixels.fill([0.0; 2]);
        let [measured, filled] = depths.kinds();
        let filled = certainty.filled(&filled.0);
        for pixel in filled.chain(certainty.measured(&measured.0)) {
            let at = usize::from(pixel.y) * self.width + usize::from(pixel.x);
            self.pixels[at] = [pixel.idepth, pixel.sigma_idepth / pixel.idepth];
        }
    }

    /// The depth next to where a point is seen, of the 3x3 pixels around it, that agrees with it.
    fn confirming(&self, seen: &Seen, sigma: f32, tolerance: &Tolerance) -> Answer {
        let (x, y) = seen.pixel();
        let expected = seen.idepth;
        // no other pixel is nearer than this one
        let middle = self.answer(y * self.width + x, expected, sigma, tolerance);
        if matches!(middle, Answer::Same { .. }) {
            return middle;
        }
        let (right, below) = (seen.x - x as f32, seen.y - y as f32);
        let mut answer = middle;
        let mut nearest = f32::INFINITY;
        for row in y.saturating_sub(1)..(y + 2).min(self.height) {
            for column in x.saturating_sub(1)..(x + 2).min(self.width) {
                let dx = column as f32 - x as f32 - right;
                let dy = row as f32 - y as f32 - below;
                let distance = dx * dx + dy * dy;
                match self.answer(row * self.width + column, expected, sigma, tolerance) {
                    same @ Answer::Same { .. } if distance < nearest => {
                        nearest = distance;
                        answer = same;
                    }
                    Answer::Other if matches!(answer, Answer::Nothing) => answer = Answer::Other,
                    _ => {}
                }
            }
        }
        answer
    }

    /// What one pixel says.
    #[inline]
    fn answer(&self, pixel: usize, expected: f32, sigma: f32, tolerance: &Tolerance) -> Answer {
        let [idepth, its_sigma] = self.pixels[pixel];
        if idepth <= 0.0 {
            return Answer::Nothing;
        }
        let ratio = idepth / expected;
        let gap = (ratio - 1.0).powi(2);
        let variance = sigma * sigma + its_sigma * its_sigma;
        if gap > (tolerance.sigmas_sq * variance).max(tolerance.least_sq) {
            return Answer::Other;
        }
        Answer::Same {
            ratio,
            sigma: its_sigma,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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

    /// A wall 2 before the first of keyframes side by side, each with a unit of its own; `error` is that of the inverse depth of a pixel of
    /// a keyframe, relative.
    fn wall(count: u16, error: impl Fn(u16, u16) -> f32) -> Vec<(Depths, Sim3)> {
        (0..count)
            .map(|keyframe| {
                let unit = 1.0 + 0.25 * f64::from(keyframe);
                let pixel = |k: u16| {
                    let idepth = unit as f32 / 2.0 * (1.0 + error(keyframe, k));
                    Measurement {
                        x: k % 80,
                        y: k / 80,
                        idepth,
                        sigma_idepth: 0.01 * idepth,
                    }
                };
                let depths = Depths {
                    measured: (0..60 * 80).map(pixel).collect(),
                    filled: Vec::new(),
                };
                let centre = Vec3::new(0.1 * f64::from(keyframe), 0.0, 0.0);
                (depths, Sim3::new(unit, Rotation::identity(), centre))
            })
            .collect()
    }

    fn fused_first(keyframes: &[(Depths, Sim3)], config: &FusionConfig) -> Vec<Measurement> {
        let views: Vec<Option<View>> = keyframes
            .iter()
            .map(|(depths, pose)| Some(View::in_memory(depths, *pose, &CAMERA)))
            .collect();
        let first = keyframes[0].0.clone();
        fused(&views, 0, first, Certainty::UNCHANGED, &CAMERA, config).measured
    }

    /// Root mean square of the relative errors of the wall's depths.
    fn error(pixels: &[Measurement]) -> f32 {
        let squares = pixels.iter().map(|p| (2.0 * p.idepth - 1.0).powi(2));
        (squares.sum::<f32>() / pixels.len() as f32).sqrt()
    }

    /// Numbers between -1 and 1 without an order.
    fn noise(keyframe: u16, k: u16) -> f32 {
        let mut mixed = u32::from(keyframe) << 16 | u32::from(k);
        for factor in [0x85eb_ca6b, 0xc2b2_ae35] {
            mixed = (mixed ^ (mixed >> 15)).wrapping_mul(factor);
        }
        (mixed >> 8) as f32 / (1 << 23) as f32 - 1.0
    }

    #[test]
    fn errors_of_single_keyframes_become_less_and_shared_ones_stay() {
        let config = FusionConfig::default();
        let own = wall(5, |keyframe, k| 0.015 * noise(keyframe, k));
        let before = error(&own[0].0.measured);
        let after = fused_first(&own, &config);
        // nine pixels away from the border all five keyframes see the wall
        let inside: Vec<Measurement> = after.iter().filter(|p| p.x > 20).copied().collect();
        let gain = before / error(&inside);
        assert!((1.9..2.6).contains(&gain), "{gain}");
        assert_eq!(after.len(), 60 * 80);
        for pixel in &after {
            assert!((pixel.sigma_idepth / pixel.idepth - 0.01).abs() < 1e-5);
        }
        let shared = wall(5, |_, _| 0.015);
        assert!((error(&fused_first(&shared, &config)) - 0.015).abs() < 1e-3);
        // one that is less certain counts less
        let mut unequal = wall(2, |keyframe, _| if keyframe == 0 { 0.0 } else { 0.02 });
        for pixel in &mut unequal[1].0.measured {
            pixel.sigma_idepth *= 3.0;
        }
        let middle = fused_first(&unequal, &config)[30 * 80 + 60];
        assert!(
            (2.0 * middle.idepth - 1.002).abs() < 2e-4,
            "{}",
            middle.idepth
        );
    }

    #[test]
    fn what_nobody_confirms_is_left_out_where_somebody_looks() {
        let config = FusionConfig::default();
        // the first keyframe has a piece that is 30 % too far
        let is_piece = |k: u16| (30..34).contains(&(k % 80)) && (20..40).contains(&(k / 80));
        let keyframes = wall(3, |keyframe, k| {
            if keyframe == 0 && is_piece(k) {
                -0.3
            } else {
                0.0
            }
        });
        let left = fused_first(&keyframes, &config);
        assert_eq!(left.len(), 60 * 80 - 4 * 20);
        assert!(error(&left) < 1e-4);
        // alone, a keyframe keeps what it has
        assert_eq!(
            fused_first(&keyframes[..1], &config),
            keyframes[0].0.measured
        );
        // so it does where the others have no depth
        let mut blind = keyframes.clone();
        for (depths, _) in &mut blind[1..] {
            depths.measured.retain(|pixel| pixel.y > 50);
        }
        assert_eq!(fused_first(&blind, &config).len(), 60 * 80);
        // and where nobody's word is asked for
        let all = FusionConfig {
            min_support: 1,
            ..config
        };
        assert_eq!(fused_first(&keyframes, &all).len(), 60 * 80);
    }
}
