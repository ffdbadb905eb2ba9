//! Vectors of 256 bits.
//!
//! Every function here has to become part of one that is compiled for AVX2, as
//! [`for_lanes`](crate::for_lanes) sees to: on its own it is a call for each operation.
#![allow(
    unsafe_code,
    reason = "instructions that not every processor has: there are no values of these types \
        without them"
)]

use super::{F32x8, I32x8, Lanes};
use std::arch::x86_64::*;
use std::ops::{Add, AddAssign, BitAnd, Div, Mul, Neg, Sub};

/// The vectors of AVX2, of a processor that has them.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(());

impl Avx2 {
    /// `None` where the processor does not have them.
    #[inline(always)]
    #[must_use]
    pub fn of_processor() -> Option<Self> {
        is_x86_feature_detected!("avx2").then_some(Self(()))
    }
}

/// Eight numbers in single precision. They come from [`Avx2`] only, so the processor has what works
/// on them.
#[derive(Clone, Copy, Debug)]
pub struct Floats(__m256);

/// Eight whole numbers, likewise.
#[derive(Clone, Copy, Debug)]
pub struct Integers(__m256i);

impl Lanes for Avx2 {
    type F32 = Floats;
    type I32 = Integers;

    #[inline(always)]
    fn f32s(self, values: &[f32; 8]) -> Floats {
        // SAFETY: an array of the same size, read from any address.
        Floats(unsafe { _mm256_loadu_ps(values.as_ptr()) })
    }

    #[inline(always)]
    fn i32s(self, values: &[i32; 8]) -> Integers {
        // SAFETY: an array of the same size, read from any address.
        Integers(unsafe { _mm256_loadu_si256(values.as_ptr().cast()) })
    }

    #[inline(always)]
    fn products(self, a: &[i16; 8], b: &[i16; 8]) -> Integers {
        // SAFETY: arrays of the same size, read from any address; the processor has AVX2.
        Integers(unsafe {
            let [a, b] = [a, b].map(|v| _mm256_cvtepi16_epi32(_mm_loadu_si128(v.as_ptr().cast())));
            _mm256_mullo_epi32(a, b)
        })
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Floats {
        // SAFETY: the processor has AVX2.
        Floats(unsafe { _mm256_set1_ps(value) })
    }
}

/// Operators of two vectors.
macro_rules! operators {
    ($vector:ident: $($trait:ident $method:ident $instruction:ident),*) => {$(
        impl $trait for $vector {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: the processor has AVX2.
                Self(unsafe { $instruction(self.0, other.0) })
            }
        }
    )*};
}

operators!(
    Floats:
    Add add _mm256_add_ps,
    Sub sub _mm256_sub_ps,
    Mul mul _mm256_mul_ps,
    Div div _mm256_div_ps,
    BitAnd bitand _mm256_and_ps
);
operators!(
    Integers:
    Add add _mm256_add_epi32,
    Sub sub _mm256_sub_epi32,
    BitAnd bitand _mm256_and_si256
);

/// Operators of a vector and a number: those of a vector that holds it.
macro_rules! operators_with_a_number {
    ($($trait:ident $method:ident),*) => {$(
        impl $trait<f32> for Floats {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: f32) -> Self {
                // there is a vector, so the processor has them
                $trait::$method(self, Avx2(()).splat(other))
            }
        }
    )*};
}

operators_with_a_number!(Add add, Sub sub, Mul mul, Div div);

impl AddAssign for Floats {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Neg for Floats {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: the processor has AVX2.
        Self(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
    }
}

/// Instructions that take two vectors of numbers.
macro_rules! with_another {
    ($($name:ident $instruction:expr),*) => {$(
        #[inline(always)]
        fn $name(self, other: Self) -> Self {
            // SAFETY: the processor has AVX2.
            Self(unsafe { $instruction(self.0, other.0) })
        }
    )*};
}

impl F32x8 for Floats {
    type I32 = Integers;

    #[inline(always)]
    fn to_array(self) -> [f32; 8] {
        let mut values = [0.0; 8];
        // SAFETY: an array of the same size, written at any address.
        unsafe { _mm256_storeu_ps(values.as_mut_ptr(), self.0) };
        values
    }

    with_another!(
        gt _mm256_cmp_ps::<_CMP_GT_OQ>,
        ge _mm256_cmp_ps::<_CMP_GE_OQ>,
        lt _mm256_cmp_ps::<_CMP_LT_OQ>,
        le _mm256_cmp_ps::<_CMP_LE_OQ>,
        min _mm256_min_ps,
        max _mm256_max_ps
    );

    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: the processor has AVX2.
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }

    #[inline(always)]
    fn select(self, set: Self, unset: Self) -> Self {
        // SAFETY: the processor has AVX2.
        Self(unsafe { _mm256_blendv_ps(unset.0, set.0, self.0) })
    }

    #[inline(always)]
    fn bits(self) -> u32 {
        // SAFETY: the processor has AVX2.
        (unsafe { _mm256_movemask_ps(self.0) }) as u32
    }

    #[inline(always)]
    fn truncated(self) -> Integers {
        // SAFETY: the processor has AVX2.
        Integers(unsafe { _mm256_cvttps_epi32(self.0) })
    }
}

impl I32x8 for Integers {
    type F32 = Floats;

    #[inline(always)]
    fn to_array(self) -> [i32; 8] {
        let mut values = [0; 8];
        // SAFETY: an array of the same size, written at any address.
        unsafe { _mm256_storeu_si256(values.as_mut_ptr().cast(), self.0) };
        values
    }

    #[inline(always)]
    fn shl<const BITS: i32>(self) -> Self {
        // SAFETY: the processor has AVX2.
        Self(unsafe { _mm256_slli_epi32::<BITS>(self.0) })
    }

    #[inline(always)]
    fn shr<const BITS: i32>(self) -> Self {
        // SAFETY: the processor has AVX2.
        Self(unsafe { _mm256_srai_epi32::<BITS>(self.0) })
    }

    #[inline(always)]
    fn to_f32(self) -> Floats {
        // SAFETY: the processor has AVX2.
        Floats(unsafe { _mm256_cvtepi32_ps(self.0) })
    }

    #[inline(always)]
    fn to_i16(self) -> [i16; 8] {
        let mut values = [0; 8];
        // SAFETY: the processor has AVX2; an array of the same size, written at any address.
        unsafe {
            let lower = _mm256_and_si256(self.0, _mm256_set1_epi32(0xffff));
            let [first, last] = [
                _mm256_castsi256_si128(lower),
                _mm256_extracti128_si256::<1>(lower),
            ];
            _mm_storeu_si128(values.as_mut_ptr().cast(), _mm_packus_epi32(first, last));
        }
        values
    }
}
