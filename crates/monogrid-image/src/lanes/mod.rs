//! Eight numbers side by side, on vectors as wide as the processor has them.
//!
//! A loop is written once, over [`Lanes`], and compiled twice by [`for_lanes`](crate::for_lanes):
//! for what every processor of the target has ([`Baseline`]) and for AVX2. Both give the same bits:
//! the operations are those of IEEE in the order in which they are written, and none are joined.
//! There is none for AVX-512: a whole program that is compiled for it takes as long as one for
//! AVX2.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod bilinear;

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;
pub use bilinear::{Grey, bilinear};
use std::fmt::Debug;
use std::ops::{Add, AddAssign, BitAnd, Div, Mul, Neg, Sub};
use wide::{f32x8, i16x8, i32x8};

/// Numbers that are side by side.
pub const LANES: usize = 8;

/// A kind of vectors of eight. A value of it says that the processor has them.
pub trait Lanes: Copy + Debug {
    /// Eight numbers in single precision.
    type F32: F32x8<I32 = Self::I32>;
    /// Eight whole numbers of 32 bits.
    type I32: I32x8<F32 = Self::F32>;

    /// Eight numbers. By reference: reading an array that was copied just before waits for the
    /// copy.
    fn f32s(self, values: &[f32; 8]) -> Self::F32;
    /// Eight whole numbers.
    fn i32s(self, values: &[i32; 8]) -> Self::I32;
    /// The products of numbers of 16 bits, which are exact.
    fn products(self, a: &[i16; 8], b: &[i16; 8]) -> Self::I32;

    /// Eight times the same number.
    #[inline(always)]
    fn splat(self, value: f32) -> Self::F32 {
        self.f32s(&[value; 8])
    }
}

/// Eight numbers in single precision. Masks are such numbers too, with all bits of a lane set or
/// none.
pub trait F32x8:
    Copy
    + Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + BitAnd<Output = Self>
    + Add<f32, Output = Self>
    + Sub<f32, Output = Self>
    + Mul<f32, Output = Self>
    + Div<f32, Output = Self>
    + AddAssign
{
    /// The whole numbers that belong to them.
    type I32: I32x8;

    /// The numbers one by one.
    fn to_array(self) -> [f32; 8];
    /// Where they are greater than others; not where one is no number.
    fn gt(self, other: Self) -> Self;
    /// Where they are at least as great.
    fn ge(self, other: Self) -> Self;
    /// Where they are less.
    fn lt(self, other: Self) -> Self;
    /// Where they are at most as great.
    fn le(self, other: Self) -> Self;
    /// The lesser ones. Where one is no number, or both are zeros: the other ones on x86, not
    /// specified elsewhere.
    fn min(self, other: Self) -> Self;
    /// The greater ones, likewise.
    fn max(self, other: Self) -> Self;
    /// Square roots.
    fn sqrt(self) -> Self;
    /// Of a mask: one number where it is set, the other elsewhere.
    fn select(self, set: Self, unset: Self) -> Self;
    /// Of a mask: a bit for each lane, the first one lowest.
    fn bits(self) -> u32;
    /// Whole numbers, towards zero; whatever beyond their range.
    fn truncated(self) -> Self::I32;

    /// The sum of the first four and that of the last four, in their order, added.
    #[inline(always)]
    fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.to_array();
        (((a + b) + c) + d) + (((e + f) + g) + h)
    }
}

/// Eight whole numbers of 32 bits.
pub trait I32x8:
    Copy + Debug + Add<Output = Self> + Sub<Output = Self> + BitAnd<Output = Self>
{
    /// The numbers in single precision that belong to them.
    type F32;

    /// The numbers one by one.
    fn to_array(self) -> [i32; 8];
    /// Shifted to the left, by less than 32.
    fn shl<const BITS: i32>(self) -> Self;
    /// Shifted to the right, with the sign, by less than 32.
    fn shr<const BITS: i32>(self) -> Self;
    /// In single precision.
    fn to_f32(self) -> Self::F32;
    /// Their lower 16 bits.
    fn to_i16(self) -> [i16; 8];
}

