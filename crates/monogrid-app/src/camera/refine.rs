//! A camera refined by the map of a first pass over its video.

use crate::camera::map_camera::{HELD, LEFT_RADIAL, TakenOut, as_calibrated, shown_by_map};
use crate::camera::self_calibration::{Expected, OwnCalibration};
use crate::config::RunConfig;
use crate::input::Input;
use crate::process::console::is_drawn;
use crate::process::failure::{Classify, Failure};
use crate::process::interrupt::is_interrupted;
use crate::process::talk;
use crate::run::tracking::progress::watched;
use monogrid_calibration::{Estimate, Intrinsics, Parameters};
use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2};
use monogrid_pipeline::{ReadFrame, ReadOn, Reading, SourceFrame, read_ahead};
use monogrid_slam::{FrameInput, Slam};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Length of the first pass: half a minute, after which more says little more, of a video with many
/// frames per second too; where there are few, as many as half a minute has at 30 per second.
const MAX_LENGTH_NS: i64 = 30_000_000_000;
const MIN_FRAMES: usize = 900;
const MAX_FRAMES: usize = 1800;

/// Keyframes of a piece of the map: the longer, the better does it hold the distortion and the
/// principal point.
const VIEWS_PER_PIECE: usize = 20;

/// How much more freedom the principal point gets than in the first seconds: a map holds it to two
/// or three pixels.
const CENTRE_FREEDOM: f64 = 5.0;

/// Runs through the beginning of a source that can be read again and replaces its camera by what
/// the map shows; where that is too little, the camera stays as it is.
pub fn refine(input: &mut Input, config: &RunConfig) -> Result<(), Failure> {
    eprintln!("a first pass over the video refines the camera");
    talk::doing("what the images show of the rolling shutter");
    if input.own_calibration.is_none()
        && input.preparation.readout_ms() == 0.0
        && let Some(readout_ms) = shown_readout_ms(input)
    {
        input.preparation = input.preparation.clone().with_readout_ms(readout_ms);
    }
    let (mut slam, posed) = first_pass(input, config, MAX_FRAMES)?;
    let num_frames = posed.len();
    if is_interrupted() {
        return Ok(());
    }
    talk::doing("the map of the first pass is adjusted");
    slam.finish();
    let preparation = &input.preparation;
    let taken_out = TakenOut::always(preparation.readout_ms(), preparation.readout_direction());
    let refined = match &input.own_calibration {
        Some(own) => refined_own((&slam, &taken_out), &own.camera, input, num_frames),
        None => refined_given((&slam, &taken_out), input),
    };
    let Some(refined) = refined else {
        return Ok(());
    };
    let before = input.known_camera();
    input.take_camera(refined.reading_for(input.preparation.readout_ms()));
    let num_frames = num_to_compare(&posed);
    let (_, again) = first_pass(input, config, num_frames)?;
    if !is_interrupted() && !tracks_as_well(&posed[..num_frames], &again) {
        let [with, without] = [&again, &posed[..num_frames]].map(num_posed);
        input.return_to_camera(before);
        input.warnings.push(format!(
            "with the camera that the first pass shows tracking went worse ({with} of the first \
             {num_frames} frames have a pose, {without} without it): the camera is that from before"
        ));
    }
    Ok(())
}

/// Frames behind the first one with a pose that are tracked again with another camera, to see that
/// it takes nothing away.
const COMPARED_FRAMES: usize = 60;
/// Least share of the poses that another camera must leave.
const MIN_KEPT: f64 = 0.7;

/// How many frames from the first one on are tracked again: until some time after tracking began.
fn num_to_compare(posed: &[bool]) -> usize {
    let first = posed.iter().position(|posed| *posed).unwrap_or(0);
    posed.len().min(first + COMPARED_FRAMES)
}

/// Whether another camera has about as many poses in the same frames.
fn tracks_as_well(before: &[bool], again: &[bool]) -> bool {
    num_posed(again) as f64 >= MIN_KEPT * num_posed(before) as f64
}

fn num_posed(posed: &[bool]) -> usize {
    posed.iter().filter(|posed| **posed).count()
}

/// The rolling shutter that the images show, ms.
fn shown_readout_ms(input: &Input) -> Option<f64> {
    let (camera, direction) = input.lens();
    let shape = ((camera.width, camera.height), direction);
    let images = input.timed_images_again();
    let shape = (shape, input.fixed_mask());
    let shown = OwnCalibration::from_images(images, shape, &Expected::ORDINARY);
    shown.ok()?.readout_ms
}

