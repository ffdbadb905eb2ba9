//! The *global* map: every keyframe where the graph has it.

use super::mapper::{MapStats, Mapper, similarity};
use crate::KeyframeScan;
use monogrid_geometry::{Sim3, Vec2, Vec3};
use monogrid_occupancy::{KeyframeChange, KeyframeMap, MapError, OccupancyMap};
use monogrid_slam::{KeyframeId, PoseSnapshot};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A map that follows the poses of its keyframes, a bounded piece of work at a time.
///
/// The map always holds every keyframe exactly once, at the poses of one revision (but for those
/// that moved less than the threshold since they were last integrated).
#[derive(Debug)]
pub(super) struct GlobalMap {
    pub map: KeyframeMap,
    map_from_world: Sim3,
    placed: BTreeMap<KeyframeId, Placed>,
    /// Better depth that is not in the map yet.
    revised: BTreeMap<KeyframeId, KeyframeScan>,
    /// Where keyframes should be; those without a pose stay where they are.
    pub wanted: Arc<PoseSnapshot>,
    /// Revision of the poses that the map shows.
    pub revision: u64,
    /// What the update under way leads to.
    coming: Option<Coming>,
    /// Updates that came about.
    num_updates: u64,
}

/// A keyframe as it is in the map.
#[derive(Clone, Copy, Debug)]
struct Placed {
    map_from_keyframe: Sim3,
    num_filled: usize,
    reach: Reach,
}

#[derive(Debug, Default)]
struct Coming {
    revision: u64,
    placed: BTreeMap<KeyframeId, Placed>,
    revised: BTreeMap<KeyframeId, KeyframeScan>,
}

impl GlobalMap {
    /// An empty map in the frame given by `map_from_world`.
    pub fn new(mapper: &Mapper, map_from_world: Sim3) -> Result<Self, MapError> {
        let config = mapper.config().map_config();
        Ok(Self {
            map: KeyframeMap::new(config, mapper.integration.clone(), mapper.threads)?,
            map_from_world,
            placed: BTreeMap::new(),
            revised: BTreeMap::new(),
            wanted: Arc::default(),
            revision: 0,
            coming: None,
            num_updates: 0,
        })
    }

    /// Grows when what the map shows, or its revision, changes by [`GlobalMap::step`].
    pub fn version(&self) -> (u64, u64) {
        (self.revision, self.num_updates)
    }

    /// Adds a keyframe where it is now; cheapest when it is newer than all others.
    pub fn add(
        &mut self,
        mapper: &Mapper,
        scan: &KeyframeScan,
        world_from_keyframe: &Sim3,
    ) -> Result<(), MapError> {
        let map_from_keyframe = self.map_from_world * *world_from_keyframe;
        self.map
            .set(&mapper.scan(scan, &scan.pixels(), &map_from_keyframe))?;
        let placed = Placed::new(scan, map_from_keyframe);
        self.placed.insert(scan.id, placed);
        Ok(())
    }

    /// Takes better depth of a keyframe that was added before.
    pub fn revise(&mut self, scan: KeyframeScan) {
        if self.placed.contains_key(&scan.id) {
            self.revised.insert(scan.id, scan);
        }
    }

    /// Does a bounded piece of work, at most the integration of one keyframe, towards the newest
    /// poses and depths; `false` when there is nothing to do.
    pub fn step(&mut self, mapper: &Mapper) -> Result<bool, MapError> {
        let threshold = mapper.config().follow_threshold * mapper.config().resolution;
        self.step_beyond(mapper, threshold)
    }

