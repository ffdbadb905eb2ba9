//! Corners followed through a video, in windows of some twenty views.

use monogrid_features::{CornerConfig, TrackConfig, detect_corners, track_points};
use monogrid_geometry::median::median;
use monogrid_geometry::{ReadoutDirection, Vec2};
use monogrid_image::{GrayImage, Mask, Pyramid};
use std::collections::BTreeSet;

/// A corner and where it was seen.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Track {
    /// View and pixel, one per view that sees it, in the order of views.
    pub pixels: Vec<(usize, Vec2)>,
    /// For each of them how far the corner moves from frame to frame there, px; empty where nobody
    /// knows.
    pub steps: Vec<Vec2>,
}

impl Track {
    /// Where a view saw it.
    #[must_use]
    pub fn pixel_in(&self, view: usize) -> Option<Vec2> {
        let found = self
            .pixels
            .binary_search_by_key(&view, |seen| seen.0)
            .ok()?;
        self.pixels.get(found).map(|seen| seen.1)
    }
}

/// A piece of a video: views that are some motion apart, and the corners that they share.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Window {
    /// Width and height of the images, px.
    pub size: (usize, usize),
    /// Which way a rolling shutter runs over them.
    pub direction: ReadoutDirection,
    /// Number of views.
    pub num_views: usize,
    /// Corners seen by at least three views.
    pub tracks: Vec<Track>,
}

/// Settings of [`TrackCollector`].
#[derive(Clone, Debug, PartialEq)]
pub struct CollectorConfig {
    /// Corners followed at a time. Range 50..; default 350.
    pub max_points: usize,
    /// Median motion after which a frame becomes a view, as a share of the longer side of the
    /// image. Range 0.005..0.2; default 0.03.
    pub view_step: f64,
    /// A frame becomes a view at the latest when less than this share of the corners is still
    /// followed. Range 0..1; default 0.7.
    pub min_survivors: f64,
    /// Views of a window. Range 4..; default 20.
    pub views_per_window: usize,
    /// Windows of fewer views are dropped. Range 3..; default 8.
    pub min_views: usize,
    /// Fewer corners than this that are still followed end a window. Default 40.
    pub min_followed: usize,
    /// Which way a rolling shutter runs over the images. Default down.
    pub direction: ReadoutDirection,
}

impl Default for CollectorConfig {
    fn default() -> Self {
        Self {
            max_points: 350,
            view_step: 0.03,
            min_survivors: 0.7,
            views_per_window: 20,
            min_views: 8,
            min_followed: 40,
            direction: ReadoutDirection::Down,
        }
    }
}

/// A corner that is being followed.
#[derive(Clone, Copy, Debug)]
struct Followed {
    track: usize,
    /// In the newest view.
    in_view: Vec2,
    /// In the newest frame, and by how much it moved there; `None` where it has only just been
    /// found.
    now: Vec2,
    step: Option<Vec2>,
}

/// Follows corners from frame to frame and collects [`Window`]s.
#[derive(Debug)]
pub struct TrackCollector {
    config: CollectorConfig,
    /// Where corners may lie; everywhere where there is none.
    mask: Option<Mask>,
    /// The newest view.
    view: Option<Pyramid>,
    followed: Vec<Followed>,
    /// Corners that were followed when the newest view was made.
    begun_with: usize,
    /// Those of them that had only just been found.
    begun_without: BTreeSet<usize>,
    /// Whether the newest view is the newest frame too.
    view_is_newest: bool,
    /// How far the corners in the newest frame are from where the view before it saw them, px.
    moves: Vec<f64>,
    open: Window,
    windows: Vec<Window>,
}

/// Levels of the pyramids; the coarsest keeps some forty pixels.
const NUM_LEVELS: usize = 4;

impl TrackCollector {
    /// An empty collector.
    #[must_use]
    pub fn new(config: CollectorConfig) -> Self {
        Self {
            config,
            mask: None,
            view: None,
            followed: Vec::new(),
            begun_with: 0,
            begun_without: BTreeSet::new(),
            view_is_newest: false,
            moves: Vec::new(),
            open: Window::default(),
            windows: Vec::new(),
        }
    }

    /// With corners only where this mask of the size of the images is not 0.
    #[must_use]
    pub fn within(self, mask: Option<Mask>) -> Self {
        Self { mask, ..self }
    }

    /// Windows that are complete.
    #[must_use]
    pub fn num_windows(&self) -> usize {
        self.windows.len()
    }

