//! The camera of a source that has no calibration: estimated from its images.

use crate::process::failure::Failure;
use crate::process::interrupt::is_interrupted;
use monogrid_calibration::{
    CollectorConfig, Estimate, EstimateConfig, Intrinsics, Prior, TrackCollector, Window,
    estimate_intrinsics,
};
use monogrid_datasets::{Calibration, Rectangle, exif_focal_px};
use monogrid_geometry::{Camera, Distortion, Pinhole, ReadoutDirection};
use monogrid_image::{GrayImage, Mask, Resize, WorkingSize, resize_area, resize_mask};
use std::path::Path;

/// Field of view that is assumed along the longer side where nothing is known, degrees: between the
/// main cameras of phones while filming and those of laptops.
const ASSUMED_FOV_DEG: f64 = 62.0;

/// How the focal length that a camera wrote into its images may differ from that of the images,
/// relative: what was cropped or stabilised sees less.
const EXIF_SIGMA: f64 = 0.12;

/// What is expected of a camera before its images are looked at.
#[derive(Clone, Debug)]
pub struct Expected {
    /// Field of view along the longer side, degrees.
    fov_deg: f64,
    /// Relative standard deviation of the focal length; `None` where nothing is known of it.
    focal_sigma: Option<f64>,
    /// Where it comes from, for people.
    source: &'static str,
    /// Of a picture within borders: its longer side and its middle, as shares of those of the
    /// image.
    picture: Option<(f64, [f64; 2])>,
}

impl Expected {
    /// An ordinary camera.
    pub const ORDINARY: Self = Self {
        fov_deg: ASSUMED_FOV_DEG,
        focal_sigma: None,
        source: "assumed",
        picture: None,
    };

    /// The rule for a picture that is `picture` of an image of this size, and has borders around
    /// it.
    pub fn within(self, picture: Option<Rectangle>, size: (usize, usize)) -> Self {
        let longer = |(width, height): (usize, usize)| width.max(height).max(1) as f64;
        let of_image = |picture: Rectangle| {
            let Rectangle { left, top, .. } = picture;
            let (width, height) = (picture.width, picture.height);
            let middle = |first: usize, length: usize, all: usize| {
                (first as f64 + length as f64 / 2.0) / all.max(1) as f64
            };
            let x = middle(left, width, size.0);
            let y = middle(top, height, size.1);
            (longer((width, height)) / longer(size), [x, y])
        };
        Self {
            picture: picture.map(of_image),
            ..self
        }
    }

    /// What the camera wrote into an image, if it did.
    pub fn of_image(path: &Path, size: (usize, usize)) -> Self {
        let longer = size.0.max(size.1) as f64;
        match exif_focal_px(path, size) {
            Some(focal) => Self {
                fov_deg: 2.0 * (longer / 2.0 / focal).atan().to_degrees(),
                focal_sigma: Some(EXIF_SIGMA),
                source: "as the images say (Exif)",
                picture: None,
            },
            None => Self::ORDINARY,
        }
    }

    /// What is known before anything was seen; the principal point has `centre_freedom` times its
    /// ordinary freedom.
    pub fn prior(&self, size: (usize, usize), centre_freedom: f64) -> Prior {
        let mut prior = Prior::ordinary(self.fov_deg, size);
        if let Some((longer, middle)) = self.picture {
            let [x, y] = middle.map(|share| share - 0.5);
            prior.mean[0] += longer.ln();
            prior.mean[3] += x * size.0 as f64;
            prior.mean[4] += y * size.1 as f64;
        }
        prior.sigma[0] = self.focal_sigma.unwrap_or(prior.sigma[0]);
        prior.sigma[3] *= centre_freedom;
        prior.sigma[4] *= centre_freedom;
        prior
    }
}

/// Windows of the video that are used.
const MAX_WINDOWS: usize = 8;

/// Frames that are looked at.
const MAX_FRAMES: usize = 900;

