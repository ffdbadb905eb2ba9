//! The surface of a map as a mesh in colour: made from the map and the keyframes, written as PLY
//! and glTF.

mod colour;
mod files;

pub use colour::{CellColours, ColouredMesh, ColouredScan};
pub use files::MeshFormat;
