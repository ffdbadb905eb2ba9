//! Point clouds of PCL (`.pcd`, versions 0.5 to 0.7): text, binary, and binary compressed by LZF,
//! field after field.

use crate::triangle_mesh::TriangleMesh;
use monogrid_datasets::{DatasetError, open_file};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Longest line of a header, and most lines.
const MAX_LINE: u64 = 1 << 16;
const MAX_LINES: usize = 100;

/// A point at most, bytes: fields of features are long.
const MAX_POINT_BYTES: usize = 1 << 20;

/// Bytes that one byte of LZF can become.
const MAX_GROWTH: u64 = 264;

/// A number of a point.
#[derive(Clone, Debug, PartialEq)]
struct Field {
    name: String,
    /// Where it begins in the point, bytes.
    at: usize,
    /// Bytes of one value.
    size: usize,
    /// `F`, `I` or `U`.
    kind: u8,
    /// Values.
    count: usize,
}

impl Field {
    /// The first value in its bytes.
    fn number(&self, bytes: &[u8]) -> Option<f64> {
        let (size, kind) = (self.size, self.kind);
        Some(match (kind, size) {
            (b'F', 4) => f32::from_le_bytes(*bytes.first_chunk()?).into(),
            (b'F', 8) => f64::from_le_bytes(*bytes.first_chunk()?),
            (b'U', 1) => (*bytes.first()?).into(),
            (b'U', 2) => u16::from_le_bytes(*bytes.first_chunk()?).into(),
            (b'U', 4) => u32::from_le_bytes(*bytes.first_chunk()?).into(),
            (b'I', 1) => bytes.first()?.cast_signed().into(),
            (b'I', 2) => i16::from_le_bytes(*bytes.first_chunk()?).into(),
            (b'I', 4) => i32::from_le_bytes(*bytes.first_chunk()?).into(),
            (b'U' | b'I', 8) => i64::from_le_bytes(*bytes.first_chunk()?) as f64,
            _ => return None,
        })
    }

    /// The bits of a colour from a number in text: PCL packs the bytes blue, green, red into one,
    /// and calls it a float.
    fn colour_of_text(&self, text: &str) -> Option<u32> {
        match self.kind {
            b'F' => text.parse::<f32>().ok().map(f32::to_bits),
            _ => text.parse().ok(),
        }
    }
}

/// How the points follow the header.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Layout {
    Text,
    Binary,
    Compressed,
}

#[derive(Debug)]
struct Header {
    fields: Vec<Field>,
    points: usize,
    layout: Layout,
}

impl Header {
    fn read(input: &mut impl BufRead) -> Result<Self, String> {
        let mut values: [Vec<String>; 4] = Default::default();
        let (mut points, mut size) = (None, [None; 2]);
        for _ in 0..MAX_LINES {
            let line = line(input)?.ok_or("a header that ends early")?;
            let mut words = line.split_whitespace().map(str::to_owned);
            let key = words.next().unwrap_or_default();
            let mut number = || words.next().and_then(|word| word.parse::<usize>().ok());
            match key.as_str() {
                "FIELDS" | "COLUMNS" => values[0] = words.collect(),
                "SIZE" => values[1] = words.collect(),
                "TYPE" => values[2] = words.collect(),
                "COUNT" => values[3] = words.collect(),
                "WIDTH" => size[0] = number(),
                "HEIGHT" => size[1] = number(),
                "POINTS" => points = number(),
                "DATA" => {
                    let layout = match words.next().as_deref() {
                        Some("ascii") => Layout::Text,
                        Some("binary") => Layout::Binary,
                        Some("binary_compressed") => Layout::Compressed,
                        other => return Err(format!("data {other:?}")),
                    };
                    let of_size = || size[0]?.checked_mul(size[1]?);
                    let points = points.or_else(of_size).ok_or("no number of points")?;
                    return Ok(Self {
                        fields: fields(&values)?,
                        points,
                        layout,
                    });
                }
                _ => {}
            }
        }
        Err("a header without DATA".to_owned())
    }

    fn field(&self, name: &str) -> Option<(usize, &Field)> {
        let mut fields = self.fields.iter().enumerate();
        fields.find(|(_, field)| field.name == name)
    }

    fn point_bytes(&self) -> usize {
        self.fields
            .last()
            .map_or(0, |field| field.at + field.size * field.count)
    }
}

fn line(input: &mut impl BufRead) -> Result<Option<String>, String> {
    let mut line = Vec::new();
    let read = input.take(MAX_LINE).read_until(b'\n', &mut line);
    let read = read.map_err(|error| error.to_string())?;
    Ok((read > 0).then(|| String::from_utf8_lossy(&line).into_owned()))
}

