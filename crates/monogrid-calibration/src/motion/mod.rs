//! How a camera moved, as its images show it before anything is mapped.
//!
//! Depth is seen where near things move past far ones. A camera that stands still shows none, and
//! one that only turns neither: every pixel goes where the rotation and the focal length send it,
//! whatever its depth. A map of such images is an invention, however well they are tracked.
//!
//! Corners are followed through [windows](crate::Window) of some views. A window shows **parallax**
//! where even the rotation, focal length and distortion that fit best leave many of its corners
//! elsewhere; few such windows decide that the camera moves, so that ordinary recordings are looked
//! at for some seconds only.

mod turn;

use crate::tracks::{CollectorConfig, TrackCollector, Window};
use monogrid_features::Match;
use monogrid_geometry::median::median;
use monogrid_geometry::{Camera, Vec2};
use monogrid_image::{GrayImage, Mask, Resize, WorkingSize, resize_area, resize_mask};
use turn::{Lens, Turn, best_turn};

/// How a camera moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraMotion {
    /// There is too little that can be followed, or too little motion, to say.
    Unclear,
    /// It stands still, whatever moves before it.
    StandsStill,
    /// It only turns about its centre, or nearly.
    OnlyTurns,
    /// It moves, and near things move past far ones.
    Moves,
}

/// Pixels of an image 640 pixels wide: lengths below are of such images.
const OF_WIDTH: f64 = 640.0;
/// Motion of a corner up to which it stays where it was, px.
const AT_REST: f64 = 1.0;
/// Share of the corners at rest from which a frame shows a camera that stands still: the rest are
/// on what moves before it.
const MIN_AT_REST: f64 = 0.2;
/// Frames after which it can be said that a camera stands still, and the share of them that must
/// say so.
const MIN_STILL_FRAMES: usize = 15;
const MIN_STILL_SHARE: f64 = 0.95;
/// Distance from where a rotation sends a corner up to which the rotation explains it, px. Of pans
/// by hand it explains nine tenths within one; while a camera walks through a room at least a third
/// goes elsewhere.
const EXPLAINED: f64 = 2.0;
/// Shares of the corners of a window from which on a rotation explains it, and up to which it does
/// not.
const MIN_EXPLAINED: f64 = 0.85;
const MAX_EXPLAINED: f64 = 0.7;
/// Fewest corners of a window.
const MIN_MATCHES: usize = 30;
/// Least median motion of a window that a rotation can explain, and of all such windows together
/// before it is said that the camera only turns, shares of the longer side: less shows no depth
/// either, but may have been too short.
const MIN_MOTION: f64 = 0.04;
const MIN_MOTION_OF_ALL: f64 = 0.2;
/// Longest focal length with which turning is recognised, in halves of the longer side. With a
/// longer one, turning looks like moving along a wall: it is taken for that where a longer one
/// explains the corners better by this factor and distance, px.
const MAX_FOCAL: f64 = 8.0;
const BETTER: f64 = 1.5;
const CORNER: f64 = 0.1;
/// Windows explained by a rotation have one focal length: the logarithm of each is so near their
/// median.
const SAME_FOCAL: f64 = 0.5;
/// Share of the windows that a rotation must explain before it is said that the camera only turns.
const MIN_TURNED_SHARE: f64 = 0.75;
/// Windows that show parallax by which it is decided that the camera moves, and the share of all
/// that shows it.
const MIN_PARALLAX: usize = 3;
const MIN_PARALLAX_SHARE: f64 = 0.3;

/// Follows corners through a video to find out how its camera moves.
#[derive(Debug)]
pub struct MotionWatch {
    /// Width and height of the images, and of those in which corners are followed.
    size: (usize, usize),
    reduced: (usize, usize),
    /// The camera, where it is known.
    given: Option<Camera>,
    collector: TrackCollector,
    num_frames: usize,
    num_at_rest: usize,
    /// Windows that a rotation explains: the logarithm of its focal length, and their motion.
    turned: Vec<(f64, f64)>,
    num_parallax: usize,
    num_between: usize,
}

