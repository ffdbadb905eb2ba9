//! Motion of the camera without corrections of the map.
//!
//! Two transforms, as robots keep them apart (REP 105): `odom_from_camera` adds up what was tracked
//! from frame to frame and never jumps; `map_from_odom` takes what loops, optimisation and
//! relocalisation correct ([`crate::FrameReport::map_from_odom`]).
//!
//! A step has the length that the unit of its keyframe says at the time, since a single camera has
//! no other.

use crate::FrameReport;
use crate::map::{Map, Record};
use monogrid_geometry::Se3;

/// Where odometry stands.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Odometry {
    odom_from_camera: Option<Se3>,
    /// The last frame with a believed pose.
    last: Option<Record>,
    /// How often it went on although nobody knows how the camera came there.
    pub(super) num_gaps: usize,
}

impl Odometry {
    /// Adds the motion since the last frame with a pose; where odometry is then. `None` for a frame
    /// without one.
    pub(super) fn step(&mut self, map: &Map, report: &FrameReport) -> Option<Se3> {
        let world_from_camera = report.world_from_camera?;
        let tracked = map.last_record().copied();
        let this = tracked.filter(|record| record.frame_index == report.index);
        let step = self.last.zip(this);
        let step = step.and_then(|(last, this)| map.tracked_step(&last, &this));
        let odom_from_camera = match (self.odom_from_camera, step) {
            (Some(odom_from_last), Some(last_from_this)) => odom_from_last * last_from_this,
            // How the camera came here while it was lost is not known.
            (Some(odom_from_last), None) => {
                self.num_gaps += 1;
                odom_from_last
            }
            (None, _) => world_from_camera,
        };
        (self.odom_from_camera, self.last) = (Some(odom_from_camera), this);
        Some(odom_from_camera)
    }
}
