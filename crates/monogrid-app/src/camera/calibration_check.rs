//! Whether a calibration that was given fits the images.

use crate::camera::map_camera::{TakenOut, as_calibrated, left_radial_by_map, shown_by_map};
use crate::camera::self_calibration::{Expected, estimate, windows_of};
use crate::input::{Images, Input};
use monogrid_calibration::Estimate;
use monogrid_geometry::{Camera, Pinhole, Vec2, Vec3};
use monogrid_slam::{KeptKeyframe, Slam};

/// Windows and frames that are looked at.
const MAX_WINDOWS: usize = 5;
const MAX_FRAMES: usize = 300;

/// Focal lengths that differ by less than this share are not worth a word, however certain they
/// are: the estimate itself is off by up to 6 % on a lens with strong distortion.
const MIN_FOCAL_DIFFERENCE: f64 = 0.08;

/// The same for the principal point, as a share of the longer side of the image.
const MIN_CENTRE_DIFFERENCE: f64 = 0.05;

/// Standard deviations beyond which a calibration is doubted.
const MIN_DIFFERENCE_SIGMAS: f64 = 3.0;

/// How much more freedom the principal point gets when that of a calibration is far from the
/// middle.
const CENTRE_FREEDOM: f64 = 7.5;

/// Widest horizontal field of view that is compared, degrees: two terms of distortion do not hold
/// beyond.
const MAX_COMPARED_FOV_DEG: f64 = 100.0;

/// Keyframes after which a run asks its map for the first time; then whenever they have doubled.
const EARLY_KEYFRAMES: usize = 12;

/// Keyframes of a piece of the map: few enough that pieces disagree where a wrong calibration makes
/// the map drift.
const VIEWS_PER_PIECE: usize = 10;

/// What a map may say else than the calibration before the images are asked: changes of the focal
/// length (share; of all together, and of each piece that is certain to 10 %) and of the principal
/// point (share of the longer side). Maps made with right calibrations say up to 2.8 %, 5 % and 2.7
/// % (of twelve keyframes); those made with wrong ones stay near them, and still some piece says 17
/// % or the centre 6.8 %.
const MAX_FOCAL_CHANGE: f64 = 0.05;
const MAX_PIECE_FOCAL_CHANGE: f64 = 0.1;
const MAX_PIECE_SIGMA: f64 = 0.1;
const MAX_CENTRE_CHANGE: f64 = 0.043;

/// Share of the frames with a pose below which a run with a small map has the images asked.
const POOR_SHARE: f64 = 0.5;

/// Checks the calibration that a run was given against the map that it makes; where the map
/// disagrees, or comes to nothing, the images themselves are asked.
#[derive(Debug)]
pub struct CalibrationCheck<'a> {
    /// `None` where there is nothing to check.
    input: Option<&'a Input>,
    /// Whether the images may be asked while the run goes on.
    may_wait: bool,
    /// Keyframes at which the map is asked next.
    next_at: usize,
    warnings: Vec<String>,
}

impl<'a> CalibrationCheck<'a> {
    /// Before the first frame; a run that keeps pace with its camera `may_wait` for nothing.
    pub fn new(input: &'a Input, may_wait: bool) -> Self {
        let is_given =
            input.own_calibration.is_none() && !matches!(input.images, Images::Rendered(_));
        Self {
            input: (is_given && is_comparable(input.camera())).then_some(input),
            may_wait,
            next_at: EARLY_KEYFRAMES,
            warnings: Vec::new(),
        }
    }

    /// While the run goes on: what the map says against the calibration, once, as soon as it does.
    pub fn early(
        &mut self,
        (slam, taken_out): (&Slam, &TakenOut),
        num_keyframes: usize,
    ) -> &[String] {
        let is_due = self.may_wait && self.warnings.is_empty() && num_keyframes >= self.next_at;
        let Some(input) = self.input.filter(|_| is_due) else {
            return &[];
        };
        self.next_at = 2 * num_keyframes;
        self.warnings = against(input, &by_map(slam, taken_out));
        &self.warnings
    }

