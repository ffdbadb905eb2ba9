//! How many pixels the images of one source may have together.

use std::path::{Path, PathBuf};

/// How many pixels there may be.
struct Allowance {
    /// Whatever is stored.
    any: u64,
    /// More for each byte of the first megabyte: what is as small must be read in seconds.
    per_small_byte: u64,
    /// More for each byte behind that.
    per_byte: u64,
}

/// Bytes that are a small source.
const SMALL_BYTES: u64 = 1 << 20;

/// Of images and videos. Images that can be tracked have 1 to 20 pixels for a byte, plain ones up
/// to eight thousand; videos only store what changes: 1080p of 30 frames per second has 500 at
/// 1 Mbit/s. Any may have four hundred images of 640 x 480.
const SOURCE: Allowance = Allowance {
    any: 1 << 27,
    per_small_byte: 256,
    per_byte: 4096,
};

/// Of the keyframes of a recording: there is depth beside the images, so that those that were
/// recorded have two at most. Making dense depth takes a second for a million.
const RECORDING: Allowance = Allowance {
    any: 1 << 21,
    per_small_byte: 8,
    per_byte: 16,
};

/// Too many pixels for what a source stores: a small file must not cost hours.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{path:?} stores {stored_bytes} bytes and shows more than {most} pixels, the most that are \
     read of so little; if you trust it, use fewer of its frames, or store them with less \
     compression"
)]
pub struct TooManyPixels {
    /// The source.
    pub path: PathBuf,
    /// What it stores.
    pub stored_bytes: u64,
    /// What is read of so much.
    pub most: u64,
}

/// What the images of one source have left. One image is bounded by its own file; this bounds all
/// of them together, so that reading a source takes a time in proportion to its bytes.
#[derive(Clone, Debug)]
pub struct PixelBudget {
    path: PathBuf,
    stored_bytes: u64,
    most: u64,
    spent: u64,
}

impl PixelBudget {
    /// Of a video, or of image files that have so many bytes together.
    #[must_use]
    pub fn of_source(path: &Path, stored_bytes: u64) -> Self {
        Self::new(path, stored_bytes, &SOURCE)
    }

    /// Of the keyframes of a recording of so many bytes.
    #[must_use]
    pub fn of_recording(path: &Path, stored_bytes: u64) -> Self {
        Self::new(path, stored_bytes, &RECORDING)
    }

    fn new(path: &Path, stored_bytes: u64, allowance: &Allowance) -> Self {
        let small = stored_bytes.min(SMALL_BYTES);
        let more = (stored_bytes - small).saturating_mul(allowance.per_byte);
        let most = allowance.any + small * allowance.per_small_byte;
        Self {
            path: path.to_owned(),
            stored_bytes,
            most: most.saturating_add(more),
            spent: 0,
        }
    }

    /// Takes an image of this size out of it.
    ///
    /// # Errors
    /// When there was not so much left.
    pub fn spend(&mut self, width: usize, height: usize) -> Result<(), TooManyPixels> {
        let pixels = (width as u64).saturating_mul(height as u64);
        self.spent = self.spent.saturating_add(pixels);
        if self.spent <= self.most {
            return Ok(());
        }
        Err(TooManyPixels {
            path: self.path.clone(),
            stored_bytes: self.stored_bytes,
            most: self.most,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Images of a megapixel that are read.
    fn images_of(mut budget: PixelBudget) -> u64 {
        (0..).find(|_| budget.spend(1024, 1024).is_err()).unwrap()
    }

    #[test]
    fn what_may_be_read_grows_with_what_is_stored() {
        let path = Path::new("a.zip");
        let of_source = |bytes| images_of(PixelBudget::of_source(path, bytes));
        assert_eq!(of_source(0), 128);
        assert_eq!(of_source(1 << 20), 128 + 256);
        assert_eq!(of_source(2 << 20), 128 + 256 + 4096);
        assert_eq!(images_of(PixelBudget::of_recording(path, 1 << 20)), 2 + 8);
        let mut largest = PixelBudget::of_source(path, u64::MAX);
        assert_eq!(largest.spend(usize::MAX, usize::MAX), Ok(()));
    }

    #[test]
    fn what_is_too_much_is_named() {
        let mut budget = PixelBudget::of_source(Path::new("plain.zip"), 1000);
        let error = budget.spend(1 << 20, 1 << 20).unwrap_err().to_string();
        assert!(error.contains("plain.zip\" stores 1000 bytes"), "{error}");
        assert!(error.contains("more than 134473728 pixels"), "{error}");
    }
}