    fn step_beyond(&mut self, mapper: &Mapper, threshold: f64) -> Result<bool, MapError> {
        if let Some(coming) = self.coming.take() {
            match self.map.step_update() {
                Ok(None) => self.coming = Some(coming),
                Ok(Some(_)) => {
                    self.revision = coming.revision;
                    self.num_updates += 1;
                    self.placed.extend(coming.placed);
                }
                Err(error) => {
                    self.take_back(coming);
                    return Err(error);
                }
            }
            return Ok(true);
        }
        let coming = Coming {
            revision: self.wanted.revision,
            placed: self.to_place(mapper, threshold),
            revised: std::mem::take(&mut self.revised),
        };
        if coming.placed.is_empty() {
            self.revision = coming.revision;
            return Ok(false);
        }
        let pixels: BTreeMap<KeyframeId, _> = coming
            .revised
            .iter()
            .map(|(id, scan)| (*id, scan.pixels()))
            .collect();
        let changes: Vec<KeyframeChange> = coming
            .placed
            .iter()
            .map(|(&id, placed)| match coming.revised.get(&id) {
                Some(scan) => {
                    let pixels = &pixels[&id];
                    KeyframeChange::Set(mapper.scan(scan, pixels, &placed.map_from_keyframe))
                }
                None => KeyframeChange::Move {
                    id,
                    world_from_sensor: similarity(&placed.map_from_keyframe),
                },
            })
            .collect();
        self.map.begin_update(&changes)?;
        self.coming = Some(coming);
        Ok(true)
    }

    /// What was under way has not come about.
    fn take_back(&mut self, coming: Coming) {
        for (id, scan) in coming.revised {
            self.revised.entry(id).or_insert(scan);
        }
    }

    /// Keyframes with new depth, and those that moved by more than `threshold` (map units), as they
    /// should be.
    fn to_place(&self, mapper: &Mapper, threshold: f64) -> BTreeMap<KeyframeId, Placed> {
        let max_range = mapper.config().max_range;
        self.placed
            .iter()
            .filter_map(|(&id, placed)| {
                let pose = self.wanted.world_from_keyframe.get(id as usize);
                let wanted = pose.map_or(placed.map_from_keyframe, |p| self.map_from_world * *p);
                if let Some(scan) = self.revised.get(&id) {
                    return Some((id, Placed::new(scan, wanted)));
                }
                let has_moved = wanted != placed.map_from_keyframe
                    && placed
                        .reach
                        .displacement(&placed.map_from_keyframe, &wanted, max_range)
                        >= threshold;
                has_moved.then_some((
                    id,
                    Placed {
                        map_from_keyframe: wanted,
                        ..*placed
                    },
                ))
            })
            .collect()
    }

    /// Brings every keyframe to its exact pose in the frame of `map_from_world`, at once.
    pub fn bring_to(&mut self, mapper: &Mapper, map_from_world: &Sim3) -> Result<(), MapError> {
        if let Some(coming) = self.coming.take() {
            // It leads to poses that are out of date.
            self.map.abandon_update();
            self.take_back(coming);
        }
        self.map_from_world = *map_from_world;
        while self.step_beyond(mapper, 0.0)? {}
        Ok(())
    }

    /// Whether a keyframe was added.
    pub fn holds(&self, id: KeyframeId) -> bool {
        self.placed.contains_key(&id)
    }