    /// The radial distortion that the calibration has left, as the map shows it.
    pub fn left_radial(&self, (slam, taken_out): (&Slam, &TakenOut)) -> Option<f64> {
        self.input?;
        left_radial_by_map(slam, taken_out)
    }

    /// After the run, of whose frames this share has a pose: all that is known against the
    /// calibration.
    pub fn end(&self, (slam, taken_out): (&Slam, &TakenOut), share_with_pose: f64) -> Vec<String> {
        match self.input {
            Some(input) if self.warnings.is_empty() => {
                let shown = by_map(slam, taken_out);
                if says_too_little(&shown, share_with_pose) && input.is_repeatable() {
                    return against_images(input);
                }
                against(input, &shown)
            }
            _ => self.warnings.clone(),
        }
    }
}

/// The camera of the working images as the map shows it, with the calibration as the guess.
fn by_map(slam: &Slam, taken_out: &TakenOut) -> Estimate {
    let keyframes = slam.keyframes();
    let size = keyframes.first().map_or((0, 0), KeptKeyframe::size);
    let guess = as_calibrated(slam);
    let mut prior = Expected::ORDINARY.prior(size, CENTRE_FREEDOM);
    prior.mean = guess.parameters();
    shown_by_map(slam, VIEWS_PER_PIECE, &guess, (size, &prior), taken_out)
}

/// What there is to say where a map disagrees with the calibration.
fn against(input: &Input, shown: &Estimate) -> Vec<String> {
    let &Pinhole { fx, fy, cx, cy } = input.pinhole();
    let given = (fx * fy).sqrt();
    let offset_px = (shown.intrinsics.centre - Vec2::new(cx, cy)).norm();
    let offset = offset_px / shown.size.0.max(shown.size.1).max(1) as f64;
    if is_as_given(given, offset, shown) {
        return Vec::new();
    }
    let ratio = shown.intrinsics.focal / given;
    if input.is_repeatable() {
        return against_images(input);
    }
    vec![format!(
        "the calibration does not fit what was seen: with another focal length (about {ratio:.2} \
         times the given one) and principal point ({:.0} % of the image beside the given one) the \
         points of the map agree better; calibrate anew",
        100.0 * offset
    )]
}

/// Whether a map says too little about its camera, so that the images must: it leaves the focal
/// length open, or is very small though most frames have no pose. A map that a wrong calibration
/// has bent agrees with it the better, the shorter it is.
fn says_too_little(shown: &Estimate, share_with_pose: f64) -> bool {
    match shown.num_windows {
        0 => share_with_pose < POOR_SHARE,
        _ => !shown.is_determined(),
    }
}

/// Whether a map shows the camera that it was made with: its focal length, and the principal point
/// to a share of the longer side.
fn is_as_given(focal: f64, centre_offset: f64, shown: &Estimate) -> bool {
    let change = |shown: f64| (shown / focal).ln().abs();
    let mut certain = (shown.each_focal.iter()).filter(|(_, sigma)| *sigma <= MAX_PIECE_SIGMA);
    change(shown.intrinsics.focal) <= MAX_FOCAL_CHANGE
        && certain.all(|(focal, _)| change(*focal) <= MAX_PIECE_FOCAL_CHANGE)
        && centre_offset <= MAX_CENTRE_CHANGE
}

/// Whether two terms of distortion hold over the whole image; NaN does not.
fn is_comparable(given: &Camera) -> bool {
    given.horizontal_fov_deg() <= MAX_COMPARED_FOV_DEG
}

