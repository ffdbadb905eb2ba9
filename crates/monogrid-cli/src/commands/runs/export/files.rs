//! The surface, the cloud and the map of a run as single files.

use crate::commands::runs::{CLOUD, unreadable};
use monogrid_app::mapfile;
use monogrid_app::output::{MAP, OutputFile};
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_datasets::open_file;
use monogrid_occupancy::{SurfaceMesh, VoxelKey, write_colour_ot};
use monogrid_report::surface::{ColouredMesh, MeshFormat, Texture};
use monogrid_worlds::read_picture;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_ply::PlyReader;
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

/// The surface of a run.
pub const MESH: &str = "mesh.ply";
/// The surface of a run, with the picture on it where it has one.
pub const MODEL: &str = "mesh.glb";
/// Its occupied cells with their colours.
pub const CELLS: &str = "cells.ply";
/// Steps of coordinates in LAS, map units.
const LAS_STEP: f64 = 1e-4;

#[derive(Deserialize)]
struct MeshVertex {
    x: f32,
    y: f32,
    z: f32,
    nx: f32,
    ny: f32,
    nz: f32,
    red: u8,
    green: u8,
    blue: u8,
}

#[derive(Deserialize)]
struct Face {
    vertex_indices: Vec<u32>,
}

#[derive(Deserialize)]
struct CloudPoint {
    x: f32,
    y: f32,
    z: f32,
    red: u8,
    green: u8,
    blue: u8,
}

#[derive(Deserialize)]
struct Cell {
    x: f32,
    y: f32,
    z: f32,
    // these are missing where the source is grey
    #[serde(default)]
    red: Option<u8>,
    #[serde(default)]
    green: Option<u8>,
    #[serde(default)]
    blue: Option<u8>,
}

/// The rows of one element of a PLY file of the run, which follows those that were read before.
fn rows<T: DeserializeOwned>(
    reader: &mut PlyReader<BufReader<File>>,
    path: &Path,
) -> Result<Vec<T>, Failure> {
    reader.next_element().map_err(|error| {
        Failure::input(format!(
            "{} is damaged or of another version: {}",
            path.display(),
            error.0
        ))
    })
}

fn open(path: &Path) -> Result<PlyReader<BufReader<File>>, Failure> {
    let (file, _) = open_file(path).map_err(|error| unreadable(&error))?;
    let reader = PlyReader::from_reader(BufReader::new(file));
    reader.map_err(|error| Failure::input(format!("{}: {}", path.display(), error.0)))
}

/// The picture on a surface of so many triangles, where the run has one.
fn picture_of(run: &Path, triangles: usize) -> Option<Texture> {
    let (image, corners) = read_picture(&run.join(MODEL)).ok()??;
    let first = corners.first_chunk()?;
    let texture = Texture::with_first(image, *first)?;
    (corners.len() == 2 * triangles).then_some(texture)
}

/// Writes the surface in another format, with the files that belong to it beside it; how many
/// triangles it has.
pub fn write_mesh(
    run: &Path,
    output: &OutputFile,
    (format, beside): (MeshFormat, impl Fn(&Path) -> Result<OutputFile, Failure>),
) -> Result<usize, Failure> {
    let path = run.join(MESH);
    let mut reader = open(&path)?;
    let vertices: Vec<MeshVertex> = rows(&mut reader, &path)?;
    let faces: Vec<Face> = rows(&mut reader, &path)?;
    let triangle = |face: &Face| <[u32; 3]>::try_from(&face.vertex_indices[..]).ok();
    let is_inside = |corners: &[u32; 3]| corners.iter().all(|k| (*k as usize) < vertices.len());
    let triangles: Vec<[u32; 3]> = faces.iter().filter_map(triangle).collect();
    if !triangles.iter().all(is_inside) {
        return Err(Failure::input(format!(
            "{} is damaged: a face names a vertex that is not there",
            path.display()
        )));
    }
    let count = triangles.len();
    let mesh = ColouredMesh {
        texture: picture_of(run, count),
        colours: vertices.iter().map(|v| [v.red, v.green, v.blue]).collect(),
        surface: SurfaceMesh {
            vertices: vertices.iter().map(|v| [v.x, v.y, v.z]).collect(),
            normals: vertices.iter().map(|v| [v.nx, v.ny, v.nz]).collect(),
            cubes: Vec::new(),
            triangles,
        },
    };
    let path = output.path();
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let files = format.beside(&mesh, &name).into_iter();
    let files = files.map(|(ending, bytes)| Ok((beside(&path.with_extension(ending))?, bytes)));
    for (file, bytes) in files.collect::<Result<Vec<_>, Failure>>()? {
        file.write(&bytes)?;
    }
    output.write_with(|out| Ok(format.write(&mesh, ("the unit of the run", &name), out)?))?;
    Ok(count)
}

/// Writes the map as OctoMap's `ColorOcTree`; how many of its cells have a colour.
pub fn write_ot(run: &Path, output: &OutputFile) -> Result<usize, Failure> {
    let path = run.join(CELLS);
    let cells: Vec<Cell> = rows(&mut open(&path)?, &path)?;
    let (map, _) = mapfile::load(&run.join(MAP))?;
    let inv_resolution = 1.0 / map.resolution();
    let coloured = cells.iter().filter_map(|cell| {
        let key = VoxelKey::from_point([cell.x, cell.y, cell.z].map(f64::from), inv_resolution)?;
        Some((key, [cell.red?, cell.green?, cell.blue?]))
    });
    let coloured: Vec<(VoxelKey, [u8; 3])> = coloured.collect();
    if coloured.is_empty() {
        return Err(Failure::input(format!(
            "{} holds no colours: the source is grey, or no cell is occupied; {MAP} is the map",
            path.display()
        )));
    }
    let count = coloured.len();
    output.write_with(|mut out| Ok(write_colour_ot(&map, coloured, &mut out)?))?;
    Ok(count)
}

/// Writes the cloud as LAS 1.2 with colours; how many points it has.
pub fn write_las(run: &Path, output: &OutputFile) -> Result<usize, Failure> {
    let path = run.join(CLOUD);
    let points: Vec<CloudPoint> = rows(&mut open(&path)?, &path)?;
    let bytes = las_of(&points).while_running("the cloud cannot be written as LAS")?;
    output.write_with(|out| Ok(out.write_all(&bytes)?))?;
    Ok(points.len())
}

fn las_of(points: &[CloudPoint]) -> Result<Vec<u8>, las::Error> {
    let mut builder = las::Builder::from((1, 2));
    builder.point_format = las::point::Format::new(2)?;
    builder.generating_software = "monogrid".to_owned();
    let axis = las::Transform {
        scale: LAS_STEP,
        offset: 0.0,
    };
    builder.transforms = las::Vector {
        x: axis,
        y: axis,
        z: axis,
    };
    // the same run gives the same bytes
    builder.date = None;
    let mut writer = las::Writer::new(Cursor::new(Vec::new()), builder.into_header()?)?;
    // colours have 16 bits
    let wide = |value: u8| u16::from(value) * 257;
    for point in points {
        writer.write_point(las::Point {
            x: point.x.into(),
            y: point.y.into(),
            z: point.z.into(),
            color: Some(las::Color {
                red: wide(point.red),
                green: wide(point.green),
                blue: wide(point.blue),
            }),
            ..las::Point::default()
        })?;
    }
    Ok(writer.into_inner()?.into_inner())
}
