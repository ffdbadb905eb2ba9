//! The tags of AprilTag's family 36h11 (`[OLSON11]`), read from between four corners.

use super::fit::homography;
use monogrid_geometry::Vec2;
use monogrid_image::{GrayImage, bilinear};

/// Bits along each side of the code.
const SIDE: usize = 6;

/// Wrong bits of a tag that are put right: two tags differ in eleven.
const MAX_WRONG_BITS: u32 = 2;

/// Least share of the border's bits that are black: corners on it make some grey.
const MIN_BLACK_BORDER: f64 = 0.85;

/// Least difference of black and white, grey levels.
const MIN_CONTRAST: f64 = 15.0;

/// Places along each side of a bit that are looked at, as a share of its side.
const PLACES: [f64; 3] = [0.3, 0.5, 0.7];

/// The codes of the family, by number: 36 bits, row by row from the top left, the highest first;
/// white is one.
pub(super) struct TagFamily {
    codes: Vec<u64>,
}

/// What was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ReadTag {
    pub number: usize,
    /// Which of the corners that were given is the first of the code, its top left.
    pub first_corner: usize,
    pub wrong_bits: u32,
}

impl TagFamily {
    pub(super) fn tag36h11() -> Self {
        let lines = include_str!("tag36h11.txt").lines();
        let codes = lines.filter_map(|line| u64::from_str_radix(line, 16).ok());
        Self {
            codes: codes.collect(),
        }
    }

    /// The tag between four corners, clockwise, px, with a black border of so many bits.
    pub(super) fn read(
        &self,
        image: &GrayImage,
        corners: &[Vec2; 4],
        border: usize,
    ) -> Option<ReadTag> {
        let seen = code_between(image, corners, border)?;
        let turns = std::iter::successors(Some(seen), |code| Some(turned(*code)));
        let tags = turns.take(4).enumerate().flat_map(|(first_corner, code)| {
            self.codes.iter().enumerate().map(move |(number, known)| {
                let wrong_bits = (known ^ code).count_ones();
                ReadTag {
                    number,
                    first_corner,
                    wrong_bits,
                }
            })
        });
        tags.min_by_key(|tag| tag.wrong_bits)
            .filter(|tag| tag.wrong_bits <= MAX_WRONG_BITS)
    }
}

/// The code as read from the next corner.
fn turned(code: u64) -> u64 {
    let bit = |x: usize, y: usize| (code >> (SIDE * SIDE - 1 - y * SIDE - x)) & 1;
    (0..SIDE * SIDE).fold(0, |turned, k| {
        (turned << 1) | bit(SIDE - 1 - k / SIDE, k % SIDE)
    })
}

/// The code read from the first corner; none when the border is not black or all is grey.
fn code_between(image: &GrayImage, corners: &[Vec2; 4], border: usize) -> Option<u64> {
    let side = SIDE + 2 * border;
    let places = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vec2::from);
    let pixel_from_tag = homography(places.into_iter().zip(*corners))?;
    let grey_at = |x: f64, y: f64| {
        let seen = pixel_from_tag * (Vec2::new(x, y) / side as f64).push(1.0);
        let pixel = seen.xy() / seen.z;
        bilinear(image, pixel.x as f32, pixel.y as f32).map(f64::from)
    };
    let bit = |k: usize| {
        let (x, y) = ((k % side) as f64, (k / side) as f64);
        let greys = PLACES.map(|v| PLACES.map(|u| grey_at(x + u, y + v)));
        let sum = greys.as_flattened().iter().copied().sum::<Option<f64>>()?;
        Some(sum / greys.as_flattened().len() as f64)
    };
    let greys = (0..side * side).map(bit).collect::<Option<Vec<f64>>>()?;
    let threshold = between_black_and_white(&greys)?;
    let is_inside = |k: usize| {
        let inside = border..border + SIDE;
        inside.contains(&(k % side)) && inside.contains(&(k / side))
    };
    let mut code = 0;
    let mut num_black = 0;
    for (k, grey) in greys.iter().enumerate() {
        let is_white = *grey > threshold;
        if is_inside(k) {
            code = (code << 1) | u64::from(is_white);
        } else {
            num_black += usize::from(!is_white);
        }
    }
    let of_border = greys.len() - SIDE * SIDE;
    (num_black as f64 >= MIN_BLACK_BORDER * of_border as f64).then_some(code)
}

