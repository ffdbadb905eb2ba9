//! Pyramids of ranges: how near could something be, how far can anything matter?

/// Bounds over a block of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    /// Every pixel of the block sees free space up to here; minus infinity if one is a hole.
    pub free_until: f32,
    /// No pixel of the block changes a cell beyond this; minus infinity if all are holes.
    pub changes_until: f32,
}

impl Bounds {
    #[inline]
    fn join(self, other: Self) -> Self {
        Self {
            free_until: self.free_until.min(other.free_until),
            changes_until: self.changes_until.max(other.changes_until),
        }
    }
}

struct Level {
    width: usize,
    height: usize,
    bounds: Vec<Bounds>,
}

/// Bounds of blocks of `2^level` pixels' edge.
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

    /// Bounds over pixels `first` to `last` (column, row), both inclusive and inside the image.
    #[inline]
    pub(crate) fn block_bounds(&self, first: [usize; 2], last: [usize; 2]) -> Bounds {
        let span = (last[0] - first[0]).max(last[1] - first[1]);
        // At this level the block is at most three wide.
        let level = (usize::BITS - span.leading_zeros()).saturating_sub(1) as usize;
        let level = level.min(self.levels.len() - 1);
        let blocks = &self.levels[level];
        let mut joined = Bounds {
            free_until: f32::INFINITY,
            changes_until: f32::NEG_INFINITY,
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
    fn bounds_of_any_box_hold_those_of_its_pixels() {
        let (width, height) = (13, 7);
        let mut state = 3_u32;
        let bounds: Vec<Bounds> = (0..width * height)
            .map(|_| {
                state = state.wrapping_mul(1664525).wrapping_add(1013904223);
                let near = (state >> 16) as f32;
                if state.is_multiple_of(9) {
                    Bounds {
                        free_until: f32::NEG_INFINITY,
                        changes_until: f32::NEG_INFINITY,
                    }
                } else {
                    Bounds {
                        free_until: near,
                        changes_until: near + 1.0,
                    }
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
                    assert!(found.free_until <= inside.free_until);
                    assert!(found.changes_until >= inside.changes_until);
                }
            }
        }
    }
}
