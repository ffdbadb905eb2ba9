//! From images of the camera to working images.

use crate::shutter::Shutter;
use crate::unusable::{Unusable, each_channel};
use monogrid_geometry::{Camera, Pinhole, ReadoutDirection};
use monogrid_image::{GrayImage, Image, Mask, Photometric, Undistorter, WorkingSize};

/// Undistortion, photometric correction and working size of one camera.
#[derive(Clone, Debug)]
pub struct Preparation {
    camera: Camera,
    size: WorkingSize,
    /// Pixels of the images that may be used, of their size.
    mask: Option<Mask>,
    undistorter: Undistorter,
    photometric: Photometric,
    /// Time between the first and the last row of an image, ns; `None` where all are read at once.
    readout_ns: Option<f64>,
    direction: ReadoutDirection,
}

impl Preparation {
    /// For images of `camera`; `mask` is of their size, 0 where pixels must be ignored.
    #[must_use]
    pub fn new(
        camera: &Camera,
        size: WorkingSize,
        mask: Option<&Mask>,
        photometric: Photometric,
    ) -> Self {
        Self {
            camera: *camera,
            size,
            mask: mask.cloned(),
            undistorter: Undistorter::new(camera, size, mask),
            photometric,
            readout_ns: None,
            direction: ReadoutDirection::of_size((camera.width, camera.height)),
        }
    }

    /// The same for a camera that takes this long from its first row to the last, ms; negative
    /// where it begins with the last. Images are rectified before they are tracked, which needs the
    /// next one.
    #[must_use]
    pub fn with_readout_ms(self, readout_ms: f64) -> Self {
        Self {
            readout_ns: (readout_ms != 0.0).then_some(readout_ms * 1e6),
            ..self
        }
    }

    /// The same where a rolling shutter runs another way than the
    /// [shape](ReadoutDirection::of_size) of the images says.
    #[must_use]
    pub fn with_readout_direction(self, direction: ReadoutDirection) -> Self {
        Self { direction, ..self }
    }

    /// Which way a rolling shutter runs over the images.
    #[must_use]
    pub fn readout_direction(&self) -> ReadoutDirection {
        self.direction
    }

    /// Time between the first and the last row of an image, ms.
    #[must_use]
    pub fn readout_ms(&self) -> f64 {
        self.readout_ns.unwrap_or(0.0) / 1e6
    }

    /// When the pixels of the working image are read; `None` where all are read at once.
    pub(crate) fn shutter(&self) -> Option<Shutter> {
        let readout_ns = self.readout_ns?;
        let readout = (readout_ns, self.direction);
        let (camera, pinhole) = (&self.camera, self.pinhole());
        Some(Shutter::new(readout, camera, pinhole, self.size()))
    }

    /// The same for another camera with images of the same size.
    #[must_use]
    pub fn with_camera(&self, camera: &Camera) -> Self {
        let mask = self.mask.as_ref();
        Self {
            readout_ns: self.readout_ns,
            direction: self.direction,
            ..Self::new(camera, self.size, mask, self.photometric.clone())
        }
    }

    /// The camera of the images.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Intrinsics of the working images, px.
    #[must_use]
    pub fn pinhole(&self) -> &Pinhole {
        self.undistorter.pinhole()
    }

    /// Width and height of the working images, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.undistorter.size()
    }

    /// Pixels of the working images that may be used.
    #[must_use]
    pub fn mask(&self) -> &Mask {
        self.undistorter.mask()
    }

    /// The working image of an image (grey, 0 to 255).
    ///
    /// # Errors
    /// An image of another size than the camera's.
    pub fn apply(&self, image: &GrayImage) -> Result<GrayImage, Unusable> {
        if self.photometric.is_identity() {
            return self.undistort(image);
        }
        let mut corrected = image.clone();
        let applied = self.photometric.apply(&mut corrected);
        applied.map_err(|_| self.size_error(image))?;
        self.undistort(&corrected)
    }

    /// The image in colour (red, green, blue) as it covers the working image, for people: without
    /// photometric correction.
    ///
    /// # Errors
    /// An image of another size than the camera's.
    pub fn apply_rgb(&self, image: &Image<[u8; 3]>) -> Result<Image<[u8; 3]>, Unusable> {
        each_channel(image, |channel| self.undistort(channel))
    }

    /// Pixels of the working image that show nothing of what a mask of the camera's images names;
    /// `None` where it has another size.
    #[must_use]
    pub fn apply_mask(&self, mask: &Mask) -> Option<Mask> {
        let used = self.undistorter.apply(&mask.map(f32::from))?;
        Some(used.map(|used| if used < 254.5 { 0 } else { 255 }))
    }

    fn undistort(&self, image: &GrayImage) -> Result<GrayImage, Unusable> {
        let undistorted = self.undistorter.apply(image);
        undistorted.ok_or_else(|| self.size_error(image))
    }

    fn size_error<T: Copy>(&self, image: &Image<T>) -> Unusable {
        Unusable::Size {
            found: (image.width(), image.height()),
            expected: (self.camera.width, self.camera.height),
        }
    }
}