    /// Takes the next frame; all frames of a window have one size (another one begins a new
    /// window).
    pub fn add(&mut self, image: &GrayImage) {
        self.moves.clear();
        let frame = Pyramid::new(image.clone(), NUM_LEVELS);
        if self.open.size != (image.width(), image.height()) {
            self.close();
        }
        let Some(view) = self.view.take() else {
            return self.begin(frame);
        };
        self.follow(&view, &frame);
        self.note_steps();
        let enough_followed = self.followed.len() >= self.config.min_followed;
        if !enough_followed {
            self.close();
            return self.begin(frame);
        }
        let moves = self.followed.iter().map(|f| (f.now - f.in_view).norm());
        self.moves = moves.collect();
        if !self.has_moved() {
            self.view = Some(view);
            return;
        }
        self.add_view(&frame);
        if self.open.num_views == self.config.views_per_window {
            self.close();
            return self.begin(frame);
        }
        self.view = Some(frame);
    }

    /// The windows that are complete, which are gone from here then.
    pub fn take_windows(&mut self) -> Vec<Window> {
        std::mem::take(&mut self.windows)
    }

    /// How far the corners that the newest frame shows have moved since the view before it, px;
    /// empty where there was none, or too few could be followed.
    #[must_use]
    pub fn moves(&self) -> &[f64] {
        &self.moves
    }

    /// All windows.
    #[must_use]
    pub fn finish(mut self) -> Vec<Window> {
        self.close();
        self.windows
    }

    /// Ends the open window and keeps it if it is long enough.
    fn close(&mut self) {
        let mut window = std::mem::take(&mut self.open);
        self.view = None;
        self.followed.clear();
        let fewest = self.config.min_views.min(3);
        window.tracks.retain(|track| track.pixels.len() >= fewest);
        if window.num_views >= self.config.min_views {
            self.windows.push(window);
        }
    }

    /// Begins a window with `frame` as its first view.
    fn begin(&mut self, frame: Pyramid) {
        let image = frame.level(0);
        self.open.size = (image.width(), image.height());
        self.open.direction = self.config.direction;
        self.add_view(&frame);
        self.view = Some(frame);
    }

    /// Makes `frame` a view: notes where corners are and looks for new ones.
    fn add_view(&mut self, frame: &Pyramid) {
        let view = self.open.num_views;
        self.open.num_views += 1;
        let occupied: Vec<Vec2> = self.followed.iter().map(|f| f.now).collect();
        let wanted = self.config.max_points.saturating_sub(occupied.len());
        let corners = detect_corners(
            frame,
            self.mask.as_ref(),
            &occupied,
            &CornerConfig {
                max_corners: wanted.max(1),
                ..CornerConfig::default()
            },
        );
        for corner in corners.into_iter().take(wanted) {
            self.followed.push(Followed {
                track: self.open.tracks.len(),
                in_view: corner.pixel,
                now: corner.pixel,
                step: None,
            });
            self.open.tracks.push(Track::default());
        }
        for followed in &mut self.followed {
            followed.in_view = followed.now;
            if let Some(track) = self.open.tracks.get_mut(followed.track) {
                track.pixels.push((view, followed.now));
                track.steps.push(followed.step.unwrap_or_default());
            }
        }
        self.begun_with = self.followed.len();
        let new = self.followed.iter().filter(|f| f.step.is_none());
        self.begun_without = new.map(|f| f.track).collect();
        self.view_is_newest = true;
    }

    /// Finds the corners of the view in `frame`; those that are lost are dropped.
    fn follow(&mut self, view: &Pyramid, frame: &Pyramid) {
        let points: Vec<Vec2> = self.followed.iter().map(|f| f.in_view).collect();
        let expected = self.followed.iter();
        let expected: Vec<Vec2> = expected
            .map(|f| f.now + f.step.unwrap_or_default())
            .collect();
        let outcomes = track_points(view, frame, &points, &expected, &TrackConfig::default());
        let found = std::mem::take(&mut self.followed)
            .into_iter()
            .zip(&outcomes);
        self.followed = found
            .filter_map(|(followed, outcome)| {
                outcome.pixel().map(|now| Followed {
                    now,
                    step: Some(now - followed.now),
                    ..followed
                })
            })
            .collect();
    }

    /// The newest view knows how its corners came; here they go on from it.
    fn note_steps(&mut self) {
        for followed in &self.followed {
            let Some(away) = followed.step.filter(|_| self.view_is_newest) else {
                continue;
            };
            let track = self.open.tracks.get_mut(followed.track);
            if let Some(step) = track.and_then(|track| track.steps.last_mut()) {
                *step = match self.begun_without.contains(&followed.track) {
                    true => away,
                    false => (*step + away) / 2.0,
                };
            }
        }
        self.view_is_newest = false;
    }

    /// Whether the newest frame is far enough from the newest view to become one.
    fn has_moved(&self) -> bool {
        let median = median(&mut self.moves.clone()).unwrap_or(0.0);
        let longer = self.open.size.0.max(self.open.size.1) as f64;
        let survivors = self.followed.len() as f64 / self.begun_with.max(1) as f64;
        median >= self.config.view_step * longer || survivors < self.config.min_survivors
    }
}
