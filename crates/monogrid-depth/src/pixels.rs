//! Reading the depth out.

use crate::DepthMap;
use monogrid_image::DepthPixel;

/// Which pixels are read out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelFilter {
    /// Smallest validity.
    pub min_validity: u8,
    /// Largest standard deviation relative to the inverse depth.
    pub max_relative_sigma: f32,
    /// Whether regularised values are read (LSD-SLAM) instead of the filter's own.
    pub smoothed: bool,
}

impl Default for PixelFilter {
    fn default() -> Self {
        Self {
            min_validity: 10,
            max_relative_sigma: f32::INFINITY,
            smoothed: false,
        }
    }
}

impl DepthMap {
    /// The known pixels that pass `filter`, in row-major order.
    pub fn pixels(&self, filter: PixelFilter) -> impl Iterator<Item = DepthPixel> + '_ {
        (0..self.host.height()).flat_map(move |y| {
            let row = self.candidates.row(y).iter();
            row.filter_map(move |&x| self.pixel(x, y, &filter))
        })
    }

    #[inline]
    fn pixel(&self, x: u16, y: usize, filter: &PixelFilter) -> Option<DepthPixel> {
        let i = y * self.host.width() + usize::from(x);
        let (idepth, idepth_var) = if filter.smoothed {
            (self.smooth_idepth[i], self.smooth_var[i])
        } else {
            (self.arrays.idepth[i], self.arrays.var[i])
        };
        let max_sigma = filter.max_relative_sigma * idepth;
        let good = self.arrays.var[i] > 0.0
            && idepth_var > 0.0
            && idepth > 0.0
            && self.arrays.validity[i] >= filter.min_validity
            && idepth_var <= max_sigma * max_sigma;
        good.then_some(DepthPixel {
            x,
            y: y as u16,
            idepth,
            idepth_var,
        })
    }
}
