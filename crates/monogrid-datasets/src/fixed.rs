//! The part of a picture that is fixed to the camera: the borders of a screen recording or of a
//! film in another format, lettering and logos that lie over it.
//!
//! Their pixels stay the same while everything else changes. They would be followed as well as the
//! scene, and say that the camera stands still.

use monogrid_image::{GrayImage, Mask, Resize, resize_area};

/// Blocks along the longer side, in which brightness is compared.
const BLOCKS: usize = 160;
/// Most by which the mean of a block may change that stays the same, grey levels: compression,
/// hardly any noise.
const SAME: f32 = 4.0;
/// Fewest samples that say something.
const MIN_SAMPLES: usize = 12;
/// Least share of the blocks of the moving picture that must change at all, and from sample to
/// sample: what passes before a camera that stands still changes each place now and then.
const MIN_CHANGED: f64 = 0.6;
const MIN_ACTIVE: f64 = 0.45;
/// Most and least share of the blocks that change in a row or column beside the moving picture, and
/// in its first ones: it is a rectangle, and pointers and clocks beside it are small.
const MAX_BESIDE: f64 = 0.12;
const MIN_WITHIN: f64 = 0.4;
/// Gradient of a block that something is drawn in, grey levels from block to block.
const DRAWN: f32 = 20.0;
/// Most share of the moving picture that lies under lettering.
const MAX_OVERLAID: f64 = 0.25;
/// Fewest blocks of lettering beside each other.
const MIN_LETTERING: usize = 6;

/// A rectangle of pixels: left, top, width, height.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rectangle {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl From<Rectangle> for [usize; 4] {
    fn from(rectangle: Rectangle) -> Self {
        let Rectangle {
            left,
            top,
            width,
            height,
        } = rectangle;
        [left, top, width, height]
    }
}

/// The part of a picture that is fixed to the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct FixedPart {
    /// 255 where the picture moves, 0 where it is fixed.
    pub mask: Mask,
    /// Where the picture lies within its borders.
    pub picture: Rectangle,
    /// Share of that which lies under lettering, logos and the like.
    pub overlaid: f64,
}

impl FixedPart {
    /// A sentence for people.
    #[must_use]
    pub fn finding(&self) -> String {
        let Rectangle {
            left,
            top,
            width,
            height,
        } = self.picture;
        let is_whole = (width, height) == (self.mask.width(), self.mask.height());
        let borders = (!is_whole).then(|| {
            format!("only {width}x{height} pixels at ({left}, {top}) move, the rest is a border")
        });
        let percent = 100.0 * self.overlaid;
        let overlaid = (self.overlaid > 0.0)
            .then(|| format!("{percent:.1} % of the picture lies under lettering or a logo"));
        let said: Vec<String> = borders.into_iter().chain(overlaid).collect();
        format!(
            "a part of the picture is fixed to the camera and is left out: {}",
            said.join("; ")
        )
    }
}

/// Looks for what stays the same in images of one size.
#[derive(Debug)]
pub struct FixedPartFinder {
    size: (usize, usize),
    /// Columns and rows of blocks.
    blocks: (usize, usize),
    num_samples: usize,
    least: Vec<f32>,
    most: Vec<f32>,
    last: Vec<f32>,
    /// How often each changed from sample to sample.
    changes: Vec<usize>,
}

impl FixedPartFinder {
    /// For images of this width and height.
    #[must_use]
    pub fn new(size: (usize, usize)) -> Self {
        let step = size.0.max(size.1).div_ceil(BLOCKS).max(1);
        let blocks = (size.0.div_ceil(step).max(1), size.1.div_ceil(step).max(1));
        let num = blocks.0 * blocks.1;
        Self {
            size,
            blocks,
            num_samples: 0,
            least: vec![f32::INFINITY; num],
            most: vec![f32::NEG_INFINITY; num],
            last: Vec::new(),
            changes: vec![0; num],
        }
    }

