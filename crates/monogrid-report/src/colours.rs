//! Colour of the keyframes of a recording.

use crate::ReportError;
use monogrid_datasets::{ReadOptions, Record, RecordedKeyframe, RecordingReader, decode_jpeg_rgb};
use monogrid_image::Image;
use std::collections::BTreeMap;
use std::path::Path;

/// An image in colour: red, green, blue.
pub type ColourImage = Image<[u8; 3]>;

/// Most pixels of a keyframe's image.
pub const MAX_PIXELS: usize = 1 << 26;

/// The keyframes of a recording in colour, as JPEG, by identity; keyframes of grey sources are not
/// there.
#[derive(Clone, Debug, Default)]
pub struct Colours(BTreeMap<u32, Vec<u8>>);

impl FromIterator<(u32, Vec<u8>)> for Colours {
    fn from_iter<T: IntoIterator<Item = (u32, Vec<u8>)>>(keyframes: T) -> Self {
        Self(keyframes.into_iter().collect())
    }
}

impl Colours {
    /// Of a recording in memory.
    pub fn of(keyframes: &[RecordedKeyframe]) -> Self {
        let colour = |k: &RecordedKeyframe| Some((k.id, k.colour.clone()?));
        Self(keyframes.iter().filter_map(colour).collect())
    }

    /// Of a recording on disk; none where there is no file.
    pub fn read(recording: &Path) -> Result<Self, ReportError> {
        if !recording.is_file() {
            return Ok(Self::default());
        }
        let mut colours = BTreeMap::new();
        for record in RecordingReader::open(recording, ReadOptions::default())? {
            if let Record::Colour(colour) = record? {
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
