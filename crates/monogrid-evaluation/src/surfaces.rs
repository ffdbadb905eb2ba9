//! How measured points lie on the surfaces of a true map, and the similarity that brings them
//! there.
//!
//! A reference trajectory that is some centimetres off halves the score of a good map whose cells
//! are as large. Points that were measured on surfaces know better how the map lies: the similarity
//! is found that makes their distances to the nearest occupied cells smallest (Gauss-Newton on the
//! distance field of the truth, Huber's weights that become narrower), started from the poses.

use monogrid_geometry::{Sim3, Vec3, rotation_exp};
use monogrid_occupancy::{DistanceConfig, DistanceField, MapError, OccupancyMap};
use nalgebra::{SMatrix, SVector};
use serde::Serialize;

/// Points that are looked at, at most, taken evenly.
const MAX_POINTS: usize = 30_000;
/// Points farther from every surface say nothing, cells.
const REACH_CELLS: f64 = 12.0;
/// Distances at which weights begin to fall, cells, one after the other, each for some iterations.
const KERNELS_CELLS: [f64; 4] = [6.0, 3.0, 1.5, 1.0];
const ITERATIONS: usize = 8;

/// Where points lie after an alignment to the surfaces of a true map.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SurfaceAlignment {
    /// truth_from_points for points that are in the frame of the truth already, but for an error.
    #[serde(skip)]
    pub correction: Sim3,
    /// Its length, in the unit of the truth, at the centre of the points.
    pub moved: f64,
    /// Its rotation, degrees.
    pub turned_deg: f64,
    /// Its scale.
    pub scale: f64,
    /// Before.
    pub before: OnSurfaces,
    /// After.
    pub after: OnSurfaces,
}

/// How points lie on surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OnSurfaces {
    /// Median distance from the nearest occupied cell, in the unit of the truth; of points that
    /// have one within twelve cells.
    pub median: f64,
    /// Share of all points that lie in an occupied cell or next to one.
    pub within_a_cell: f64,
}

/// The similarity that brings points onto the surfaces of a true map; no points, or points far from
/// it, give the identity.
///
/// # Errors
/// A map whose distances cannot be computed.
pub fn align_to_surfaces(
    points: &[Vec3],
    truth: &OccupancyMap,
    threads: usize,
) -> Result<SurfaceAlignment, MapError> {
    let cell = truth.resolution();
    let config = DistanceConfig {
        max_distance: REACH_CELLS * cell,
        ..DistanceConfig::default()
    };
    let field = DistanceField::new(truth, config, threads)?;
    let every = points.len().div_ceil(MAX_POINTS).max(1);
    let points: Vec<Vec3> = points.iter().copied().step_by(every).collect();
    let center = points.iter().sum::<Vec3>() / points.len().max(1) as f64;
    let mut correction = Sim3::identity();
    for kernel in KERNELS_CELLS.map(|cells| cells * cell) {
        for _ in 0..ITERATIONS {
            let Some(step) = step(&points, &correction, &center, (&field, cell), kernel) else {
                break;
            };
            correction = step * correction;
        }
    }
    // surfaces that are missing in the truth can pull points away from those that are there
    let identity = Sim3::identity();
    let cost = |correction: &Sim3| cost(&points, correction, (&field, cell));
    if cost(&correction) >= cost(&identity) {
        correction = identity;
    }
    Ok(SurfaceAlignment {
        moved: (correction * center - center).norm(),
        turned_deg: correction.rotation.angle().to_degrees(),
        scale: correction.scale,
        before: on_surfaces(&points, &identity, &field, cell),
        after: on_surfaces(&points, &correction, &field, cell),
        correction,
    })
}

/// One step of Gauss-Newton around the centre of the points; `None` where they do not determine it.
fn step(
    points: &[Vec3],
    correction: &Sim3,
    center: &Vec3,
    (field, cell): (&DistanceField, f64),
    kernel: f64,
) -> Option<Sim3> {
    let mut normal = SMatrix::<f64, 7, 7>::zeros();
    let mut right = SVector::<f64, 7>::zeros();
    let middle = *correction * *center;
    for point in points {
        let at = *correction * *point;
        let Some((distance, slope)) = interpolated(field, &at, cell) else {
            continue;
        };
        let arm = at - middle;
        // change of the distance with translation, rotation and logarithm of the scale
        let [jt, jr] = [slope, arm.cross(&slope)];
        let row = SVector::from([jt.x, jt.y, jt.z, jr.x, jr.y, jr.z, arm.dot(&slope)]);
        let is_far = distance > kernel;
        let weight = if is_far { kernel / distance } else { 1.0 };
        normal += weight * row * row.transpose();
        right -= weight * distance * row;
    }
    let x = normal.cholesky()?.solve(&right);
    let rotation = rotation_exp(&Vec3::new(x[3], x[4], x[5]));
    let (scale, moved) = (x[6].exp(), Vec3::new(x[0], x[1], x[2]));
    let translation = middle + moved - scale * (rotation * middle);
    Some(Sim3::new(scale, rotation, translation))
}