/// The system after the first frames, not finished yet, and which of them had a pose when they were
/// tracked.
fn first_pass(
    input: &Input,
    config: &RunConfig,
    max_frames: usize,
) -> Result<(Slam, Vec<bool>), Failure> {
    let mask = input.mask().clone();
    let mut slam = Slam::new(config.slam.clone(), *input.pinhole(), mask, config.seed)
        .map_err(Failure::input)?;
    let mut posed = Vec::new();
    let frames = beginning(input.source(None)).take(max_frames);
    let total = input.expected_frames().unwrap_or(0).min(max_frames);
    let mut take = |done: &AtomicUsize, frame: ReadFrame| {
        if is_interrupted() {
            return ControlFlow::Break(());
        }
        done.fetch_add(1, Ordering::Relaxed);
        let report = frame.image.and_then(Result::ok).map(|image| {
            slam.process_frame(FrameInput {
                index: frame.index,
                timestamp_ns: frame.timestamp_ns,
                image,
                depth: None,
            })
        });
        posed.push(report.is_some_and(|report| report.world_from_camera.is_some()));
        ControlFlow::Continue(ReadOn::AsBefore)
    };
    let what = ("first pass", "frames", total);
    let is_terminal = is_drawn();
    let read = watched(
        what,
        is_terminal,
        || {},
        |done| {
            read_ahead(frames, &input.preparation, Reading::default(), |frame| {
                take(done, frame)
            })
        },
    );
    read.while_running("frames cannot be read")?;
    Ok((slam, posed))
}

/// The frames of the first pass.
fn beginning(
    source: impl Iterator<Item = SourceFrame> + Send,
) -> impl Iterator<Item = SourceFrame> + Send {
    let mut first_ns = None;
    let is_early = move |(number, frame): &(usize, SourceFrame)| {
        let first_ns = *first_ns.get_or_insert(frame.timestamp_ns);
        *number < MIN_FRAMES || frame.timestamp_ns.saturating_sub(first_ns) <= MAX_LENGTH_NS
    };
    let numbered = source.take(MAX_FRAMES).enumerate();
    numbered.take_while(is_early).map(|(_, frame)| frame)
}

/// All parameters of a camera that was estimated or assumed.
fn refined_own(
    (slam, taken_out): (&Slam, &TakenOut),
    camera: &Camera,
    input: &Input,
    num_frames: usize,
) -> Option<OwnCalibration> {
    let working = input.size();
    let size = (camera.width, camera.height);
    let factor = working.0 as f64 / size.0 as f64;
    let guess = own_intrinsics(camera).scaled(factor);
    let picture = input.fixed.as_ref().map(|fixed| fixed.picture);
    let expected = Expected::ORDINARY.within(picture, size);
    let prior = expected.prior(working, CENTRE_FREEDOM);
    let shown = shown_by_map(slam, VIEWS_PER_PIECE, &guess, (working, &prior), taken_out);
    let shown = shown.scaled(1.0 / factor, size);
    let source = format!("estimated from the map of the first {num_frames} frames");
    OwnCalibration::from_determined(&shown, size, &source)
}

/// Focal length, principal point and one term of distortion of a camera that was given.
fn refined_given((slam, taken_out): (&Slam, &TakenOut), input: &Input) -> Option<OwnCalibration> {
    let guess = as_calibrated(slam);
    let size = input.size();
    let mut prior = Expected::ORDINARY.prior(size, CENTRE_FREEDOM);
    let [log_focal, _, _, at_x, at_y, readout] = prior.sigma.into();
    let radial = match input.camera().distortion {
        Distortion::None | Distortion::RadialTangential { .. } => LEFT_RADIAL,
        _ => HELD,
    };
    prior.mean = guess.parameters();
    prior.sigma = Parameters::from([log_focal, radial, HELD, at_x, at_y, readout]);
    let shown = shown_by_map(slam, VIEWS_PER_PIECE, &guess, (size, &prior), taken_out);
    given_as_shown(input.camera(), &guess, &shown, &input.interpretation)
}

