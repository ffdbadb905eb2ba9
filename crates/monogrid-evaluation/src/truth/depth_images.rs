//! Ground truth from depth images with known poses: free where rays cross, occupied where they end.

use super::TruthError;
use super::grid::{FREE, OCCUPIED, TruthGrid};
use crate::line::cells_on_segment;
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};

/// One depth image with its own camera.
#[derive(Clone, Copy, Debug)]
pub struct PosedDepth<'a> {
    /// Pose of the depth camera.
    pub world_from_camera: Se3,
    /// Its intrinsics.
    pub camera: Pinhole,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Depth along the optical axis, row-major, in world units; not finite or not positive: unknown.
    pub depth: &'a [f32],
}

/// Settings of [`truth_from_depth_images`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarveConfig {
    /// Edge of a cell, world units.
    pub resolution: f64,
    /// Depth beyond this is ignored, world units. Default infinity: a truth that ends before the surfaces do makes
    /// everything behind it unknown. (A Kinect's noise passes 3 cm at 4 m.)
    pub max_depth: f64,
    /// Every so many pixels along both axes a ray is cast. Default 1.
    pub pixel_stride: usize,
    /// A cell is occupied when rays of at least so many images end in it. Default 2.
    pub min_hits: u16,
    /// ... and these are at least this share of the images that see the cell, (0, 1]. Default 0.4.
    pub min_hit_ratio: f64,
    /// Most cells of the box, 9 bytes each while it is built. Default 3e8.
    pub max_cells: u64,
}

impl CarveConfig {
    /// The defaults with cells of edge `resolution`.
    #[must_use]
    pub fn with_resolution(resolution: f64) -> Self {
        Self {
            resolution,
            max_depth: f64::INFINITY,
            pixel_stride: 1,
            min_hits: 2,
            min_hit_ratio: 0.4,
            max_cells: 300_000_000,
        }
    }
}

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
/// # Errors
/// An image of another size than stated, no usable depth, or a box of too many cells.
pub fn truth_from_depth_images(
    images: &[PosedDepth],
    config: &CarveConfig,
) -> Result<TruthGrid, TruthError> {
    for (index, image) in images.iter().enumerate() {
        if image.depth.len() != image.width * image.height {
            return Err(TruthError::ImageSize {
                index,
                found: image.depth.len(),
                width: image.width,
                height: image.height,
            });
        }
    }
    let mut grid = empty_grid(images, config)?;
    let size = grid.size();
    let mut votes = vec![Votes::default(); size[0] * size[1] * size[2]];
    let index_of = |[x, y, z]: [usize; 3]| (z * size[1] + y) * size[0] + x;
    for (number, image) in (1..).zip(images) {
        let origin = image.world_from_camera.translation;
        // Ends first: a cell that is hit does not count as passed by the same image.
        for_each_point(image, config, |point| {
            if let Some(cell) = grid.key(point.into()).and_then(|key| grid.local(key)) {
                let vote = &mut votes[index_of(cell)];
                if vote.last_hit != number {
                    vote.last_hit = number;
                    vote.hits = vote.hits.saturating_add(1);
                }
            }
        });
        for_each_point(image, config, |point| {
            cells_on_segment(origin.into(), point.into(), config.resolution, |key| {
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
        if vote.hits >= config.min_hits && f64::from(vote.hits) >= config.min_hit_ratio * seen {
            grid.set_code(cell, OCCUPIED);
        } else if vote.misses > 0 {
            grid.set_code(cell, FREE);
        }
    }
    Ok(grid)
}

fn empty_grid(images: &[PosedDepth], config: &CarveConfig) -> Result<TruthGrid, TruthError> {
    let mut low = Vec3::repeat(f64::INFINITY);
    let mut high = Vec3::repeat(f64::NEG_INFINITY);
    for image in images {
        let origin = image.world_from_camera.translation;
        for_each_point(image, config, |point| {
            low = low.inf(&point).inf(&origin);
            high = high.sup(&point).sup(&origin);
        });
    }
    if low.x > high.x {
        return Err(TruthError::NothingKnown);
    }
    let inv_resolution = 1.0 / config.resolution;
    let key = |point: Vec3| {
        monogrid_occupancy::VoxelKey::from_point(point.into(), inv_resolution)
            .map(monogrid_occupancy::VoxelKey::to_array)
            .ok_or(TruthError::Point {
                index: 0,
                point: point.into(),
            })
    };
    TruthGrid::new(config.resolution, key(low)?, key(high)?, config.max_cells)
}

/// World points of the usable pixels of an image.
fn for_each_point(image: &PosedDepth, config: &CarveConfig, mut visit: impl FnMut(Vec3)) {
    let stride = config.pixel_stride.max(1);
    for y in (0..image.height).step_by(stride) {
        for x in (0..image.width).step_by(stride) {
            let depth = f64::from(image.depth[y * image.width + x]);
            if depth.is_finite() && depth > 0.0 && depth <= config.max_depth {
                let ray = image.camera.unproject(&Vec2::new(x as f64, y as f64));
                visit(image.world_from_camera * (ray * depth));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Rotation;
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
                world_from_camera: Se3::new(Rotation::identity(), Vec3::new(*x, 0.0, 0.0)),
                camera,
                width,
                height,
                depth: &depth,
            })
            .collect();
        let grid =
            truth_from_depth_images(&images, &CarveConfig::with_resolution(0.1)).expect("a grid");
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
