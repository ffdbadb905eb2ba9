//! Values as they are written to the file.

use super::Kept;
use crate::DepthPixel;
use monogrid_alignment::DepthSample;
use monogrid_depth::{DenseDepth, PackedDepth};
use monogrid_features::{KeptCorners, PlaceCorners};
use monogrid_image::{GrayImage, Image, Pyramid};
use monogrid_occupancy::DepthPixel as Measurement;
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::any::Any;
use std::sync::Arc;

/// A value of which is known what it takes.
pub(crate) trait Measured: Send + Sync + 'static {
    /// Memory, bytes.
    fn bytes(&self) -> usize;
}

/// A value that can be written and read again.
pub(crate) trait Keepable: Measured + Serialize + DeserializeOwned {}

impl<T: Measured + Serialize + DeserializeOwned> Keepable for T {}

/// A value as bytes; `None` for one of another type.
pub(super) fn pack_any<T: Keepable>(value: &(dyn Any + Send + Sync)) -> Option<Vec<u8>> {
    postcard::to_allocvec(value.downcast_ref::<T>()?).ok()
}

/// The value of these bytes.
pub(super) fn unpack<T: Keepable>(bytes: &[u8]) -> Option<T> {
    postcard::from_bytes(bytes).ok()
}

/// Measurements of a keyframe, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Measurements(pub Vec<Measurement>);

impl Serialize for Measurements {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let pixels = self.0.iter();
        serializer.collect_seq(pixels.map(|p| (p.x, p.y, p.idepth, p.sigma_idepth)))
    }
}

impl<'de> Deserialize<'de> for Measurements {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let pixels = Vec::<(u16, u16, f32, f32)>::deserialize(deserializer)?;
        let measurement = |(x, y, idepth, sigma_idepth)| Measurement {
            x,
            y,
            idepth,
            sigma_idepth,
        };
        Ok(Self(pixels.into_iter().map(measurement).collect()))
    }
}

impl Measured for Measurements {
    fn bytes(&self) -> usize {
        self.0.capacity() * size_of::<Measurement>()
    }
}

/// Dense depth of a keyframe.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct KeptDense(pub DenseDepth);

impl Serialize for KeptDense {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let DenseDepth { idepth, sigma } = &self.0;
        let size = (idepth.width(), idepth.height());
        (size, idepth.as_slice(), sigma.as_slice()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for KeptDense {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let ((width, height), idepth, sigma) =
            <((usize, usize), Vec<f32>, Vec<f32>)>::deserialize(deserializer)?;
        let image = |values| {
            let image = Image::from_vec(width, height, values);
            image.ok_or_else(|| serde::de::Error::custom("values for each pixel"))
        };
        Ok(Self(DenseDepth {
            idepth: image(idepth)?,
            sigma: image(sigma)?,
        }))
    }
}

impl Measured for KeptDense {
    fn bytes(&self) -> usize {
        2 * size_of_val(self.0.idepth.as_slice())
    }
}

/// Corners by which a place is verified.
#[derive(Clone, Debug)]
pub(crate) struct StoredCorners(pub Arc<PlaceCorners>);

impl Serialize for StoredCorners {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0.to_bytes())
    }
}

impl<'de> Deserialize<'de> for StoredCorners {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let bytes = Vec::<u8>::deserialize(deserializer)?;
        let corners = PlaceCorners::from_bytes(&bytes);
        let corners = corners.ok_or_else(|| D::Error::custom("the corners of a place"))?;
        Ok(Self(Arc::new(corners)))
    }
}

impl Measured for StoredCorners {
    fn bytes(&self) -> usize {
        self.0.bytes()
    }
}

impl KeptCorners for Kept<StoredCorners> {
    fn get(&self) -> Option<Arc<PlaceCorners>> {
        Some(Arc::clone(&Self::get(self)?.0))
    }
}

/// An image in eight bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct KeptImage {
    width: usize,
    height: usize,
    /// Row-major.
    values: Vec<u8>,
}

impl KeptImage {
    /// An image whose values lie between 0 and 255, rounded.
    pub(crate) fn rounded(image: &GrayImage) -> Self {
        let round = |value: &f32| value.round().clamp(0.0, 255.0) as u8;
        Self {
            width: image.width(),
            height: image.height(),
            values: image.as_slice().iter().map(round).collect(),
        }
    }

    /// The image again.
    pub(crate) fn image(&self) -> Option<Image<u8>> {
        Image::from_vec(self.width, self.height, self.values.clone())
    }
}

impl Measured for KeptImage {
    fn bytes(&self) -> usize {
        self.values.capacity()
    }
}

impl Measured for Pyramid {
    fn bytes(&self) -> usize {
        Self::bytes(self)
    }
}

impl Measured for PackedDepth {
    fn bytes(&self) -> usize {
        self.bytes_in_memory()
    }
}

impl Measured for Vec<DepthSample> {
    fn bytes(&self) -> usize {
        self.capacity() * size_of::<DepthSample>()
    }
}

impl Measured for Vec<DepthPixel> {
    fn bytes(&self) -> usize {
        self.capacity() * size_of::<DepthPixel>()
    }
}
