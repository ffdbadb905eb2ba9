//! Meshes as files: binary little-endian PLY, glTF 2.0 in its binary form (`.glb`), Wavefront OBJ,
//! binary STL, DXF and USDZ.

use super::{ColouredMesh, usdz};
use crate::ReportError;
use monogrid_geometry::nalgebra::Vector3;
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;

/// Formats that meshes are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// PLY with normals and colours.
    Ply,
    /// Binary glTF with normals and colours, y up as its readers expect.
    Glb,
    /// Wavefront OBJ with normals, and a picture beside it ([`MeshFormat::beside`]) or colours
    /// behind the coordinates of a vertex, as most readers take them.
    Obj,
    /// Binary STL: triangles alone, without colour.
    Stl,
    /// DXF of AutoCAD's release 12, which every program of this kind reads: triangles as faces,
    /// without colour.
    Dxf,
    /// USD in an archive, with normals and colours, y up as its readers expect.
    Usdz,
}

impl MeshFormat {
    /// The format that a file name asks for.
    pub fn from_name(path: &Path) -> Result<Self, ReportError> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("ply") => Ok(Self::Ply),
            Some("glb") => Ok(Self::Glb),
            Some("obj") => Ok(Self::Obj),
            Some("stl") => Ok(Self::Stl),
            Some("dxf") => Ok(Self::Dxf),
            Some("usdz") => Ok(Self::Usdz),
            _ => Err(ReportError::MeshFormat {
                path: path.to_owned(),
            }),
        }
    }

    /// Endings of the files that belong to one of this format, and their bytes; `name` is that of
    /// all of them without its ending.
    pub fn beside(self, mesh: &ColouredMesh, name: &str) -> Vec<(&'static str, Vec<u8>)> {
        match (self, &mesh.texture) {
            (Self::Obj, Some(texture)) => vec![
                ("mtl", material(name).into_bytes()),
                ("jpg", texture.jpeg()),
            ],
            _ => Vec::new(),
        }
    }

    /// Writes a mesh whose lengths are in `unit` into a file of this name without its ending.
    pub fn write(
        self,
        mesh: &ColouredMesh,
        (unit, name): (&str, &str),
        out: &mut dyn Write,
    ) -> io::Result<()> {
        match self {
            Self::Ply => write_ply(mesh, unit, out),
            Self::Glb => write_glb(mesh, unit, out),
            Self::Obj => write_obj(mesh, (unit, name), out),
            Self::Stl => write_stl(mesh, unit, out),
            Self::Dxf => write_dxf(mesh, unit, out),
            Self::Usdz => usdz::write(mesh, unit, out),
        }
    }
}

fn write_ply(mesh: &ColouredMesh, unit: &str, out: &mut dyn Write) -> io::Result<()> {
    let surface = &mesh.surface;
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment lengths in {unit}\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        surface.vertices.len(),
        surface.triangles.len()
    )?;
    let places = surface.vertices.iter().zip(&surface.normals);
    for ((vertex, normal), colour) in places.zip(&mesh.colours) {
        for values in [vertex, normal] {
            out.write_all(values.map(f32::to_le_bytes).as_flattened())?;
        }
        out.write_all(colour)?;
    }
    for triangle in &surface.triangles {
        out.write_all(&[3])?;
        out.write_all(triangle.map(u32::to_le_bytes).as_flattened())?;
    }
    Ok(())
}

/// The material that shows a picture of this name.
fn material(name: &str) -> String {
    format!("newmtl surface\nKa 1 1 1\nKd 1 1 1\nillum 0\nmap_Kd {name}.jpg\n")
}