/// The vectors that every processor of the target has.
#[derive(Clone, Copy, Debug)]
pub struct Baseline;

impl Lanes for Baseline {
    type F32 = f32x8;
    type I32 = i32x8;

    #[inline(always)]
    fn f32s(self, values: &[f32; 8]) -> f32x8 {
        f32x8::new(*values)
    }

    #[inline(always)]
    fn i32s(self, values: &[i32; 8]) -> i32x8 {
        i32x8::new(*values)
    }

    #[inline(always)]
    fn products(self, a: &[i16; 8], b: &[i16; 8]) -> i32x8 {
        i16x8::new(*a).widening_mul(i16x8::new(*b))
    }
}

/// What `wide` does with two vectors, by the names that it has here.
macro_rules! with_another {
    ($($name:ident $wide:ident),*) => {$(
        #[inline(always)]
        fn $name(self, other: Self) -> Self {
            self.$wide(other)
        }
    )*};
}

impl F32x8 for f32x8 {
    type I32 = i32x8;

    #[inline(always)]
    fn to_array(self) -> [f32; 8] {
        f32x8::to_array(self)
    }

    with_another!(gt simd_gt, ge simd_ge, lt simd_lt, le simd_le, min fast_min, max fast_max);

    #[inline(always)]
    fn sqrt(self) -> Self {
        f32x8::sqrt(self)
    }

    #[inline(always)]
    fn select(self, set: Self, unset: Self) -> Self {
        self.bitselect(set, unset)
    }

    #[inline(always)]
    fn bits(self) -> u32 {
        self.to_bitmask()
    }

    #[inline(always)]
    fn truncated(self) -> i32x8 {
        self.fast_trunc_int()
    }
}

impl I32x8 for i32x8 {
    type F32 = f32x8;

    #[inline(always)]
    fn to_array(self) -> [i32; 8] {
        i32x8::to_array(self)
    }

    #[inline(always)]
    fn shl<const BITS: i32>(self) -> Self {
        self << BITS
    }

    #[inline(always)]
    fn shr<const BITS: i32>(self) -> Self {
        self >> BITS
    }

    #[inline(always)]
    fn to_f32(self) -> f32x8 {
        f32x8::from_i32x8(self)
    }

    #[inline(always)]
    fn to_i16(self) -> [i16; 8] {
        i16x8::from_i32x8_truncate(self).to_array()
    }
}

/// Defines functions that run others on the widest vectors of the processor:
/// `fn name = other, (argument: Type, ...) -> Returned;`. The other one takes
/// [`Lanes`](crate::lanes::Lanes) before these arguments, is generic over them, and
/// `#[inline(always)]`, as all that it calls in loops; where the compiler makes the vectors it need
/// not look at them.
#[macro_export]
macro_rules! for_lanes {
    ($(
        $(#[$doc:meta])*
        $vis:vis fn $name:ident = $with:path,
        ($($argument:ident: $type:ty),* $(,)?) $(-> $returned:ty)?;
    )*) => {$(
        $(#[$doc])*
        #[inline]
        $vis fn $name($($argument: $type),*) $(-> $returned)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn on_avx2(lanes: $crate::lanes::Avx2, $($argument: $type),*) $(-> $returned)? {
                    $with(lanes, $($argument),*)
                }
                if let Some(lanes) = $crate::lanes::Avx2::of_processor() {
                    // SAFETY: the processor has AVX2, or there would be no lanes of it.
                    #[allow(unsafe_code, reason = "the processor was asked")]
                    return unsafe { on_avx2(lanes, $($argument),*) };
                }
            }
            $with($crate::lanes::Baseline, $($argument),*)
        }
    )*};
}

#[cfg(test)]
mod tests;
