//! What the eight halves of a cube of cells can get from a range image, found for all at once.
//!
//! The loops over eight lanes here define the result; `octants_avx2` computes the same bits with a
//! vector.

use crate::integrate::image::extremes::{higher, lower};
use crate::integrate::image::range_image::RangeImage;
use crate::integrate::image::windows::Windows;
use crate::integrate::kernel::scalar::{EIGHT_SAMPLES, FOUR_SAMPLES, SINGLE_SAMPLE_PX};
use crate::integrate::octants::Octants;

/// A cube in the world's axes, relative to the sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cube {
    pub center: [f32; 3],
    /// Half of its edge.
    pub half: f32,
}

impl Cube {
    /// One of the eight halves.
    pub(crate) fn octant(self, octant: usize) -> Self {
        let half = 0.5 * self.half;
        Self {
            center: std::array::from_fn(|axis| self.center[axis] + side(octant, axis) * half),
            half,
        }
    }
}

/// An image with its bounds, as the search needs it.
pub(crate) struct View<'a> {
    pub image: &'a RangeImage,
    pub windows: &'a Windows,
    /// Edge of a cell.
    pub cell: f32,
    /// Cells that are not deeper than this along the optical axis get nothing.
    pub nearest: f32,
}

const LANES: usize = 8;
type Lanes = [f32; LANES];

/// Slack against rounding, in cells, in pixels and relative to ranges.
pub(crate) const SLACK_CELLS: f32 = 0.02;
pub(crate) const SLACK_PX: f32 = 0.01;
pub(crate) const SLACK_RANGE: f32 = 1e-5;

/// Widest offset of a sample from the centre, in units of the footprint's width.
pub(crate) const WIDEST_SAMPLE: f32 = {
    let mut widest = 0.0;
    let mut i = 0;
    while i < 8 {
        let [u, v] = EIGHT_SAMPLES[i];
        let [s, t] = FOUR_SAMPLES[i / 2];
        let candidates = [u.abs(), v.abs(), s.abs(), t.abs()];
        let mut c = 0;
        while c < 4 {
            if candidates[c] > widest {
                widest = candidates[c];
            }
            c += 1;
        }
        i += 1;
    }
    widest
};

#[inline]
fn lanes(f: impl Fn(usize) -> f32) -> Lanes {
    std::array::from_fn(f)
}

/// `-1` or `1` for the side of octant `octant` along `axis`.
#[inline]
fn side(octant: usize, axis: usize) -> f32 {
    if octant >> axis & 1 == 0 { -1.0 } else { 1.0 }
}

