//! The semi-dense cloud as a file.

use crate::output::OutputFolder;
use crate::process::failure::Failure;
use monogrid_report::colours::Colours;
use monogrid_report::explorer::{CloudPoint, ShownKeyframe, measured_in};

/// Points in the file at most; of more, they are taken evenly.
const MAX_POINTS: usize = 2_000_000;

/// Writes `cloud.ply`, binary little-endian PLY: what was measured in the keyframes, if there are
/// any, with colour and confidence.
pub fn write_cloud(
    folder: &OutputFolder,
    keyframes: &[ShownKeyframe],
    colours: &Colours,
    unit: &str,
) -> Result<(), Failure> {
    if keyframes.is_empty() {
        return Ok(());
    }
    let measured = measured_in(keyframes);
    let every = measured.div_ceil(MAX_POINTS).max(1);
    folder.write_with("cloud.ply", |out| {
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\ncomment lengths in {unit}\ncomment one of \
             {every} measured points\nelement vertex {}\nproperty float x\nproperty float y\n\
             property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
             property float confidence\nend_header\n",
            measured.div_ceil(every)
        )?;
        let points = keyframes.iter().flat_map(|k| k.points(colours));
        for point in points.step_by(every) {
            out.write_all(&row(&point))?;
        }
        Ok(())
    })
}

fn row(point: &CloudPoint) -> [u8; 19] {
    let mut row = [0; 19];
    for (bytes, value) in row.chunks_exact_mut(4).zip(point.point) {
        bytes.copy_from_slice(&value.to_le_bytes());
    }
    row[12..15].copy_from_slice(&point.colour);
    row[15..].copy_from_slice(&point.confidence.to_le_bytes());
    row
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_place_colour_and_confidence() {
        let point = CloudPoint {
            point: [1.0, 2.0, -3.0],
            colour: [9, 8, 7],
            confidence: 0.5,
        };
        let row = row(&point);
        assert_eq!(row[4..8], 2.0f32.to_le_bytes());
        assert_eq!(row[8..12], (-3.0f32).to_le_bytes());
        assert_eq!(row[12..15], [9, 8, 7]);
        assert_eq!(row[15..], 0.5f32.to_le_bytes());
    }
}
