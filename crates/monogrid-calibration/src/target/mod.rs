//! Calibration with a target: a chessboard, or a grid of AprilTags, that is shown to the camera
//! from many sides.
//!
//! [`BoardCollector`] finds the board in the images of a video and keeps views that differ;
//! [`calibrate`] finds the camera that sees all of them with the least error, as a pinhole with
//! radial and tangential distortion, or as an equidistant lens.

mod board;
mod family;
mod fit;
mod tags;

pub use board::{BoardSize, BoardView, find_board};
pub use fit::LensModel;
pub use tags::{TagGrid, find_tags};

use fit::{Fit, fit, on_board};
use monogrid_geometry::median::median;
use monogrid_geometry::{Camera, Vec2};
use monogrid_image::GrayImage;
use std::collections::BTreeMap;

/// Settings of [`BoardCollector`] and [`calibrate`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetConfig {
    /// Inner corners of the board; none takes the size that most images show. Of no meaning for
    /// tags.
    pub board: Option<BoardSize>,
    /// The grid of tags, which may be seen in part; none looks for a chessboard.
    pub tags: Option<TagGrid>,
    /// Lens model; none takes radial and tangential distortion, or the equidistant model where its
    /// error is clearly smaller.
    pub model: Option<LensModel>,
    /// Views that are used at most. Range 3..; default 40.
    pub max_views: usize,
    /// Mean distance of the corners between two views that are both used, as a share of the image's
    /// longer side. Range 0..1; default 0.01.
    pub min_change: f64,
    /// Mean distance of the corners to those of the image before, up to which the board holds
    /// still: blur and rolling shutter bend it else, as a share of the image's longer side. Range
    /// above 0; default 0.005.
    pub max_motion: f64,
    /// Views whose error is this many times that of the median view are left out. Range 1..;
    /// default 3.
    pub max_error_ratio: f64,
}

impl Default for TargetConfig {
    fn default() -> Self {
        Self {
            board: None,
            tags: None,
            model: None,
            max_views: 40,
            min_change: 0.01,
            max_motion: 0.005,
            max_error_ratio: 3.0,
        }
    }
}

/// Fewest views of a calibration.
const MIN_VIEWS: usize = 4;

/// Largest standard deviation of a focal length that is determined, relative.
const MAX_FOCAL_SIGMA: f64 = 0.02;

/// By which factor the error of the equidistant model must be smaller: for ordinary lenses both say
/// the same.
const EQUIDISTANT_CHARGE: f64 = 1.05;

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TargetError {
    /// No image shows a board.
    #[error(
        "none of {num_images} images shows a whole chessboard; expected one of black and white \
         squares with a white border, all of it in view, sharp and evenly lit"
    )]
    NoBoard {
        /// Images that were looked at.
        num_images: usize,
    },
    /// No image shows enough of a grid of tags.
    #[error(
        "none of {num_images} images shows four tags of a grid of {expected}; expected AprilTags \
         of the family 36h11, numbered row by row from 0, with small black squares between their \
         corners, sharp and evenly lit"
    )]
    NoTags {
        /// Images that were looked at.
        num_images: usize,
        /// What was asked for.
        expected: BoardSize,
    },
    /// The images show a board of another size.
    #[error(
        "found a board of {found} inner corners in {num_found} of {num_images} images, expected \
         {expected}; count the places where four squares meet (one less than squares on each \
         side), or leave the size out"
    )]
    OtherBoard {
        /// What most images show.
        found: BoardSize,
        /// In how many.
        num_found: usize,
        /// Images that were looked at.
        num_images: usize,
        /// What was asked for.
        expected: BoardSize,
    },
    /// Too few views that differ.
    #[error(
        "found {found} different views of the board, expected at least {MIN_VIEWS}; show it from \
         more sides, tilted by some 30 degrees each way, and hold still for a moment in each"
    )]
    FewViews {
        /// Views found.
        found: usize,
    },
    /// The views leave the camera open.
    #[error(
        "the views of the board do not determine the focal length (uncertain by {:.0} %, expected \
         at most 2 %); tilt the board by some 30 degrees each way", 100.0 * relative_sigma
    )]
    NotDetermined {
        /// Relative standard deviation of the focal length.
        relative_sigma: f64,
    },
}

