//! The part of 16 bits that a source uses.
//!
//! Sensors of 10, 12 or 14 bits and thermal cameras are stored in 16 bits; the upper 8 of these
//! would show hardly anything. The range that the first images use is stretched to that of 8 bits,
//! the same for all images: values of different frames must stay comparable.

use super::decode::{Format, decode_raster, luma_of, read_image_file, sniff};
use super::raster::{Raster, Samples};
use crate::DatasetError;
use monogrid_image::GrayImage;
use std::path::Path;

/// Share of the pixels that may lie outside at each end: dead pixels, reflections.
const OUTSIDE: f64 = 0.001;
/// Share of the range that is left free at each end, for what later images show.
const MARGIN: f32 = 0.1;
/// Share of the values of a number of bits from which all of them count as used.
const USED_SHARE: f32 = 0.4;

/// 65535 / 255.
const WORDS_PER_GREY: f32 = 257.0;

/// Values of 16-bit samples that are shown as black and white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    /// Shown as 0.
    pub black: f32,
    /// Shown as 255.
    pub white: f32,
}

impl Levels {
    /// Images whose values are looked at: the first ones, since streams have no others yet.
    pub const NUM_IMAGES: usize = 8;

    /// All values of 16 bits.
    pub const ALL: Self = Self {
        black: 0.0,
        white: u16::MAX as f32,
    };

    /// What the first images of a sequence use of 16 bits; all of it where they have other samples,
    /// or cannot be read.
    #[must_use]
    pub fn of_images<'a>(paths: impl IntoIterator<Item = &'a Path>) -> Self {
        let mut counts = Vec::new();
        for path in paths.into_iter().take(Self::NUM_IMAGES) {
            let raster = read_image_file(path).and_then(|bytes| {
                let is_jpeg = sniff(&bytes, path)? == Format::Jpeg;
                (!is_jpeg).then(|| decode_raster(&bytes, path)).transpose()
            });
            match raster {
                Ok(Some(raster)) if raster.has_all_words() => count(&raster, &mut counts),
                // a damaged image is the business of who reads the frames
                Err(DatasetError::Image { .. } | DatasetError::Io { .. }) => {}
                _ => return Self::ALL,
            }
        }
        Self::of_counts(&counts)
    }

    /// What the first images of a sequence use of 16 bits, by their grey values, [0, 255], of
    /// [all](Self::ALL) of these.
    #[must_use]
    pub fn of_grey(images: impl IntoIterator<Item = GrayImage>) -> Self {
        let mut counts = vec![0; usize::from(u16::MAX) + 1];
        for image in images.into_iter().take(Self::NUM_IMAGES) {
            for value in image.as_slice() {
                counts[usize::from((value * WORDS_PER_GREY).round() as u16)] += 1;
            }
        }
        Self::of_counts(&counts)
    }

    /// The grey values of an image of [all](Self::ALL) 16 bits in these levels.
    #[must_use]
    pub fn of_all(&self, image: &GrayImage) -> GrayImage {
        image.map(|value| self.show(value * WORDS_PER_GREY))
    }

    /// The range of values that occur so many times.
    fn of_counts(counts: &[u64]) -> Self {
        let total: u64 = counts.iter().sum();
        if total == 0 {
            return Self::ALL;
        }
        let few = (total as f64 * OUTSIDE) as u64;
        let low = beyond(few, counts.iter().enumerate());
        let high = beyond(few, counts.iter().enumerate().rev());
        for bits in 10..=16 {
            let white = ((1_u32 << bits) - 1) as f32;
            if high <= white && high - low >= USED_SHARE * white {
                return Self { black: 0.0, white };
            }
        }
        // a plain image is not made of noise
        let margin = (MARGIN * (high - low)).max(MIN_RANGE * 0.5);
        Self {
            black: (low - margin).max(0.0),
            white: (high + margin).min(Self::ALL.white),
        }
    }

    /// The values that a sample becomes, [0, 255].
    pub(super) fn show(&self, value: f32) -> f32 {
        (255.0 * (value - self.black) / (self.white - self.black)).clamp(0.0, 255.0)
    }

    /// How the images are shown, for people; `None` where all values are used.
    #[must_use]
    pub fn note(&self) -> Option<String> {
        (*self != Self::ALL).then(|| {
            format!(
                "the images use a part of their 16 bits: values from {:.0} to {:.0} are shown as \
                 black to white, in all of them",
                self.black, self.white
            )
        })
    }
}

/// The first value with more than a few samples at it and before it.
fn beyond<'a>(few: u64, values: impl Iterator<Item = (usize, &'a u64)>) -> f32 {
    let mut sum = 0;
    let is_beyond = |(_, count): &(usize, &u64)| {
        sum += **count;
        sum > few
    };
    let mut values = values;
    values
        .find(is_beyond)
        .map_or(0.0, |(value, _)| value as f32)
}

/// Values that are stretched at least.
const MIN_RANGE: f32 = 64.0;

fn count(raster: &Raster, counts: &mut Vec<u64>) {
    counts.resize(usize::from(u16::MAX) + 1, 0);
    for value in raster.map(|pixel| luma_of(pixel).round() as u16) {
        counts[usize::from(value)] += 1;
    }
}

impl Raster {
    /// Whether its samples have 16 bits, of which nothing says how many are used.
    pub(super) fn has_all_words(&self) -> bool {
        matches!(self.samples, Samples::Words(_)) && self.white == u16::MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(values: std::ops::Range<usize>, step: usize) -> Levels {
        let mut counts = vec![0; 65_536];
        values.step_by(step).for_each(|value| counts[value] = 1000);
        Levels::of_counts(&counts)
    }

    #[test]
    fn sensors_of_fewer_bits_have_their_own_white() {
        for (most, white) in [
            (1020, 1023.0),
            (4080, 4095.0),
            (2500, 4095.0),
            (16_000, 16_383.0),
        ] {
            let found = levels(30..most, 16);
            assert_eq!((found.black, found.white), (0.0, white), "{most}");
        }
        assert_eq!(levels(0..65_536, 16), Levels::ALL);
        assert_eq!(levels(0..40_000, 16), Levels::ALL);
        assert_eq!(Levels::of_counts(&[]), Levels::ALL);
    }

    #[test]
    fn a_narrow_range_is_stretched_with_room_at_its_ends() {
        let thermal = levels(7000..9001, 1);
        assert!((thermal.black - 6802.0).abs() < 4.0, "{thermal:?}");
        assert!((thermal.white - 9198.0).abs() < 4.0, "{thermal:?}");
        assert_eq!(thermal.show(0.0), 0.0);
        assert!((thermal.show(8000.0) - 127.5).abs() < 0.5);
        assert_eq!(thermal.show(60_000.0), 255.0);
        // a single bright pixel, and an image of one value
        let mut counts = vec![0; 65_536];
        counts[7000..9000].fill(100);
        counts[65_000] = 1;
        assert!(Levels::of_counts(&counts).white < 9300.0);
        let plain = levels(500..501, 1);
        assert!(plain.white - plain.black >= 64.0);
    }
}