/// Mean distance, at most a cell each.
fn cost(points: &[Vec3], correction: &Sim3, (field, cell): (&DistanceField, f64)) -> f64 {
    let distance = |point: &Vec3| {
        let found = interpolated(field, &(*correction * *point), cell);
        found.map_or(cell, |(distance, _)| distance.min(cell))
    };
    points.iter().map(distance).sum::<f64>() / points.len().max(1) as f64
}

/// Distance and its slope between the centres of the eight cells around a point; `None` where one
/// of them is too far from all surfaces.
fn interpolated(field: &DistanceField, at: &Vec3, cell: f64) -> Option<(f64, Vec3)> {
    let in_cells = at / cell - Vec3::repeat(0.5);
    let low = in_cells.map(f64::floor);
    let part = in_cells - low;
    let (mut distance, mut slope) = (0.0, Vec3::zeros());
    for corner in 0..8 {
        let far = Vec3::from_fn(|axis, _| f64::from(corner >> axis & 1));
        let center = (low + far + Vec3::repeat(0.5)) * cell;
        let value = field.distance(center.into())?;
        let weight = |axis: usize| match far[axis] > 0.5 {
            true => part[axis],
            false => 1.0 - part[axis],
        };
        distance += value * weight(0) * weight(1) * weight(2);
        for axis in 0..3 {
            let others = weight((axis + 1) % 3) * weight((axis + 2) % 3);
            slope[axis] += value * (2.0 * far[axis] - 1.0) * others / cell;
        }
    }
    Some((distance, slope))
}

fn on_surfaces(points: &[Vec3], correction: &Sim3, field: &DistanceField, cell: f64) -> OnSurfaces {
    let distance = |point: &Vec3| field.distance((*correction * *point).into());
    let mut distances: Vec<f64> = points.iter().filter_map(distance).collect();
    distances.sort_by(f64::total_cmp);
    let near = distances.partition_point(|distance| *distance <= 1.01 * cell);
    OnSurfaces {
        median: distances.get(distances.len() / 2).copied().unwrap_or(0.0),
        within_a_cell: near as f64 / points.len().max(1) as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Rotation;
    use monogrid_occupancy::{MapConfig, VoxelKey};

    const CELL: f64 = 0.05;

    /// The walls, the floor and a pillar of a room, as cells and as points on them.
    fn room() -> (OccupancyMap, Vec<Vec3>) {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(CELL)).unwrap();
        let mut points = Vec::new();
        for x in 0..60 {
            for y in 0..50 {
                for z in 0..40 {
                    let is_pillar = (20..24).contains(&x) && (30..35).contains(&y);
                    let is_surface = x == 0 || x == 59 || y == 0 || z == 0 || is_pillar;
                    let key = VoxelKey::new(x, y, z);
                    map.set_log_odds(key, Some(if is_surface { 2.0 } else { -1.0 }))
                        .unwrap();
                    if is_surface && (x + 3 * y + 7 * z) % 5 == 0 {
                        points.push(Vec3::from(key.center(CELL)));
                    }
                }
            }
        }
        (map, points)
    }

    #[test]
    fn points_are_brought_back_to_where_they_were_measured() {
        let (map, points) = room();
        let turn: Rotation = rotation_exp(&Vec3::new(0.01, -0.015, 0.02));
        let error = Sim3::new(1.02, turn, Vec3::new(0.08, -0.05, 0.06));
        // a fifth of them is wrong, to both sides
        let wrong = |k: usize| match k % 10 {
            0 => Vec3::new(0.0, 0.1, 0.25),
            5 => Vec3::new(0.0, -0.1, -0.25),
            _ => Vec3::zeros(),
        };
        let moved = points.iter().enumerate();
        let moved: Vec<Vec3> = moved.map(|(k, p)| error * (p + wrong(k))).collect();
        let found = align_to_surfaces(&moved, &map, 2).unwrap();
        let left = found.correction * error;
        assert!((left.scale - 1.0).abs() < 4e-3, "{}", left.scale);
        assert!(left.rotation.angle() < 4e-3, "{}", left.rotation.angle());
        let middle = Vec3::new(1.5, 1.25, 1.0);
        assert!((left * middle - middle).norm() < 0.3 * CELL);
        assert!(found.before.within_a_cell < 0.6 && found.after.within_a_cell > 0.75);
        assert!(found.after.median < found.before.median);
    }

    #[test]
    fn without_points_near_surfaces_nothing_moves() {
        let (map, _) = room();
        for points in [vec![], vec![Vec3::new(100.0, 0.0, 0.0); 10]] {
            let found = align_to_surfaces(&points, &map, 1).unwrap();
            assert!(found.moved <= 0.0 && (found.scale - 1.0).abs() <= 0.0);
            assert!(found.after.within_a_cell <= 0.0);
        }
    }
}
