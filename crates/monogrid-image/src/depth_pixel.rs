//! A pixel whose depth is known.

/// Inverse depth of one pixel of an image, and how uncertain it is; u is the unit of length of
/// whoever has it, of a keyframe most often.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthPixel {
    /// Column, px.
    pub x: u16,
    /// Row, px.
    pub y: u16,
    /// Inverse depth along the optical axis, 1/u.
    pub idepth: f32,
    /// Its variance, 1/u².
    pub idepth_var: f32,
}
