//! Cameras by the keys that programs give them: EuRoC, Kalibr, ROS, OpenCV, ORB-SLAM, stella, VINS.

use super::document::Document;
use super::{lens, pixel_count};
use crate::trajectory::pose_from_matrix;
use crate::{Calibration, DatasetError, ImuCalibration};
use monogrid_geometry::{Distortion, Pinhole, Se3};
use monogrid_inertial::ImuNoise;
use std::path::Path;

/// The camera that a file describes, for images of this size where it says none.
pub(super) fn parse(
    document: &Document,
    path: &Path,
    size_of_images: Option<(usize, usize)>,
) -> Result<Calibration, DatasetError> {
    let chain = |key: &&str| key.starts_with("cam") && key[3..].parse::<u32>().is_ok();
    let chained: Vec<&str> = document.top().filter(chain).collect();
    let first = chained.first().and_then(|first| document.below(first));
    let file = File {
        document: first.as_ref().unwrap_or(document),
        path,
        size_of_images,
    };
    let mut draft = if let Some(model) = file.document.text(&["model_type"]) {
        file.vins(model)?
    } else if let Some(prefix) = file.slam_prefix() {
        file.slam(prefix)?
    } else {
        file.camera_info()?
    };
    draft.body_from_camera = body_from_camera(file.document);
    if chained.len() > 1 {
        draft.note("the first camera of the chain is used");
    }
    Ok(draft)
}

/// EuRoC's `T_BS`, the sensor's pose in the body, 4x4 row-major; Kalibr's `T_cam_imu` is the
/// inverse, where the body is the inertial sensor.
fn body_from_camera(document: &Document) -> Option<Se3> {
    let pose = |key: &str| {
        let matrix = document.list(&[key], Path::new("")).ok()?;
        pose_from_matrix(&matrix.filter(|m| m.len() == 16)?)
    };
    pose("t_bs").or_else(|| Some(pose("t_cam_imu")?.inverse()))
}

/// What EuRoC's `sensor.yaml` says of an inertial sensor: its pose in the body and its noise, as
/// far as they are there.
pub(crate) fn sensor_yaml(text: &str) -> ImuCalibration {
    let document = Document::yaml(text);
    let positive = |key: &str| {
        let number = document.text(&[key])?.parse().ok();
        number.filter(|value: &f64| *value > 0.0)
    };
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
        body_from_imu: body_from_camera(&document),
    }
}

/// Keys of matrices: ROS, OpenCV, `CameraInfo`, OpenCV's stereo calibration.
const MATRIX_KEYS: [&str; 5] = [
    "camera_matrix",
    "cameramatrix",
    "intrinsic_matrix",
    "k",
    "m1",
];

/// Keys of coefficients of the lens.
const LENS_KEYS: [&str; 10] = [
    "distortion_coefficients",
    "distortion_coeffs",
    "distortioncoefficients",
    "dist_coeffs",
    "distcoeffs",
    "distortion_parameters",
    "distortion",
    "parameters",
    "d",
    "d1",
];

struct File<'a> {
    document: &'a Document,
    path: &'a Path,
    size_of_images: Option<(usize, usize)>,
}

