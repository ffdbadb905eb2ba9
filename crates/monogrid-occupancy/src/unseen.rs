//! Occupied cells that no camera can have seen.
//!
//! Depth that is too far puts surfaces behind others: behind a wall that other views show, where no ray will ever make them free. What lies
//! on no line of sight of the finished map is not known to be there.

use crate::error::MapError;
use crate::evidence::Occupancy;
use crate::integrate::parallel::for_each;
use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::query::cast::{RayHit, UnknownCells};
use crate::query::snapshot::Snapshot;
use crate::scan::{Similarity, dot};
use std::collections::BTreeMap;

/// A pinhole camera at a pose; it looks along +z.
#[derive(Clone, Copy, Debug)]
pub struct CameraView {
    /// Pose of the camera.
    pub world_from_camera: Similarity,
    /// Image width and height in pixels.
    pub size: [u32; 2],
    /// Focal lengths along x and y in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels.
    pub principal: [f64; 2],
}

/// What [`OccupancyMap::forget_unseen`] takes for unseen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnseenLimits {
    /// A cell is seen past an occupied cell at most this far before it: surfaces are thick, and lines of sight graze them. In cells.
    pub max_behind: f64,
    /// Or this far, as a share of the range: so far may the two be off against each other.
    pub max_behind_share: f64,
    /// Along an axis, a cell this near to a free one that is seen past no occupied cell at all is its surface. In cells.
    pub max_beside: i32,
}

impl OccupancyMap {
    /// Makes the occupied cells unknown that views have in their images and none can see in this map; how many these are.
    /// Cells in no image stay.
    ///
    /// # Errors
    /// The memory budget is exhausted.
    pub fn forget_unseen(
        &mut self,
        views: &[CameraView],
        limits: &UnseenLimits,
        threads: usize,
    ) -> Result<usize, MapError> {
        let snapshot = Snapshot::new(self);
        let sights: Vec<Sight> = views.iter().map(Sight::new).collect();
        let bricks = self.bricks().into_iter();
        let mut bricks: Vec<(BrickKey, Vec<VoxelKey>)> =
            bricks.map(|brick| (brick, Vec::new())).collect();
        let map = &*self;
        for_each(&mut bricks, threads, |_, (brick, unseen)| {
            let [first, last] = [0, BRICK_CELLS - 1].map(|index| brick.cell(index));
            unseen.extend(map.keys_in_key_box(first, last, Occupancy::Occupied));
            if !unseen.is_empty() {
                let mut looking = Looking::at(*brick, &snapshot, &sights, limits);
                unseen.retain(|key| looking.is_unseen(*key));
            }
        });
        let mut count = 0;
        for key in bricks.into_iter().flat_map(|(_, unseen)| unseen) {
            self.set_log_odds(key, None)?;
            count += 1;
        }
        Ok(count)
    }
}

/// A view, as it is asked whether it shows something.
struct Sight {
    view: CameraView,
    camera_from_world: Similarity,
    /// Normals of the planes through the camera and the edges of its image, inwards, in its axes.
    edges: [[f64; 3]; 4],
}

impl Sight {
    fn new(view: &CameraView) -> Self {
        // slopes of the left, right, upper and lower edge
        let slope = |i: usize, edge: f64| (edge - view.principal[i]) / view.focal[i];
        let low = [0, 1].map(|i| slope(i, -0.5));
        let high = [0, 1].map(|i| slope(i, f64::from(view.size[i]) - 0.5));
        let edges = [
            [1.0, 0.0, -low[0]],
            [-1.0, 0.0, high[0]],
            [0.0, 1.0, -low[1]],
            [0.0, -1.0, high[1]],
        ];
        let of_length_one = |normal: [f64; 3]| {
            let length = dot(normal, normal).sqrt();
            normal.map(|c| c / length)
        };
        Self {
            view: *view,
            camera_from_world: view.world_from_camera.inverse(),
            edges: edges.map(of_length_one),
        }
    }

    /// Whether some of a ball is in the image; a ball without size: whether a point is.
    fn shows(&self, center: [f64; 3], radius: f64) -> bool {
        let center = self.camera_from_world.transform(center);
        let radius = radius * self.camera_from_world.scale;
        center[2] > -radius && self.edges.iter().all(|edge| dot(*edge, center) >= -radius)
    }

    /// Whether nothing is occupied on the line of sight to a point, but for its last stretch, as long as is said for its range.
    fn sees(&self, point: [f64; 3], last: impl Fn(f64) -> f64, snapshot: &Snapshot) -> bool {
        let origin = self.view.world_from_camera.translation;
        let way: [f64; 3] = std::array::from_fn(|i| point[i] - origin[i]);
        let range = dot(way, way).sqrt();
        let clear = range - last(range);
        clear <= 0.0
            || !matches!(
                snapshot.cast_ray(origin, way, clear, UnknownCells::PassThrough),
                RayHit::Occupied { .. }
            )
    }
}

