//! What is published of a map.
//!
//! A listener has room for some 200 kB that have come and are not yet read, and gets the rest of a
//! larger message slowly, by asking again. So whole maps go out one after the other, seldom, with
//! pauses by their size, and none before everybody has the last one; what can be sent in parts is.
//! Nothing is made for nobody.

use crate::convert::{
    MAX_BYTES, MAX_BYTES_PER_POSE, MAX_POINTS, changed_parts, cloud_of_cells, clouds_of_keyframe,
    grid_of, last_path_of, octomap_of, part_that_fits,
};
use crate::node::{Outlet, Quality, RosNode};
use crate::shown::Shown;
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_messages::RosMessage;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::diagnostic_msgs::DiagnosticArray;
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::{OccupancyGrid, Path};
use monogrid_messages::octomap_msgs::Octomap;
use monogrid_messages::sensor_msgs::PointCloud2;
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::{MapError, Projection};
use monogrid_slam::Keyframe;
use std::time::{Duration, Instant};

/// Maps are sent as a whole so often at most. The middleware forgets what it sent before the last
/// message every six seconds: who comes late then gets one.
const WHOLE_EVERY: Duration = Duration::from_secs(7);
/// What is sent of whole maps in a second, bytes: as much as the middleware sends again when a
/// listener lacks it (8 fragments of 256 bytes each 10 ms).
const BYTES_PER_SECOND: f64 = 2e5;

/// A map of one form, which is sent as a whole.
struct Whole<M: RosMessage> {
    outlet: Outlet<M>,
    /// The number of the map that was sent last, and when.
    sent: Option<(u64, Instant)>,
    /// What is sent next, and its size, bytes.
    waiting: Option<(M, usize)>,
    /// When listeners have all of the last one, as far as that can be told.
    there_at: Instant,
}

impl<M: RosMessage> Whole<M> {
    fn new(outlet: Outlet<M>) -> Self {
        Self {
            outlet,
            sent: None,
            waiting: None,
            there_at: Instant::now(),
        }
    }

    /// Whether the map of this number is to be sent.
    fn is_due(&self, number: u64) -> bool {
        let is_new = |(sent, at): (u64, Instant)| sent != number && at.elapsed() >= WHOLE_EVERY;
        self.sent.is_none_or(is_new) && self.outlet.is_heard()
    }

    fn put(&mut self, number: u64, message: M, bytes: usize) {
        self.sent = Some((number, Instant::now()));
        self.waiting = Some((message, bytes));
    }
}

/// What is done with maps of all forms.
trait Sending {
    /// Sends what waits: whether that could be sent, and when listeners have it.
    fn send(&mut self) -> Option<(bool, Instant)>;
    /// The next map is sent, whatever was sent before.
    fn forget(&mut self);
}

impl<M: RosMessage> Sending for Whole<M> {
    fn send(&mut self) -> Option<(bool, Instant)> {
        let (message, bytes) = self.waiting.take()?;
        let is_sent = self.outlet.publish(message);
        if !is_sent {
            self.sent = None;
        }
        self.there_at = Instant::now() + Duration::from_secs_f64(bytes as f64 / BYTES_PER_SECOND);
        Some((is_sent, self.there_at))
    }

    fn forget(&mut self) {
        (self.sent, self.waiting) = (None, None);
    }
}

/// Publishes maps, and knows what listeners have.
pub struct MapTopics {
    frame: String,
    grid: Whole<OccupancyGrid>,
    grid_updates: Outlet<OccupancyGridUpdate>,
    octomap_binary: Whole<Octomap>,
    octomap_full: Whole<Octomap>,
    large: Whole<Octomap>,
    cells: Whole<PointCloud2>,
    points: Outlet<PointCloud2>,
    path: Whole<Path>,
    diagnostics: Outlet<DiagnosticArray>,
    /// The grid that listeners have.
    sent_grid: Option<OccupancyGrid>,
    /// The map that was looked at last.
    number: u64,
    /// When the next whole map may be sent.
    free_at: Instant,
    /// Radius around the camera, m, of what was too large to be sent as a whole; `None` where
    /// everything was sent.
    pub window: Option<f64>,
    /// Maps that were sent as a whole.
    pub wholes: u64,
    /// Messages that could not be sent.
    pub unsent: u64,
}

