//! How long the occupied band has to be along a line of sight so that it holds the cells that a
//! surface passes through.
//!
//! A plane with the unit normal n passes through the cell of edge e around c where it lies at most
//! e (|nx| + |ny| + |nz|) / 2 from c. Along a line of sight that makes the angle theta with n,
//! these cells are a band of the length
//!
//! ```text
//! L = e (|nx| + |ny| + |nz|) / cos(theta)
//! ```
//!
//! around the measured range: one cell for a wall along the axes that is looked at straight, and
//! many for a floor that is looked along. A cell's diagonal, which serves all where no normal is
//! known, is too much for the first and too little for the last.
//!
//! The inverse depth of a plane is affine in the slopes, w = a u + b v + c, and (a, b, c) is its
//! normal: a x + b y + c z = 1. At the range r, cos(theta) = 1 / (r |(a, b, c)|).

use crate::integrate::image::range_image::{HOLE, ONE_SURFACE, RangeImage};
use crate::sensor::table::TableSet;

/// Pixels to each side that the plane of one is fitted to.
const RADIUS: usize = 2;
/// Fewest of these pixels that must be of one surface with it.
const MIN_PIXELS: f32 = 8.0;
/// Longest band, cells: surfaces are hardly measured under flatter angles, and noise looks like
/// one.
const MOST_CELLS: f32 = 3.0;

/// Gives each pixel of an image the table of a band that is long enough for the slope of its
/// surface.
pub(super) fn band_by_slope(image: &mut RangeImage, tables: &mut TableSet, resolution: f64) {
    let surface = Surface::new(image);
    let cell = resolution as f32;
    let mut of_pixels = image.tables.clone();
    of_pixels.resize(image.ranges.len(), 0);
    for (pixel, table) in of_pixels.iter_mut().enumerate() {
        if image.ranges[pixel] != HOLE
            && let Some(cells) = surface.band_cells(pixel)
        {
            *table = tables.with_band(*table, cells.min(MOST_CELLS) * cell);
        }
    }
    image.tables = of_pixels;
}

/// A range image with the inverse depths of its pixels along the forward axis; 0 for none.
struct Surface<'a> {
    image: &'a RangeImage,
    inverse_depths: Vec<f32>,
}

impl<'a> Surface<'a> {
    fn new(image: &'a RangeImage) -> Self {
        let inverse_depth = |(pixel, range): (usize, &f32)| match *range {
            HOLE => 0.0,
            range => {
                let [u, v] = slopes(image, pixel);
                (u * u + v * v + 1.0).sqrt() / range
            }
        };
        let ranges = image.ranges.iter().enumerate();
        Self {
            inverse_depths: ranges.map(inverse_depth).collect(),
            image,
        }
    }

    /// Length of the band of a pixel with a range, in edges of a cell; `None` where too few pixels
    /// around it are of one surface with it.
    fn band_cells(&self, pixel: usize) -> Option<f32> {
        let image = self.image;
        let [du, dv] = self.gradient(pixel)?;
        let (a, b) = (du * image.focal[0], dv * image.focal[1]);
        let [u, v] = slopes(image, pixel);
        let c = self.inverse_depths[pixel] - a * u - b * v;
        let normal: [f32; 3] = std::array::from_fn(|i| {
            let [right, down, forward] = image.axes.map(|axis| axis[i] as f32);
            a * right + b * down + c * forward
        });
        // with n = normal / |normal| and cos(theta) = 1 / (r |normal|), its length cancels
        Some(normal.iter().map(|n| n.abs()).sum::<f32>() * image.ranges[pixel])
    }

    /// How the inverse depth changes from column to column and from row to row: of the plane by
    /// least squares.
    fn gradient(&self, pixel: usize) -> Option<[f32; 2]> {
        let (width, height) = (self.image.width, self.image.height);
        let (x, y) = (pixel % width, pixel / width);
        let own = self.inverse_depths[pixel];
        let mut sums = Sums::default();
        for row in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
            for column in x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width) {
                let change = self.inverse_depths[row * width + column] - own;
                if change.abs() <= ONE_SURFACE * own {
                    let offset = [column as f32 - x as f32, row as f32 - y as f32];
                    sums.add(offset, change);
                }
            }
        }
        sums.gradient()
    }
}

/// Slopes of the middle of a pixel.
fn slopes(image: &RangeImage, pixel: usize) -> [f32; 2] {
    let at = [pixel % image.width, pixel / image.width];
    std::array::from_fn(|i| (at[i] as f32 - image.center[i]) / image.focal[i])
}

/// Sums over pixels, of their offsets, of what is asked for, and of products.
#[derive(Default)]
struct Sums {
    count: f32,
    x: f32,
    y: f32,
    w: f32,
    xx: f32,
    xy: f32,
    yy: f32,
    xw: f32,
    yw: f32,
}

