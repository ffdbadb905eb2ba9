//! Image gradients.

use crate::{GrayImage, Image};

/// Central differences of a grey image, per pixel, zero on the border.
#[derive(Clone, Debug, Default)]
pub struct GradientImage {
    /// Horizontal derivative, grey levels per px.
    pub gx: Image<f32>,
    /// Vertical derivative, grey levels per px.
    pub gy: Image<f32>,
}

impl GradientImage {
    /// Halved central differences of `image`; the border of one pixel is zero.
    #[must_use]
    pub fn new(image: &GrayImage) -> Self {
        let (w, h) = (image.width(), image.height());
        let mut gx = Image::filled(w, h, 0.0);
        let mut gy = Image::filled(w, h, 0.0);
        for y in 1..h.saturating_sub(1) {
            let (above, row, below) = (image.row(y - 1), image.row(y), image.row(y + 1));
            let (out_x, out_y) = (gx.row_mut(y), gy.row_mut(y));
            for x in 1..w.saturating_sub(1) {
                out_x[x] = 0.5 * (row[x + 1] - row[x - 1]);
                out_y[x] = 0.5 * (below[x] - above[x]);
            }
        }
        Self { gx, gy }
    }

    /// Gradient magnitude per pixel.
    #[must_use]
    pub fn magnitude(&self) -> GrayImage {
        let (w, h) = (self.gx.width(), self.gx.height());
        let mut out = Image::filled(w, h, 0.0f32);
        for ((m, gx), gy) in out
            .as_mut_slice()
            .iter_mut()
            .zip(self.gx.as_slice())
            .zip(self.gy.as_slice())
        {
            *m = (gx * gx + gy * gy).sqrt();
        }
        out
    }
}

/// Largest gradient magnitude in the 3x3 neighbourhood of each pixel; zero on a border of two.
#[must_use]
pub fn max_gradient(gradient: &GradientImage) -> GrayImage {
    let magnitude = gradient.magnitude();
    let (w, h) = (magnitude.width(), magnitude.height());
    let mut vertical = Image::filled(w, h, 0.0f32);
    for y in 1..h.saturating_sub(1) {
        let (a, b, c) = (magnitude.row(y - 1), magnitude.row(y), magnitude.row(y + 1));
        for (x, out) in vertical.row_mut(y).iter_mut().enumerate() {
            *out = a[x].max(b[x]).max(c[x]);
        }
    }
    let mut output = Image::filled(w, h, 0.0f32);
    for y in 2..h.saturating_sub(2) {
        let row = vertical.row(y);
        let out = output.row_mut(y);
        for x in 2..w.saturating_sub(2) {
            out[x] = row[x - 1].max(row[x]).max(row[x + 1]);
        }
    }
    output
}