/// A bit for each lane that satisfies a condition.
#[inline]
fn bits(condition: impl Fn(usize) -> bool) -> u8 {
    // Eight bytes of 0 or 1, gathered into one by a product.
    let bytes: [u8; LANES] = std::array::from_fn(|l| u8::from(condition(l)));
    (u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

/// Bounds of the windows of eight boxes.
#[derive(Default)]
struct BoundsOfLanes {
    free_until: Lanes,
    clear_until: Lanes,
    changes_until: Lanes,
}

impl View<'_> {
    /// Judges the eight halves of a cube. Conservative: touched, and neither free nor clear, where
    /// it is not certain.
    #[inline]
    pub(crate) fn judge(&self, cube: Cube) -> Octants {
        let half = 0.5 * cube.half;
        // What counts are the centres of cells: half a cell less than the octants.
        let hull = half - 0.5 * self.cell + SLACK_CELLS * self.cell;
        let centers: [Lanes; 3] =
            std::array::from_fn(|a| lanes(|l| cube.center[a] + side(l, a) * half));
        let mut nearest = [0.0; LANES];
        let mut farthest = [0.0; LANES];
        for center in &centers {
            for l in 0..LANES {
                let near = higher(center[l].abs() - hull, 0.0);
                let far = center[l].abs() + hull;
                nearest[l] += near * near;
                farthest[l] += far * far;
            }
        }
        let (axes, extent) = self.axes_and_extent(hull);
        let in_image: [Lanes; 3] = std::array::from_fn(|i| {
            let [x, y, z] = axes[i];
            lanes(|l| x * centers[0][l] + y * centers[1][l] + z * centers[2][l])
        });
        let near = lanes(|l| in_image[2][l] - extent[2]);
        let far = lanes(|l| in_image[2][l] + extent[2]);
        // Cells that are not deeper than `nearest` get nothing.
        let inv_near = lanes(|l| 1.0 / higher(near[l], self.nearest));
        let inv_far = lanes(|l| 1.0 / higher(far[l], self.nearest));
        let boxes = self.pixel_boxes(&in_image, extent, &inv_near, &inv_far);
        let bounds = self.look_up(&boxes);
        let nearest = lanes(|l| nearest[l].sqrt() * (1.0 - SLACK_RANGE));
        let farthest = lanes(|l| farthest[l].sqrt() * (1.0 + SLACK_RANGE));
        let [right, bottom] = boxes.size;
        let is_deep = bits(|l| near[l] > self.nearest);
        let reaches_deep = bits(|l| far[l] > self.nearest);
        let [low_u, low_v] = &boxes.low;
        let [high_u, high_v] = &boxes.high;
        let is_seen = bits(|l| {
            (high_u[l] >= 0.0) & (high_v[l] >= 0.0) & (low_u[l] < right) & (low_v[l] < bottom)
        });
        // Pixels outside of the image are holes.
        let is_inside = bits(|l| {
            (low_u[l] >= 0.0) & (low_v[l] >= 0.0) & (high_u[l] < right) & (high_v[l] < bottom)
        });
        let is_reached = bits(|l| nearest[l] <= bounds.changes_until[l]);
        let is_clear = bits(|l| farthest[l] < bounds.clear_until[l]);
        let is_free = bits(|l| farthest[l] < bounds.free_until[l]);
        let touched = reaches_deep & is_seen & is_reached;
        Octants {
            touched,
            clear: touched & is_clear,
            free: touched & is_clear & is_free & is_inside & is_deep,
        }
    }

    /// The axes of the image, and the extent of a cube of half edge `hull` along them.
    #[inline]
    pub(crate) fn axes_and_extent(&self, hull: f32) -> ([[f32; 3]; 3], [f32; 3]) {
        let axes = self.image.axes.map(|axis| axis.map(|c| c as f32));
        let extent = axes.map(|[x, y, z]| (x.abs() + y.abs() + z.abs()) * hull);
        (axes, extent)
    }

    /// The bounds over each box; of a box outside of the image, those of some pixels in it.
    #[inline]
    fn look_up(&self, boxes: &PixelBoxes) -> BoundsOfLanes {
        let level = self.windows.level_for(boxes.edge());
        let first: [[i32; LANES]; 2] = std::array::from_fn(|axis| {
            let last = boxes.size[axis] - 1.0;
            boxes.low[axis].map(|low| lower(higher(low, 0.0), last) as i32)
        });
        let mut bounds = BoundsOfLanes::default();
        for (l, (&column, &row)) in first[0].iter().zip(&first[1]).enumerate() {
            let found = self.windows.at(level, column as usize, row as usize);
            bounds.free_until[l] = found.free_until;
            bounds.clear_until[l] = found.clear_until;
            bounds.changes_until[l] = found.changes_until;
        }
        bounds
    }

    /// The pixels that the samples of the octants' cells can fall into.
    #[inline]
    fn pixel_boxes(
        &self,
        in_image: &[Lanes; 3],
        extent: [f32; 3],
        inv_near: &Lanes,
        inv_far: &Lanes,
    ) -> PixelBoxes {
        let [width, height] = self.windows.size();
        let size = [width as f32, height as f32];
        let footprint = self.cell * self.image.focal[0];
        // Samples lie within so much of the cell's centre, at its depth.
        let spread = lanes(|l| {
            let width = footprint * inv_near[l] * (1.0 + SLACK_RANGE);
            if width <= SINGLE_SAMPLE_PX {
                0.0
            } else {
                WIDEST_SAMPLE * self.cell
            }
        });
        let mut boxes = PixelBoxes {
            low: [[0.0; LANES]; 2],
            high: [[0.0; LANES]; 2],
            size,
        };
        for axis in 0..2 {
            // Half a pixel more: truncation then finds the nearest pixel.
            let (focal, center) = (self.image.focal[axis], self.image.center[axis] + 0.5);
            // Footprints are as high as they are wide, in pixels.
            let aspect = self.image.focal[0] / focal;
            for l in 0..LANES {
                let extent = extent[axis] + spread[l] * aspect;
                let low = in_image[axis][l] - extent;
                let high = in_image[axis][l] + extent;
                let low = low * if low < 0.0 { inv_near[l] } else { inv_far[l] };
                let high = high * if high > 0.0 { inv_near[l] } else { inv_far[l] };
                boxes.low[axis][l] = low * focal + center - SLACK_PX;
                boxes.high[axis][l] = high * focal + center + SLACK_PX;
            }
        }
        boxes
    }
}

/// Boxes of pixels, by axis and lane; pixel `i` covers `[i, i + 1)`.
struct PixelBoxes {
    low: [Lanes; 2],
    high: [Lanes; 2],
    size: [f32; 2],
}

impl PixelBoxes {
    /// Pixels along the longest edge of all boxes, as far as they lie in the image.
    #[inline]
    fn edge(&self) -> usize {
        let mut longest = 0_i32;
        for axis in 0..2 {
            let last = self.size[axis] - 1.0;
            for l in 0..LANES {
                let low = lower(higher(self.low[axis][l], 0.0), last) as i32;
                let high = lower(higher(self.high[axis][l], 0.0), last) as i32;
                longest = longest.max(high - low);
            }
        }
        longest as usize + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::IntegrationConfig;
    use crate::integrate::image::RangeImages;
    use crate::scan::{PointScan, PoseSigma, Scan, ScanData, Similarity};
    use crate::sensor::table::KnownTables;
    use crate::test_random::Random;

    /// The edge of a cell.
    const CELL: f32 = 0.01;

    /// Random points one to two units in front of a turned camera, as an image.
    fn images() -> RangeImages {
        let mut random = Random(9);
        let points: Vec<[f32; 3]> = (0..3000)
            .map(|_| {
                let z = 1.0 + random.unit();
                [(random.unit() - 0.5) * z, (random.unit() - 0.6) * z, z]
            })
            .collect();
        let (sin, cos) = 0.7_f64.sin_cos();
        let scan = Scan {
            id: 0,
            world_from_sensor: Similarity {
                rotation: [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]],
                ..Similarity::IDENTITY
            },
            pose_sigma: PoseSigma::default(),
            data: ScanData::Points(PointScan {
                points: &points,
                sigmas: &[0.01],
            }),
        };
        let (config, tables) = (IntegrationConfig::default(), KnownTables::default());
        RangeImages::new(&scan, &config, f64::from(CELL), 1, &tables).unwrap()
    }

    /// What `look` sees of them.
    fn with_view<T>(look: impl FnOnce(&View) -> T) -> T {
        let images = images();
        let windows = Windows::new(&images.images[0], &images.tables, 100.0);
        look(&View {
            image: &images.images[0],
            windows: &windows,
            cell: CELL,
            nearest: 0.25 * CELL,
        })
    }

    #[test]
    fn cubes_in_the_plane_of_the_camera_are_touched_only_beside_it() {
        with_view(|view| {
            let axes = view.image.axes.map(|axis| axis.map(|c| c as f32));
            for offset in [0.0, 0.05, 0.3, 1.0] {
                for axis in [&axes[0], &axes[1]] {
                    let cube = Cube {
                        center: axis.map(|c| c * offset),
                        half: 4.0 * CELL,
                    };
                    let touched = view.judge(cube).touched;
                    assert_eq!(touched != 0, offset < 0.1, "{offset}");
                }
            }
        });
    }

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn vectors_give_the_bits_of_the_scalar_search() {
        with_view(|view| {
            let mut random = Random(5);
            let mut seen = Octants::default();
            for i in 0..200_000 {
                let cube = Cube {
                    center: [0; 3].map(|_| (random.unit() - 0.5) * 4.0),
                    half: CELL * (1 << (i % 8)) as f32,
                };
                let expected = view.judge(cube);
                let Some(found) = crate::integrate::fused::octants_avx2::judge(view, cube) else {
                    eprintln!("SKIPPED: this processor has no AVX2");
                    return;
                };
                assert_eq!(found, expected, "{cube:?}");
                seen.touched |= expected.touched;
                seen.clear |= expected.clear & !expected.free;
                seen.free |= expected.free;
            }
            assert!((seen.touched, seen.clear, seen.free) == (0xff, 0xff, 0xff));
        });
    }
}
