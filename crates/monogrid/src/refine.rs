//! A camera refined by the map of a first pass over its video.

use crate::config::RunConfig;
use crate::failure::{Classify, Failure};
use crate::input::Input;
use crate::map_camera::{as_calibrated, shown_by_map};
use crate::self_calibration::{Expected, OwnCalibration};
use monogrid_calibration::{Estimate, Intrinsics, Parameters};
use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2};
use monogrid_pipeline::{Reading, read_ahead};
use monogrid_slam::{FrameInput, Slam};
use std::ops::ControlFlow;

/// Frames of the first pass: half a minute of a phone's video, after which more says little more.
const MAX_FRAMES: usize = 900;

/// Keyframes of a piece of the map: the longer, the better does it hold the distortion and the principal point.
const VIEWS_PER_PIECE: usize = 20;

/// How much more freedom the principal point gets than in the first seconds: a map holds it to two or three pixels.
const CENTRE_FREEDOM: f64 = 5.0;

/// Runs through the beginning of a source that can be read again and replaces its camera by what the map shows; where
/// that is too little, the camera stays as it is.
pub fn refine(input: &mut Input, config: &RunConfig) -> Result<(), Failure> {
    eprintln!("a first pass over the video refines the camera");
    let (slam, num_frames) = first_pass(input, config)?;
    let refined = match &input.own_calibration {
        Some(own) => refined_own(&slam, &own.camera, input.size(), num_frames),
        None => refined_given(&slam, input),
    };
    if let Some(refined) = refined {
        input.take_camera(refined);
    }
    Ok(())
}

/// The system after the first frames, and their number.
fn first_pass(input: &Input, config: &RunConfig) -> Result<(Slam, usize), Failure> {
    let mask = input.mask().clone();
    let mut slam = Slam::new(config.slam.clone(), *input.pinhole(), mask, config.seed)
        .map_err(Failure::input)?;
    let mut num_frames = 0;
    let frames = input.source().take(MAX_FRAMES);
    read_ahead(frames, &input.preparation, Reading::default(), |frame| {
        num_frames += 1;
        if let Some(Ok(image)) = frame.image {
            slam.process_frame(FrameInput {
                index: frame.index,
                timestamp_ns: frame.timestamp_ns,
                image,
                seed_depth: None,
            });
        }
        ControlFlow::Continue(())
    })
    .while_running("frames cannot be read")?;
    slam.finish();
    Ok((slam, num_frames))
}

/// All parameters of a camera that was estimated or assumed.
fn refined_own(
    slam: &Slam,
    camera: &Camera,
    working: (usize, usize),
    num_frames: usize,
) -> Option<OwnCalibration> {
    let size = (camera.width, camera.height);
    let factor = working.0 as f64 / size.0 as f64;
    let guess = own_intrinsics(camera).scaled(factor);
    let prior = Expected::ORDINARY.prior(working, CENTRE_FREEDOM);
    let shown = shown_by_map(slam, VIEWS_PER_PIECE, &guess, working, &prior);
    let shown = shown.scaled(1.0 / factor, size);
    let source = format!("estimated from the map of the first {num_frames} frames");
    OwnCalibration::from_determined(&shown, size, &source)
}

/// Focal length and principal point of a camera whose distortion is believed.
fn refined_given(slam: &Slam, input: &Input) -> Option<OwnCalibration> {
    let guess = as_calibrated(slam);
    let size = input.size();
    let mut prior = Expected::ORDINARY.prior(size, CENTRE_FREEDOM);
    let [log_focal, _, _, at_x, at_y] = prior.sigma.into();
    prior.mean = guess.parameters();
    prior.sigma = Parameters::from([log_focal, HELD, HELD, at_x, at_y]);
    let shown = shown_by_map(slam, VIEWS_PER_PIECE, &guess, size, &prior);
    given_as_shown(input.camera(), &guess, &shown, &input.interpretation)
}

/// Standard deviation of a term of distortion that is not refined.
const HELD: f64 = 1e-6;

/// A given camera with the focal length and the principal point changed as the map shows, if it does.
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
    let mut camera = *given;
    let Pinhole { fx, fy, cx, cy } = given.pinhole;
    camera.pinhole = Pinhole::new(
        fx * ratio,
        fy * ratio,
        cx + fx * from_axis.x,
        cy + fy * from_axis.y,
    );
    let percent = |sigma: f64| 196.0 * sigma;
    Some(OwnCalibration {
        camera,
        interpretation: format!(
            "{interpretation}; refined: focal length times {ratio:.4} (95 %: within {:.1} %), principal point ({:.1}, \
             {:.1})",
            percent(shown.sigma[0]),
            camera.pinhole.cx,
            camera.pinhole.cy
        ),
        warnings: Vec::new(),
    })
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
    }
}
