//! Whether a calibration that was given fits the images.

use crate::self_calibration::{estimate, windows_of};
use monogrid_calibration::Estimate;
use monogrid_geometry::{Camera, Vec2, Vec3};
use monogrid_image::GrayImage;

/// Windows and frames that are looked at.
const MAX_WINDOWS: usize = 5;
const MAX_FRAMES: usize = 300;

/// Focal lengths that differ by less than this share are not worth a word, however certain they are:
/// the estimate itself is off by up to 6 % on a lens with strong distortion.
const MIN_FOCAL_DOUBT: f64 = 0.08;

/// The same for the principal point, as a share of the longer side of the image.
const MIN_CENTRE_DOUBT: f64 = 0.05;

/// Standard deviations beyond which a calibration is doubted.
const DOUBT_SIGMAS: f64 = 3.0;

/// How much more freedom the principal point gets when that of a calibration is far from the middle.
const CENTRE_FREEDOM: f64 = 7.5;

/// Widest horizontal field of view that is compared, degrees: two terms of distortion do not hold
/// beyond.
const MAX_COMPARED_FOV_DEG: f64 = 100.0;

/// What the images say against a calibration that was given, in sentences with the better value.
pub fn doubts(given: &Camera, images: impl Iterator<Item = GrayImage>) -> Vec<String> {
    let size = (given.width, given.height);
    let Some((focal, centre)) = middle(given) else {
        return Vec::new();
    };
    // NaN refuses as well
    let is_comparable = given.horizontal_fov_deg() <= MAX_COMPARED_FOV_DEG;
    if !is_comparable {
        return Vec::new();
    }
    let windows = windows_of(images.take(MAX_FRAMES), size, MAX_WINDOWS);
    if windows.is_empty() {
        return Vec::new();
    }
    let mut doubts = Vec::new();
    let shown = estimate(&windows, size, 1.0);
    if is_focal_doubted(focal, &shown) {
        let (low, high) = shown.focal_interval_px();
        doubts.push(format!(
            "the calibration does not fit the images: its focal length is {focal:.1} px, the points say \
             {:.1} px (95 %: {low:.1} to {high:.1}); calibrate anew, or leave it out to have the camera \
             estimated",
            shown.intrinsics.focal
        ));
    }
    let limit_px = MIN_CENTRE_DOUBT * size.0.max(size.1) as f64;
    if (centre - shown.intrinsics.centre).norm() > limit_px {
        let free = estimate(&windows, size, CENTRE_FREEDOM);
        if is_centre_doubted(&centre, &free, limit_px) {
            let better = free.intrinsics.centre;
            doubts.push(format!(
                "the calibration does not fit the images: its principal point is ({:.1}, {:.1}) px, the \
                 points say ({:.1}, {:.1}) px; are cx and cy swapped?",
                centre.x, centre.y, better.x, better.y
            ));
        }
    }
    doubts
}

/// Whether an estimate contradicts a focal length.
fn is_focal_doubted(focal: f64, shown: &Estimate) -> bool {
    let difference = (focal / shown.intrinsics.focal).ln().abs();
    shown.is_determined() && difference > MIN_FOCAL_DOUBT.max(DOUBT_SIGMAS * shown.sigma[0])
}

/// Whether an estimate contradicts a principal point.
fn is_centre_doubted(centre: &Vec2, free: &Estimate, limit_px: f64) -> bool {
    let difference = centre - free.intrinsics.centre;
    let sigma = Vec2::new(free.sigma[3], free.sigma[4]);
    free.is_determined()
        && difference.norm() > limit_px
        && difference.component_div(&sigma).norm() > DOUBT_SIGMAS
}

/// Focal length in the middle of the image (whatever the model of distortion) and principal point, px.
fn middle(camera: &Camera) -> Option<(f64, Vec2)> {
    let step = 1e-3;
    let centre = camera.project(&Vec3::z())?;
    let right = camera.project(&Vec3::new(step, 0.0, 1.0))?;
    let below = camera.project(&Vec3::new(0.0, step, 1.0))?;
    let focal = ((right - centre).norm() * (below - centre).norm()).sqrt() / step;
    Some((focal, centre))
}

#[cfg(test)]
mod tests {
    use super::{Estimate, estimate, is_centre_doubted, is_focal_doubted, middle};
    use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2};

    /// An estimate of 500 px as certain as this, with the principal point in the middle.
    fn shown(sigma: f64) -> Estimate {
        let mut estimate = estimate(&[], (640, 480), 1.0);
        estimate.intrinsics.focal = 500.0;
        estimate.num_windows = 3;
        estimate.sigma[0] = sigma;
        estimate
    }

    #[test]
    fn a_focal_length_is_doubted_when_it_is_far_off_and_the_points_are_certain() {
        assert!(is_focal_doubted(300.0, &shown(0.02)));
        assert!(is_focal_doubted(900.0, &shown(0.02)));
        assert!(!is_focal_doubted(535.0, &shown(0.01)));
        assert!(is_focal_doubted(550.0, &shown(0.01)));
        assert!(!is_focal_doubted(550.0, &shown(0.04)));
        // undetermined
        assert!(!is_focal_doubted(300.0, &shown(0.06)));
    }

    #[test]
    fn a_principal_point_is_doubted_when_it_is_far_off() {
        let swapped = Vec2::new(240.0, 320.0);
        assert!(is_centre_doubted(&swapped, &shown(0.02), 32.0));
        assert!(!is_centre_doubted(
            &Vec2::new(300.0, 240.0),
            &shown(0.02),
            32.0
        ));
        assert!(!is_centre_doubted(&swapped, &shown(0.06), 32.0));
        let mut uncertain = shown(0.02);
        uncertain.sigma[3] = 50.0;
        uncertain.sigma[4] = 50.0;
        assert!(!is_centre_doubted(&swapped, &uncertain, 32.0));
    }

    #[test]
    fn the_middle_of_any_model() {
        let pinhole = Pinhole::new(500.0, 520.0, 300.0, 200.0);
        let k = [0.1, 0.0, 0.0, 0.0];
        for distortion in [Distortion::None, Distortion::Equidistant { k }] {
            let camera = Camera::try_new(640, 480, pinhole, distortion).unwrap();
            let (focal, centre) = middle(&camera).unwrap();
            assert!((focal - 509.9).abs() < 0.1, "{focal}");
            assert_eq!(centre, Vec2::new(300.0, 200.0));
        }
    }
}
