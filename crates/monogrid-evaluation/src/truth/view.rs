//! Which cells the keyframes look at: without it, coverage blames a map for what nobody saw.

use super::grid::{FREE, OCCUPIED, TruthGrid, UNKNOWN};
use crate::line::cells_on_segment;
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};

/// A camera that looks at the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// True pose.
    pub world_from_camera: Se3,
    /// Intrinsics.
    pub camera: Pinhole,
    /// Columns of its images.
    pub width: usize,
    /// Rows of its images.
    pub height: usize,
}

/// Distance between neighbouring rays at their far end, in cells: small enough that no cell of
/// the frustum slips between four of them.
const RAY_SPACING_CELLS: f64 = 0.7;

/// Marks the cells of `truth` that at least one view sees within `max_range` (map units, along the
/// ray): rays spread over each image run until they meet an occupied cell, which is seen too.
///
/// The result has the box of `truth`; cells that nobody sees are unknown, the others as in `truth`
/// (those whose truth is unknown as free). The cost grows with the cube of range over resolution:
/// pass a coarsened truth and let [`crate::evaluate_map`] look up its cells in the coarser view.
#[must_use]
pub fn cells_in_view(truth: &TruthGrid, views: &[View], max_range: f64) -> TruthGrid {
    let mut seen = truth.clone();
    for cell in truth.cells() {
        seen.set_code(cell, UNKNOWN);
    }
    for view in views {
        let origin = view.world_from_camera.translation;
        let range_cells = max_range / truth.resolution();
        for_each_ray(view, range_cells, |direction_in_camera| {
            let end = view.world_from_camera * (direction_in_camera.normalize() * max_range);
            cells_on_segment(origin.into(), end.into(), truth.resolution(), |key| {
                let Some(cell) = truth.local(key) else {
                    // Cameras are inside the box, so the rest of the ray is outside.
                    return false;
                };
                let is_occupied = truth.code(cell) == OCCUPIED;
                seen.set_code(cell, if is_occupied { OCCUPIED } else { FREE });
                !is_occupied
            });
        });
    }
    seen
}

/// Directions spread over the image, close enough to hit every cell at `range_cells`.
fn for_each_ray(view: &View, range_cells: f64, mut visit: impl FnMut(Vec3)) {
    let count = |pixels: usize, focal: f64| {
        let extent = pixels as f64 / focal.abs().max(1e-9);
        (extent * range_cells / RAY_SPACING_CELLS).ceil().max(1.0) as usize
    };
    let columns = count(view.width, view.camera.fx);
    let rows = count(view.height, view.camera.fy);
    for row in 0..rows {
        let y_px = (row as f64 + 0.5) / rows as f64 * view.height as f64 - 0.5;
        for column in 0..columns {
            let x_px = (column as f64 + 0.5) / columns as f64 * view.width as f64 - 0.5;
            visit(view.camera.unproject(&Vec2::new(x_px, y_px)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Rotation;
    use monogrid_occupancy::Occupancy;

    #[test]
    fn sees_the_frustum_up_to_the_first_surface_and_not_behind_it() {
        let mut truth = TruthGrid::new(0.1, [-30, -30, -5], [30, 30, 50], 1 << 20).expect("small");
        let all: Vec<_> = truth.cells().map(|c| truth.global(c)).collect();
        for key in &all {
            // A plate at z = 2 that covers the right half of the view, a wall at z = 4.
            let is_plate = key[2] == 20 && key[0] >= 0;
            let is_occupied = is_plate || key[2] == 40;
            let state = if is_occupied {
                Occupancy::Occupied
            } else {
                Occupancy::Free
            };
            truth.set(*key, state);
        }
        let view = View {
            world_from_camera: Se3::new(Rotation::identity(), Vec3::new(0.05, 0.05, 0.05)),
            camera: Pinhole::new(60.0, 60.0, 39.5, 29.5),
            width: 80,
            height: 60,
        };
        let seen = cells_in_view(&truth, &[view], 6.0);
        for key in all {
            let p = Vec3::from(truth.center(key)) - view.world_from_camera.translation;
            let (u, v) = ((p.x / p.z * 60.0).abs(), (p.y / p.z * 60.0).abs());
            let is_visible = seen.state(key) != Occupancy::Unknown;
            let is_behind = key[2] > 40 || (key[2] > 20 && p.x / p.z > 0.06);
            // The rim of the frustum is a matter of half a cell.
            let margin = 60.0 * 0.1 / p.z.max(0.1);
            if p.z > 0.3 && u < 40.0 - margin && v < 30.0 - margin && !is_behind {
                let is_shadow_rim = key[2] > 20 && p.x / p.z > -0.06;
                assert!(is_visible || is_shadow_rim, "{key:?} is not seen");
            }
            if p.z < -0.1 || u > 40.0 + margin || v > 30.0 + margin || is_behind {
                assert!(!is_visible, "{key:?} is seen");
            }
        }
        assert_eq!(seen.state([10, 0, 20]), Occupancy::Occupied);
        assert_eq!(seen.state([-10, 0, 40]), Occupancy::Occupied);
    }
}
