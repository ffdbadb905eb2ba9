//! Colour of keyframes: read from the files once more when a keyframe is finished, or what a video showed beside luma, and kept as JPEG,
//! so that tracking knows nothing of it and no decoded image stays in memory.

use crate::failure::{Classify, Failure};
use crate::input::{Images, Input};
use crate::video_colours::VideoColours;
use monogrid_datasets::{
    FrameEntry, ReadOptions, Record, RecordedKeyframe, RecordingReader, decode_jpeg_rgb,
    encode_jpeg_rgb, read_rgb,
};
use monogrid_image::Image;
use monogrid_pipeline::Preparation;
use monogrid_slam::Keyframe;
use monogrid_video::Colour;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// An image in colour: red, green, blue.
pub type ColourImage = Image<[u8; 3]>;

/// Quality of the JPEG images: errors of some grey levels, a third of the bytes of the grey image in the recording.
const QUALITY: u8 = 88;

/// Most pixels of a keyframe's image.
const MAX_PIXELS: usize = 1 << 26;

/// Where the colour of keyframes comes from.
#[derive(Clone, Debug)]
pub enum ColourSource {
    /// Files, which are read once more.
    Files(Vec<FrameEntry>, Preparation),
    /// A video, of which colours are kept as it is read.
    Video(Arc<VideoColours>, Preparation),
}

impl ColourSource {
    /// Image files and videos have colour; built-in worlds are grey.
    pub fn of(input: &Input) -> Option<Self> {
        let preparation = input.preparation.clone();
        match &input.images {
            Images::Files(_) => Some(Self::Files(input.frames.clone(), preparation)),
            Images::Video(_) => Some(Self::Video(Arc::default(), preparation)),
            Images::Rendered(_) => None,
        }
    }

    /// Where the colours of a video go as it is read.
    pub fn of_video(&self) -> Option<&Arc<VideoColours>> {
        match self {
            Self::Files(..) => None,
            Self::Video(colours, _) => Some(colours),
        }
    }

    /// The working image of a keyframe in colour, as JPEG; `None` where it is grey, or cannot be read a second time. Those of a
    /// video can be asked for once.
    pub fn keyframe(&self, keyframe: &Keyframe) -> Option<Vec<u8>> {
        let image = match self {
            Self::Files(frames, preparation) => {
                let frame = &keyframe.frame_index;
                let found = frames.binary_search_by_key(frame, |frame| frame.index);
                let image = read_rgb(&frames[found.ok()?].path).ok()??;
                preparation.apply_rgb(&image).ok()?
            }
            Self::Video(colours, preparation) => {
                let colour = colours.take(keyframe.frame_index);
                shown_in_colour(&keyframe.image, &colour, preparation)?
            }
        };
        Some(encode_jpeg_rgb(&image, QUALITY))
    }
}

/// A working image in the colours of its frame.
fn shown_in_colour(
    working: &Image<u8>,
    colour: &Colour,
    preparation: &Preparation,
) -> Option<ColourImage> {
    match colour {
        Colour::Grey => None,
        Colour::Jpeg(bytes) => {
            let name = Path::new("frame of a video");
            let image = decode_jpeg_rgb(bytes, MAX_PIXELS, name).ok()??;
            preparation.apply_rgb(&image).ok()
        }
        // the detail is that of luma, which tracking has prepared
        Colour::Chroma(chroma) => {
            let camera = preparation.camera();
            let differences = chroma.at_size((camera.width, camera.height));
            let differences = differences.map(|[blue, red]| [0, blue, red]);
            let differences = preparation.apply_rgb(&differences).ok()?;
            let (width, height) = (working.width(), working.height());
            Some(Image::from_fn(width, height, |x, y| {
                let [_, blue, red] = differences.at(x, y);
                chroma.space().rgb(working.at(x, y), [blue, red])
            }))
        }
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
