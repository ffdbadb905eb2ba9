//! What a frame shows beside its luma.
//!
//! Tracking needs luma only, and of most frames nobody ever wants the colour. So it is kept as
//! small as it comes: planes of colour differences are made smaller, frames that are JPEG files are
//! decoded by whoever wants to see one.

use crate::turn::Turn;
use monogrid_image::Image;

/// Longer side of the planes that are kept, px: colour is coarse beside luma, which has all the
/// detail.
const MAX_SIDE: usize = 200;

/// Largest distance from the middle of what is no colour, but noise of the encoder.
const GREY_WITHIN: u8 = 3;

/// The colour of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Colour {
    /// The source has none.
    #[default]
    Grey,
    /// Beside luma.
    Chroma(Chroma),
    /// The whole frame as a JPEG file.
    Jpeg(Vec<u8>),
}

impl Colour {
    /// Memory that it takes.
    #[must_use]
    pub fn num_bytes(&self) -> usize {
        match self {
            Self::Grey => 0,
            Self::Chroma(chroma) => 2 * chroma.planes.as_slice().len(),
            Self::Jpeg(bytes) => bytes.len(),
        }
    }
}

/// Colour differences of an upright image.
#[derive(Clone, Debug, PartialEq)]
pub struct Chroma {
    /// Cb and Cr, 128 where there is no colour; smaller than the image.
    planes: Image<[u8; 2]>,
    /// How they and luma become red, green and blue.
    space: ColourSpace,
}

impl Chroma {
    /// Of planes of this size with one byte per sample, turned; `None` where they are too short, or
    /// grey.
    pub(crate) fn new(
        [blue, red]: [&[u8]; 2],
        (width, height): (usize, usize),
        space: ColourSpace,
        turn: Turn,
    ) -> Option<Self> {
        let factor = width.max(height).div_ceil(MAX_SIDE).max(1);
        let (small_width, small_height) = (width / factor, height / factor);
        if small_width * small_height == 0 || blue.len().min(red.len()) < width * height {
            return None;
        }
        let mean = |plane: &[u8], x: usize, y: usize| {
            let rows = (y * factor..(y + 1) * factor).map(|row| row * width + x * factor);
            let sum: usize = rows
                .flat_map(|from| &plane[from..from + factor])
                .map(|v| usize::from(*v))
                .sum();
            ((sum + factor * factor / 2) / (factor * factor)) as u8
        };
        let planes = Image::from_fn(small_width, small_height, |x, y| {
            [mean(blue, x, y), mean(red, x, y)]
        });
        let is_grey = |pair: &[u8; 2]| pair.iter().all(|v| v.abs_diff(128) <= GREY_WITHIN);
        (!planes.as_slice().iter().all(is_grey)).then(|| Self {
            planes: turn.apply(planes),
            space,
        })
    }

    /// Colour differences in an image of this size, Cb and Cr, between those that are known.
    #[must_use]
    pub fn at_size(&self, (width, height): (usize, usize)) -> Image<[u8; 2]> {
        let (known_width, known_height) = (self.planes.width(), self.planes.height());
        // the place among `known` samples of pixel `k` of `count`: the sample before, the one
        // after, and the way between them
        let place = |k: usize, count: usize, known: usize| {
            let at = (k as f32 + 0.5) * known as f32 / count as f32 - 0.5;
            let at = at.clamp(0.0, known as f32 - 1.0);
            let before = at as usize;
            (before, (before + 1).min(known - 1), at - before as f32)
        };
        Image::from_fn(width, height, |x, y| {
            let (left, right, to_right) = place(x, width, known_width);
            let (above, below, to_below) = place(y, height, known_height);
            let [a, b] =
                [above, below].map(|y| (self.planes.at(left, y), self.planes.at(right, y)));
            [0, 1].map(|c| {
                let between = |(p, q): ([u8; 2], [u8; 2])| {
                    let (p, q) = (f32::from(p[c]), f32::from(q[c]));
                    p + (q - p) * to_right
                };
                let (a, b) = (between(a), between(b));
                (a + (b - a) * to_below).round() as u8
            })
        })
    }

