//! Maps that are too large for a message: the part around the camera.

use monogrid_occupancy::{MapError, OccupancyMap};

/// A part is smaller than the one before by this much.
const SHRINK: f64 = 0.8;

/// What `make` makes of a map, or, where that does not fit, of the largest part around `center` that does, with its
/// radius. Lengths are those of the map.
///
/// # Errors
/// What `make` cannot do.
pub fn part_that_fits<M>(
    map: &OccupancyMap,
    center: [f64; 3],
    make: impl Fn(&OccupancyMap) -> Result<M, MapError>,
    fits: impl Fn(&M) -> bool,
) -> Result<(M, Option<f64>), MapError> {
    let whole = make(map)?;
    if fits(&whole) {
        return Ok((whole, None));
    }
    let mut radius = map.bounds().map_or(0.0, |(low, high)| {
        let sides = (0..3).map(|axis| (high[axis] - low[axis]).powi(2));
        sides.sum::<f64>().sqrt()
    });
    // a part without a cell fits always
    while radius > map.resolution() {
        radius *= SHRINK;
        let part = make(&map.within(center, radius)?)?;
        if fits(&part) {
            return Ok((part, Some(radius)));
        }
    }
    let nothing = OccupancyMap::new(map.config().clone())?;
    Ok((make(&nothing)?, Some(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{MapConfig, VoxelKey};

    #[test]
    fn the_largest_part_that_fits_is_taken() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(1.0)).unwrap();
        for x in 0..1000 {
            map.set_log_odds(VoxelKey::new(x, 0, 0), Some(1.0)).unwrap();
        }
        let cells = |map: &OccupancyMap| Ok(map.cells().map(|cell| cell.key.x).collect::<Vec<_>>());
        let (all, radius) = part_that_fits(&map, [0.0; 3], cells, |c| c.len() <= 1000).unwrap();
        assert_eq!((all.len(), radius), (1000, None));
        let (part, radius) =
            part_that_fits(&map, [500.5, 0.5, 0.5], cells, |c| c.len() <= 100).unwrap();
        assert!((80..=100).contains(&part.len()), "{}", part.len());
        assert!(part.contains(&500) && radius.unwrap() > 40.0);
        let none = part_that_fits(&map, [500.5, 0.5, 0.5], cells, Vec::is_empty).unwrap();
        assert!(none.0.is_empty());
    }
}
