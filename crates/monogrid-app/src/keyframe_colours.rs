//! Colour of keyframes: read from the files once more when a keyframe is finished, or what a video
//! showed beside luma, and kept as JPEG, so that tracking knows nothing of it and no decoded image
//! stays in memory.

use crate::input::frame_colours::{FrameColour, FrameColours};
use crate::input::{Images, Input};
use monogrid_datasets::{FrameEntry, Levels, decode_jpeg_rgb, encode_jpeg_rgb, read_rgb_in};
use monogrid_image::Image;
use monogrid_pipeline::Preparation;
use monogrid_report::colours::{ColourImage, MAX_PIXELS};
use monogrid_slam::Keyframe;
use monogrid_video::Colour;
use std::path::Path;
use std::sync::Arc;

/// Quality of the JPEG images: errors of some grey levels, a third of the bytes of the grey image
/// in the recording.
const QUALITY: u8 = 88;

/// Where the colour of keyframes comes from.
#[derive(Clone, Debug)]
pub struct ColourSource {
    /// Those of image files, which are read once more; none of a video.
    files: Vec<FrameEntry>,
    /// What these use of 16 bits.
    levels: Levels,
    preparation: Preparation,
    /// Where what is seen only once is kept.
    pub kept: Arc<FrameColours>,
}

impl ColourSource {
    /// Image files and videos have colour; built-in worlds are grey.
    pub fn of(input: &Input) -> Option<Self> {
        let files = match &input.images {
            Images::Files(_) => input.frames.clone(),
            Images::Video(_) => Vec::new(),
            Images::Rendered(_) => return None,
        };
        Some(Self {
            files,
            levels: input.reading.levels,
            preparation: input.preparation.clone(),
            kept: Arc::default(),
        })
    }

    /// The working image of a keyframe in colour, as JPEG; `None` where it is grey, or cannot be
    /// read a second time. To be asked for once.
    pub fn keyframe(&self, keyframe: &Keyframe) -> Option<Vec<u8>> {
        let frame = keyframe.frame_index;
        let kept = self.kept.take(frame);
        let found = self.files.binary_search_by_key(&frame, |file| file.index);
        let image = match found {
            Ok(found) => {
                let image = read_rgb_in(&self.files[found].path, self.levels).ok()??;
                self.working(&image, &kept)?
            }
            Err(_) => self.shown_in_colour(&keyframe.image, &kept)?,
        };
        Some(encode_jpeg_rgb(&image, QUALITY))
    }

    /// A working image in the colours of its frame of a video.
    fn shown_in_colour(&self, working: &Image<u8>, kept: &FrameColour) -> Option<ColourImage> {
        match &kept.colour {
            Colour::Grey => None,
            Colour::Jpeg(bytes) => {
                let name = Path::new("frame of a video");
                let image = decode_jpeg_rgb(bytes, MAX_PIXELS, name).ok()??;
                self.working(&image, kept)
            }
            // the detail is that of luma, which tracking has prepared
            Colour::Chroma(chroma) => {
                let camera = self.preparation.camera();
                let differences = chroma.at_size((camera.width, camera.height));
                let differences = differences.map(|[blue, red]| [0, blue, red]);
                let differences = self.working(&differences, kept)?;
                let (width, height) = (working.width(), working.height());
                Some(Image::from_fn(width, height, |x, y| {
                    let [_, blue, red] = differences.at(x, y);
                    chroma.space().rgb(working.at(x, y), [blue, red])
                }))
            }
        }
    }

    /// An image of the camera as the working image shows it: undistorted, and rectified as the grey
    /// one was.
    fn working(&self, image: &ColourImage, kept: &FrameColour) -> Option<ColourImage> {
        let undistorted = self.preparation.apply_rgb(image).ok()?;
        match &kept.rectification {
            Some(rectification) => rectification.apply_rgb(&undistorted).ok(),
            None => Some(undistorted),
        }
    }
}
