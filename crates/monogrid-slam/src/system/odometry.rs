//! Motion of the camera without corrections of the map.
//!
//! Two transforms, as robots keep them apart (REP 105): `odom_from_camera` adds up what was tracked from
//! frame to frame and never jumps; `map_from_odom` takes what loops, optimisation and relocalisation
//! correct ([`FrameReport::map_from_odom`]).

use super::{Record, Slam};
use crate::FrameReport;
use monogrid_geometry::Se3;

/// Where odometry stands.
#[derive(Debug, Default)]
pub(super) struct Odometry {
    odom_from_camera: Option<Se3>,
    /// The last frame with a believed pose.
    last: Option<Record>,
}

impl Slam {
    /// Adds the motion since the last frame with a pose, and reports where odometry is.
    pub(super) fn advance_odometry(&mut self, report: &mut FrameReport) {
        let Some(world_from_camera) = report.world_from_camera else {
            return;
        };
        let tracked = self.records.last().copied();
        let this = tracked.filter(|record| record.frame_index == report.index);
        let step = self
            .odometry
            .last
            .zip(this)
            .and_then(|(last, this)| self.tracked_step(&last, &this));
        let odom_from_camera = match (self.odometry.odom_from_camera, step) {
            (Some(odom_from_last), Some(last_from_this)) => odom_from_last * last_from_this,
            // How the camera came here while it was lost is not known.
            (Some(odom_from_last), None) => odom_from_last,
            (None, _) => world_from_camera,
        };
        report.odom_from_camera = Some(odom_from_camera);
        self.odometry = Odometry {
            odom_from_camera: Some(odom_from_camera),
            last: this,
        };
    }

    /// `last_from_this` as both were tracked on one keyframe, in units of the world; `None` if there is
    /// none that knows both.
    fn tracked_step(&self, last: &Record, this: &Record) -> Option<Se3> {
        let keyframe = self.visits.get(this.visit)?.keyframe;
        let last_from_keyframe = if last.visit == this.visit {
            last.frame_from_keyframe
        } else {
            let left = self.visits.get(last.visit)?;
            let is_next = last.visit + 1 == this.visit;
            left.handed_over_at(last.timestamp_ns)
                .filter(|(next, _)| is_next && *next == keyframe)
                .map(|(_, last_from_next)| last_from_next)?
        };
        let scale = self.nodes.get(keyframe as usize)?.world_from_keyframe.scale;
        let step = last_from_keyframe * this.frame_from_keyframe.inverse();
        Some(Se3::new(step.rotation, step.translation * scale))
    }
}
