//! The text files of a run in another unit.

/// A trajectory (`time tx ty tz qx qy qz qw`) with its positions times `factor`.
pub fn trajectory(text: &str, factor: f64) -> Option<String> {
    scaled_lines(text, has_numbers, &[1, 2, 3], factor)
}

/// `keyframes.txt` (`id frame timestamp scale tx ty tz ...`) with scales and positions times
/// `factor`.
pub fn keyframes(text: &str, factor: f64) -> Option<String> {
    scaled_lines(text, has_numbers, &[3, 4, 5, 6], factor)
}

/// `graph.g2o`: vertices move, and their units grow; edges are in units of keyframes.
pub fn graph(text: &str, factor: f64) -> Option<String> {
    let is_vertex = |line: &str| line.starts_with("VERTEX_SIM3");
    scaled_lines(text, is_vertex, &[2, 3, 4, 9], factor)
}

/// Bytes of a point of `cloud.ply`: three coordinates, a colour and a confidence.
const POINT_BYTES: usize = 19;

/// `cloud.ply` with its points times `factor`, in metres.
pub fn cloud(ply: &[u8], factor: f64) -> Option<Vec<u8>> {
    const END: &[u8] = b"end_header\n";
    let end = ply.windows(END.len()).position(|window| window == END)? + END.len();
    let header = std::str::from_utf8(&ply[..end]).ok()?;
    let header = header.replace("lengths in map units (scale unknown)", "lengths in m");
    let mut out = header.into_bytes();
    for point in ply[end..].chunks(POINT_BYTES) {
        let (place, rest) = point.split_at_checked(12)?;
        for coordinate in place.chunks_exact(4) {
            let value = f32::from_le_bytes(coordinate.try_into().ok()?);
            out.extend(((f64::from(value) * factor) as f32).to_le_bytes());
        }
        out.extend(rest);
    }
    Some(out)
}

fn has_numbers(line: &str) -> bool {
    !line.is_empty() && !line.starts_with('#')
}

fn scaled_lines(
    text: &str,
    is_scaled: fn(&str) -> bool,
    columns: &[usize],
    factor: f64,
) -> Option<String> {
    let mut out = String::with_capacity(text.len());
    for line in text.lines() {
        match is_scaled(line) {
            true => out += &scaled(line, columns, factor)?,
            false => out += line,
        }
        out.push('\n');
    }
    Some(out)
}

/// A line with some of its columns times `factor`.
fn scaled(line: &str, columns: &[usize], factor: f64) -> Option<String> {
    let mut words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
    for column in columns {
        let word = words.get_mut(*column)?;
        let value: f64 = word.parse().ok()?;
        *word = format!("{:.9}", value * factor);
    }
    Some(words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_scaled_and_nothing_else() {
        let text = "# comment\n1.5 1 -2 0.5 0 0 0 1\n";
        let expected = "# comment\n1.5 2.000000000 -4.000000000 1.000000000 0 0 0 1\n";
        assert_eq!(trajectory(text, 2.0).as_deref(), Some(expected));
        let expected = "3 7 1.5 1.000000000 2.000000000 4.000000000 6.000000000 0 0 0 1 99\n";
        assert_eq!(
            keyframes("3 7 1.5 0.5 1 2 3 0 0 0 1 99\n", 2.0).as_deref(),
            Some(expected)
        );
        let edges = "EDGE_SIM3:QUAT 0 1 1 2 3 0 0 0 1 1 9 9\nFIX 0\n";
        assert_eq!(graph(edges, 2.0).as_deref(), Some(edges));
        let vertex = "VERTEX_SIM3:QUAT 4 1 2 3 0 0 0 1 0.5\n";
        let expected =
            "VERTEX_SIM3:QUAT 4 2.000000000 4.000000000 6.000000000 0 0 0 1 1.000000000\n";
        assert_eq!(graph(vertex, 2.0).as_deref(), Some(expected));
        assert_eq!(trajectory("1.5 1 x 0\n", 2.0), None);
        let header = "ply\ncomment lengths in map units (scale unknown)\nend_header\n";
        let mut point = [1.0_f32, 2.0, -3.0].map(f32::to_le_bytes).concat();
        point.extend([9, 9, 9, 1, 2, 3, 4]);
        let found = cloud(&[header.as_bytes(), &point].concat(), 2.0).unwrap();
        let mut expected = b"ply\ncomment lengths in m\nend_header\n".to_vec();
        expected.extend([2.0_f32, 4.0, -6.0].map(f32::to_le_bytes).concat());
        expected.extend([9, 9, 9, 1, 2, 3, 4]);
        assert_eq!(found, expected);
        assert_eq!(cloud(b"ply", 2.0), None);
        assert_eq!(trajectory("1.5 1\n", 2.0), None);
    }
}
