//! Wavefront `.obj` with `.mtl`: positions, texture coordinates, faces, diffuse colour and texture.

use super::{MeshModel, UNKNOWN_ALBEDO, luma, textured};
use crate::scene::Material;
use monogrid_datasets::{DatasetError, read_file, read_gray};
use std::path::Path;
use tobj::{LoadError, LoadOptions, load_mtl_buf, load_obj_buf};

/// Largest mesh, and largest library of materials, that is read.
const MAX_BYTES: u64 = 1 << 32;
const MAX_LIBRARY_BYTES: u64 = 1 << 24;

const EXPECTED: &str =
    "an .obj file with faces of finite vertices, and materials, if any, that can be read";

/// Reads the mesh and the materials that it names; where the file of these is missing, it has none.
pub(super) fn read(path: &Path) -> Result<MeshModel, DatasetError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let bad = |found: String| DatasetError::content(path, found, EXPECTED);
    let file = read_file(path, MAX_BYTES)?;
    let options = LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..LoadOptions::default()
    };
    let library = |name: &Path| {
        let file = read_file(&folder.join(name), MAX_LIBRARY_BYTES);
        let file = file.map_err(|_| LoadError::OpenFileFailed)?;
        load_mtl_buf(&mut plain_text(&file).as_bytes())
    };
    let text = plain_text(&file);
    if let Some(line) = text.lines().position(has_wild_index(&text)) {
        let number = line + 1;
        return Err(bad(format!(
            "an index that leads nowhere, in line {number}"
        )));
    }
    let (parts, materials) = load_obj_buf(&mut text.as_bytes(), &options, library)
        .map_err(|error| bad(error.to_string()))?;
    let materials = match materials {
        // meshes are passed on without it, and the shape is all there
        Err(LoadError::OpenFileFailed) => Vec::new(),
        read => read.map_err(|error| bad(format!("a library of materials: {error}")))?,
    };
    let mut model = MeshModel::default();
    for part in &parts {
        add_part(&part.mesh, &mut model).map_err(|reason| bad(reason.to_owned()))?;
    }
    if model.mesh.triangles.is_empty() {
        return Err(bad("no face".to_owned()));
    }
    if model.mesh.albedo.len() != model.mesh.vertices.len() {
        model.mesh.albedo.clear();
        model.mesh.colours.clear();
    }
    if parts.iter().all(|part| part.mesh.texcoords.is_empty()) {
        model.corner_uv.clear();
    }
    let materials = materials.iter().map(|m| read_material(m, folder));
    model.materials = materials.collect::<Result<_, _>>()?;
    Ok(model)
}

/// Text of which only names and comments may be in another encoding, with `/` in its paths.
fn plain_text(file: &[u8]) -> String {
    let text = String::from_utf8_lossy(file).replace('\\', "/");
    text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned()
}

/// Says of one line after the other whether it has an index of nothing: beyond any file of this
/// length, before the first element, or none of a position. `tobj` does arithmetic with indices
/// before it checks them.
fn has_wild_index(text: &str) -> impl FnMut(&str) -> bool {
    let most = text.len() as i64;
    // positions, texture coordinates, normals so far
    let mut counts = [0_i64; 3];
    move |line| {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => counts[0] += 1,
            Some("vt") => counts[1] += 1,
            Some("vn") => counts[2] += 1,
            Some("f" | "l" | "p") => {
                return words.any(|corner| {
                    let indices = corner.split('/').zip(counts).enumerate();
                    indices.into_iter().any(|(kind, (index, count))| {
                        match index.parse::<i64>() {
                            Ok(0) => kind == 0,
                            Ok(index) => !(-count..=most).contains(&index),
                            // refused by the parser, but for one that is left out
                            Err(_) => index.is_empty() && kind == 0,
                        }
                    })
                });
            }
            _ => {}
        }
        false
    }
}

/// Adds the triangles of one material.
fn add_part(part: &tobj::Mesh, model: &mut MeshModel) -> Result<(), &'static str> {
    let values = || part.positions.iter().chain(&part.texcoords);
    if !values().chain(&part.vertex_color).all(|v| v.is_finite()) {
        return Err("a number that is not finite");
    }
    let mesh = &mut model.mesh;
    let first = mesh.vertices.len() as u32;
    mesh.vertices
        .extend_from_slice(part.positions.as_chunks().0);
    // colours at vertices are an extension: in [0, 1], as displayed
    let colours = part.vertex_color.as_chunks::<3>().0.iter();
    colours.for_each(|colour| mesh.add_colour(colour.map(|share| 255.0 * share)));
    for (k, corners) in part.indices.as_chunks::<3>().0.iter().enumerate() {
        mesh.triangles.push(corners.map(|corner| first + corner));
        let uv = std::array::from_fn(|corner| {
            let index = part.texcoord_indices.get(3 * k + corner).copied();
            let at = index.and_then(|i| part.texcoords.as_chunks::<2>().0.get(i as usize));
            // v of OBJ runs up
            at.map_or([0.0; 2], |[u, v]| [*u, 1.0 - v])
        });
        model.corner_uv.push(uv);
        model.material_of.push(part.material_id.unwrap_or(0) as u32);
    }
    Ok(())
}

fn read_material(material: &tobj::Material, folder: &Path) -> Result<Material, DatasetError> {
    if let Some(name) = &material.diffuse_texture {
        // options come before the name, which may hold blanks
        let name = match name.starts_with('-') {
            true => name.rsplit(char::is_whitespace).next().unwrap_or(name),
            false => name,
        };
        return Ok(textured(&read_gray(&folder.join(name))?));
    }
    let albedo = material.diffuse.map_or(UNKNOWN_ALBEDO, |c| {
        luma(c.map(f64::from)).clamp(0.0, 1.0) as f32
    });
    Ok(Material::plain(albedo))
}
