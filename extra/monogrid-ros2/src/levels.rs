//! The part of 16 bits that a live camera uses: that of its first images, as of files.

use monogrid_datasets::Levels;
use monogrid_image::GrayImage;

/// Of one camera.
#[derive(Debug, Default)]
pub struct LiveLevels {
    first: Vec<GrayImage>,
    known: Option<Levels>,
}

impl LiveLevels {
    /// An image of all 16 bits in the levels of the camera.
    ///
    /// # Errors
    /// An image that these are not known by yet: all but the last of the first ones.
    pub fn show(&mut self, image: GrayImage) -> Result<GrayImage, String> {
        if let Some(levels) = self.known {
            return Ok(levels.of_all(&image));
        }
        self.first.push(image);
        if self.first.len() < Levels::NUM_IMAGES {
            let count = Levels::NUM_IMAGES;
            return Err(format!(
                "the first {count} images say what part of their 16 bits is used"
            ));
        }
        let first = std::mem::take(&mut self.first);
        let newest = first[first.len() - 1].clone();
        let levels = Levels::of_grey(first);
        self.known = Some(levels);
        Ok(levels.of_all(&newest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_of_twelve_bits_is_shown_from_black_to_white() {
        let mut levels = LiveLevels::default();
        // 12 of 16 bits: the upper 8 bits are at most 15
        let image = || GrayImage::from_fn(64, 64, |x, y| (x + 64 * y) as f32 / 257.0);
        for _ in 1..Levels::NUM_IMAGES {
            assert!(levels.show(image()).unwrap_err().contains("16 bits"));
        }
        for _ in 0..2 {
            let shown = levels.show(image()).unwrap();
            let white = shown.at(63, 63);
            assert!(
                shown.at(0, 0) == 0.0 && (white - 255.0).abs() < 1.0,
                "{white}"
            );
        }
    }
}