impl File<'_> {
    fn wrong(&self, found: impl Into<String>, expected: &str) -> DatasetError {
        DatasetError::content(self.path, found, expected)
    }

    fn number(&self, keys: &[&str]) -> Result<Option<f64>, DatasetError> {
        self.document.number(keys, self.path)
    }

    fn list(&self, keys: &[&str]) -> Result<Option<Vec<f64>>, DatasetError> {
        self.document.list(keys, self.path)
    }

    /// A number that must be there.
    fn required(&self, key: &str) -> Result<f64, DatasetError> {
        let expected = "its intrinsics with all their numbers";
        let found = || format!("a camera without {key}");
        let number = self.number(&[key])?;
        number.ok_or_else(|| self.wrong(found(), expected))
    }

    /// Width and height where the file says them, and whether it does.
    fn size(&self, pairs: &[[&str; 2]]) -> Result<((usize, usize), bool), DatasetError> {
        let mut size = match self
            .list(&["resolution", "image_dimension", "image_size"])?
            .as_deref()
        {
            Some(&[width, height]) => Some((width, height)),
            _ => None,
        };
        for [width, height] in pairs {
            if size.is_none() {
                size = self.number(&[*width])?.zip(self.number(&[*height])?);
            }
        }
        if let Some((width, height)) = size {
            let size = pixel_count(width).zip(pixel_count(height));
            let found = || format!("an image size of {width} x {height}");
            let size = size.ok_or_else(|| self.wrong(found(), "whole numbers of pixels"))?;
            return Ok((size, true));
        }
        let size = self.size_of_images.ok_or_else(|| {
            let expected = "resolution: [width, height], or image_width and image_height";
            self.wrong("no image size", expected)
        })?;
        Ok((size, false))
    }

    fn draft(
        &self,
        (size, is_said): ((usize, usize), bool),
        pinhole: Pinhole,
        distortion: Distortion,
        format: &'static str,
    ) -> Calibration {
        let mut draft = Calibration::draft(size, pinhole, distortion, format);
        if !is_said {
            draft.note("the file does not say its image size; that of the images is taken");
        }
        draft
    }

    /// VINS: `model_type` with keys for each number.
    fn vins(&self, model: &str) -> Result<Calibration, DatasetError> {
        let size = self.size(&[["image_width", "image_height"]])?;
        let kind = model.to_ascii_uppercase();
        let keys = match kind.as_str() {
            "PINHOLE" | "PINHOLE_FULL" => ["fx", "fy", "cx", "cy"],
            "KANNALA_BRANDT" => ["mu", "mv", "u0", "v0"],
            "MEI" => ["gamma1", "gamma2", "u0", "v0"],
            _ => {
                self.lens(model, &[])?;
                let found = format!("camera model {model}");
                return Err(self.wrong(found, "PINHOLE, KANNALA_BRANDT or MEI"));
            }
        };
        let [fx, fy, cx, cy] = keys.map(|key| self.required(key));
        let pinhole = Pinhole::new(fx?, fy?, cx?, cy?);
        let distortion = match kind.as_str() {
            // the first term of the polynomial is 1
            "KANNALA_BRANDT" => self.lens(
                "kannala-brandt",
                &self.terms("", &["k2", "k3", "k4", "k5"])?,
            ),
            "MEI" => {
                let lens = self.terms("", &["k1", "k2", "p1", "p2"])?;
                self.lens("mei", &[vec![self.required("xi")?], lens].concat())
            }
            _ => self.lens("opencv", &self.terms("", &OPENCV_KEYS)?),
        };
        Ok(self.draft(size, pinhole, distortion?, "camera YAML of VINS"))
    }

    /// Terms of a lens, 0 where they are not there.
    fn terms(&self, prefix: &str, keys: &[&str]) -> Result<Vec<f64>, DatasetError> {
        let term = |key: &&str| -> Result<f64, DatasetError> {
            let key = format!("{prefix}{key}");
            Ok(self.number(&[key.as_str()])?.unwrap_or(0.0))
        };
        keys.iter().map(term).collect()
    }

    fn lens(&self, model: &str, coefficients: &[f64]) -> Result<Distortion, DatasetError> {
        lens(model, coefficients, self.path)
    }

    /// What stands in front of the intrinsics of ORB-SLAM (`Camera.fx`, in version 3 `Camera1.fx`)
    /// or stella (`fx` below `Camera:`); a camera of another model may have none, but names it.
    fn slam_prefix(&self) -> Option<&'static str> {
        let has = |keys: &[&str]| self.document.text(keys).is_some();
        let candidates = [
            ("camera.", has(&["camera.fx"])),
            ("camera1.", has(&["camera1.fx"])),
            ("", has(&["fx"])),
            ("camera.", has(&["camera.type", "camera.model"])),
            ("", self.stella_model().is_some()),
        ];
        let found = candidates.into_iter().find(|(_, is_there)| *is_there);
        found.map(|(prefix, _)| prefix)
    }

    /// The `model` below stella's `Camera:`.
    fn stella_model(&self) -> Option<String> {
        let camera = self.document.below("camera")?;
        camera.text(&["model"]).map(str::to_owned)
    }

    /// Pinhole with radial-tangential distortion, or the fisheye model of Kannala and Brandt.
    fn slam(&self, prefix: &str) -> Result<Calibration, DatasetError> {
        let model = self.document.text(&["camera.type", "camera.model"]);
        let model = model.map(str::to_owned).or_else(|| self.stella_model());
        let model = model.unwrap_or_else(|| {
            let model = self.document.text(&["model"]);
            model.unwrap_or("pinhole").to_owned()
        });
        let kind = model.to_ascii_lowercase();
        let (kind, keys): (_, &[&str]) = match kind.as_str() {
            "pinhole" | "perspective" => ("opencv", &OPENCV_KEYS),
            "kannalabrandt8" | "fisheye" => ("kannala-brandt", &["k1", "k2", "k3", "k4"]),
            other => (other, &[]),
        };
        let all_terms = self.terms(prefix, &OPENCV_KEYS)?;
        let distortion = self.lens(kind, &self.terms(prefix, keys)?)?;
        let of = |key: &str| self.required(&format!("{prefix}{key}"));
        let pinhole = Pinhole::new(of("fx")?, of("fy")?, of("cx")?, of("cy")?);
        let below = self.document.below("camera");
        let below = below.filter(|below| below.text(&["cols"]).is_some());
        let size = match &below {
            // elsewhere these are the sides of matrices
            Some(document) => File { document, ..*self }.size(&[["cols", "rows"]])?,
            None => self.size(&[
                ["camera.width", "camera.height"],
                ["camera.cols", "camera.rows"],
                ["width", "height"],
                ["image_width", "image_height"],
            ])?,
        };
        let format = "camera YAML of ORB-SLAM or stella";
        let mut draft = self.draft(size, pinhole, distortion, format);
        if kind == "rectified" && all_terms.iter().any(|term| *term != 0.0) {
            draft.note("the distortion in the file is not used: its images are rectified");
        }
        Ok(draft)
    }

    /// EuRoC, Kalibr, ROS and OpenCV: a list of intrinsics or a matrix, and coefficients.
    fn camera_info(&self) -> Result<Calibration, DatasetError> {
        let model = self.document.text(&["camera_model", "camera_type"]);
        let model = model.unwrap_or("pinhole").to_ascii_lowercase();
        let intrinsics = self.list(&["intrinsics"])?.unwrap_or_default();
        let (pinhole, distortion) = match model.as_str() {
            "omni" => self.sphere(&model, &intrinsics, 1)?,
            "ds" | "eucm" => self.sphere(&model, &intrinsics, 2)?,
            // a model that does not exist is refused before its numbers are looked for
            _ => {
                let distortion = self.distortion(&model)?;
                (self.pinhole(&intrinsics)?, distortion)
            }
        };
        if (pinhole.fx, pinhole.fy) == (0.0, 0.0) {
            let expected = "a focal length; calibrate the camera, or give --fov DEG";
            return Err(self.wrong(
                "a camera that is not calibrated (its matrix is 0)",
                expected,
            ));
        }
        let size = self.size(&[
            ["image_width", "image_height"],
            ["width", "height"],
            ["img_width", "img_height"],
        ])?;
        let mut draft = self.draft(size, pinhole, distortion, "camera YAML");
        self.part_of_sensor(&mut draft)?;
        Ok(draft)
    }

    /// Kalibr's models whose lens has so many parameters in front of the intrinsics.
    fn sphere(
        &self,
        model: &str,
        intrinsics: &[f64],
        num_own: usize,
    ) -> Result<(Pinhole, Distortion), DatasetError> {
        let (own, rest) = intrinsics.split_at(num_own.min(intrinsics.len()));
        let pinhole = self.pinhole(rest)?;
        let named = self.document.text(&["distortion_model"]).unwrap_or("none");
        let behind = match (model, named) {
            (_, "none") => Vec::new(),
            ("omni", "radtan") => self.list(&LENS_KEYS)?.unwrap_or_default(),
            (_, other) => {
                let found = format!("camera_model {model} with distortion_model {other}");
                return Err(self.wrong(found, "none, or radtan behind omni"));
            }
        };
        let distortion = self.lens(model, &[own, &behind].concat())?;
        Ok((pinhole, distortion))
    }

    /// Focal length and principal point: four numbers, or those of a matrix.
    fn pinhole(&self, intrinsics: &[f64]) -> Result<Pinhole, DatasetError> {
        let expected = "intrinsics: [fx, fy, cx, cy], or a camera_matrix of 9 numbers";
        match *intrinsics {
            [fx, fy, cx, cy] => return Ok(Pinhole::new(fx, fy, cx, cy)),
            [] => {}
            _ => {
                let found = format!("intrinsics of {} numbers for this model", intrinsics.len());
                return Err(self.wrong(found, expected));
            }
        }
        if let Some(&[fx, fy]) = self.list(&["focal_length"])?.as_deref()
            && let Some(&[cx, cy]) = self.list(&["principal_point"])?.as_deref()
        {
            return Ok(Pinhole::new(fx, fy, cx, cy));
        }
        match self.list(&MATRIX_KEYS)?.as_deref() {
            Some(&[fx, _, cx, _, fy, cy, _, _, _]) => Ok(Pinhole::new(fx, fy, cx, cy)),
            _ => Err(self.wrong("no intrinsics", expected)),
        }
    }

    /// The lens: its model has a name, is that of the camera, has a flag (OpenCV's samples), or
    /// follows from its parameters.
    fn distortion(&self, camera_model: &str) -> Result<Distortion, DatasetError> {
        let coefficients = self.list(&LENS_KEYS)?.unwrap_or_default();
        if let Some(xi) = self.number(&["xi"])? {
            return self.lens("omnidirectional", &[&[xi][..], &coefficients].concat());
        }
        let below = self.document.below("distortion");
        let below = below.as_ref().and_then(|below| below.text(&["type"]));
        let named = self.document.text(&["distortion_model", "distortion_type"]);
        let is_pinhole = matches!(camera_model, "pinhole" | "perspective");
        let of_camera = (!is_pinhole).then_some(camera_model);
        let flag = self.document.text(&["fisheye_model", "fisheye"]);
        let is_fisheye = flag.is_some_and(|flag| !matches!(flag, "0" | "0." | "false" | "False"));
        let model = match of_camera.or(named).or(below) {
            Some("none") => return Ok(Distortion::None),
            Some(model) => model,
            None if is_fisheye => "fisheye",
            None => "radial-tangential",
        };
        match self.lens(model, &coefficients) {
            // none are 0, whatever the model is
            Err(_) if coefficients.is_empty() && self.lens(model, &[0.0; 4]).is_ok() => {
                Ok(Distortion::None)
            }
            outcome => outcome,
        }
    }

    /// `CameraInfo` may say that the image is a part of the sensor, in coarser pixels.
    fn part_of_sensor(&self, draft: &mut Calibration) -> Result<(), DatasetError> {
        let Some(binning_x) = self.number(&["binning_x"])? else {
            return Ok(());
        };
        let binning = [binning_x, self.number(&["binning_y"])?.unwrap_or(1.0)];
        let [bin_x, bin_y] = binning.map(|pixels| pixels.max(1.0));
        let roi = self.document.below("roi").unwrap_or_default();
        let of_roi = |key: &str| -> Result<f64, DatasetError> {
            Ok(roi.number(&[key], self.path)?.unwrap_or(0.0))
        };
        let [left, top, width, height] = ["x_offset", "y_offset", "width", "height"].map(of_roi);
        let camera = &mut draft.camera;
        let part = |whole: usize, part: f64, bin: f64| match part > 0.0 {
            true => (part / bin) as usize,
            false => (whole as f64 / bin) as usize,
        };
        camera.width = part(camera.width, width?, bin_x);
        camera.height = part(camera.height, height?, bin_y);
        let pinhole = camera.pinhole.cropped(left?, top?);
        camera.pinhole = pinhole.scaled(1.0 / bin_x, 1.0 / bin_y);
        Ok(())
    }
}

/// Keys of a lens of OpenCV in its order.
const OPENCV_KEYS: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
