//! Depth from the two images of a stereo pair, which are taken at once.

use super::sweep::CostVolume;
use super::warp::Source;
use super::winner::winners;
use super::{DenseConfig, DenseDepth, MIN_EDGE_PX};
use crate::MeasuredDepth;
use crate::multi_view::SourceView;
use monogrid_geometry::{Pinhole, Se3, Sim3, Vec2};
use monogrid_image::{GrayImage, Image, half_size, to_gray8};

/// Standard deviation of a disparity, px.
const DISPARITY_SIGMA_PX: f64 = 0.35;
/// Disparities that are looked for, px of the half image: the nearest surface is seen with the
/// largest.
const MAX_DISPARITY_PX: usize = 80;
/// How far the disparities of a point in both images may differ, px of the half image.
const MAX_DIFFERENCE_PX: f32 = 1.0;

impl MeasuredDepth {
    /// Depth in the first image of a stereo pair, in metres: semi-global matching (`[SGM08]`) of
    /// both images at half their size, as far as both find the same.
    ///
    /// Both images are of the size and of the `camera` of the first; `second_from_first` has its
    /// translation in metres. Nothing is known where the images are too small or of two sizes, or
    /// the cameras at one place.
    #[must_use]
    pub fn of_pair(
        [first, second]: [&GrayImage; 2],
        camera: &Pinhole,
        second_from_first: &Se3,
    ) -> Self {
        let mut depth = Image::filled(first.width(), first.height(), f32::NAN);
        let images = [first.map(to_gray8), second.map(to_gray8)];
        let pose = Sim3::from(*second_from_first);
        let pair = Pair {
            images: [&images[0], &images[1]],
            camera: camera.half(),
            second_from_first: pose,
        };
        let is_large = first.width().min(first.height()) >= 2 * MIN_EDGE_PX;
        let step = pair.step().filter(|_| is_large && first.same_size(second));
        let Some(step) = step else {
            return Self::new(&depth, 1.0);
        };
        let of_first = pair.depth(step);
        let of_second = pair.swapped().depth(step);
        let both = of_first.seen_by(&of_second, &pair, MAX_DIFFERENCE_PX * step);
        // two pixels of the full image are one of the half image
        let sigma = (0.5 * DISPARITY_SIGMA_PX * f64::from(step)) as f32;
        for y in 0..2 * both.idepth.height() {
            for x in 0..2 * both.idepth.width() {
                if let Some(idepth) = both.at_full_size(x, y) {
                    depth.set(x, y, 1.0 / idepth);
                }
            }
        }
        Self::new(&depth, sigma)
    }
}

/// Two images and how they were taken.
struct Pair<'a> {
    images: [&'a Image<u8>; 2],
    /// That of the half images.
    camera: Pinhole,
    second_from_first: Sim3,
}

impl Pair<'_> {
    fn swapped(&self) -> Self {
        Self {
            images: [self.images[1], self.images[0]],
            second_from_first: self.second_from_first.inverse(),
            ..*self
        }
    }

    /// The change of inverse depth, 1/m, by which a match moves by a pixel of the half image;
    /// `None` for two cameras at one place.
    fn step(&self) -> Option<f32> {
        let baseline = self.second_from_first.inverse().translation;
        // motion along the line of sight moves no match in the middle of the image
        let across = baseline.xy().norm() * self.camera.fx;
        (across > 1e-6).then(|| (1.0 / across) as f32)
    }

    /// Depth of the first image at half its size.
    fn depth(&self, step: f32) -> DenseDepth {
        let half = half_size(&self.images[0].map(f32::from));
        let source = SourceView {
            image: self.images[1],
            source_from_keyframe: self.second_from_first,
        };
        let sources = [Source::new(&source, &self.camera)];
        let planes = (0..=MAX_DISPARITY_PX).map(|k| k as f32 * step).collect();
        let volume = CostVolume::new(self.images[0], &sources, planes);
        winners(&volume, &half, &DenseConfig::default())
    }
}

impl DenseDepth {
    /// What of the first image's depth the second image has too, within this difference of the
    /// inverse depths.
    fn seen_by(mut self, second: &Self, pair: &Pair<'_>, max_difference: f32) -> Self {
        let (width, height) = (self.idepth.width(), self.idepth.height());
        for y in 0..height {
            for x in 0..width {
                let idepth = self.idepth.at(x, y);
                if idepth <= 0.0 {
                    continue;
                }
                let ray = pair.camera.unproject(&Vec2::new(x as f64, y as f64));
                let point = pair.second_from_first * (ray / f64::from(idepth));
                let seen = second.at_point(&point, &pair.camera);
                let is_seen =
                    seen.is_some_and(|d| (d - 1.0 / point.z as f32).abs() <= max_difference);
                if !is_seen {
                    self.idepth.set(x, y, 0.0);
                }
            }
        }
        self
    }
}
