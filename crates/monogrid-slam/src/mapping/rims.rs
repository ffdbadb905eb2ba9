//! Depth beside a step of the depth, on the near side: less certain than its match says.
//!
//! A window that touches the outline of an object sees its strong edge and matches that, so that an object's depth spreads some pixels
//! beyond its edge, onto what is behind it; what is behind spreads far less. Half of these pixels are wrong by more than two standard deviations
//! of their match (`docs/studies.md`, *What each kind of wrong depth costs*), and no image says reliably which half.

use super::KeyframeCamera;
use super::scan::Depths;
use monogrid_image::Image;
use serde::{Deserialize, Serialize};

/// Depth beside a step of the depth, on the near side, is less certain than its match says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RimConfig {
    /// Relative standard deviation that it has beside that of its match; 0: none. Default 0.02. Range [0, 1].
    pub relative_sigma: f64,
    /// How far from a step, px of an image that is 640 px wide. Default 8. Range [0, 100].
    pub width: f64,
    /// Smallest step, share of the nearer inverse depth. Default 0.06. Range [0.001, 0.999].
    pub min_step: f64,
}

impl Default for RimConfig {
    fn default() -> Self {
        Self {
            relative_sigma: 0.02,
            width: 8.0,
            min_step: 0.06,
        }
    }
}

/// Width of the image for which [`RimConfig::width`] is given, px.
const REFERENCE_WIDTH: f64 = 640.0;

/// The depths with the standard deviation that they have beside steps.
pub(super) fn uncertain_at_rims(
    mut depths: Depths,
    camera: &KeyframeCamera,
    config: &RimConfig,
) -> Depths {
    let reach = config.width * camera.width as f64 / REFERENCE_WIDTH;
    let reach = reach.round() as usize;
    if config.relative_sigma <= 0.0 || reach == 0 {
        return depths;
    }
    let lowest = lowest_around(&depths, camera, reach);
    let (left, sigma) = (1.0 - config.min_step as f32, config.relative_sigma as f32);
    for pixel in depths.measured.iter_mut().chain(&mut depths.filled) {
        if lowest.at(pixel.x.into(), pixel.y.into()) < left * pixel.idepth {
            pixel.sigma_idepth = pixel.sigma_idepth.hypot(sigma * pixel.idepth);
        }
    }
    depths
}

/// The lowest inverse depth in the square around each pixel that reaches so many pixels to each side.
fn lowest_around(depths: &Depths, camera: &KeyframeCamera, reach: usize) -> Image<f32> {
    // room of infinite values on all sides, so that a window begins at the place of its pixel in the image without room
    let (row, rows) = (camera.width + 2 * reach, camera.height + 2 * reach);
    let mut idepths = Image::filled(row, rows, f32::INFINITY);
    for pixel in depths.measured.iter().chain(&depths.filled) {
        let (x, y) = (usize::from(pixel.x) + reach, usize::from(pixel.y) + reach);
        idepths.set(x, y, pixel.idepth);
    }
    take_lowest(idepths.as_mut_slice(), 2 * reach + 1, 1);
    take_lowest(idepths.as_mut_slice(), 2 * reach + 1, row);
    idepths
}

