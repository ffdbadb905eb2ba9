//! Size and speed of the map formats on one map, without the disk.
//!
//! `cargo run --release -p monogrid-occupancy --example file_speed -- MAP.ot`
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use std::error::Error;
use std::fs::File;
use std::time::Instant;

use monogrid_occupancy::*;

const BUDGET: usize = 8 << 30;
const REPEATS: usize = 3;

type Writer = fn(&OccupancyMap, &mut Vec<u8>) -> Result<(), MapError>;
type Reader = fn(&[u8]) -> Result<OccupancyMap, MapError>;

fn best<T>(mut work: impl FnMut() -> Result<T, MapError>) -> Result<(f64, T), MapError> {
    let mut least = f64::MAX;
    for _ in 1..REPEATS {
        let started = Instant::now();
        work()?;
        least = least.min(started.elapsed().as_secs_f64());
    }
    let started = Instant::now();
    let result = work()?;
    Ok((least.min(started.elapsed().as_secs_f64()), result))
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: file_speed MAP.ot")?;
    let map = read_ot(File::open(path)?, BUDGET)?;
    let formats: [(&str, Writer, Reader); 3] = [
        (".ot", |m, o| write_ot(m, o), |b| read_ot(b, BUDGET)),
        (".bt", |m, o| write_bt(m, o), |b| read_bt(b, BUDGET)),
        (".mgo", |m, o| write_mgo(m, o), |b| read_mgo(b, BUDGET)),
    ];
    for (name, write, read) in formats {
        let (write_seconds, bytes) = best(|| {
            let mut bytes = Vec::new();
            write(&map, &mut bytes)?;
            Ok(bytes)
        })?;
        let (read_seconds, again) = best(|| read(&bytes))?;
        println!(
            "{name:5} {:8.3} MB, written in {write_seconds:.3} s, read in {read_seconds:.3} s, \
             exact: {}",
            bytes.len() as f64 / 1e6,
            again == map
        );
    }
    Ok(())
}
