//! Triangles of STL, binary and as text: three corners each, and nothing that belongs together.

use crate::triangle_mesh::TriangleMesh;
use monogrid_datasets::{DatasetError, open_file};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Bytes of a binary file before its triangles, and of one of these: a normal, three corners, two
/// bytes of anything.
const HEAD_BYTES: u64 = 84;
const TRIANGLE_BYTES: usize = 50;
/// Longest line of text.
const MAX_LINE: u64 = 1 << 10;

/// Reads the triangles, and the number of corners that were left out: those of triangles of which
/// one has no place.
pub(super) fn read_counted(path: &Path) -> Result<(TriangleMesh, usize), DatasetError> {
    let (file, length) = open_file(path)?;
    read(BufReader::new(file), length)
        .map_err(|reason| DatasetError::content(path, reason, "a complete STL file"))
}

/// The triangles so far.
#[derive(Default)]
struct Triangles {
    mesh: TriangleMesh,
    left_out: usize,
}

impl Triangles {
    fn add(&mut self, corners: [[f32; 3]; 3]) {
        if !corners.iter().flatten().all(|c| c.is_finite()) {
            self.left_out += 3;
            return;
        }
        let first = self.mesh.vertices.len() as u32;
        self.mesh.vertices.extend(corners);
        self.mesh.triangles.push([first, first + 1, first + 2]);
    }
}

fn read(mut file: impl BufRead, length: u64) -> Result<(TriangleMesh, usize), String> {
    let mut head = Vec::new();
    let failed = |error: std::io::Error| error.to_string();
    file.by_ref()
        .take(HEAD_BYTES)
        .read_to_end(&mut head)
        .map_err(failed)?;
    let mut found = Triangles::default();
    let count = head
        .last_chunk()
        .map(|count| u64::from(u32::from_le_bytes(*count)));
    // files of text begin with solid, and some binary ones do so too
    let needed = count.map(|count| HEAD_BYTES + count * TRIANGLE_BYTES as u64);
    if needed == Some(length) {
        let mut bytes = [0; TRIANGLE_BYTES];
        for _ in 0..count.unwrap_or(0) {
            file.read_exact(&mut bytes).map_err(failed)?;
            let (numbers, _) = bytes[12..48].as_chunks();
            let number = |at: usize| f32::from_le_bytes(numbers[at]);
            found.add([0, 3, 6].map(|at| [number(at), number(at + 1), number(at + 2)]));
        }
    } else if head.trim_ascii_start().starts_with(b"solid") {
        read_text(&mut head.chain(file), &mut found)?;
    } else {
        return Err(match needed {
            Some(needed) => format!("{length} bytes where its head says {needed}"),
            None => format!("{length} bytes"),
        });
    }
    Ok((found.mesh, found.left_out))
}

fn read_text(file: &mut impl BufRead, found: &mut Triangles) -> Result<(), String> {
    let mut corners = Vec::new();
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let read = file.take(MAX_LINE).read_until(b'\n', &mut line);
        if read.map_err(|error| error.to_string())? == 0 {
            break;
        }
        let text = String::from_utf8_lossy(&line);
        let Some(rest) = text.trim().strip_prefix("vertex") else {
            continue;
        };
        let numbers = rest.split_whitespace().map(|word| word.parse::<f32>().ok());
        let numbers: Option<Vec<f32>> = numbers.collect();
        let corner = numbers.and_then(|numbers| <[f32; 3]>::try_from(numbers).ok());
        corners.push(corner.ok_or_else(|| format!("line {number}: {:?}", text.trim()))?);
        if let Ok(triangle) = <[[f32; 3]; 3]>::try_from(&*corners) {
            found.add(triangle);
            corners.clear();
        }
    }
    match corners.len() {
        0 if found.mesh.triangles.is_empty() && found.left_out == 0 => {
            Err("no triangle in it".to_owned())
        }
        0 => Ok(()),
        left => Err(format!("{left} corners of a triangle at its end")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn binary(corners: &[[f32; 3]; 3], more: u32) -> Vec<u8> {
        let mut bytes = b"solid of a program that begins its binary files so".to_vec();
        bytes.resize(80, b' ');
        bytes.extend((1 + more).to_le_bytes());
        bytes.extend([0; 12]);
        bytes.extend(corners.iter().flatten().flat_map(|c| c.to_le_bytes()));
        bytes.extend([0; 2]);
        bytes
    }

    fn found(bytes: &[u8]) -> Result<(TriangleMesh, usize), String> {
        read(bytes, bytes.len() as u64)
    }

    #[test]
    fn binary_files_and_those_of_text_hold_the_same() {
        let corners = [[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [0.0, -1.5, 0.5]];
        let text = "solid x\n  facet normal 0 0 1\n    outer loop\n      vertex 0 0 5e-1\n      \
                    vertex 1 0 .5\r\n      vertex 0 -1.5 0.5\n    endloop\n  endfacet\n";
        for bytes in [binary(&corners, 0), text.as_bytes().to_vec()] {
            let (mesh, left_out) = found(&bytes).unwrap();
            assert_eq!((mesh.vertices, left_out), (corners.to_vec(), 0));
            assert_eq!(mesh.triangles, [[0, 1, 2]]);
        }
        let no_place = found(&binary(&[[f32::NAN; 3]; 3], 0)).unwrap();
        assert!(no_place.0.triangles.is_empty() && no_place.1 == 3);
    }

    #[test]
    fn what_is_cut_or_claims_more_is_refused() {
        let whole = binary(&[[1.0; 3]; 3], 0);
        for end in 0..whole.len() {
            assert!(found(&whole[..end]).is_err(), "{end}");
        }
        let mut other = binary(&[[1.0; 3]; 3], u32::MAX - 1);
        other[0] = b'x';
        assert!(found(&other).unwrap_err().contains("its head says"));
        for text in ["solid\nvertex 1 2\n", "solid\nvertex 1 2 3\nvertex 1 2 3\n"] {
            assert!(found(text.as_bytes()).is_err(), "{text}");
        }
    }
}
