//! A depth camera before a wall with a hole in its measurements: from a depth image to a map.
//!
//! `cargo run --release -p monogrid-occupancy --example depth_camera`
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use monogrid_occupancy::*;

fn main() -> Result<(), MapError> {
    let (width, height, focal) = (320_u32, 240_u32, 260.0_f32);
    // Depths along the optical axis, row by row; 0 where nothing was measured.
    let depth = 2.0_f32;
    let mut depths = vec![depth; (width * height) as usize];
    for row in 80..120 {
        let first = row * width as usize;
        depths[first + 100..first + 140].fill(0.0);
    }
    let scan = Scan {
        id: 0,
        world_from_sensor: Similarity::IDENTITY, // the camera looks along its +z
        pose_sigma: PoseSigma::default(),
        data: ScanData::Image(DepthImage {
            width,
            height,
            fx: f64::from(focal),
            fy: f64::from(focal),
            cx: f64::from(width) / 2.0 - 0.5,
            cy: f64::from(height) / 2.0 - 0.5,
            depths: &depths,
            sigmas: &[0.01 * depth],
        }),
    };
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.04))?;
    integrate(&mut map, &scan, &IntegrationConfig::default(), 2)?;

    for (what, point) in [
        ("between camera and wall", [0.4, 0.3, 1.0]),
        ("on the wall", [0.4, 0.3, 2.0]),
        ("behind the wall", [0.4, 0.3, 2.6]),
        ("behind the hole", [-0.3, -0.15, 1.5]),
    ] {
        println!("{what}: {:?} {:?}", map.state(point), map.log_odds(point));
    }
    Ok(())
}
