//! The reference trajectory of a data set, as poses of its camera.

use super::{Dataset, Layout, folder, icl};
use crate::text::{data_lines, numbers, read_text};
use crate::trajectory::{parse_kitti, parse_path, pose_from_matrix};
use crate::{DatasetError, TimedPose};
use monogrid_geometry::Se3;

impl Dataset {
    /// The reference trajectory, `None` when the source has none.
    ///
    /// EuRoC's and TUM-VI's poses are those of the body and become those of camera 0 with the
    /// `T_BS` of its `sensor.yaml`, or the `T_cam_imu` of its `camchain.yaml`. KITTI's and those of
    /// 7-Scenes and ScanNet have no times and take those of the frames, and so do those of
    /// ICL-NUIM. These are also mirrored, from a y axis that points up to one that points down.
    ///
    /// # Errors
    /// When the file, or EuRoC's calibration, cannot be understood.
    pub fn reference_trajectory(&self) -> Result<Option<Vec<TimedPose>>, DatasetError> {
        let Some(path) = &self.ground_truth else {
            return Ok(None);
        };
        if !self.pose_files.is_empty() {
            return self.poses_of_frames().map(Some);
        }
        let text = read_text(path)?;
        let words = data_lines(&text)
            .next()
            .map(|(_, line)| line.split_whitespace().count());
        if words == Some(12) {
            let times: Vec<i64> = self.frames.iter().map(|f| f.timestamp_ns).collect();
            return parse_kitti(&text, &times, path).map(Some);
        }
        let mut poses = parse_path(&text, path)?;
        if self.layout == Layout::IclNuim {
            return Ok(Some(icl::poses_of(
                poses,
                folder::rate(self.options, path)?,
            )));
        }
        if matches!(self.layout, Layout::Euroc | Layout::TumVi) {
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

    /// The poses in a file each; where tracking of the data set failed, there is no rotation, and
    /// no pose.
    fn poses_of_frames(&self) -> Result<Vec<TimedPose>, DatasetError> {
        let mut poses = Vec::new();
        for (timestamp_ns, path) in &self.pose_files {
            let text = read_text(path)?;
            let rows: Option<Vec<Vec<f64>>> =
                data_lines(&text).map(|(_, line)| numbers(line)).collect();
            let values = rows.unwrap_or_default().concat();
            if !matches!(values.len(), 12 | 16) {
                let found = format!("{} numbers", values.len());
                return Err(DatasetError::content(path, found, "a 4x4 matrix"));
            }
            poses.extend(
                pose_from_matrix(&values).map(|world_from_camera| TimedPose {
                    timestamp_ns: *timestamp_ns,
                    world_from_camera,
                }),
            );
        }
        Ok(poses)
    }
}
