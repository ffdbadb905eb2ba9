//! Photometric correction: inverse camera response and vignette, as calibrated for TUM monoVO.

use crate::GrayImage;

/// What is wrong with a photometric calibration.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum PhotometricError {
    /// Wrong number of values in the response.
    #[error("inverse response has {found} values, expected 256 (one per grey level)")]
    ResponseLength {
        /// Values found.
        found: usize,
    },
    /// The response is not increasing.
    #[error(
        "inverse response falls or is not a number at grey level {level}, expected 256 values that \
         never decrease"
    )]
    NotMonotonic {
        /// First offending level.
        level: usize,
    },
    /// The response is the same everywhere.
    #[error("inverse response is {value} at every grey level, expected values that rise")]
    Constant {
        /// The one value.
        value: f64,
    },
    /// The vignette has another size than the images.
    #[error("vignette is {found:?} pixels, the images are {expected:?}")]
    VignetteSize {
        /// Width and height of the vignette.
        found: (usize, usize),
        /// Width and height of the images.
        expected: (usize, usize),
    },
}

/// Inverse response and vignette of a camera; corrects raw images to irradiance in [0, 255].
#[derive(Clone, Debug, Default)]
pub struct Photometric {
    inverse_response: Option<Vec<f32>>,
    inverse_vignette: Option<GrayImage>,
}

impl Photometric {
    /// A correction from 256 increasing irradiances and an attenuation image (maximum = no
    /// attenuation), either of which may be absent.
    ///
    /// # Errors
    /// When the response has another length or falls.
    pub fn try_new(
        inverse_response: Option<&[f64]>,
        vignette: Option<&GrayImage>,
    ) -> Result<Self, PhotometricError> {
        let inverse_response = match inverse_response {
            None => None,
            Some(values) => Some(normalised_response(values)?),
        };
        let inverse_vignette = vignette.map(|image| {
            let max = image.as_slice().iter().copied().fold(1e-6f32, f32::max);
            // A pixel that receives less than 5 % of the light is noise, not signal.
            image.map(|v| max / v.max(0.05 * max))
        });
        Ok(Self {
            inverse_response,
            inverse_vignette,
        })
    }

    /// Whether nothing would change.
    #[must_use]
    pub fn is_identity(&self) -> bool {
        self.inverse_response.is_none() && self.inverse_vignette.is_none()
    }

    /// Corrects a raw image in place.
    ///
    /// # Errors
    /// When the vignette has another size.
    pub fn apply(&self, image: &mut GrayImage) -> Result<(), PhotometricError> {
        if let Some(response) = &self.inverse_response {
            for value in image.as_mut_slice() {
                let position = value.clamp(0.0, 255.0);
                let index = (position as usize).min(254);
                let fraction = position - index as f32;
                *value = response[index] + fraction * (response[index + 1] - response[index]);
            }
        }
        if let Some(vignette) = &self.inverse_vignette {
            if !vignette.same_size(image) {
                return Err(PhotometricError::VignetteSize {
                    found: (vignette.width(), vignette.height()),
                    expected: (image.width(), image.height()),
                });
            }
            for (value, gain) in image.as_mut_slice().iter_mut().zip(vignette.as_slice()) {
                *value *= gain;
            }
        }
        Ok(())
    }
}

/// Scales the response to [0, 255] and checks that it never falls.
fn normalised_response(values: &[f64]) -> Result<Vec<f32>, PhotometricError> {
    if values.len() != 256 {
        return Err(PhotometricError::ResponseLength {
            found: values.len(),
        });
    }
    let is_wrong = |&i: &usize| !values[i].is_finite() || (i > 0 && values[i] < values[i - 1]);
    if let Some(level) = (0..256).find(is_wrong) {
        return Err(PhotometricError::NotMonotonic { level });
    }
    let (low, range) = (values[0], values[255] - values[0]);
    if range <= 0.0 {
        return Err(PhotometricError::Constant { value: low });
    }
    Ok(values
        .iter()
        .map(|v| (255.0 * (v - low) / range) as f32)
        .collect())
}
