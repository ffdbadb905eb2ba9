//! News as what Rerun shows.

use crate::news::{Frame, Keyframe, News, Pose, bytes};
use rerun::{
    Boxes3D, EncodedImage, LineStrips3D, Mat3x3, Pinhole, Points3D, RecordingStream,
    RecordingStreamResult, Scalars, TextLog, Transform3D, ViewCoordinates,
};

/// Radius of points, px of the screen.
const POINT_RADIUS: f32 = 1.5;

/// What was shown.
#[derive(Debug, Default)]
pub struct Shown {
    version: u64,
    path: Vec<[f32; 3]>,
    last_frame: Option<i64>,
    last_said: String,
    has_camera: bool,
}

impl Shown {
    /// Before the first news.
    pub fn begin(recording: &RecordingStream) -> RecordingStreamResult<Self> {
        recording.log_static("map", &ViewCoordinates::RIGHT_HAND_Z_UP())?;
        Ok(Self::default())
    }

    /// What to ask next. Cells are asked for each time, or the map would not grow; they come every
    /// few seconds.
    pub fn question(&self) -> String {
        let (version, from) = (self.version, self.path.len());
        format!("/live/{version}/{from}/1")
    }

    /// Shows news; whether nothing more comes.
    pub fn take(
        &mut self,
        recording: &RecordingStream,
        news: &News,
    ) -> RecordingStreamResult<bool> {
        if let Some(frame) = &news.frame {
            recording.set_time_sequence("frame", frame.index);
            self.show_frame(recording, frame, news)?;
        }
        self.path
            .extend(news.path.iter().map(|(_, x, y, z)| [*x, *y, *z]));
        if !news.path.is_empty() {
            recording.log("map/path", &LineStrips3D::new([self.path.clone()]))?;
        }
        for keyframe in &news.keyframes {
            show_keyframe(recording, keyframe, news)?;
        }
        for (id, unit, pose) in &news.poses {
            recording.log(name(*id), &transform(pose, *unit))?;
        }
        if let Some(cells) = &news.cells {
            let (middles, halves): (Vec<_>, Vec<_>) = cells.cubes().into_iter().unzip();
            let halves = halves.into_iter().map(|half| [half; 3]);
            let boxes = Boxes3D::from_centers_and_half_sizes(middles, halves);
            recording.log("map/cells", &boxes)?;
        }
        // of many keyframes some come at a time
        let is_all = self.version == news.version;
        self.version = news.version;
        Ok(news.ended && is_all)
    }

    fn show_frame(
        &mut self,
        recording: &RecordingStream,
        frame: &Frame,
        news: &News,
    ) -> RecordingStreamResult<()> {
        if !self.has_camera {
            self.has_camera = true;
            recording.log_static("map/camera/view", &pinhole(news))?;
        }
        if self.last_frame.replace(frame.index) == Some(frame.index) {
            return Ok(());
        }
        if let Some(pose) = &frame.pose {
            recording.log("map/camera", &transform(pose, 1.0))?;
        }
        if let Some(image) = &frame.image {
            recording.log("image", &EncodedImage::from_file_contents(bytes(image)))?;
        }
        recording.log("tracking/rate", &Scalars::single(news.rate))?;
        let reason = frame.reason.as_ref().map(|reason| format!(": {reason}"));
        let said = frame.state.clone() + &reason.unwrap_or_default();
        if said != self.last_said {
            recording.log("tracking/state", &TextLog::new(said.clone()))?;
            self.last_said = said;
        }
        Ok(())
    }
}

fn name(id: u32) -> String {
    format!("map/keyframes/{id:05}")
}

fn show_keyframe(
    recording: &RecordingStream,
    keyframe: &Keyframe,
    news: &News,
) -> RecordingStreamResult<()> {
    let name = name(keyframe.id);
    let (points, greys): (Vec<_>, Vec<_>) = keyframe.cloud.points().into_iter().unzip();
    let colours = greys
        .into_iter()
        .map(|grey| rerun::Color::from_rgb(grey, grey, grey));
    let points = Points3D::new(points)
        .with_colors(colours)
        .with_radii([rerun::Radius::new_ui_points(POINT_RADIUS)]);
    recording.log(format!("{name}/points"), &points)?;
    recording.log_static(format!("{name}/view"), &pinhole(news))?;
    let image = EncodedImage::from_file_contents(bytes(&keyframe.image));
    recording.log("keyframe", &image)
}

/// The frustum of the camera.
fn pinhole(news: &News) -> Pinhole {
    let [fx, fy, cx, cy] = news.camera.intrinsics;
    Pinhole::from_focal_length_and_resolution([fx, fy], news.camera.size)
        .with_principal_point([cx, cy])
}

/// A pose in the map; lengths of what lies in it are in this unit.
fn transform(pose: &Pose, unit: f64) -> Transform3D {
    let at = |row: usize, column: usize| pose[4 * row + column] as f32;
    let column = |k: usize| [0, 1, 2].map(|row| unit as f32 * at(row, k));
    let matrix = Mat3x3::from([column(0), column(1), column(2)]);
    Transform3D::from_translation_mat3x3([at(0, 3), at(1, 3), at(2, 3)], matrix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// News as a run tells them, of two keyframes.
    fn news(version: u64, ended: bool) -> News {
        let identity = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let cloud =
            json!({"low": [0, 0, 1], "step": 0.1, "count": [1, 1], "points": "AQACAAMATf8="});
        let keyframe = |id: u32| json!({"id": id, "frame": 0, "image": "", "cloud": cloud});
        serde_json::from_value(json!({
            "version": version, "ended": ended, "frames": [3, 9], "rate": 30.0,
            "camera": {"intrinsics": [100, 100, 79.5, 59.5], "size": [160, 120]},
            "frame": {"index": 7, "state": "good", "reason": null, "pose": identity, "image": null},
            "path": [[6, 0, 0, 0], [7, 0.1, 0, 0]],
            "keyframes": [keyframe(0), keyframe(1)],
            "poses": [[0, 1.0, identity], [1, 2.0, identity]],
            "cells": {"edge": 0.1, "first": [0, 0, 0], "count": [1, 0], "smallest": 1,
                "occupied": "AAAAAAAAyAA=", "free": ""},
        }))
        .unwrap()
    }

    #[test]
    fn news_become_entities_and_the_end_waits_for_all_of_them() {
        let (recording, storage) = rerun::RecordingStreamBuilder::new("test").memory().unwrap();
        let mut shown = Shown::begin(&recording).unwrap();
        assert_eq!(shown.question(), "/live/0/0/1");
        assert!(
            !shown.take(&recording, &news(5, true)).unwrap(),
            "there may be more"
        );
        assert_eq!(shown.question(), "/live/5/2/1");
        assert!(shown.take(&recording, &news(5, true)).unwrap());
        recording.flush_blocking().unwrap();
        let mut entities: Vec<String> = storage
            .take()
            .into_iter()
            .filter_map(|message| match message {
                rerun::log::LogMsg::ArrowMsg(_, message) => {
                    let chunk = rerun::log::Chunk::from_arrow_msg(&message).ok()?;
                    Some(chunk.entity_path().to_string())
                }
                _ => None,
            })
            .collect();
        entities.sort();
        entities.dedup();
        for expected in [
            "/map",
            "/map/camera",
            "/map/camera/view",
            "/map/cells",
            "/map/keyframes/00000",
            "/map/keyframes/00001/points",
            "/map/path",
            "/tracking/rate",
            "/tracking/state",
        ] {
            assert!(
                entities.iter().any(|entity| entity == expected),
                "{expected} of {entities:?}"
            );
        }
    }
}
