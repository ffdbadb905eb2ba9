//! Bounds over square windows of a range image: how near could something be, how far can anything
//! matter?
//!
//! Windows of `2^k` pixels' edge begin at every pixel for the three smallest sizes, at every
//! quarter of their edge for larger ones. Any box of pixels lies in one window little larger than
//! itself, so one look tells what a block of cells can get from all pixels that it covers.

use crate::integrate::image::extremes::{higher, lower};
use crate::integrate::image::range_image::{HOLE, RangeImage};
use crate::sensor::table::TableSet;

/// Bounds of all windows of an image, level by level.
pub(crate) struct Windows {
    size: [usize; 2],
    levels: Vec<Level>,
    bounds: Bounds,
    farthest_change: f32,
}

/// Windows of one size.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Level {
    /// Place of the first window in the bounds.
    pub first: usize,
    /// Windows per row.
    pub width: usize,
    height: usize,
    /// Pixels from one window to the next, as a power of two.
    pub shift: u32,
    /// Any box of at most so many pixels' edge lies in one window.
    holds: usize,
}

/// What the pixels of each window say, window by window.
#[derive(Default)]
struct Bounds {
    /// Every pixel sees free space up to here; minus infinity if one is a hole.
    free_until: Vec<f32>,
    /// Before this no pixel says anything but free; infinity if all are holes.
    clear_until: Vec<f32>,
    /// No pixel changes a cell beyond this; minus infinity if all are holes.
    changes_until: Vec<f32>,
}

/// The bounds of one window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WindowBounds {
    pub free_until: f32,
    pub clear_until: f32,
    pub changes_until: f32,
}

impl Windows {
    pub(crate) fn new(image: &RangeImage, tables: &TableSet, max_range: f32) -> Self {
        // Nothing is uniformly free if measurements of different uncertainty say different things.
        let free = tables.tables().first().map_or(0, |t| t.free);
        let one_free_value = tables.tables().iter().all(|t| t.free == free);
        let free_range = if one_free_value {
            max_range
        } else {
            f32::NEG_INFINITY
        };
        let reaches: Vec<Reach> = tables
            .tables()
            .iter()
            .map(|t| Reach {
                start: t.start as f32,
                end: t.end() as f32,
                free_range,
                max_range,
            })
            .collect();
        let mut bounds = Bounds::with_capacity(4 * image.ranges.len());
        match (&image.tables[..], reaches.first()) {
            ([], Some(reach)) => bounds.push_all(&image.ranges, |_| *reach),
            (tables, _) => {
                bounds.push_all(&image.ranges, |i| reaches[usize::from(tables[i])]);
            }
        }
        Self::from_pixels([image.width, image.height], bounds)
    }

    fn from_pixels(size: [usize; 2], bounds: Bounds) -> Self {
        let farthest_change = bounds
            .changes_until
            .iter()
            .fold(f32::NEG_INFINITY, |far, &c| far.max(c));
        let mut windows = Self {
            size,
            levels: vec![Level {
                first: 0,
                width: size[0],
                height: size[1],
                shift: 0,
                holds: 1,
            }],
            bounds,
            farthest_change,
        };
        while windows.levels[windows.levels.len() - 1].holds < size[0].max(size[1]) {
            windows.add_level();
        }
        windows
    }

    /// The windows of twice the edge of the largest so far, joined from four of those.
    fn add_level(&mut self) {
        let last = self.levels[self.levels.len() - 1];
        let half_edge = 1_usize << (self.levels.len() - 1);
        let shift = (self.levels.len() as u32).saturating_sub(2);
        let stride = 1 << shift;
        let level = Level {
            first: self.bounds.free_until.len(),
            width: self.size[0].div_ceil(stride),
            height: self.size[1].div_ceil(stride),
            shift,
            holds: 2 * half_edge + 1 - stride,
        };
        // In windows of the last level: from one window to the next, and to the other half.
        let join = Join {
            step: stride >> last.shift,
            half: half_edge >> last.shift,
            from: last,
            to: level,
        };
        join.append(&mut self.bounds.free_until, f32::INFINITY, lower);
        join.append(&mut self.bounds.clear_until, f32::INFINITY, lower);
        join.append(&mut self.bounds.changes_until, f32::NEG_INFINITY, higher);
        self.levels.push(level);
    }

    /// Width and height of the image in pixels.
    #[inline]
    pub(crate) fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The smallest windows that hold boxes of `edge` pixels, at most the image's longer edge.
    #[inline]
    pub(crate) fn level_for(&self, edge: usize) -> Level {
        // The estimate is at most one too small.
        let estimate = (usize::BITS - edge.saturating_sub(1).leading_zeros()) as usize;
        let mut index = estimate.min(self.levels.len() - 1);
        if self.levels[index].holds < edge && index + 1 < self.levels.len() {
            index += 1;
        }
        self.levels[index]
    }

    /// The bounds of the window that holds a box whose first pixel is `(column, row)`.
    #[inline]
    pub(crate) fn at(&self, level: Level, column: usize, row: usize) -> WindowBounds {
        let index = level.first + (row >> level.shift) * level.width + (column >> level.shift);
        WindowBounds {
            free_until: self.bounds.free_until[index],
            clear_until: self.bounds.clear_until[index],
            changes_until: self.bounds.changes_until[index],
        }
    }

