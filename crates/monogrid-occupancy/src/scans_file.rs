//! `.scans` files: posed point scans, as benchmarks exchange them.
//!
//! Little endian: `u32 0x4f474d31`, `u32` number of scans; per scan `f64[12]` world_from_sensor
//! (3 x 4, row major), `u32 n`, then n times `f32` x, y, z in the sensor frame and `f32` sigma.

use std::io::{BufReader, ErrorKind, Read};

use crate::error::MapError;
use crate::scan::{PointScan, PoseSigma, Scan, ScanData, Similarity};

const MAGIC: u32 = 0x4f47_4d31;
const FORMAT: &str = ".scans";
const BYTES_PER_POINT: usize = 16;
/// Points read at a time: a damaged count must not allocate more than the file can fill.
const POINTS_PER_READ: usize = 4096;

/// A scan of a `.scans` file.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredScan {
    /// Position in the file.
    pub id: u32,
    /// Pose of the sensor.
    pub world_from_sensor: Similarity,
    /// End points in the sensor frame.
    pub points: Vec<[f32; 3]>,
    /// Standard deviation of each range.
    pub sigmas: Vec<f32>,
}

impl StoredScan {
    /// The scan for [`crate::integrate`], without pose uncertainty.
    #[must_use]
    pub fn as_scan(&self) -> Scan<'_> {
        Scan {
            id: self.id,
            world_from_sensor: self.world_from_sensor,
            pose_sigma: PoseSigma::default(),
            data: ScanData::Points(PointScan {
                points: &self.points,
                sigmas: &self.sigmas,
            }),
        }
    }
}

/// Reads a `.scans` file scan by scan.
#[derive(Debug)]
pub struct ScansReader<R: Read> {
    input: BufReader<R>,
    scans: u32,
    next: u32,
}

impl<R: Read> ScansReader<R> {
    /// Opens a stream and reads its header.
    ///
    /// # Errors
    /// The stream is not a `.scans` file.
    pub fn new(input: R) -> Result<Self, MapError> {
        let mut input = BufReader::with_capacity(1 << 16, input);
        let magic = u32::from_le_bytes(read_array(&mut input)?);
        if magic != MAGIC {
            return Err(MapError::format(
                FORMAT,
                format!("it begins with {magic:#010x}, expected {MAGIC:#010x}"),
            ));
        }
        let scans = u32::from_le_bytes(read_array(&mut input)?);
        Ok(Self {
            input,
            scans,
            next: 0,
        })
    }

    /// Scans that the header promises.
    #[must_use]
    pub fn len(&self) -> u32 {
        self.scans
    }

    /// Whether the header promises no scan.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.scans == 0
    }

    fn read_scan(&mut self) -> Result<StoredScan, MapError> {
        let mut rows = [[0.0; 4]; 3];
        for value in rows.iter_mut().flatten() {
            *value = f64::from_le_bytes(read_array(&mut self.input)?);
        }
        let mut left = u32::from_le_bytes(read_array(&mut self.input)?) as usize;
        let (mut points, mut sigmas) = (Vec::new(), Vec::new());
        let mut bytes = [0; POINTS_PER_READ * BYTES_PER_POINT];
        while left > 0 {
            let count = left.min(POINTS_PER_READ);
            let bytes = &mut bytes[..count * BYTES_PER_POINT];
            read_exact(&mut self.input, bytes)?;
            for point in bytes.chunks_exact(BYTES_PER_POINT) {
                let value = |i: usize| {
                    f32::from_le_bytes([
                        point[4 * i],
                        point[4 * i + 1],
                        point[4 * i + 2],
                        point[4 * i + 3],
                    ])
                };
                points.push([value(0), value(1), value(2)]);
                sigmas.push(value(3));
            }
            left -= count;
        }
        Ok(StoredScan {
            id: self.next,
            world_from_sensor: Similarity::from_rigid_rows(rows),
            points,
            sigmas,
        })
    }
}

impl<R: Read> Iterator for ScansReader<R> {
    type Item = Result<StoredScan, MapError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next >= self.scans {
            return None;
        }
        let scan = self.read_scan();
        self.next = if scan.is_ok() {
            self.next + 1
        } else {
            self.scans
        };
        Some(scan)
    }
}

fn read_exact(input: &mut impl Read, bytes: &mut [u8]) -> Result<(), MapError> {
    input.read_exact(bytes).map_err(|source| {
        if source.kind() == ErrorKind::UnexpectedEof {
            MapError::format(FORMAT, "the file ends in the middle of a scan")
        } else {
            MapError::Io {
                action: "reading the scans",
                source,
            }
        }
    })
}

fn read_array<const N: usize>(input: &mut impl Read) -> Result<[u8; N], MapError> {
    let mut bytes = [0; N];
    read_exact(input, &mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> Vec<u8> {
        let mut file = Vec::new();
        file.extend(MAGIC.to_le_bytes());
        file.extend(1_u32.to_le_bytes());
        for value in [
            1.0, 0.0, 0.0, 5.0, 0.0, 1.0, 0.0, 6.0, 0.0, 0.0, 1.0, 7.0_f64,
        ] {
            file.extend(value.to_le_bytes());
        }
        file.extend(2_u32.to_le_bytes());
        for value in [1.0, 2.0, 3.0, 0.1, 4.0, 5.0, 6.0, 0.2_f32] {
            file.extend(value.to_le_bytes());
        }
        file
    }

    #[test]
    fn scans_come_back_as_written() {
        let file = file();
        let scans: Vec<_> = ScansReader::new(&file[..]).unwrap().collect();
        assert_eq!(scans.len(), 1);
        let scan = scans[0].as_ref().unwrap();
        assert_eq!(scan.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(scan.sigmas, [0.1, 0.2]);
        assert_eq!(scan.world_from_sensor.translation, [5.0, 6.0, 7.0]);
    }

    #[test]
    fn every_truncation_is_an_error_and_a_huge_count_allocates_nothing() {
        let file = file();
        for end in 0..file.len() {
            let scans: Result<Vec<_>, _> =
                ScansReader::new(&file[..end]).and_then(Iterator::collect);
            assert!(scans.is_err(), "{end} bytes were accepted");
        }
        let mut huge = file;
        huge[104..108].copy_from_slice(&u32::MAX.to_le_bytes());
        let scan = ScansReader::new(&huge[..]).unwrap().next().unwrap();
        assert!(scan.is_err());
    }
}