/// A camera that was not given.
#[derive(Clone, Debug)]
pub struct OwnCalibration {
    /// The camera.
    pub camera: Camera,
    /// Time from the first row to the last, where the images show it, ms.
    pub readout_ms: Option<f64>,
    /// How it came about, for people.
    pub interpretation: String,
    /// Whether its focal length is assumed, because nothing shows it.
    pub is_assumed: bool,
    /// Standard deviation of the logarithm of the focal length, where images or map show it.
    pub focal_sigma: Option<f64>,
    /// What to know about it, in sentences.
    pub warnings: Vec<String>,
}

impl OwnCalibration {
    /// A pinhole with this horizontal field of view.
    pub fn from_fov(fov_deg: f64, (width, height): (usize, usize)) -> Result<Self, Failure> {
        let focal = width as f64 / 2.0 / (fov_deg.to_radians() / 2.0).tan();
        let Intrinsics { focal, centre, .. } = Intrinsics::centred(focal, (width, height));
        let pinhole = Pinhole::new(focal, focal, centre.x, centre.y);
        let camera = Camera::try_new(width, height, pinhole, Distortion::None)
            .map_err(|e| Failure::input(format!("--fov {fov_deg}: {e}")))?;
        Ok(Self {
            camera,
            readout_ms: None,
            interpretation: format!(
                "pinhole with the horizontal field of view that was given, {fov_deg} degrees"
            ),
            is_assumed: false,
            focal_sigma: None,
            warnings: Vec::new(),
        })
    }

    /// The camera that the beginning of a video shows; why, where it shows none at all.
    ///
    /// # Errors
    /// No corner can be followed for long enough.
    pub fn from_images(
        frames: impl Iterator<Item = (i64, GrayImage)>,
        ((size, direction), mask): (((usize, usize), ReadoutDirection), Option<&Mask>),
        expected: &Expected,
    ) -> Result<Self, String> {
        let mut times_ns = Vec::new();
        let images = frames.take(MAX_FRAMES).map(|(time_ns, image)| {
            times_ns.push(time_ns);
            image
        });
        let windows = windows_of(images, ((size, direction), mask), MAX_WINDOWS);
        if windows.is_empty() || is_interrupted() {
            return Err(why_not_followed(&times_ns).to_owned());
        }
        let estimate = estimate(&windows, size, expected, 1.0);
        let own = Self::from_estimate(&estimate, size, expected);
        let own = own.ok_or("the camera that they show is none")?;
        let readout = estimate.readout().filter(|_| estimate.is_determined());
        Ok(match readout {
            Some((share, sigma)) => own.with_readout(share, sigma, interval_ns(&times_ns) / 1e6),
            None => own,
        })
    }

    /// The camera that is expected, where its images cannot show it, and why they do not.
    pub fn assumed(size: (usize, usize), expected: &Expected, reason: &str) -> Option<Self> {
        let own = Self::from_estimate(&estimate(&[], size, expected, 1.0), size, expected)?;
        let (fov_deg, source) = (expected.fov_deg, expected.source);
        Some(Self {
            warnings: vec![format!(
                "the focal length is not known: {reason}; {fov_deg:.0} degrees along the longer \
                 side are taken, {source}; give --calibration FILE or --fov DEG"
            )],
            ..own
        })
    }

    /// The same with a rolling shutter, in shares of the time from frame to frame.
    fn with_readout(mut self, share: f64, sigma: f64, interval_ms: f64) -> Self {
        let (ms, uncertain_ms) = (share * interval_ms, 1.96 * sigma * interval_ms);
        self.readout_ms = Some(ms);
        self.interpretation.push_str(&format!(
            "; rolling shutter of {ms:.1} ms (95 %: within {uncertain_ms:.1} ms)"
        ));
        self
    }