/// Finds a board in images and keeps views that differ.
#[derive(Clone, Debug)]
pub struct BoardCollector {
    config: TargetConfig,
    num_images: usize,
    num_of_size: BTreeMap<BoardSize, usize>,
    before: Option<BoardView>,
    kept: Vec<BoardView>,
}

impl BoardCollector {
    /// An empty collector.
    #[must_use]
    pub fn new(config: TargetConfig) -> Self {
        Self {
            config,
            num_images: 0,
            num_of_size: BTreeMap::new(),
            before: None,
            kept: Vec::new(),
        }
    }

    /// Looks for the board in the next image (grey, 0 to 255).
    pub fn add(&mut self, image: &GrayImage) {
        let longer = image.width().max(image.height()) as f64;
        self.num_images += 1;
        let before = self.before.take();
        let found = match &self.config.tags {
            Some(grid) => find_tags(image, grid),
            None => find_board(image),
        };
        let Some(view) = found else {
            return;
        };
        *self.num_of_size.entry(view.size).or_default() += 1;
        let distance = |other: &BoardView| mean_distance(&view, other) / longer;
        let is_still = before.is_none_or(|before| distance(&before) <= self.config.max_motion);
        let least = self.config.min_change;
        let is_new = self.kept.iter().all(|kept| distance(kept) >= least);
        if is_still && is_new {
            self.kept.push(view.clone());
        }
        self.before = Some(view);
    }

    /// The views of the board, at most as many as are used, evenly over the video.
    ///
    /// # Errors
    /// No board, one of another size, or too few views.
    pub fn finish(self) -> Result<Vec<BoardView>, TargetError> {
        let most = self.num_of_size.iter().max_by_key(|(_, count)| **count);
        let num_images = self.num_images;
        let Some((&found, &num_found)) = most else {
            return Err(match self.config.tags {
                Some(TagGrid { size: expected, .. }) => TargetError::NoTags {
                    num_images,
                    expected,
                },
                None => TargetError::NoBoard { num_images },
            });
        };
        let asked = self.config.board.filter(|_| self.config.tags.is_none());
        let wanted = asked.unwrap_or(found);
        if !self.num_of_size.contains_key(&wanted) {
            return Err(TargetError::OtherBoard {
                found,
                num_found,
                num_images,
                expected: wanted,
            });
        }
        let mut views: Vec<BoardView> = self.kept;
        views.retain(|view| view.size == wanted);
        let step = views.len().div_ceil(self.config.max_views.max(1)).max(1);
        Ok(views.into_iter().step_by(step).collect())
    }
}

/// Mean distance of the corners that two views share, px; infinite where they share none. A
/// chessboard may have been turned by half a turn.
fn mean_distance(a: &BoardView, b: &BoardView) -> f64 {
    if a.size != b.size {
        return f64::INFINITY;
    }
    let far = Vec2::new(a.size.columns as f64 - 1.0, a.size.rows as f64 - 1.0);
    let mean = |place_in_b: &dyn Fn(&Vec2) -> Vec2| {
        let (mut sum, mut count) = (0.0, 0.0);
        for (place, pixel) in a.places.iter().zip(&a.corners) {
            let place = place_in_b(place);
            if let Some(k) = b.places.iter().position(|p| (p - place).norm() < 1e-6) {
                sum += (b.corners[k] - pixel).norm();
                count += 1.0;
            }
        }
        if count > 0.0 {
            sum / count
        } else {
            f64::INFINITY
        }
    };
    let is_whole = a.corners.len() == a.size.columns * a.size.rows;
    let turned = if is_whole {
        mean(&|place| far - place)
    } else {
        f64::INFINITY
    };
    mean(&|place| *place).min(turned)
}

/// A corner of the board in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerError {
    /// Where the image shows it, px.
    pub pixel: Vec2,
    /// From there to where the camera found sees it, px.
    pub error: Vec2,
}

/// A camera found with a target.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetCalibration {
    /// The camera.
    pub camera: Camera,
    /// How its lens is described.
    pub model: LensModel,
    /// The board.
    pub board: BoardSize,
    /// Views that were used, and given.
    pub num_views: (usize, usize),
    /// Root of the mean squared distance between a corner and where it should be, px.
    pub rms_px: f64,
    /// The same of the other model, where it was tried.
    pub other_rms_px: Option<f64>,
    /// Standard deviations of `fx fy cx cy`, px.
    pub sigma_px: [f64; 4],
    /// All corners of all views used.
    pub errors: Vec<CornerError>,
}

