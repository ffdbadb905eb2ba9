//! What is published of a map.

use crate::convert::{
    MAX_BYTES, MAX_POINTS, changed_part, cloud_of_cells, cloud_of_keyframe, grid_of, last_path_of,
    octomap_of, part_that_fits,
};
use crate::node::{Quality, RosNode};
use crate::shown::Shown;
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::diagnostic_msgs::DiagnosticArray;
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::{OccupancyGrid, Path};
use monogrid_messages::octomap_msgs::Octomap;
use monogrid_messages::sensor_msgs::PointCloud2;
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::{MapError, Projection};
use monogrid_slam::Keyframe;
use ros2_client::Publisher;
use std::time::{Duration, Instant};

/// The grid is sent as a whole so often, for those who come late; in between as changes.
const WHOLE_GRID_EVERY: Duration = Duration::from_secs(5);

/// Publishes maps, and knows what listeners have.
pub struct MapTopics {
    frame: String,
    grid: Publisher<OccupancyGrid>,
    grid_updates: Publisher<OccupancyGridUpdate>,
    octomap_binary: Publisher<Octomap>,
    octomap_full: Publisher<Octomap>,
    cells: Publisher<PointCloud2>,
    points: Publisher<PointCloud2>,
    path: Publisher<Path>,
    diagnostics: Publisher<DiagnosticArray>,
    /// The grid that listeners have, and when it was last sent as a whole.
    sent_grid: Option<(OccupancyGrid, Instant)>,
    /// Radius around the camera, m, of what was too large to be sent as a whole; `None` where
    /// everything was sent.
    pub window: Option<f64>,
    /// Messages that could not be sent.
    pub unsent: u64,
}

impl MapTopics {
    /// Begins to publish, in this frame.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(node: &mut RosNode, frame: &str) -> anyhow::Result<Self> {
        Ok(Self {
            frame: frame.to_owned(),
            grid: node.publisher("map", Quality::Latched)?,
            grid_updates: node.publisher("map_updates", Quality::Stream)?,
            octomap_binary: node.publisher("octomap_binary", Quality::Latched)?,
            octomap_full: node.publisher("octomap_full", Quality::Latched)?,
            cells: node.publisher("octomap_point_cloud_centers", Quality::Latched)?,
            points: node.publisher("points", Quality::Stream)?,
            path: node.publisher("path", Quality::Latched)?,
            diagnostics: node.publisher("/diagnostics", Quality::Stream)?,
            sent_grid: None,
            window: None,
            unsent: 0,
        })
    }

    /// The next grid is sent as a whole, whatever listeners have.
    pub fn forget_grid(&mut self) {
        self.sent_grid = None;
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

    /// Publishes a map in all forms.
    ///
    /// # Errors
    /// A map that OctoMap cannot address.
    pub fn publish(&mut self, shown: &Shown) -> Result<(), MapError> {
        if let Some(grid) = &shown.grid {
            self.publish_grid(shown, grid);
        }
        let header = self.header(shown.stamp);
        let tree = |binary: bool| {
            part_that_fits(
                &shown.map,
                shown.camera,
                |map| octomap_of(header.clone(), map, binary),
                |tree| tree.data.len() <= MAX_BYTES,
            )
        };
        let (binary, binary_window) = tree(true)?;
        let (full, full_window) = tree(false)?;
        let (cells, cells_window) = part_that_fits(
            &shown.map,
            shown.camera,
            |map| Ok(cloud_of_cells(header.clone(), map)),
            |cloud| (cloud.width as usize) < MAX_POINTS,
        )?;
        let windows = [binary_window, full_window, cells_window];
        self.window = windows.into_iter().flatten().reduce(f64::min);
        let sent = [
            self.octomap_binary.publish(binary).is_ok(),
            self.octomap_full.publish(full).is_ok(),
            self.cells.publish(cells).is_ok(),
            self.path.publish(last_path_of(header, &shown.path)).is_ok(),
        ];
        sent.into_iter().for_each(|is_sent| self.count(is_sent));
        Ok(())
    }

    /// Publishes the grid, or what has changed of it since listeners got the last one of the same
    /// size and place.
    fn publish_grid(&mut self, shown: &Shown, grid: &Projection) {
        let [x, y, _] = shown.camera;
        let grid = grid.around([x, y], MAX_BYTES);
        let now = grid_of(self.header(shown.stamp), shown.stamp, &grid);
        let place = |grid: &OccupancyGrid| {
            let info = grid.info;
            (info.width, info.height, info.resolution, info.origin)
        };
        let last = self
            .sent_grid
            .take()
            .filter(|(last, at)| at.elapsed() < WHOLE_GRID_EVERY && place(last) == place(&now));
        let (is_sent, whole_at) = match last {
            None => (self.grid.publish(now.clone()).is_ok(), Instant::now()),
            Some((last, at)) => {
                let change = changed_part(&last, &now);
                let send = |change| self.grid_updates.publish(change).is_ok();
                (change.is_none_or(send), at)
            }
        };
        self.sent_grid = Some((now, whole_at));
        self.count(is_sent);
    }

    /// Publishes the points of a keyframe, which is at `map_from_keyframe` (m).
    pub fn publish_points(
        &mut self,
        keyframe: &Keyframe,
        pinhole: &Pinhole,
        map_from_keyframe: &Sim3,
    ) {
        let header = self.header(Time::from_nanoseconds(keyframe.timestamp_ns));
        let points = cloud_of_keyframe(header, keyframe, pinhole, map_from_keyframe);
        let is_sent = self.points.publish(points).is_ok();
        self.count(is_sent);
    }

    /// Publishes how the node is.
    pub fn publish_diagnostics(&mut self, message: DiagnosticArray) {
        let is_sent = self.diagnostics.publish(message).is_ok();
        self.count(is_sent);
    }
}
