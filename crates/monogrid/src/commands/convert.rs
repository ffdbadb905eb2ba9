//! `monogrid convert`.

use super::print_json;
use crate::cli::ConvertArgs;
use crate::failure::{CommandResult, Outcome};
use crate::mapfile::{self, MapFormat};

/// Reads a map and writes it in another format.
pub fn execute(args: &ConvertArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.output, &MapFormat::ALL)?;
    let (map, from) = mapfile::load(&args.input)?;
    mapfile::save(&map, &args.output, format)?;
    let file_bytes = std::fs::metadata(&args.output).map_or(0, |m| m.len());
    if args.json.json {
        print_json(&serde_json::json!({
            "from": from.description(),
            "to": format.description(),
            "leaves": map.leaf_count(),
            "file_bytes": file_bytes,
        }))?;
    } else {
        println!(
            "{} -> {}: {}, {:.2} MB",
            args.input.display(),
            args.output.display(),
            format.description(),
            file_bytes as f64 / 1e6
        );
        if from == MapFormat::Bt && matches!(format, MapFormat::Ot | MapFormat::Mgo) {
            println!("a .bt holds no probabilities: free and occupied cells got OctoMap's limits");
        }
    }
    Ok(Outcome::Done)
}
