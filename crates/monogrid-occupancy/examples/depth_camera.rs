//! A depth camera before a wall with a hole in its measurements: from a depth image to a map.
//!
//! `cargo run --release -p monogrid-occupancy --example depth_camera`
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use monogrid_occupancy::*;

fn main() -> Result<(), MapError> {
    let (width, height, focal) = (320_u32, 240_u32, 260.0_f32);
    // Pixels with a depth; the others are simply left out. Depth cameras know their error in
    // depth z: that of 1 / z is sigma_z / z^2.
    let depth = 2.0_f32;
    let sigma = 0.01 * depth;
    let pixels: Vec<DepthPixel> = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .filter(|(x, y)| !((100..140).contains(x) && (80..120).contains(y)))
        .map(|(x, y)| DepthPixel {
            x: x as u16,
            y: y as u16,
            idepth: 1.0 / depth,
            sigma_idepth: sigma / (depth * depth),
        })
        .collect();
    let scan = Scan {
        id: 0,
        world_from_sensor: Similarity::IDENTITY, // the camera looks along its +z
        pose_sigma: PoseSigma::default(),
        data: ScanData::Depth(DepthScan {
            width,
            height,
            fx: f64::from(focal),
            fy: f64::from(focal),
            cx: f64::from(width) / 2.0 - 0.5,
            cy: f64::from(height) / 2.0 - 0.5,
            pixels: &pixels,
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
