//! How long Rust takes to insert a scan: `insert_points POINTS REPETITIONS`, points as x, y, z in
//! `f32`, little endian. Prints the shortest time in seconds and the numbers of cells.
//! `insert_points.py` compares Python with it.
#![allow(clippy::print_stdout, reason = "it talks to its caller")]

use monogrid::occupancy::*;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [_, points, repetitions] = &std::env::args().collect::<Vec<_>>()[..] else {
        return Err("expected POINTS REPETITIONS".into());
    };
    let bytes = std::fs::read(points)?;
    let numbers: Vec<f32> = bytes
        .as_chunks()
        .0
        .iter()
        .map(|b| f32::from_le_bytes(*b))
        .collect();
    let points = numbers.as_chunks().0;
    let threads = std::thread::available_parallelism()?.get();
    let mut shortest = f64::INFINITY;
    let mut counts = None;
    for _ in 0..repetitions.parse()? {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05))?;
        let begin = Instant::now();
        let scan = Scan::of_points(0, Similarity::IDENTITY, points, &[0.025]);
        integrate(&mut map, &scan, &IntegrationConfig::default(), threads)?;
        shortest = shortest.min(begin.elapsed().as_secs_f64());
        counts = Some(map.cell_counts());
    }
    let counts = counts.ok_or("no repetitions")?;
    println!("{shortest} {} {}", counts.occupied, counts.free);
    Ok(())
}
