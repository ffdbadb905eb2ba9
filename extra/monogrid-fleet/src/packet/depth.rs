//! Semi-dense depth in few bytes: which pixels have any, then logarithms of inverse depth and of
//! its relative sigma in steps, each as its difference from what its neighbours let expect,
//! deflated.

use super::PacketError;
use super::bounds::check_size;
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use monogrid_datasets::DepthPixel;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};

/// Step of the logarithm of inverse depth: its error has a sigma of 0.23 % of the depth, a tenth of
/// that of the depth itself (median 2.3 %).
pub const IDEPTH_STEP: f64 = 1.0 / 128.0;
/// Steps of the relative sigma per factor of two: it is known to 19 %.
pub const SIGMA_STEPS_PER_OCTAVE: f64 = 2.0;
/// Longest number of a stream, bytes.
const MAX_NUMBER_BYTES: usize = 5;

/// The depth of a keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PackedDepth {
    /// One bit for each pixel, row by row, the highest bit of a byte first; deflated.
    mask: Vec<u8>,
    /// `ln(inverse depth) / IDEPTH_STEP` of the pixels of the mask as differences, deflated. Small
    /// ones take few bytes, as postcard has them: 2 n, or -2 n - 1 of negative ones, seven bits per
    /// byte, the lowest first; the highest bit of a byte says that another one follows.
    idepth: Vec<u8>,
    /// The same of `SIGMA_STEPS_PER_OCTAVE * log2(sigma / inverse depth)`.
    sigma: Vec<u8>,
}

impl PackedDepth {
    /// Packs the depth of an image of this width and height, px. Pixels outside it, without a
    /// value, or named twice, are left out.
    #[must_use]
    pub fn pack(pixels: &[DepthPixel], size: (u16, u16)) -> Self {
        let (width, height) = (usize::from(size.0), usize::from(size.1));
        let mut image: Vec<Option<DepthPixel>> = vec![None; width * height];
        for pixel in pixels.iter().filter(|p| p.x < size.0 && p.y < size.1) {
            if levels(pixel).is_some() {
                image[usize::from(pixel.y) * width + usize::from(pixel.x)] = Some(*pixel);
            }
        }
        let mask: Vec<bool> = image.iter().map(Option::is_some).collect();
        let levels: Vec<[i32; 2]> = image.iter().flatten().filter_map(levels).collect();
        let stream = |which: usize| {
            let mut known = Neighbours::new(&mask, width);
            let mut numbers = Vec::new();
            for level in &levels {
                let difference = level[which].wrapping_sub(known.expected());
                // writing into memory does not fail
                numbers = postcard::to_extend(&difference, numbers).unwrap_or_default();
                known.next(level[which]);
            }
            deflated(&numbers)
        };
        Self {
            mask: deflated(&bits(&mask)),
            idepth: stream(0),
            sigma: stream(1),
        }
    }

    /// The depth of an image of this width and height, px, row by row.
    ///
    /// # Errors
    /// [`PacketError::Content`].
    pub fn unpack(&self, size: (u16, u16)) -> Result<Vec<DepthPixel>, PacketError> {
        check_size(size)?;
        self.unpacked(size)
            .ok_or(PacketError::Content("depth does not fit its image"))
    }

    fn unpacked(&self, size: (u16, u16)) -> Option<Vec<DepthPixel>> {
        let (width, height) = (usize::from(size.0), usize::from(size.1));
        let mask = inflated(&self.mask, (width * height).div_ceil(8))?;
        let is_set = |at: usize| {
            mask.get(at / 8)
                .is_some_and(|byte| byte >> (7 - at % 8) & 1 == 1)
        };
        let mask: Vec<bool> = (0..width * height).map(is_set).collect();
        let count = mask.iter().filter(|is_set| **is_set).count();
        let stream = |bytes: &[u8]| {
            let bytes = inflated(bytes, count * MAX_NUMBER_BYTES)?;
            let mut known = Neighbours::new(&mask, width);
            let mut input = bytes.as_slice();
            let mut levels = Vec::with_capacity(count);
            for _ in 0..count {
                let (difference, rest) = postcard::take_from_bytes::<i32>(input).ok()?;
                input = rest;
                let level = known.expected().wrapping_add(difference);
                known.next(level);
                levels.push(level);
            }
            input.is_empty().then_some(levels)
        };
        let (idepths, sigmas) = (stream(&self.idepth)?, stream(&self.sigma)?);
        let places = (0..mask.len()).filter(|at| mask[*at]);
        let pixels = places.zip(idepths.into_iter().zip(sigmas));
        pixels
            .map(|(at, levels)| pixel((at % width, at / width), levels))
            .collect()
    }
}

