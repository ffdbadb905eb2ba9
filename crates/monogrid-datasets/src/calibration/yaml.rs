//! The few lines of YAML that EuRoC, Kalibr, ROS, ORB-SLAM and stella use for cameras.
//!
//! Not a YAML parser: keys with a scalar or a list of numbers (flow style over several lines, or one
//! dash per line), whatever their nesting. The first occurrence of a key counts, so the first camera
//! of a chain is read.

use super::{equidistant, fov, pixel_count, radial_tangential};
use crate::trajectory::pose_from_matrix;
use crate::{Calibration, DatasetError, ImuCalibration};
use monogrid_geometry::{Distortion, Pinhole, Se3};
use monogrid_inertial::ImuNoise;
use std::path::Path;

pub(super) fn parse(
    text: &str,
    path: &Path,
    size_of_images: Option<(usize, usize)>,
) -> Result<Calibration, DatasetError> {
    let yaml = Yaml { text };
    if let Some(slam) = SlamKeys::find(&yaml) {
        return slam.parse(path, size_of_images);
    }
    let size = image_size(&yaml).ok_or_else(|| {
        let expected = "resolution: [width, height], or image_width and image_height";
        DatasetError::content(path, "no image size", expected)
    })?;
    let pinhole = intrinsics(&yaml).ok_or_else(|| {
        let expected = "intrinsics: [fx, fy, cx, cy], or a camera_matrix of 9 numbers";
        DatasetError::content(path, "no intrinsics", expected)
    })?;
    if let Some(model) = yaml.scalar("camera_model").filter(|m| *m != "pinhole") {
        let (found, expected) = (
            format!("camera_model: {model}"),
            "pinhole (with any of the distortion models)",
        );
        return Err(DatasetError::content(path, found, expected));
    }
    let mut draft = Calibration::draft(size, pinhole, distortion(&yaml, path)?, "camera YAML");
    draft.body_from_camera = body_from_camera(&yaml);
    let mut lines = text.lines();
    if lines.any(|line| line.trim_start().starts_with("cam1:")) {
        draft.note("the first camera of the chain is used");
    }
    Ok(draft)
}

fn image_size(yaml: &Yaml) -> Option<(usize, usize)> {
    let (width, height) = match yaml.list("resolution").as_deref() {
        Some(&[width, height]) => (width, height),
        _ => (yaml.number("image_width")?, yaml.number("image_height")?),
    };
    Some((pixel_count(width)?, pixel_count(height)?))
}

fn intrinsics(yaml: &Yaml) -> Option<Pinhole> {
    if let Some(&[fx, fy, cx, cy]) = yaml.list("intrinsics").as_deref() {
        return Some(Pinhole::new(fx, fy, cx, cy));
    }
    let matrix = yaml.list("camera_matrix")?;
    (matrix.len() == 9).then(|| Pinhole::new(matrix[0], matrix[4], matrix[2], matrix[5]))
}

fn distortion(yaml: &Yaml, path: &Path) -> Result<Distortion, DatasetError> {
    let coefficients = yaml.list("distortion_coefficients");
    let coefficients = coefficients.or_else(|| yaml.list("distortion_coeffs"));
    let coefficients = coefficients.unwrap_or_default();
    let model = yaml.scalar("distortion_model");
    let model = model.unwrap_or("radial-tangential");
    Ok(match (model, coefficients.as_slice()) {
        (_, []) | ("none", _) => Distortion::None,
        ("radial-tangential" | "radtan" | "plumb_bob", lens) if matches!(lens.len(), 4 | 5) => {
            radial_tangential(lens)
        }
        ("equidistant" | "equi" | "fisheye", &[k1, k2, k3, k4]) => equidistant([k1, k2, k3, k4]),
        ("fov", &[omega]) => fov(omega),
        (model, values) => {
            let found = format!(
                "distortion_model {model} with {} coefficients",
                values.len()
            );
            let expected = "radial-tangential (4 or 5), equidistant (4) or fov (1)";
            return Err(DatasetError::content(path, found, expected));
        }
    })
}

/// EuRoC's `T_BS`: the sensor's pose in the body, 4x4 row-major.
fn body_from_camera(yaml: &Yaml) -> Option<Se3> {
    pose_from_matrix(&yaml.list("T_BS").filter(|m| m.len() == 16)?)
}

/// What EuRoC's `sensor.yaml` says of an inertial sensor: its pose in the body and its noise, as far as they are there.
pub(crate) fn sensor_yaml(text: &str) -> ImuCalibration {
    let yaml = Yaml { text };
    let positive = |key| yaml.number(key).filter(|value| *value > 0.0);
    let noise = || {
        Some(ImuNoise {
            gyroscope: positive("gyroscope_noise_density")?,
            accelerometer: positive("accelerometer_noise_density")?,
            gyroscope_walk: positive("gyroscope_random_walk")?,
            accelerometer_walk: positive("accelerometer_random_walk")?,
        })
    };
    ImuCalibration {
        noise: noise(),
        body_from_imu: body_from_camera(&yaml),
    }
}