impl Sums {
    fn add(&mut self, [x, y]: [f32; 2], w: f32) {
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.w += w;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.xw += x * w;
        self.yw += y * w;
    }

    /// The gradient of the plane through them, if they are many and not on one line.
    fn gradient(&self) -> Option<[f32; 2]> {
        if self.count < MIN_PIXELS {
            return None;
        }
        let about = |product: f32, a: f32, b: f32| product - a * b / self.count;
        let xx = about(self.xx, self.x, self.x);
        let xy = about(self.xy, self.x, self.y);
        let yy = about(self.yy, self.y, self.y);
        let xw = about(self.xw, self.x, self.w);
        let yw = about(self.yw, self.y, self.w);
        let determinant = xx * yy - xy * xy;
        (determinant > 1e-3 * xx * yy).then(|| {
            [
                (yy * xw - xy * yw) / determinant,
                (xx * yw - xy * xw) / determinant,
            ]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::{IntegrationConfig, integrate};
    use crate::map::{MapConfig, OccupancyMap};
    use crate::scan::{Scan, Similarity};
    use crate::sensor::table::KnownTables;

    /// The image of a plane `normal x = distance` in the world, from its origin, the axes of the
    /// camera turned about the vertical.
    fn plane(normal: [f32; 3], distance: f32, turned: f64) -> RangeImage {
        let (sin, cos) = turned.sin_cos();
        let axes = [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]];
        let (width, height) = (41, 31);
        let mut image = RangeImage {
            axes,
            width,
            height,
            focal: [60.0, 55.0],
            center: [20.0, 15.0],
            ranges: vec![HOLE; width * height],
            tables: Vec::new(),
            density: 1.0,
        };
        for pixel in 0..width * height {
            let [u, v] = slopes(&image, pixel);
            let ray: [f32; 3] = std::array::from_fn(|i| {
                let [right, down, forward] = axes.map(|axis| axis[i] as f32);
                u * right + v * down + forward
            });
            let along: f32 = ray.iter().zip(normal).map(|(r, n)| r * n).sum();
            if along > 0.0 {
                image.ranges[pixel] = (u * u + v * v + 1.0).sqrt() * distance / along;
            }
        }
        image
    }

    #[test]
    fn the_band_holds_the_cells_that_a_plane_passes_through() {
        let middle = 15 * 41 + 20;
        let root = 0.5_f32.sqrt();
        for (normal, turned, expected) in [
            // a wall along the axes, looked at straight and under 45 degrees
            ([0.0, 0.0, 1.0], 0.0, 1.0),
            ([0.0, 0.0, 1.0], std::f64::consts::FRAC_PI_4, 2.0_f32.sqrt()),
            // a wall across the axes, looked at straight: cells on edge
            (
                [root, 0.0, root],
                std::f64::consts::FRAC_PI_4,
                2.0_f32.sqrt(),
            ),
            ([root, 0.0, root], 0.0, 2.0),
        ] {
            let image = plane(normal, 2.0, turned);
            let found = Surface::new(&image).band_cells(middle).unwrap();
            assert!((found - expected).abs() < 1e-3, "{found} {expected}");
        }
    }

    #[test]
    fn cells_within_the_band_are_those_that_the_plane_touches() {
        let normal = [0.48_f32, 0.6, 0.64];
        let image = plane(normal, 2.0, 0.3);
        let surface = Surface::new(&image);
        let half = 0.5 * normal.iter().sum::<f32>();
        let mut compared = 0;
        for pixel in (0..image.ranges.len()).step_by(17) {
            let cos = 2.0 / image.ranges[pixel];
            let Some(found) = surface.band_cells(pixel) else {
                continue;
            };
            // the middle of a cell at the end of the band is half the extent of a cell along the
            // normal away
            assert!((0.5 * found * cos - half).abs() < 2e-3 * half, "{pixel}");
            compared += 1;
        }
        assert!(compared > 60, "{compared}");
    }

    #[test]
    fn edges_have_the_slope_of_their_own_side_and_lonely_pixels_none() {
        let mut image = plane([0.0, 0.0, 1.0], 2.0, 0.0);
        let behind = plane([0.0, 0.0, 1.0], 3.0, 0.0);
        for pixel in 0..image.ranges.len() {
            if pixel % 41 > 20 {
                image.ranges[pixel] = behind.ranges[pixel];
            }
        }
        let lonely = 5 * 41 + 5;
        for pixel in 0..41 * 9 {
            if pixel != lonely {
                image.ranges[pixel] = HOLE;
            }
        }
        let surface = Surface::new(&image);
        for pixel in [15 * 41 + 20, 15 * 41 + 21, 30 * 41 + 40] {
            let found = surface.band_cells(pixel).unwrap();
            let [u, v] = slopes(&image, pixel);
            let expected = (u * u + v * v + 1.0).sqrt();
            assert!((found - expected).abs() < 1e-3, "{pixel}: {found}");
        }
        assert_eq!(surface.band_cells(lonely), None);
    }

    /// Cells of a map of one precise depth image of a plane: occupied ones that it passes through,
    /// all that it passes through, and occupied ones.
    fn occupied(normal: [f64; 3], band_by_slope: bool) -> [usize; 3] {
        const CELL: f64 = 0.05;
        // a fifth of a cell off the middle of one
        const DISTANCE: f64 = 1.985;
        let points: Vec<[f32; 3]> = (-70..=70)
            .flat_map(|y| {
                (-70..=70).map(move |x| [f64::from(x) / 100.0, f64::from(y) / 100.0, 1.0])
            })
            .map(|ray| {
                let along: f64 = ray.iter().zip(normal).map(|(r, n)| r * n).sum();
                ray.map(|r| (DISTANCE / along * r) as f32)
            })
            .collect();
        let scan = Scan::of_points(0, Similarity::IDENTITY, &points, &[0.001]);
        let config = IntegrationConfig {
            band_by_slope,
            update_min: -0.2,
            cutoff_log_odds: 0.6,
            obstacle_weight: 0,
            ..IntegrationConfig::default()
        };
        let mut map = OccupancyMap::new(MapConfig::with_resolution(CELL)).unwrap();
        integrate(&mut map, &scan, &config, 1).unwrap();
        let mut counts = [0; 3];
        for cell in map.cells() {
            let center = cell.key.center(CELL);
            // well inside of the view, and where pixels are finer than cells
            if center[0].abs().max(center[1].abs()) > 0.55 * center[2] || center[2] > 3.0 {
                continue;
            }
            let along: f64 = center.iter().zip(normal).map(|(c, n)| c * n).sum();
            let reach = 0.5 * CELL * normal.iter().map(|n| n.abs()).sum::<f64>();
            let is_touched = (along - DISTANCE).abs() < reach;
            let is_occupied = cell.log_odds > 0.0;
            counts[0] += usize::from(is_touched && is_occupied);
            counts[1] += usize::from(is_touched);
            counts[2] += usize::from(is_occupied);
        }
        counts
    }

    #[test]
    fn walls_are_thinner_and_slanted_ones_more_complete_than_by_the_diagonal() {
        let [right, touched, all] = occupied([0.0, 0.0, 1.0], true);
        let [_, _, by_diagonal] = occupied([0.0, 0.0, 1.0], false);
        assert_eq!(right, touched);
        assert!(100 * all <= 115 * touched, "{all} {touched}");
        assert!(2 * by_diagonal > 3 * touched, "{by_diagonal} {touched}");
        let steep = [0.8, 0.0, 0.6];
        let [right, touched, all] = occupied(steep, true);
        let [by_diagonal, seen, _] = occupied(steep, false);
        assert!(
            200 * right > 199 * touched && 100 * by_diagonal < 99 * seen,
            "{right} {touched} {by_diagonal} {seen}"
        );
        // samples of a footprint spread along a slope as well
        assert!(4 * right > 3 * all, "{right} {all}");
    }

    #[test]
    fn pixels_get_tables_as_long_as_their_bands_and_no_longer_than_three_cells() {
        let cell = 0.05;
        let config = IntegrationConfig::default();
        let bands = |normal, sigma: f32| {
            let mut image = plane(normal, 2.0, 0.0);
            let mut tables = KnownTables::default().set(&config, cell).unwrap();
            let own = tables.prepare(2.0, sigma);
            assert_eq!(own, 0);
            band_by_slope(&mut image, &mut tables, cell);
            let middle = image.tables[15 * 41 + 20];
            // where the occupied band ends, before its uncertainty: the table is about even there
            (tables.table(own).end(), tables.table(middle).end())
        };
        let (own, straight) = bands([0.0, 0.0, 1.0], 0.002);
        assert!(straight < own && straight > 0.5 * cell, "{straight} {own}");
        let (own, flat) = bands([0.28, 0.0, 0.96], 0.002);
        let (_, flatter) = bands([0.93, 0.0, 0.367_56], 0.002);
        assert!(flat > straight && flat < own, "{straight} {flat} {own}");
        assert!(flatter > own && flatter < 1.8 * cell, "{own} {flatter}");
        // what is much less certain than a cell is large keeps its table
        let (own, uncertain) = bands([0.0, 0.0, 1.0], 0.1);
        assert!((own - uncertain).abs() < 1e-12);
    }
}
