//! `monogrid mesh`: the surface of a map as triangles.

use super::print_json;
use crate::args::{ForceArg, JsonArg};
use crate::failure::{Classify, CommandResult, Outcome};
use crate::mapfile;
use crate::output::{Inputs, OutputFile};
use crate::surface::{CellColours, MeshFormat};
use clap::Args;
use monogrid_slam::mapping::MeshConfig;
use std::path::PathBuf;

/// `monogrid mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub map: PathBuf,
    /// Mesh to write: .ply or .glb
    pub output: PathBuf,
    /// Pieces of the surface with fewer faces of cells are left out; 0 keeps all
    #[arg(long, value_name = "N", default_value_t = MeshConfig::default().min_faces)]
    pub min_faces: usize,
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Reads a map and writes its surface, in grey: a map knows no colours.
pub fn execute(args: &MeshArgs) -> CommandResult {
    let format = MeshFormat::from_name(&args.output)?;
    let inputs = Inputs::of("the map", &args.map);
    let output = OutputFile::new(&args.output, args.force.force, &inputs)?;
    let (map, _) = mapfile::load(&args.map)?;
    let config = MeshConfig {
        min_faces: args.min_faces,
        ..MeshConfig::default()
    };
    let mesh = CellColours::unknown().mesh(&map, &config);
    let mesh = mesh.while_running("the surface cannot be made")?;
    output.write_with(|out| format.write(&mesh, "the unit of the map", out))?;
    let (vertices, triangles) = (mesh.surface.vertices.len(), mesh.surface.triangles.len());
    if args.json.json {
        print_json(&serde_json::json!({ "vertices": vertices, "triangles": triangles }))?;
    } else {
        println!(
            "{}: {vertices} vertices, {triangles} triangles",
            args.output.display()
        );
    }
    Ok(Outcome::Done)
}