impl MotionWatch {
    /// For images of this size; with the camera where it is known, and corners where the mask (of
    /// their size) is not 0.
    #[must_use]
    pub fn new(size: (usize, usize), given: Option<&Camera>, mask: Option<&Mask>) -> Self {
        let reduced = WorkingSize::AUTOMATIC.resolve(size.0, size.1);
        let (width, height) = reduced;
        let config = CollectorConfig {
            max_points: 200,
            views_per_window: 9,
            min_views: 2,
            ..CollectorConfig::default()
        };
        let mask = mask.map(|mask| resize_mask(mask, Resize { width, height }));
        Self {
            size,
            reduced,
            given: given.copied(),
            collector: TrackCollector::new(config).within(mask),
            num_frames: 0,
            num_at_rest: 0,
            turned: Vec::new(),
            num_parallax: 0,
            num_between: 0,
        }
    }

    /// Takes the next image; one of another size is passed over.
    pub fn add(&mut self, image: &GrayImage) {
        if (image.width(), image.height()) != self.size {
            return;
        }
        let (width, height) = self.reduced;
        self.collector
            .add(&resize_area(image, Resize { width, height }));
        let moves = self.collector.moves();
        if !moves.is_empty() {
            let at_rest = moves.iter().filter(|m| **m <= AT_REST * self.unit());
            let is_at_rest = at_rest.count() as f64 >= MIN_AT_REST * moves.len() as f64;
            self.num_frames += 1;
            self.num_at_rest += usize::from(is_at_rest);
        }
        for window in self.collector.take_windows() {
            self.look(&window);
        }
    }

    /// Whether more images change nothing: the camera moves.
    #[must_use]
    pub fn is_decided(&self) -> bool {
        let all = self.turned.len() + self.num_parallax + self.num_between;
        self.num_parallax >= MIN_PARALLAX
            && self.num_parallax as f64 >= MIN_PARALLAX_SHARE * all as f64
    }

    /// What the images that were seen come to.
    #[must_use]
    pub fn conclusion(mut self) -> CameraMotion {
        let config = CollectorConfig::default();
        let collector = std::mem::replace(&mut self.collector, TrackCollector::new(config));
        for window in collector.finish() {
            self.look(&window);
        }
        if self.stands_still() {
            return CameraMotion::StandsStill;
        }
        if self.is_decided() {
            return CameraMotion::Moves;
        }
        let logs = self.turned.iter().map(|(log_focal, _)| *log_focal);
        let middle = median(&mut logs.collect::<Vec<f64>>()).unwrap_or(0.0);
        let of_one_focal = |(log_focal, _): &&(f64, f64)| (log_focal - middle).abs() < SAME_FOCAL;
        let turned: Vec<&(f64, f64)> = self.turned.iter().filter(of_one_focal).collect();
        let motion: f64 = turned.iter().map(|(_, motion)| motion).sum();
        let seen = self.turned.len() + self.num_parallax + self.num_between;
        let only_turns = turned.len() as f64 >= MIN_TURNED_SHARE * seen as f64;
        match only_turns && motion >= MIN_MOTION_OF_ALL {
            true => CameraMotion::OnlyTurns,
            false if self.turned.is_empty() && self.num_parallax > 0 => CameraMotion::Moves,
            false => CameraMotion::Unclear,
        }
    }

    fn stands_still(&self) -> bool {
        let num = self.num_frames;
        num >= MIN_STILL_FRAMES && self.num_at_rest as f64 >= MIN_STILL_SHARE * num as f64
    }

    /// Length of a pixel of an image 640 pixels wide.
    fn unit(&self) -> f64 {
        self.longer() / OF_WIDTH
    }

