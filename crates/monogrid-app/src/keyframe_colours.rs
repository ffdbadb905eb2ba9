//! Colour of keyframes: read from the files once more when a keyframe is finished, or what a video
//! showed beside luma, and kept as JPEG, so that tracking knows nothing of it and no decoded image
//! stays in memory.

use crate::input::frame_colours::{FrameColour, FrameColours};
use crate::input::frame_masks::FrameMasks;
use crate::input::{Images, Input};
use monogrid_datasets::{FrameEntry, Levels, decode_jpeg_rgb, encode_jpeg_rgb, read_rgb_in};
use monogrid_image::Image;
use monogrid_pipeline::Preparation;
use monogrid_report::colours::{ColourImage, MAX_PIXELS};
use monogrid_slam::Keyframe;
use monogrid_video::Colour;
use monogrid_worlds::{Renderer, SynthSequence, Tint};
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
    /// A built-in world, and the camera of the working images.
    rendered: Option<Arc<(SynthSequence, Renderer)>>,
    /// What these use of 16 bits.
    levels: Levels,
    masks: Option<Arc<FrameMasks>>,
    preparation: Preparation,
    /// Where what is seen only once is kept.
    pub kept: Arc<FrameColours>,
}

impl ColourSource {
    /// What the images of an input are asked for.
    pub fn of(input: &Input) -> Self {
        let files = match &input.images {
            Images::Files(_) => input.frames.clone(),
            Images::Video(_) | Images::Rendered(_) => Vec::new(),
        };
        let rendered = match &input.images {
            Images::Rendered(sequence) => {
                let camera = *input.preparation.camera();
                let renderer = Renderer::new(&camera, 1.0);
                Some(Arc::new((sequence.as_ref().clone(), renderer)))
            }
            Images::Files(_) | Images::Video(_) => None,
        };
        Self {
            files,
            rendered,
            levels: input.reading.levels,
            masks: input.reading.masks.clone(),
            preparation: input.preparation.clone(),
            kept: Arc::default(),
        }
    }

    /// The working image of a keyframe in colour, as JPEG; `None` where it is grey, or cannot be
    /// read a second time. To be asked for once.
    pub fn keyframe(&self, keyframe: &Keyframe) -> Option<Vec<u8>> {
        let frame = keyframe.frame_index;
        if let Some(rendered) = &self.rendered {
            let (sequence, renderer) = rendered.as_ref();
            let tints = sequence.tints_through(renderer, frame)?;
            let image = in_tints(&keyframe.image, &tints)?;
            return Some(encode_jpeg_rgb(&image, QUALITY));
        }
        let kept = self.kept.take(frame);
        let found = self.files.binary_search_by_key(&frame, |file| file.index);
        let image = match found {
            Ok(found) => {
                let image = read_rgb_in(&self.files[found].path, self.levels).ok()??;
                self.working(&self.masked(frame, image)?, &kept)?
            }
            Err(_) => self.shown_in_colour(frame, &keyframe.image, &kept)?,
        };
        Some(encode_jpeg_rgb(&image, QUALITY))
    }

    /// A working image in the colours of its frame of a video.
    fn shown_in_colour(
        &self,
        frame: usize,
        working: &Image<u8>,
        kept: &FrameColour,
    ) -> Option<ColourImage> {
        match &kept.colour {
            Colour::Grey => None,
            Colour::Jpeg(bytes) => {
                let name = Path::new("frame of a video");
                let image = decode_jpeg_rgb(bytes, MAX_PIXELS, name).ok()??;
                self.working(&self.masked(frame, image)?, kept)
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

    /// An image of the camera without what the mask of its frame names; `None` where that cannot be
    /// asked for again.
    fn masked(&self, frame: usize, image: ColourImage) -> Option<ColourImage> {
        match &self.masks {
            Some(masks) => masks.apply_to_rgb(frame, &image),
            None => Some(image),
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

/// A grey image in the colours of what it shows; `None` where their sizes differ.
fn in_tints(grey: &Image<u8>, tints: &Image<Tint>) -> Option<ColourImage> {
    let (width, height) = (grey.width(), grey.height());
    ((tints.width(), tints.height()) == (width, height)).then(|| {
        Image::from_fn(width, height, |x, y| {
            let level = f32::from(grey.at(x, y));
            tints.at(x, y).map(|share| (level * share).round() as u8)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Camera, Distortion};

    #[test]
    fn a_built_in_room_has_colours_that_do_not_change_its_grey() {
        let sequence = SynthSequence::small_demo().unwrap();
        let camera = *sequence.camera();
        let camera = Camera::try_new(320, 240, camera.pinhole, Distortion::None).unwrap();
        let tints = sequence.tints_through(&Renderer::new(&camera, 1.0), 30);
        let grey = sequence.frame(30).unwrap().image.map(|value| value as u8);
        let image = in_tints(&grey, &tints.unwrap()).unwrap();
        let pixels = image.as_slice().iter().zip(grey.as_slice());
        let (mut coloured, mut same) = (0, 0);
        for ([r, g, b], grey) in pixels {
            let [r, g, b] = [*r, *g, *b].map(f32::from);
            let luma = 0.299 * r + 0.587 * g + 0.114 * b;
            same += usize::from((luma - f32::from(*grey)).abs() < 2.0);
            coloured += usize::from(r.max(g).max(b) > 1.2 * r.min(g).min(b));
        }
        let all = grey.as_slice().len();
        // a channel that is full cannot be brighter
        assert!(same > all * 9 / 10, "{same} of {all}");
        assert!(coloured > all / 3, "{coloured} of {all}");
        let small = Image::filled(2, 2, 0);
        assert!(in_tints(&small, &Image::filled(3, 2, [1.0; 3])).is_none());
    }
}
