//! The reference trajectory of a data set, as poses of its camera.

use super::{Dataset, Layout};
use crate::text::{data_lines, read_text};
use crate::trajectory::{parse_kitti, parse_trajectory};
use crate::{DatasetError, TimedPose};
use monogrid_geometry::Se3;

impl Dataset {
    /// The reference trajectory, `None` when the source has none.
    ///
    /// EuRoC's poses are those of the body and become those of camera 0 with the `T_BS` of its
    /// `sensor.yaml`; KITTI's have no times and take those of the frames.
    ///
    /// # Errors
    /// When the file, or EuRoC's calibration, cannot be understood.
    pub fn reference_trajectory(&self) -> Result<Option<Vec<TimedPose>>, DatasetError> {
        let Some(path) = &self.ground_truth else {
            return Ok(None);
        };
        let text = read_text(path)?;
        let words = data_lines(&text)
            .next()
            .map(|(_, line)| line.split_whitespace().count());
        if words == Some(12) {
            let times: Vec<i64> = self.frames.iter().map(|f| f.timestamp_ns).collect();
            return parse_kitti(&text, &times, path).map(Some);
        }
        let mut poses = parse_trajectory(&text, path)?;
        if self.layout == Layout::Euroc {
            let body_from_camera = self
                .calibration(None)?
                .and_then(|c| c.body_from_camera)
                .unwrap_or(Se3::identity());
            for pose in &mut poses {
                pose.world_from_camera = pose.world_from_camera * body_from_camera;
            }
        }
        Ok(Some(poses))
    }
}
