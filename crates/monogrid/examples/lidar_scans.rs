//! Scans of a lidar with their poses: `cargo run --example lidar_scans -- turns.scans map.ot`
#![allow(clippy::print_stdout, reason = "it talks to its user")]
use monogrid::{datasets::ScansReader, occupancy::*};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [_, scans, out] = &std::env::args().collect::<Vec<_>>()[..] else {
        return Err("expected SCANS OUT.ot".into());
    };
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05))?;
    for (id, scan) in (0..).zip(ScansReader::open(scans.as_ref())?) {
        let scan = scan?; // points in the frame of the sensor, metres
        let points: Vec<_> = scan.points.iter().map(|p| p.point_in_sensor).collect();
        let pose = Similarity::from_rigid(&scan.world_from_sensor); // from your odometry
        let scan = Scan::of_points(id, pose, &points, &[0.02]);
        integrate(&mut map, &scan, &IntegrationConfig::default(), 2)?;
    }
    println!("{:?}", map.cell_counts());
    save_atomically(out.as_ref(), |file| write_ot(&map, file))?;
    Ok(())
}