/// Working images one after the other; what repeats the image before is found.
#[derive(Debug, Default)]
pub(crate) struct Preparer {
    /// The working image before: that of the source may have a hundred times its bytes.
    previous: Option<GrayImage>,
}

impl Preparer {
    /// The working image of the next image; a repeated one too, where it `must_be_used`.
    pub(crate) fn next(
        &mut self,
        preparation: &Preparation,
        image: &GrayImage,
        must_be_used: bool,
    ) -> Result<GrayImage, Unusable> {
        let prepared = preparation.apply(image)?;
        if !must_be_used && self.previous.as_ref() == Some(&prepared) {
            return Err(Unusable::Repeats);
        }
        self.previous = Some(prepared.clone());
        Ok(prepared)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Distortion;

    #[test]
    fn only_the_same_image_at_once_is_a_repeat() {
        let camera = Camera {
            width: 40,
            height: 30,
            pinhole: Pinhole::new(30.0, 30.0, 19.5, 14.5),
            distortion: Distortion::None,
        };
        let preparation = Preparation::new(
            &camera,
            WorkingSize::AUTOMATIC,
            None,
            Photometric::default(),
        );
        let image = |k: usize| GrayImage::from_fn(40, 30, |x, y| ((x + y * k) % 200) as f32);
        let mut preparer = Preparer::default();
        let mut next = |k, must| preparer.next(&preparation, &image(k), must);
        assert!(next(1, false).is_ok());
        assert_eq!(next(1, false).err(), Some(Unusable::Repeats));
        assert!(next(1, true).is_ok(), "one that must be used");
        assert!(next(2, false).is_ok() && next(1, false).is_ok());
        let small = preparer.next(&preparation, &GrayImage::filled(20, 30, 1.0), false);
        assert!(small.is_err_and(|error| error.to_string().contains("20x30")));
        let one_pixel = |x: usize, y: usize| {
            if (x, y) == (7, 7) {
                0.0
            } else {
                ((x + y) % 200) as f32
            }
        };
        let image = GrayImage::from_fn(40, 30, one_pixel);
        assert!(
            preparer.next(&preparation, &image, false).is_ok(),
            "one pixel is enough"
        );
    }

    #[test]
    fn of_the_image_before_no_more_is_held_than_was_used() {
        let camera = Camera {
            width: 2560,
            height: 1920,
            pinhole: Pinhole::new(1500.0, 1500.0, 1279.5, 959.5),
            distortion: Distortion::None,
        };
        let size = WorkingSize::AUTOMATIC;
        let preparation = Preparation::new(&camera, size, None, Photometric::default());
        let image = GrayImage::from_fn(2560, 1920, |x, y| ((x + y * 3) % 200) as f32);
        let mut preparer = Preparer::default();
        assert!(preparer.next(&preparation, &image, false).is_ok());
        let held = preparer.previous.as_ref().map(|p| (p.width(), p.height()));
        assert_eq!(held, Some(preparation.size()));
        assert!(preparation.size().0 < 2560, "it is reduced");
        let again = preparer.next(&preparation, &image, false);
        assert_eq!(again.err(), Some(Unusable::Repeats));
        let mut other = image;
        other.set(1000, 1000, other.at(1000, 1000) + 1.0);
        assert!(
            preparer.next(&preparation, &other, false).is_ok(),
            "one value of one pixel is enough, though many become one"
        );
    }
}
