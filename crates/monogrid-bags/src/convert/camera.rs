//! Calibrations.

use monogrid_geometry::{Camera, CameraError, Distortion, Pinhole};
use monogrid_messages::sensor_msgs::CameraInfo;
use monogrid_messages::std_msgs::Header;

/// Why a `CameraInfo` is no camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InfoError {
    /// The driver has no calibration.
    #[error("the camera is not calibrated (K is 0); calibrate it, or give --calibration FILE")]
    NotCalibrated,
    /// A distortion that cannot be undone here.
    #[error(
        "distortion model {model:?} with {count} parameters is not supported; there are plumb_bob \
         (4 or 5), rational_polynomial (8, no thin prism), equidistant (4), and topics of \
         rectified images"
    )]
    Distortion {
        /// What it is called.
        model: String,
        /// How many parameters there are.
        count: usize,
    },
    /// A number that cannot be that of a camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// The camera of raw images, or of rectified ones.
///
/// # Errors
/// What is missing or not supported.
pub fn camera_of(info: &CameraInfo, is_rectified: bool) -> Result<Camera, InfoError> {
    let (pinhole, distortion) = if is_rectified {
        let [fx, _, cx, _, _, fy, cy, ..] = info.p;
        (Pinhole::new(fx, fy, cx, cy), Distortion::None)
    } else {
        let [fx, _, cx, _, fy, cy, ..] = info.k;
        (Pinhole::new(fx, fy, cx, cy), distortion_of(info)?)
    };
    if pinhole.fx == 0.0 {
        return Err(InfoError::NotCalibrated);
    }
    // the numbers are those of the whole sensor; the image may be a part of it, in coarser pixels
    let roi = &info.roi;
    let binning = [info.binning_x, info.binning_y].map(|pixels| pixels.max(1));
    let size = |whole: u32, part: u32, pixels: u32| {
        (if part == 0 { whole } else { part } / pixels) as usize
    };
    let pinhole = pinhole
        .cropped(f64::from(roi.x_offset), f64::from(roi.y_offset))
        .scaled(1.0 / f64::from(binning[0]), 1.0 / f64::from(binning[1]));
    Ok(Camera::try_new(
        size(info.width, roi.width, binning[0]),
        size(info.height, roi.height, binning[1]),
        pinhole,
        distortion,
    )?)
}

fn distortion_of(info: &CameraInfo) -> Result<Distortion, InfoError> {
    let (model, d) = (info.distortion_model.as_str(), &info.d);
    // drivers fill up with zeros: thin prisms and a numerator that are not there
    let num_used = d.iter().rposition(|v| *v != 0.0).map_or(0, |last| last + 1);
    let first = |count: usize| -> Vec<f64> {
        let given = d.iter().copied().chain(std::iter::repeat(0.0));
        given.take(count).collect()
    };
    let coefficients = match model {
        "equidistant" | "fisheye" if d.len() >= 4 && num_used <= 4 => first(4),
        "equidistant" => return Err(unsupported(info)),
        _ if num_used == 0 => return Ok(Distortion::None),
        "plumb_bob" if d.len() >= 4 && num_used <= 5 => first(5),
        "rational_polynomial" if d.len() >= 4 && num_used <= 8 => first(8),
        "plumb_bob" | "rational_polynomial" => return Err(unsupported(info)),
        _ => d.clone(),
    };
    Distortion::from_name(model, &coefficients).map_err(|_| unsupported(info))
}

fn unsupported(info: &CameraInfo) -> InfoError {
    InfoError::Distortion {
        model: info.distortion_model.clone(),
        count: info.d.len(),
    }
}

