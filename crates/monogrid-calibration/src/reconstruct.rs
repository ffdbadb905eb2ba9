//! The scene of a window under a guess of the camera: two views, then one view at a time.

use crate::adjust::{Scene, Sighting};
use crate::intrinsics::Intrinsics;
use crate::tracks::Window;
use crate::triangulation::{View, triangulate};
use monogrid_features::{
    AbsolutePoseConfig, Match, PointPixel, TwoViewConfig, TwoViewOutcome, absolute_pose, two_view,
};
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};

/// Fewest corners that two views must share.
const MIN_SHARED: usize = 40;

/// Largest error of a corner that belongs to the scene, px. A wrong guess of the camera bends it.
const MAX_ERROR_PX: f64 = 4.0;

/// Smallest angle between the rays to a point, degrees.
const MIN_PARALLAX_DEG: f64 = 1.0;

/// Fewest points of a scene that is believed.
const MIN_POINTS: usize = 40;

/// Reconstructs a window; `None` where two views determine no motion or too little fits together.
pub(crate) fn reconstruct(window: &Window, guess: &Intrinsics, seed: u64) -> Option<Scene> {
    let mut growing = Growing::new(window, guess, seed);
    let second = growing.begin()?;
    for view in 1..window.num_views {
        if view > second {
            growing.triangulate();
        }
        growing.add_view(view);
    }
    growing.triangulate();
    growing.finish()
}

struct Growing<'a> {
    window: &'a Window,
    guess: &'a Intrinsics,
    pinhole: Pinhole,
    seed: u64,
    /// Per track its pixels without distortion.
    undistorted: Vec<Vec<(usize, Vec2)>>,
    /// Per view its `camera_from_world`, where it is known.
    poses: Vec<Option<Se3>>,
    /// Per track its place in the world, where it is known.
    points: Vec<Option<Vec3>>,
}

impl<'a> Growing<'a> {
    fn new(window: &'a Window, guess: &'a Intrinsics, seed: u64) -> Self {
        let undistorted = window
            .tracks
            .iter()
            .map(|track| {
                let pixels = track.pixels.iter();
                pixels
                    .filter_map(|&(view, pixel)| Some((view, guess.undistort(&pixel)?)))
                    .collect()
            })
            .collect();
        Self {
            window,
            guess,
            pinhole: guess.pinhole(),
            seed,
            undistorted,
            poses: vec![None; window.num_views],
            points: vec![None; window.tracks.len()],
        }
    }

    /// Motion between the first view and the furthest one that determines it; returns that one.
    fn begin(&mut self) -> Option<usize> {
        let config = TwoViewConfig {
            seed: self.seed,
            min_matches: MIN_SHARED,
            min_parallax_deg: MIN_PARALLAX_DEG,
            min_rotation_residual_px: 2.0,
            max_direction_sigma_deg: 15.0,
            max_relative_idepth_sigma: 0.5,
            ..TwoViewConfig::default()
        };
        for second in (1..self.window.num_views).rev() {
            let (tracks, matches) = self.matches(0, second);
            if tracks.len() < MIN_SHARED {
                continue;
            }
            let motion = match two_view(&matches, &self.pinhole, &config) {
                TwoViewOutcome::Accepted(motion) => *motion,
                TwoViewOutcome::Ambiguous { candidates } => candidates.into_iter().next()?,
                TwoViewOutcome::NotEnoughParallax { .. } => return None,
                _ => continue,
            };
            for ((&track, point), pair) in tracks.iter().zip(&motion.points).zip(&matches) {
                self.points[track] = point
                    .filter(|p| p.idepth > 0.0)
                    .map(|p| self.pinhole.unproject(&pair.a) / p.idepth);
            }
            self.poses[0] = Some(Se3::identity());
            self.poses[second] = Some(motion.b_from_a);
            return Some(second);
        }
        None
    }

    /// Tracks that two views share, and their pixels.
    fn matches(&self, a: usize, b: usize) -> (Vec<usize>, Vec<Match>) {
        let pixel_in = |pixels: &[(usize, Vec2)], view| {
            let found = pixels.iter().find(|seen: &&(usize, Vec2)| seen.0 == view);
            found.map(|seen| seen.1)
        };
        self.undistorted
            .iter()
            .enumerate()
            .filter_map(|(track, pixels)| {
                let (a, b) = (pixel_in(pixels, a)?, pixel_in(pixels, b)?);
                Some((track, Match { a, b }))
            })
            .unzip()
    }

    /// Pose of a view from the points that it sees.
    fn add_view(&mut self, view: usize) {
        if self.poses[view].is_some() {
            return;
        }
        let seen: Vec<PointPixel> = self
            .undistorted
            .iter()
            .zip(&self.points)
            .filter_map(|(pixels, point)| {
                let pixel = pixels.iter().find(|seen| seen.0 == view)?.1;
                let point_in_world = (*point)?;
                Some(PointPixel {
                    point_in_world,
                    pixel,
                })
            })
            .collect();
        let config = AbsolutePoseConfig {
            max_error_px: MAX_ERROR_PX,
            seed: self.seed,
            min_inlier_ratio: 0.4,
            ..AbsolutePoseConfig::default()
        };
        self.poses[view] = absolute_pose(&seen, &self.pinhole, &config);
    }

    /// Places of all tracks from the views that are known.
    fn triangulate(&mut self) {
        for (pixels, point) in self.undistorted.iter().zip(&mut self.points) {
            let sightings: Vec<View> = pixels
                .iter()
                .filter_map(|&(view, pixel)| {
                    let camera_from_world = self.poses[view]?;
                    Some(View {
                        camera_from_world,
                        pixel,
                    })
                })
                .collect();
            *point = triangulate(&sightings, &self.pinhole)
                .ok()
                .filter(|t| t.residual_rms_px < MAX_ERROR_PX && t.parallax_deg > MIN_PARALLAX_DEG)
                .map(|t| t.point_in_world);
        }
    }

    /// The scene, with the views and points that are known.
    fn finish(self) -> Option<Scene> {
        let mut index_of_view = vec![None; self.poses.len()];
        let mut poses = Vec::new();
        for (view, pose) in self.poses.iter().enumerate() {
            if let Some(pose) = pose {
                index_of_view[view] = Some(poses.len());
                poses.push(*pose);
            }
        }
        let (mut points, mut sightings) = (Vec::new(), Vec::new());
        for (track, point) in self.window.tracks.iter().zip(&self.points) {
            let Some(point) = point else { continue };
            let pixels = track.pixels.iter().enumerate();
            sightings.extend(pixels.filter_map(|(k, &(view, pixel))| {
                let step = track.steps.get(k).copied().unwrap_or_default();
                let Window {
                    size, direction, ..
                } = self.window;
                index_of_view[view].map(|view| Sighting {
                    view,
                    point: points.len(),
                    pixel,
                    bend: step * direction.phase(&pixel, *size),
                })
            }));
            points.push(*point);
        }
        let is_enough = points.len() >= MIN_POINTS && 2 * poses.len() >= self.poses.len();
        is_enough.then_some(Scene {
            intrinsics: *self.guess,
            poses,
            points,
            sightings,
        })
    }
}
