//! Our own calibration format.
//!
//! ```toml
//! width = 640                      # pixels
//! height = 480
//! model = "radial-tangential"      # "pinhole" (default), or a name of `Distortion::from_name`
//! units = "pixels"                 # of fx, fy, cx, cy: "pixels" or "relative" to width and height
//! pixel_center = "integer"         # centre of the first pixel: "integer" is 0, "half" is 0.5
//! fx = 458.654
//! fy = 457.296
//! cx = 367.215
//! cy = 248.375
//! # in the order of `Distortion::parameters`
//! distortion = [-0.28, 0.07, 0.0002, 0.00002, 0.0]
//! rolling_shutter_ms = 24.5        # from the first row to the last; not with a global shutter
//! ```

use super::lens;
use crate::{Calibration, DatasetError};
use monogrid_geometry::{Camera, Pinhole};
use serde::Deserialize;
use std::fmt::Write;
use std::path::Path;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    width: usize,
    height: usize,
    #[serde(default = "pinhole")]
    model: String,
    #[serde(default)]
    units: Units,
    #[serde(default)]
    pixel_center: PixelCenter,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    distortion: Vec<f64>,
    rolling_shutter_ms: Option<f64>,
}

fn pinhole() -> String {
    "pinhole".to_owned()
}

#[derive(Deserialize, Default, Clone, Copy, PartialEq)]
#[serde(rename_all = "kebab-case")]
enum Units {
    #[default]
    Pixels,
    Relative,
}

#[derive(Deserialize, Default, Clone, Copy, PartialEq)]
#[serde(rename_all = "kebab-case")]
enum PixelCenter {
    #[default]
    Integer,
    Half,
}

pub(super) fn parse(text: &str, path: &Path) -> Result<Calibration, DatasetError> {
    let file: File = toml::from_str(text)
        .map_err(|e| DatasetError::calibration(path, e.to_string().trim_end().to_owned()))?;
    let (scale_x, scale_y) = match file.units {
        Units::Pixels => (1.0, 1.0),
        Units::Relative => (file.width as f64, file.height as f64),
    };
    let shift = match file.pixel_center {
        PixelCenter::Integer => 0.0,
        PixelCenter::Half => 0.5,
    };
    let pinhole = Pinhole::new(
        file.fx * scale_x,
        file.fy * scale_y,
        file.cx * scale_x - shift,
        file.cy * scale_y - shift,
    );
    let distortion = lens(&file.model, &file.distortion, path)?;
    let size = (file.width, file.height);
    let mut draft = Calibration::draft(size, pinhole, distortion, "calibration.toml");
    draft.readout_ms = file.rolling_shutter_ms;
    if file.units == Units::Relative {
        draft.note("values are relative to the image size");
    }
    if file.pixel_center == PixelCenter::Half {
        draft.note("pixel centres at .5: half a pixel was subtracted from the principal point");
    }
    Ok(draft)
}

/// The camera in this format, in pixels.
pub(super) fn format(camera: &Camera, readout_ms: Option<f64>) -> String {
    let Pinhole { fx, fy, cx, cy } = camera.pinhole;
    let mut text = format!(
        "width = {}\nheight = {}\nmodel = \"{}\"\nunits = \"pixels\"\npixel_center = \"integer\"\n\
         fx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\n",
        camera.width,
        camera.height,
        camera.distortion.name(),
    );
    let parameters = camera.distortion.parameters();
    let values = parameters.iter().map(|(_, value)| format!("{value:?}"));
    let values: Vec<String> = values.collect();
    if !values.is_empty() {
        // writing into a string cannot fail
        let _ = writeln!(text, "distortion = [{}]", values.join(", "));
    }
    if let Some(ms) = readout_ms {
        let _ = writeln!(text, "rolling_shutter_ms = {ms:?}");
    }
    text
}