/// The camera that sees the views of one board, in images of `size` (width, height).
///
/// # Errors
/// Too few views, or views that leave the focal length open.
pub fn calibrate(
    views: &[BoardView],
    size: (usize, usize),
    config: &TargetConfig,
) -> Result<TargetCalibration, TargetError> {
    let too_few = TargetError::FewViews { found: views.len() };
    let board = views.first().map(|view| view.size).ok_or(too_few.clone())?;
    if views.len() < MIN_VIEWS {
        return Err(too_few);
    }
    let models = match config.model {
        Some(model) => vec![model],
        None => vec![LensModel::RadialTangential, LensModel::Equidistant],
    };
    let fit = |model| Candidate::of(views, size, model, config);
    let mut fits: Vec<Candidate> = models.into_iter().filter_map(fit).collect();
    // the simpler files and the first of both models unless the other explains clearly more
    fits.sort_by(|a, b| a.charged_px().total_cmp(&b.charged_px()));
    let not_determined = |relative_sigma| TargetError::NotDetermined { relative_sigma };
    let best = fits.first().ok_or(not_determined(f64::INFINITY))?;
    let (pinhole, sigma_px) = (best.fit.camera.pinhole, best.fit.sigma_px);
    let relative_sigma = (sigma_px[0] / pinhole.fx).max(sigma_px[1] / pinhole.fy);
    if relative_sigma.is_nan() || relative_sigma > MAX_FOCAL_SIGMA {
        return Err(not_determined(relative_sigma));
    }
    Ok(TargetCalibration {
        camera: best.fit.camera,
        model: best.fit.model,
        board,
        num_views: (best.views.len(), views.len()),
        rms_px: best.rms_px(),
        other_rms_px: fits.get(1).map(Candidate::rms_px),
        sigma_px,
        errors: best.errors().into_iter().flatten().collect(),
    })
}

/// A model with the camera found, and the views that it explains.
struct Candidate {
    fit: Fit,
    views: Vec<BoardView>,
}

impl Candidate {
    /// Fits all views, leaves out those that do not fit, and fits the others once more.
    fn of(
        views: &[BoardView],
        size: (usize, usize),
        model: LensModel,
        config: &TargetConfig,
    ) -> Option<Self> {
        let first = Self {
            fit: fit(views, size, model)?,
            views: views.to_vec(),
        };
        let rms: Vec<f64> = first.errors().iter().map(|errors| rms_of(errors)).collect();
        let limit = config.max_error_ratio * median(&mut rms.clone())?;
        let good = views.iter().zip(&rms).filter(|(_, rms)| **rms <= limit);
        let good: Vec<BoardView> = good.map(|(view, _)| view.clone()).collect();
        if good.len() == views.len() || good.len() < MIN_VIEWS {
            return Some(first);
        }
        Some(Self {
            fit: fit(&good, size, model)?,
            views: good,
        })
    }

    /// Per view what is left between its corners and the camera; a corner that the camera cannot
    /// see is left out.
    fn errors(&self) -> Vec<Vec<CornerError>> {
        let of_view = |view: &BoardView, pose: &monogrid_geometry::Se3| {
            let corners = view.corners.iter().enumerate();
            let error = |(k, pixel): (usize, &Vec2)| {
                let seen = self.fit.camera.project(&(*pose * on_board(view, k)))?;
                Some(CornerError {
                    pixel: *pixel,
                    error: seen - pixel,
                })
            };
            corners.filter_map(error).collect()
        };
        let views = self.views.iter().zip(&self.fit.poses);
        views.map(|(view, pose)| of_view(view, pose)).collect()
    }

    /// Its error, with what the equidistant model must be better by.
    fn charged_px(&self) -> f64 {
        match self.fit.model {
            LensModel::RadialTangential => self.rms_px(),
            LensModel::Equidistant => self.rms_px() * EQUIDISTANT_CHARGE,
        }
    }

    fn rms_px(&self) -> f64 {
        rms_of(&self.errors().concat())
    }
}

fn rms_of(errors: &[CornerError]) -> f64 {
    let sum: f64 = errors.iter().map(|e| e.error.norm_squared()).sum();
    (sum / errors.len().max(1) as f64).sqrt()
}
