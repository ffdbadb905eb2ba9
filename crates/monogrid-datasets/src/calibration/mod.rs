//! Camera calibration files of this and other programs.
//!
//! [`Calibration::read`] recognises, by content:
//!
//! * our own TOML (see [`toml_format`](Calibration::to_toml) for an example);
//! * one line `fx fy cx cy [omega | k1 k2 p1 p2 [k3]] width height`, in pixels;
//! * a matrix K of three or four rows (ScanNet, 7-Scenes as others cut it; needs the size of the
//!   images);
//! * LSD-SLAM's and PTAM's files of four lines (5 relative numbers with the FOV model's omega, or 8
//!   numbers of OpenCV's model), and DSO's with a model name in front;
//! * YAML of EuRoC, Kalibr, ROS (`camera_info`, and a `CameraInfo` as `topic echo` prints it),
//!   OpenCV (also its XML), ORB-SLAM, stella and VINS, told apart by their keys; ROS' `ost.txt`;
//!   Basalt's JSON;
//! * COLMAP's `cameras.txt` and `cameras.bin` (the camera whose size is that of the images);
//! * KITTI's `calib.txt` (first projection matrix; needs the size of the images) and the
//!   `calib_cam_to_cam.txt` of its raw recordings.
//!
//! The centre of the top-left pixel is (0, 0) in the result. Formats with *relative* values count
//! from the corner of that pixel, so half a pixel is subtracted for them and only for them.

mod basalt;
mod cameras;
mod colmap;
mod document;
mod kitti;
mod lines;
mod pair;
mod photometric;
mod toml_format;

pub use pair::SecondCamera;
pub use photometric::{read_photometric, read_response, read_vignette};

use crate::DatasetError;
use crate::text::{data_lines, read_text};
use monogrid_geometry::{Camera, Distortion, Pinhole, Se3};
use std::path::{Path, PathBuf};

pub(crate) use cameras::sensor_yaml;
pub(crate) use lines::camera_from_numbers;

use document::Document;

/// A camera as read from a file, and how the file was understood.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The checked camera.
    pub camera: Camera,
    /// Pose of the camera in the body, where the file says it (EuRoC's `T_BS`).
    pub body_from_camera: Option<Se3>,
    /// Time from the first row to the last, ms, where the file says it.
    pub readout_ms: Option<f64>,
    /// Which format was recognised.
    pub format: &'static str,
    /// Remarks on how numbers were interpreted, in sentences for people.
    pub notes: Vec<String>,
    /// The file.
    pub path: PathBuf,
}

impl Calibration {
    /// Reads a calibration of any supported format.
    ///
    /// `image_size` (width, height) is used by formats that do not say the size, and to choose
    /// among several cameras.
    ///
    /// # Errors
    /// When the file cannot be read or understood, or its numbers are not those of a real camera.
    pub fn read(path: &Path, image_size: Option<(usize, usize)>) -> Result<Self, DatasetError> {
        let images = Images {
            size: image_size,
            folder: None,
        };
        Self::read_for(path, images)
    }

    /// Reads the calibration of these images.
    pub(crate) fn read_for(path: &Path, images: Images<'_>) -> Result<Self, DatasetError> {
        let text = match path.extension() {
            Some(extension) if extension.eq_ignore_ascii_case("bin") => colmap::read_binary(path)?,
            _ => read_text(path)?,
        };
        Self::parse_for(&text, path, images)
    }

    /// Parses the content of a calibration file; `path` is only for messages.
    ///
    /// # Errors
    /// As [`Calibration::read`].
    pub fn parse(
        text: &str,
        path: &Path,
        image_size: Option<(usize, usize)>,
    ) -> Result<Self, DatasetError> {
        let images = Images {
            size: image_size,
            folder: None,
        };
        Self::parse_for(text, path, images)
    }

    fn parse_for(text: &str, path: &Path, images: Images<'_>) -> Result<Self, DatasetError> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        let content = text.trim_start();
        let of_keys = |document: &Document| cameras::parse(document, path, images.size);
        let draft = match extension.as_deref() {
            Some("toml") => toml_format::parse(text, path)?,
            _ if content.starts_with('<') => of_keys(&Document::xml(text, path)?)?,
            _ if content.starts_with('{') => basalt::parse(text, path)?,
            Some("yaml" | "yml") => of_keys(&Document::yaml(text))?,
            _ if is_ost(text) => ost(text, path, images)?,
            _ if is_yaml(text) => of_keys(&Document::yaml(text))?,
            _ => lines::parse(text, path, images)?,
        };
        draft.check(path)
    }

    /// What the file says, in one line for people.
    #[must_use]
    pub fn interpretation(&self) -> String {
        let Camera {
            width,
            height,
            pinhole: Pinhole { fx, fy, cx, cy },
            distortion,
        } = self.camera;
        let model = match distortion {
            Distortion::None => "pinhole without distortion".to_owned(),
            other => {
                let value = |(name, value): &(_, f64)| format!("{name} = {value}");
                let values: Vec<String> = other.parameters().iter().map(value).collect();
                format!("{} ({})", other.name(), values.join(", "))
            }
        };
        let mut text = format!(
            "{}: {width}x{height} px, focal length ({fx:.2}, {fy:.2}) px, principal point \
             ({cx:.2}, {cy:.2}) px with the centre of the top-left pixel at (0, 0), {model}, \
             horizontal field of view {:.1} degrees",
            self.format,
            self.camera.horizontal_fov_deg()
        );
        if let Some(ms) = self.readout_ms {
            text.push_str(&format!("; rolling shutter of {ms} ms"));
        }
        for note in &self.notes {
            text.push_str("; ");
            text.push_str(note);
        }
        text
    }

