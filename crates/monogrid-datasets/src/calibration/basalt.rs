//! Basalt's calibration: JSON with a list of cameras, each with the name of its model.

use super::{lens, pixel_count};
use crate::{Calibration, DatasetError};
use monogrid_geometry::{Distortion, Pinhole};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Deserialize)]
struct File {
    value0: Cameras,
}

#[derive(Deserialize)]
struct Cameras {
    intrinsics: Vec<Camera>,
    resolution: Vec<[f64; 2]>,
}

#[derive(Deserialize)]
struct Camera {
    camera_type: String,
    intrinsics: BTreeMap<String, f64>,
}

/// The first camera.
pub(super) fn parse(text: &str, path: &Path) -> Result<Calibration, DatasetError> {
    let expected = "Basalt's value0 with intrinsics (camera_type, intrinsics) and resolution";
    let wrong = |found: String| DatasetError::content(path, found, expected);
    let file: File = serde_json::from_str(text).map_err(|e| wrong(e.to_string()))?;
    let cameras = file.value0;
    let first = cameras.intrinsics.first().zip(cameras.resolution.first());
    let (camera, [width, height]) = first.ok_or_else(|| wrong("no camera".to_owned()))?;
    let size = pixel_count(*width).zip(pixel_count(*height));
    let size = size.ok_or_else(|| wrong(format!("a resolution of {width} x {height}")))?;
    let number = |key: &str| {
        let value = camera.intrinsics.get(key).copied();
        value.ok_or_else(|| {
            wrong(format!(
                "a camera of type {} without {key}",
                camera.camera_type
            ))
        })
    };
    let all = |keys: &[&str]| {
        keys.iter()
            .map(|key| number(key))
            .collect::<Result<Vec<_>, _>>()
    };
    let kind = camera.camera_type.as_str();
    let distortion = match kind {
        "pinhole" => Distortion::None,
        "kb4" => lens(kind, &all(&["k1", "k2", "k3", "k4"])?, path)?,
        "ds" => lens(kind, &all(&["xi", "alpha"])?, path)?,
        "eucm" => lens(kind, &all(&["alpha", "beta"])?, path)?,
        // the unified model is the extended one with a beta of 1
        "ucm" => lens("eucm", &[number("alpha")?, 1.0], path)?,
        "fov" => lens(kind, &all(&["w"])?, path)?,
        "pinhole-radtan8" => lens(kind, &all(&RADTAN8)?, path)?,
        other => lens(other, &[], path)?,
    };
    let pinhole = Pinhole::new(number("fx")?, number("fy")?, number("cx")?, number("cy")?);
    let mut draft = Calibration::draft(size, pinhole, distortion, "calibration of Basalt");
    if cameras.intrinsics.len() > 1 {
        draft.note("the first camera of the chain is used");
    }
    Ok(draft)
}

const RADTAN8: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