/// Steps of inverse depth and of its relative sigma; `None` where they have no logarithm.
fn levels(pixel: &DepthPixel) -> Option<[i32; 2]> {
    let (idepth, variance) = (f64::from(pixel.idepth), f64::from(pixel.idepth_var));
    let is_usable = |v: f64| v.is_finite() && v > 0.0;
    (is_usable(idepth) && is_usable(variance)).then(|| {
        let sigma = variance.sqrt() / idepth;
        [
            (idepth.ln() / IDEPTH_STEP).round() as i32,
            (sigma.log2() * SIGMA_STEPS_PER_OCTAVE).round() as i32,
        ]
    })
}

fn pixel((x, y): (usize, usize), (idepth, sigma): (i32, i32)) -> Option<DepthPixel> {
    let value = (f64::from(idepth) * IDEPTH_STEP).exp();
    let sigma = value * (f64::from(sigma) / SIGMA_STEPS_PER_OCTAVE).exp2();
    let pixel = DepthPixel {
        x: u16::try_from(x).ok()?,
        y: u16::try_from(y).ok()?,
        idepth: value as f32,
        idepth_var: (sigma * sigma) as f32,
    };
    let is_usable = |v: f32| v.is_finite() && v > 0.0;
    (is_usable(pixel.idepth) && is_usable(pixel.idepth_var)).then_some(pixel)
}

/// Walks over the pixels of a mask and says of each what those before it let expect.
struct Neighbours<'a> {
    mask: &'a [bool],
    levels: Vec<i32>,
    width: usize,
    /// The pixel that is next.
    at: usize,
    last: i32,
}

impl<'a> Neighbours<'a> {
    fn new(mask: &'a [bool], width: usize) -> Self {
        let mut new = Self {
            mask,
            levels: vec![0; mask.len()],
            width,
            at: 0,
            last: 0,
        };
        new.skip();
        new
    }

    fn skip(&mut self) {
        while self.mask.get(self.at) == Some(&false) {
            self.at += 1;
        }
    }

    /// Left plus up minus what lies between, as far as that lies between left and up; else the one
    /// that is there, else the last one.
    fn expected(&self) -> i32 {
        let has_left = !self.at.is_multiple_of(self.width);
        let level = |back: usize, is_there: bool| {
            let at = self.at.checked_sub(back);
            let at = at.filter(|at| is_there && self.mask[*at])?;
            Some(self.levels[at])
        };
        let left = level(1, has_left);
        let up = level(self.width, true);
        match (left, up, level(self.width + 1, has_left)) {
            (Some(left), Some(up), Some(corner)) => {
                let plane = left.wrapping_add(up).wrapping_sub(corner);
                plane.clamp(left.min(up), left.max(up))
            }
            (Some(left), ..) => left,
            (None, Some(up), _) => up,
            (None, None, _) => self.last,
        }
    }

    /// Takes the level of the pixel and goes to the next one.
    fn next(&mut self, level: i32) {
        self.levels[self.at] = level;
        self.last = level;
        self.at += 1;
        self.skip();
    }
}

fn bits(mask: &[bool]) -> Vec<u8> {
    let byte = |eight: &[bool]| {
        let set = eight.iter().zip(0..).filter(|(is_set, _)| **is_set);
        set.fold(0_u8, |byte, (_, bit)| byte | 0x80 >> bit)
    };
    mask.chunks(8).map(byte).collect()
}

/// Deflated bytes.
pub(super) fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
    // writing into memory does not fail
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

/// Bytes that were deflated; `None` where they are more than `limit`, or damaged.
pub(super) fn inflated(bytes: &[u8], limit: usize) -> Option<Vec<u8>> {
    let mut out = Vec::new();
    let mut decoder = DeflateDecoder::new(bytes).take(limit as u64 + 1);
    decoder.read_to_end(&mut out).ok()?;
    (out.len() <= limit).then_some(out)
}
