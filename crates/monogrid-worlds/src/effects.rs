//! What a real camera does to the light: gain, vignette, noise, gamma, quantisation, shutter.

use super::random::{NormalTable, Random, mix2, unit};
use monogrid_image::GrayImage;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Photon and electronics noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseConfig {
    /// Electrons of a pixel at white; shot noise is the root of their number. Default 6000.
    pub full_well_electrons: f32,
    /// Read noise, electrons. Default 12.
    pub read_electrons: f32,
}

impl Default for NoiseConfig {
    fn default() -> Self {
        Self {
            full_well_electrons: 6000.0,
            read_electrons: 12.0,
        }
    }
}

/// Change of exposure, root mean square of the logarithm (base 2) of the gain.
const EXPOSURE_RMS_STOPS: f64 = 0.2;
/// Shortest period of this change, s.
const EXPOSURE_PERIOD_SECS: f64 = 4.0;

/// Which effects of a real camera are simulated; the default is a perfect camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectsConfig {
    /// Gamma of the response: grey = 255 · light^(1/gamma). 1 is linear. Default 2.2.
    pub gamma: f32,
    /// Noise of the sensor. Default none.
    pub noise: Option<NoiseConfig>,
    /// Whether the exposure changes over time, as automatic exposure does. Default no.
    pub has_auto_exposure: bool,
    /// Light lost in the corners, in [0, 1). Default 0.
    pub vignette: f32,
    /// Time that the shutter is open, s; 0 means no motion blur. Default 0.
    pub shutter_secs: f64,
    /// Time between the first and the last row; 0 is a global shutter. Default 0.
    pub readout_secs: f64,
    /// Share of the frames that get lost (never one of the first 30). Default 0.
    pub drop_share: f32,
    /// Whether something walks through the picture. Default no.
    pub has_mover: bool,
}

impl Default for EffectsConfig {
    fn default() -> Self {
        Self {
            gamma: 2.2,
            noise: None,
            has_auto_exposure: false,
            vignette: 0.0,
            shutter_secs: 0.0,
            readout_secs: 0.0,
            drop_share: 0.0,
            has_mover: false,
        }
    }
}

impl EffectsConfig {
    /// Noise and exposure change: the camera of the demonstration.
    #[must_use]
    pub fn demo() -> Self {
        Self {
            noise: Some(NoiseConfig::default()),
            has_auto_exposure: true,
            ..Self::default()
        }
    }

    /// Everything that a cheap camera does, at once.
    #[must_use]
    pub fn harsh() -> Self {
        Self {
            vignette: 0.35,
            shutter_secs: 0.012,
            readout_secs: 0.020,
            drop_share: 0.02,
            has_mover: true,
            ..Self::demo()
        }
    }
}

/// A sensor that turns radiance into grey values; every frame's noise is a function of seed and
/// index.
#[derive(Clone, Debug)]
pub struct Sensor {
    config: EffectsConfig,
    seed: u64,
    normal: NormalTable,
    tones: Vec<[f64; 3]>,
    /// Grey value of a linear light in [0, 1], in equal steps.
    response: Vec<f32>,
}

/// Steps of the response table.
const RESPONSE_STEPS: usize = 16384;

