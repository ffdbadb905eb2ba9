//! From the image of a real camera to the image of an ideal pinhole camera of a working size.

use crate::{GrayImage, Image, Mask, Resize, resize_area};
use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2};
use std::borrow::Cow;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// How the working size is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorkingSize {
    /// At most about this many pixels in the shape of the input, never larger than it.
    Pixels(usize),
    /// Exactly this size; a different aspect ratio crops the longer side.
    Exact {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
    },
}

impl WorkingSize {
    /// Pixels of [`Self::AUTOMATIC`].
    pub const AUTOMATIC_PIXELS: usize = 640 * 480;
    /// As many pixels as 640x480.
    pub const AUTOMATIC: Self = Self::Pixels(Self::AUTOMATIC_PIXELS);
    /// Pixels that may be asked for: tracking keeps some hundred bytes for each.
    pub const ALLOWED_PIXELS: RangeInclusive<usize> = 4096..=4_000_000;

    /// The working size for images of the given size.
    #[must_use]
    pub fn resolve(self, width: usize, height: usize) -> (usize, usize) {
        match self {
            Self::Exact { width, height } => (width, height),
            Self::Pixels(budget) => {
                let (budget, pixels) = (budget as f64, (width * height) as f64);
                // up to 20 % above the budget the loss of sharpness costs more than the pixels
                if pixels <= 1.2 * budget {
                    return (width, height);
                }
                let factor = (budget / pixels).sqrt();
                let even = |x: usize| (((x as f64 * factor) / 2.0).round() as usize * 2).max(16);
                (even(width), even(height))
            }
        }
    }
}

/// Where an output pixel is read: between four pixels of the reduced image.
#[derive(Clone, Copy, Debug)]
struct Tap {
    /// Index of the upper left of the four, [`Tap::OUTSIDE`] when the image does not show the
    /// place.
    index: u32,
    /// Fractions of a pixel to the right and down, [0, 1].
    fraction: [f32; 2],
}

impl Tap {
    const OUTSIDE: u32 = u32::MAX;

    /// The tap at `(x, y)` of an image of the given size; outside the square of pixel centres, or
    /// when not a number, it is none.
    fn new(x: f64, y: f64, size: Resize) -> Self {
        let (x, y) = (x as f32, y as f32);
        let (right, bottom) = (size.width as f32 - 1.0, size.height as f32 - 1.0);
        let is_inside = x >= 0.0 && y >= 0.0 && x <= right && y <= bottom;
        if !is_inside || size.width < 2 || size.height < 2 {
            return Self {
                index: Self::OUTSIDE,
                fraction: [0.0; 2],
            };
        }
        let (left, top) = (
            (x as usize).min(size.width - 2),
            (y as usize).min(size.height - 2),
        );
        Self {
            index: (top * size.width + left) as u32,
            fraction: [x - left as f32, y - top as f32],
        }
    }

    /// Bilinear value in an image of the width it was made for.
    #[inline]
    fn read(&self, pixels: &[f32], width: usize) -> Option<f32> {
        if self.index == Self::OUTSIDE {
            return None;
        }
        let i = self.index as usize;
        let (upper, lower) = (pixels.get(i..i + 2)?, pixels.get(i + width..i + width + 2)?);
        let [fx, fy] = self.fraction;
        let top = upper[0] + fx * (upper[1] - upper[0]);
        let bottom = lower[0] + fx * (lower[1] - lower[0]);
        Some(top + fy * (bottom - top))
    }
}

/// Precomputed mapping from input images to working images.
///
/// Without distortion the image is cropped and averaged over areas; with distortion it is resampled
/// bilinearly (after area averaging when the working size is smaller).
#[derive(Clone, Debug)]
pub struct Undistorter {
    input: Camera,
    pinhole: Pinhole,
    width: usize,
    height: usize,
    /// Crop of the input (left, top, width, height) before resampling.
    crop: (usize, usize, usize, usize),
    /// Size after area averaging, before remapping.
    reduced: Resize,
    /// Where each output pixel is read in the reduced image; empty when nothing is to be resampled.
    /// Copies of the mapping share it.
    remap: Arc<[Tap]>,
    mask: Mask,
}

/// Tangent of the largest angle from the axis that the working image shows on each side (60
/// degrees).
///
/// A pinhole image stretches the rim without bound: at 60 degrees a pixel of the rim covers a
/// quarter of the angle of one in the centre, and a fisheye shown whole would leave the centre,
/// which tracking lives on, a few dozen pixels.
const MAX_HALF_ANGLE_TAN: f64 = 1.732;

/// Pixels by which the valid area is eroded, so that no gradient sees the border.
const MASK_EROSION: usize = 3;

