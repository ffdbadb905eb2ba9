//! Maps that follow their keyframes: scans can be added in any order, moved, replaced and removed,
//! and the map always equals one built from scratch of the scans it has, in the order of their ids,
//! bit for bit.
//!
//! Every brick is a function of the scans that see it, in the order of their ids. A scan newer
//! than all others is added to the map; any other change rebuilds the bricks that the changed scans
//! see (where they were and where they are) from all scans that see them. Evidence is clamped when
//! it is written, so it cannot be subtracted.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::error::MapError;
use crate::evidence::UNKNOWN;
use crate::integrate::{
    IntegrationConfig, IntegrationReport, bricks_seen, integrate, integrate_where,
};
use crate::key::{BRICK_CELLS, BrickKey};
use crate::map::{MapConfig, OccupancyMap};
use crate::scan::{DepthPixel, DepthScan, PointScan, PoseSigma, Scan, ScanData, Similarity};

/// Bricks along the edge of the groups that a scan's footprint is kept in, as a power of two.
const GROUP_LEVEL: u32 = 2;

/// The measurements of a scan, owned.
#[derive(Clone, Debug)]
enum OwnedData {
    Points {
        points: Vec<[f32; 3]>,
        sigmas: Vec<f32>,
    },
    /// The camera and an empty list of pixels; the pixels.
    Depth(DepthScan<'static>, Vec<DepthPixel>),
}

/// One keyframe at its pose.
#[derive(Clone, Debug)]
struct Keyframe {
    id: u32,
    world_from_sensor: Similarity,
    pose_sigma: PoseSigma,
    data: Arc<OwnedData>,
    /// Groups of bricks that the scan sees, sorted.
    groups: Arc<Vec<u64>>,
}

impl Keyframe {
    fn new(scan: &Scan) -> Self {
        let data = match scan.data {
            ScanData::Points(scan) => OwnedData::Points {
                points: scan.points.to_vec(),
                sigmas: scan.sigmas.to_vec(),
            },
            ScanData::Depth(scan) => {
                let camera = DepthScan {
                    pixels: &[],
                    width: scan.width,
                    height: scan.height,
                    fx: scan.fx,
                    fy: scan.fy,
                    cx: scan.cx,
                    cy: scan.cy,
                };
                OwnedData::Depth(camera, scan.pixels.to_vec())
            }
        };
        Self {
            id: scan.id,
            world_from_sensor: scan.world_from_sensor,
            pose_sigma: scan.pose_sigma,
            data: Arc::new(data),
            groups: Arc::default(),
        }
    }

    fn scan(&self) -> Scan<'_> {
        let data = match &*self.data {
            OwnedData::Points { points, sigmas } => ScanData::Points(PointScan { points, sigmas }),
            OwnedData::Depth(camera, pixels) => ScanData::Depth(DepthScan { pixels, ..*camera }),
        };
        Scan {
            id: self.id,
            world_from_sensor: self.world_from_sensor,
            pose_sigma: self.pose_sigma,
            data,
        }
    }
}

/// A change of the keyframes of a [`KeyframeMap`].
#[derive(Clone, Copy, Debug)]
pub enum KeyframeChange<'a> {
    /// Adds a scan, or puts it in the place of the one with the same id.
    Set(Scan<'a>),
    /// Moves a keyframe; one that is not there is left alone.
    Move {
        /// Id of the scan.
        id: u32,
        /// Its new pose.
        world_from_sensor: Similarity,
    },
    /// Takes a keyframe out; one that is not there is left alone.
    Remove {
        /// Id of the scan.
        id: u32,
    },
}

/// A map and the keyframes it is made of.
#[derive(Clone, Debug)]
pub struct KeyframeMap {
    map: OccupancyMap,
    config: IntegrationConfig,
    keyframes: BTreeMap<u32, Keyframe>,
    threads: usize,
}

impl KeyframeMap {
    /// An empty map whose keyframes are integrated with `config` on `threads` threads.
    ///
    /// # Errors
    /// A setting outside its documented range.
    pub fn new(
        map: MapConfig,
        config: IntegrationConfig,
        threads: usize,
    ) -> Result<Self, MapError> {
        config.validate()?;
        Ok(Self {
            map: OccupancyMap::new(map)?,
            config,
            keyframes: BTreeMap::new(),
            threads: threads.max(1),
        })
    }

    /// The map as it is now.
    #[must_use]
    pub fn map(&self) -> &OccupancyMap {
        &self.map
    }

    /// The map, without its keyframes.
    #[must_use]
    pub fn into_map(self) -> OccupancyMap {
        self.map
    }

