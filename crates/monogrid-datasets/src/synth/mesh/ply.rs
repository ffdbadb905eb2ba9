//! Stanford `.ply` meshes, ascii and binary, with vertex colours.

use super::albedo_of_grey;
use crate::DatasetError;
use crate::synth::world::TriangleMesh;
use std::path::Path;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Value of the bytes in little-endian order.
    fn value(self, le: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = le;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(le),
        }
    }
}

#[derive(Clone, Debug)]
struct Property {
    name: String,
    number: Number,
    /// Type of the length when it is a list.
    length: Option<Number>,
}

#[derive(Clone, Debug)]
struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// Reads the triangles (polygons become fans) and, where there are colours, the reflectance of the
/// vertices. A file without faces gives a mesh without triangles (a point cloud).
///
/// # Errors
/// When the file cannot be read, is not PLY, or ends early.
pub fn read_ply(path: &Path) -> Result<TriangleMesh, DatasetError> {
    let bytes = std::fs::read(path).map_err(|e| DatasetError::io("read", path, e))?;
    let bad = |found: String, expected: &str| DatasetError::content(path, found, expected);
    let (format, elements, body) = header(&bytes).map_err(|reason| bad(reason, "a PLY header"))?;
    let mut values = Values { format, body };
    let mut mesh = TriangleMesh::default();
    for element in &elements {
        let done = match element.name.as_str() {
            "vertex" => read_vertices(&mut values, element, &mut mesh),
            "face" => read_faces(&mut values, element, &mut mesh),
            _ => skip(&mut values, element),
        };
        done.map_err(|reason| {
            bad(
                format!("{reason} in element {:?}", element.name),
                "a complete PLY file",
            )
        })?;
    }
    Ok(mesh)
}

fn header(bytes: &[u8]) -> Result<(Format, Vec<Element>, &[u8]), String> {
    let mut rest = bytes;
    let mut next_line = || -> Option<String> {
        let end = rest.iter().position(|&b| b == b'\n')?;
        let line = String::from_utf8_lossy(&rest[..end]).trim().to_owned();
        rest = &rest[end + 1..];
        Some(line)
    };
    if next_line().as_deref() != Some("ply") {
        return Err("a first line other than \"ply\"".into());
    }
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let line = next_line().ok_or("no end_header")?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => break,
            ["format", name, ..] => {
                format = Some(match *name {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::LittleEndian,
                    "binary_big_endian" => Format::BigEndian,
                    other => return Err(format!("format {other:?}")),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| format!("line {line:?}"))?;
                elements.push(Element {
                    name: (*name).to_owned(),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", rest @ ..] => {
                let property = parse_property(rest).ok_or_else(|| format!("line {line:?}"))?;
                let element = elements.last_mut().ok_or("a property before any element")?;
                element.properties.push(property);
            }
            _ => {}
        }
    }
    Ok((format.ok_or("no format line")?, elements, rest))
}

fn parse_property(words: &[&str]) -> Option<Property> {
    let (length, number, name) = match words {
        ["list", length, number, name] => (Some(Number::parse(length)?), number, name),
        [number, name] => (None, number, name),
        _ => return None,
    };
    Some(Property {
        name: (*name).to_owned(),
        number: Number::parse(number)?,
        length,
    })
}

/// The values after the header, one after the other.
struct Values<'a> {
    format: Format,
    body: &'a [u8],
}

impl Values<'_> {
    fn next(&mut self, number: Number) -> Result<f64, String> {
        const EARLY: &str = "the end of the file";
        if self.format == Format::Ascii {
            let start = self
                .body
                .iter()
                .position(|b| !b.is_ascii_whitespace())
                .ok_or(EARLY)?;
            let body = &self.body[start..];
            let end = body
                .iter()
                .position(u8::is_ascii_whitespace)
                .unwrap_or(body.len());
            let word = String::from_utf8_lossy(&body[..end]);
            self.body = &body[end..];
            return word.parse().map_err(|_| format!("{word:?}"));
        }
        let size = number.size();
        let (bytes, rest) = self.body.split_at_checked(size).ok_or(EARLY)?;
        self.body = rest;
        let mut le = [0u8; 8];
        le[..size].copy_from_slice(bytes);
        if self.format == Format::BigEndian {
            le[..size].reverse();
        }
        Ok(number.value(le))
    }

    /// One property: its value, or those of its list.
    fn property(&mut self, property: &Property, list: &mut Vec<f64>) -> Result<(), String> {
        list.clear();
        let Some(length) = property.length else {
            list.push(self.next(property.number)?);
            return Ok(());
        };
        let count = self.next(length)?;
        if !(0.0..=1e6).contains(&count) {
            return Err(format!("a list of {count} values"));
        }
        for _ in 0..count as usize {
            list.push(self.next(property.number)?);
        }
        Ok(())
    }
}

fn read_vertices(
    values: &mut Values,
    element: &Element,
    mesh: &mut TriangleMesh,
) -> Result<(), String> {
    let find = |name: &str| {
        element
            .properties
            .iter()
            .position(|p| p.name == name && p.length.is_none())
    };
    let (Some(x), Some(y), Some(z)) = (find("x"), find("y"), find("z")) else {
        return Err("no x, y, z".into());
    };
    let colour = [find("red"), find("green"), find("blue")];
    let mut row = vec![0.0; element.properties.len()];
    let mut list = Vec::new();
    for k in 0..element.count {
        for (value, property) in row.iter_mut().zip(&element.properties) {
            values.property(property, &mut list)?;
            *value = list.first().copied().unwrap_or(0.0);
        }
        let point = [row[x] as f32, row[y] as f32, row[z] as f32];
        if point.iter().any(|v| !v.is_finite()) {
            return Err(format!("a coordinate that is not finite at vertex {k}"));
        }
        mesh.vertices.push(point);
        if let [Some(r), Some(g), Some(b)] = colour {
            // colours are bytes, or fractions when of a floating type
            let unit = if matches!(element.properties[r].number, Number::F32 | Number::F64) {
                255.0
            } else {
                1.0
            };
            let grey = 0.299 * row[r] + 0.587 * row[g] + 0.114 * row[b];
            mesh.albedo.push(albedo_of_grey((unit * grey) as f32));
        }
    }
    Ok(())
}

fn read_faces(
    values: &mut Values,
    element: &Element,
    mesh: &mut TriangleMesh,
) -> Result<(), String> {
    let mut list = Vec::new();
    for k in 0..element.count {
        for property in &element.properties {
            values.property(property, &mut list)?;
            if property.length.is_none()
                || !matches!(property.name.as_str(), "vertex_indices" | "vertex_index")
            {
                continue;
            }
            let count = mesh.vertices.len() as f64;
            if let Some(wrong) = list.iter().find(|&&v| !(0.0..count).contains(&v)) {
                return Err(format!("vertex {wrong} of {count} at face {k}"));
            }
            for pair in list.windows(2).skip(1) {
                mesh.triangles
                    .push([list[0] as u32, pair[0] as u32, pair[1] as u32]);
            }
        }
    }
    Ok(())
}

fn skip(values: &mut Values, element: &Element) -> Result<(), String> {
    let mut list = Vec::new();
    for _ in 0..element.count {
        for property in &element.properties {
            values.property(property, &mut list)?;
        }
    }
    Ok(())
}
