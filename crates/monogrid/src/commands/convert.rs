//! `monogrid convert`.

use super::{bytes, print_json};
use crate::args::{ForceArg, JsonArg};
use crate::failure::{Classify, CommandResult, Outcome};
use crate::mapfile;
use crate::output::{Inputs, OutputFile};
use clap::Args;
use monogrid_occupancy::MapFormat;
use std::path::PathBuf;

/// `monogrid convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub input: PathBuf,
    /// File to write (.ot, .bt, .mgo, .ply or .pcd); point clouds hold the centres of occupied cells
    pub output: PathBuf,
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Reads a map and writes it in another format.
pub fn execute(args: &ConvertArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.output, &MapFormat::ALL).bad_input()?;
    let inputs = Inputs::of("the map", &args.input);
    let output = OutputFile::new(&args.output, args.force.force, &inputs)?;
    let (map, from) = mapfile::load(&args.input)?;
    let file_bytes = mapfile::save(&map, &output, format)?;
    if args.json.json {
        print_json(&serde_json::json!({
            "from": from.description(),
            "to": format.description(),
            "leaves": map.leaf_count(),
            "file_bytes": file_bytes,
        }))?;
    } else {
        println!(
            "{} -> {}: {}, {}",
            args.input.display(),
            args.output.display(),
            format.description(),
            bytes(file_bytes)
        );
        if from == MapFormat::Bt && matches!(format, MapFormat::Ot | MapFormat::Mgo) {
            println!("a .bt holds no probabilities: free and occupied cells got OctoMap's limits");
        }
    }
    Ok(Outcome::Done)
}
