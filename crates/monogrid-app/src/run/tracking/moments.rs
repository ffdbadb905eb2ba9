//! Pictures of the source where a run went wrong: its beginning, and what followed each loss.

use crate::input::Input;
use crate::run::tracking::frames::FrameRow;
use monogrid_image::GrayImage;
use monogrid_report::explorer::small_jpeg;
use monogrid_slam::TrackingState;

/// Pictures at most.
const MAX_MOMENTS: usize = 12;
/// Images of a source that shows no depth, and how far they are apart.
const STILL: usize = 3;
const STILL_EVERY: usize = 30;

/// A frame and its picture, JPEG.
pub type Moment = (usize, Vec<u8>);

/// What is kept while frames come.
#[derive(Debug)]
pub struct Moments {
    kept: Vec<Moment>,
    /// Whether the next image is wanted.
    is_due: bool,
    is_lost: bool,
    num_starting: usize,
}

impl Moments {
    /// Before the first frame; a source that is not tracked shows why at once.
    pub fn of(input: &Input) -> Self {
        let mut moments = Self {
            kept: Vec::new(),
            is_due: true,
            is_lost: false,
            num_starting: 0,
        };
        if input.no_map().is_some() {
            let images = input.images_again().enumerate();
            for (index, image) in images.step_by(STILL_EVERY).take(STILL) {
                moments.kept.push((index, picture(&image)));
            }
        }
        moments
    }

    /// Looks at an image before it is tracked.
    pub fn look(&mut self, index: usize, image: &GrayImage) {
        if self.is_due && self.kept.len() < MAX_MOMENTS {
            self.kept.push((index, picture(image)));
        }
        self.is_due = false;
    }

    /// Notes what became of it.
    pub fn note(&mut self, row: &FrameRow) {
        let Some(report) = row.report() else {
            return;
        };
        let is_lost = report.state == TrackingState::Lost;
        self.is_due |= is_lost && !self.is_lost;
        self.is_lost = is_lost;
        if report.state == TrackingState::Initialising {
            // ever more rarely
            self.num_starting += 1;
            self.is_due |= self.num_starting >= 16 && self.num_starting.is_power_of_two();
        }
    }

    /// After the last frame.
    pub fn finish(self) -> Vec<Moment> {
        self.kept
    }
}

fn picture(image: &GrayImage) -> Vec<u8> {
    small_jpeg(&image.map(|grey| grey.clamp(0.0, 255.0) as u8))
}