fn write_obj(
    mesh: &ColouredMesh,
    (unit, name): (&str, &str),
    out: &mut dyn Write,
) -> io::Result<()> {
    let surface = &mesh.surface;
    writeln!(out, "# lengths in {unit}")?;
    match mesh.texture {
        Some(_) => {
            writeln!(out, "mtllib {name}.mtl\nusemtl surface")?;
            for [x, y, z] in &surface.vertices {
                writeln!(out, "v {x} {y} {z}")?;
            }
        }
        None => {
            for ([x, y, z], colour) in surface.vertices.iter().zip(&mesh.colours) {
                let [red, green, blue] = colour.map(|value| f32::from(value) / 255.0);
                writeln!(out, "v {x} {y} {z} {red:.4} {green:.4} {blue:.4}")?;
            }
        }
    }
    for [x, y, z] in &surface.normals {
        writeln!(out, "vn {x:.5} {y:.5} {z:.5}")?;
    }
    // vertices and places on the picture are counted from one
    let triangles = surface.triangles.iter();
    let triangles = triangles.map(|corners| corners.map(|index| index + 1));
    let Some(texture) = &mesh.texture else {
        for [a, b, c] in triangles {
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
        return Ok(());
    };
    for [u, v] in (0..surface.triangles.len() / 2).flat_map(|face| texture.corners(face)) {
        // from below
        writeln!(out, "vt {u:.6} {:.6}", 1.0 - v)?;
    }
    for (k, [a, b, c]) in triangles.enumerate() {
        let [i, j, l] = FACE[k % 2].map(|corner| k / 2 * 4 + corner + 1);
        writeln!(out, "f {a}/{i}/{a} {b}/{j}/{b} {c}/{l}/{c}")?;
    }
    Ok(())
}

/// Corners of the two triangles of a face.
pub(super) const FACE: [[usize; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

/// Bytes before the triangles of an STL file, which say nothing to a program.
const STL_HEADER: usize = 80;

fn write_stl(mesh: &ColouredMesh, unit: &str, out: &mut dyn Write) -> io::Result<()> {
    let surface = &mesh.surface;
    // a header that begins with "solid" would be that of a text file
    let mut header = format!("monogrid, lengths in {unit}").into_bytes();
    header.resize(STL_HEADER, b' ');
    let count = u32::try_from(surface.triangles.len()).map_err(io::Error::other)?;
    out.write_all(&header)?;
    out.write_all(&count.to_le_bytes())?;
    for triangle in &surface.triangles {
        let corners = triangle.map(|index| surface.vertices[index as usize]);
        for values in [normal_of(&corners)].iter().chain(&corners) {
            out.write_all(values.map(f32::to_le_bytes).as_flattened())?;
        }
        out.write_all(&[0, 0])?;
    }
    Ok(())
}

/// Faces of three corners, in groups of a code and a value: 8 is the layer, and the coordinates of
/// corner k are 10 + k, 20 + k, 30 + k. A fourth corner that is the third makes a triangle.
fn write_dxf(mesh: &ColouredMesh, unit: &str, out: &mut dyn Write) -> io::Result<()> {
    let surface = &mesh.surface;
    out.write_all(dxf_head(unit).as_bytes())?;
    for [a, b, c] in &surface.triangles {
        write!(out, "0\n3DFACE\n8\nsurface\n")?;
        for (corner, index) in [a, b, c, c].into_iter().enumerate() {
            let [x, y, z] = surface.vertices[*index as usize];
            write!(out, "1{corner}\n{x}\n2{corner}\n{y}\n3{corner}\n{z}\n")?;
        }
    }
    out.write_all(DXF_END.as_bytes())
}

/// What stands before the entities of a DXF file of release 12, and after them.
pub(crate) fn dxf_head(unit: &str) -> String {
    format!(
        "999\nmonogrid, lengths in {unit}\n0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n0\n\
         ENDSEC\n0\nSECTION\n2\nENTITIES\n"
    )
}
pub(crate) const DXF_END: &str = "0\nENDSEC\n0\nEOF\n";

/// The unit normal of a triangle by the right-hand rule; 0 where it has no area.
fn normal_of(corners: &[[f32; 3]; 3]) -> [f32; 3] {
    let [a, b, c] = corners.map(Vector3::from);
    let normal = (b - a).cross(&(c - a)).try_normalize(0.0);
    normal.unwrap_or_default().into()
}

/// Magic number, version, and the kinds of the two chunks of a `.glb` (glTF 2.0 specification,
/// section 4).
const GLB_MAGIC: [u8; 4] = *b"glTF";
const GLB_VERSION: u32 = 2;
const JSON_CHUNK: [u8; 4] = *b"JSON";
const BINARY_CHUNK: [u8; 4] = *b"BIN\0";

/// Types of components in glTF.
const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;

/// The bytes of a mesh in glTF.
struct GlbParts {
    /// Places, normals, colours or places on the picture, indices, and the picture, if any.
    parts: Vec<Vec<u8>>,
    num_vertices: usize,
}

impl GlbParts {
    /// Vertices with colours, or, with a picture, four vertices for each face.
    fn of(mesh: &ColouredMesh) -> Self {
        let surface = &mesh.surface;
        let floats = |values: &mut dyn Iterator<Item = [f32; 3]>| -> Vec<u8> {
            values
                .flat_map(|v| v.map(f32::to_le_bytes))
                .flatten()
                .collect()
        };
        let Some(texture) = &mesh.texture else {
            let indices = surface.triangles.iter().flatten();
            return Self {
                parts: vec![
                    floats(&mut surface.vertices.iter().copied()),
                    floats(&mut surface.normals.iter().copied()),
                    mesh.colours.iter().flat_map(linear_colour).collect(),
                    indices.flat_map(|index| index.to_le_bytes()).collect(),
                ],
                num_vertices: surface.vertices.len(),
            };
        };
        let faces = || {
            let pairs = surface.triangles.as_chunks::<2>().0.iter();
            pairs.flat_map(|[[a, b, c], [_, _, d]]| [a, b, c, d].map(|i| *i as usize))
        };
        let num_faces = surface.triangles.len() / 2;
        let places = (0..num_faces).flat_map(|face| texture.corners(face));
        let places = places
            .flatten()
            .map(|share| (share * 65_535.0).round() as u16);
        let corners = (0..num_faces).flat_map(|face| {
            FACE.into_iter()
                .flatten()
                .map(move |k| (4 * face + k) as u32)
        });
        let mut picture = texture.jpeg();
        picture.resize(picture.len().next_multiple_of(4), 0);
        Self {
            parts: vec![
                floats(&mut faces().map(|i| surface.vertices[i])),
                floats(&mut faces().map(|i| surface.normals.get(i).copied().unwrap_or_default())),
                places.flat_map(u16::to_le_bytes).collect(),
                corners.flat_map(u32::to_le_bytes).collect(),
                picture,
            ],
            num_vertices: 4 * num_faces,
        }
    }
}

fn write_glb(mesh: &ColouredMesh, unit: &str, out: &mut dyn Write) -> io::Result<()> {
    let glb = GlbParts::of(mesh);
    let mut description = serde_json::to_vec(&description(mesh, unit, &glb))?;
    // chunks are multiples of four bytes; JSON is filled with spaces
    description.resize(description.len().next_multiple_of(4), b' ');
    let binary: usize = glb.parts.iter().map(Vec::len).sum();
    let total = 12 + 8 + description.len() + 8 + binary;
    let number = |length: usize| {
        let length = u32::try_from(length).map_err(io::Error::other)?;
        Ok::<_, io::Error>(length.to_le_bytes())
    };
    out.write_all(&GLB_MAGIC)?;
    out.write_all(&GLB_VERSION.to_le_bytes())?;
    out.write_all(&number(total)?)?;
    out.write_all(&number(description.len())?)?;
    out.write_all(&JSON_CHUNK)?;
    out.write_all(&description)?;
    out.write_all(&number(binary)?)?;
    out.write_all(&BINARY_CHUNK)?;
    for part in &glb.parts {
        out.write_all(part)?;
    }
    Ok(())
}

/// The scene: one node that turns z up to y up, with one mesh. What was filmed holds its light
/// already: a picture is shown as it is.
fn description(mesh: &ColouredMesh, unit: &str, glb: &GlbParts) -> Value {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    let surface = &mesh.surface;
    let extras = json!({ "unit": unit });
    let asset = json!({ "version": "2.0", "generator": "monogrid", "extras": extras });
    if surface.triangles.is_empty() {
        // neither meshes nor buffers may be empty
        return json!({ "asset": asset });
    }
    let [low, high] = extent(&surface.vertices);
    let mut offset = 0;
    let targets = [34962, 34962, 34962, 34963].into_iter().map(Value::from);
    let views = glb.parts.iter().zip(targets.map(Some).chain([None]));
    let views = views.map(|(part, target)| {
        offset += part.len();
        let start = offset - part.len();
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": part.len() });
        if let Some(target) = target {
            view["target"] = target;
        }
        view
    });
    let views: Vec<Value> = views.collect();
    let count = glb.num_vertices;
    let (third, kind) = match mesh.texture {
        Some(_) => ("TEXCOORD_0", "VEC2"),
        None => ("COLOR_0", "VEC4"),
    };
    let mut scene = json!({
        "asset": asset,
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "rotation": [-HALF, 0.0, 0.0, HALF] }],
        "meshes": [{ "primitives": [{
            "attributes": { "POSITION": 0, "NORMAL": 1, third: 2 },
            "indices": 3,
            "material": 0,
        }] }],
        "materials": [{
            "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 },
            "doubleSided": true,
        }],
        "buffers": [{ "byteLength": offset }],
        "bufferViews": views,
        "accessors": [
            { "bufferView": 0, "componentType": FLOAT, "count": count, "type": "VEC3",
              "min": low, "max": high },
            { "bufferView": 1, "componentType": FLOAT, "count": count, "type": "VEC3" },
            { "bufferView": 2, "componentType": UNSIGNED_SHORT, "normalized": true, "count": count,
              "type": kind },
            { "bufferView": 3, "componentType": UNSIGNED_INT, "count": 3 * surface.triangles.len(),
              "type": "SCALAR" },
        ],
    });
    if mesh.texture.is_some() {
        add_picture(&mut scene);
    }
    scene
}

/// The picture, which is the fifth part, and the material that shows it.
fn add_picture(scene: &mut Value) {
    const LINEAR: u32 = 9729;
    scene["images"] = json!([{ "bufferView": 4, "mimeType": "image/jpeg" }]);
    scene["samplers"] = json!([{ "magFilter": LINEAR, "minFilter": LINEAR }]);
    scene["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    let material = &mut scene["materials"][0];
    material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    material["extensions"] = json!({ UNLIT: {} });
    scene["extensionsUsed"] = json!([UNLIT]);
}

/// The extension of glTF for what is shown as it is.
const UNLIT: &str = "KHR_materials_unlit";

/// Colours of vertices are linear in glTF: red, green, blue and an opaque alpha in 16 bits each.
fn linear_colour(srgb: &[u8; 3]) -> [u8; 8] {
    let mut bytes = [255; 8];
    for (two, value) in bytes.chunks_exact_mut(2).zip(srgb) {
        two.copy_from_slice(&((linear(*value) * 65535.0).round() as u16).to_le_bytes());
    }
    bytes
}

/// The corners of the box around points; infinite, and the wrong way round, where there are none.
pub(crate) fn extent(points: &[[f32; 3]]) -> [[f32; 3]; 2] {
    let corner = |limit: f32, of: fn(f32, f32) -> f32| {
        points.iter().fold([limit; 3], |corner, point| {
            [0, 1, 2].map(|axis| of(corner[axis], point[axis]))
        })
    };
    [
        corner(f32::INFINITY, f32::min),
        corner(f32::NEG_INFINITY, f32::max),
    ]
}

/// The light of a value of sRGB, from 0 to 1.
pub(super) fn linear(srgb: u8) -> f64 {
    let value = f64::from(srgb) / 255.0;
    match value <= 0.04045 {
        true => value / 12.92,
        false => ((value + 0.055) / 1.055).powf(2.4),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colours::ColourImage;
    use crate::surface::Texture;
    use monogrid_occupancy::{SurfaceMesh, VoxelKey};

    fn triangle() -> ColouredMesh {
        ColouredMesh {
            texture: None,
            surface: SurfaceMesh {
                vertices: vec![[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, -3.0, 1.0]],
                normals: vec![[0.0, 0.0, 1.0]; 3],
                cubes: vec![VoxelKey::new(0, 0, 0); 3],
                triangles: vec![[0, 1, 2]],
            },
            colours: vec![[255, 0, 188], [9, 9, 9], [1, 2, 3]],
        }
    }

    fn written(format: MeshFormat, mesh: &ColouredMesh) -> Vec<u8> {
        let mut bytes = Vec::new();
        format.write(mesh, ("m", "room"), &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn a_glb_is_what_the_specification_says() {
        let glb = written(MeshFormat::Glb, &triangle());
        let number = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(
            (&glb[..4], number(4), number(8)),
            (b"glTF".as_slice(), 2, glb.len())
        );
        let length = number(12);
        assert_eq!((length % 4, &glb[16..20]), (0, b"JSON".as_slice()));
        let json: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
        assert_eq!(json["accessors"][0]["min"], json!([0.0, -3.0, 1.0]));
        assert_eq!(json["accessors"][0]["max"], json!([2.0, 0.0, 1.0]));
        let binary = 20 + length + 8;
        assert_eq!(number(20 + length), glb.len() - binary);
        let view = |k: usize| {
            let of = |name| json["bufferViews"][k][name].as_u64().unwrap() as usize;
            &glb[binary + of("byteOffset")..][..of("byteLength")]
        };
        assert_eq!(view(0)[12..16], 2.0f32.to_le_bytes());
        assert_eq!(view(3), [0, 1, 2].map(u32::to_le_bytes).as_flattened());
        // 188 of sRGB is half of the light
        let half = u16::from_le_bytes([view(2)[4], view(2)[5]]);
        assert!(half.abs_diff(32768) < 400, "{half}");
        assert_eq!(view(2)[..2], [255, 255]);
        let empty = ColouredMesh {
            texture: None,
            surface: SurfaceMesh::default(),
            colours: Vec::new(),
        };
        assert!(written(MeshFormat::Glb, &empty).len() < 200);
    }

    #[test]
    fn an_obj_counts_vertices_from_one_and_has_colours() {
        let obj = String::from_utf8(written(MeshFormat::Obj, &triangle())).unwrap();
        let lines: Vec<&str> = obj.lines().collect();
        assert_eq!(lines[1], "v 0 0 1 1.0000 0.0000 0.7373");
        assert_eq!(lines[4], "vn 0.00000 0.00000 1.00000");
        assert_eq!(lines[7..], ["f 1//1 2//2 3//3"]);
    }

    #[test]
    fn an_obj_with_a_picture_names_its_files_and_the_corners_of_blocks() {
        let mut mesh = triangle();
        mesh.surface.vertices.push([2.0, -3.0, 1.0]);
        mesh.surface.normals.push([0.0, 0.0, 1.0]);
        mesh.surface.triangles = vec![[0, 1, 3], [0, 3, 2]];
        mesh.texture = Some(Texture {
            image: ColourImage::filled(8, 8, [9; 3]),
            block: 8,
            columns: 1,
        });
        let obj = String::from_utf8(written(MeshFormat::Obj, &mesh)).unwrap();
        let lines: Vec<&str> = obj.lines().collect();
        assert_eq!(
            lines[1..4],
            ["mtllib room.mtl", "usemtl surface", "v 0 0 1"]
        );
        // half a pixel from the upper left corner
        assert_eq!(lines[11], "vt 0.062500 0.937500");
        assert_eq!(lines[15..], ["f 1/1/1 2/2/2 4/3/4", "f 1/1/1 4/3/4 3/4/3"]);
        let beside = MeshFormat::Obj.beside(&mesh, "room");
        let names: Vec<_> = beside.iter().map(|(ending, _)| *ending).collect();
        assert_eq!(names, ["mtl", "jpg"]);
        assert!(beside[0].1.ends_with(b"map_Kd room.jpg\n"));
    }

    #[test]
    fn an_stl_has_normals_that_follow_from_the_corners() {
        let stl = written(MeshFormat::Stl, &triangle());
        assert_eq!(stl.len(), 80 + 4 + 50);
        assert!(!stl.starts_with(b"solid"));
        assert_eq!(stl[80..84], 1u32.to_le_bytes());
        let number = |at: usize| f32::from_le_bytes(stl[at..at + 4].try_into().unwrap());
        let numbers: Vec<f32> = (84..132).step_by(4).map(number).collect();
        // the corners go clockwise as seen from above
        assert_eq!(numbers[..3], [0.0, 0.0, -1.0]);
        assert_eq!(numbers[6..9], [2.0, 0.0, 1.0]);
    }

    #[test]
    fn a_dxf_has_a_face_for_each_triangle() {
        let dxf = String::from_utf8(written(MeshFormat::Dxf, &triangle())).unwrap();
        let lines: Vec<&str> = dxf.lines().collect();
        let groups: Vec<(&str, &str)> = lines.chunks(2).map(|two| (two[0], two[1])).collect();
        let faces = groups.iter().filter(|group| **group == ("0", "3DFACE"));
        assert_eq!(faces.count(), 1);
        let values = |corner: usize| {
            let code = |k: usize| format!("{k}{corner}");
            let value = |k| groups.iter().find(|(c, _)| *c == code(k)).unwrap().1;
            [1, 2, 3].map(value)
        };
        assert_eq!(values(1), ["2", "0", "1"]);
        assert_eq!(values(2), ["0", "-3", "1"]);
        assert_eq!(values(3), values(2));
        assert_eq!(groups.last(), Some(&("0", "EOF")));
    }

    #[test]
    fn a_ply_has_vertices_and_faces() {
        let ply = written(MeshFormat::Ply, &triangle());
        let end = ply.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let header = std::str::from_utf8(&ply[..end]).unwrap();
        assert!(header.contains("element vertex 3\n") && header.contains("element face 1\n"));
        assert!(header.contains("comment lengths in m\n"));
        assert_eq!(ply.len(), end + 3 * 27 + 13);
        assert_eq!(ply[end + 24..end + 27], [255, 0, 188]);
    }
}
