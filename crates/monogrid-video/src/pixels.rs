//! Pixels that are not square: anamorphic recordings squeeze the picture along one axis and say by
//! how much.
//!
//! Everything behind a video takes a focal length for the same along both axes, so frames are
//! stretched until pixels are square. The shorter side of a pixel sets the scale: nothing that the
//! picture shows is lost.

use crate::frame::{Grey, MAX_PIXELS};

/// Shapes within this of a square are rounded sizes: a row or a column of a small picture.
const SQUARE_WITHIN: f64 = 0.01;

/// Most that a picture is stretched; more is taken for damage.
const MAX_STRETCH: f64 = 4.0;

/// Width and height of a pixel, in any unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PixelShape(u64, u64);

impl PixelShape {
    pub(crate) const SQUARE: Self = Self(1, 1);

    /// Of a width and a height; 0 says that nobody knows, as in H.264 and YUV4MPEG2.
    pub(crate) fn new(width: u64, height: u64) -> Self {
        match width.min(height) {
            0 => Self::SQUARE,
            _ => Self(width, height),
        }
    }

    /// Of `width:height` as it is written.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (width, height) = text.split_once(':')?;
        Some(Self::new(width.parse().ok()?, height.parse().ok()?))
    }

    /// In a picture that is turned by a quarter.
    pub(crate) fn turned(self) -> Self {
        Self(self.1, self.0)
    }

    fn ratio(self) -> f64 {
        self.0 as f64 / self.1 as f64
    }

    fn is_square(self) -> bool {
        (self.ratio() - 1.0).abs() <= SQUARE_WITHIN
    }

    /// The size of a picture when its pixels are square; `None` where they are, or its size would
    /// be beyond reason.
    pub(crate) fn square_size(self, (width, height): (usize, usize)) -> Option<(usize, usize)> {
        let ratio = self.ratio();
        if self.is_square() || !(1.0 / MAX_STRETCH..=MAX_STRETCH).contains(&ratio) {
            return None;
        }
        let longer = |side: usize, factor: f64| (side as f64 * factor).round() as usize;
        let size = match ratio > 1.0 {
            true => (longer(width, ratio), height),
            false => (width, longer(height, 1.0 / ratio)),
        };
        (size.0 * size.1 <= MAX_PIXELS).then_some(size)
    }

    /// What is done about it, for people.
    pub(crate) fn note(self, size: (usize, usize)) -> Option<String> {
        let Self(across, along) = self;
        if self.is_square() {
            return None;
        }
        let Some((width, height)) = self.square_size(size) else {
            return Some(format!(
                "pixels are said to be {across}:{along}, which is taken for damage: images are \
                 used as they are stored"
            ));
        };
        Some(format!(
            "pixels are not square ({across}:{along}): images of {}x{} are stretched to \
             {width}x{height}; a calibration may be for either size",
            size.0, size.1
        ))
    }

    /// The picture with square pixels.
    pub(crate) fn squared(self, image: Grey) -> Grey {
        let size = (image.width(), image.height());
        match self.square_size(size) {
            Some((width, _)) if width != size.0 => stretched_across(&image, width),
            Some((_, height)) => stretched_along(&image, height),
            None => image,
        }
    }
}

/// The two samples around the centre of sample `k` of `count`, which take the place of `known`, and
/// the share of the second in 1/256.
fn place(k: usize, count: usize, known: usize) -> (usize, usize, u32) {
    let at = (k as f64 + 0.5) * known as f64 / count as f64 - 0.5;
    let at = at.clamp(0.0, known as f64 - 1.0);
    let before = at as usize;
    let share = ((at - before as f64) * 256.0).round() as u32;
    (before, (before + 1).min(known - 1), share)
}

fn between(a: u8, b: u8, share: u32) -> u8 {
    ((u32::from(a) * (256 - share) + u32::from(b) * share + 128) >> 8) as u8
}

fn stretched_across(image: &Grey, width: usize) -> Grey {
    let places: Vec<_> = (0..width).map(|x| place(x, width, image.width())).collect();
    let mut out = Grey::filled(width, image.height(), 0);
    for y in 0..image.height() {
        let row = image.row(y);
        for (value, (a, b, share)) in out.row_mut(y).iter_mut().zip(&places) {
            *value = between(row[*a], row[*b], *share);
        }
    }
    out
}

fn stretched_along(image: &Grey, height: usize) -> Grey {
    let mut out = Grey::filled(image.width(), height, 0);
    for y in 0..height {
        let (a, b, share) = place(y, height, image.height());
        let pairs = image.row(a).iter().zip(image.row(b));
        for (value, (a, b)) in out.row_mut(y).iter_mut().zip(pairs) {
            *value = between(*a, *b, share);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::PixelShape;
    use crate::frame::Grey;

    #[test]
    fn a_picture_is_stretched_along_the_shorter_side_of_its_pixels() {
        let shape = |width, height| PixelShape::new(width, height);
        assert_eq!(shape(4, 3).square_size((1440, 1080)), Some((1920, 1080)));
        assert_eq!(shape(3, 4).square_size((484, 674)), Some((484, 899)));
        assert_eq!(
            shape(3, 4).turned().square_size((484, 674)),
            Some((645, 674))
        );
        for square in [(1, 1), (0, 1), (7, 0), (336, 337), (1, 9), (9, 1)] {
            let shape = shape(square.0, square.1);
            assert_eq!(shape.square_size((100, 100)), None, "{square:?}");
        }
        assert_eq!(
            shape(2, 1).square_size((1 << 13, 1 << 13)),
            None,
            "too large"
        );
    }

    #[test]
    fn a_ramp_is_one_still() {
        // a pixel of twice the width becomes two, whose centres are a quarter of it away from its
        // own
        let ramp = Grey::from_fn(8, 2, |x, _| (40 + 20 * x) as u8);
        let wide = PixelShape::new(2, 1).squared(ramp.clone());
        assert_eq!((wide.width(), wide.height()), (16, 2));
        for x in 1..15 {
            assert_eq!(wide.at(x, 1), (35 + 10 * x) as u8, "{x}");
        }
        assert_eq!((wide.at(0, 0), wide.at(15, 0)), (40, 180));
        let ramp = Grey::from_fn(2, 8, |_, y| (40 + 20 * y) as u8);
        let high = PixelShape::new(1, 2).squared(ramp.clone());
        assert_eq!((high.width(), high.height()), (2, 16));
        assert!((1..15).all(|y| high.at(1, y) == (35 + 10 * y) as u8));
        assert_eq!(PixelShape::SQUARE.squared(ramp.clone()), ramp);
    }

    #[test]
    fn shapes_as_they_are_written() {
        assert_eq!(PixelShape::parse("4:3"), Some(PixelShape::new(4, 3)));
        assert_eq!(PixelShape::parse("0:0"), Some(PixelShape::SQUARE));
        assert_eq!(PixelShape::parse("4"), None);
        let note = PixelShape::new(3, 4).note((484, 674)).unwrap();
        assert!(
            note.contains("484x674") && note.contains("484x899"),
            "{note}"
        );
        assert_eq!(PixelShape::SQUARE.note((484, 674)), None);
        assert!(
            PixelShape::new(1, 9)
                .note((9, 9))
                .unwrap()
                .contains("damage")
        );
    }
}