/// What the images say against a calibration that was given, in sentences with the better value.
pub fn against_images(input: &Input) -> Vec<String> {
    let (given, direction) = input.lens();
    let size = (given.width, given.height);
    let Some((focal, centre)) = middle(given).filter(|_| is_comparable(given)) else {
        return Vec::new();
    };
    let images = input.images_again().take(MAX_FRAMES);
    let windows = windows_of(images, ((size, direction), input.fixed_mask()), MAX_WINDOWS);
    if windows.is_empty() {
        return Vec::new();
    }
    let mut warnings = Vec::new();
    let shown = estimate(&windows, size, &Expected::ORDINARY, 1.0);
    if is_focal_doubted(focal, &shown) {
        let (low, high) = shown.focal_interval_px();
        warnings.push(format!(
            "the calibration does not fit the images: its focal length is {focal:.1} px, the \
             points say {:.1} px (95 %: {low:.1} to {high:.1}); calibrate anew, or leave it out to \
             have the camera estimated",
            shown.intrinsics.focal
        ));
    }
    let limit_px = MIN_CENTRE_DIFFERENCE * size.0.max(size.1) as f64;
    if (centre - shown.intrinsics.centre).norm() > limit_px {
        let free = estimate(&windows, size, &Expected::ORDINARY, CENTRE_FREEDOM);
        if is_centre_doubted(&centre, &free, limit_px) {
            let better = free.intrinsics.centre;
            warnings.push(format!(
                "the calibration does not fit the images: its principal point is ({:.1}, {:.1}) \
                 px, the points say ({:.1}, {:.1}) px; are cx and cy swapped?",
                centre.x, centre.y, better.x, better.y
            ));
        }
    }
    warnings
}

/// Whether an estimate contradicts a focal length.
fn is_focal_doubted(focal: f64, shown: &Estimate) -> bool {
    let difference = (focal / shown.intrinsics.focal).ln().abs();
    shown.is_determined()
        && difference > MIN_FOCAL_DIFFERENCE.max(MIN_DIFFERENCE_SIGMAS * shown.sigma[0])
}

/// Whether an estimate contradicts a principal point.
fn is_centre_doubted(centre: &Vec2, free: &Estimate, limit_px: f64) -> bool {
    let difference = centre - free.intrinsics.centre;
    let sigma = Vec2::new(free.sigma[3], free.sigma[4]);
    free.is_determined()
        && difference.norm() > limit_px
        && difference.component_div(&sigma).norm() > MIN_DIFFERENCE_SIGMAS
}

/// Focal length in the middle of the image (whatever the model of distortion) and principal point,
/// px.
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
    use super::{
        Estimate, Expected, estimate, is_as_given, is_centre_doubted, is_focal_doubted, middle,
        says_too_little,
    };
    use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2};

    /// An estimate of 500 px as certain as this, with the principal point in the middle.
    fn shown(sigma: f64) -> Estimate {
        let mut estimate = estimate(&[], (640, 480), &Expected::ORDINARY, 1.0);
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
    fn a_map_that_shows_another_camera_has_the_images_asked() {
        let says = |given: f64, offset: f64, each: &[(f64, f64)]| {
            let mut all = shown(0.02);
            all.each_focal = each.to_vec();
            is_as_given(given, offset, &all)
        };
        assert!(says(492.0, 0.027, &[(485.0, 0.04), (515.0, 0.02)]));
        assert!(says(511.0, 0.005, &[(300.0, 0.14)]), "an uncertain piece");
        assert!(!says(340.0, 0.016, &[]) && !says(610.0, 0.013, &[]));
        assert!(!says(500.0, 0.068, &[]));
        let disagree = [(508.0, 0.055), (420.0, 0.084)];
        assert!(!says(505.0, 0.0, &disagree), "pieces that disagree");
    }

    #[test]
    fn the_images_are_asked_where_a_map_leaves_the_camera_open() {
        let mut small = shown(0.07);
        assert!(says_too_little(&small, 1.0) && !says_too_little(&shown(0.03), 0.2));
        small.num_windows = 0;
        assert!(!says_too_little(&small, 1.0) && says_too_little(&small, 0.3));
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
