//! Stanford `.ply` meshes, ascii and binary, with vertex colours.

use crate::triangle_mesh::TriangleMesh;
use monogrid_datasets::{DatasetError, open_file};
use serde::Deserialize;
use serde_ply::{DeserializeError, PlyReader, PropertyType, ScalarType};
use std::io::{BufRead, BufReader};
use std::path::Path;

#[derive(Deserialize)]
struct Vertex {
    x: f32,
    y: f32,
    z: f32,
    #[serde(default)]
    red: f32,
    #[serde(default)]
    green: f32,
    #[serde(default)]
    blue: f32,
}

#[derive(Deserialize)]
struct Face {
    #[serde(alias = "vertex_index")]
    vertex_indices: Vec<u32>,
}

/// A row of which nothing is wanted.
#[derive(Deserialize)]
struct Other {}

/// Reads the triangles (polygons become fans) and, where there are colours, the reflectance of the
/// vertices. A file without faces gives a mesh without triangles (a point cloud).
///
/// Vertices without a place (a coordinate that is not finite: what a depth camera did not measure)
/// are left out, with the faces at them; [`MeshModel::read`](super::MeshModel::read) says how many.
///
/// # Errors
/// When the file cannot be read, is not PLY, or ends early.
pub fn read_ply(path: &Path) -> Result<TriangleMesh, DatasetError> {
    read_counted(path).map(|(mesh, _)| mesh)
}

/// As [`read_ply`], and the number of vertices that were left out.
pub(super) fn read_counted(path: &Path) -> Result<(TriangleMesh, usize), DatasetError> {
    let (file, _) = open_file(path)?;
    read(BufReader::new(file))
        .map_err(|reason| DatasetError::content(path, reason, "a complete PLY file"))
}

/// The number of a vertex among those that have a place.
type Kept = Vec<Option<u32>>;

fn read(file: impl BufRead) -> Result<(TriangleMesh, usize), String> {
    let reason = |error: DeserializeError| error.0.to_string();
    let mut reader = PlyReader::from_reader(file).map_err(reason)?;
    let mut mesh = TriangleMesh::default();
    let mut kept = Kept::new();
    while let Some(element) = reader.current_element() {
        // such rows have no bytes: their number could be anything
        if element.properties.is_empty() && element.count > 0 {
            return Err(format!("element {:?} without properties", element.name));
        }
        match element.name.as_str() {
            "vertex" => {
                // colours are bytes, or fractions when of a floating type
                let colour = element.get_property("red").map(|p| &p.property_type);
                let colour_unit = colour.map(|colour| match colour {
                    PropertyType::Scalar(ScalarType::F32 | ScalarType::F64) => 255.0,
                    _ => 1.0,
                });
                let vertices: Vec<Vertex> = reader.next_element().map_err(reason)?;
                add_vertices(&vertices, colour_unit, &mut mesh, &mut kept);
            }
            "face" => {
                let faces: Vec<Face> = reader.next_element().map_err(reason)?;
                add_faces(&faces, &kept, &mut mesh)?;
            }
            _ => drop(reader.next_element::<Vec<Other>>().map_err(reason)?),
        }
    }
    let left_out = kept.len() - mesh.vertices.len();
    Ok((mesh, left_out))
}

fn add_vertices(
    vertices: &[Vertex],
    colour_unit: Option<f64>,
    mesh: &mut TriangleMesh,
    kept: &mut Kept,
) {
    for v in vertices {
        let point = [v.x, v.y, v.z];
        if !point.iter().all(|c| c.is_finite()) {
            kept.push(None);
            continue;
        }
        kept.push(u32::try_from(mesh.vertices.len()).ok());
        mesh.vertices.push(point);
        if let Some(unit) = colour_unit {
            mesh.add_colour([v.red, v.green, v.blue].map(|value| unit as f32 * value));
        }
    }
}

fn add_faces(faces: &[Face], kept: &Kept, mesh: &mut TriangleMesh) -> Result<(), String> {
    let count = kept.len();
    for (k, face) in faces.iter().enumerate() {
        let corners = &face.vertex_indices;
        if let Some(wrong) = corners.iter().find(|&&v| v as usize >= count) {
            return Err(format!("vertex {wrong} of {count} at face {k}"));
        }
        let corners: Option<Vec<u32>> = corners.iter().map(|v| kept[*v as usize]).collect();
        let Some(corners) = corners else {
            continue;
        };
        for pair in corners.windows(2).skip(1) {
            mesh.triangles.push([corners[0], pair[0], pair[1]]);
        }
    }
    Ok(())
}
