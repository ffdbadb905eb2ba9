//! Photometric calibration as TUM monoVO keeps it: `pcalib.txt` and `vignette.png`.

use crate::text::{numbers, read_text};
use crate::{DatasetError, read_gray};
use monogrid_image::{GrayImage, Photometric};
use std::path::Path;

/// The 256 values of the inverse response in `pcalib.txt` (one line, or one value per line).
///
/// # Errors
/// When the file cannot be read or does not hold 256 numbers.
pub fn read_response(path: &Path) -> Result<Vec<f64>, DatasetError> {
    let text = read_text(path)?.replace(['\n', '\r'], " ");
    let values = numbers(text.trim()).ok_or_else(|| {
        DatasetError::content(path, "something that is not a number", "256 numbers")
    })?;
    if values.len() != 256 || values.iter().any(|v| !v.is_finite()) {
        let found = format!("{} numbers", values.len());
        let expected = "256 finite numbers, the inverse response per grey level";
        return Err(DatasetError::content(path, found, expected));
    }
    Ok(values)
}

/// The vignette: light that reaches each pixel, brightest = all of it; 8 or 16 bits.
///
/// # Errors
/// When the image cannot be read or is black.
pub fn read_vignette(path: &Path) -> Result<GrayImage, DatasetError> {
    let image = read_gray(path)?;
    if image.as_slice().iter().all(|&v| v <= 0.0) {
        return Err(DatasetError::image(path, "the vignette is black"));
    }
    Ok(image)
}

/// The correction from either file or both.
///
/// # Errors
/// As [`read_response`] and [`read_vignette`], and when the response falls.
pub fn read_photometric(
    response_path: Option<&Path>,
    vignette_path: Option<&Path>,
) -> Result<Photometric, DatasetError> {
    let response = response_path.map(read_response).transpose()?;
    let vignette = vignette_path.map(read_vignette).transpose()?;
    Photometric::try_new(response.as_deref(), vignette.as_ref()).map_err(|e| {
        let path = response_path.or(vignette_path).unwrap_or(Path::new(""));
        DatasetError::calibration(path, e.to_string())
    })
}
