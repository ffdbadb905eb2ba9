//! Wavefront `.obj` with `.mtl`: positions, texture coordinates, faces, diffuse colour and texture.

use super::{MeshModel, UNKNOWN_ALBEDO, albedo_of_grey, textured};
use crate::synth::scene::Material;
use crate::text::{data_lines, numbers, read_text};
use crate::{DatasetError, read_gray};
use std::collections::BTreeMap;
use std::path::Path;

/// Reads the mesh and the materials that it names.
pub(super) fn read(path: &Path) -> Result<MeshModel, DatasetError> {
    let text = read_text(path)?;
    let mut reader = ObjReader::default();
    for (number, line) in data_lines(&text) {
        reader
            .line(line, path)?
            .map_err(|expected| DatasetError::line(path, number, line, expected))?;
    }
    let mut model = reader.model;
    if model.mesh.triangles.is_empty() {
        return Err(DatasetError::content(
            path,
            "no face",
            "at least one triangle",
        ));
    }
    if !reader.has_vertex_colours {
        model.mesh.albedo.clear();
    } else if model.materials.is_empty() {
        model.materials.push(Material::plain(1.0));
    }
    if reader.uv.is_empty() {
        model.corner_uv.clear();
    }
    if model.materials.is_empty() {
        model.materials.push(Material::plain(UNKNOWN_ALBEDO));
    }
    Ok(model)
}

#[derive(Default)]
struct ObjReader {
    model: MeshModel,
    uv: Vec<[f32; 2]>,
    names: BTreeMap<String, u32>,
    current: u32,
    has_vertex_colours: bool,
}

impl ObjReader {
    /// One statement. The inner error says what was expected.
    fn line(&mut self, line: &str, path: &Path) -> Result<Result<(), &'static str>, DatasetError> {
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        Ok(match keyword {
            "v" => self.vertex(rest),
            "vt" => self.texture_coordinate(rest),
            "f" => self.face(rest),
            "usemtl" => {
                self.current = self.material_id(rest);
                Ok(())
            }
            "mtllib" => {
                let folder = path.parent().unwrap_or(Path::new("."));
                self.library(&folder.join(rest.replace('\\', "/")))?;
                Ok(())
            }
            // normals, groups, smoothing, lines: of no use here
            _ => Ok(()),
        })
    }

    fn vertex(&mut self, rest: &str) -> Result<(), &'static str> {
        let values = numbers(rest).unwrap_or_default();
        if values.len() < 3 || values.iter().any(|v| !v.is_finite()) {
            return Err("v and three finite numbers");
        }
        self.model
            .mesh
            .vertices
            .push([values[0] as f32, values[1] as f32, values[2] as f32]);
        let colour = values.get(3..6);
        self.has_vertex_colours |= colour.is_some();
        // colours at vertices are an extension: in [0, 1], as displayed
        let albedo = colour.map_or(UNKNOWN_ALBEDO, |c| {
            albedo_of_grey(255.0 * luma([c[0], c[1], c[2]]))
        });
        self.model.mesh.albedo.push(albedo);
        Ok(())
    }

    fn texture_coordinate(&mut self, rest: &str) -> Result<(), &'static str> {
        let values = numbers(rest).unwrap_or_default();
        if values.is_empty() || values.iter().any(|v| !v.is_finite()) {
            return Err("vt and two finite numbers");
        }
        let v = values.get(1).copied().unwrap_or(0.0);
        self.uv.push([values[0] as f32, 1.0 - v as f32]);
        Ok(())
    }

    /// Polygon as a fan of triangles.
    fn face(&mut self, rest: &str) -> Result<(), &'static str> {
        const EXPECTED: &str = "f and at least three indices of vertices that were given before";
        let mut corners = Vec::new();
        for word in rest.split_whitespace() {
            let mut parts = word.split('/');
            let count = self.model.mesh.vertices.len();
            let vertex = parts.next().and_then(|t| index(t, count)).ok_or(EXPECTED)?;
            let uv = match parts.next() {
                None | Some("") => [0.0; 2],
                Some(text) => {
                    let k = index(text, self.uv.len())
                        .ok_or("indices of texture coordinates that were given before")?;
                    self.uv[k as usize]
                }
            };
            corners.push((vertex, uv));
        }
        if corners.len() < 3 {
            return Err(EXPECTED);
        }
        for k in 1..corners.len() - 1 {
            let [a, b, c] = [corners[0], corners[k], corners[k + 1]];
            self.model.mesh.triangles.push([a.0, b.0, c.0]);
            self.model.corner_uv.push([a.1, b.1, c.1]);
            self.model.material_of.push(self.current);
        }
        Ok(())
    }

    fn material_id(&mut self, name: &str) -> u32 {
        if let Some(id) = self.names.get(name) {
            return *id;
        }
        // used before or without its library
        let id = self.model.materials.len() as u32;
        self.model.materials.push(Material::plain(UNKNOWN_ALBEDO));
        self.names.insert(name.to_owned(), id);
        id
    }

    fn library(&mut self, path: &Path) -> Result<(), DatasetError> {
        let text = read_text(path)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut current = None;
        for (number, line) in data_lines(&text) {
            let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            let rest = rest.trim();
            match (keyword, current) {
                ("newmtl", _) => current = Some(self.material_id(rest) as usize),
                ("Kd", Some(id)) => {
                    let c = numbers(rest).unwrap_or_default();
                    if c.len() < 3 || c.iter().any(|v| !v.is_finite()) {
                        return Err(DatasetError::line(
                            path,
                            number,
                            line,
                            "Kd and three numbers",
                        ));
                    }
                    let material: &mut Material = &mut self.model.materials[id];
                    if material.texture.is_none() {
                        material.albedo = luma([c[0], c[1], c[2]]).clamp(0.0, 1.0);
                    }
                }
                ("map_Kd", Some(id)) => {
                    // options come before the name, which may hold blanks
                    let name = if rest.starts_with('-') {
                        rest.rsplit(char::is_whitespace).next().unwrap_or(rest)
                    } else {
                        rest
                    };
                    let image = read_gray(&folder.join(name.replace('\\', "/")))?;
                    self.model.materials[id] = textured(&image);
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// ITU-601 luma.
fn luma([r, g, b]: [f64; 3]) -> f32 {
    (0.299 * r + 0.587 * g + 0.114 * b) as f32
}

/// Index counted from 1, or backwards from -1.
fn index(text: &str, count: usize) -> Option<u32> {
    let k: i64 = text.parse().ok()?;
    let count = count as i64;
    let zero_based = if k > 0 { k - 1 } else { count + k };
    (k != 0 && (0..count).contains(&zero_based)).then_some(zero_based as u32)
}
