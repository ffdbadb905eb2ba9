//! Colour of keyframes: read from the source once more when a keyframe is finished, and kept as JPEG, so that tracking knows nothing
//! of it and no decoded image stays in memory.

use crate::failure::{Classify, Failure};
use crate::input::{Images, Input};
use monogrid_datasets::{
    FrameEntry, ReadOptions, Record, RecordedKeyframe, RecordingReader, decode_jpeg_rgb,
    encode_jpeg_rgb, read_rgb,
};
use monogrid_image::Image;
use monogrid_pipeline::Preparation;
use std::collections::BTreeMap;
use std::path::Path;

/// An image in colour: red, green, blue.
pub type ColourImage = Image<[u8; 3]>;

/// Quality of the JPEG images: errors of some grey levels, a third of the bytes of the grey image in the recording.
const QUALITY: u8 = 88;

/// Most pixels of a keyframe's image.
const MAX_PIXELS: usize = 1 << 26;

/// The images of a source in colour, where its frames can be read in any order.
#[derive(Clone, Debug)]
pub struct ColourSource {
    frames: Vec<FrameEntry>,
    preparation: Preparation,
}

impl ColourSource {
    /// Image files have colour; videos are read once and in order, and built-in worlds are grey.
    pub fn of(input: &Input) -> Option<Self> {
        matches!(input.images, Images::Files(_)).then(|| Self {
            frames: input.frames.clone(),
            preparation: input.preparation.clone(),
        })
    }

    /// The working image of a frame in colour, as JPEG; `None` where it is grey, or cannot be read a second time.
    pub fn frame(&self, index: usize) -> Option<Vec<u8>> {
        let found = self
            .frames
            .binary_search_by_key(&index, |frame| frame.index);
        let image = read_rgb(&self.frames[found.ok()?].path).ok()??;
        let prepared = self.preparation.apply_rgb(&image).ok()?;
        Some(encode_jpeg_rgb(&prepared, QUALITY))
    }
}

/// The keyframes of a recording in colour, as JPEG, by identity; keyframes of grey sources are not there.
#[derive(Clone, Debug, Default)]
pub struct Colours(BTreeMap<u32, Vec<u8>>);

impl Colours {
    /// Of a recording in memory.
    pub fn of(keyframes: &[RecordedKeyframe]) -> Self {
        let colour = |k: &RecordedKeyframe| Some((k.id, k.colour.clone()?));
        Self(keyframes.iter().filter_map(colour).collect())
    }

    /// Of a recording on disk; none where there is no file.
    pub fn read(recording: &Path) -> Result<Self, Failure> {
        if !recording.is_file() {
            return Ok(Self::default());
        }
        let mut colours = BTreeMap::new();
        for record in RecordingReader::open(recording, ReadOptions::default()).bad_input()? {
            if let Record::Colour(colour) = record.bad_input()? {
                colours.insert(colour.keyframe_id, colour.jpeg);
            }
        }
        Ok(Self(colours))
    }

    /// The JPEG file of a keyframe.
    pub fn jpeg(&self, id: u32) -> Option<&[u8]> {
        self.0.get(&id).map(Vec::as_slice)
    }

    /// A keyframe in colour.
    pub fn of_keyframe(&self, id: u32) -> Option<ColourImage> {
        let name = Path::new("colour of a keyframe");
        decode_jpeg_rgb(self.jpeg(id)?, MAX_PIXELS, name).ok()?
    }
}