impl Undistorter {
    /// Prepares the mapping. `mask` (in input pixels, 0 = ignore) excludes parts of the image.
    #[must_use]
    pub fn new(input: &Camera, size: WorkingSize, mask: Option<&Mask>) -> Self {
        Self::prepare(input, size.resolve(input.width, input.height), None, mask)
    }

    /// Prepares the mapping to images of this `size` (width, height), px, that a pinhole camera at
    /// the same place and with the same direction of view takes: that of another camera, of which
    /// this one is the second.
    #[must_use]
    pub fn onto(input: &Camera, pinhole: Pinhole, size: (usize, usize)) -> Self {
        Self::prepare(input, size, Some(pinhole), None)
    }

    fn prepare(
        input: &Camera,
        (width, height): (usize, usize),
        wanted: Option<Pinhole>,
        mask: Option<&Mask>,
    ) -> Self {
        let crop = centred_crop(input, width, height);
        let (left, top, crop_width, crop_height) = crop;
        let reduced = Resize {
            width: width.min(crop_width),
            height: height.min(crop_height),
        };
        let factor_x = reduced.width as f64 / crop_width as f64;
        let factor_y = reduced.height as f64 / crop_height as f64;
        let reduced_pinhole = input
            .pinhole
            .cropped(left as f64, top as f64)
            .scaled(factor_x, factor_y);
        let enlarge_x = width as f64 / reduced.width as f64;
        let enlarge_y = height as f64 / reduced.height as f64;
        let enlarged = reduced_pinhole.scaled(enlarge_x, enlarge_y);
        let pinhole = match wanted {
            Some(pinhole) => pinhole,
            None if input.distortion == Distortion::None => enlarged,
            None => inscribed_pinhole(input, &crop, width, height).unwrap_or(enlarged),
        };
        let plain = input.distortion == Distortion::None
            && reduced.width == width
            && reduced.height == height
            && pinhole == enlarged;
        let remap = if plain {
            Vec::new()
        } else {
            let distortion = &input.distortion;
            remap_table(
                &pinhole,
                (width, height),
                &reduced_pinhole,
                reduced,
                distortion,
            )
        };
        let mut this = Self {
            input: *input,
            pinhole,
            width,
            height,
            crop,
            reduced,
            remap: remap.into(),
            mask: Mask::filled(width, height, 255),
        };
        this.mask = this.valid_mask(mask);
        this
    }

    /// Intrinsics of the working images.
    #[must_use]
    pub fn pinhole(&self) -> &Pinhole {
        &self.pinhole
    }

    /// Width and height of the working images, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Camera of the input images.
    #[must_use]
    pub fn input(&self) -> &Camera {
        &self.input
    }

    /// Pixels of the working image that may be used (255), eroded by three pixels.
    #[must_use]
    pub fn mask(&self) -> &Mask {
        &self.mask
    }

    /// The working image of an input image; `None` when it has another size than the camera.
    #[must_use]
    pub fn apply(&self, image: &GrayImage) -> Option<GrayImage> {
        if image.width() != self.input.width || image.height() != self.input.height {
            return None;
        }
        let reduced = self.reduce(image);
        if self.remap.is_empty() {
            return Some(reduced.into_owned());
        }
        let (pixels, row) = (reduced.as_slice(), self.reduced.width);
        let output = self.remap.iter();
        let output = output.map(|tap| tap.read(pixels, row).unwrap_or(0.0));
        Image::from_vec(self.width, self.height, output.collect())
    }

    /// Crop and area averaging.
    fn reduce<'a>(&self, image: &'a GrayImage) -> Cow<'a, GrayImage> {
        let (left, top, width, height) = self.crop;
        let is_whole = width == image.width() && height == image.height();
        if is_whole && self.reduced == (Resize { width, height }) {
            return Cow::Borrowed(image);
        }
        if is_whole {
            return Cow::Owned(resize_area(image, self.reduced));
        }
        let mut cropped = Image::filled(width, height, 0.0f32);
        for y in 0..height {
            cropped
                .row_mut(y)
                .copy_from_slice(&image.row(top + y)[left..left + width]);
        }
        Cow::Owned(resize_area(&cropped, self.reduced))
    }

    /// Pixels whose source lies inside the input image and the user's mask.
    fn valid_mask(&self, user: Option<&Mask>) -> Mask {
        let user = user
            .filter(|m| m.width() == self.input.width && m.height() == self.input.height)
            .map(|m| self.reduce(&m.map(f32::from)).into_owned());
        let raw = Mask::from_fn(self.width, self.height, |x, y| {
            let i = y * self.width + x;
            let allowed = match (self.remap.get(i), &user) {
                (Some(tap), None) => (tap.index != Tap::OUTSIDE).then_some(255.0),
                (Some(tap), Some(user)) => tap.read(user.as_slice(), self.reduced.width),
                (None, Some(user)) => Some(user.at(x, y)),
                (None, None) => Some(255.0),
            };
            // a pixel to which an excluded one contributes is excluded
            if allowed.is_some_and(|v| v > 254.0) {
                255
            } else {
                0
            }
        });
        erode(&raw, MASK_EROSION)
    }
}