    /// What an estimate determines, else what is expected.
    fn from_estimate(
        estimate: &Estimate,
        size: (usize, usize),
        expected: &Expected,
    ) -> Option<Self> {
        if estimate.is_determined() {
            return Self::from_determined(estimate, size, "estimated from the video");
        }
        let percent = 196.0 * estimate.sigma[0];
        let (fov_deg, source) = (expected.fov_deg, expected.source);
        Some(Self {
            camera: Intrinsics::from_parameters(&expected.prior(size, 1.0).mean).camera(size)?,
            readout_ms: None,
            interpretation: format!(
                "{source}: pinhole with a field of view of {fov_deg:.0} degrees along the longer \
                 side"
            ),
            is_assumed: true,
            focal_sigma: None,
            warnings: vec![format!(
                "the motion of the camera does not show its focal length (uncertain by \
                 {percent:.0} %): {fov_deg:.0} degrees are taken, {source}, unless the map of a \
                 first pass shows it; turn the camera while moving it sideways, or give \
                 --calibration FILE or --fov DEG"
            )],
        })
    }

    /// The same with a rolling shutter that is known, ms; none where it is 0.
    pub fn reading_for(mut self, readout_ms: f64) -> Self {
        self.readout_ms = Some(readout_ms).filter(|ms| *ms != 0.0);
        if let Some(ms) = self.readout_ms {
            self.interpretation += &format!("; rolling shutter of {ms:.1} ms");
        }
        self
    }

    /// What an estimate determines, and from what; `None` where the focal length is not.
    pub fn from_determined(
        estimate: &Estimate,
        size: (usize, usize),
        source: &str,
    ) -> Option<Self> {
        if !estimate.is_determined() {
            return None;
        }
        let (low, high) = estimate.focal_interval_px();
        let (focal, centre) = (estimate.intrinsics.focal, estimate.intrinsics.centre);
        let [k1, k2] = estimate.intrinsics.radial;
        Some(Self {
            camera: estimate.intrinsics.camera(size)?,
            readout_ms: None,
            interpretation: format!(
                "{source}: focal length {focal:.1} px (95 %: {low:.1} to {high:.1}), \
                 distortion k1 = {k1:.4}, k2 = {k2:.4}, principal point ({:.1}, {:.1}); {} of {} \
                 pieces of it used",
                centre.x, centre.y, estimate.num_windows, estimate.num_given
            ),
            is_assumed: false,
            focal_sigma: Some(estimate.sigma[0]),
            warnings: Vec::new(),
        })
    }

    /// Name and content of the calibration file: one line of numbers, or TOML where these cannot
    /// say the distortion.
    pub fn file(&self) -> (&'static str, String) {
        match self.camera.distortion {
            Distortion::None | Distortion::RadialTangential { k3: 0.0, .. } => {
                ("calibration.txt", self.line())
            }
            _ => {
                let text = Calibration::to_toml(&self.camera, self.readout_ms);
                ("calibration.toml", text)
            }
        }
    }

    fn line(&self) -> String {
        let (width, height) = (self.camera.width, self.camera.height);
        let Pinhole { fx, fy, cx, cy } = self.camera.pinhole;
        let terms = match self.camera.distortion {
            Distortion::RadialTangential { k1, k2, p1, p2, .. } => {
                format!(" {k1:.6} {k2:.6} {p1:.6} {p2:.6}")
            }
            _ => String::new(),
        };
        let shutter = self
            .readout_ms
            .map(|ms| format!("rolling_shutter_ms {ms:.2}\n"));
        let shutter = shutter.unwrap_or_default();
        format!(
            "# {}\n# fx fy cx cy{} width height, in pixels\n{fx:.3} {fy:.3} {cx:.3} {cy:.3}{terms} \
             {width} {height}\n{shutter}",
            self.interpretation,
            if terms.is_empty() { "" } else { " k1 k2 p1 p2" }
        )
    }
}

/// Why corners cannot be followed through images of these times.
fn why_not_followed(times_ns: &[i64]) -> &'static str {
    let interval_ns = interval_ns(times_ns);
    if times_ns.len() < 2 {
        return "there are too few images";
    }
    if times_ns.windows(2).any(|pair| pair[1] < pair[0]) {
        return "the times of the images are out of order";
    }
    match interval_ns > FAR_APART_NS {
        true => "the images are too far apart to follow anything from one to the next",
        false => {
            "nothing can be followed through the images (the picture hardly moves, has no texture, \
             or jumps from image to image)"
        }
    }
}

