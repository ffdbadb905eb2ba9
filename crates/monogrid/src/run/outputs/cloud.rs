//! The semi-dense cloud as a file.

use crate::explorer::{CloudPoint, PosedKeyframe, SemiDense, num_measured};
use crate::failure::Failure;
use crate::output::OutputFolder;
use monogrid_geometry::Pinhole;

/// Points in the file at most; of more, they are taken evenly.
const MAX_POINTS: usize = 2_000_000;

/// Writes `cloud.ply`, binary little-endian PLY: what was measured in the keyframes, with grey level and confidence.
///
/// `semi_dense` is in the order of the keyframes' identities.
pub fn write_cloud(
    folder: &OutputFolder,
    keyframes: &[PosedKeyframe],
    semi_dense: &[SemiDense],
    pinhole: &Pinhole,
    unit: &str,
) -> Result<(), Failure> {
    let measured = num_measured(semi_dense);
    let every = measured.div_ceil(MAX_POINTS).max(1);
    let points = || {
        let all = keyframes.iter().filter_map(|(keyframe, pose)| {
            let index = semi_dense.binary_search_by_key(&keyframe.id, |of| of.id);
            let measured = &semi_dense[index.ok()?];
            Some(measured.points(Some(&keyframe.image), pinhole, pose))
        });
        all.flatten().step_by(every)
    };
    folder.write_with("cloud.ply", |out| {
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\ncomment lengths in {unit}\ncomment one of {every} measured points\n\
             element vertex {}\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
             property uchar green\nproperty uchar blue\nproperty float confidence\nend_header\n",
            points().count()
        )?;
        for point in points() {
            out.write_all(&row(&point))?;
        }
        Ok(())
    })
}

fn row(point: &CloudPoint) -> [u8; 19] {
    let mut row = [point.grey; 19];
    for (bytes, value) in row.chunks_exact_mut(4).zip(point.point) {
        bytes.copy_from_slice(&value.to_le_bytes());
    }
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
            grey: 9,
            confidence: 0.5,
        };
        let row = row(&point);
        assert_eq!(row[4..8], 2.0f32.to_le_bytes());
        assert_eq!(row[8..12], (-3.0f32).to_le_bytes());
        assert_eq!(row[12..15], [9, 9, 9]);
        assert_eq!(row[15..], 0.5f32.to_le_bytes());
    }
}
