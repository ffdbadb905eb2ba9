//! Binary glTF (`.glb`): triangles of its scene with the colours that vertices, materials and
//! pictures give their vertices; z up, as everywhere here.

use super::{MeshModel, albedo_of_grey, linear_luma};
use monogrid_datasets::{DatasetError, decode_jpeg_rgb, open_file};
use monogrid_geometry::nalgebra::{Matrix4, Quaternion, UnitQuaternion, Vector3};
use monogrid_image::Image;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

/// Pixels of a picture at most.
const MAX_PIXELS: usize = 1 << 24;

/// Pictures that are decoded at most: beyond them there are the colours of vertices and materials.
const MAX_PICTURES: usize = 16;

/// Values that parts may read for each byte of the file: they may read the same ones.
const VALUES_PER_BYTE: usize = 4;

/// From y up to z up.
const Z_UP: Matrix4<f32> = Matrix4::new(
    1.0, 0.0, 0.0, 0.0, //
    0.0, 0.0, -1.0, 0.0, //
    0.0, 1.0, 0.0, 0.0, //
    0.0, 0.0, 0.0, 1.0,
);

/// Reads the scene of a file.
pub(super) fn read(path: &Path) -> Result<MeshModel, DatasetError> {
    read_with(path, scene_of)
}

/// A picture, and where vertices are on it: shares of its sides from the upper left.
pub type PictureOf = (Image<[u8; 3]>, Vec<[f64; 2]>);

/// Reads what the first mesh of a file is covered with; `None` where that is no JPEG.
///
/// # Errors
/// When the file cannot be read.
pub fn read_picture(path: &Path) -> Result<Option<PictureOf>, DatasetError> {
    read_with(path, |mut scene| {
        let places = &scene.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"];
        let Some(picture) = scene.picture(&json!(0)) else {
            return Ok(None);
        };
        let places = scene.accessor(places)?.into_iter();
        Ok(Some((picture, places.map(|[u, v, ..]| [u, v]).collect())))
    })
}

/// What `take` takes of a file.
fn read_with<T>(
    path: &Path,
    take: impl FnOnce(Scene) -> Result<T, String>,
) -> Result<T, DatasetError> {
    let (mut file, _) = open_file(path)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)
        .map_err(|e| DatasetError::io("read", path, e))?;
    parse(&bytes, take)
        .map_err(|found| DatasetError::content(path, found, "a whole .glb (glTF 2.0)"))
}

fn parse<T>(bytes: &[u8], take: impl FnOnce(Scene) -> Result<T, String>) -> Result<T, String> {
    let (json, binary) = chunks(bytes).ok_or("not the chunks of a .glb")?;
    let json: Value = serde_json::from_slice(json).map_err(|error| error.to_string())?;
    take(Scene {
        json: &json,
        binary,
        values_left: VALUES_PER_BYTE * bytes.len(),
        visited: BTreeSet::new(),
        pictures_left: MAX_PICTURES,
        model: MeshModel::default(),
    })
}

fn scene_of(mut scene: Scene) -> Result<MeshModel, String> {
    let json = scene.json;
    let number = json["scene"].as_u64().unwrap_or(0) as usize;
    for node in numbers(&json["scenes"][number]["nodes"]) {
        scene.add_node(node, Z_UP)?;
    }
    let mesh = &mut scene.model.mesh;
    let is_known = |point: &[f32; 3]| point.iter().all(|value| value.is_finite());
    if !mesh.vertices.iter().all(is_known) {
        return Err("a place that is not finite".into());
    }
    Ok(scene.model)
}

/// The JSON of a file, and the bytes that it describes.
fn chunks(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let chunk = |bytes: &'_ [u8], kind: &[u8; 4]| -> Option<usize> {
        let length = u32::from_le_bytes(bytes.get(..4)?.try_into().ok()?) as usize;
        (bytes.get(4..8)? == kind && bytes.len() - 8 >= length).then_some(length)
    };
    let rest = bytes.strip_prefix(b"glTF\x02\0\0\0")?.get(4..)?;
    let length = chunk(rest, b"JSON")?;
    let (json, rest) = rest[8..].split_at(length);
    let binary = chunk(rest, b"BIN\0").map_or(&rest[..0], |length| &rest[8..8 + length]);
    Some((json, binary))
}

fn numbers(list: &Value) -> impl Iterator<Item = usize> {
    let list = list.as_array().into_iter().flatten();
    list.filter_map(|number| Some(number.as_u64()? as usize))
}

