//! The map at one moment, in metres, as it is published and saved.

use monogrid_geometry::Se3;
use monogrid_mapping::navigation_band;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_occupancy::{MapError, Occupancy, OccupancyMap, Projection};
use std::sync::Arc;

/// Sides of the grid are multiples of so many cells: a map that grows a little is sent as a change.
const GRID_STEP: usize = 64;

/// What the map is seen with.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// The newest image that the map knows of.
    pub stamp: Time,
    /// Metres of a unit of the map as it was made.
    pub metres_per_unit: f64,
    /// Heights over the base that matter, m; `None` where they follow from the map.
    pub band_over_base: Option<[f64; 2]>,
    /// How far the origin of the map is above where the base was first, m.
    pub origin_over_base: f64,
    /// Where the camera was: map_from_camera, m.
    pub path: &'a [(Time, Se3)],
}

/// A map to publish or save.
#[derive(Clone, Debug)]
pub struct Shown {
    /// The newest image that the map knows of.
    pub stamp: Time,
    /// The cells; lengths are metres.
    pub map: OccupancyMap,
    /// Seen from above; `None` where nothing is known at the heights that matter.
    pub grid: Option<Projection>,
    /// These heights in the map, m.
    pub band: [f64; 2],
    /// Where the camera is, m.
    pub camera: [f64; 3],
    /// Where it was: map_from_camera, m.
    pub path: Vec<(Time, Se3)>,
    /// The map that has the poses of the time, in units, and metres of these.
    large: Option<(Arc<OccupancyMap>, f64)>,
}

impl Shown {
    /// A map whose lengths are in units.
    ///
    /// # Errors
    /// A scale that makes cells of no size, or a map that is too large to be seen from above.
    pub fn new(map: &OccupancyMap, seen: &Seen) -> Result<Self, MapError> {
        let map = map.rescaled(seen.metres_per_unit)?;
        let band = band_in_map(&map, seen);
        let grid = map.projected(band[0], band[1])?;
        let camera = seen.path.last();
        Ok(Self {
            stamp: seen.stamp,
            grid: grid.map(|grid| grid.aligned(GRID_STEP)),
            band,
            camera: camera.map_or([0.0; 3], |(_, pose)| pose.translation.into()),
            path: seen.path.to_vec(),
            large: None,
            map,
        })
    }

    /// Adds the map that has the poses of the time.
    #[must_use]
    pub fn with_large(mut self, large: &Arc<OccupancyMap>, metres_per_unit: f64) -> Self {
        self.large = Some((Arc::clone(large), metres_per_unit));
        self
    }

    /// The map that has the poses of the time, in metres; without one it is empty.
    ///
    /// # Errors
    /// A scale that makes cells of no size.
    pub fn large(&self) -> Result<OccupancyMap, MapError> {
        match &self.large {
            Some((large, metres_per_unit)) => large.rescaled(*metres_per_unit),
            None => OccupancyMap::new(self.map.config().clone()),
        }
    }
}

/// The heights that matter.
fn band_in_map(map: &OccupancyMap, seen: &Seen) -> [f64; 2] {
    if let Some(band) = seen.band_over_base {
        return band.map(|height| height - seen.origin_over_base);
    }
    let occupied = map.cells().filter(|cell| cell.state == Occupancy::Occupied);
    let heights = occupied.map(|cell| cell.key.center(map.resolution())[2]);
    let mut heights: Vec<f64> = heights.collect();
    let path = seen.path.iter();
    let mut cameras: Vec<f64> = path.map(|(_, pose)| pose.translation.z).collect();
    if cameras.is_empty() {
        cameras.push(0.0);
    }
    navigation_band(&mut heights, &cameras, false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{MapConfig, VoxelKey};

    /// A floor 1 unit below the camera, something at its height, something above.
    fn room() -> OccupancyMap {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
        for x in 0..50 {
            map.set_log_odds(VoxelKey::new(x, 0, -11), Some(1.0))
                .unwrap();
        }
        map.set_log_odds(VoxelKey::new(7, 3, 0), Some(1.0)).unwrap();
        map.set_log_odds(VoxelKey::new(9, 5, 40), Some(1.0))
            .unwrap();
        map
    }

    fn seen<'a>(path: &'a [(Time, Se3)]) -> Seen<'a> {
        Seen {
            stamp: Time { sec: 3, nanosec: 4 },
            metres_per_unit: 2.0,
            band_over_base: None,
            origin_over_base: 0.5,
            path,
        }
    }

    fn obstacles(shown: &Shown) -> Vec<[f64; 2]> {
        let grid = shown.grid.as_ref().unwrap();
        let columns = grid.columns.iter().enumerate();
        let occupied = columns.filter(|(_, state)| **state == Occupancy::Occupied);
        let corner = |k: usize| [k % grid.width, k / grid.width];
        let place = |k: usize| {
            let [x, y] = corner(k).map(|index| index as f64 * grid.resolution);
            [x + grid.origin[0], y + grid.origin[1]].map(|v| (v * 1e6).round() / 1e6)
        };
        occupied.map(|(k, _)| place(k)).collect()
    }

    #[test]
    fn floor_and_ceiling_are_no_obstacles() {
        let path = [(Time::default(), Se3::identity())];
        let shown = Shown::new(&room(), &seen(&path)).unwrap();
        assert_eq!(shown.map.resolution(), 0.2);
        assert_eq!(shown.stamp.sec, 3);
        assert_eq!(obstacles(&shown), [[1.4, 0.6]]);
        let grid = shown.grid.as_ref().unwrap();
        assert_eq!((grid.width % 64, grid.height % 64), (0, 0));
    }

    #[test]
    fn heights_that_were_given_are_over_the_base() {
        // from 0.2 m below the camera to 9 m above it
        let given = Seen {
            band_over_base: Some([0.3, 9.5]),
            ..seen(&[])
        };
        let shown = Shown::new(&room(), &given).unwrap();
        assert_eq!(shown.band, [-0.2, 9.0]);
        assert_eq!(obstacles(&shown), [[1.4, 0.6], [1.8, 1.0]]);
        assert_eq!(shown.camera, [0.0; 3]);
    }
}
