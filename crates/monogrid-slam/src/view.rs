//! A keyframe as others see it: its image, brightness and points, which do not change.

use crate::KeyframeCamera;
use crate::KeyframeId;
use crate::store::{Kept, Store};
use monogrid_alignment::DepthPixel;
use monogrid_image::{GrayImage, Image, Pyramid, to_gray8};
use std::sync::Arc;

/// Levels of all pyramids.
pub(crate) const NUM_LEVELS: usize = 5;

/// The image of a keyframe, in eight bits.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeImage {
    size: (usize, usize),
    grey: Kept<Image<u8>>,
    pyramid: Kept<Pyramid>,
}

/// Brightness of a keyframe: `I_keyframe = gain * I_first + bias`, relative to the first keyframe.
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

/// A keyframe as it was when tracking left it: image, points and brightness. Shared with the graph.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub id: KeyframeId,
    /// Camera of its image.
    pub camera: KeyframeCamera,
    pub image: KeyframeImage,
    /// Depth in the keyframe's units.
    pub samples: Kept<Vec<DepthPixel>>,
    pub exposure: Exposure,
    /// Whether its shape and scale can be relied on: not so the first keyframes of a random start.
    pub has_converged: bool,
}

impl KeyframeImage {
    /// An image that is kept, rounded.
    pub(crate) fn new(store: &Store, image: &GrayImage) -> Self {
        let grey = store.keep(image.map(to_gray8));
        let of_pyramid = grey.clone();
        Self {
            size: (image.width(), image.height()),
            grey,
            pyramid: store.derive(move || {
                let image = of_pyramid.get()?.map(f32::from);
                Some(Pyramid::new(image, NUM_LEVELS))
            }),
        }
    }

    /// Width and height, px.
    pub(crate) fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The image; `None` where it cannot be read back.
    pub(crate) fn grey(&self) -> Option<Image<u8>> {
        Some(Image::clone(&*self.grey.get()?))
    }

    /// Its pyramid; `None` where it cannot be read back.
    pub(crate) fn pyramid(&self) -> Option<Arc<Pyramid>> {
        self.pyramid.get()
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
