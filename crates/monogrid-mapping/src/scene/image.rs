//! The depth of a keyframe by its place in the image.

use super::KeptDepths;
use crate::KeyframeCamera;
use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;

/// Inverse depth of each pixel and how uncertain it is, in the measure in which it was put there;
/// an inverse depth of 0 where there is none.
pub(crate) struct DepthImage(Image<[f32; 2]>);

impl DepthImage {
    /// Without depth.
    pub fn new(camera: &KeyframeCamera) -> Self {
        Self(Image::filled(camera.width, camera.height, [0.0; 2]))
    }

    /// All depth of a keyframe; measured depth wins where there are both.
    pub fn of(depths: &KeptDepths, camera: &KeyframeCamera) -> Self {
        let mut image = Self::new(camera);
        let [measured, filled] = depths.kinds();
        image.show(filled.iter().copied());
        image.show(measured.iter().copied());
        image
    }

    /// Leaves all depth.
    pub fn clear(&mut self) {
        self.0.as_mut_slice().fill([0.0; 2]);
    }

    /// Shows some depth, with relative standard deviations, in place of what was there.
    pub fn show(&mut self, pixels: impl IntoIterator<Item = Measurement>) {
        for pixel in pixels {
            let depth = [pixel.idepth, pixel.sigma_idepth / pixel.idepth];
            self.set(pixel.x.into(), pixel.y.into(), depth);
        }
    }

    /// Puts a depth at a pixel; nothing is done outside of the image.
    pub fn set(&mut self, x: usize, y: usize, depth: [f32; 2]) {
        if x < self.0.width() && y < self.0.height() {
            self.0.set(x, y, depth);
        }
    }

    /// The depth at a pixel of the image.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> Option<[f32; 2]> {
        let depth = self.0.at(x, y);
        (depth[0] > 0.0).then_some(depth)
    }

    /// The inverse depth at a place that may be outside; 0 where there is none.
    pub fn idepth(&self, x: i32, y: i32) -> f32 {
        let inside = usize::try_from(x).ok().zip(usize::try_from(y).ok());
        let inside = inside.filter(|(x, y)| *x < self.0.width() && *y < self.0.height());
        inside.map_or(0.0, |(x, y)| self.0.at(x, y)[0])
    }

    /// The depths of the 3x3 pixels around one, with their places, row-major.
    #[inline]
    pub fn around(&self, x: usize, y: usize) -> impl Iterator<Item = (usize, usize, [f32; 2])> {
        let columns = x.saturating_sub(1)..(x + 2).min(self.0.width());
        let rows = y.saturating_sub(1)..(y + 2).min(self.0.height());
        let places = rows.flat_map(move |y| columns.clone().map(move |x| (x, y)));
        places.filter_map(move |(x, y)| self.at(x, y).map(|depth| (x, y, depth)))
    }

    /// All depths with their places, row-major.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, usize, [f32; 2])> {
        let width = self.0.width();
        let pixels = self.0.as_slice().iter().enumerate();
        let known = pixels.filter(|(_, depth)| depth[0] > 0.0);
        known.map(move |(index, depth)| (index % width, index / width, *depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Pinhole;

    #[test]
    fn depth_is_found_at_its_pixel_and_around_and_nowhere_else() {
        let camera = KeyframeCamera::new(Pinhole::new(9.0, 9.0, 4.0, 3.0), (8, 6));
        let mut image = DepthImage::new(&camera);
        let pixel = |x, y, idepth| Measurement {
            x,
            y,
            idepth,
            sigma_idepth: 0.1,
        };
        image.show([
            pixel(0, 0, 0.5),
            pixel(7, 5, 2.0),
            pixel(1, 1, 0.25),
            pixel(8, 0, 1.0),
        ]);
        image.show([pixel(1, 1, 1.0)]);
        assert_eq!(
            (image.at(0, 0), image.at(1, 1)),
            (Some([0.5, 0.2]), Some([1.0, 0.1]))
        );
        assert_eq!(
            (image.at(2, 0), image.idepth(7, 5), image.idepth(8, 0)),
            (None, 2.0, 0.0)
        );
        assert_eq!((image.idepth(-1, 3), image.idepth(3, 6)), (0.0, 0.0));
        let around = |x, y| {
            image
                .around(x, y)
                .map(|(x, y, _)| (x, y))
                .collect::<Vec<_>>()
        };
        assert_eq!(around(0, 1), [(0, 0), (1, 1)]);
        assert_eq!(around(7, 5), [(7, 5)]);
        assert_eq!(image.pixels().count(), 3);
        image.clear();
        assert_eq!(image.pixels().count(), 0);
    }
}