impl MapTopics {
    /// Begins to publish, in this frame.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(node: &mut RosNode, frame: &str) -> anyhow::Result<Self> {
        let (latched, parts) = (Quality::Latched, Quality::Parts);
        Ok(Self {
            frame: frame.to_owned(),
            grid: Whole::new(node.publisher("map", latched)?),
            grid_updates: node.publisher("map_updates", parts)?,
            octomap_binary: Whole::new(node.publisher("octomap_binary", latched)?),
            octomap_full: Whole::new(node.publisher("octomap_full", latched)?),
            large: Whole::new(node.publisher("large_octomap", latched)?),
            cells: Whole::new(node.publisher("octomap_point_cloud_centers", latched)?),
            points: node.publisher("points", parts)?,
            path: Whole::new(node.publisher("path", latched)?),
            diagnostics: node.publisher("/diagnostics", Quality::Stream)?,
            sent_grid: None,
            number: 0,
            free_at: Instant::now(),
            window: None,
            wholes: 0,
            unsent: 0,
        })
    }

    fn forms(&mut self) -> [&mut dyn Sending; 6] {
        [
            &mut self.grid,
            &mut self.path,
            &mut self.octomap_binary,
            &mut self.cells,
            &mut self.octomap_full,
            &mut self.large,
        ]
    }

    /// The next map is sent as a whole in all forms, whatever listeners have.
    pub fn forget(&mut self) {
        self.forms().into_iter().for_each(Sending::forget);
        self.sent_grid = None;
    }

    /// Whether somebody wants something of the map of this number.
    #[must_use]
    pub fn wants(&self, number: u64) -> bool {
        self.grid.is_due(number)
            || (self.number != number && self.grid_updates.is_heard())
            || self.octomap_binary.is_due(number)
            || self.octomap_full.is_due(number)
            || self.large.is_due(number)
            || self.cells.is_due(number)
            || self.path.is_due(number)
    }

    /// Sends the next whole map that waits, when it is its time.
    pub fn send_next(&mut self) {
        if Instant::now() < self.free_at {
            return;
        }
        let sent = self.forms().into_iter().find_map(Sending::send);
        if let Some((is_sent, there_at)) = sent {
            self.wholes += u64::from(is_sent);
            self.count(is_sent);
            self.free_at = there_at;
        }
    }

    fn header(&self, stamp: Time) -> Header {
        Header {
            stamp,
            frame_id: self.frame.clone(),
        }
    }

    fn count(&mut self, is_sent: bool) {
        self.unsent += u64::from(!is_sent);
    }

    /// Publishes what is due of the map of this number.
    ///
    /// # Errors
    /// A map that OctoMap cannot address.
    pub fn publish(&mut self, number: u64, shown: &Shown) -> Result<(), MapError> {
        self.number = number;
        if let Some(grid) = &shown.grid {
            self.publish_grid(number, shown, grid);
        }
        let header = self.header(shown.stamp);
        let mut windows = [None; 4];
        for binary in [true, false] {
            let whole = match binary {
                true => &mut self.octomap_binary,
                false => &mut self.octomap_full,
            };
            if whole.is_due(number) {
                let (tree, window) = part_that_fits(
                    &shown.map,
                    shown.camera,
                    |map| octomap_of(header.clone(), map, binary),
                    |tree| tree.data.len() <= MAX_BYTES,
                )?;
                windows[usize::from(binary)] = window;
                let bytes = tree.data.len();
                whole.put(number, tree, bytes);
            }
        }
        if self.large.is_due(number) {
            let (tree, window) = part_that_fits(
                &shown.large()?,
                shown.camera,
                |map| octomap_of(header.clone(), map, true),
                |tree| tree.data.len() <= MAX_BYTES,
            )?;
            windows[3] = window;
            let bytes = tree.data.len();
            self.large.put(number, tree, bytes);
        }
        if self.cells.is_due(number) {
            let (cells, window) = part_that_fits(
                &shown.map,
                shown.camera,
                |map| Ok(cloud_of_cells(header.clone(), map)),
                |cloud| (cloud.width as usize) < MAX_POINTS,
            )?;
            windows[2] = window;
            let bytes = cells.data.len();
            self.cells.put(number, cells, bytes);
        }
        if self.path.is_due(number) {
            let path = last_path_of(header, &shown.path);
            let bytes = path.poses.len() * MAX_BYTES_PER_POSE;
            self.path.put(number, path, bytes);
        }
        self.window = windows.into_iter().flatten().reduce(f64::min);
        Ok(())
    }

    /// Publishes the grid, or what has changed of it since listeners got the last one of the same
    /// size and place.
    fn publish_grid(&mut self, number: u64, shown: &Shown, grid: &Projection) {
        let [x, y, _] = shown.camera;
        let grid = grid.around([x, y], MAX_BYTES);
        let now = grid_of(self.header(shown.stamp), shown.stamp, &grid);
        let place = |grid: &OccupancyGrid| {
            let info = grid.info;
            (info.width, info.height, info.resolution, info.origin)
        };
        let last = self.sent_grid.take();
        let last = last.filter(|last| place(last) == place(&now));
        if last.is_none() {
            self.grid.forget();
        }
        if self.grid.is_due(number) || self.grid.waiting.is_some() {
            let bytes = now.data.len();
            self.grid.put(number, now.clone(), bytes);
        } else if let Some(last) = last {
            // a change that comes before its grid would be undone by it
            if Instant::now() < self.grid.there_at {
                self.sent_grid = Some(last);
                return;
            }
            if self.grid.sent.is_some() && self.grid_updates.is_heard() {
                for change in changed_parts(&last, &now) {
                    let is_sent = self.grid_updates.publish(change);
                    self.count(is_sent);
                }
            }
        }
        self.sent_grid = Some(now);
    }

    /// Publishes the points of a keyframe, which is at `map_from_keyframe` (m).
    pub fn publish_points(
        &mut self,
        keyframe: &Keyframe,
        pinhole: &Pinhole,
        map_from_keyframe: &Sim3,
    ) {
        if !self.points.is_heard() {
            return;
        }
        let header = self.header(Time::from_nanoseconds(keyframe.timestamp_ns));
        for part in clouds_of_keyframe(&header, keyframe, pinhole, map_from_keyframe) {
            let is_sent = self.points.publish(part);
            self.count(is_sent);
            if !is_sent {
                return;
            }
        }
    }

    /// Publishes how the node is.
    pub fn publish_diagnostics(&mut self, message: DiagnosticArray) {
        let is_sent = self.diagnostics.publish(message);
        self.count(is_sent);
    }
}