    /// The camera in our own format, with the time from its first row to its last where it is
    /// known.
    #[must_use]
    pub fn to_toml(camera: &Camera, readout_ms: Option<f64>) -> String {
        toml_format::format(camera, readout_ms)
    }
}

/// The images that a calibration is wanted for.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Images<'a> {
    /// Width and height, px, where they are known.
    pub size: Option<(usize, usize)>,
    /// Name of the folder of this camera, where it tells cameras apart.
    pub folder: Option<&'a str>,
}

/// Whether a text has the sections of ROS' `ost.txt`.
fn is_ost(text: &str) -> bool {
    let mut lines = data_lines(text).map(|(_, line)| line);
    lines.any(|line| line == "camera matrix") && text.contains("[image]")
}

/// The camera of an `ost.txt`, which does not name the model of its lens.
fn ost(text: &str, path: &Path, images: Images<'_>) -> Result<Calibration, DatasetError> {
    let document = Document::ost(text);
    let lens = document.list(&["distortion"], path)?.unwrap_or_default();
    if lens.len() == 4 {
        let found = "4 coefficients (of a fisheye, or of another lens)";
        let expected = "5 or 8; the YAML file that was written beside it names the model";
        return Err(DatasetError::content(path, found, expected));
    }
    cameras::parse(&document, path, images.size)
}

/// Whether a text is one of keys in lines, and not one of KITTI's.
fn is_yaml(text: &str) -> bool {
    let first = text.lines().map(str::trim);
    let mut first = first.filter(|line| !line.is_empty() && !line.starts_with('#'));
    let Some(line) = first.next() else {
        return false;
    };
    let is_word = |key: &str| key.chars().all(|c| c.is_alphanumeric() || "_.".contains(c));
    let key = line.split_once(':').map(|(key, _)| key.trim());
    let has_key = key.is_some_and(is_word) && !kitti::has_labels(text);
    has_key || line.starts_with("%YAML") || line.starts_with("---")
}

/// The lens of a model of this name; see [`Distortion::from_name`].
fn lens(model: &str, coefficients: &[f64], path: &Path) -> Result<Distortion, DatasetError> {
    let lens = Distortion::from_name(model, coefficients);
    lens.map_err(|e| DatasetError::calibration(path, e.to_string()))
}

/// Times from the first row to the last that a sensor can take, ms; negative where the image is
/// upside down.
const READOUT_MS: std::ops::RangeInclusive<f64> = -100.0..=100.0;

impl Calibration {
    /// One that is not checked yet.
    fn draft(
        (width, height): (usize, usize),
        pinhole: Pinhole,
        distortion: Distortion,
        format: &'static str,
    ) -> Self {
        Self {
            camera: Camera {
                width,
                height,
                pinhole,
                distortion,
            },
            body_from_camera: None,
            readout_ms: None,
            format,
            notes: Vec::new(),
            path: PathBuf::new(),
        }
    }

    fn note(&mut self, remark: impl Into<String>) {
        self.notes.push(remark.into());
    }

    fn check(mut self, path: &Path) -> Result<Self, DatasetError> {
        if self.camera.pinhole.fy < 0.0 {
            // ICL-NUIM's fy = -480: its world is left-handed, the rows still run downwards
            self.camera.pinhole.fy = -self.camera.pinhole.fy;
            self.note(
                "fy was negative (a camera whose y axis points up); its absolute value is used \
                 with y down, so a reference trajectory in the other convention is mirrored",
            );
        }
        let valid = self.camera.validate();
        valid.map_err(|e| DatasetError::calibration(path, e.to_string()))?;
        if let Some(ms) = self.readout_ms.filter(|ms| !READOUT_MS.contains(ms)) {
            let expected = "expected -100 to 100 milliseconds from the first row to the last";
            let reason = format!("rolling_shutter_ms is {ms}, {expected}");
            return Err(DatasetError::calibration(path, reason));
        }
        self.path = path.to_path_buf();
        Ok(self)
    }
}

/// Four values of a pinhole, relative to the image size or in pixels, as DSO and LSD-SLAM decide
/// it: a principal point below 1 is relative.
///
/// Relative: `fx = width * fx'`, `cx = width * cx' - 0.5`, because the relative principal point
/// counts from the corner of the top-left pixel. Pixels are taken as they are.
fn relative_or_pixels(values: [f64; 4], (width, height): (usize, usize)) -> (Pinhole, bool) {
    let [fx, fy, cx, cy] = values;
    let relative = cx < 1.0 && cy < 1.0;
    if !relative {
        return (Pinhole::new(fx, fy, cx, cy), false);
    }
    let (w, h) = (width as f64, height as f64);
    let pinhole = Pinhole::new(fx * w, fy * h, cx * w - 0.5, cy * h - 0.5);
    (pinhole, true)
}

/// A size written as a number.
fn pixel_count(value: f64) -> Option<usize> {
    (value.fract() == 0.0 && (1.0..=1e6).contains(&value)).then_some(value as usize)
}

/// Radial-tangential with the first of k1, k2, p1, p2, k3, the others 0; without coefficients it is
/// a pinhole: nothing needs resampling then.
fn radial_tangential(coefficients: &[f64]) -> Distortion {
    let [k1, k2, p1, p2, k3] = std::array::from_fn(|i| coefficients.get(i).copied().unwrap_or(0.0));
    match coefficients.iter().all(|k| *k == 0.0) {
        true => Distortion::None,
        false => Distortion::RadialTangential { k1, k2, p1, p2, k3 },
    }
}

/// FOV model, or none for omega = 0 (already rectified).
fn fov(omega: f64) -> Distortion {
    match omega == 0.0 {
        true => Distortion::None,
        false => Distortion::Fov { omega },
    }
}
