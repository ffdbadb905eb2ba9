//! The images of keyframes: undistorted, in colour where the source has it.

use super::reconstruction::Reconstruction;
use monogrid_app::output::OutputFolder;
use monogrid_app::process::failure::Failure;
use monogrid_datasets::{RecordedKeyframe, Recording, decode_jpeg_rgb, encode_png};
use monogrid_image::Image;
use monogrid_report::colours::MAX_PIXELS;
use std::path::Path;

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

/// Colours of pixels; of one image after the other.
#[derive(Default)]
pub struct ColourOf {
    /// The keyframe asked for last, and its image where that has colour.
    decoded: Option<(u32, Option<Image<[u8; 3]>>)>,
}

impl ColourOf {
    /// The colour of the nearest pixel, grey where the image is.
    pub fn at(&mut self, keyframe: &RecordedKeyframe, [x, y]: [f64; 2]) -> [u8; 3] {
        if self.decoded.as_ref().map(|(id, _)| *id) != Some(keyframe.id) {
            let name = Path::new("colour of a keyframe");
            let decoded = |jpeg: &Vec<u8>| decode_jpeg_rgb(jpeg, MAX_PIXELS, name).ok()?;
            let image = keyframe.colour.as_ref().and_then(decoded);
            self.decoded = Some((keyframe.id, image));
        }
        let colours = self.decoded.as_ref().and_then(|(_, image)| image.as_ref());
        let nearest = |at: f64, size: usize| (at.round().max(0.0) as usize).min(size - 1);
        let within = |size: (usize, usize)| (nearest(x, size.0), nearest(y, size.1));
        match (colours, &keyframe.image) {
            (Some(image), _) => {
                let (x, y) = within((image.width(), image.height()));
                image.at(x, y)
            }
            (None, Some(image)) => {
                let (x, y) = within((image.width(), image.height()));
                [image.at(x, y); 3]
            }
            (None, None) => [0; 3],
        }
    }
}