/// The keys of ORB-SLAM (`Camera.fx`, version 3 `Camera1.fx`) or stella (`fx` below `Camera:`).
struct SlamKeys<'a> {
    yaml: &'a Yaml<'a>,
    /// In front of the intrinsics, and in front of the rest.
    prefixes: [&'static str; 2],
}

impl<'a> SlamKeys<'a> {
    fn find(yaml: &'a Yaml<'a>) -> Option<Self> {
        let candidates = [["Camera.", "Camera."], ["Camera1.", "Camera."], ["", ""]];
        let fits = |[prefix, _]: &[&str; 2]| yaml.number(&format!("{prefix}fx")).is_some();
        let prefixes = candidates.into_iter().find(fits)?;
        Some(Self { yaml, prefixes })
    }

    fn intrinsic(&self, key: &str) -> Option<f64> {
        self.yaml.number(&format!("{}{key}", self.prefixes[0]))
    }

    fn size(&self) -> Option<(usize, usize)> {
        let side = |keys: [&str; 2]| {
            let number = |key| self.yaml.number(&format!("{}{key}", self.prefixes[1]));
            keys.into_iter().find_map(number).and_then(pixel_count)
        };
        Some((side(["width", "cols"])?, side(["height", "rows"])?))
    }

    /// Pinhole with radial-tangential distortion, or the fisheye model of Kannala and Brandt.
    fn parse(
        &self,
        path: &Path,
        size_of_images: Option<(usize, usize)>,
    ) -> Result<Calibration, DatasetError> {
        let incomplete = || {
            let found = "a camera of ORB-SLAM or stella without one of its numbers";
            let expected = "fx, fy, cx, cy and the size (width and height, or cols and rows)";
            DatasetError::content(path, found, expected)
        };
        let required = |key| self.intrinsic(key).ok_or_else(incomplete);
        let (fx, fy) = (required("fx")?, required("fy")?);
        let pinhole = Pinhole::new(fx, fy, required("cx")?, required("cy")?);
        let size = self.size().or(size_of_images).ok_or_else(incomplete)?;
        let k = |key| self.intrinsic(key).unwrap_or(0.0);
        let mut keys = ["Camera.type", "model", "Camera.model"].iter();
        let model = keys.find_map(|key| self.yaml.scalar(key));
        let model = model.unwrap_or("PinHole").to_ascii_lowercase();
        let distortion = match model.as_str() {
            "pinhole" | "perspective" | "rectified" => {
                radial_tangential(&["k1", "k2", "p1", "p2", "k3"].map(k))
            }
            "kannalabrandt8" | "fisheye" => equidistant(["k1", "k2", "k3", "k4"].map(k)),
            _ => {
                let found = format!("camera model {model}");
                let expected =
                    "PinHole or KannalaBrandt8 (ORB-SLAM), perspective or fisheye (stella)";
                return Err(DatasetError::content(path, found, expected));
            }
        };
        let format = "camera YAML of ORB-SLAM or stella";
        Ok(Calibration::draft(size, pinhole, distortion, format))
    }
}

struct Yaml<'a> {
    text: &'a str,
}

impl<'a> Yaml<'a> {
    /// Everything after the first `key:` that starts a line.
    fn after(&self, key: &str) -> Option<&'a str> {
        let mut offset = 0;
        for line in self.text.split_inclusive('\n') {
            let rest = line.trim_start();
            let rest = rest.strip_prefix("- ").unwrap_or(rest);
            let after_key = rest.strip_prefix(key).map(str::trim_start);
            if let Some(value) = after_key.and_then(|rest| rest.strip_prefix(':')) {
                return Some(&self.text[offset + line.len() - value.len()..]);
            }
            offset += line.len();
        }
        None
    }

    /// The text on the line of a key, without comment and quotes.
    fn scalar(&self, key: &str) -> Option<&'a str> {
        let line = self.after(key)?.lines().next()?;
        let value = line.split('#').next()?.trim().trim_matches(['"', '\'']);
        (!value.is_empty()).then_some(value)
    }

    fn number(&self, key: &str) -> Option<f64> {
        self.scalar(key)?.parse().ok()
    }

    /// The list of numbers of a key, or of the `data:` below it.
    fn list(&self, key: &str) -> Option<Vec<f64>> {
        let rest = self.after(key)?;
        let lines = rest.lines().map(|l| l.split('#').next().unwrap_or(""));
        let without_comments: String = lines.flat_map(|l| [l, "\n"]).collect();
        let rest = without_comments.trim_start();
        let own_list = rest.starts_with('[') || rest.starts_with('-');
        let below = Yaml { text: rest };
        let body = if own_list {
            rest
        } else {
            below.after("data")?.trim_start()
        };
        if let Some(flow) = body.strip_prefix('[') {
            let items = flow[..flow.find(']')?].split(',').map(str::trim);
            let items = items.filter(|item| !item.is_empty());
            return items.map(|item| item.parse().ok()).collect();
        }
        // block style: leading lines `- number`
        let value = |line: &str| line.trim().strip_prefix('-')?.trim().parse().ok();
        let values: Vec<f64> = body.lines().map_while(value).collect();
        (!values.is_empty()).then_some(values)
    }
}