    /// Brings every keyframe to its exact pose, in the frame of `map_from_world`, and adds those
    /// that are `waiting`, with the poses they had when they came; `done` grows with each of those.
    pub fn settle(
        &mut self,
        mapper: &Mapper,
        wanted: &Arc<PoseSnapshot>,
        map_from_world: &Sim3,
        mut waiting: Vec<(KeyframeScan, Sim3)>,
        done: &AtomicUsize,
    ) -> Result<(), MapError> {
        self.map.set_threads(mapper.threads);
        self.wanted = Arc::clone(wanted);
        self.bring_to(mapper, map_from_world)?;
        // the newest is added without work on the others
        waiting.sort_by_key(|(scan, _)| scan.id);
        for (scan, first) in waiting {
            let pose = wanted.world_from_keyframe.get(scan.id as usize);
            self.add(mapper, &scan, pose.unwrap_or(&first))?;
            done.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    /// What is in the map.
    pub fn stats(&self) -> MapStats {
        let points = self.map.points().zip(self.placed.values());
        MapStats {
            points: points
                .map(|((_, used), placed)| used.saturating_sub(placed.num_filled))
                .sum(),
            keyframes: self.placed.len(),
        }
    }

    /// The map of the same depths with the keyframes elsewhere.
    pub fn elsewhere(
        &self,
        map_from_keyframe: impl Iterator<Item = (KeyframeId, Sim3)>,
    ) -> Result<OccupancyMap, MapError> {
        let changes: Vec<KeyframeChange> = map_from_keyframe
            .map(|(id, pose)| KeyframeChange::Move {
                id,
                world_from_sensor: similarity(&pose),
            })
            .collect();
        let mut map = self.map.clone();
        map.apply(&changes)?;
        Ok(map.into_map())
    }
}

impl Placed {
    fn new(scan: &KeyframeScan, map_from_keyframe: Sim3) -> Self {
        Self {
            map_from_keyframe,
            num_filled: scan.num_filled,
            reach: Reach::new(scan),
        }
    }
}

/// Corners, in units of the keyframe, of a pyramid from the camera that holds all measurements.
#[derive(Clone, Copy, Debug)]
struct Reach([Vec3; 5]);

impl Reach {
    fn new(scan: &KeyframeScan) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let mut far: f64 = 0.0;
        for pixel in scan.pixels().iter().filter(|p| p.idepth > 0.0) {
            let place = [pixel.x, pixel.y].map(f64::from);
            low = [0, 1].map(|k| f64::min(low[k], place[k]));
            high = [0, 1].map(|k| f64::max(high[k], place[k]));
            far = far.max(1.0 / f64::from(pixel.idepth));
        }
        let corner = |x: f64, y: f64| match far > 0.0 {
            true => scan.camera.pinhole.unproject(&Vec2::new(x, y)) * far,
            false => Vec3::zeros(),
        };
        Self([
            Vec3::zeros(),
            corner(low[0], low[1]),
            corner(high[0], low[1]),
            corner(low[0], high[1]),
            corner(high[0], high[1]),
        ])
    }

    /// The farthest that a measurement within `max_range` moves between two poses (map units).
    ///
    /// The displacement is an affine function of the point, so it is largest in a corner.
    fn displacement(&self, before: &Sim3, after: &Sim3, max_range: f64) -> f64 {
        let scale = before.scale.max(after.scale);
        self.0
            .iter()
            .map(|corner| {
                let range = corner.norm() * scale;
                let point = if range > max_range {
                    corner * (max_range / range)
                } else {
                    *corner
                };
                (*before * point - *after * point).norm()
            })
            .fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KeyframeCamera;
    use monogrid_geometry::{Pinhole, Rotation};
    use monogrid_occupancy::DepthPixel as Measurement;

    #[test]
    fn no_measurement_moves_farther_than_the_reach_says() {
        let camera = KeyframeCamera {
            pinhole: Pinhole::new(40.0, 42.0, 31.5, 23.5),
            width: 64,
            height: 48,
        };
        let mut state = 3_u64;
        let mut unit = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24)
        };
        for _ in 0..50 {
            let pixels: Vec<Measurement> = (0..60)
                .map(|_| Measurement {
                    x: (unit() * 64.0) as u16,
                    y: (unit() * 48.0) as u16,
                    idepth: (0.2 + 2.0 * unit()) as f32,
                    sigma_idepth: 0.01,
                })
                .collect();
            let scan = KeyframeScan::of_measurements(0, camera, pixels, 0);
            let mut pose = || {
                let turn = Vec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5);
                let shift = Vec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5);
                Sim3::new(0.5 + unit(), Rotation::from_scaled_axis(turn), shift)
            };
            let (before, after) = (pose(), pose());
            let farthest = scan
                .pixels()
                .iter()
                .map(|p| {
                    let ray = Vec3::new(
                        (f64::from(p.x) - 31.5) / 40.0,
                        (f64::from(p.y) - 23.5) / 42.0,
                        1.0,
                    );
                    let point = ray / f64::from(p.idepth);
                    (before * point - after * point).norm()
                })
                .fold(0.0, f64::max);
            let reach = Reach::new(&scan);
            let bound = reach.displacement(&before, &after, 1e9);
            assert!(farthest <= bound + 1e-9 && bound < 10.0 * farthest);
            // Points beyond the range do not count: the shift of the camera alone remains.
            let shift = (before.translation - after.translation).norm();
            assert!((reach.displacement(&before, &after, 1e-9) - shift).abs() < 1e-6);
            assert_eq!(reach.displacement(&before, &before, 1e9), 0.0);
        }
    }
}