/// A given camera with the focal length, the principal point and the radial distortion changed as
/// the map shows, if it does.
fn given_as_shown(
    given: &Camera,
    guess: &Intrinsics,
    shown: &Estimate,
    interpretation: &str,
) -> Option<OwnCalibration> {
    if !shown.is_determined() {
        return None;
    }
    let ratio = shown.intrinsics.focal / guess.focal;
    let from_axis = (shown.intrinsics.centre - guess.centre) / guess.focal;
    let [left, _] = shown.intrinsics.radial;
    let mut camera = *given;
    camera.distortion = two_lenses(given.distortion, ratio, left);
    let Pinhole { fx, fy, cx, cy } = given.pinhole;
    let shift = from_axis * given.distortion.enlargement_on_axis();
    camera.pinhole = Pinhole::new(fx * ratio, fy * ratio, cx + fx * shift.x, cy + fy * shift.y);
    let percent = |sigma: f64| 196.0 * sigma;
    Some(OwnCalibration {
        camera,
        readout_ms: None,
        interpretation: format!(
            "{interpretation}; refined: focal length times {ratio:.4} (95 %: within {:.1} %), \
             principal point ({:.1}, {:.1}), radial distortion {left:+.4} (95 %: within {:.4})",
            percent(shown.sigma[0]),
            camera.pinhole.cx,
            camera.pinhole.cy,
            1.96 * shown.sigma[1]
        ),
        is_assumed: false,
        focal_sigma: Some(shown.sigma[0]),
        warnings: Vec::new(),
    })
}

/// The distortion of a lens before which there is another: that one enlarges by `ratio` and has the
/// radial term `left`. Up to the fourth power of the radius; a model that knows no radial terms
/// stays.
fn two_lenses(given: Distortion, ratio: f64, left: f64) -> Distortion {
    let (k1, k2, p1, p2, k3) = match given {
        Distortion::None => (0.0, 0.0, 0.0, 0.0, 0.0),
        Distortion::RadialTangential { k1, k2, p1, p2, k3 } => (k1, k2, p1, p2, k3),
        _ => return given,
    };
    let squared = ratio * ratio;
    Distortion::RadialTangential {
        k1: squared * k1 + left,
        k2: squared * (squared * k2 + 3.0 * k1 * left),
        p1: ratio * p1,
        p2: ratio * p2,
        k3: squared.powi(3) * k3,
    }
}

/// The parameters of a camera that was estimated or assumed.
fn own_intrinsics(camera: &Camera) -> Intrinsics {
    let Pinhole { fx, cx, cy, .. } = camera.pinhole;
    Intrinsics {
        focal: fx,
        centre: Vec2::new(cx, cy),
        radial: match camera.distortion {
            Distortion::RadialTangential { k1, k2, .. } => [k1, k2],
            _ => [0.0; 2],
        },
        readout: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::{beginning, num_to_compare, tracks_as_well, two_lenses};
    use monogrid_geometry::{Distortion, Vec2};
    use monogrid_pipeline::{SourceFrame, Unusable};

    #[test]
    fn a_camera_that_takes_the_start_away_does_not_track_as_well() {
        let posed = |first: usize, num: usize| {
            let posed = (0..200).map(|k| (first..first + num).contains(&k));
            posed.collect::<Vec<bool>>()
        };
        let before = posed(30, 170);
        let num = num_to_compare(&before);
        assert_eq!(num, 90);
        assert!(tracks_as_well(&before[..num], &before[..num]));
        assert!(tracks_as_well(&before[..num], &posed(40, 160)[..num]));
        assert!(!tracks_as_well(&before[..num], &posed(0, 0)[..num]));
        assert!(!tracks_as_well(&before[..num], &posed(30, 20)[..num]));
        // where there was no start before, nothing is taken away
        assert!(tracks_as_well(&posed(0, 0), &posed(0, 0)));
    }

    #[test]
    fn the_first_pass_is_half_a_minute_long() {
        let count = |per_second: i64| {
            let frames = (0..5000i64).map(move |k| SourceFrame {
                index: k as usize,
                timestamp_ns: 7 + k * 1_000_000_000 / per_second,
                image: Err(Unusable::Repeats),
                depth: None,
            });
            beginning(frames).count()
        };
        assert_eq!([10, 30, 48, 240].map(count), [900, 901, 1441, 1800]);
    }

    #[test]
    fn a_lens_before_a_lens_is_both_in_turn() {
        let given = Distortion::RadialTangential {
            k1: -0.21,
            k2: 0.05,
            p1: 0.001,
            p2: -0.002,
            k3: -0.01,
        };
        let (ratio, left) = (1.02, 0.02);
        for (given, bound) in [(Distortion::None, 1e-12), (given, 1e-4)] {
            let both = two_lenses(given, ratio, left);
            for ideal in [Vec2::new(0.3, -0.2), Vec2::new(-0.1, 0.45), Vec2::zeros()] {
                let seen = ideal * (ratio * (1.0 + left * ideal.norm_squared()));
                let expected = given.distort(&seen).unwrap();
                let found = both.distort(&ideal).unwrap() * ratio;
                assert!((found - expected).norm() < bound, "{given:?} {ideal}");
            }
        }
        let fisheye = Distortion::Equidistant {
            k: [0.1, 0.0, 0.0, 0.0],
        };
        assert_eq!(two_lenses(fisheye, ratio, left), fisheye);
    }
}