/// The grey level in the middle between the means of what lies below and above it.
fn between_black_and_white(greys: &[f64]) -> Option<f64> {
    let (least, most) = greys.iter().fold((f64::MAX, f64::MIN), |(a, b), grey| {
        (a.min(*grey), b.max(*grey))
    });
    if most - least < MIN_CONTRAST {
        return None;
    }
    let middle = |threshold: f64| {
        let mean = |of: &dyn Fn(f64) -> bool| {
            let (sum, count) = (greys.iter().filter(|grey| of(**grey)))
                .fold((0.0, 0), |(sum, count), grey| (sum + grey, count + 1));
            sum / f64::from(count.max(1))
        };
        (mean(&|grey| grey <= threshold) + mean(&|grey| grey > threshold)) / 2.0
    };
    Some(middle(middle((least + most) / 2.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_differ_in_eleven_bits_however_they_are_turned() {
        let family = TagFamily::tag36h11();
        assert_eq!(family.codes.len(), 587);
        assert_eq!(family.codes[0], 0xd_5d62_8584);
        for (k, code) in family.codes.iter().enumerate() {
            assert!(*code < 1 << 36);
            assert_eq!(turned(turned(turned(turned(*code)))), *code);
            let mut other = *code;
            for turn in 0..4 {
                let rest = &family.codes[if turn == 0 { k + 1 } else { k }..];
                let least = rest.iter().map(|c| (c ^ other).count_ones()).min();
                assert!(least.is_none_or(|bits| bits >= 11), "{k} {turn} {least:?}");
                other = turned(other);
            }
        }
    }

    /// A tag of black 40 and white 200 whose bits are ten px wide, from its top left corner at (20,
    /// 20).
    fn picture(code: u64, border: usize) -> GrayImage {
        GrayImage::from_fn(140, 140, |x, y| {
            let bit = |v: usize| (v as isize - 20).div_euclid(10) - border as isize;
            let inside = 0..SIDE as isize;
            let (column, row) = (bit(x), bit(y));
            let frame = -(border as isize)..(SIDE + border) as isize;
            if inside.contains(&column) && inside.contains(&row) {
                let k = row as usize * SIDE + column as usize;
                40.0 + 160.0 * ((code >> (35 - k)) & 1) as f32
            } else if frame.contains(&column) && frame.contains(&row) {
                40.0
            } else {
                200.0
            }
        })
    }

    #[test]
    fn a_tag_is_read_from_any_corner_and_with_two_wrong_bits() {
        let family = TagFamily::tag36h11();
        for border in [1, 2] {
            let far = 20.0 + 10.0 * (SIDE + 2 * border) as f64 - 0.5;
            let corners = [[19.5, 19.5], [far, 19.5], [far, far], [19.5, far]].map(Vec2::from);
            for (number, wrong, is_read) in [(0, 0, true), (7, 0b100_0100, true), (7, 0b111, false)]
            {
                let image = picture(family.codes[number] ^ wrong, border);
                for turn in 0..4 {
                    let mut from = corners;
                    from.rotate_left(turn);
                    let read = family.read(&image, &from, border);
                    let expected = ReadTag {
                        number,
                        first_corner: (4 - turn) % 4,
                        wrong_bits: wrong.count_ones(),
                    };
                    assert_eq!(read, is_read.then_some(expected), "{border} {turn}");
                }
            }
            // the border of a tag that has another width is not black, and a plain place has no tag
            let image = picture(family.codes[3], border);
            assert_eq!(family.read(&image, &corners, 3 - border), None);
            assert_eq!(
                family.read(&GrayImage::filled(140, 140, 90.0), &corners, border),
                None
            );
        }
    }
}
