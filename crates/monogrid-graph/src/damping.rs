//! Levenberg-Marquardt damping after Nielsen, *Damping Parameter in Marquardt's Method*, 1999.

/// Damping factor, driven by how much of the predicted decrease came true.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Damping {
    pub(crate) lambda: f64,
    growth: f64,
}

/// Below this the damping does not change a double-precision solution.
const MIN_LAMBDA: f64 = 1e-12;
/// Beyond this a step is nothing but rounding.
const MAX_LAMBDA: f64 = 1e12;

impl Damping {
    pub(crate) fn new(lambda: f64) -> Self {
        Self {
            lambda,
            growth: 2.0,
        }
    }

    /// After a step that lowered the true cost by `gain` times the prediction.
    pub(crate) fn accept(&mut self, gain: f64) {
        let factor = (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(1.0 / 10.0, 2.0);
        self.lambda = (self.lambda * factor).max(MIN_LAMBDA);
        self.growth = 2.0;
    }

    /// After a step that did not lower the true cost, or could not be computed. Returns whether it
    /// is worth trying again.
    pub(crate) fn reject(&mut self) -> bool {
        self.lambda *= self.growth;
        self.growth *= 2.0;
        self.lambda < MAX_LAMBDA
    }
}
