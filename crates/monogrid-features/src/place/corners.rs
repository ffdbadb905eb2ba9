//! What is remembered of a keyframe beside the index: enough to verify a candidate, and not needed
//! before.

use super::locate::Side;
use super::view::Landmark;
use crate::{Descriptor, Feature};
use monogrid_geometry::{Pinhole, Vec2, Vec3};
use std::fmt::Debug;
use std::sync::Arc;

/// The corners of a remembered keyframe with their descriptors, and the positions of those whose
/// depth is known. Some 170 bytes per corner.
#[derive(Clone, Debug)]
pub struct PlaceCorners {
    pub(super) pinhole: Pinhole,
    /// Width and height of its image, px.
    pub(super) size: (usize, usize),
    pub(super) features: Vec<Feature>,
    /// Of each feature.
    pub(super) landmarks: Vec<Option<Landmark>>,
}

/// Corners that somebody keeps: in memory, or where they can be read back.
pub trait KeptCorners: Debug + Send + Sync {
    /// The corners; `None` where they cannot be read back.
    fn get(&self) -> Option<Arc<PlaceCorners>>;
}

/// In memory.
impl KeptCorners for Arc<PlaceCorners> {
    fn get(&self) -> Option<Arc<PlaceCorners>> {
        Some(Self::clone(self))
    }
}

impl PlaceCorners {
    pub(super) fn side(&self) -> Side<'_> {
        Side::new(&self.features, &self.landmarks, self.size, &self.pinhole)
    }

    /// Memory, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.features.capacity() * size_of::<Feature>()
            + self.landmarks.capacity() * size_of::<Option<Landmark>>()
    }

    /// All of it, for [`Self::from_bytes`] of the same build.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let Pinhole { fx, fy, cx, cy } = self.pinhole;
        let mut out = Words::default();
        for number in [fx, fy, cx, cy] {
            out.put(number.to_bits());
        }
        for number in [self.size.0, self.size.1, self.features.len()] {
            out.put(number as u64);
        }
        for (at, feature) in self.features.iter().enumerate() {
            out.put_feature(feature);
            out.put_landmark(self.landmarks.get(at).and_then(Option::as_ref));
        }
        out.0
    }

    /// What [`Self::to_bytes`] wrote; `None` for other bytes.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut words = bytes
            .chunks_exact(8)
            .filter_map(|word| word.try_into().ok().map(u64::from_le_bytes));
        let mut number = || Some(f64::from_bits(words.next()?));
        let pinhole = Pinhole::new(number()?, number()?, number()?, number()?);
        let size = (words.next()? as usize, words.next()? as usize);
        let count = words.next()? as usize;
        // a count that is too large ends with the words
        let most = bytes.len() / 8;
        let mut features = Vec::with_capacity(count.min(most));
        let mut landmarks = Vec::with_capacity(count.min(most));
        for _ in 0..count {
            let feature = feature(&mut words)?;
            landmarks.push(landmark(&mut words, feature)?);
            features.push(feature);
        }
        words.next().is_none().then_some(Self {
            pinhole,
            size,
            features,
            landmarks,
        })
    }
}

/// Bytes in words of 64 bits.
#[derive(Default)]
struct Words(Vec<u8>);

impl Words {
    fn put(&mut self, word: u64) {
        self.0.extend(word.to_le_bytes());
    }

    fn put_feature(&mut self, feature: &Feature) {
        self.put(feature.pixel.x.to_bits());
        self.put(feature.pixel.y.to_bits());
        self.put(feature.level as u64);
        self.put(u64::from(feature.angle_rad.to_bits()));
        for word in feature.descriptor.0 {
            self.put(word);
        }
    }

    fn put_landmark(&mut self, landmark: Option<&Landmark>) {
        self.put(u64::from(landmark.is_some()));
        if let Some(landmark) = landmark {
            for number in landmark.point.iter().chain([&landmark.relative_sigma]) {
                self.put(number.to_bits());
            }
        }
    }
}

fn feature(words: &mut impl Iterator<Item = u64>) -> Option<Feature> {
    let (x, y) = (words.next()?, words.next()?);
    Some(Feature {
        pixel: Vec2::new(f64::from_bits(x), f64::from_bits(y)),
        level: words.next()? as usize,
        angle_rad: f32::from_bits(u32::try_from(words.next()?).ok()?),
        descriptor: Descriptor([words.next()?, words.next()?, words.next()?, words.next()?]),
    })
}

/// The landmark of a feature, if it has one; `None` where the words end.
fn landmark(words: &mut impl Iterator<Item = u64>, feature: Feature) -> Option<Option<Landmark>> {
    if words.next()? == 0 {
        return Some(None);
    }
    let mut number = || Some(f64::from_bits(words.next()?));
    Some(Some(Landmark {
        feature,
        point: Vec3::new(number()?, number()?, number()?),
        relative_sigma: number()?,
    }))
}