    /// The three bounds of [`WindowBounds`] of all windows of all levels, each level row by row.
    #[inline]
    pub(crate) fn bounds(&self) -> [&[f32]; 3] {
        let Bounds {
            free_until,
            clear_until,
            changes_until,
        } = &self.bounds;
        [free_until, clear_until, changes_until]
    }

    /// No pixel changes a cell beyond this; minus infinity if all are holes.
    #[inline]
    pub(crate) fn farthest_change(&self) -> f32 {
        self.farthest_change
    }
}

impl Bounds {
    fn with_capacity(capacity: usize) -> Self {
        Self {
            free_until: Vec::with_capacity(capacity),
            clear_until: Vec::with_capacity(capacity),
            changes_until: Vec::with_capacity(capacity),
        }
    }

    /// Adds pixels of these ranges, of which each has its table's reach.
    fn push_all(&mut self, ranges: &[f32], reach_of: impl Fn(usize) -> Reach) {
        let each = |of: &mut Vec<f32>, bound: fn(f32, Reach) -> f32, of_hole: f32| {
            let bounds = ranges.iter().zip(0..).map(|(&range, i)| match range {
                HOLE => of_hole,
                range => bound(range, reach_of(i)),
            });
            of.extend(bounds);
        };
        let Self {
            free_until,
            clear_until,
            changes_until,
        } = self;
        each(
            free_until,
            |range, reach| lower(range + reach.start, reach.free_range),
            f32::NEG_INFINITY,
        );
        each(
            clear_until,
            |range, reach| range + reach.start,
            f32::INFINITY,
        );
        each(
            changes_until,
            |range, reach| lower(range + reach.end, reach.max_range),
            f32::NEG_INFINITY,
        );
    }

    #[cfg(test)]
    fn push(&mut self, free_until: f32, clear_until: f32, changes_until: f32) {
        self.free_until.push(free_until);
        self.clear_until.push(clear_until);
        self.changes_until.push(changes_until);
    }
}

/// What a table says, relative to the measured range.
#[derive(Clone, Copy)]
struct Reach {
    start: f32,
    end: f32,
    /// Free space counts up to here at most.
    free_range: f32,
    max_range: f32,
}

/// How the windows of a level are made of those of the level before.
struct Join {
    step: usize,
    half: usize,
    from: Level,
    to: Level,
}

impl Join {
    /// Appends the bounds of the new level; windows beyond the image hold `nothing`.
    fn append(&self, bounds: &mut Vec<f32>, nothing: f32, join: impl Fn(f32, f32) -> f32 + Copy) {
        let (from, to) = (self.from, self.to);
        bounds.resize(to.first + to.width * to.height, nothing);
        let (old, new) = bounds.split_at_mut(to.first);
        let row_of = |row: usize| &old[from.first + row * from.width..][..from.width];
        // Both halves of a row can lie beyond its end.
        let mut joined = vec![nothing; to.width * self.step + self.half];
        for (row, out) in new.chunks_exact_mut(to.width).enumerate() {
            let upper = row_of(row * self.step);
            if row * self.step + self.half < from.height {
                let lower = row_of(row * self.step + self.half);
                for ((out, &a), &b) in joined.iter_mut().zip(upper).zip(lower) {
                    *out = join(a, b);
                }
            } else {
                joined[..from.width].copy_from_slice(upper);
            }
            let right = &joined[self.half..];
            if self.step == 1 {
                for ((out, &a), &b) in out.iter_mut().zip(&joined).zip(right) {
                    *out = join(a, b);
                }
            } else {
                let pairs = joined
                    .iter()
                    .step_by(self.step)
                    .zip(right.iter().step_by(self.step));
                for (out, (&a, &b)) in out.iter_mut().zip(pairs) {
                    *out = join(a, b);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_of_any_box_holds_its_pixels_and_is_little_larger() {
        let (width, height) = (43, 27);
        let mut state = 3_u32;
        let mut random = move || {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            (state >> 16) as f32
        };
        let mut bounds = Bounds::default();
        let pixels: Vec<[f32; 3]> = (0..width * height)
            .map(|_| [random(), random(), random()])
            .collect();
        for [free, clear, changes] in &pixels {
            bounds.push(*free, *clear, *changes);
        }
        let windows = Windows::from_pixels([width, height], bounds);
        let join = |columns: std::ops::Range<usize>, rows: std::ops::Range<usize>| {
            let mut joined = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY];
            for row in rows.start..rows.end.min(height) {
                for column in columns.start..columns.end.min(width) {
                    let [free, clear, changes] = pixels[row * width + column];
                    joined[0] = joined[0].min(free);
                    joined[1] = joined[1].min(clear);
                    joined[2] = joined[2].max(changes);
                }
            }
            joined
        };
        for edge in 1..=width {
            let level = windows.level_for(edge);
            let window = level.holds + (1 << level.shift) - 1;
            assert!(window >= edge && window < (8 * edge).div_ceil(3).max(2));
            for (column, row) in (0..width).flat_map(|c| (0..height).map(move |r| (c, r))) {
                let begin = |c: usize| c >> level.shift << level.shift;
                assert!(column + edge <= begin(column) + window);
                let found = windows.at(level, column, row);
                let expected = join(
                    begin(column)..begin(column) + window,
                    begin(row)..begin(row) + window,
                );
                let found = [found.free_until, found.clear_until, found.changes_until];
                assert_eq!(found, expected, "edge {edge} at {column} {row}");
            }
        }
    }
}
