//! Random scenes for the property tests.

use monogrid_occupancy::*;

/// A small deterministic generator.
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A rotation from a random quaternion.
    pub fn rotation(&mut self) -> [[f64; 3]; 3] {
        let mut q = [0; 4].map(|_| self.between(-1.0, 1.0));
        let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt().max(1e-3);
        q = q.map(|c| c / norm);
        let [w, x, y, z] = q;
        [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ]
    }

    pub fn pose(&mut self, spread: f64) -> Similarity {
        Similarity {
            scale: 1.0,
            rotation: self.rotation(),
            translation: [0; 3].map(|_| self.between(-spread, spread)),
        }
    }
}

/// A scan that owns its points.
#[derive(Clone)]
pub struct OwnedScan {
    pub id: u32,
    pub pose: Similarity,
    pub points: Vec<[f32; 3]>,
    pub sigmas: Vec<f32>,
}

impl OwnedScan {
    pub fn borrow(&self) -> Scan<'_> {
        Scan {
            id: self.id,
            world_from_sensor: self.pose,
            pose_sigma: PoseSigma {
                translation: 0.01,
                rotation_rad: 0.002,
            },
            data: ScanData::Points(PointScan {
                points: &self.points,
                sigmas: &self.sigmas,
            }),
        }
    }
}

/// The inside of a box of `half` map units around the origin, seen by a camera of about 80
/// degrees, with noise, outliers and points that are no measurement at all.
pub fn room_scan(random: &mut Random, id: u32, points: usize, half: f64) -> OwnedScan {
    let pose = random.pose(0.4 * half);
    let mut scan = OwnedScan {
        id,
        pose,
        points: Vec::new(),
        sigmas: Vec::new(),
    };
    for i in 0..points {
        let direction = [random.between(-0.8, 0.8), random.between(-0.6, 0.6), 1.0];
        let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt();
        let unit = direction.map(|c| c / norm);
        let in_world = pose.rotate(unit);
        let to_wall = (0..3)
            .map(|a| (half.copysign(in_world[a]) - pose.translation[a]) / in_world[a])
            .fold(f64::MAX, f64::min);
        let sigma = if i % 3 == 0 { 0.05 } else { 0.02 };
        let mut range = (to_wall + sigma * random.between(-2.0, 2.0)).max(0.05);
        if i % 50 == 7 {
            range *= random.between(0.2, 1.5);
        }
        scan.points.push(unit.map(|c| (c * range) as f32));
        scan.sigmas.push(sigma as f32);
        if i % 97 == 13 {
            scan.points.push([f32::NAN, 0.0, 1.0]);
            scan.sigmas.push(0.02);
        }
    }
    scan
}

/// Damaged copies of a file, the same ones every time: changed bits and bytes, extreme numbers,
/// cuts, repeated and removed stretches.
pub fn mutations(file: &[u8], count: usize) -> impl Iterator<Item = Vec<u8>> + '_ {
    let mut random = Random(file.len() as u64 + 17);
    (0..count).map(move |_| {
        let mut bytes = file.to_vec();
        for _ in 0..=(random.unit() * 3.0) as usize {
            let at = (random.unit() * bytes.len() as f64) as usize;
            let end = (at + 1 + (random.unit() * 24.0) as usize).min(bytes.len());
            match (random.unit() * 6.0) as usize {
                _ if bytes.is_empty() => {}
                0 => bytes[at] ^= 1 << (random.unit() * 8.0) as u32,
                1 => bytes[at] = (random.unit() * 256.0) as u8,
                2 => bytes[at..end.min(at + 4)].fill(255),
                3 => bytes[at..end.min(at + 8)].fill(0),
                4 => drop(bytes.drain(at..end)),
                _ => {
                    let stretch = bytes[at..end].to_vec();
                    bytes.splice(at..at, stretch);
                }
            }
            if random.unit() < 0.05 {
                bytes.truncate(at);
            }
        }
        bytes
    })
}
