//! Changes of keyframes on their way into the map.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Keyframe, KeyframeChange, KeyframeMap, groups_of};
use crate::error::MapError;
use crate::evidence::UNKNOWN;
use crate::integrate::integrate_where;
use crate::key::BrickKey;
use crate::map::OccupancyMap;
use crate::storage::{BrickRef, Shard, hash, shard_of};

/// From this share of changed keyframes on all bricks are built anew: looking for those that are
/// concerned would cost more than it saves.
const REBUILD_ALL_SHARE: f64 = 0.5;

/// A second map in which changes are made, scan by scan.
#[derive(Clone, Debug)]
pub(super) struct Update {
    /// Changed keyframes as they will be; `None`: taken out.
    changed: BTreeMap<u32, Option<Keyframe>>,
    stage: Stage,
}

#[derive(Clone, Debug)]
enum Stage {
    /// Everything will be built anew.
    Beginning,
    /// Which bricks do the changed keyframes see, where they were and where they will be?
    Looking {
        /// Keyframes still to be asked.
        left: Vec<u32>,
        dirty: Vec<u64>,
    },
    /// Keyframes are integrated in the order of their ids.
    Building(Building),
}

#[derive(Clone, Debug)]
struct Building {
    map: OccupancyMap,
    extent: Extent,
    /// Keyframes up to this one are done.
    done: Option<u32>,
    /// Measurements that were used of the keyframes.
    points: Vec<(u32, usize)>,
}

/// What is built anew.
#[derive(Clone, Debug)]
enum Extent {
    /// All bricks.
    All,
    /// Some bricks; other bricks had the keyframes up to `newest` when the update began.
    Some {
        dirty: Vec<u64>,
        groups: Vec<u64>,
        newest: Option<u32>,
    },
}

impl Update {
    /// The update that makes changes one after the other; `None` when they change nothing.
    pub fn new(
        keyframes: &BTreeMap<u32, Keyframe>,
        changes: &[KeyframeChange],
    ) -> Result<Option<Self>, MapError> {
        let mut changed: BTreeMap<u32, Option<Keyframe>> = BTreeMap::new();
        for change in changes {
            let id = match change {
                KeyframeChange::Set(scan) => scan.id,
                KeyframeChange::Move { id, .. } | KeyframeChange::Remove { id } => *id,
            };
            let before = match changed.get(&id) {
                Some(keyframe) => keyframe.as_ref(),
                None => keyframes.get(&id),
            };
            let after = match (change, before) {
                (KeyframeChange::Set(scan), _) => Some(Keyframe::new(scan)),
                (KeyframeChange::Remove { .. }, Some(_)) => None,
                (
                    KeyframeChange::Move {
                        world_from_sensor, ..
                    },
                    Some(before),
                ) if before.world_from_sensor != *world_from_sensor => Some(Keyframe {
                    world_from_sensor: *world_from_sensor,
                    groups: Arc::default(),
                    ..before.clone()
                }),
                _ => continue,
            };
            if let Some(after) = &after {
                after.scan().validate()?;
            }
            changed.insert(id, after);
        }
        if changed.is_empty() {
            return Ok(None);
        }
        let old = changed.keys().filter(|id| keyframes.contains_key(*id));
        let everything = REBUILD_ALL_SHARE * keyframes.len() as f64;
        let stage = if old.count() as f64 >= everything {
            Stage::Beginning
        } else {
            Stage::Looking {
                left: changed.keys().copied().collect(),
                dirty: Vec::new(),
            }
        };
        Ok(Some(Self { changed, stage }))
    }

    /// The largest id of those that are changed.
    pub fn newest(&self) -> Option<u32> {
        self.changed.keys().next_back().copied()
    }

    /// Does a part of the work, at most the integration of one scan; whether it was the last.
    pub fn step(&mut self, front: &KeyframeMap) -> Result<bool, MapError> {
        match &mut self.stage {
            Stage::Beginning => {
                self.stage = Stage::Building(Building::of_everything(front)?);
                Ok(false)
            }
            Stage::Looking { left, dirty } => {
                if let Some(id) = left.pop() {
                    let new = self.changed.get(&id).and_then(Option::as_ref);
                    for keyframe in front.keyframes.get(&id).into_iter().chain(new) {
                        dirty.extend(front.seen_by(keyframe)?);
                    }
                }
                if left.is_empty() {
                    let dirty = std::mem::take(dirty);
                    self.stage = Stage::Building(Building::of_some(front, dirty)?);
                }
                Ok(false)
            }
            Stage::Building(building) => building.step(front, &self.changed),
        }
    }

