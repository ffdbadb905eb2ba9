//! What is around the robot, several times in a second, by odometry alone: no correction of the map
//! moves it.

use crate::args::Args;
use crate::convert::{MAX_BYTES, octomap_of, part_that_fits};
use crate::node::{Outlet, Quality, RosNode};
use crate::shown::{Seen, Shown};
use monogrid_bags::convert::grid_of;
use monogrid_geometry::Se3;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::nav_msgs::OccupancyGrid;
use monogrid_messages::octomap_msgs::Octomap;
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::MapError;
use monogrid_pipeline::{LocalMapper, LocalView, Pipeline};
use std::sync::Arc;

/// Publishes maps of what is around.
struct LocalTopics {
    frame: String,
    height_band: Option<[f64; 2]>,
    camera_over_base: f64,
    grid: Outlet<OccupancyGrid>,
    tree: Outlet<Octomap>,
}

/// Maps what is around while somebody listens.
pub struct Local {
    topics: Arc<LocalTopics>,
    /// With the scale of its maps.
    mapper: Option<(f64, LocalMapper)>,
}

impl Local {
    /// Begins to publish.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(node: &mut RosNode, args: &Args) -> anyhow::Result<Self> {
        let topics = LocalTopics {
            frame: args.frames.odom_frame().to_owned(),
            height_band: args.height_band,
            camera_over_base: args.frames.mount().translation.z,
            grid: node.publisher("local_map", Quality::Parts)?,
            tree: node.publisher("local_octomap", Quality::Parts)?,
        };
        Ok(Self {
            topics: Arc::new(topics),
            mapper: None,
        })
    }

    /// The next image belongs to another world.
    pub fn begin_again(&mut self) {
        self.mapper = None;
    }

    /// Takes the newest image, which is at `odom_from_camera` (m). With another scale the map
    /// begins again.
    pub fn take(
        &mut self,
        pipeline: &Pipeline,
        time_ns: i64,
        odom_from_camera: &Se3,
        metres_per_unit: f64,
    ) {
        self.mapper.take_if(|(scale, _)| *scale != metres_per_unit);
        let is_due = |(_, mapper): &(f64, LocalMapper)| mapper.is_due(time_ns);
        if !self.mapper.as_ref().is_none_or(is_due) {
            return;
        }
        if !self.topics.is_heard() {
            self.mapper = None;
            return;
        }
        if self.mapper.is_none() {
            let topics = Arc::clone(&self.topics);
            let shown = move |view: Result<LocalView, MapError>| {
                // a map that is too large is not sent
                let _ = view.and_then(|view| topics.publish(&view, metres_per_unit));
            };
            let camera = pipeline.slam().camera();
            let mapper = LocalMapper::start(pipeline.mapper().clone(), camera, shown);
            // without a thread for it there is none
            self.mapper = mapper.ok().map(|mapper| (metres_per_unit, mapper));
        }
        if let Some((_, mapper)) = &mut self.mapper {
            let local_from_camera = odom_from_camera.stretched(1.0 / metres_per_unit);
            mapper.offer(pipeline.slam(), time_ns, &local_from_camera);
        }
    }
}

impl LocalTopics {
    fn is_heard(&self) -> bool {
        self.grid.is_heard() || self.tree.is_heard()
    }

    fn publish(&self, view: &LocalView, metres_per_unit: f64) -> Result<(), MapError> {
        let stamp = Time::from_nanoseconds(view.timestamp_ns);
        let camera = view.local_from_camera.stretched(metres_per_unit);
        let seen = Seen {
            stamp,
            metres_per_unit,
            band_over_base: self.height_band,
            // over the base as it is now
            origin_over_base: self.camera_over_base - camera.translation.z,
            path: &[(stamp, camera)],
        };
        let shown = Shown::new(&view.map, &seen)?;
        let header = Header {
            stamp,
            frame_id: self.frame.clone(),
        };
        // one that cannot be sent is followed by the next
        let [x, y, _] = shown.camera;
        if let Some(grid) = shown.grid.filter(|_| self.grid.is_heard()) {
            let grid = grid.around([x, y], MAX_BYTES);
            let _ = self.grid.publish(grid_of(header.clone(), stamp, &grid));
        }
        if self.tree.is_heard() {
            let (tree, _) = part_that_fits(
                &shown.map,
                shown.camera,
                |map| octomap_of(header.clone(), map, true),
                |tree| tree.data.len() <= MAX_BYTES,
            )?;
            let _ = self.tree.publish(tree);
        }
        Ok(())
    }
}
