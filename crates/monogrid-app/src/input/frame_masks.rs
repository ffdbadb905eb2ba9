//! A mask for all frames, or one for each: what is black in it (people, the robot's own body) is
//! made plain in the image before anybody looks at it.

use crate::args::SourceArgs;
use crate::input::image_files::spend;
use crate::input::video_source::{VideoItem, VideoSource, is_video};
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::{Dataset, FrameEntry, PixelBudget, SourceOptions, read_mask};
use monogrid_image::{GrayImage, Image, Mask, Resize, fill_masked, resize_mask};
use monogrid_pipeline::Unusable;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::iter::Peekable;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// How much the ratio of the sides of a mask may differ from that of the image.
const MAX_ASPECT_CHANGE: f64 = 0.005;

/// Endings of files that are one mask for all frames, also where they are damaged.
const IMAGES: [&str; 5] = ["png", "jpg", "jpeg", "pgm", "bmp"];

/// Masks of the frames of a source.
#[derive(Debug)]
pub struct FrameMasks {
    origin: Origin,
    /// Frames without one in the longest reading, and how many frames that had.
    missing: [AtomicUsize; 2],
}

#[derive(Debug)]
enum Origin {
    /// One for all frames.
    One(Mask),
    /// Files by the number of their frame, and what they are in.
    Files(Box<Dataset>, BTreeMap<usize, PathBuf>),
    /// A video: of each frame that of the same number.
    Video(Box<VideoSource>),
}

impl FrameMasks {
    /// What `--mask` names: an image, a folder, an archive or a video; `files` are those of the
    /// frames, where they are files.
    pub fn open(args: &SourceArgs, files: Option<&[FrameEntry]>) -> Result<Option<Self>, Failure> {
        let Some(path) = args.mask.as_deref() else {
            return Ok(None);
        };
        let ending = path.extension().unwrap_or_default().to_string_lossy();
        let is_named_so = IMAGES.contains(&&*ending.to_lowercase());
        let image = || read_mask(path);
        let origin = if !path.exists() || path.is_file() && (is_named_so || image().is_ok()) {
            Origin::One(image().bad_input()?)
        } else if is_video(path) {
            let whole = SourceArgs {
                source_timeout: args.source_timeout,
                ..SourceArgs::default()
            };
            Origin::Video(Box::new(VideoSource::open(path, &whole)?))
        } else {
            let masks = Dataset::open(path, SourceOptions::default()).bad_input()?;
            let by_frame = match files {
                Some(frames) => by_name(&masks, frames)?,
                None => by_number(&masks),
            };
            Origin::Files(Box::new(masks), by_frame)
        };
        Ok(Some(Self {
            origin,
            missing: [0, 0].map(AtomicUsize::new),
        }))
    }

    /// Whether that of any frame can be asked for.
    pub fn is_any_known(&self) -> bool {
        !matches!(self.origin, Origin::Video(_))
    }

    /// An error if it is one for all frames, and not of images of this size or all of it is black.
    pub fn check(&self, size: (usize, usize)) -> Result<(), Failure> {
        let Origin::One(mask) = &self.origin else {
            return Ok(());
        };
        if mask.as_slice().iter().all(|used| *used == 0) {
            return Err(Failure::input(
                "--mask: all of it is black, which leaves nothing of the images; what may be used \
                 is white",
            ));
        }
        mask_at(mask, size)
            .map(|_| ())
            .map_err(|reason| Failure::input(format!("--mask: {reason}")))
    }

    /// These frames, in ascending order, without what their masks name.
    pub fn applied<'a>(
        &'a self,
        items: Box<dyn Iterator<Item = VideoItem> + Send + 'a>,
    ) -> Box<dyn Iterator<Item = VideoItem> + Send + 'a> {
        let mut masks = match &self.origin {
            Origin::One(mask) => InOrder::One(mask),
            Origin::Files(dataset, files) => InOrder::Files(files, dataset.pixel_budget()),
            Origin::Video(video) => InOrder::Video(video.frames(None).peekable()),
        };
        let (mut num_missing, mut num_read) = (0, 0);
        Box::new(items.map(move |(index, time_ns, image)| {
            let image = image.and_then(|mut image| {
                let mask = masks.of(index)?;
                num_read += 1;
                num_missing += usize::from(mask.is_none());
                if num_read >= self.missing[1].load(Ordering::Relaxed) {
                    self.missing[0].store(num_missing, Ordering::Relaxed);
                    self.missing[1].store(num_read, Ordering::Relaxed);
                }
                if let Some(mask) = mask {
                    apply(&mut image, &mask)?;
                }
                Ok(image)
            });
            (index, time_ns, image)
        }))
    }

    /// The mask of a frame, if it has one; `None` where they are a video.
    fn of(&self, frame: usize) -> Result<Option<Cow<'_, Mask>>, Unusable> {
        match &self.origin {
            Origin::One(mask) => Ok(Some(Cow::Borrowed(mask))),
            Origin::Files(_, files) => {
                let mask = files.get(&frame).map(|path| read(path)).transpose()?;
                Ok(mask.map(Cow::Owned))
            }
            Origin::Video(_) => Ok(None),
        }
    }

    /// The mask of a frame for images of this size, if it has one; `None` where they are a video,
    /// or this one cannot be used.
    pub fn of_size(&self, frame: usize, size: (usize, usize)) -> Option<Mask> {
        let mask = self.of(frame).ok()??;
        mask_at(&mask, size).ok().map(Cow::into_owned)
    }

    /// The image of a frame without what its mask names, unless the masks are a video.
    pub fn apply_to(&self, frame: usize, mut image: GrayImage) -> Result<GrayImage, Unusable> {
        if let Some(mask) = self.of(frame)? {
            apply(&mut image, &mask)?;
        }
        Ok(image)
    }

    /// An image in colour without what the mask of its frame names; `None` where the masks are a
    /// video, or this one cannot be read.
    pub fn apply_to_rgb(&self, frame: usize, image: &Image<[u8; 3]>) -> Option<Image<[u8; 3]>> {
        if !self.is_any_known() {
            return None;
        }
        let Some(mask) = self.of(frame).ok()? else {
            return Some(image.clone());
        };
        let mut channels = [0, 1, 2].map(|c| image.map(|pixel| f32::from(pixel[c])));
        for channel in &mut channels {
            apply(channel, &mask).ok()?;
        }
        let pixel = |x, y| [0, 1, 2].map(|c: usize| channels[c].at(x, y).round() as u8);
        Some(Image::from_fn(image.width(), image.height(), pixel))
    }

    /// What was missing in the longest reading, for people.
    pub fn fault(&self) -> Option<String> {
        let [missing, read] = [0, 1].map(|k| self.missing[k].load(Ordering::Relaxed));
        (missing > 0)
            .then(|| format!("{missing} of {read} frames have no mask: all of them is used"))
    }
}