/// The views that have a brick and what is beside it in their images.
struct Looking<'a> {
    snapshot: &'a Snapshot,
    limits: &'a UnseenLimits,
    /// The one that saw the last cell comes first: it will see the next.
    sights: Vec<&'a Sight>,
    /// Whether free cells are seen that were asked for.
    free: BTreeMap<VoxelKey, bool>,
}

impl<'a> Looking<'a> {
    fn at(
        brick: BrickKey,
        snapshot: &'a Snapshot,
        sights: &'a [Sight],
        limits: &'a UnseenLimits,
    ) -> Self {
        let half = 0.5 * f64::from(BRICK_EDGE);
        let cell = snapshot.resolution();
        let first = brick.first_cell().to_array();
        let center = first.map(|c| (f64::from(c) + half) * cell);
        let radius = (3_f64.sqrt() * half + f64::from(limits.max_beside)) * cell;
        let near = sights.iter().filter(|sight| sight.shows(center, radius));
        Self {
            snapshot,
            limits,
            sights: near.collect(),
            free: BTreeMap::new(),
        }
    }

    /// Whether an occupied cell of the brick is in an image and none of the views can see it.
    fn is_unseen(&mut self, key: VoxelKey) -> bool {
        let center = key.center(self.snapshot.resolution());
        !self.is_seen(key, true)
            && self.sights.iter().any(|sight| sight.shows(center, 0.0))
            && !self.is_beside_seen(key)
    }

    /// Whether a view sees a cell past nothing that is occupied, or as a surface: past what may be its own thickness.
    fn is_seen(&mut self, key: VoxelKey, as_surface: bool) -> bool {
        let cell = self.snapshot.resolution();
        let center = key.center(cell);
        let limits = self.limits;
        let last = |range: f64| {
            let behind = (limits.max_behind * cell).max(limits.max_behind_share * range);
            if as_surface { behind } else { 0.0 }
        };
        let sees = |sight: &&Sight| sight.sees(center, last, self.snapshot);
        let mut sights = self.sights.iter();
        let seeing = sights.position(|sight| sight.shows(center, 0.0) && sees(sight));
        if let Some(index) = seeing {
            self.sights[..=index].rotate_right(1);
        }
        seeing.is_some()
    }

    /// Whether a free cell beside this one, along an axis, is seen past nothing occupied.
    fn is_beside_seen(&mut self, key: VoxelKey) -> bool {
        let reach = 1..=self.limits.max_beside;
        reach.into_iter().any(|steps| {
            let ways = (0..3).flat_map(|axis| [(axis, steps), (axis, -steps)]);
            let mut beside = ways.map(|(axis, by)| key.along(axis, by));
            beside.any(|key| self.is_free_and_seen(key))
        })
    }

    fn is_free_and_seen(&mut self, key: VoxelKey) -> bool {
        if self.snapshot.state_of(key) != Occupancy::Free {
            return false;
        }
        if let Some(known) = self.free.get(&key) {
            return *known;
        }
        let is_seen = self.is_seen(key, false);
        self.free.insert(key, is_seen);
        is_seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::MapConfig;

    /// At the origin of cells of 0.1, looking along z; 90 degrees wide.
    fn view_at(x: f64) -> CameraView {
        CameraView {
            world_from_camera: Similarity {
                translation: [x, 0.05, 0.05],
                ..Similarity::IDENTITY
            },
            size: [101, 101],
            focal: [50.0, 50.0],
            principal: [50.0, 50.0],
        }
    }

    const CELL: f64 = 0.1;

    /// A wall of 41 x 41 cells at z = 20, in free space from z = 0 on.
    fn wall() -> OccupancyMap {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(CELL)).unwrap();
        for x in -20..=20 {
            for y in -20..=20 {
                for z in 0..20 {
                    map.set_log_odds(VoxelKey::new(x, y, z), Some(-1.0))
                        .unwrap();
                }
                map.set_log_odds(VoxelKey::new(x, y, 20), Some(2.0))
                    .unwrap();
            }
        }
        map
    }

    const LIMITS: UnseenLimits = UnseenLimits {
        max_behind: 5.0,
        max_behind_share: 0.04,
        max_beside: 4,
    };

    /// How many of these cells, added to the wall, are forgotten.
    fn forgotten(cells: &[[i32; 3]], views: &[CameraView]) -> usize {
        let mut map = wall();
        for cell in cells {
            map.set_log_odds(VoxelKey::from_array(*cell), Some(2.0))
                .unwrap();
        }
        map.forget_unseen(views, &LIMITS, 2).unwrap();
        let corner = VoxelKey::new(-20, -20, 20);
        assert_eq!(map.state_of(corner), Occupancy::Occupied);
        let state = |cell: &&[i32; 3]| map.state_of(VoxelKey::from_array(**cell));
        let unknown = cells.iter().filter(|c| state(c) == Occupancy::Unknown);
        unknown.count()
    }

