//! Brightness of keyframes.

/// `I_keyframe = gain * I_first + bias`: brightness relative to the first keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Exposure {
    pub gain: f64,
    pub bias: f64,
}

impl Exposure {
    pub(crate) const NEUTRAL: Self = Self {
        gain: 1.0,
        bias: 0.0,
    };

    /// Exposure of a frame that is `gain * I_self + bias`.
    pub(crate) fn then(&self, gain: f64, bias: f64) -> Self {
        Self {
            gain: gain * self.gain,
            bias: gain * self.bias + bias,
        }
    }

    /// Gain and bias with `I_other = gain * I_self + bias`.
    pub(crate) fn relative(&self, other: &Self) -> (f64, f64) {
        let gain = other.gain / self.gain;
        (gain, other.bias - gain * self.bias)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_compose() {
        let a = Exposure {
            gain: 1.2,
            bias: 5.0,
        };
        let b = a.then(0.8, -3.0);
        let (gain, bias) = a.relative(&b);
        assert!((gain - 0.8).abs() < 1e-12 && (bias + 3.0).abs() < 1e-12);
    }
}