/// Numbers of a list of just so many.
fn floats<const N: usize>(list: &Value) -> Option<[f32; N]> {
    let list = list.as_array()?.iter();
    let values: Option<Vec<f32>> = list.map(|value| Some(value.as_f64()? as f32)).collect();
    values?.try_into().ok()
}

struct Scene<'a> {
    json: &'a Value,
    binary: &'a [u8],
    /// A mesh may be in a scene many times, and values in many meshes.
    values_left: usize,
    /// A scene is a tree.
    visited: BTreeSet<usize>,
    pictures_left: usize,
    model: MeshModel,
}

impl Scene<'_> {
    fn add_node(&mut self, number: usize, around: Matrix4<f32>) -> Result<(), String> {
        // one after the other: a chain of nodes may be long
        let mut nodes = vec![(number, around)];
        while let Some((number, around)) = nodes.pop() {
            if !self.visited.insert(number) {
                return Err(format!("node {number} is in the scene twice"));
            }
            let node = &self.json["nodes"][number];
            let placed = around * placement(node);
            if let Some(mesh) = node["mesh"].as_u64() {
                let parts = &self.json["meshes"][mesh as usize]["primitives"];
                for part in parts.as_array().into_iter().flatten() {
                    self.add_part(part, &placed)?;
                }
            }
            nodes.extend(numbers(&node["children"]).map(|child| (child, placed)));
        }
        Ok(())
    }

    /// Adds triangles of one material; lines and points are none.
    fn add_part(&mut self, part: &Value, placed: &Matrix4<f32>) -> Result<(), String> {
        if part["mode"].as_u64().is_some_and(|mode| mode != 4) {
            return Ok(());
        }
        let attributes = &part["attributes"];
        let places = self.accessor(&attributes["POSITION"])?;
        let first = self.model.mesh.vertices.len();
        let material = part["material"].as_u64().unwrap_or(u64::MAX) as usize;
        let material = &self.json["materials"][material]["pbrMetallicRoughness"];
        let factor = floats::<4>(&material["baseColorFactor"]).unwrap_or([1.0; 4]);
        let mut colours = match &attributes["COLOR_0"] {
            Value::Null => vec![[1.0; 4]; places.len()],
            colours => self.accessor(colours)?,
        };
        if let Some(picture) = self.picture(&material["baseColorTexture"]["index"]) {
            let on = self.accessor(&attributes["TEXCOORD_0"])?;
            for (colour, [u, v, ..]) in colours.iter_mut().zip(on) {
                let at = |share: f64, side: usize| {
                    // pictures repeat
                    let pixel = (share - share.floor()) * side as f64;
                    (pixel as usize).min(side - 1)
                };
                let shown = picture.at(at(u, picture.width()), at(v, picture.height()));
                for (value, shown) in colour.iter_mut().zip(shown) {
                    *value *= f64::from(albedo_of_grey(f32::from(shown)));
                }
            }
        }
        let corners = match &part["indices"] {
            Value::Null => (0..places.len()).collect(),
            indices => {
                let indices = self.accessor(indices)?.into_iter();
                indices
                    .map(|[index, ..]| index as usize)
                    .collect::<Vec<_>>()
            }
        };
        if corners.iter().any(|corner| *corner >= places.len()) {
            return Err("a corner without a vertex".into());
        }
        let mesh = &mut self.model.mesh;
        for [x, y, z, _] in &places {
            let place = placed.transform_point(&[*x as f32, *y as f32, *z as f32].into());
            mesh.vertices.push(place.coords.into());
        }
        let colours = colours.into_iter().chain(std::iter::repeat([1.0; 4]));
        for colour in colours.take(places.len()) {
            let linear = [0, 1, 2].map(|k| (colour[k] as f32 * factor[k]).clamp(0.0, 1.0));
            mesh.albedo.push(linear_luma(linear));
            mesh.colours.push(linear.map(displayed));
        }
        let triangles = corners.as_chunks::<3>().0.iter();
        mesh.triangles
            .extend(triangles.map(|corners| corners.map(|corner| (first + corner) as u32)));
        Ok(())
    }

    /// The picture of a texture; `None` where there is none, or it is no JPEG.
    fn picture(&mut self, texture: &Value) -> Option<Image<[u8; 3]>> {
        let texture = &self.json["textures"][texture.as_u64()? as usize];
        self.pictures_left = self.pictures_left.checked_sub(1)?;
        let image = &self.json["images"][texture["source"].as_u64()? as usize];
        let view = &self.json["bufferViews"][image["bufferView"].as_u64()? as usize];
        let bytes = self
            .binary
            .get(view["byteOffset"].as_u64().unwrap_or(0) as usize..)?;
        let bytes = bytes.get(..view["byteLength"].as_u64()? as usize)?;
        let name = Path::new("picture of a .glb");
        decode_jpeg_rgb(bytes, MAX_PIXELS, name).ok()?
    }

    /// The values of an accessor, up to four each.
    fn accessor(&mut self, number: &Value) -> Result<Vec<[f64; 4]>, String> {
        let values = self.values(number);
        let values = values.ok_or_else(|| format!("accessor {number} does not lie in the file"))?;
        let left = self.values_left.checked_sub(values.len());
        self.values_left = left.ok_or("the same vertices and triangles too often")?;
        Ok(values)
    }

    fn values(&self, number: &Value) -> Option<Vec<[f64; 4]>> {
        let accessor = &self.json["accessors"][number.as_u64()? as usize];
        let view = &self.json["bufferViews"][accessor["bufferView"].as_u64()? as usize];
        let offset = |value: &Value| value["byteOffset"].as_u64().unwrap_or(0) as usize;
        let count = accessor["count"].as_u64()? as usize;
        let components = match accessor["type"].as_str()? {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => return None,
        };
        let (size, most) = match accessor["componentType"].as_u64()? {
            5121 => (1, 255.0),
            5123 => (2, 65_535.0),
            5125 | 5126 => (4, 1.0),
            _ => return None,
        };
        let is_float = accessor["componentType"] == 5126;
        let unit = match accessor["normalized"].as_bool() {
            Some(true) => most,
            _ => 1.0,
        };
        let bytes = self.binary.get(offset(view)..)?;
        let bytes = bytes.get(..view["byteLength"].as_u64()? as usize)?;
        let bytes = bytes.get(offset(accessor)..)?;
        let stride = view["byteStride"].as_u64().unwrap_or(0) as usize;
        let stride = stride.max(components * size);
        // so that a count is not believed before it is seen
        if count > bytes.len().div_ceil(stride) {
            return None;
        }
        let value = |index: usize| {
            let mut values = [0.0; 4];
            for (k, value) in values.iter_mut().take(components).enumerate() {
                let bytes = bytes.get(index * stride + k * size..)?.get(..size)?;
                let mut four = [0; 4];
                four[..size].copy_from_slice(bytes);
                *value = match is_float {
                    true => f64::from(f32::from_le_bytes(four)),
                    false => f64::from(u32::from_le_bytes(four)) / unit,
                };
            }
            Some(values)
        };
        (0..count).map(value).collect()
    }
}