/// Replaces each value by the lowest of so many, this far from one to the next, of which it is the first: windows of twice the length until the
/// next would be too long, then two that overlap.
fn take_lowest(values: &mut [f32], count: usize, stride: usize) {
    let mut add = |ahead: usize| {
        for at in 0..values.len().saturating_sub(ahead * stride) {
            values[at] = values[at].min(values[at + ahead * stride]);
        }
    };
    let mut length = 1;
    while 2 * length <= count {
        add(length);
        length *= 2;
    }
    add(count - length);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;
    use monogrid_geometry::{Pinhole, Rng};
    use monogrid_occupancy::DepthPixel as Measurement;

    const SIZE: (usize, usize) = (160, 40);

    fn camera() -> KeyframeCamera {
        KeyframeCamera::new(Pinhole::new(100.0, 100.0, 80.0, 20.0), SIZE)
    }

    fn pixel(x: usize, y: usize, idepth: f32) -> Measurement {
        Measurement {
            x: x as u16,
            y: y as u16,
            idepth,
            sigma_idepth: 0.003 * idepth,
        }
    }

    /// A box in the middle before a wall; every third pixel of it is measured, the wall is filled in.
    fn before_a_wall(wall: f32) -> Depths {
        let pixels = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
        let is_box = |x: usize, y: usize| (60..100).contains(&x) && (10..30).contains(&y);
        let (mut measured, mut filled) = (Vec::new(), Vec::new());
        for (x, y) in pixels {
            match is_box(x, y) {
                true if (x + y) % 3 == 0 => measured.push(pixel(x, y, 1.0)),
                true => {}
                false => filled.push(pixel(x, y, wall)),
            }
        }
        Depths { measured, filled }
    }

    /// Whether a pixel became less certain.
    fn is_doubted(pixel: &Measurement) -> bool {
        let relative = pixel.sigma_idepth / pixel.idepth;
        let doubted = 0.003_f32.hypot(0.02);
        assert!((relative - 0.003).abs() < 1e-6 || (relative - doubted).abs() < 1e-6);
        relative > 0.01
    }

    #[test]
    fn the_rim_of_what_is_nearer_is_less_certain_and_nothing_else() {
        let depths = uncertain_at_rims(before_a_wall(0.9), &camera(), &RimConfig::default());
        assert!(depths.filled.iter().all(|p| !is_doubted(p)));
        // 8 px of an image four times as wide
        let is_rim = |p: &Measurement| {
            let inside = (62..98).contains(&p.x) && (12..28).contains(&p.y);
            !inside
        };
        assert!(depths.measured.len() > 200);
        for p in &depths.measured {
            assert_eq!(is_doubted(p), is_rim(p), "{} {}", p.x, p.y);
        }
        // no step, or one that is no reason to doubt
        for wall in [1.0, 0.95, 1.5] {
            let depths = uncertain_at_rims(before_a_wall(wall), &camera(), &RimConfig::default());
            assert!(depths.measured.iter().all(|p| !is_doubted(p)), "{wall}");
        }
    }

    #[test]
    fn the_lowest_around_is_that_of_a_search() {
        let mut depths = Depths::default();
        let mut rng = Rng::new(5);
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                if rng.below(8) == 0 {
                    depths
                        .measured
                        .push(pixel(x, y, 1.0 + rng.uniform() as f32));
                }
            }
        }
        for reach in [1, 2, 3, 8, 60] {
            let found = lowest_around(&depths, &camera(), reach);
            for (x, y) in [(0, 0), (159, 39), (80, 20), (3, 37), (158, 1)] {
                let near = depths.measured.iter().filter(|p| {
                    usize::from(p.x).abs_diff(x) <= reach && usize::from(p.y).abs_diff(y) <= reach
                });
                let expected = near.map(|p| p.idepth).fold(f32::INFINITY, f32::min);
                assert_eq!(found.at(x, y), expected, "{reach} {x} {y}");
            }
        }
    }

    #[test]
    fn what_is_mapped_is_less_certain_there() {
        let scan =
            before_a_wall(0.9).joined(7, &camera(), &RimConfig::default(), &Store::default());
        let doubted = scan.pixels().iter().filter(|p| is_doubted(p)).count();
        let depths = uncertain_at_rims(before_a_wall(0.9), &camera(), &RimConfig::default());
        let rim = depths.measured.iter().filter(|p| is_doubted(p)).count();
        assert!(rim > 50 && doubted == rim, "{rim} {doubted}");
    }

    #[test]
    fn it_can_be_switched_off() {
        for off in [
            RimConfig {
                relative_sigma: 0.0,
                ..RimConfig::default()
            },
            RimConfig {
                width: 1.0,
                ..RimConfig::default()
            },
        ] {
            let depths = uncertain_at_rims(before_a_wall(0.5), &camera(), &off);
            assert!(depths.measured.iter().all(|p| !is_doubted(p)));
        }
    }
}