/// Fields by their names, sizes, types and counts.
fn fields([names, sizes, kinds, counts]: &[Vec<String>; 4]) -> Result<Vec<Field>, String> {
    let mut at = 0;
    let mut fields = Vec::new();
    for (k, name) in names.iter().enumerate() {
        let number = |list: &[String], usual| match list.get(k) {
            Some(word) => word
                .parse::<usize>()
                .ok()
                .filter(|n| (1..=MAX_POINT_BYTES).contains(n)),
            None => usual,
        };
        let found = (number(sizes, Some(4)), number(counts, Some(1)));
        let (Some(size), Some(count)) = found else {
            return Err(format!("no size or count of field {name}"));
        };
        let kind = kinds
            .get(k)
            .and_then(|kind| kind.bytes().next())
            .unwrap_or(b'F');
        fields.push(Field {
            name: name.clone(),
            at,
            size,
            kind,
            count,
        });
        at = size
            .checked_mul(count)
            .and_then(|bytes| bytes.checked_add(at))
            .unwrap_or(usize::MAX);
        if at > MAX_POINT_BYTES {
            return Err(format!("points of more than {MAX_POINT_BYTES} bytes"));
        }
    }
    Ok(fields)
}

/// Reads the points of a cloud and, where it has colours, their reflectance; and the number of
/// those without a place, which are left out.
pub(super) fn read_counted(path: &Path) -> Result<(TriangleMesh, usize), DatasetError> {
    let (file, _) = open_file(path)?;
    read(&mut BufReader::new(file))
        .map_err(|reason| DatasetError::content(path, reason, "a complete PCD file"))
}

/// The points so far.
#[derive(Default)]
struct Cloud {
    mesh: TriangleMesh,
    left_out: usize,
}

impl Cloud {
    fn add(&mut self, point: [f64; 3], colour: Option<u32>) {
        let point = point.map(|c| c as f32);
        if !point.iter().all(|c| c.is_finite()) {
            self.left_out += 1;
            return;
        }
        self.mesh.vertices.push(point);
        if let Some(bits) = colour {
            let [blue, green, red, _] = bits.to_le_bytes().map(f32::from);
            self.mesh.add_colour([red, green, blue]);
        }
    }
}

fn read(input: &mut impl BufRead) -> Result<(TriangleMesh, usize), String> {
    let header = Header::read(input)?;
    let axis = |name: &str| header.field(name).ok_or_else(|| format!("no field {name}"));
    let axes = [axis("x")?, axis("y")?, axis("z")?];
    let colour = header.field("rgb").or_else(|| header.field("rgba"));
    let colour = colour.filter(|(_, field)| field.size == 4);
    let mut cloud = Cloud::default();
    match header.layout {
        Layout::Text => read_text(input, &header, (axes, colour), &mut cloud)?,
        Layout::Binary => read_binary(input, &header, (axes, colour), &mut cloud)?,
        Layout::Compressed => read_compressed(input, &header, (axes, colour), &mut cloud)?,
    }
    Ok((cloud.mesh, cloud.left_out))
}