    /// Looks at an image, some frames after the last one; those of another size are passed over.
    pub fn add(&mut self, image: &GrayImage) {
        if (image.width(), image.height()) != self.size {
            return;
        }
        let (width, height) = self.blocks;
        let means = resize_area(image, Resize { width, height });
        let means = means.as_slice();
        let ranges = self.least.iter_mut().zip(&mut self.most);
        for (mean, (least, most)) in means.iter().zip(ranges) {
            *least = least.min(*mean);
            *most = most.max(*mean);
        }
        for ((mean, last), changes) in means.iter().zip(&self.last).zip(&mut self.changes) {
            *changes += usize::from((mean - last).abs() > SAME / 2.0);
        }
        self.last = means.to_vec();
        self.num_samples += 1;
    }

    /// What is fixed; `None` where nothing is, or the samples do not say.
    #[must_use]
    pub fn finish(&self) -> Option<FixedPart> {
        if self.num_samples < MIN_SAMPLES {
            return None;
        }
        let changed: Vec<bool> = (self.least.iter().zip(&self.most))
            .map(|(least, most)| most - least > SAME)
            .collect();
        let picture = self.picture(&changed)?;
        let lettering = self.lettering(&changed, &picture);
        let is_whole = picture == Area::whole(self.blocks);
        if is_whole && lettering.is_empty() {
            return None;
        }
        let overlaid = lettering.len() as f64 / picture.num().max(1) as f64;
        let mut moves = vec![false; changed.len()];
        for (x, y) in picture.within(self.blocks).places() {
            moves[y * self.blocks.0 + x] = true;
        }
        for &(x, y) in &lettering {
            for (x, y) in Area::around(x, y, self.blocks).places() {
                moves[y * self.blocks.0 + x] = false;
            }
        }
        Some(FixedPart {
            mask: self.mask(&moves),
            picture: self.pixels(&picture),
            overlaid,
        })
    }

    /// The rectangle that changes.
    fn picture(&self, changed: &[bool]) -> Option<Area> {
        let whole = Area::whole(self.blocks);
        let is_changed = |&(x, y): &(usize, usize)| changed[y * self.blocks.0 + x];
        let share = |area: &Area| {
            let num_changed = area.places().filter(is_changed).count();
            num_changed as f64 / area.num().max(1) as f64
        };
        let mut area = whole;
        // without sides in which hardly anything changes, until there are none
        loop {
            let smaller = area.without_sides(|side| share(side) <= MAX_BESIDE);
            if smaller.width().min(smaller.height()) < BLOCKS / 8 {
                return None;
            }
            if smaller == area {
                break;
            }
            area = smaller;
        }
        let is_clear = |side: &Area| whole.sides().contains(side) || share(side) >= MIN_WITHIN;
        // compression takes motion across the edge
        area = area.without_sides(|side| !is_clear(side));
        let is_edge_clear = area.sides().iter().all(is_clear);
        let activity: f64 = area
            .places()
            .filter(is_changed)
            .map(|(x, y)| self.changes[y * self.blocks.0 + x] as f64)
            .sum();
        let intervals = (self.num_samples - 1) as f64;
        let active = activity / (intervals * area.num().max(1) as f64);
        let moves = share(&area) >= MIN_CHANGED && active >= MIN_ACTIVE;
        (is_edge_clear && moves).then_some(area)
    }

    /// Blocks within the picture that something is drawn in and that stay the same.
    fn lettering(&self, changed: &[bool], picture: &Area) -> Vec<(usize, usize)> {
        let columns = self.blocks.0;
        let drawn = |x: usize, y: usize| {
            let here = self.last[y * columns + x];
            let around = Area::around(x, y, self.blocks);
            let mut others = around.places().filter(|(x, y)| !changed[y * columns + x]);
            others.any(|(x, y)| (self.last[y * columns + x] - here).abs() > DRAWN)
        };
        let is_drawn = |&(x, y): &(usize, usize)| !changed[y * columns + x] && drawn(x, y);
        let all: Vec<(usize, usize)> = picture.places().filter(is_drawn).collect();
        let near = |&(x, y): &(usize, usize)| {
            let near = |&&(a, b): &&(usize, usize)| a.abs_diff(x) <= 3 && b.abs_diff(y) <= 3;
            all.iter().filter(near).count() >= MIN_LETTERING
        };
        let lettering: Vec<(usize, usize)> = all.iter().copied().filter(near).collect();
        match lettering.len() as f64 <= MAX_OVERLAID * picture.num() as f64 {
            true => lettering,
            false => Vec::new(),
        }
    }