impl Sensor {
    /// A sensor with the given effects.
    #[must_use]
    pub fn new(config: EffectsConfig, seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0xE890);
        let count = if config.has_auto_exposure { 4 } else { 0 };
        let tone = |k: i32| {
            // periods from the shortest to eight times of it
            let octave = 3.0 * (f64::from(k) + f64::from(random.unit())) / f64::from(count);
            let period = EXPOSURE_PERIOD_SECS * octave.exp2();
            let amplitude = EXPOSURE_RMS_STOPS * (2.0 / f64::from(count)).sqrt();
            [amplitude, 1.0 / period, TAU * f64::from(random.unit())]
        };
        let tones = (0..count).map(tone).collect();
        let inverse_gamma = 1.0 / config.gamma;
        let response = (0..=RESPONSE_STEPS)
            .map(|i| 255.0 * (i as f32 / RESPONSE_STEPS as f32).powf(inverse_gamma))
            .collect();
        Self {
            config,
            seed,
            normal: NormalTable::default(),
            tones,
            response,
        }
    }

    /// Gain at a time; 1 on average (geometrically).
    #[must_use]
    pub fn gain(&self, secs: f64) -> f64 {
        self.tones
            .iter()
            .map(|[amplitude, hz, phase]| amplitude * (TAU * hz * secs + phase).sin())
            .sum::<f64>()
            .exp2()
    }

    /// The picture of frame `index`, whole grey values in [0, 255], from linear radiance.
    #[must_use]
    pub fn expose(&self, radiance: &GrayImage, index: usize, secs: f64) -> GrayImage {
        let (width, height) = (radiance.width(), radiance.height());
        let gain = self.gain(secs) as f32;
        let frame_seed = mix2(self.seed, index as u64);
        let (cx, cy) = (0.5 * (width as f32 - 1.0), 0.5 * (height as f32 - 1.0));
        let corner2 = (cx * cx + cy * cy).max(1.0);
        let mut image = radiance.clone();
        image
            .as_mut_slice()
            .par_chunks_mut(width)
            .enumerate()
            .for_each(|(y, row)| {
                let dy2 = (y as f32 - cy).powi(2);
                for (x, value) in row.iter_mut().enumerate() {
                    let r2 = (dy2 + (x as f32 - cx).powi(2)) / corner2;
                    let light = *value * gain * (1.0 - self.config.vignette * r2);
                    let word = mix2(frame_seed, (y * width + x) as u64);
                    // whole numbers, without a call to round
                    *value = ((self.respond(self.with_noise(light, word)) + 0.5) as i32) as f32;
                }
            });
        image
    }

    fn with_noise(&self, light: f32, word: u64) -> f32 {
        let Some(noise) = self.config.noise else {
            return light;
        };
        let electrons = light.max(0.0) * noise.full_well_electrons;
        let sigma = (electrons + noise.read_electrons * noise.read_electrons).sqrt();
        light + self.normal.sample(word) * sigma / noise.full_well_electrons
    }

    fn respond(&self, light: f32) -> f32 {
        if self.config.gamma == 1.0 {
            return 255.0 * light.clamp(0.0, 1.0);
        }
        let position = light.clamp(0.0, 1.0) * RESPONSE_STEPS as f32;
        let k = (position as usize).min(RESPONSE_STEPS - 1);
        let (a, b) = (self.response[k], self.response[k + 1]);
        a + (position - k as f32) * (b - a)
    }

    /// Whether frame `index` reaches the computer.
    #[must_use]
    pub fn is_kept(&self, index: usize) -> bool {
        let word = mix2(self.seed ^ 0xD209, index as u64);
        index < 30 || unit(word) >= self.config.drop_share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean_and_variance(image: &GrayImage) -> (f64, f64) {
        let count = image.as_slice().len() as f64;
        let mean = image.as_slice().iter().map(|&v| f64::from(v)).sum::<f64>() / count;
        let squares: f64 = image
            .as_slice()
            .iter()
            .map(|&v| (f64::from(v) - mean).powi(2))
            .sum();
        (mean, squares / count)
    }

    #[test]
    fn noise_has_the_variance_of_photons_and_electronics() {
        let config = EffectsConfig {
            gamma: 1.0,
            noise: Some(NoiseConfig::default()),
            ..EffectsConfig::default()
        };
        let sensor = Sensor::new(config, 3);
        for light in [0.05f32, 0.2, 0.6] {
            let image = sensor.expose(&GrayImage::filled(200, 200, light), 5, 0.1);
            let (mean, variance) = mean_and_variance(&image);
            let electrons = f64::from(light) * 6000.0;
            // plus the variance of rounding, 1/12
            let expected = (electrons + 144.0) * (255.0 / 6000.0f64).powi(2) + 1.0 / 12.0;
            assert!((mean - 255.0 * f64::from(light)).abs() < 0.1, "{mean}");
            assert!(
                (variance / expected - 1.0).abs() < 0.05,
                "{variance} {expected}"
            );
        }
    }

    #[test]
    fn frames_have_different_noise_and_the_same_frame_the_same() {
        let sensor = Sensor::new(EffectsConfig::demo(), 3);
        let light = GrayImage::filled(64, 48, 0.3);
        assert_eq!(sensor.expose(&light, 7, 0.2), sensor.expose(&light, 7, 0.2));
        assert_ne!(sensor.expose(&light, 7, 0.2), sensor.expose(&light, 8, 0.2));
    }

    #[test]
    fn a_gain_is_a_gain_after_gamma_too() {
        let sensor = Sensor::new(EffectsConfig::default(), 1);
        let (a, b) = (sensor.respond(0.1), sensor.respond(0.2));
        let (c, d) = (sensor.respond(0.3), sensor.respond(0.6));
        assert!((b / a - d / c).abs() < 1e-3);
    }

    #[test]
    fn exposure_stays_within_its_strength() {
        let sensor = Sensor::new(EffectsConfig::demo(), 9);
        let stops: Vec<f64> = (0..4000)
            .map(|k| sensor.gain(f64::from(k) * 0.1).log2())
            .collect();
        let rms = (stops.iter().map(|s| s * s).sum::<f64>() / stops.len() as f64).sqrt();
        assert!((0.15..0.25).contains(&rms), "{rms}");
        let step = stops
            .windows(2)
            .map(|w| (w[1] - w[0]).abs())
            .fold(0.0, f64::max);
        assert!(step < 0.1, "{step}");
    }

    #[test]
    fn about_the_asked_share_of_frames_is_lost() {
        let config = EffectsConfig {
            drop_share: 0.1,
            ..EffectsConfig::default()
        };
        let sensor = Sensor::new(config, 2);
        let lost = (0..5000).filter(|&i| !sensor.is_kept(i)).count();
        assert!((400..600).contains(&lost), "{lost}");
        assert!((0..30).all(|i| sensor.is_kept(i)));
    }
}