/// The largest centred part of the input with the aspect ratio of the working size.
fn centred_crop(input: &Camera, width: usize, height: usize) -> (usize, usize, usize, usize) {
    let (w, h) = (input.width as f64, input.height as f64);
    let ratio = width as f64 / height as f64;
    // within one pixel of the right ratio (rounding of the automatic size) nothing is cropped
    if (w / ratio - h).abs() <= 2.0 * h / height as f64 {
        return (0, 0, input.width, input.height);
    }
    let (crop_w, crop_h) = if w / h > ratio {
        ((h * ratio).round() as usize, input.height)
    } else {
        (input.width, (w / ratio).round() as usize)
    };
    (
        (input.width - crop_w) / 2,
        (input.height - crop_h) / 2,
        crop_w,
        crop_h,
    )
}

/// A pinhole camera of the given size whose border midpoints see inside the input image ("crop").
///
/// The midpoints of the four borders of the input are undistorted; the output's borders lie on the
/// innermost of them, as in PTAM's and LSD-SLAM's crop mode, but at most [`MAX_HALF_ANGLE_TAN`]
/// wide.
fn inscribed_pinhole(
    input: &Camera,
    crop: &(usize, usize, usize, usize),
    width: usize,
    height: usize,
) -> Option<Pinhole> {
    let (left, top, crop_w, crop_h) = (crop.0 as f64, crop.1 as f64, crop.2 as f64, crop.3 as f64);
    let (mid_x, mid_y) = (input.pinhole.cx, input.pinhole.cy);
    // a border that the model sees at 90 degrees or beyond is limited like any other wide one
    let limit = MAX_HALF_ANGLE_TAN;
    let tangent = |x: f64, y: f64| input.unproject(&Vec2::new(x, y));
    let x_min = tangent(left, mid_y).map_or(-limit, |ray| ray.x.max(-limit));
    let x_max = tangent(left + crop_w - 1.0, mid_y).map_or(limit, |ray| ray.x.min(limit));
    let y_min = tangent(mid_x, top).map_or(-limit, |ray| ray.y.max(-limit));
    let y_max = tangent(mid_x, top + crop_h - 1.0).map_or(limit, |ray| ray.y.min(limit));
    let fx = (width as f64 - 1.0) / (x_max - x_min);
    let fy = (height as f64 - 1.0) / (y_max - y_min);
    (fx.is_finite() && fy.is_finite() && fx > 0.0 && fy > 0.0)
        .then(|| Pinhole::new(fx, fy, -x_min * fx, -y_min * fy))
}

/// Where each pixel of the output, of `size` (width, height), is read in the reduced input image.
fn remap_table(
    pinhole: &Pinhole,
    size: (usize, usize),
    reduced_pinhole: &Pinhole,
    reduced: Resize,
    distortion: &Distortion,
) -> Vec<Tap> {
    let (width, height) = size;
    let mut table = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let ideal = pinhole.unproject(&Vec2::new(x as f64, y as f64)).xy();
            let seen = distortion.distort(&ideal).unwrap_or(Vec2::repeat(f64::NAN));
            table.push(Tap::new(
                reduced_pinhole.fx * seen.x + reduced_pinhole.cx,
                reduced_pinhole.fy * seen.y + reduced_pinhole.cy,
                reduced,
            ));
        }
    }
    table
}

/// Clears every pixel within `radius` (in both axes) of an invalid one or of nothing at all at the
/// border of the image only where the border itself is invalid.
pub(crate) fn erode(mask: &Mask, radius: usize) -> Mask {
    let (w, h) = (mask.width(), mask.height());
    let horizontal = Mask::from_fn(w, h, |x, y| {
        let row = mask.row(y);
        let range = x.saturating_sub(radius)..(x + radius + 1).min(w);
        row[range].iter().copied().min().unwrap_or(0)
    });
    Mask::from_fn(w, h, |x, y| {
        (y.saturating_sub(radius)..(y + radius + 1).min(h))
            .map(|yy| horizontal.at(x, yy))
            .min()
            .unwrap_or(0)
    })
}