    #[test]
    fn what_lies_far_behind_a_wall_is_forgotten_and_the_thickness_of_walls_is_not() {
        let views = [view_at(0.05)];
        let behind = |z: i32| forgotten(&[[0, 0, z]], &views);
        assert_eq!([21, 22, 24, 25, 27, 30].map(behind), [0, 0, 0, 1, 1, 1]);
        // far away walls are as thick as what is off there
        let off = UnseenLimits {
            max_behind_share: 0.3,
            ..LIMITS
        };
        let mut map = wall();
        let key = VoxelKey::new(0, 0, 27);
        map.set_log_odds(key, Some(2.0)).unwrap();
        assert_eq!(map.forget_unseen(&views, &off, 1).unwrap(), 0);
        // neither is what stands before it, or what is in no image
        assert_eq!(
            forgotten(&[[3, 3, 10], [200, 0, 30], [0, 0, -30]], &views),
            0
        );
        // a cell that one camera cannot see, another one can
        assert_eq!(forgotten(&[[15, 0, 30]], &views), 1);
        assert_eq!(forgotten(&[[15, 0, 30]], &[view_at(0.05), view_at(3.5)]), 0);
    }

    #[test]
    fn a_surface_that_is_only_grazed_stays_beside_free_space_that_is_seen() {
        // a floor below the camera: far cells of it lie behind near ones, whatever their thickness
        let floor: Vec<[i32; 3]> = (3..19).flat_map(|z| [[0, -1, z], [0, -2, z]]).collect();
        assert_eq!(forgotten(&floor, &[view_at(0.05)]), 0);
        let mut map = wall();
        for cell in &floor {
            map.set_log_odds(VoxelKey::from_array(*cell), Some(2.0))
                .unwrap();
        }
        let alone = UnseenLimits {
            max_beside: 0,
            ..LIMITS
        };
        let views = [view_at(0.05)];
        map.forget_unseen(&views, &alone, 1).unwrap();
        let far = VoxelKey::new(0, -1, 18);
        assert_eq!(map.state_of(far), Occupancy::Unknown);
    }

    #[test]
    fn bricks_and_the_order_of_views_leave_out_nothing_that_each_cell_alone_finds() {
        let mut map = wall();
        let mut state = 5_u64;
        let mut below = |n: i32| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            (state >> 33) as i32 % n
        };
        for _ in 0..3000 {
            let key = VoxelKey::new(below(60) - 30, below(60) - 30, below(50) - 5);
            map.set_log_odds(key, Some(2.0)).unwrap();
        }
        let views = [view_at(0.05), view_at(-1.5), view_at(2.5)];
        let sees = |view: &CameraView, key: VoxelKey, past: f64| {
            let origin = view.world_from_camera.translation;
            let center = key.center(CELL);
            let [x, y, z]: [f64; 3] = std::array::from_fn(|i| center[i] - origin[i]);
            let is_shown = z > 0.0 && (x / z).abs() <= 1.01 && (y / z).abs() <= 1.01;
            let range = (x * x + y * y + z * z).sqrt() - past * CELL;
            let cast = |range| map.cast_ray(origin, [x, y, z], range, UnknownCells::PassThrough);
            (
                is_shown,
                is_shown && (range <= 0.0 || cast(range) == RayHit::Nothing),
            )
        };
        let is_unseen = |key: VoxelKey| {
            let any = |key, past| views.iter().any(|view| sees(view, key, past).1);
            let is_shown = views.iter().any(|view| sees(view, key, 0.0).0);
            let beside = (1..=4).any(|steps| {
                let mut ways = (0..3).flat_map(|axis| [(axis, steps), (axis, -steps)]);
                ways.any(|(axis, by)| {
                    let free = key.along(axis, by);
                    map.state_of(free) == Occupancy::Free && any(free, 0.0)
                })
            });
            is_shown && !any(key, 5.0) && !beside
        };
        let occupied = map.cells().filter(|cell| cell.state == Occupancy::Occupied);
        let expected: Vec<VoxelKey> = occupied.map(|c| c.key).filter(|k| is_unseen(*k)).collect();
        assert!(expected.len() > 100, "{}", expected.len());
        let mut cleared = map.clone();
        let count = cleared.forget_unseen(&views, &LIMITS, 2).unwrap();
        assert_eq!(count, expected.len());
        for key in expected {
            assert_eq!(cleared.state_of(key), Occupancy::Unknown);
        }
    }
}
