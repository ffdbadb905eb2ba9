//! Models by the names and in the order of coefficients that other programs use.

use super::Distortion;

/// Models that there are, for messages.
const SUPPORTED: &str = "there are pinhole, radial-tangential (k1 k2 p1 p2 [k3]), rational (k1 k2 \
    p1 p2 k3 k4 k5 k6), equidistant (Kannala-Brandt: k1 k2 k3 k4), fov (omega), double sphere (xi \
    alpha), extended unified (alpha beta) and omnidirectional (Mei: xi k1 k2 p1 p2)";

/// Why a lens cannot be used.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum LensError {
    /// A model that exists, perhaps, but not here.
    #[error("camera model {model} is not supported; {SUPPORTED}")]
    Model {
        /// Its name, as it was found.
        model: String,
    },
    /// A picture of everything around, which no lens before a plane has.
    #[error(
        "camera model {model} is not supported; cut the view ahead out of the video (a face of the \
         cube) and use that as a pinhole camera with --fov 90: ffmpeg -i VIDEO -vf \
         v360=equirect:flat:h_fov=90:v_fov=90:w=960:h=960 ahead.mp4"
    )]
    Equirectangular {
        /// Its name, as it was found.
        model: String,
    },
    /// More terms than the model has here.
    #[error(
        "{terms} is not supported (the coefficients of OpenCV behind k6 are {found:?}); calibrate \
         without it"
    )]
    Terms {
        /// What the terms are.
        terms: &'static str,
        /// Their values.
        found: Vec<f64>,
    },
    /// A number of coefficients that the model does not have.
    #[error("camera model {model} with {found} coefficients, expected {expected}")]
    Coefficients {
        /// Its name, as it was found.
        model: String,
        /// How many there are.
        found: usize,
        /// What the model has.
        expected: &'static str,
    },
}

/// Models that have their coefficients in the same order.
#[derive(Clone, Copy)]
enum Family {
    Pinhole,
    OpenCv,
    Fisheye,
    Fov,
    DoubleSphere,
    Extended,
    Omnidirectional,
}

impl Family {
    fn of_name(model: &str) -> Result<Self, LensError> {
        let plain: String = model.chars().filter(|c| c.is_alphanumeric()).collect();
        Ok(match plain.to_ascii_lowercase().as_str() {
            "pinhole" | "perspective" | "none" | "rectified" => Self::Pinhole,
            "radialtangential" | "radtan" | "radtan8" | "pinholeradtan8" | "plumbbob"
            | "opencv" | "brown" | "brownconrady" | "rational" | "rationalpolynomial" => {
                Self::OpenCv
            }
            "equidistant" | "equi" | "fisheye" | "kannalabrandt" | "kannalabrandt8" | "kb4" => {
                Self::Fisheye
            }
            "fov" | "atan" => Self::Fov,
            "ds" | "doublesphere" => Self::DoubleSphere,
            "eucm" | "extendedunified" => Self::Extended,
            "omni" | "omnidirectional" | "mei" => Self::Omnidirectional,
            "equirectangular" | "equirect" | "spherical" => {
                let model = model.to_owned();
                return Err(LensError::Equirectangular { model });
            }
            _ => {
                let model = model.to_owned();
                return Err(LensError::Model { model });
            }
        })
    }
}

impl Distortion {
    /// The lens of a model of this name, as Kalibr, ROS, OpenCV, ORB-SLAM and others call it
    /// (capitals, blanks and dashes do not count), with its coefficients in their order there.
    ///
    /// Radial-tangential coefficients that are all 0 are no distortion.
    ///
    /// # Errors
    /// When the model is unknown, or does not have as many coefficients.
    pub fn from_name(model: &str, coefficients: &[f64]) -> Result<Self, LensError> {
        let wrong = |expected| {
            Err(LensError::Coefficients {
                model: model.to_owned(),
                found: coefficients.len(),
                expected,
            })
        };
        match (Family::of_name(model)?, coefficients) {
            (Family::Pinhole, []) | (Family::Fov, &[0.0]) => Ok(Self::None),
            (Family::Pinhole, _) => wrong("none (a lens with distortion has a model of its own)"),
            (Family::OpenCv, _) => {
                Self::from_opencv(coefficients).unwrap_or_else(|| wrong(OPENCV_ORDER))
            }
            (Family::Fisheye, &[k1, k2, k3, k4]) => Ok(Self::Equidistant {
                k: [k1, k2, k3, k4],
            }),
            (Family::Fisheye, _) => wrong("k1 k2 k3 k4"),
            (Family::Fov, &[omega]) => Ok(Self::Fov { omega }),
            (Family::Fov, _) => wrong("omega alone"),
            (Family::DoubleSphere, &[xi, alpha]) => Ok(Self::DoubleSphere { xi, alpha }),
            (Family::DoubleSphere, _) => wrong("xi alpha"),
            (Family::Extended, &[alpha, beta]) => Ok(Self::ExtendedUnified { alpha, beta }),
            (Family::Extended, _) => wrong("alpha beta"),
            (Family::Omnidirectional, &[xi]) => Ok(Self::Omnidirectional {
                xi,
                k: [0.0; 2],
                p: [0.0; 2],
            }),
            (Family::Omnidirectional, &[xi, k1, k2, p1, p2]) => Ok(Self::Omnidirectional {
                xi,
                k: [k1, k2],
                p: [p1, p2],
            }),
            (Family::Omnidirectional, _) => wrong("xi k1 k2 p1 p2"),
        }
    }

    /// Name of the model in our own files; [`Self::from_name`] knows it.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::None => "pinhole",
            Self::RadialTangential { .. } => "radial-tangential",
            Self::Fov { .. } => "fov",
            Self::Equidistant { .. } => "equidistant",
            Self::Rational { .. } => "rational",
            Self::DoubleSphere { .. } => "double-sphere",
            Self::ExtendedUnified { .. } => "extended-unified",
            Self::Omnidirectional { .. } => "omnidirectional",
        }
    }

    /// OpenCV's vector of coefficients; `None` where it is none.
    fn from_opencv(coefficients: &[f64]) -> Option<Result<Self, LensError>> {
        if !matches!(coefficients.len(), 4 | 5 | 8 | 12 | 14) {
            return None;
        }
        let of = |i: usize| coefficients.get(i).copied().unwrap_or(0.0);
        let any = |range: std::ops::Range<usize>| range.map(of).any(|value| value != 0.0);
        let further = |terms| LensError::Terms {
            terms,
            found: coefficients[8..].to_vec(),
        };
        Some(if any(12..14) {
            Err(further("a tilted sensor (tau x, tau y)"))
        } else if any(8..12) {
            Err(further("thin prism distortion (s1 s2 s3 s4)"))
        } else if any(5..8) {
            let k = [of(0), of(1), of(4), of(5), of(6), of(7)];
            let p = [of(2), of(3)];
            Ok(Self::Rational { k, p })
        } else if any(0..5) {
            let ([k1, k2], [p1, p2], k3) = ([of(0), of(1)], [of(2), of(3)], of(4));
            Ok(Self::RadialTangential { k1, k2, p1, p2, k3 })
        } else {
            Ok(Self::None)
        })
    }
}

const OPENCV_ORDER: &str =
    "k1 k2 p1 p2 and optionally k3, or k1 k2 p1 p2 k3 k4 k5 k6 (OpenCV's order)";