/// The calibration of images without distortion.
#[must_use]
pub fn info_of(header: Header, pinhole: &Pinhole, (width, height): (usize, usize)) -> CameraInfo {
    let Pinhole { fx, fy, cx, cy } = *pinhole;
    CameraInfo {
        header,
        height: height as u32,
        width: width as u32,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.0; 5],
        k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraInfo::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_messages::sensor_msgs::RegionOfInterest;

    fn info(model: &str, d: &[f64]) -> CameraInfo {
        CameraInfo {
            height: 480,
            width: 640,
            distortion_model: model.into(),
            d: d.to_vec(),
            k: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0],
            p: [
                400.0, 0.0, 321.0, 0.0, 0.0, 410.0, 241.0, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
            ..CameraInfo::default()
        }
    }

    #[test]
    fn models_that_ros_and_we_know() {
        let camera = camera_of(&info("plumb_bob", &[0.1, 0.2, 0.3, 0.4, 0.5]), false).unwrap();
        assert_eq!((camera.width, camera.height), (640, 480));
        assert_eq!(camera.pinhole, Pinhole::new(500.0, 510.0, 320.0, 240.0));
        let plumb_bob = Distortion::RadialTangential {
            k1: 0.1,
            k2: 0.2,
            p1: 0.3,
            p2: 0.4,
            k3: 0.5,
        };
        assert_eq!(camera.distortion, plumb_bob);
        let rational = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0];
        let camera = camera_of(&info("rational_polynomial", &rational), false).unwrap();
        assert_eq!(camera.distortion, plumb_bob);
        // as cameras of Azure, Orbbec and OpenCV fill them up
        for model in ["plumb_bob", "rational_polynomial"] {
            for num_zeros in [3, 7, 9] {
                let filled = [&rational[..5], &vec![0.0; num_zeros]].concat();
                let camera = camera_of(&info(model, &filled), false).unwrap();
                assert_eq!(camera.distortion, plumb_bob, "{model}, {num_zeros}");
            }
        }
        let thin = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.0, 0.7, 0.0, 0.0];
        let camera = camera_of(&info("rational_polynomial", &thin), false).unwrap();
        let (k, p) = ([0.1, 0.2, 0.5, 0.6, 0.0, 0.7], [0.3, 0.4]);
        assert_eq!(camera.distortion, Distortion::Rational { k, p });
        let fisheye = camera_of(&info("equidistant", &[0.1, 0.2, 0.3, 0.4]), false).unwrap();
        let k = [0.1, 0.2, 0.3, 0.4];
        assert_eq!(fisheye.distortion, Distortion::Equidistant { k });
        // four zeros are a fisheye still
        let zeros = camera_of(&info("equidistant", &[0.0; 4]), false).unwrap();
        assert_eq!(zeros.distortion, Distortion::Equidistant { k: [0.0; 4] });
        for zero in [info("plumb_bob", &[0.0; 5]), info("", &[])] {
            let camera = camera_of(&zero, false).unwrap();
            assert_eq!(camera.distortion, Distortion::None);
        }
    }

    #[test]
    fn others_are_refused_unless_the_images_are_rectified() {
        let rational = info(
            "rational_polynomial",
            // a thin prism
            &[0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.1, 0.2],
        );
        let refused = InfoError::Distortion {
            model: "rational_polynomial".into(),
            count: 9,
        };
        assert!(refused.to_string().contains("no thin prism"));
        assert_eq!(camera_of(&rational, false), Err(refused));
        let camera = camera_of(&rational, true).unwrap();
        assert_eq!(camera.pinhole, Pinhole::new(400.0, 410.0, 321.0, 241.0));
        assert_eq!(camera.distortion, Distortion::None);
        let mut without = info("plumb_bob", &[]);
        without.k = [0.0; 9];
        assert_eq!(camera_of(&without, false), Err(InfoError::NotCalibrated));
    }

    #[test]
    fn what_is_written_is_read_as_the_same_camera() {
        let pinhole = Pinhole::new(500.0, 510.0, 320.0, 240.0);
        let info = info_of(Header::default(), &pinhole, (640, 480));
        for rectified in [false, true] {
            let camera = camera_of(&info, rectified).unwrap();
            assert_eq!((camera.width, camera.height), (640, 480));
            assert_eq!(
                (camera.pinhole, camera.distortion),
                (pinhole, Distortion::None)
            );
        }
    }

    #[test]
    fn a_part_of_the_sensor_in_coarser_pixels() {
        let mut part = info("plumb_bob", &[]);
        part.roi = RegionOfInterest {
            x_offset: 100,
            y_offset: 40,
            width: 400,
            height: 300,
            do_rectify: false,
        };
        part.binning_x = 2;
        part.binning_y = 2;
        let camera = camera_of(&part, false).unwrap();
        assert_eq!((camera.width, camera.height), (200, 150));
        // (320 - 100 + 0.5) / 2 - 0.5
        assert_eq!(camera.pinhole, Pinhole::new(250.0, 255.0, 109.75, 99.75));
    }
}