    /// The pixels of an area of blocks.
    fn pixels(&self, area: &Area) -> Rectangle {
        let at = |block: usize, blocks: usize, size: usize| block * size / blocks;
        let [left, right] = area.x.map(|x| at(x, self.blocks.0, self.size.0));
        let [top, bottom] = area.y.map(|y| at(y, self.blocks.1, self.size.1));
        Rectangle {
            left,
            top,
            width: right - left,
            height: bottom - top,
        }
    }

    fn mask(&self, moves: &[bool]) -> Mask {
        let mut mask = Mask::filled(self.size.0, self.size.1, 0);
        for y in 0..self.size.1 {
            let row = y * self.blocks.1 / self.size.1 * self.blocks.0;
            for (x, pixel) in mask.row_mut(y).iter_mut().enumerate() {
                let block = row + x * self.blocks.0 / self.size.0;
                *pixel = if moves[block] { 255 } else { 0 };
            }
        }
        mask
    }
}

/// A rectangle of blocks: first column and row, and those behind the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Area {
    x: [usize; 2],
    y: [usize; 2],
}

impl Area {
    fn whole((columns, rows): (usize, usize)) -> Self {
        Self {
            x: [0, columns],
            y: [0, rows],
        }
    }

    /// A block and those beside it.
    fn around(x: usize, y: usize, (columns, rows): (usize, usize)) -> Self {
        Self {
            x: [x.saturating_sub(1), (x + 2).min(columns)],
            y: [y.saturating_sub(1), (y + 2).min(rows)],
        }
    }

    /// Without its outermost blocks, but at the ends of the image: the edge of a border shows in
    /// the blocks beside it.
    fn within(self, (columns, rows): (usize, usize)) -> Self {
        let inner = |[first, end]: [usize; 2], all: usize| {
            [first + usize::from(first > 0), end - usize::from(end < all)]
        };
        Self {
            x: inner(self.x, columns),
            y: inner(self.y, rows),
        }
    }

    fn width(&self) -> usize {
        self.x[1].saturating_sub(self.x[0])
    }

    fn height(&self) -> usize {
        self.y[1].saturating_sub(self.y[0])
    }

    fn num(&self) -> usize {
        self.width() * self.height()
    }

    fn places(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let x = self.x[0]..self.x[1];
        (self.y[0]..self.y[1]).flat_map(move |y| x.clone().map(move |x| (x, y)))
    }

    /// Its first and last column, its first and last row.
    fn sides(&self) -> [Self; 4] {
        let [left, right] = self.x;
        let [top, bottom] = self.y;
        [
            Self {
                x: [left, left + 1],
                ..*self
            },
            Self {
                x: [right - 1, right],
                ..*self
            },
            Self {
                y: [top, top + 1],
                ..*self
            },
            Self {
                y: [bottom - 1, bottom],
                ..*self
            },
        ]
    }

