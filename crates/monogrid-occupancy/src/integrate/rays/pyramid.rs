//! Pyramids over tiles of directions: how near can a cell be raised, how far is free space?

/// Bounds over a block of tiles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    /// Least range of a cell's centre at which a beam can raise it.
    pub raised_from: f32,
    /// Farthest end of a beam's free space; minus infinity if there is no beam.
    pub free_until: f32,
}

impl Bounds {
    #[inline]
    fn join(self, other: Self) -> Self {
        Self {
            raised_from: self.raised_from.min(other.raised_from),
            free_until: self.free_until.max(other.free_until),
        }
    }
}

struct Level {
    width: usize,
    height: usize,
    bounds: Vec<Bounds>,
}

/// Bounds of blocks of `2^level` tiles' edge.
pub(crate) struct Pyramid {
    levels: Vec<Level>,
}

impl Pyramid {
    /// A pyramid over a grid of `width` x `height` bounds, row by row; neither is 0.
    pub(crate) fn from_bounds(width: usize, height: usize, bounds: Vec<Bounds>) -> Self {
        let mut levels = vec![Level {
            width,
            height,
            bounds,
        }];
        while let Some(last) = levels.last()
            && (last.width > 1 || last.height > 1)
        {
            let next = last.halved();
            levels.push(next);
        }
        Self { levels }
    }

    /// Bounds over tiles `first` to `last` (column, row), both inclusive and in the grid.
    #[inline]
    pub(crate) fn block_bounds(&self, first: [usize; 2], last: [usize; 2]) -> Bounds {
        let span = (last[0] - first[0]).max(last[1] - first[1]);
        // At this level the block is at most three wide.
        let level = (usize::BITS - span.leading_zeros()).saturating_sub(1) as usize;
        let level = level.min(self.levels.len() - 1);
        let blocks = &self.levels[level];
        let mut joined = Bounds {
            raised_from: f32::INFINITY,
            free_until: f32::NEG_INFINITY,
        };
        for row in first[1] >> level..=last[1] >> level {
            let start = row * blocks.width;
            let row = &blocks.bounds[start + (first[0] >> level)..=start + (last[0] >> level)];
            joined = row.iter().fold(joined, |joined, b| joined.join(*b));
        }
        joined
    }
}

impl Level {
    fn halved(&self) -> Level {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut bounds = Vec::with_capacity(width * height);
        for row in 0..height {
            let upper = &self.bounds[2 * row * self.width..][..self.width];
            let lower_row = (2 * row + 1).min(self.height - 1);
            let lower = &self.bounds[lower_row * self.width..][..self.width];
            let pairs = upper.chunks(2).zip(lower.chunks(2));
            bounds.extend(
                pairs.map(|(u, l)| u[0].join(l[0]).join(u[u.len() - 1]).join(l[l.len() - 1])),
            );
        }
        Level {
            width,
            height,
            bounds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_of_any_box_hold_those_of_its_tiles() {
        let (width, height) = (13, 7);
        let mut state = 3_u32;
        let bounds: Vec<Bounds> = (0..width * height)
            .map(|_| {
                state = state.wrapping_mul(1664525).wrapping_add(1013904223);
                Bounds {
                    raised_from: (state >> 16) as f32,
                    free_until: (state >> 12) as f32,
                }
            })
            .collect();
        let pyramid = Pyramid::from_bounds(width, height, bounds.clone());
        for (x0, x1, y0, y1) in (0..13).flat_map(|a| {
            (a..13).flat_map(move |b| (0..7).flat_map(move |c| (c..7).map(move |d| (a, b, c, d))))
        }) {
            let found = pyramid.block_bounds([x0, y0], [x1, y1]);
            for y in y0..=y1 {
                for x in x0..=x1 {
                    let inside = bounds[y * width + x];
                    assert!(found.raised_from <= inside.raised_from);
                    assert!(found.free_until >= inside.free_until);
                }
            }
        }
    }
}