    /// How the planes and luma become red, green and blue.
    #[must_use]
    pub fn space(&self) -> ColourSpace {
        self.space
    }
}

/// What luma and colour differences mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ColourSpace {
    /// Whether luma goes from 0 to 255, and not from 16 to 235.
    pub has_full_range: bool,
    /// Whether luma is weighted by ITU-R BT.709 (high definition), and not by BT.601.
    pub is_bt709: bool,
}

impl ColourSpace {
    /// What is usual for pictures of this height that do not say it.
    pub(crate) fn usual(height: usize, has_full_range: bool) -> Self {
        Self {
            has_full_range,
            is_bt709: height >= 720,
        }
    }

    /// Red, green and blue of luma, Cb and Cr.
    #[must_use]
    pub fn rgb(self, luma: u8, [blue, red]: [u8; 2]) -> [u8; 3] {
        let (luma, difference_scale) = match self.has_full_range {
            true => (f32::from(luma), 1.0),
            false => ((f32::from(luma) - 16.0) * 255.0 / 219.0, 255.0 / 224.0),
        };
        let [blue, red] = [blue, red].map(|v| (f32::from(v) - 128.0) * difference_scale);
        // shares of red and blue in luma
        let (of_red, of_blue) = match self.is_bt709 {
            true => (0.2126, 0.0722),
            false => (0.299, 0.114),
        };
        let r = luma + 2.0 * (1.0 - of_red) * red;
        let b = luma + 2.0 * (1.0 - of_blue) * blue;
        let g = (luma - of_red * r - of_blue * b) / (1.0 - of_red - of_blue);
        [r, g, b].map(|v| v.round().clamp(0.0, 255.0) as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::{Chroma, ColourSpace};
    use crate::turn::Turn;

    #[test]
    fn the_colours_of_a_test_picture() {
        let (limited, hd) = (ColourSpace::default(), ColourSpace::usual(1080, false));
        // ITU-R BT.601 and BT.709: full red, green and blue
        assert_eq!(limited.rgb(81, [90, 240]), [254, 0, 0]);
        assert_eq!(limited.rgb(145, [54, 34]), [0, 255, 1]);
        assert_eq!(hd.rgb(63, [102, 240]), [255, 1, 0]);
        let full = ColourSpace::usual(480, true);
        assert_eq!(full.rgb(76, [85, 255]), [254, 0, 0]);
        assert_eq!(full.rgb(200, [128, 128]), [200; 3]);
        assert_eq!(limited.rgb(235, [128, 128]), [255; 3]);
    }

    #[test]
    fn planes_are_made_smaller_and_turned_and_grey_ones_left_out() {
        let (width, height) = (420, 300);
        let blue: Vec<u8> = (0..width * height).map(|i| (i % width / 3) as u8).collect();
        let red = vec![200; width * height];
        let space = ColourSpace::default();
        let planes = [blue.as_slice(), red.as_slice()];
        let chroma = Chroma::new(planes, (width, height), space, Turn::None).unwrap();
        assert_eq!((chroma.planes.width(), chroma.planes.height()), (140, 100));
        assert_eq!(chroma.planes.at(17, 50), [17, 200]);
        let large = chroma.at_size((840, 600));
        for x in 10..830 {
            let expected = (x as f32 + 0.5) / 6.0 - 0.5;
            let [blue, red] = large.at(x, 300);
            assert!((f32::from(blue) - expected).abs() <= 0.5, "{x}: {blue}");
            assert_eq!(red, 200);
        }
        let turned = Chroma::new(planes, (width, height), space, Turn::Quarter).unwrap();
        assert_eq!((turned.planes.width(), turned.planes.height()), (100, 140));
        assert_eq!(turned.planes.at(50, 17), [17, 200]);
        let grey = vec![127; width * height];
        assert!(Chroma::new([&grey, &grey], (width, height), space, Turn::None).is_none());
        assert!(Chroma::new([&blue[1..], &red], (width, height), space, Turn::None).is_none());
    }
}
