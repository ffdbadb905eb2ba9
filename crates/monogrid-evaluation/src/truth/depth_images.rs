//! Ground truth from depth images with known poses: free where rays cross, occupied where they end.

use super::grid::{FREE, OCCUPIED, TruthGrid};
use super::{TruthError, View};
use crate::line::cells_on_segment;
use monogrid_geometry::{Vec2, Vec3};
use monogrid_occupancy::VoxelKey;

/// One depth image with its own camera.
#[derive(Clone, Copy, Debug)]
pub struct PosedDepth<'a> {
    /// The depth camera.
    pub view: View,
    /// Depth along the optical axis, row-major, in world units; not finite or not positive:
    /// unknown.
    pub depth: &'a [f32],
}

/// A cell is occupied when rays of at least so many images end in it ...
const MIN_HITS: u16 = 2;
/// ... and these are at least this share of the images that see the cell.
const MIN_HIT_RATIO: f64 = 0.4;
/// Most cells of the box, 9 bytes each while it is built.
const MAX_CELLS: u64 = 300_000_000;

/// Images in which a ray ends in a cell, or only passes it.
#[derive(Clone, Copy, Default)]
struct Votes {
    hits: u16,
    misses: u16,
    /// Number of the last image that hit, and of the last that passed, counted from 1.
    last_hit: u16,
    last_miss: u16,
}

/// Ground truth of what the depth images saw.
///
/// Every image votes once per cell: occupied when one of its rays ends in the cell, else free when
/// one passes it. Real depth is noisy, so this is only as true as the depth and the poses are.
///
/// `resolution` is the edge of a cell, world units. Depth beyond `max_depth` (world units) is
/// ignored: a truth that ends before the surfaces do makes everything behind it unknown. (A
/// Kinect's noise passes 3 cm at 4 m.)
///
/// # Errors
/// An image of another size than stated, no usable depth, or a box of too many cells.
pub fn truth_from_depth_images(
    images: &[PosedDepth],
    resolution: f64,
    max_depth: f64,
) -> Result<TruthGrid, TruthError> {
    for (index, image) in images.iter().enumerate() {
        let (found, width, height) = (image.depth.len(), image.view.width, image.view.height);
        if found != width * height {
            return Err(TruthError::ImageSize {
                index,
                found,
                width,
                height,
            });
        }
    }
    let mut grid = empty_grid(images, resolution, max_depth)?;
    let size = grid.size();
    let mut votes = vec![Votes::default(); size[0] * size[1] * size[2]];
    let index_of = |[x, y, z]: [usize; 3]| (z * size[1] + y) * size[0] + x;
    for (number, image) in (1..).zip(images) {
        let origin = image.view.world_from_camera.translation;
        // Ends first: a cell that is hit does not count as passed by the same image.
        for_each_point(image, max_depth, |point| {
            if let Some(cell) = grid.key(point.into()).and_then(|key| grid.local(key)) {
                let vote = &mut votes[index_of(cell)];
                if vote.last_hit != number {
                    vote.last_hit = number;
                    vote.hits = vote.hits.saturating_add(1);
                }
            }
        });
        for_each_point(image, max_depth, |point| {
            cells_on_segment(origin.into(), point.into(), resolution, |key| {
                if let Some(cell) = grid.local(key) {
                    let vote = &mut votes[index_of(cell)];
                    if vote.last_hit != number && vote.last_miss != number {
                        vote.last_miss = number;
                        vote.misses = vote.misses.saturating_add(1);
                    }
                }
                true
            });
        });
    }
    for cell in grid.cells() {
        let vote = votes[index_of(cell)];
        let seen = f64::from(vote.hits) + f64::from(vote.misses);
        if vote.hits >= MIN_HITS && f64::from(vote.hits) >= MIN_HIT_RATIO * seen {
            grid.set_code(cell, OCCUPIED);
        } else if vote.misses > 0 {
            grid.set_code(cell, FREE);
        }
    }
    Ok(grid)
}

fn empty_grid(
    images: &[PosedDepth],
    resolution: f64,
    max_depth: f64,
) -> Result<TruthGrid, TruthError> {
    let mut low = Vec3::repeat(f64::INFINITY);
    let mut high = Vec3::repeat(f64::NEG_INFINITY);
    for image in images {
        let origin = image.view.world_from_camera.translation;
        for_each_point(image, max_depth, |point| {
            low = low.inf(&point).inf(&origin);
            high = high.sup(&point).sup(&origin);
        });
    }
    if low.x > high.x {
        return Err(TruthError::NothingKnown);
    }
    let inv_resolution = 1.0 / resolution;
    let key = |point: Vec3| {
        let (index, point) = (0, point.into());
        let key = VoxelKey::from_point(point, inv_resolution).map(VoxelKey::to_array);
        key.ok_or(TruthError::Point { index, point })
    };
    TruthGrid::new(resolution, key(low)?, key(high)?, MAX_CELLS)
}

/// World points of the usable pixels of an image.
fn for_each_point(image: &PosedDepth, max_depth: f64, mut visit: impl FnMut(Vec3)) {
    let View { width, height, .. } = image.view;
    for y in 0..height {
        for x in 0..width {
            let depth = f64::from(image.depth[y * width + x]);
            if depth.is_finite() && depth > 0.0 && depth <= max_depth {
                let pixel = Vec2::new(x as f64, y as f64);
                let ray = image.view.camera.unproject(&pixel);
                visit(image.view.world_from_camera * (ray * depth));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Pinhole, Rotation, Se3};
    use monogrid_occupancy::Occupancy;

    #[test]
    fn a_wall_seen_from_two_sides_of_the_room() {
        let (width, height) = (32, 24);
        let camera = Pinhole::new(30.0, 30.0, 15.5, 11.5);
        // The wall is the plane z = 2.05; the cameras look along z.
        let depth = vec![2.05_f32; width * height];
        let images: Vec<_> = [-0.2, 0.0, 0.2]
            .iter()
            .map(|x| PosedDepth {
                view: View {
                    world_from_camera: Se3::new(Rotation::identity(), Vec3::new(*x, 0.0, 0.0)),
                    camera,
                    width,
                    height,
                },
                depth: &depth,
            })
            .collect();
        let grid = truth_from_depth_images(&images, 0.1, f64::INFINITY).expect("a grid");
        assert_eq!(grid.state([0, 0, 20]), Occupancy::Occupied);
        assert_eq!(grid.state([0, 0, 19]), Occupancy::Free);
        assert_eq!(grid.state([0, 0, 5]), Occupancy::Free);
        assert_eq!(grid.state([0, 0, 21]), Occupancy::Unknown);
        let off_wall = grid.keys_in(Occupancy::Occupied).filter(|k| k[2] != 20);
        assert_eq!(off_wall.count(), 0);
        // Beside the frustum nothing is known.
        assert_eq!(grid.state([10, 0, 2]), Occupancy::Unknown);
    }
}