    /// Ids of the keyframes in the map, ascending.
    pub fn ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.keyframes.keys().copied()
    }

    /// Adds or replaces one keyframe: [`KeyframeMap::apply`] of one [`KeyframeChange::Set`].
    ///
    /// # Errors
    /// As [`KeyframeMap::apply`].
    pub fn set(&mut self, scan: &Scan) -> Result<(), MapError> {
        self.apply(&[KeyframeChange::Set(*scan)]).map(|_| ())
    }

    /// Makes changes, one after the other, with a single rebuild of the bricks concerned.
    ///
    /// Returns how many bricks were built anew; 0 where scans were only added at the end.
    ///
    /// # Errors
    /// An invalid scan or pose, or the memory budget could be exceeded; map and keyframes are then
    /// as before.
    pub fn apply(&mut self, changes: &[KeyframeChange]) -> Result<usize, MapError> {
        if let [KeyframeChange::Set(scan)] = changes
            && self
                .keyframes
                .keys()
                .next_back()
                .is_none_or(|last| *last < scan.id)
        {
            self.append(scan)?;
            return Ok(0);
        }
        let mut keyframes = self.keyframes.clone();
        let mut dirty = Vec::new();
        for change in changes {
            let id = match change {
                KeyframeChange::Set(scan) => scan.id,
                KeyframeChange::Move { id, .. } | KeyframeChange::Remove { id } => *id,
            };
            let old = keyframes.remove(&id);
            let new = match (change, &old) {
                (KeyframeChange::Set(scan), _) => Some(Keyframe::new(scan)),
                (
                    KeyframeChange::Move {
                        world_from_sensor, ..
                    },
                    Some(old),
                ) => Some(Keyframe {
                    world_from_sensor: *world_from_sensor,
                    ..old.clone()
                }),
                (KeyframeChange::Move { .. }, None) | (KeyframeChange::Remove { .. }, _) => None,
            };
            let is_same = matches!((change, &old, &new), (KeyframeChange::Move { .. }, Some(old), Some(new))
                if old.world_from_sensor == new.world_from_sensor);
            if is_same {
                keyframes.extend(old.map(|old| (id, old)));
                continue;
            }
            if let Some(old) = old {
                dirty.extend(self.seen_by(&old)?);
            }
            if let Some(mut new) = new {
                let seen = self.seen_by(&new)?;
                new.groups = Arc::new(groups_of(&seen));
                dirty.extend(seen);
                keyframes.insert(id, new);
            }
        }
        dirty.sort_unstable();
        dirty.dedup();
        self.rebuild(&dirty, &keyframes)?;
        self.keyframes = keyframes;
        Ok(dirty.len())
    }

    /// A scan after all others: the map without it is what it is added to.
    fn append(&mut self, scan: &Scan) -> Result<IntegrationReport, MapError> {
        scan.validate()?;
        let mut keyframe = Keyframe::new(scan);
        keyframe.groups = Arc::new(groups_of(&self.seen_by(&keyframe)?));
        let report = integrate(&mut self.map, scan, &self.config, self.threads)?;
        self.keyframes.insert(scan.id, keyframe);
        Ok(report)
    }

    /// Packed keys of the bricks that a keyframe can change, sorted.
    fn seen_by(&self, keyframe: &Keyframe) -> Result<Vec<u64>, MapError> {
        let scan = keyframe.scan();
        scan.validate()?;
        bricks_seen(&self.map, &scan, &self.config, self.threads)
    }

    /// Builds bricks anew from the keyframes that see them; on an error they are put back.
    fn rebuild(
        &mut self,
        dirty: &[u64],
        keyframes: &BTreeMap<u32, Keyframe>,
    ) -> Result<(), MapError> {
        if dirty.is_empty() {
            return Ok(());
        }
        let keys: Vec<BrickKey> = dirty.iter().map(|&key| BrickKey::unpack(key)).collect();
        let known: Vec<(BrickKey, [i16; BRICK_CELLS])> = keys
            .iter()
            .map(|&key| (key, self.map.brick_values(key)))
            .filter(|(_, values)| values.iter().any(|&v| v != UNKNOWN))
            .collect();
        self.map.check_budget(dirty.len(), 0)?;
        self.map.revision += 1;
        for (key, _) in &known {
            self.map.set_brick_uniform(*key, UNKNOWN);
        }
        let groups = groups_of(dirty);
        for keyframe in keyframes.values().filter(|k| intersect(&k.groups, &groups)) {
            let (scan, only) = (keyframe.scan(), Some(dirty));
            if let Err(error) =
                integrate_where(&mut self.map, &scan, &self.config, self.threads, only)
            {
                for &key in &keys {
                    self.map.set_brick_uniform(key, UNKNOWN);
                }
                for (key, values) in &known {
                    self.map.set_brick(*key, values);
                }
                return Err(error);
            }
        }
        Ok(())
    }
}

/// The groups that hold the bricks, sorted.
fn groups_of(bricks: &[u64]) -> Vec<u64> {
    let mut groups: Vec<u64> = bricks
        .iter()
        .map(|&key| {
            let BrickKey { x, y, z } = BrickKey::unpack(key);
            BrickKey::new(x >> GROUP_LEVEL, y >> GROUP_LEVEL, z >> GROUP_LEVEL).pack()
        })
        .collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// Whether two sorted lists have a common element.
fn intersect(a: &[u64], b: &[u64]) -> bool {
    let (few, many) = if a.len() < b.len() { (a, b) } else { (b, a) };
    few.iter().any(|key| many.binary_search(key).is_ok())
}