    /// Without all sides that `are_beside`.
    fn without_sides(&self, are_beside: impl Fn(&Self) -> bool) -> Self {
        let [left, right, top, bottom] = self.sides().map(|side| usize::from(are_beside(&side)));
        Self {
            x: [self.x[0] + left, self.x[1] - right],
            y: [self.y[0] + top, self.y[1] - bottom],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{FixedPart, FixedPartFinder, Rectangle};
    use monogrid_image::GrayImage;

    const SIZE: (usize, usize) = (320, 240);

    /// A pattern of patches that nobody has seen before at `(x, y)`.
    fn pattern(x: usize, y: usize) -> f32 {
        let (x, y) = (x / 8, y / 8);
        ((x * 7919 + y * 104_729 + x * y * 31) % 211) as f32
    }

    /// Twenty images of which each pixel is `of` the number of the image and its place.
    fn found(of: impl Fn(usize, usize, usize) -> f32) -> Option<FixedPart> {
        let mut finder = FixedPartFinder::new(SIZE);
        for k in 0..20 {
            let mut image = GrayImage::filled(SIZE.0, SIZE.1, 0.0);
            for y in 0..SIZE.1 {
                for (x, pixel) in image.row_mut(y).iter_mut().enumerate() {
                    *pixel = of(k, x, y);
                }
            }
            finder.add(&image);
        }
        finder.finish()
    }

    #[test]
    fn the_picture_within_a_screen_is_found() {
        let is_inside = |x: usize, y: usize| (80..280).contains(&x) && (40..200).contains(&y);
        let fixed = found(|k, x, y| match is_inside(x, y) {
            true => pattern(x + 13 * k, y + 5 * k),
            // a pointer that moves now and then
            false if (300..306).contains(&x) && y / 4 == k / 5 => 255.0,
            false => pattern(x + 1000, y),
        });
        let fixed = fixed.unwrap();
        let expected = Rectangle {
            left: 80,
            top: 40,
            width: 200,
            height: 160,
        };
        assert_eq!(fixed.picture, expected);
        assert_eq!(fixed.overlaid, 0.0);
        for (x, y) in [(40, 120), (290, 120), (160, 20), (160, 220), (79, 120)] {
            assert_eq!(fixed.mask.row(y)[x], 0, "{x} {y}");
        }
        assert_eq!(fixed.mask.row(120)[160], 255);
        assert!(fixed.finding().contains("200x160"), "{}", fixed.finding());
    }

    /// Compression lets what moves change some of the border beside it.
    #[test]
    fn the_edge_of_a_picture_may_be_blurred() {
        let is_inside = |x: usize, y: usize| (80..280).contains(&x) && (40..200).contains(&y);
        let fixed = found(|k, x, y| match is_inside(x, y) {
            true => pattern(x + 13 * k, y + 5 * k),
            false if (38..40).contains(&y) && (100..150).contains(&x) => (20 * (k % 2)) as f32,
            false => pattern(x + 1000, y),
        });
        let picture = fixed.unwrap().picture;
        assert_eq!((picture.top, picture.height), (40, 160));
    }

    #[test]
    fn lettering_over_a_moving_picture_is_found() {
        let is_lettering = |x: usize, y: usize| (20..100).contains(&x) && (200..216).contains(&y);
        let fixed = found(|k, x, y| match is_lettering(x, y) {
            true => (x / 4 % 2 * 255) as f32,
            false => pattern(x + 13 * k, y + 5 * k),
        });
        let fixed = fixed.unwrap();
        assert_eq!((fixed.picture.width, fixed.picture.height), SIZE);
        assert!((0.005..0.03).contains(&fixed.overlaid), "{fixed:?}");
        assert_eq!(fixed.mask.row(208)[60], 0);
        assert_eq!(fixed.mask.row(100)[60], 255);
    }

    #[test]
    fn ordinary_recordings_have_nothing_fixed() {
        let moving = found(|k, x, y| pattern(x + 13 * k, y + 5 * k));
        assert_eq!(moving, None);
        // a sky that stays white over what moves
        let sky = found(|k, x, y| {
            if y < 100 + 5 * (k % 3) {
                255.0
            } else {
                pattern(x + 13 * k, y)
            }
        });
        assert!(sky.is_none_or(|sky| sky.picture.top <= 100 && sky.overlaid == 0.0));
        // a camera that stands still, and something that passes
        let passes = found(
            |k, x, y| match (16 * k..16 * k + 60).contains(&x) && y > 60 {
                true => pattern(x + 500 - 16 * k, y),
                false => pattern(x, y),
            },
        );
        assert_eq!(passes, None);
        assert_eq!(found(|_, x, y| pattern(x, y)), None);
    }
}