/// Where a node is in the one around it.
fn placement(node: &Value) -> Matrix4<f32> {
    if let Some(columns) = floats::<16>(&node["matrix"]) {
        return Matrix4::from_column_slice(&columns);
    }
    let [x, y, z, w] = floats(&node["rotation"]).unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let turn = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    let scale = floats::<3>(&node["scale"]).unwrap_or([1.0; 3]);
    let move_by = floats::<3>(&node["translation"]).unwrap_or([0.0; 3]);
    Matrix4::new_translation(&Vector3::from(move_by))
        * turn.to_homogeneous()
        * Matrix4::new_nonuniform_scaling(&Vector3::from(scale))
}

/// A linear value as screens show it (sRGB, IEC 61966-2-1).
fn displayed(linear: f32) -> u8 {
    let value = match linear {
        0.0..=0.003_130_8 => 12.92 * linear,
        _ => 1.055 * linear.powf(1.0 / 2.4) - 0.055,
    };
    (255.0 * value).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of this description and these bytes.
    fn file(json: &Value, binary: &[u8]) -> Vec<u8> {
        let text = json.to_string().into_bytes();
        let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for (kind, chunk) in [(b"JSON", text.as_slice()), (b"BIN\0", binary)] {
            bytes.extend((chunk.len() as u32).to_le_bytes());
            bytes.extend(kind);
            bytes.extend(chunk);
        }
        bytes
    }

    fn triangle() -> (Value, Vec<u8>) {
        let places = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0];
        let mut binary: Vec<u8> = places.iter().flat_map(|v| v.to_le_bytes()).collect();
        binary.extend([0, 2, 1, 0]);
        let json = json!({
            "scenes": [{ "nodes": [1] }],
            "nodes": [{ "mesh": 0 }, { "children": [0], "translation": [10, 0, 0] }],
            "meshes": [{ "primitives": [{
                "attributes": { "POSITION": 0 }, "indices": 1, "material": 0,
            }] }],
            "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [1, 0, 0.5, 1] } }],
            "bufferViews": [
                { "byteLength": 36 }, { "byteOffset": 36, "byteLength": 3 },
            ],
            "accessors": [
                { "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" },
                { "bufferView": 1, "componentType": 5121, "count": 3, "type": "SCALAR" },
            ],
        });
        (json, binary)
    }

    #[test]
    fn a_scene_is_turned_z_up_and_has_the_colours_of_its_materials() {
        let (json, binary) = triangle();
        let mesh = parse(&file(&json, &binary), scene_of).unwrap().mesh;
        let places = [[10.0, 0.0, 0.0], [11.0, 0.0, 0.0], [10.0, 0.0, 2.0]];
        assert_eq!(
            (mesh.vertices, mesh.triangles),
            (places.to_vec(), vec![[0, 2, 1]])
        );
        assert_eq!(mesh.colours, [[255, 0, 188]; 3]);
    }

    #[test]
    fn a_picture_gives_vertices_their_colours() {
        let (mut json, mut binary) = triangle();
        let picture = Image::from_fn(16, 8, |x, _| if x < 8 { [250, 0, 0] } else { [0, 0, 250] });
        let jpeg = monogrid_datasets::encode_jpeg_rgb(&picture, 95);
        binary.extend(
            [0.25f32, 0.5, 0.75, 0.5, 0.75, 0.9]
                .map(f32::to_le_bytes)
                .as_flattened(),
        );
        binary.extend(&jpeg);
        let material = &mut json["materials"][0]["pbrMetallicRoughness"];
        *material = json!({ "baseColorTexture": { "index": 0 } });
        json["textures"] = json!([{ "source": 0 }]);
        json["images"] = json!([{ "bufferView": 3, "mimeType": "image/jpeg" }]);
        json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = 2.into();
        let views = json["bufferViews"].as_array_mut().unwrap();
        views.push(json!({ "byteOffset": 40, "byteLength": 24 }));
        views.push(json!({ "byteOffset": 64, "byteLength": jpeg.len() }));
        let accessors = json["accessors"].as_array_mut().unwrap();
        accessors
            .push(json!({ "bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC2" }));
        let colours = parse(&file(&json, &binary), scene_of).unwrap().mesh.colours;
        assert!(colours[0][0] > 230 && colours[0][2] < 20, "{colours:?}");
        assert!(colours[1][0] < 20 && colours[1][2] > 230, "{colours:?}");
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let (json, binary) = triangle();
        let whole = file(&json, &binary);
        for end in 0..whole.len() - 1 {
            assert!(parse(&whole[..end], scene_of).is_err(), "{end}");
        }
        let wrong = |pointer: &str, value: Value| {
            let mut json = json.clone();
            *json.pointer_mut(pointer).unwrap() = value;
            parse(&file(&json, &binary), scene_of).unwrap_err()
        };
        assert!(wrong("/accessors/0/count", json!(u64::MAX)).contains("accessor 0"));
        assert!(wrong("/accessors/1/componentType", json!(5123)).contains("accessor 1"));
        assert!(wrong("/nodes/1/children", json!([1])).contains("twice"));
        assert!(wrong("/accessors/0/count", json!(2)).contains("corner"));
        let mut often = json.clone();
        let node = json!({ "mesh": 0 });
        often["nodes"] = vec![node; 2000].into();
        often["scenes"][0]["nodes"] = (0..2000).collect::<Vec<_>>().into();
        // a node takes 16 bytes here and has 3 vertices: all of them fit
        assert!(parse(&file(&often, &binary), scene_of).is_ok());
        // what is read of a part, beside its three places, may be more than they are
        let part = often["meshes"][0]["primitives"][0].clone();
        let [mut of_corners, mut of_colours] = [part.clone(), part.clone()];
        of_corners["indices"] = 2.into();
        of_colours["attributes"]["COLOR_0"] = 2.into();
        of_colours.as_object_mut().unwrap().remove("indices");
        let push = |often: &mut Value, list: &str, value: Value| {
            often[list].as_array_mut().unwrap().push(value);
        };
        push(
            &mut often,
            "bufferViews",
            json!({ "byteOffset": 40, "byteLength": 3000 }),
        );
        let values =
            json!({ "bufferView": 2, "componentType": 5121, "count": 3000, "type": "SCALAR" });
        push(&mut often, "accessors", values);
        let much = [binary.as_slice(), &[0; 3000]].concat();
        for (part, count) in [(part.clone(), 20), (of_corners, 1), (of_colours, 1)] {
            let mut often = often.clone();
            often["meshes"][0]["primitives"] = vec![part; count].into();
            let error = parse(&file(&often, &much), scene_of).unwrap_err();
            assert!(error.contains("too often"), "{error}");
        }
        assert!(wrong("/bufferViews/1/byteOffset", json!(u64::MAX)).contains("accessor 1"));
    }
}
