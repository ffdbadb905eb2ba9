//! A lidar that turns in a room: from ranges to a map, a planner's questions, and files.
//!
//! `cargo run --release -p monogrid-occupancy --example lidar`
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use monogrid_occupancy::*;

/// A turn of a lidar of 64 rings at `x`, in a room of 8 x 6 x 3 m: points in the sensor's frame.
fn measure(x: f64) -> Vec<[f32; 3]> {
    let walls = [[-4.0 - x, 4.0 - x], [-3.0, 3.0], [-1.0, 2.0]];
    let mut points = Vec::new();
    for ring in 0..64 {
        for step in 0..1800 {
            let (azimuth, elevation) = (f64::from(step) * 0.0035, f64::from(ring - 32) * 0.0125);
            let direction = [
                azimuth.cos() * elevation.cos(),
                azimuth.sin() * elevation.cos(),
                elevation.sin(),
            ];
            let to_wall = |axis: usize| {
                let side = usize::from(direction[axis] > 0.0);
                walls[axis][side] / direction[axis]
            };
            let range = to_wall(0).min(to_wall(1)).min(to_wall(2));
            points.push(direction.map(|c| (c * range) as f32));
        }
    }
    points
}

fn main() -> Result<(), MapError> {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05))?;
    for id in 0..10 {
        let x = f64::from(id) * 0.1;
        let world_from_sensor = Similarity {
            translation: [x, 0.0, 0.0], // and its rotation, from your odometry
            ..Similarity::IDENTITY
        };
        let points = measure(x);
        // one sigma for all, or one per point
        let scan = Scan::of_points(id, world_from_sensor, &points, &[0.02]);
        integrate(&mut map, &scan, &IntegrationConfig::default(), 2)?;
    }

    let counts = map.cell_counts();
    println!(
        "{} occupied and {} free cells",
        counts.occupied, counts.free
    );
    println!(
        "wall ahead: {:?}",
        map.cast_ray([0.0; 3], [1.0, 0.0, 0.0], 10.0, UnknownCells::PassThrough)
    );

    // For a planner on another thread: a snapshot, and the distance to the nearest obstacle.
    let snapshot = Snapshot::new(&map);
    let distances = DistanceField::new(&map, DistanceConfig::default(), 2)?;
    let robot = [3.0, 0.0, 0.0];
    println!(
        "at {robot:?}: collides within 0.3 m: {}, nearest obstacle: {:?}",
        snapshot.sphere_collides(robot, 0.3, UnknownCells::PassThrough),
        distances.distance(robot)
    );

    let folder = std::env::temp_dir();
    save_atomically(&folder.join("room.ot"), |file| write_ot(&map, file))?; // for octovis, MoveIt
    save_atomically(&folder.join("room.mgo"), |file| write_mgo(&map, file))?; // exact, small
    if let Some(grid) = map.projected(-0.8, 1.0)? {
        // grid.to_pgm() for nav2
        println!("{} x {} cells seen from above", grid.width, grid.height);
    }
    println!("wrote room.ot and room.mgo to {}", folder.display());
    Ok(())
}
