//! Maps that follow their keyframes: scans can be added in any order, moved, replaced and removed,
//! and the map always equals one built from scratch of the scans it has, in the order of their ids,
//! bit for bit.
//!
//! Every brick is a function of the scans that see it, in the order of their ids. A scan newer than
//! all others is added to the map; any other change is an [`update::Update`]: a second map in which
//! the bricks that the changed scans see (where they were and where they are) are rebuilt from all
//! scans that see them. Evidence is clamped when it is written, so it cannot be subtracted.
//!
//! The work of an update can be spread over steps of one scan each; until the last, the map is that
//! of before, complete, and grows with new scans.

mod update;

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use self::update::Update;
use crate::error::MapError;
use crate::integrate::{IntegrationConfig, bricks_seen, integrate};
use crate::key::BrickKey;
use crate::map::{MapConfig, OccupancyMap};
use crate::scan::{
    DepthImage, DepthPixel, DepthScan, PointScan, PoseSigma, Scan, ScanData, Similarity,
};

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
    /// The camera and an empty image; depths and sigmas.
    Image(DepthImage<'static>, Vec<f32>, Vec<f32>),
}

/// One keyframe at its pose.
#[derive(Clone, Debug)]
struct Keyframe {
    id: u32,
    world_from_sensor: Similarity,
    pose_sigma: PoseSigma,
    data: Arc<OwnedData>,
    /// Groups of bricks that the scan sees from there, sorted; found when they are needed.
    groups: Arc<OnceLock<Vec<u64>>>,
    /// Measurements that were used when it was last integrated.
    points: usize,
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
            ScanData::Image(image) => {
                let camera = DepthImage {
                    depths: &[],
                    sigmas: &[],
                    width: image.width,
                    height: image.height,
                    fx: image.fx,
                    fy: image.fy,
                    cx: image.cx,
                    cy: image.cy,
                };
                OwnedData::Image(camera, image.depths.to_vec(), image.sigmas.to_vec())
            }
        };
        Self {
            id: scan.id,
            world_from_sensor: scan.world_from_sensor,
            pose_sigma: scan.pose_sigma,
            data: Arc::new(data),
            groups: Arc::default(),
            points: 0,
        }
    }

    fn scan(&self) -> Scan<'_> {
        let data = match &*self.data {
            OwnedData::Points { points, sigmas } => ScanData::Points(PointScan { points, sigmas }),
            OwnedData::Depth(camera, pixels) => ScanData::Depth(DepthScan { pixels, ..*camera }),
            OwnedData::Image(camera, depths, sigmas) => ScanData::Image(DepthImage {
                depths,
                sigmas,
                ..*camera
            }),
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
    /// Shared with those who asked for it; copied when it changes while they hold it.
    map: Arc<OccupancyMap>,
    config: IntegrationConfig,
    keyframes: BTreeMap<u32, Keyframe>,
    threads: usize,
    /// Changes under way.
    update: Option<Update>,
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
            map: Arc::new(OccupancyMap::new(map)?),
            config,
            keyframes: BTreeMap::new(),
            threads: threads.max(1),
            update: None,
        })
    }

    /// Changes the number of threads; results do not depend on it.
    pub fn set_threads(&mut self, threads: usize) {
        self.threads = threads.max(1);
    }

    /// The map as it is now: without the changes of an update that is under way.
    #[must_use]
    pub fn map(&self) -> &OccupancyMap {
        &self.map
    }

    /// The same for another thread. It stays as it is while this map goes on.
    #[must_use]
    pub fn share(&self) -> Arc<OccupancyMap> {
        Arc::clone(&self.map)
    }

    /// The map, without its keyframes.
    #[must_use]
    pub fn into_map(self) -> OccupancyMap {
        Arc::unwrap_or_clone(self.map)
    }

    /// Ids of the keyframes in the map, ascending.
    pub fn ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.keyframes.keys().copied()
    }

    /// Ids of the keyframes in the map, ascending, and how many measurements of each were used.
    pub fn points(&self) -> impl Iterator<Item = (u32, usize)> + '_ {
        self.keyframes.values().map(|k| (k.id, k.points))
    }

    /// Adds or replaces one keyframe: [`KeyframeMap::apply`] of one [`KeyframeChange::Set`].
    ///
    /// A keyframe newer than all others is added at once, also while an update is under way.
    ///
    /// # Errors
    /// As [`KeyframeMap::apply`].
    pub fn set(&mut self, scan: &Scan) -> Result<(), MapError> {
        self.apply(&[KeyframeChange::Set(*scan)]).map(|_| ())
    }

    /// Makes changes, one after the other, with a single rebuild of the bricks concerned; an update
    /// that is under way is finished before.
    ///
    /// Returns how many bricks were built anew; 0 where scans were only added at the end.
    ///
    /// # Errors
    /// An invalid scan or pose, or the memory budget could be exceeded; map and keyframes are then
    /// as before.
    pub fn apply(&mut self, changes: &[KeyframeChange]) -> Result<usize, MapError> {
        if let [KeyframeChange::Set(scan)] = changes
            && self.newest().is_none_or(|newest| newest < scan.id)
        {
            self.append(scan)?;
            return Ok(0);
        }
        self.finish_update()?;
        self.begin_update(changes)?;
        self.finish_update()
    }

    /// Begins to make changes in a second map, which takes the place of the first when
    /// [`KeyframeMap::step_update`] has been called often enough. An update that is under way is
    /// finished before.
    ///
    /// The two maps need twice the memory meanwhile; the budget holds for each.
    ///
    /// # Errors
    /// An invalid scan or pose, or as [`KeyframeMap::step_update`].
    pub fn begin_update(&mut self, changes: &[KeyframeChange]) -> Result<(), MapError> {
        self.finish_update()?;
        self.update = Update::new(&self.keyframes, changes)?;
        Ok(())
    }

    /// Whether an update is under way.
    #[must_use]
    pub fn is_updating(&self) -> bool {
        self.update.is_some()
    }

    /// Goes on with the update: at most one scan is integrated. Returns how many bricks were built
    /// anew when the update is finished (0 if there was none), `None` when there is more to do.
    ///
    /// # Errors
    /// The memory budget could be exceeded; the update is given up, the map stays as before.
    pub fn step_update(&mut self) -> Result<Option<usize>, MapError> {
        let Some(mut update) = self.update.take() else {
            return Ok(Some(0));
        };
        if update.step(self)? {
            return Ok(Some(update.finish(self)));
        }
        self.update = Some(update);
        Ok(None)
    }

    /// Gives up the update that is under way.
    pub fn abandon_update(&mut self) {
        self.update = None;
    }

    /// Goes on with the update to its end.
    fn finish_update(&mut self) -> Result<usize, MapError> {
        loop {
            if let Some(rebuilt) = self.step_update()? {
                return Ok(rebuilt);
            }
        }
    }

    /// The largest id, those of an update that is under way included.
    fn newest(&self) -> Option<u32> {
        let coming = self.update.as_ref().and_then(Update::newest);
        self.keyframes.keys().next_back().copied().max(coming)
    }

    /// A scan after all others: the map without it is what it is added to.
    fn append(&mut self, scan: &Scan) -> Result<(), MapError> {
        scan.validate()?;
        let mut keyframe = Keyframe::new(scan);
        let map = Arc::make_mut(&mut self.map);
        keyframe.points = integrate(map, scan, &self.config, self.threads)?.points;
        self.keyframes.insert(scan.id, keyframe);
        Ok(())
    }

    /// Packed keys of the bricks that a keyframe can change, sorted.
    fn seen_by(&self, keyframe: &Keyframe) -> Result<Vec<u64>, MapError> {
        let seen = bricks_seen(&self.map, &keyframe.scan(), &self.config, self.threads)?;
        keyframe.groups.get_or_init(|| groups_of(&seen));
        Ok(seen)
    }

    /// Whether a keyframe may change bricks of some groups (sorted).
    fn may_change(&self, keyframe: &Keyframe, groups: &[u64]) -> Result<bool, MapError> {
        if keyframe.groups.get().is_none() {
            self.seen_by(keyframe)?;
        }
        let own = keyframe.groups.get();
        Ok(own.is_none_or(|own| intersect(own, groups)))
    }
}

/// The groups that hold the bricks, sorted.
fn groups_of(bricks: &[u64]) -> Vec<u64> {
    let group = |key: &u64| {
        let BrickKey { x, y, z } = BrickKey::unpack(*key);
        BrickKey::new(x >> GROUP_LEVEL, y >> GROUP_LEVEL, z >> GROUP_LEVEL).pack()
    };
    let mut groups: Vec<u64> = bricks.iter().map(group).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// Whether two sorted lists have a common element.
fn intersect(a: &[u64], b: &[u64]) -> bool {
    let (few, many) = if a.len() < b.len() { (a, b) } else { (b, a) };
    few.iter().any(|key| many.binary_search(key).is_ok())
}