    fn longer(&self) -> f64 {
        self.reduced.0.max(self.reduced.1) as f64
    }

    /// What a window shows.
    fn look(&mut self, window: &Window) {
        let lens = self.lens();
        let Some(matches) = farthest(window, |pixel| self.ideal(pixel, &lens)) else {
            return;
        };
        let mut moves: Vec<f64> = matches.iter().map(|m| (m.a - m.b).norm()).collect();
        let within = |lengths: &[f64], px: f64| {
            let num = lengths.iter().filter(|length| **length <= px * self.unit());
            num.count() as f64 / lengths.len().max(1) as f64
        };
        if within(&moves, AT_REST) >= MIN_AT_REST {
            // what moves before a camera at rest is no parallax
            return;
        }
        let motion = median(&mut moves).unwrap_or(0.0) / self.longer();
        // a focal length that is known may be any
        let max_focal = self.given.map_or(MAX_FOCAL, |_| f64::INFINITY);
        let turn = best_turn(&matches, &lens, (max_focal, true));
        let longer = best_turn(&matches, &lens, (max_focal, false));
        let Some(turn) = turn else { return };
        let is_much_better =
            |longer: &Turn| turn.median() > BETTER * longer.median() + CORNER * self.unit();
        let explained = |turn: &Turn| within(&turn.residuals, EXPLAINED);
        let is_turn =
            explained(&turn) >= MIN_EXPLAINED && !longer.as_ref().is_some_and(is_much_better);
        let most = explained(&turn).max(longer.as_ref().map_or(0.0, explained));
        match is_turn {
            true if motion >= MIN_MOTION => self.turned.push((turn.focal.ln(), motion)),
            _ if most <= MAX_EXPLAINED => self.num_parallax += 1,
            _ if motion >= MIN_MOTION => self.num_between += 1,
            _ => {}
        }
    }

    /// What is known of the lens before the window is looked at.
    fn lens(&self) -> Lens {
        let (width, height) = self.reduced;
        let half = self.longer() / 2.0;
        let factor = width as f64 / self.size.0 as f64;
        let centre = Vec2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
        match &self.given {
            Some(camera) => {
                let pinhole = &camera.pinhole;
                let focal = (pinhole.fx * pinhole.fy).sqrt() * factor;
                Lens {
                    centre,
                    half,
                    focals: vec![focal / half],
                    sigma: [0.1, 0.03],
                }
            }
            None => Lens {
                centre,
                half,
                focals: vec![0.7, 1.1, 1.7, 2.6, 4.5, 12.0],
                sigma: [0.4, 0.3],
            },
        }
    }

    /// Where a camera without distortion, with its principal point in the middle, would see what
    /// this pixel shows.
    fn ideal(&self, pixel: &Vec2, lens: &Lens) -> Option<Vec2> {
        let Some(camera) = &self.given else {
            return Some(*pixel);
        };
        let half = Vec2::repeat(0.5);
        let factor = self.size.0 as f64 / self.reduced.0 as f64;
        let ray = camera.unproject(&((pixel + half) * factor - half))?;
        let focal = lens.focals.first()? * lens.half;
        (ray.z > 0.1 * ray.norm()).then(|| ray.xy() * (focal / ray.z) + lens.centre)
    }
}

/// The corners that the first view of a window shares with the last one that still has enough of
/// them.
fn farthest(window: &Window, ideal: impl Fn(&Vec2) -> Option<Vec2>) -> Option<Vec<Match>> {
    (1..window.num_views).rev().find_map(|last| {
        let both = window.tracks.iter().filter_map(|track| {
            let [a, b] = [0, last].map(|view| track.pixel_in(view).and_then(|p| ideal(&p)));
            Some(Match { a: a?, b: b? })
        });
        let both: Vec<Match> = both.collect();
        (both.len() >= MIN_MATCHES).then_some(both)
    })
}

#[cfg(test)]
mod tests;
