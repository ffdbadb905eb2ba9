//! A rolling shutter that nobody told of, found in the map while a run goes on.
//!
//! The points of the map are seen from many keyframes. Where rows are read one after the other,
//! each of them is off by what the image moves in the time between its row and the middle one,
//! which no pose explains. From eight keyframes on that shows how long the camera takes; from then
//! on images are rectified as they are read.

use crate::camera::map_camera::{TakenOut, as_calibrated, readout_ms_by_map};
use crate::input::{Images, Input};
use monogrid_pipeline::ReadOn;
use monogrid_slam::Slam;

/// Keyframes after which the map is asked for the first time; then whenever they have doubled:
/// points that the shutter bends most are not in the map before it is taken out, so that the first
/// answers are two thirds of what there is.
const FIRST_AT: usize = 8;

/// A change that is too small to matter, ms: a tenth of a pixel at the border of an image that
/// moves by ten from frame to frame.
const MIN_CHANGE_MS: f64 = 1.0;

/// Looks for a rolling shutter in the map of a run.
#[derive(Debug)]
pub struct ShutterSearch {
    /// Whether nobody said what the camera does.
    is_on: bool,
    /// Keyframes at which the map is asked next.
    next_at: usize,
    /// Time from the first row to the last as far as it is known, ms: what is wanted of the reader.
    pub wanted_ms: f64,
    /// What was taken out of each frame.
    pub taken_out: TakenOut,
}

impl ShutterSearch {
    /// Before the first frame. Nothing is looked for where the shutter was given, or known with the
    /// camera.
    pub fn new(input: &Input) -> Self {
        let is_rendered = matches!(input.images, Images::Rendered(_));
        let known_ms = input.preparation.readout_ms();
        Self {
            is_on: !input.is_shutter_known && !is_rendered,
            next_at: FIRST_AT,
            wanted_ms: known_ms,
            taken_out: TakenOut::always(known_ms, input.preparation.readout_direction()),
        }
    }

    /// How to read on after a frame; there are as many keyframes now.
    pub fn after_frame(&mut self, slam: &Slam, num_keyframes: usize) -> ReadOn {
        if !self.is_on || num_keyframes < self.next_at {
            return ReadOn::AsBefore;
        }
        self.next_at = 2 * num_keyframes;
        let shown = readout_ms_by_map(slam, &as_calibrated(slam), &self.taken_out);
        match shown.filter(|ms| (ms - self.wanted_ms).abs() >= MIN_CHANGE_MS) {
            Some(readout_ms) => {
                self.wanted_ms = readout_ms;
                ReadOn::Rectified { readout_ms }
            }
            None => ReadOn::AsBefore,
        }
    }

    /// After the last frame: what was found, in a sentence.
    pub fn conclusion(&self) -> Option<String> {
        let found_ms = self.wanted_ms;
        (self.is_on && found_ms != 0.0).then(|| {
            format!(
                "the camera has a rolling shutter of about {found_ms:.0} ms, which was taken out \
                 of the images from frame {} on; with --rolling-shutter {found_ms:.0} it is from \
                 the first one on",
                self.taken_out.first_changed().unwrap_or_default()
            )
        })
    }
}