/// Masks as a reading of the source needs them.
enum InOrder<'a> {
    One(&'a Mask),
    Files(&'a BTreeMap<usize, PathBuf>, PixelBudget),
    Video(Peekable<Box<dyn Iterator<Item = VideoItem> + Send + 'a>>),
}

impl InOrder<'_> {
    fn of(&mut self, frame: usize) -> Result<Option<Cow<'_, Mask>>, Unusable> {
        match self {
            Self::One(mask) => Ok(Some(Cow::Borrowed(mask))),
            Self::Files(files, budget) => {
                let mask = files.get(&frame).map(|path| read(path)).transpose()?;
                if let Some(mask) = &mask {
                    spend(budget, (mask.width(), mask.height()))?;
                }
                Ok(mask.map(Cow::Owned))
            }
            Self::Video(masks) => {
                while masks.next_if(|(index, ..)| *index < frame).is_some() {}
                let Some((_, _, mask)) = masks.next_if(|(index, ..)| *index == frame) else {
                    return Ok(None);
                };
                let mask = mask?.map(|v| if v < 128.0 { 0 } else { 255 });
                Ok(Some(Cow::Owned(mask)))
            }
        }
    }
}

/// A frame whose mask cannot be read is not used.
fn read(path: &Path) -> Result<Mask, Unusable> {
    read_mask(path).map_err(|error| Unusable::Unreadable(error.to_string()))
}

fn apply(image: &mut GrayImage, mask: &Mask) -> Result<(), Unusable> {
    let mask = mask_at(mask, (image.width(), image.height()));
    fill_masked(image, &*mask.map_err(Unusable::Unreadable)?);
    Ok(())
}

/// A mask of another size with the same ratio of sides is brought to that of the images.
fn mask_at(mask: &Mask, (width, height): (usize, usize)) -> Result<Cow<'_, Mask>, String> {
    let ratio = (mask.width() * height) as f64 / (mask.height() * width) as f64;
    if (ratio - 1.0).abs() > MAX_ASPECT_CHANGE {
        return Err(format!(
            "the mask is {}x{} pixels, the image is {width}x{height}; expected that size, or \
             another with the same ratio of sides",
            mask.width(),
            mask.height()
        ));
    }
    if (mask.width(), mask.height()) == (width, height) {
        return Ok(Cow::Borrowed(mask));
    }
    Ok(Cow::Owned(resize_mask(mask, Resize { width, height })))
}

/// Masks by the names of the images: `NAME.png` or `NAME.jpg.png` is that of `NAME.jpg`. Where no
/// name is that of an image and there are as many as images, they are in the same order.
fn by_name(masks: &Dataset, frames: &[FrameEntry]) -> Result<BTreeMap<usize, PathBuf>, Failure> {
    let by_stem: BTreeMap<_, &Path> = masks
        .frames
        .iter()
        .filter_map(|mask| Some((mask.path.file_stem()?, &*mask.path)))
        .collect();
    let of_name = |frame: &FrameEntry| {
        let [stem, name] = [frame.path.file_stem()?, frame.path.file_name()?];
        let mask = by_stem.get(stem).or_else(|| by_stem.get(name))?;
        Some((frame.index, mask.to_path_buf()))
    };
    let named: BTreeMap<usize, PathBuf> = frames.iter().filter_map(of_name).collect();
    let last = frames.last().map_or(0, |frame| frame.index);
    match named.is_empty() {
        false => Ok(named),
        true if masks.frames.len() > last => Ok(by_number(masks)),
        true => Err(Failure::input(format!(
            "--mask {}: none of its {} images has the name of an image of the source, and they are \
             fewer than its {}; expected NAME.png for NAME.jpg",
            masks.root.display(),
            masks.frames.len(),
            last + 1
        ))),
    }
}

/// Masks in natural order of their names.
fn by_number(masks: &Dataset) -> BTreeMap<usize, PathBuf> {
    let all = masks.frames.iter().enumerate();
    all.map(|(number, mask)| (number, mask.path.clone()))
        .collect()
}
