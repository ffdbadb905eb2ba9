//! The surface of a map as a mesh in colour: made from the map and the keyframes, written as PLY,
//! glTF and what other programs read.

mod colour;
mod files;
mod texture;
mod usdz;

pub use colour::{CellColours, ColouredMesh, ColouredScan};
pub use files::MeshFormat;
pub(crate) use files::{DXF_END, dxf_head, extent};
pub use texture::{SurfaceView, Texture};
