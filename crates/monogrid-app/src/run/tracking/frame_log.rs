//! What became of the frames of a run, kept on disk while the run goes on: memory does not grow
//! with its length.

use crate::process::failure::{Classify, Failure};
use crate::run::tracking::frames::FrameRow;
use anyhow::Context;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Rows that are written at once.
const BLOCK: usize = 256;

/// The rows of a run in their order: the last ones in memory, those before in a file without a
/// name, which is gone with the program however that ends.
#[derive(Debug)]
pub struct FrameLog {
    /// `None`: it cannot be written, and all rows that come stay in memory.
    file: Option<File>,
    /// Where what was written whole ends, bytes.
    written: u64,
    recent: Vec<FrameRow>,
}

impl FrameLog {
    /// No rows yet; the file lies on the disk of `folder`.
    pub fn begin(folder: &Path) -> Self {
        Self {
            file: tempfile::tempfile_in(folder).ok(),
            written: 0,
            recent: Vec::with_capacity(BLOCK),
        }
    }

    /// Adds the next frame.
    pub fn push(&mut self, row: FrameRow) {
        self.recent.push(row);
        if self.recent.len() >= BLOCK
            && let Some(file) = &mut self.file
        {
            match write_block(file, self.written, &self.recent) {
                Ok(bytes) => {
                    self.written += bytes;
                    self.recent.clear();
                }
                // a full disk
                Err(_) => self.stay_in_memory(),
            }
        }
    }

    /// Reads what was written whole back into memory, where all rows stay from now on; where that
    /// fails too, nothing changes, and the next row is another attempt.
    fn stay_in_memory(&mut self) {
        if let Ok(mut rows) = self.read_back() {
            rows.append(&mut self.recent);
            self.recent = rows;
            self.file = None;
        }
    }

    /// The rows in the file.
    fn read_back(&mut self) -> anyhow::Result<Vec<FrameRow>> {
        let mut rows = Vec::new();
        let Some(file) = &mut self.file else {
            return Ok(rows);
        };
        file.rewind()?;
        let mut bytes = Vec::new();
        file.take(self.written).read_to_end(&mut bytes)?;
        let mut rest = bytes.as_slice();
        while !rest.is_empty() {
            let (row, after) = postcard::take_from_bytes(rest).context("a damaged row")?;
            rows.push(row);
            rest = after;
        }
        Ok(rows)
    }

    /// All rows.
    pub fn finish(&mut self) -> Result<Vec<FrameRow>, Failure> {
        let mut rows = self
            .read_back()
            .while_running("what became of the frames cannot be read back from the disk")?;
        rows.append(&mut self.recent);
        Ok(rows)
    }
}

/// Writes rows one after the other, from byte `begin` on; how many bytes they are.
fn write_block(file: &mut File, begin: u64, rows: &[FrameRow]) -> io::Result<u64> {
    file.seek(SeekFrom::Start(begin))?;
    let mut bytes = Vec::new();
    for row in rows {
        bytes = postcard::to_extend(row, bytes).map_err(io::Error::other)?;
    }
    file.write_all(&bytes)?;
    Ok(bytes.len() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::tracking::frames::FrameFate;
    use monogrid_geometry::{Se3, Vec6};
    use monogrid_slam::{FrameReport, InFragment, LostReason, TrackingState};

    /// A row of every kind, one after the other.
    fn row(index: usize) -> FrameRow {
        let pose = Se3::exp(&(Vec6::new(0.1, -2.0, 3e5, 0.3, -1e-9, 1.2) * (index as f64 + 0.37)));
        let mut report = FrameReport::new(index, -7, TrackingState::Fragment);
        report.world_from_camera = Some(pose);
        report.odom_from_camera = index.is_multiple_of(2).then(|| pose.inverse());
        report.reason = Some(LostReason::Jump);
        report.residual = f32::NAN;
        report.milliseconds.depth = 0.1 + index as f64;
        report.joined_fragments = vec![3, 4];
        report.fragment = Some(InFragment {
            id: 2,
            fragment_from_camera: pose,
        });
        FrameRow {
            index,
            timestamp_ns: i64::MIN + index as i64,
            fate: match index % 4 {
                0 => FrameFate::Skipped("a \"reason\", 中".to_owned()),
                1 => FrameFate::Repeated,
                2 => FrameFate::Dropped,
                _ => FrameFate::Processed(Box::new(report)),
            },
            latency_ms: index.is_multiple_of(3).then_some(0.1 + index as f32),
        }
    }

    fn described(rows: &[FrameRow]) -> Vec<String> {
        rows.iter().map(|row| format!("{row:?}")).collect()
    }

    #[test]
    fn rows_come_back_as_they_were_and_do_not_stay_in_memory() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut log = FrameLog::begin(folder.path());
        let rows: Vec<_> = (0..3 * BLOCK + 7).map(row).collect();
        for row in &rows {
            log.push(row.clone());
            assert!(log.recent.len() < BLOCK);
        }
        assert_eq!(
            std::fs::read_dir(folder.path())
                .expect("the folder")
                .count(),
            0,
            "the file has no name"
        );
        assert_eq!(
            described(&log.finish().expect("the rows")),
            described(&rows)
        );
    }

    #[test]
    fn a_disk_that_fails_loses_no_row() {
        let folder = tempfile::tempdir().expect("a folder");
        let rows: Vec<_> = (0..3 * BLOCK).map(row).collect();
        // no folder at all
        let mut log = FrameLog::begin(&folder.path().join("missing"));
        rows.iter().cloned().for_each(|row| log.push(row));
        assert_eq!(
            described(&log.finish().expect("the rows")),
            described(&rows)
        );
        // after a block it cannot be written any more
        let path = folder.path().join("file");
        let mut log = FrameLog::begin(folder.path());
        log.file = Some(File::create_new(&path).expect("a file"));
        rows.iter().take(BLOCK).cloned().for_each(|r| log.push(r));
        log.file = Some(File::open(&path).expect("for reading alone"));
        rows.iter().skip(BLOCK).cloned().for_each(|r| log.push(r));
        assert!(log.file.is_none());
        assert_eq!(
            described(&log.finish().expect("the rows")),
            described(&rows)
        );
    }
}
