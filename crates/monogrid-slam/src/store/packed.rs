//! Values as they are written to the file.

use super::Kept;
use crate::DepthPixel;
use monogrid_alignment::DepthSample;
use monogrid_depth::{DenseDepth, PackedDepth};
use monogrid_features::{KeptCorners, PlaceCorners};
use monogrid_image::{GrayImage, Image, Pyramid, to_gray8};
use monogrid_occupancy::DepthPixel as Measurement;
use std::any::Any;
use std::sync::Arc;

/// A value of which is known what it takes.
pub(crate) trait Measured: Send + Sync + 'static {
    /// Memory, bytes.
    fn bytes(&self) -> usize;
}

/// A value that can be written and read again: often, since little is in memory, so that pixels are copied and not encoded.
pub(crate) trait Keepable: Measured + Sized {
    /// As bytes.
    fn pack(&self) -> Vec<u8>;

    /// The value of these bytes.
    fn unpack(bytes: &[u8]) -> Option<Self>;
}

/// A value as bytes; `None` for one of another type.
pub(super) fn pack_any<T: Keepable>(value: &(dyn Any + Send + Sync)) -> Option<Vec<u8>> {
    Some(value.downcast_ref::<T>()?.pack())
}

/// Column and row of a pixel, and two numbers.
type Pixel = (u16, u16, f32, f32);

/// Bytes of a pixel.
const PIXEL: usize = 12;

fn pack_pixels<T: Copy>(pixels: &[T], of: impl Fn(T) -> Pixel) -> Vec<u8> {
    let mut bytes = vec![0; PIXEL * pixels.len()];
    for (to, pixel) in bytes.as_chunks_mut::<PIXEL>().0.iter_mut().zip(pixels) {
        let (x, y, first, second) = of(*pixel);
        to[..2].copy_from_slice(&x.to_le_bytes());
        to[2..4].copy_from_slice(&y.to_le_bytes());
        to[4..8].copy_from_slice(&first.to_le_bytes());
        to[8..].copy_from_slice(&second.to_le_bytes());
    }
    bytes
}

fn unpack_pixels<T>(bytes: &[u8], to: impl Fn(Pixel) -> T) -> Option<Vec<T>> {
    let (pixels, rest) = bytes.as_chunks::<PIXEL>();
    let pixel = |[a, b, c, d, e, f, g, h, i, j, k, l]: &[u8; PIXEL]| {
        to((
            u16::from_le_bytes([*a, *b]),
            u16::from_le_bytes([*c, *d]),
            f32::from_le_bytes([*e, *f, *g, *h]),
            f32::from_le_bytes([*i, *j, *k, *l]),
        ))
    };
    rest.is_empty().then(|| pixels.iter().map(pixel).collect())
}

/// Measurements of a keyframe, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Measurements(pub Vec<Measurement>);

impl Keepable for Measurements {
    fn pack(&self) -> Vec<u8> {
        pack_pixels(&self.0, |p| (p.x, p.y, p.idepth, p.sigma_idepth))
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let measurement = |(x, y, idepth, sigma_idepth)| Measurement {
            x,
            y,
            idepth,
            sigma_idepth,
        };
        unpack_pixels(bytes, measurement).map(Self)
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

impl Keepable for KeptDense {
    fn pack(&self) -> Vec<u8> {
        let DenseDepth { idepth, sigma } = &self.0;
        let width = idepth.width() as u64;
        let values = idepth.as_slice().iter().chain(sigma.as_slice());
        let values = values.flat_map(|value| value.to_le_bytes());
        width.to_le_bytes().into_iter().chain(values).collect()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let (width, values) = bytes.split_first_chunk()?;
        let width = u64::from_le_bytes(*width) as usize;
        let values = values.as_chunks().0.iter();
        let mut idepth: Vec<f32> = values.map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let sigma = idepth.split_off(idepth.len() / 2);
        let height = sigma.len().checked_div(width)?;
        Some(Self(DenseDepth {
            idepth: Image::from_vec(width, height, idepth)?,
            sigma: Image::from_vec(width, height, sigma)?,
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

impl Keepable for StoredCorners {
    fn pack(&self) -> Vec<u8> {
        self.0.to_bytes()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        Some(Self(Arc::new(PlaceCorners::from_bytes(bytes)?)))
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
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct KeptImage {
    width: usize,
    height: usize,
    /// Row-major.
    values: Vec<u8>,
}

impl KeptImage {
    /// An image whose values lie between 0 and 255, rounded.
    pub(crate) fn rounded(image: &GrayImage) -> Self {
        let values = image.as_slice().iter();
        Self {
            width: image.width(),
            height: image.height(),
            values: values.map(|value| to_gray8(*value)).collect(),
        }
    }

    /// The image again.
    pub(crate) fn image(&self) -> Option<Image<u8>> {
        Image::from_vec(self.width, self.height, self.values.clone())
    }

    /// The image in numbers.
    pub(crate) fn grey(&self) -> Option<GrayImage> {
        GrayImage::from_gray8(self.width, self.height, &self.values)
    }
}

impl Keepable for KeptImage {
    fn pack(&self) -> Vec<u8> {
        [&(self.width as u64).to_le_bytes(), self.values.as_slice()].concat()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let (width, values) = bytes.split_first_chunk()?;
        let width = u64::from_le_bytes(*width) as usize;
        Some(Self {
            width,
            height: values.len().checked_div(width)?,
            values: values.to_vec(),
        })
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

impl Keepable for PackedDepth {
    fn pack(&self) -> Vec<u8> {
        // none of its numbers is refused
        postcard::to_allocvec(self).unwrap_or_default()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes(bytes).ok()
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

impl Keepable for Vec<DepthSample> {
    fn pack(&self) -> Vec<u8> {
        pack_pixels(self, |p| (p.x, p.y, p.idepth, p.idepth_var))
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let sample = |(x, y, idepth, idepth_var)| DepthSample {
            x,
            y,
            idepth,
            idepth_var,
        };
        unpack_pixels(bytes, sample)
    }
}

impl Keepable for Vec<DepthPixel> {
    fn pack(&self) -> Vec<u8> {
        pack_pixels(self, |p| (p.x, p.y, p.idepth, p.idepth_var))
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let pixel = |(x, y, idepth, idepth_var)| DepthPixel {
            x,
            y,
            idepth,
            idepth_var,
        };
        unpack_pixels(bytes, pixel)
    }
}
