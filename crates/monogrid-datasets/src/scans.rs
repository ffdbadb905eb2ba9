//! `.scans` files: posed point clouds with the standard deviation of each range.

use crate::DatasetError;
use crate::files::open_file;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

const MAGIC: u32 = 0x4f47_4d31;
/// Pose and number of points of a scan.
const SCAN_HEADER_BYTES: u64 = 12 * 8 + 4;
const POINT_BYTES: u64 = 16;

/// A measured point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanPoint {
    /// Position in the sensor's frame, metres.
    pub point_in_sensor: [f32; 3],
    /// Standard deviation of the range, metres.
    pub range_sigma: f32,
}

/// One scan.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Scan {
    /// Sensor to world, 3x4 row-major.
    pub world_from_sensor: [f64; 12],
    /// The points; values are as written, not checked.
    pub points: Vec<ScanPoint>,
}

/// Reads the scans of a file one by one.
#[derive(Debug)]
pub struct ScansReader<R = BufReader<File>> {
    input: R,
    path: PathBuf,
    num_scans: u32,
    next_index: u32,
    remaining_bytes: u64,
}

impl ScansReader {
    /// Opens a file.
    ///
    /// # Errors
    /// When it cannot be read or does not start like a scan file.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        let (file, length) = open_file(path)?;
        Self::new(BufReader::with_capacity(1 << 18, file), length, path)
    }
}

impl<R: Read> ScansReader<R> {
    /// Reads from anything of known length; `path` is only for messages.
    ///
    /// # Errors
    /// When the input does not start like a scan file.
    pub fn new(mut input: R, length_bytes: u64, path: &Path) -> Result<Self, DatasetError> {
        let wrong = |reason: String| DatasetError::binary(path, "scan file", reason);
        let mut header = [0; 8];
        input
            .read_exact(&mut header)
            .map_err(|_| wrong(format!("{length_bytes} bytes are less than its header")))?;
        let [a, b, c, d, num @ ..] = header;
        if u32::from_le_bytes([a, b, c, d]) != MAGIC {
            return Err(wrong("it does not start with 0x4f474d31".to_owned()));
        }
        let num_scans = u32::from_le_bytes(num);
        let remaining_bytes = length_bytes.saturating_sub(8);
        if u64::from(num_scans) * SCAN_HEADER_BYTES > remaining_bytes {
            return Err(wrong(format!(
                "{num_scans} scans do not fit into {length_bytes} bytes (truncated?)"
            )));
        }
        Ok(Self {
            input,
            path: path.to_path_buf(),
            num_scans,
            next_index: 0,
            remaining_bytes,
        })
    }

    fn read_scan(&mut self) -> Result<Scan, String> {
        let truncated = |_| "the file ends inside it".to_owned();
        let mut header = [0; SCAN_HEADER_BYTES as usize];
        self.input.read_exact(&mut header).map_err(truncated)?;
        self.remaining_bytes = self.remaining_bytes.saturating_sub(SCAN_HEADER_BYTES);
        let (pose, count) = header.as_chunks::<8>();
        let world_from_sensor: [f64; 12] = std::array::from_fn(|k| f64::from_le_bytes(pose[k]));
        let count = u64::from(u32::from_le_bytes([count[0], count[1], count[2], count[3]]));
        // checked before anything is allocated
        if count * POINT_BYTES > self.remaining_bytes {
            return Err(format!(
                "{count} points do not fit into the {} bytes left",
                self.remaining_bytes
            ));
        }
        let mut bytes = vec![0; (count * POINT_BYTES) as usize];
        self.input.read_exact(&mut bytes).map_err(truncated)?;
        self.remaining_bytes -= count * POINT_BYTES;
        if world_from_sensor.iter().any(|v| !v.is_finite()) {
            return Err("its pose is not finite".to_owned());
        }
        let point = |bytes: &[u8; 16]| {
            let values = bytes.as_chunks::<4>().0;
            let value = |k: usize| f32::from_le_bytes(values[k]);
            ScanPoint {
                point_in_sensor: [value(0), value(1), value(2)],
                range_sigma: value(3),
            }
        };
        let points = bytes.as_chunks::<16>().0.iter();
        Ok(Scan {
            world_from_sensor,
            points: points.map(point).collect(),
        })
    }
}

impl<R: Read> Iterator for ScansReader<R> {
    type Item = Result<Scan, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next_index >= self.num_scans {
            return None;
        }
        let index = self.next_index;
        self.next_index += 1;
        Some(self.read_scan().map_err(|reason| {
            // nothing behind a broken scan can be trusted
            self.next_index = self.num_scans;
            let reason = format!("scan {index} of {}: {reason}", self.num_scans);
            DatasetError::binary(&self.path, "scan file", reason)
        }))
    }
}
