//! Speed of queries on a map, one thread, and the same questions written to a file for
//! `tests/octomap/query.cpp`.
//!
//! `cargo run --release -p monogrid-occupancy --example query_speed -- MAP.ot [QUESTIONS.bin]`
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::time::Instant;

use monogrid_occupancy::*;

const POINTS: usize = 2_000_000;
const RAYS: usize = 50_000;
const MAX_RANGE: f64 = 10.0;
const REPEATS: usize = 3;

/// A small deterministic generator of numbers in [0, 1).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn in_box(&mut self, (low, high): ([f64; 3], [f64; 3])) -> [f64; 3] {
        std::array::from_fn(|i| low[i] + (high[i] - low[i]) * self.unit())
    }

    fn direction(&mut self) -> [f64; 3] {
        let z = 2.0 * self.unit() - 1.0;
        let angle = std::f64::consts::TAU * self.unit();
        let r = (1.0 - z * z).sqrt();
        [r * angle.cos(), r * angle.sin(), z]
    }
}

/// Seconds of CPU of the only thread of this process.
fn cpu_seconds() -> Result<f64, Box<dyn Error>> {
    let stat = std::fs::read_to_string("/proc/self/schedstat")?;
    Ok(stat
        .split(' ')
        .next()
        .ok_or("empty schedstat")?
        .parse::<f64>()?
        * 1e-9)
}

/// Best CPU time of some runs: the others measure what else the machine was doing.
fn best<T>(mut work: impl FnMut() -> T) -> Result<(f64, T), Box<dyn Error>> {
    let mut best = f64::MAX;
    loop {
        let mut last = None;
        for _ in 0..REPEATS {
            let started = cpu_seconds()?;
            last = Some(std::hint::black_box(work()));
            best = best.min(cpu_seconds()? - started);
        }
        if let Some(result) = last {
            return Ok((best, result));
        }
    }
}

fn count(states: impl Iterator<Item = Occupancy>) -> [usize; 3] {
    let mut counts = [0; 3];
    states.for_each(|s| counts[s as usize] += 1);
    counts
}

/// What there is to ask.
struct Questions {
    points: Vec<[f64; 3]>,
    /// Origin and direction.
    rays: Vec<[[f64; 3]; 2]>,
}

/// The same questions to a map or to a snapshot of it.
macro_rules! measure {
    ($name:literal, $map:expr, $questions:expr) => {{
        let (map, Questions { points, rays }) = ($map, $questions);
        let per_second = |count: usize, seconds: f64| count as f64 / seconds * 1e-6;
        let (seconds, counts) = best(|| count(points.iter().map(|p| map.state(*p))))?;
        println!(
            "{:9}state    {:8.2} M/s  unknown, free, occupied {counts:?}",
            $name,
            per_second(points.len(), seconds)
        );
        let mut states = vec![Occupancy::Unknown; points.len()];
        let (seconds, ()) = best(|| map.states(points, &mut states))?;
        println!(
            "{:9}states   {:8.2} M/s  {:?}",
            $name,
            per_second(points.len(), seconds),
            count(states.iter().copied())
        );
        for (ends, unknown) in [
            ("through unknown", UnknownCells::PassThrough),
            ("to unknown", UnknownCells::Stop),
        ] {
            let (seconds, (hits, ranges)) = best(|| {
                let (mut hits, mut ranges) = (0, 0.0);
                for [origin, direction] in rays {
                    let hit = map.cast_ray(*origin, *direction, MAX_RANGE, unknown);
                    if let RayHit::Occupied { range, .. } = hit {
                        hits += 1;
                        ranges += range;
                    }
                }
                (hits, ranges)
            })?;
            println!(
                "{:9}cast_ray {:8.3} M/s  {ends}: {hits} of {} hit, mean range {:.3}",
                $name,
                per_second(rays.len(), seconds),
                rays.len(),
                ranges / f64::from(hits.max(1))
            );
        }
    }};
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments
        .next()
        .ok_or("usage: query_speed MAP.ot [QUESTIONS.bin]")?;
    let started = Instant::now();
    let map = read_ot(File::open(&path)?, 8 << 30)?;
    println!(
        "read {path}: {:.2} s, cells of {}",
        started.elapsed().as_secs_f64(),
        map.resolution()
    );
    let bounds = map.bounds().ok_or("the map is empty")?;
    let mut random = Random(1);
    let points: Vec<[f64; 3]> = (0..POINTS).map(|_| random.in_box(bounds)).collect();
    let rays: Vec<[[f64; 3]; 2]> = points
        .iter()
        .filter(|p| map.state(**p) == Occupancy::Free)
        .take(RAYS)
        .map(|p| [*p, random.direction()])
        .collect();
    if let Some(path) = arguments.next() {
        let mut bytes = Vec::new();
        for count in [points.len(), rays.len()] {
            bytes.extend((count as u64).to_le_bytes());
        }
        let numbers = points.iter().chain(rays.iter().flatten()).flatten();
        numbers.for_each(|v| bytes.extend(v.to_le_bytes()));
        File::create(path)?.write_all(&bytes)?;
    }

    let questions = Questions { points, rays };
    measure!("map", &map, &questions);
    let unpacked = map.bytes_in_memory();
    let mut packed = map.clone();
    packed.pack(1);
    println!(
        "packed {:.1} MB, before {:.1} MB",
        packed.bytes_in_memory() as f64 / 1e6,
        unpacked as f64 / 1e6
    );
    measure!("packed", &packed, &questions);
    let (seconds, snapshot) = best(|| Snapshot::new(&map))?;
    println!(
        "snapshot made in {:.3} s, {:.1} MB (the map {:.1} MB)",
        seconds,
        snapshot.bytes_in_memory() as f64 / 1e6,
        map.bytes_in_memory() as f64 / 1e6
    );
    measure!("snapshot", &snapshot, &questions);
    measure_distances(&map, &questions.points)
}

/// A field up to 30 cells, made anew and following one changed cell, and its queries.
fn measure_distances(map: &OccupancyMap, points: &[[f64; 3]]) -> Result<(), Box<dyn Error>> {
    let config = DistanceConfig {
        max_distance: 30.5 * map.resolution(),
        ..DistanceConfig::default()
    };
    let (seconds, field) = best(|| DistanceField::new(map, config, 1))?;
    let mut field = field?;
    println!(
        "distances up to {:.2}: made in {seconds:.3} s, {:.1} MB",
        config.max_distance,
        field.bytes_in_memory() as f64 / 1e6
    );
    let (seconds, near) = best(|| points.iter().filter_map(|p| field.distance(*p)).count())?;
    println!(
        "distance   {:8.2} M/s  {near} of {} within reach",
        points.len() as f64 / seconds * 1e-6,
        points.len()
    );
    let mut map = map.clone();
    let free = points.iter().find(|p| map.state(**p) == Occupancy::Free);
    let key = free.and_then(|p| map.key(*p)).ok_or("no free cell")?;
    // Every update makes an obstacle or removes it.
    let mut log_odds = -1.0;
    let (seconds, bricks) = best(|| -> Result<usize, MapError> {
        log_odds = -log_odds;
        map.set_log_odds(key, Some(log_odds))?;
        Ok(field.update(&map, 1))
    })?;
    println!(
        "update after one cell: {:.2} ms, {} bricks",
        seconds * 1e3,
        bricks?
    );
    Ok(())
}
