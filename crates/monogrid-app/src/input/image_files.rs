//! Image files, read one after the other in a thread of their own.

use crate::input::video_source::VideoItem;
use monogrid_datasets::{FrameEntry, Levels, PixelBudget, read_gray_in};
use monogrid_image::Image;
use monogrid_pipeline::Unusable;
use monogrid_video::{Aside, Patience, Sink, Waited};
use std::sync::atomic::{AtomicU64, Ordering};

/// The image, if there is room for it.
pub fn within<T: Copy>(budget: &mut PixelBudget, image: Image<T>) -> Result<Image<T>, Unusable> {
    spend(budget, (image.width(), image.height())).map(|()| image)
}

/// Takes an image of this size out of the budget; the source breaks off where there is no room.
pub fn spend(budget: &mut PixelBudget, (width, height): (usize, usize)) -> Result<(), Unusable> {
    let spent = budget.spend(width, height);
    spent.map_err(|error| Unusable::BrokeOff(error.to_string()))
}

/// The images of these files in their order, which use so much of 16 bits and have so many pixels
/// at most; `cpu_ns` hears of the CPU time of reading them.
pub fn read_files<'a>(
    (files, levels, mut budget): (Vec<FrameEntry>, Levels, PixelBudget),
    patience: Patience,
    cpu_ns: &'a AtomicU64,
) -> Box<dyn Iterator<Item = VideoItem> + Send + 'a> {
    let broke_off = |reason: String| (0, 0, Err(Unusable::BrokeOff(reason)));
    let work = move |sink: &Sink<VideoItem>| {
        for file in files {
            let image = read_gray_in(&file.path, levels);
            let image = image.map_err(|error| Unusable::Unreadable(error.to_string()));
            let image = image.and_then(|image| within(&mut budget, image));
            let is_last = matches!(image, Err(Unusable::BrokeOff(_)));
            if !sink.put((file.index, file.timestamp_ns, image)) || is_last {
                return;
            }
        }
    };
    let mut images = match Aside::start("source", patience, work) {
        Ok(images) => Some(images),
        Err(error) => return Box::new(std::iter::once(broke_off(error.to_string()))),
    };
    Box::new(std::iter::from_fn(move || {
        let waited = images.as_mut()?;
        let item = match waited.wait() {
            Waited::Item(item) => {
                cpu_ns.store(waited.cpu().as_nanos() as u64, Ordering::Relaxed);
                return Some(item);
            }
            Waited::Ended | Waited::Interrupted => None,
            Waited::TooLong(limit) => Some(broke_off(format!(
                "an image file could not be read for {} s",
                limit.as_secs_f64()
            ))),
        };
        images = None;
        item
    }))
}