    /// Puts the second map and the changed keyframes in the place of the first; the number of
    /// bricks that were built anew.
    pub fn finish(self, front: &mut KeyframeMap) -> usize {
        let Stage::Building(mut building) = self.stage else {
            return 0;
        };
        let rebuilt = building.mark_as_new(&front.map);
        for (id, keyframe) in self.changed {
            match keyframe {
                Some(keyframe) => front.keyframes.insert(id, keyframe),
                None => front.keyframes.remove(&id),
            };
        }
        for (id, points) in building.points {
            if let Some(keyframe) = front.keyframes.get_mut(&id) {
                keyframe.points = points;
            }
        }
        front.map = Arc::new(building.map);
        rebuilt
    }
}

impl Building {
    /// An empty map.
    fn of_everything(front: &KeyframeMap) -> Result<Self, MapError> {
        Ok(Self {
            map: OccupancyMap::new(front.map.config().clone())?,
            extent: Extent::All,
            done: None,
            points: Vec::new(),
        })
    }

    /// The map without the bricks that are built anew.
    fn of_some(front: &KeyframeMap, mut dirty: Vec<u64>) -> Result<Self, MapError> {
        dirty.sort_unstable();
        dirty.dedup();
        let mut map = OccupancyMap::clone(&front.map);
        map.check_budget(dirty.len(), 0)?;
        map.revision += 1;
        for key in dirty.iter().map(|&key| BrickKey::unpack(key)) {
            if map.brick(key) != BrickRef::UNKNOWN {
                map.set_brick_uniform(key, UNKNOWN);
            }
        }
        Ok(Self {
            map,
            extent: Extent::Some {
                groups: groups_of(&dirty),
                dirty,
                newest: front.keyframes.keys().next_back().copied(),
            },
            done: None,
            points: Vec::new(),
        })
    }

    /// Integrates the next keyframe, those that came meanwhile included; whether none is left.
    fn step(
        &mut self,
        front: &KeyframeMap,
        changed: &BTreeMap<u32, Option<Keyframe>>,
    ) -> Result<bool, MapError> {
        while let Some(id) = self.next(front, changed) {
            self.done = Some(id);
            let keyframe = match changed.get(&id) {
                Some(new) => new.as_ref(),
                None => front.keyframes.get(&id),
            };
            let Some(keyframe) = keyframe else {
                continue;
            };
            let only = match &self.extent {
                Extent::Some {
                    dirty,
                    groups,
                    newest,
                } if Some(id) <= *newest => {
                    if !front.may_change(keyframe, groups)? {
                        continue;
                    }
                    Some(&dirty[..])
                }
                _ => None,
            };
            let (config, threads) = (&front.config, front.threads);
            let report = integrate_where(&mut self.map, &keyframe.scan(), config, threads, only)?;
            self.points.push((id, report.points));
            return Ok(false);
        }
        Ok(true)
    }

    /// The first keyframe after those that are done.
    fn next(&self, front: &KeyframeMap, changed: &BTreeMap<u32, Option<Keyframe>>) -> Option<u32> {
        let after = match self.done {
            Some(id) => id.checked_add(1)?,
            None => 0,
        };
        let known = front.keyframes.range(after..).next().map(|(id, _)| *id);
        let other = changed.range(after..).next().map(|(id, _)| *id);
        known.into_iter().chain(other).min()
    }

    /// Marks what was built anew as newer than anything in the first map, also bricks that are
    /// unknown now, so that those who follow the map learn of it; the number of bricks.
    fn mark_as_new(&mut self, front: &OccupancyMap) -> usize {
        self.map.revision = self.map.revision.max(front.revision) + 1;
        let bricks = match std::mem::replace(&mut self.extent, Extent::All) {
            Extent::Some { dirty, .. } => dirty,
            Extent::All => {
                for key in front.bricks() {
                    if self.map.brick(key) == BrickRef::UNKNOWN {
                        self.map.set_brick_uniform(key, UNKNOWN);
                    }
                }
                let bricks = self.map.shards.iter().flat_map(Shard::bricks);
                bricks.map(|brick| brick.0).collect()
            }
        };
        for &key in &bricks {
            let hash = hash(key);
            let shard = &mut self.map.shards[shard_of(hash)];
            if let Some(slot) = shard.find(key, hash) {
                shard.touch(slot, self.map.revision);
            }
        }
        bricks.len()
    }
}
