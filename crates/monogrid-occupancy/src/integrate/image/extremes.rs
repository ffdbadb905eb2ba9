//! The smaller and the larger of two numbers, without a branch.

/// The smaller of two, as the vector instructions choose it: the second where they cannot be
/// compared.
#[inline]
pub(crate) fn lower(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger of two, likewise.
#[inline]
pub(crate) fn higher(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}
