//! One depth from those of all keyframes that see a point.
//!
//! Keyframes measure a surface again and again, each with errors of its own beside those that all
//! of them share (poses, the images that they have in common). The weighted mean of the depths that
//! agree has less of the former. What a pixel says of a point that other keyframes look at, and
//! none of them confirms, is most often wrong, and left out.

use crate::agreement::Certainty;
use crate::scene::{DepthImage, Depths, Scene, Seen, Transfer};
use monogrid_occupancy::DepthPixel as Measurement;

/// Keyframes that must have a depth, its own among them, where others have any there; what fewer
/// have is left out.
const MIN_SUPPORT: usize = 2;

/// Depths agree that differ by at most so many standard deviations of the difference.
const AGREEING_SIGMAS: f64 = 3.0;
/// Depths agree, too, that differ by this share of them.
const AGREEING_SHARE: f64 = 0.01;

/// The depths of a keyframe, each fused with those of other keyframes that agree, as certain as
/// they are; as they are for one without a pose.
pub(crate) fn fused(scene: &Scene, index: usize, depths: Depths, certainty: Certainty) -> Depths {
    let Some(this) = &scene.views[index] else {
        return depths;
    };
    let camera = scene.camera;
    let num_measured = depths.measured.len();
    let all = depths.measured.into_iter().chain(depths.filled);
    let mut means: Vec<Mean> = all.map(Mean::of).collect();
    let mut image = DepthImage::new(camera);
    for (_, other) in scene.covisible(index, scene.config.quality.effort().max_covisible) {
        let [measured, filled] = other.depths.kinds();
        image.clear();
        image.show(certainty.filled(&filled));
        image.show(certainty.measured(&measured));
        let other_from_this = this.transfer_to(other, camera);
        for mean in &mut means {
            mean.hear(&image, &other_from_this);
        }
    }
    let results = |means: &[Mean]| means.iter().filter_map(|m| m.result()).collect();
    let (measured, filled) = means.split_at(num_measured);
    Depths {
        measured: results(measured),
        filled: results(filled),
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
    fn hear(&mut self, image: &DepthImage, other_from_this: &Transfer) {
        let Measurement { x, y, idepth, .. } = self.pixel;
        let Some(seen) = other_from_this.of(x.into(), y.into(), idepth) else {
            return;
        };
        let sigma = self.pixel.sigma_idepth / self.pixel.idepth;
        match confirming(image, &seen, sigma) {
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

    /// The pixel with the mean of the depths that agree with it; `None` where others look and too
    /// few of them do.
    fn result(&self) -> Option<Measurement> {
        if self.is_looked_at && usize::from(self.support) < MIN_SUPPORT {
            return None;
        }
        let idepth = self.pixel.idepth * self.sum_of_ratios / self.weights;
        // that of a typical one: what all keyframes share, no mean takes away, and it is most of
        // what remains
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
    /// It has the same depth, but for this ratio of inverse depths, with this relative standard
    /// deviation.
    Same { ratio: f32, sigma: f32 },
}

/// The depth next to where a point is seen, of the 3x3 pixels around it, that agrees with it.
fn confirming(image: &DepthImage, seen: &Seen, sigma: f32) -> Answer {
    let (x, y) = seen.pixel();
    // no other pixel is nearer than this one
    if let Some(depth) = image.at(x, y)
        && let Some(same) = agreeing(depth, seen.idepth, sigma)
    {
        return same;
    }
    let (right, below) = (seen.x - x as f32, seen.y - y as f32);
    let mut answer = Answer::Nothing;
    let mut nearest = f32::INFINITY;
    for (column, row, depth) in image.around(x, y) {
        let dx = column as f32 - x as f32 - right;
        let dy = row as f32 - y as f32 - below;
        let distance = dx * dx + dy * dy;
        match agreeing(depth, seen.idepth, sigma) {
            Some(same) if distance < nearest => {
                nearest = distance;
                answer = same;
            }
            None if matches!(answer, Answer::Nothing) => answer = Answer::Other,
            _ => {}
        }
    }
    answer
}

/// What a depth says of a point that it agrees with.
#[inline]
fn agreeing([idepth, its_sigma]: [f32; 2], expected: f32, sigma: f32) -> Option<Answer> {
    let ratio = idepth / expected;
    let gap = (ratio - 1.0).powi(2);
    let variance = sigma * sigma + its_sigma * its_sigma;
    let sigmas_sq = (AGREEING_SIGMAS * AGREEING_SIGMAS) as f32;
    let least_sq = (AGREEING_SHARE * AGREEING_SHARE) as f32;
    (gap <= (sigmas_sq * variance).max(least_sq)).then_some(Answer::Same {
        ratio,
        sigma: its_sigma,
    })
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

    /// A wall 2 before the first of keyframes side by side, each with a unit of its own; `error` is
    /// that of the inverse depth of a pixel of a keyframe, relative.
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

    fn fused_first(keyframes: &[(Depths, Sim3)]) -> Vec<Measurement> {
        let views: Vec<Option<View>> = keyframes
            .iter()
            .map(|(depths, pose)| Some(View::in_memory(depths, *pose, &CAMERA)))
            .collect();
        let config = MappingConfig::default();
        let scene = Scene {
            keyframes: &[],
            views: &views,
            camera: &CAMERA,
            config: &config,
            threads: 1,
        };
        let first = keyframes[0].0.clone();
        fused(&scene, 0, first, Certainty::UNCHANGED).measured
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
        let own = wall(5, |keyframe, k| 0.015 * noise(keyframe, k));
        let before = error(&own[0].0.measured);
        let after = fused_first(&own);
        // nine pixels away from the border all five keyframes see the wall
        let inside: Vec<Measurement> = after.iter().filter(|p| p.x > 20).copied().collect();
        let gain = before / error(&inside);
        assert!((1.9..2.6).contains(&gain), "{gain}");
        assert_eq!(after.len(), 60 * 80);
        for pixel in &after {
            assert!((pixel.sigma_idepth / pixel.idepth - 0.01).abs() < 1e-5);
        }
        let shared = wall(5, |_, _| 0.015);
        assert!((error(&fused_first(&shared)) - 0.015).abs() < 1e-3);
        // one that is less certain counts less
        let mut unequal = wall(2, |keyframe, _| if keyframe == 0 { 0.0 } else { 0.02 });
        for pixel in &mut unequal[1].0.measured {
            pixel.sigma_idepth *= 3.0;
        }
        let middle = fused_first(&unequal)[30 * 80 + 60];
        assert!(
            (2.0 * middle.idepth - 1.002).abs() < 2e-4,
            "{}",
            middle.idepth
        );
    }

    #[test]
    fn what_nobody_confirms_is_left_out_where_somebody_looks() {
        // the first keyframe has a piece that is 30 % too far
        let is_piece = |k: u16| (30..34).contains(&(k % 80)) && (20..40).contains(&(k / 80));
        let keyframes = wall(3, |keyframe, k| {
            if keyframe == 0 && is_piece(k) {
                -0.3
            } else {
                0.0
            }
        });
        let left = fused_first(&keyframes);
        assert_eq!(left.len(), 60 * 80 - 4 * 20);
        assert!(error(&left) < 1e-4);
        // alone, a keyframe keeps what it has
        assert_eq!(fused_first(&keyframes[..1]), keyframes[0].0.measured);
        // so it does where the others have no depth
        let mut blind = keyframes.clone();
        for (depths, _) in &mut blind[1..] {
            depths.measured.retain(|pixel| pixel.y > 50);
        }
        assert_eq!(fused_first(&blind).len(), 60 * 80);
    }
}