/// Number and field of x, y and z, and of the colour.
type Wanted<'a> = ([(usize, &'a Field); 3], Option<(usize, &'a Field)>);

fn read_text(
    input: &mut impl BufRead,
    header: &Header,
    (axes, colour): Wanted,
    cloud: &mut Cloud,
) -> Result<(), String> {
    // the word of the first value of each field
    let starts = header.fields.iter().scan(0, |next, field| {
        let start = *next;
        *next += field.count;
        Some(start)
    });
    let starts: Vec<usize> = starts.collect();
    let num_words: usize = header.fields.iter().map(|field| field.count).sum();
    for k in 0..header.points {
        let line = line(input)?.ok_or_else(|| format!("an end after {k} points"))?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let word = |field: usize| words.get(starts[field]).copied();
        let number = |(field, _): (usize, &Field)| word(field)?.parse().ok();
        let point = (number(axes[0]), number(axes[1]), number(axes[2]));
        let (Some(x), Some(y), Some(z)) = point else {
            return Err(format!("no coordinates at point {k}"));
        };
        if words.len() < num_words {
            return Err(format!(
                "{} of {num_words} numbers at point {k}",
                words.len()
            ));
        }
        let bits = colour.map(|(field, f)| word(field).and_then(|text| f.colour_of_text(text)));
        cloud.add([x, y, z], bits.map(Option::unwrap_or_default));
    }
    Ok(())
}

fn read_binary(
    input: &mut impl BufRead,
    header: &Header,
    (axes, colour): Wanted,
    cloud: &mut Cloud,
) -> Result<(), String> {
    let mut point = vec![0; header.point_bytes()];
    for k in 0..header.points {
        let read = input.read_exact(&mut point);
        read.map_err(|_| format!("an end after {k} points"))?;
        let number = |(_, field): (usize, &Field)| field.number(&point[field.at..]);
        let numbers = (number(axes[0]), number(axes[1]), number(axes[2]));
        let (Some(x), Some(y), Some(z)) = numbers else {
            return Err("coordinates of an unknown type".to_owned());
        };
        let bits = colour.and_then(|(_, field)| point[field.at..].first_chunk());
        cloud.add([x, y, z], bits.map(|bits| u32::from_le_bytes(*bits)));
    }
    Ok(())
}

fn read_compressed(
    input: &mut impl BufRead,
    header: &Header,
    (axes, colour): Wanted,
    cloud: &mut Cloud,
) -> Result<(), String> {
    let mut sizes = [0; 8];
    let cut = |_| "an end before the points".to_owned();
    input.read_exact(&mut sizes).map_err(cut)?;
    let [packed, unpacked] = [0, 4].map(|at| {
        let bytes = [sizes[at], sizes[at + 1], sizes[at + 2], sizes[at + 3]];
        u64::from(u32::from_le_bytes(bytes))
    });
    let mut bytes = Vec::new();
    input
        .take(packed)
        .read_to_end(&mut bytes)
        .map_err(|error| error.to_string())?;
    let needed = header.points.saturating_mul(header.point_bytes()) as u64;
    if unpacked != needed || unpacked > MAX_GROWTH * bytes.len() as u64 {
        return Err(format!(
            "{} bytes that claim to hold {unpacked}, where the points need {needed}",
            bytes.len()
        ));
    }
    let unpacked = unpacked_lzf(&bytes, unpacked as usize)?;
    // all values of a field, then all of the next
    let of_field = |(_, field): (usize, &Field), k: usize| {
        let start = field.at * header.points + k * field.size * field.count;
        &unpacked[start..start + field.size]
    };
    for k in 0..header.points {
        let number = |axis: (usize, &Field)| axis.1.number(of_field(axis, k));
        let numbers = (number(axes[0]), number(axes[1]), number(axes[2]));
        let (Some(x), Some(y), Some(z)) = numbers else {
            return Err("coordinates of an unknown type".to_owned());
        };
        let bits = colour.and_then(|colour| of_field(colour, k).first_chunk());
        cloud.add([x, y, z], bits.map(|bits| u32::from_le_bytes(*bits)));
    }
    Ok(())
}

/// What LZF has packed into so many bytes: runs of bytes as they are, and repetitions of what came
/// up to 8 kB before.
fn unpacked_lzf(packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    let cut = || "compressed points that end early".to_owned();
    let mut rest = packed.iter().copied();
    let mut out: Vec<u8> = Vec::new();
    while let Some(control) = rest.next() {
        if control < 32 {
            for _ in 0..=control {
                out.push(rest.next().ok_or_else(cut)?);
            }
        } else {
            let mut length = usize::from(control >> 5);
            if length == 7 {
                length += usize::from(rest.next().ok_or_else(cut)?);
            }
            let back = usize::from(control & 31) << 8 | usize::from(rest.next().ok_or_else(cut)?);
            let from = out.len().checked_sub(back + 1).ok_or_else(cut)?;
            for k in from..from + length + 2 {
                out.push(out[k]);
            }
        }
        if out.len() > size {
            break;
        }
    }
    if out.len() != size {
        return Err(format!(
            "compressed points of {} bytes, where there should be {size}",
            out.len()
        ));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::{read, unpacked_lzf};
    use crate::triangle_mesh::TriangleMesh;

    fn header(data: &str) -> String {
        format!(
            "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z rgb normal\n\
             SIZE 4 4 4 4 8\nTYPE F F F U F\nCOUNT 1 1 1 1 2\nWIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 \
             0 0 0\nPOINTS 3\nDATA {data}\n"
        )
    }

    const POINTS: [([f32; 3], u32); 3] = [
        ([1.0, 2.0, 3.0], 0x00ff_ffff),
        ([f32::NAN, 0.0, 0.0], 0),
        ([-1.5, 0.0, 0.25], 0),
    ];

    fn binary() -> Vec<u8> {
        let mut bytes = header("binary").into_bytes();
        for (point, colour) in POINTS {
            point.iter().for_each(|c| bytes.extend(c.to_le_bytes()));
            bytes.extend(colour.to_le_bytes());
            bytes.extend([7; 16]);
        }
        bytes
    }

    /// As runs of bytes without a repetition.
    fn packed(bytes: &[u8]) -> Vec<u8> {
        let run = |run: &[u8]| [&[run.len() as u8 - 1], run].concat();
        bytes.chunks(32).flat_map(run).collect()
    }

    fn compressed() -> Vec<u8> {
        let mut columns = Vec::new();
        for axis in 0..3 {
            POINTS
                .iter()
                .for_each(|(point, _)| columns.extend(point[axis].to_le_bytes()));
        }
        POINTS
            .iter()
            .for_each(|(_, colour)| columns.extend(colour.to_le_bytes()));
        columns.extend([7; 48]);
        let data = packed(&columns);
        let mut bytes = header("binary_compressed").into_bytes();
        bytes.extend((data.len() as u32).to_le_bytes());
        bytes.extend((columns.len() as u32).to_le_bytes());
        bytes.extend(data);
        bytes
    }

    fn text() -> Vec<u8> {
        let rows = "1 2 3 16777215 7 7\nnan 0 0 0 7 7\n-1.5 0 2.5e-1 0 7 7\n";
        (header("ascii") + rows).into_bytes()
    }

    #[test]
    fn all_three_encodings_hold_the_same_points() {
        let expected = TriangleMesh {
            vertices: vec![[1.0, 2.0, 3.0], [-1.5, 0.0, 0.25]],
            albedo: vec![1.0, 0.0],
            colours: vec![[255; 3], [0; 3]],
            ..TriangleMesh::default()
        };
        for bytes in [text(), binary(), compressed()] {
            let (cloud, left_out) = read(&mut &bytes[..]).unwrap();
            assert_eq!((&cloud, left_out), (&expected, 1));
            for end in 0..bytes.len() - 1 {
                assert!(read(&mut &bytes[..end]).is_err(), "{end}");
            }
        }
    }

    #[test]
    fn colours_may_be_packed_into_floats_and_missing() {
        let rgb = f32::from_bits(0x00ff_ffff);
        let file = format!("FIELDS x y z rgb\nWIDTH 1\nHEIGHT 1\nDATA ascii\n1 2 3 {rgb:e}\n");
        assert_eq!(read(&mut file.as_bytes()).unwrap().0.albedo, [1.0]);
        let file = "FIELDS y x z\nSIZE 8 8 8\nTYPE F F F\nPOINTS 1\nDATA ascii\n2 1 3\n";
        let (cloud, _) = read(&mut file.as_bytes()).unwrap();
        assert_eq!(
            (cloud.vertices, cloud.albedo),
            (vec![[1.0, 2.0, 3.0]], vec![])
        );
    }

    #[test]
    fn damage_and_claims_are_refused() {
        let claims = |text: &str| read(&mut text.as_bytes()).unwrap_err();
        assert!(claims("FIELDS x y\nPOINTS 1\nDATA ascii\n1 2\n").contains("no field z"));
        assert!(
            claims("FIELDS x y z\nPOINTS 99999999999\nDATA binary\nabc").contains("after 0 points")
        );
        assert!(
            claims("FIELDS x y z\nSIZE 3 3 3\nPOINTS 1\nDATA binary\nabcdefghi").contains("type")
        );
        assert!(
            claims("FIELDS x y z\nCOUNT 1 1 99999999\nPOINTS 1\nDATA binary\n").contains("count")
        );
        assert!(claims("FIELDS x y z\nPOINTS 1\nDATA zip\n").contains("zip"));
        let mut bomb = b"FIELDS x y z\nPOINTS 300000000\nDATA binary_compressed\n".to_vec();
        bomb.extend(5_u32.to_le_bytes());
        bomb.extend(3_600_000_000_u32.to_le_bytes());
        bomb.extend([0xff; 5]);
        assert!(read(&mut &bomb[..]).unwrap_err().contains("claim to hold"));
    }

    #[test]
    fn repetitions_may_overlap_themselves() {
        // one byte, then nine of it
        assert_eq!(unpacked_lzf(&[0, 5, 0xe0, 0, 0], 10).unwrap(), [5; 10]);
        assert_eq!(
            unpacked_lzf(&[1, 1, 2, 0x20, 1], 5).unwrap(),
            [1, 2, 1, 2, 1]
        );
        for damaged in [&[0][..], &[0x20, 0], &[0, 1, 0x20, 9], &[0, 1, 0xe0]] {
            assert!(unpacked_lzf(damaged, 3).is_err(), "{damaged:?}");
        }
    }
}
