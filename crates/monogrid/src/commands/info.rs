//! `monogrid info`.

mod submaps;

use super::{bytes, print_json};
use crate::args::JsonArg;
use crate::failure::{CommandResult, Outcome};
use crate::mapfile;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use submaps::Submaps;

/// `monogrid info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Map (.ot, .bt or .mgo), a submap (.mgs), or submaps (submaps.json, or the folder of them)
    pub map: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

#[derive(Serialize)]
struct Info {
    format: &'static str,
    resolution: f64,
    leaves: usize,
    cells_occupied: u64,
    cells_free: u64,
    bounds_min: Option<[f64; 3]>,
    bounds_max: Option<[f64; 3]>,
    bytes_in_memory: usize,
    file_bytes: u64,
}

/// Prints facts about a map, a submap or all submaps of a run.
pub fn execute(args: &InfoArgs) -> CommandResult {
    if let Some(submaps) = Submaps::at(&args.map)? {
        submaps.tell(&args.map, args.json.json)?;
        return Ok(Outcome::Done);
    }
    let (map, format) = mapfile::load(&args.map)?;
    let counts = map.cell_counts();
    let bounds = map.bounds();
    let info = Info {
        format: format.description(),
        resolution: map.resolution(),
        leaves: map.leaf_count(),
        cells_occupied: counts.occupied,
        cells_free: counts.free,
        bounds_min: bounds.map(|b| b.0),
        bounds_max: bounds.map(|b| b.1),
        bytes_in_memory: map.bytes_in_memory(),
        file_bytes: std::fs::metadata(&args.map).map_or(0, |m| m.len()),
    };
    if args.json.json {
        print_json(&info)?;
        return Ok(Outcome::Done);
    }
    println!("{}: {}", args.map.display(), info.format);
    println!(
        "resolution  {} (maps hold no unit: lengths are metres only where the scale was known)",
        info.resolution
    );
    println!("leaves      {}", info.leaves);
    println!(
        "cells       {} occupied, {} free",
        info.cells_occupied, info.cells_free
    );
    if let Some((low, high)) = bounds {
        let size: [f64; 3] = std::array::from_fn(|i| high[i] - low[i]);
        println!(
            "extent      {:.3} x {:.3} x {:.3}",
            size[0], size[1], size[2]
        );
        println!(
            "            from ({:.3}, {:.3}, {:.3}) to ({:.3}, {:.3}, {:.3})",
            low[0], low[1], low[2], high[0], high[1], high[2]
        );
    } else {
        println!("extent      the map is empty");
    }
    println!(
        "memory      {}, file {}",
        bytes(info.bytes_in_memory as u64),
        bytes(info.file_bytes)
    );
    Ok(Outcome::Done)
}
