//! Images of natural spectrum that are known at every real position.

use crate::Rng;
use monogrid_image::{GrayImage, Image};

/// A sum of waves whose amplitude falls with the frequency, as in natural images.
pub(crate) struct Texture {
    /// Turns per px along x and y, turns at the origin, amplitude.
    waves: Vec<[f64; 4]>,
}

/// Sine of an angle in turns, to 1e-7. With that of the standard library, drawing textures would
/// take most of the time of these tests.
fn sine_of_turns(turns: f64) -> f64 {
    /// A number added to this and taken from it again is rounded.
    const ROUNDING: f64 = 1.5 * (1u64 << 52) as f64;
    let part = turns - ((turns + ROUNDING) - ROUNDING);
    let folded = if part.abs() > 0.25 {
        0.5_f64.copysign(part) - part
    } else {
        part
    };
    let x = std::f64::consts::TAU * folded;
    // the series of the sine, to the eleventh power
    let (square, mut sum) = (x * x, 1.0);
    for k in [110.0, 72.0, 42.0, 20.0, 6.0] {
        sum = 1.0 - square * (1.0 / k) * sum;
    }
    x * sum
}

impl Texture {
    pub fn new(seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let waves = (0..120)
            .map(|_| {
                // cycles per px, uniform in the logarithm from 1/200 to 1/4.5
                let frequency = 0.005 * (0.22f64 / 0.005).powf(rng.uniform());
                let angle = std::f64::consts::PI * rng.uniform();
                let amplitude = 0.35 / frequency.powf(0.75);
                let (along_y, along_x) = angle.sin_cos();
                let phase = rng.uniform();
                [frequency * along_x, frequency * along_y, phase, amplitude]
            })
            .collect();
        Self { waves }
    }

    pub fn at(&self, x: f64, y: f64) -> f64 {
        let sum: f64 = self
            .waves
            .iter()
            .map(|[wx, wy, phase, amplitude]| amplitude * sine_of_turns(wx * x + wy * y + phase))
            .sum();
        128.0 + sum
    }

    /// The image whose pixel `(x, y)` shows the texture at `warp(x, y)`.
    pub fn render(
        &self,
        width: usize,
        height: usize,
        warp: impl Fn(f64, f64) -> (f64, f64),
    ) -> GrayImage {
        Image::from_fn(width, height, |x, y| {
            let (u, v) = warp(x as f64, y as f64);
            self.at(u, v) as f32
        })
    }
}

/// Blotches of some 15 px that differ by a few grey levels: on the finest level noise of two grey
/// levels hides their gradients, on coarser ones it does not.
pub(crate) fn blotches(
    width: usize,
    height: usize,
    warp: impl Fn(f64, f64) -> (f64, f64),
) -> GrayImage {
    Image::from_fn(width, height, |x, y| {
        let (u, v) = warp(x as f64, y as f64);
        let wave = (0.21 * u + 0.9 * (0.03 * v).sin()).sin() * (0.19 * v + (0.041 * u).cos()).sin();
        (128.0 + 8.0 * wave) as f32
    })
}

/// Adds Gaussian noise.
pub(crate) fn add_noise(image: &mut GrayImage, sigma: f64, seed: u64) {
    let mut rng = Rng::new(seed);
    for value in image.as_mut_slice() {
        *value += (sigma * rng.normal()) as f32;
    }
}