/// Time from image to image from which most motions leave too little in common, ns.
const FAR_APART_NS: f64 = 400e6;

/// Median time from frame to frame, ns; 0 without two frames.
pub fn interval_ns(times_ns: &[i64]) -> f64 {
    let mut intervals: Vec<i64> = times_ns.windows(2).map(|t| t[1] - t[0]).collect();
    intervals.sort_unstable();
    let median = intervals.get(intervals.len() / 2);
    median.map_or(0.0, |ns| *ns as f64)
}

/// The windows of a video at working size; the images are of this size, a rolling shutter runs this
/// way over them, and corners lie where the mask says.
pub fn windows_of(
    images: impl Iterator<Item = GrayImage>,
    ((size, direction), mask): (((usize, usize), ReadoutDirection), Option<&Mask>),
    max_windows: usize,
) -> Vec<Window> {
    let (width, height) = WorkingSize::AUTOMATIC.resolve(size.0, size.1);
    let mut collector = TrackCollector::new(CollectorConfig {
        direction,
        ..CollectorConfig::default()
    })
    .within(mask.map(|mask| resize_mask(mask, Resize { width, height })));
    for image in images.filter(|image| (image.width(), image.height()) == size) {
        collector.add(&resize_area(&image, Resize { width, height }));
        if collector.num_windows() >= max_windows {
            break;
        }
    }
    collector.finish()
}

/// What windows at working size say about the camera of images of this size; the principal point
/// has `centre_freedom` times its ordinary freedom.
pub fn estimate(
    windows: &[Window],
    size: (usize, usize),
    expected: &Expected,
    centre_freedom: f64,
) -> Estimate {
    let working = WorkingSize::AUTOMATIC.resolve(size.0, size.1);
    let prior = expected.prior(working, centre_freedom);
    let ordinary = EstimateConfig::default();
    let config = EstimateConfig {
        guesses_deg: match expected.focal_sigma {
            Some(_) => vec![expected.fov_deg],
            None => ordinary.guesses_deg,
        },
        ..ordinary
    };
    let estimate = estimate_intrinsics(windows, working, &prior, &config);
    estimate.scaled(size.0 as f64 / working.0 as f64, size)
}

#[cfg(test)]
mod tests {
    use super::{Expected, OwnCalibration, estimate};

    #[test]
    fn what_is_not_determined_is_assumed_and_said() {
        let ordinary = Expected::ORDINARY;
        let mut shown = estimate(&[], (640, 480), &ordinary, 1.0);
        shown.intrinsics.focal = 500.0;
        shown.num_windows = 3;
        shown.sigma[0] = 0.02;
        let certain = OwnCalibration::from_estimate(&shown, (640, 480), &ordinary).unwrap();
        assert!(certain.warnings.is_empty());
        assert!((certain.camera.pinhole.fx - 500.0).abs() < 1e-9);
        assert_eq!(certain.focal_sigma, Some(0.02));
        let (name, text) = certain.file();
        assert_eq!(name, "calibration.txt");
        assert!(
            text.ends_with("\n500.000 500.000 319.500 239.500 640 480\n"),
            "{text}"
        );
        shown.sigma[0] = 0.06;
        let assumed = OwnCalibration::from_estimate(&shown, (640, 480), &ordinary).unwrap();
        assert!((assumed.camera.horizontal_fov_deg() - 62.0).abs() < 0.2);
        assert!(assumed.warnings[0].contains("--fov DEG"), "{assumed:?}");
        assert!(assumed.is_assumed && assumed.focal_sigma.is_none());
        let wide = Expected {
            fov_deg: 80.0,
            focal_sigma: Some(0.1),
            source: "as the images say",
            picture: None,
        };
        let known = OwnCalibration::from_estimate(&shown, (640, 480), &wide).unwrap();
        assert!((known.camera.horizontal_fov_deg() - 80.0).abs() < 0.2);
        assert!(known.interpretation.contains("images say"), "{known:?}");
        assert!(estimate(&[], (640, 480), &wide, 1.0).sigma[0] < 0.11);
    }
}
