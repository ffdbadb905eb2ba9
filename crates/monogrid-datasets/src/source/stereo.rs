//! The images of the second camera of a stereo pair, beside the frames of a sequence.

use super::Dataset;
use crate::files::is_file;
use crate::{DatasetError, FrameEntry, SecondCamera};
use std::path::{Path, PathBuf};

/// Folders of a first camera, and of the second one beside it: EuRoC's and TUM-VI's, KITTI's grey
/// and coloured ones, and those of its raw recordings.
const PAIRS: [[&str; 2]; 5] = [
    ["cam0", "cam1"],
    ["image_0", "image_1"],
    ["image_2", "image_3"],
    ["image_00", "image_01"],
    ["image_02", "image_03"],
];

/// Files in which the calibration of a pair lies, in the folder of the sequence and, for KITTI's
/// raw recordings, around it.
const CALIBRATIONS: [&str; 4] = [
    "calib.txt",
    "calib_cam_to_cam.txt",
    "camchain.yaml",
    "dso/camchain.yaml",
];

impl Dataset {
    /// The image of the second camera that was taken with a frame: that of the same name in the
    /// folder of the other camera. `None` where there is none.
    #[must_use]
    pub fn second_image(&self, frame: &FrameEntry) -> Option<PathBuf> {
        let (_, second) = beside(&frame.path)?;
        Some(second).filter(|path| is_file(path))
    }

    /// How many frames have an image of the second camera.
    #[must_use]
    pub fn num_second_images(&self) -> usize {
        let frames = self.frames.iter();
        frames.filter_map(|frame| self.second_image(frame)).count()
    }

    /// The second camera of a stereo pair; `None` where no frame has a second image.
    ///
    /// Its calibration is that of `file`, if that is for two cameras, or else of the source:
    /// EuRoC's `sensor.yaml` of both cameras, KITTI's projection matrices, or Kalibr's chain of
    /// cameras. `image_size` (width, height) is that of formats that do not say it.
    ///
    /// # Errors
    /// When there is no calibration of a pair, or one that cannot be understood.
    pub fn second_camera(
        &self,
        file: Option<&Path>,
        image_size: (usize, usize),
    ) -> Result<Option<SecondCamera>, DatasetError> {
        let has_second = |frame: &&FrameEntry| self.second_image(frame).is_some();
        let frame = self.frames.iter().find(has_second);
        let pair = frame.and_then(|frame| Some((frame, beside(&frame.path)?)));
        let Some((frame, (names, second))) = pair else {
            return Ok(None);
        };
        let numbers = names.map(|name| name.trim_start_matches(|c: char| !c.is_ascii_digit()));
        let of_file = |file: &Path| SecondCamera::of_file(file, numbers, image_size);
        if let Some(camera) = file.map(of_file).transpose()?.flatten() {
            return Ok(Some(camera));
        }
        if let (Some(first), Some(second)) = (sensor_file(&frame.path), sensor_file(&second))
            && let Some(camera) = SecondCamera::of_sensors([&first, &second], image_size)?
        {
            return Ok(Some(camera));
        }
        let around = self.root.ancestors().take(3);
        let files = around.flat_map(|folder| CALIBRATIONS.map(|name| folder.join(name)));
        for file in files.filter(|path| is_file(path)) {
            if let Some(camera) = of_file(&file)? {
                return Ok(Some(camera));
            }
        }
        let found = "images of two cameras without the calibration of a stereo pair";
        let expected = "the sensor.yaml of both (EuRoC), calib.txt with P0 and P1 (KITTI), or \
                        camchain.yaml (Kalibr), there or with --calibration";
        Err(DatasetError::content(&self.root, found, expected))
    }
}

/// The names of the folders of a pair, and where the second camera has the image of a first one.
fn beside(image: &Path) -> Option<([&'static str; 2], PathBuf)> {
    let folders = image.ancestors().skip(1);
    folders
        .filter_map(|folder| Some((folder, folder.file_name()?)))
        .find_map(|(folder, name)| {
            let pair = PAIRS.iter().find(|[first, _]| name == *first)?;
            let below = image.strip_prefix(folder).ok()?;
            Some((*pair, folder.with_file_name(pair[1]).join(below)))
        })
}

/// EuRoC's description of the camera that took an image.
fn sensor_file(image: &Path) -> Option<PathBuf> {
    let file = image.parent()?.parent()?.join("sensor.yaml");
    is_file(&file).then_some(file)
}
