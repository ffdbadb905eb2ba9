//! Values as they are written to the file.

use super::Kept;
use monogrid_depth::{DenseDepth, MeasuredDepth, PackedDepth};
use monogrid_features::{KeptCorners, PlaceCorners};
use monogrid_image::{DepthPixel, Image, Pyramid};
use std::any::Any;
use std::sync::Arc;

/// A value of which is known what it takes.
pub trait Measured: Send + Sync + 'static {
    /// Memory, bytes.
    fn bytes(&self) -> usize;
}

/// A value that can be written and read again: often, since little is in memory, so that pixels are
/// copied and not encoded.
pub trait Keepable: Measured + Sized {
    /// As bytes.
    fn pack(&self) -> Vec<u8>;

    /// The value of these bytes.
    fn unpack(bytes: &[u8]) -> Option<Self>;
}

/// A value as bytes; `None` for one of another type.
pub(super) fn pack_any<T: Keepable>(value: &(dyn Any + Send + Sync)) -> Option<Vec<u8>> {
    Some(value.downcast_ref::<T>()?.pack())
}

/// A pixel as it is written: column, row and two numbers.
pub type PackedPixel = (u16, u16, f32, f32);

/// Bytes of a pixel.
const PIXEL: usize = 12;

/// Pixels as bytes.
pub fn pack_pixels(pixels: impl ExactSizeIterator<Item = PackedPixel>) -> Vec<u8> {
    let mut bytes = vec![0; PIXEL * pixels.len()];
    let to = bytes.as_chunks_mut::<PIXEL>().0.iter_mut();
    for (to, (x, y, first, second)) in to.zip(pixels) {
        to[..2].copy_from_slice(&x.to_le_bytes());
        to[2..4].copy_from_slice(&y.to_le_bytes());
        to[4..8].copy_from_slice(&first.to_le_bytes());
        to[8..].copy_from_slice(&second.to_le_bytes());
    }
    bytes
}

/// The pixels of these bytes; `None` where one is not whole.
pub fn unpack_pixels<T>(bytes: &[u8], of_packed: impl Fn(PackedPixel) -> T) -> Option<Vec<T>> {
    let (pixels, rest) = bytes.as_chunks::<PIXEL>();
    let pixel = |[a, b, c, d, e, f, g, h, i, j, k, l]: &[u8; PIXEL]| {
        of_packed((
            u16::from_le_bytes([*a, *b]),
            u16::from_le_bytes([*c, *d]),
            f32::from_le_bytes([*e, *f, *g, *h]),
            f32::from_le_bytes([*i, *j, *k, *l]),
        ))
    };
    rest.is_empty().then(|| pixels.iter().map(pixel).collect())
}

impl Keepable for Vec<DepthPixel> {
    fn pack(&self) -> Vec<u8> {
        pack_pixels(self.iter().map(|p| (p.x, p.y, p.idepth, p.idepth_var)))
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        unpack_pixels(bytes, |(x, y, idepth, idepth_var)| DepthPixel {
            x,
            y,
            idepth,
            idepth_var,
        })
    }
}

impl Measured for Vec<DepthPixel> {
    fn bytes(&self) -> usize {
        self.capacity() * size_of::<DepthPixel>()
    }
}

impl Keepable for MeasuredDepth {
    fn pack(&self) -> Vec<u8> {
        let (width, _) = self.size();
        let numbers = [self.sigma()].into_iter();
        let numbers = numbers.chain(self.idepth().as_slice().iter().copied());
        let numbers = numbers.flat_map(f32::to_le_bytes);
        let width = (width as u64).to_le_bytes();
        width.into_iter().chain(numbers).collect()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let (width, values) = bytes.split_first_chunk()?;
        let width = u64::from_le_bytes(*width) as usize;
        let (sigma, values) = values.split_first_chunk()?;
        let values = values.as_chunks().0.iter();
        let idepth: Vec<f32> = values.map(|bytes| f32::from_le_bytes(*bytes)).collect();
        let height = idepth.len().checked_div(width)?;
        let idepth = Image::from_vec(width, height, idepth)?;
        Some(Self::of_inverse(idepth, f32::from_le_bytes(*sigma)))
    }
}

impl Measured for MeasuredDepth {
    fn bytes(&self) -> usize {
        size_of_val(self.idepth().as_slice())
    }
}

impl Keepable for DenseDepth {
    fn pack(&self) -> Vec<u8> {
        let width = self.idepth.width() as u64;
        let values = self.idepth.as_slice().iter().chain(self.sigma.as_slice());
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
        Some(Self {
            idepth: Image::from_vec(width, height, idepth)?,
            sigma: Image::from_vec(width, height, sigma)?,
        })
    }
}

impl Measured for DenseDepth {
    fn bytes(&self) -> usize {
        2 * size_of_val(self.idepth.as_slice())
    }
}

impl Keepable for PlaceCorners {
    fn pack(&self) -> Vec<u8> {
        self.to_bytes()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        Self::from_bytes(bytes)
    }
}

impl Measured for PlaceCorners {
    fn bytes(&self) -> usize {
        Self::bytes(self)
    }
}

impl KeptCorners for Kept<PlaceCorners> {
    fn get(&self) -> Option<Arc<PlaceCorners>> {
        Self::get(self)
    }
}

impl Keepable for Image<u8> {
    fn pack(&self) -> Vec<u8> {
        [&(self.width() as u64).to_le_bytes(), self.as_slice()].concat()
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let (width, values) = bytes.split_first_chunk()?;
        let width = u64::from_le_bytes(*width) as usize;
        Self::from_vec(width, values.len().checked_div(width)?, values.to_vec())
    }
}

impl Measured for Image<u8> {
    fn bytes(&self) -> usize {
        self.as_slice().len()
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
