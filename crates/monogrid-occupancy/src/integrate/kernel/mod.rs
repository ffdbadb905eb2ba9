//! The innermost loop of the rule `fused`: evidence for the cells of a brick from one range image.
//!
//! [`scalar`] defines the result; `kernel_avx2` computes the same bits eight cells at a time.

#[cfg(target_arch = "x86_64")]
mod block_avx2;
#[cfg(target_arch = "x86_64")]
mod holes_avx2;
#[cfg(target_arch = "x86_64")]
mod kernel_avx2;
pub(crate) mod kernel_image;
pub(crate) mod scalar;

use crate::integrate::kernel::scalar::{Kernel, Placed, Weights};
use crate::integrate::octants::Octants;
use crate::key::BRICK_CELLS;

impl Kernel<'_> {
    /// Writes the evidence for the cells of the octants of a brick that are touched; 0 where the
    /// scan says nothing.
    #[inline]
    pub(crate) fn brick(
        &self,
        brick: &Placed,
        weights: &Weights,
        octants: Octants,
        cells: &mut [i16; BRICK_CELLS],
    ) {
        #[cfg(target_arch = "x86_64")]
        if kernel_avx2::brick(self, brick, weights, octants, cells) {
            return;
        }
        self.brick_scalar(brick, weights, octants, cells);
    }
}
