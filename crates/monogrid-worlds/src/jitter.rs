//! The unsteadiness of a hand or a drone: band-limited noise on a smooth camera motion.
//!
//! The strength per octave was measured on real recordings (TUM RGB-D fr1/xyz and fr2/desk held by
//! hand, EuRoC V1_02 flown): displacement falls by about 4 to 5 per octave above 1 Hz, rotation by
//! 2.

use super::random::Random;
use monogrid_geometry::{Se3, Vec3, rotation_exp};
use std::f64::consts::TAU;

/// Strength of the unsteadiness in one band of frequencies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JitterBand {
    /// Lowest frequency, Hz; the band reaches to twice of it.
    pub from_hz: f64,
    /// Root mean square displacement per axis, m.
    pub translation_rms_m: f64,
    /// Root mean square rotation per axis, rad.
    pub rotation_rms_rad: f64,
}

const fn band(from_hz: f64, translation_rms_m: f64, rotation_rms_rad: f64) -> JitterBand {
    JitterBand {
        from_hz,
        translation_rms_m,
        rotation_rms_rad,
    }
}

/// Medians over the axes of both hand-held recordings; above 5 Hz the motion-capture system's own
/// noise sets an upper bound, of which half is taken.
pub const HAND_JITTER: [JitterBand; 5] = [
    band(0.3, 0.015, 0.018),
    band(0.6, 0.008, 0.012),
    band(1.2, 0.0018, 0.0065),
    band(2.4, 0.0003, 0.0028),
    band(4.8, 0.000_05, 0.0008),
];

/// Medians over the axes of the flown recording.
pub const DRONE_JITTER: [JitterBand; 5] = [
    band(0.3, 0.060, 0.040),
    band(0.6, 0.020, 0.028),
    band(1.2, 0.0025, 0.010),
    band(2.4, 0.0002, 0.0018),
    band(4.8, 0.000_03, 0.0004),
];

/// A guess, not measured: springs of a car on a street, a few millimetres and a tenth of a degree.
pub const CAR_JITTER: [JitterBand; 4] = [
    band(0.3, 0.008, 0.0015),
    band(0.6, 0.005, 0.0020),
    band(1.2, 0.003, 0.0020),
    band(2.4, 0.001, 0.0008),
];

/// Sinusoids per band and axis.
const TONES: usize = 7;

#[derive(Clone, Copy, Debug)]
struct Tone {
    frequency_hz: f64,
    phase_rad: f64,
    amplitude: f64,
}

/// A fixed realisation of the unsteadiness: a smooth function of time.
#[derive(Clone, Debug)]
pub struct Jitter {
    /// Tones of x, y, z and of the rotations about them.
    axes: [Vec<Tone>; 6],
}

impl Jitter {
    /// The realisation that belongs to a seed.
    #[must_use]
    pub fn new(bands: &[JitterBand], seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x4A17);
        let axes = std::array::from_fn(|axis| {
            let mut tones = Vec::new();
            for b in bands {
                let rms = [b.translation_rms_m, b.rotation_rms_rad][axis / 3];
                // TONES sinusoids of amplitude a have a mean square of TONES a² / 2
                let amplitude = rms * (2.0 / TONES as f64).sqrt();
                for k in 0..TONES {
                    // one per stratum of the octave: equal frequencies would add up
                    let octave = (k as f64 + f64::from(random.unit())) / TONES as f64;
                    tones.push(Tone {
                        frequency_hz: b.from_hz * octave.exp2(),
                        phase_rad: TAU * f64::from(random.unit()),
                        amplitude,
                    });
                }
            }
            tones
        });
        Self { axes }
    }

    /// Displacement in the world and rotation about the camera's axes at a time.
    #[must_use]
    pub fn at(&self, secs: f64) -> Se3 {
        let wave = |t: &Tone| t.amplitude * (TAU * t.frequency_hz * secs + t.phase_rad).sin();
        let value = |axis: usize| -> f64 { self.axes[axis].iter().map(wave).sum() };
        let rotation = Vec3::new(value(3), value(4), value(5));
        let translation = Vec3::new(value(0), value(1), value(2));
        Se3::new(rotation_exp(&rotation), translation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn displacement_has_the_strength_that_was_asked_for() {
        let jitter = Jitter::new(&HAND_JITTER, 5);
        let count = 40_000;
        let mut squares = Vec3::zeros();
        for k in 0..count {
            let x = jitter.at(0.05 * f64::from(k)).translation;
            squares += x.component_mul(&x);
        }
        let expected: f64 = HAND_JITTER
            .iter()
            .map(|b| b.translation_rms_m.powi(2))
            .sum();
        for axis in 0..3 {
            let ratio = squares[axis] / f64::from(count) / expected;
            assert!((0.9..1.1).contains(&ratio), "{ratio}");
        }
    }
}
