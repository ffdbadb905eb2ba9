//! The images of keyframes: undistorted, in colour where the source has it.

use super::reconstruction::Reconstruction;
use monogrid_app::output::OutputFolder;
use monogrid_app::process::failure::Failure;
use monogrid_datasets::{Recording, encode_png};

/// The folder with the images.
pub const FOLDER: &str = "images";

/// Writes the image of each view.
pub fn write(
    folder: &OutputFolder,
    recording: &Recording,
    scene: &Reconstruction,
) -> Result<(), Failure> {
    for view in &scene.views {
        let keyframe = &recording.keyframes[view.keyframe];
        let name = format!("{FOLDER}/{}", view.name);
        match (&keyframe.colour, &keyframe.image) {
            (Some(jpeg), _) => folder.write(&name, jpeg)?,
            (None, Some(image)) => folder.write(&name, encode_png(image))?,
            (None, None) => {}
        }
    }
    Ok(())
}
