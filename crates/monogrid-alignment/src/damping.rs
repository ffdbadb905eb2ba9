//! What both solvers have in common: the damping of Levenberg and Marquardt, and the scale of the
//! residuals.

/// Damping below which there is none.
pub(crate) const MIN_LAMBDA: f64 = 1e-3;
/// Damping after the first step that made the cost larger.
pub(crate) const FIRST_LAMBDA: f64 = 0.05;
/// Factor of the damping after a step that made it smaller.
pub(crate) const LESS: f64 = 0.25;
/// Keeps the factorisation possible where nothing constrains an unknown.
pub(crate) const DIAGONAL_FLOOR: f64 = 1e-9;
/// Least and largest scale of the residuals, in units of the assumed noise. Below a tenth they are
/// those of a rendered image: a smaller scale would only make the weights reject everything.
pub(crate) const SCALES: [f32; 2] = [0.1, 20.0];
/// Changes of the scale by less than this share change no weights.
pub(crate) const MIN_SCALE_CHANGE: f32 = 0.05;
/// Points whose depth becomes less than this share of what it was are not visible.
pub(crate) const MIN_DEPTH_RATIO: f32 = 0.01;

/// The damping after a step that made the cost smaller.
pub(crate) fn less(lambda: f64) -> f64 {
    if lambda < MIN_LAMBDA {
        0.0
    } else {
        lambda * LESS
    }
}
