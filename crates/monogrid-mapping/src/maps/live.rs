//! The three maps of a run.

use super::global::GlobalMap;
use super::mapper::{MapStats, Mapper};
use crate::schedule::{LiveDepth, Step};
use crate::{KeyframeCamera, KeyframeScan, MappingConfig};
use monogrid_geometry::{Sim3, Vec3};
use monogrid_occupancy::{MapError, OccupancyMap};
use monogrid_slam::{KeptKeyframe, KeyframeId, PoseSnapshot};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, PoisonError};

/// The three maps at the end of a run.
#[derive(Clone, Debug)]
pub struct Maps {
    /// Every keyframe of the main map at its final pose.
    pub global: OccupancyMap,
    /// Every keyframe, with its final depth, at its first pose.
    pub large: OccupancyMap,
    /// *global* around the camera.
    pub local: OccupancyMap,
    /// What *global* was built from.
    pub stats: MapStats,
}

/// The maps of a running system at one moment. They never change.
#[derive(Clone, Debug)]
pub struct LiveView {
    /// Revision of the poses ([`PoseSnapshot::revision`]) at which *global* has the keyframes, but
    /// for those that moved less than `follow_threshold` since they were mapped, or came
    /// afterwards.
    pub revision: u64,
    /// What *global* holds.
    pub stats: MapStats,
    /// Every keyframe once, at the poses of one revision.
    pub global: Arc<OccupancyMap>,
    /// Every keyframe where it was when it was finished.
    pub large: Arc<OccupancyMap>,
    /// The frame of the maps.
    pub map_from_world: Sim3,
}

/// Gives other threads the newest maps of a run. Copies give the same.
#[derive(Clone, Debug, Default)]
pub struct MapReader(Arc<Mutex<Option<Arc<LiveView>>>>);

impl MapReader {
    /// The maps after the last change; `None` before the first keyframe is finished.
    #[must_use]
    pub fn latest(&self) -> Option<Arc<LiveView>> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn put(&self, view: LiveView) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(view));
    }

    fn is_read(&self) -> bool {
        Arc::strong_count(&self.0) > 1
    }
}

/// Maps that grow while keyframes are finished, and follow the graph.
///
/// Meant for a thread of its own: it adds keyframes and poses as they come, and calls
/// [`LiveMaps::step`] whenever nothing else is to be done. The work of a step is bounded, so that
/// new keyframes never wait for long; what other threads read ([`LiveMaps::reader`]) is always
/// complete.
#[derive(Debug)]
pub struct LiveMaps {
    mapper: Mapper,
    map_from_world: Sim3,
    large: Arc<OccupancyMap>,
    first_poses: Vec<(KeyframeId, Sim3)>,
    global: GlobalMap,
    /// Keyframes that came while nobody read, at the poses they had; the maps take them when they
    /// are wanted. A map that follows every small correction costs twice its integration and more.
    waiting: Vec<(Waiting, Sim3)>,
    /// Keyframes of fragments that are not joined to the main map: nobody knows where they are.
    apart: BTreeMap<KeyframeId, Waiting>,
    /// Better depth of the keyframes in the maps, from the first on that came while somebody read.
    depth: Option<LiveDepth>,
    /// Whether the next step is one of the depth, where there is one to take; else one of *global*.
    is_depths_turn: bool,
    published: MapReader,
}

/// A keyframe that is not in the maps yet.
#[derive(Clone, Debug)]
pub enum Waiting {
    /// What of it is mapped.
    Scan(KeyframeScan),
    /// What of it is mapped will be made when it is.
    Keyframe(KeptKeyframe, KeyframeCamera),
}

impl Waiting {
    fn id(&self) -> KeyframeId {
        match self {
            Self::Scan(scan) => scan.id,
            Self::Keyframe(keyframe, _) => keyframe.id,
        }
    }

    /// What of it is mapped; nothing where it cannot be read back. Filling plain surfaces is left
    /// for the final maps, which have better depth, as long as nobody looks.
    fn scan(self, config: &MappingConfig, is_read: bool) -> KeyframeScan {
        let (keyframe, camera) = match self {
            Self::Scan(scan) => return scan,
            Self::Keyframe(keyframe, camera) => (keyframe, camera),
        };
        let loaded = keyframe.load();
        let pixels = loaded.as_ref().map_or(&[][..], |loaded| &loaded.pixels);
        let image = loaded.as_ref().filter(|_| is_read);
        let image = image.map(|loaded| &loaded.image);
        KeyframeScan::new(keyframe.id, pixels, image, &camera, config)
    }
}

impl From<KeyframeScan> for Waiting {
    fn from(scan: KeyframeScan) -> Self {
        Self::Scan(scan)
    }
}

impl LiveMaps {
    /// Empty maps in the frame given by `map_from_world`.
    ///
    /// # Errors
    /// A setting of the map outside its range.
    pub fn new(mapper: Mapper, map_from_world: Sim3) -> Result<Self, MapError> {
        Ok(Self {
            large: Arc::new(mapper.empty_map()?),
            global: GlobalMap::new(&mapper, map_from_world)?,
            mapper,
            map_from_world,
            first_poses: Vec::new(),
            waiting: Vec::new(),
            apart: BTreeMap::new(),
            depth: None,
            is_depths_turn: false,
            published: MapReader::default(),
        })
    }

    /// What maps are built with.
    #[must_use]
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// For threads that read the maps while they grow. As long as nobody does, they are left for
    /// the end.
    ///
    /// # Errors
    /// As [`LiveMaps::add`], for keyframes that came before.
    pub fn reader(&mut self) -> Result<MapReader, MapError> {
        let reader = self.published.clone();
        for (waiting, world_from_keyframe) in std::mem::take(&mut self.waiting) {
            self.make_better(&waiting);
            let scan = waiting.scan(self.mapper.config(), false);
            self.integrate(&scan, &world_from_keyframe)?;
        }
        if !self.first_poses.is_empty() {
            self.publish();
        }
        Ok(reader)
    }

    /// Adds a finished keyframe at the pose it has now; keyframes come in the order of their ids,
    /// but for those of joined fragments.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn add(
        &mut self,
        keyframe: impl Into<Waiting>,
        world_from_keyframe: Sim3,
    ) -> Result<(), MapError> {
        let keyframe = keyframe.into();
        self.first_poses.push((keyframe.id(), world_from_keyframe));
        if self.published.is_read() {
            self.make_better(&keyframe);
            let scan = keyframe.scan(self.mapper.config(), true);
            self.integrate(&scan, &world_from_keyframe)?;
            self.publish();
        } else {
            self.waiting.push((keyframe, world_from_keyframe));
        }
        Ok(())
    }

    /// Has better depth made of a keyframe, if the settings ask for it.
    fn make_better(&mut self, keyframe: &Waiting) {
        let config = self.mapper.config();
        let Waiting::Keyframe(keyframe, camera) = keyframe else {
            return;
        };
        if config.quality.has_dense_depth() && config.dense.live {
            self.depth
                .get_or_insert_with(|| LiveDepth::new(config.clone(), *camera))
                .add(keyframe.clone());
        }
    }

    fn integrate(
        &mut self,
        scan: &KeyframeScan,
        world_from_keyframe: &Sim3,
    ) -> Result<(), MapError> {
        let pose = self.map_from_world * *world_from_keyframe;
        let large = Arc::make_mut(&mut self.large);
        self.mapper.integrate(large, scan, &pose)?;
        self.global.add(&self.mapper, scan, world_from_keyframe)
    }

    /// Whether somebody reads the maps while they grow.
    #[must_use]
    pub fn is_read(&self) -> bool {
        self.published.is_read()
    }

    /// Takes a finished keyframe of a fragment; it is added when [`LiveMaps::follow`] hears that
    /// the fragment is joined to the main map.
    pub fn add_apart(&mut self, keyframe: impl Into<Waiting>) {
        let keyframe = keyframe.into();
        self.apart.insert(keyframe.id(), keyframe);
    }

    /// Takes other depth of a keyframe that was added before; *global* will use it, or what is made
    /// of it, *large* at the end.
    pub fn revise(&mut self, keyframe: impl Into<Waiting>) {
        let keyframe = keyframe.into();
        let id = keyframe.id();
        if let Some(apart) = self.apart.get_mut(&id) {
            *apart = keyframe;
            return;
        }
        match self.waiting.iter_mut().find(|(w, _)| w.id() == id) {
            Some((waiting, _)) => *waiting = keyframe,
            None => {
                let depth = self.depth.as_ref();
                // of the filter: what was made of its depth before is better
                let is_better_shown = matches!(keyframe, Waiting::Keyframe(..))
                    && depth.is_some_and(|depth| depth.has_handed_over(id));
                self.make_better(&keyframe);
                if !is_better_shown {
                    let scan = keyframe.scan(self.mapper.config(), self.published.is_read());
                    self.global.revise(scan);
                }
            }
        }
    }

    /// Says where keyframes are now; *global* follows in [`LiveMaps::step`]. Keyframes that have
    /// come to the main map are added.
    ///
    /// # Errors
    /// As [`LiveMaps::add`].
    pub fn follow(&mut self, poses: Arc<PoseSnapshot>) -> Result<(), MapError> {
        for (id, scan) in std::mem::take(&mut self.apart) {
            match poses.in_main_map(id) {
                Some(pose) => self.add(scan, *pose)?,
                None => {
                    self.apart.insert(id, scan);
                }
            }
        }
        self.global.wanted = poses;
        Ok(())
    }

    /// The frame of the maps.
    #[must_use]
    pub fn map_from_world(&self) -> &Sim3 {
        &self.map_from_world
    }

    /// Brings the maps to another frame, at once: all that is in them is integrated again.
    ///
    /// # Errors
    /// As [`LiveMaps::add`].
    pub fn bring_to(&mut self, map_from_world: Sim3) -> Result<(), MapError> {
        self.map_from_world = map_from_world;
        self.global.bring_to(&self.mapper, &map_from_world)?;
        let first_poses = self.first_poses.iter();
        let placed = first_poses.filter(|(id, _)| self.global.holds(*id));
        let large = placed.map(|(id, pose)| (*id, map_from_world * *pose));
        self.large = Arc::new(self.global.elsewhere(large)?);
        if !self.first_poses.is_empty() {
            self.publish();
        }
        Ok(())
    }

    /// Brings *global* closer to the newest poses and depths, by at most the integration of one
    /// keyframe, or makes the depth of a keyframe better, by a step of it, in turns; `false` when
    /// there is nothing to do, or when nobody reads.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn step(&mut self) -> Result<bool, MapError> {
        if !self.published.is_read() {
            return Ok(false);
        }
        let is_depth_first = self.is_depths_turn;
        self.is_depths_turn = !is_depth_first;
        Ok(is_depth_first && self.step_depth()
            || self.step_global()?
            || !is_depth_first && self.step_depth())
    }

    fn step_global(&mut self) -> Result<bool, MapError> {
        let version = self.global.version();
        let has_worked = self.global.step(&self.mapper)?;
        if self.global.version() != version {
            self.publish();
        }
        Ok(has_worked)
    }

    fn step_depth(&mut self) -> bool {
        let depth = self.depth.as_mut();
        let step = depth.map_or(Step::Idle, |depth| depth.step(&self.global.wanted));
        let has_worked = !matches!(step, Step::Idle);
        if let Step::Better(scan) = step {
            self.global.revise(scan);
        }
        has_worked
    }

    /// No more keyframes come: what was kept to make their depth better is given back.
    pub fn rest(&mut self) {
        self.depth = None;
    }

    fn publish(&self) {
        if self.published.is_read() {
            self.published.put(LiveView {
                revision: self.global.revision,
                stats: self.global.stats(),
                global: self.global.map.share(),
                large: Arc::clone(&self.large),
                map_from_world: self.map_from_world,
            });
        }
    }

    /// The same keyframes, with the depth of `scans` (all of them), in maps of other settings in
    /// which nothing is integrated yet. Those that are not in the main map by `poses` are apart,
    /// though they may have been in it before.
    ///
    /// # Errors
    /// A setting of the map outside its range.
    pub fn remade(
        self,
        mapper: Mapper,
        scans: Vec<KeyframeScan>,
        poses: &PoseSnapshot,
    ) -> Result<Self, MapError> {
        let mut remade = Self::new(mapper, self.map_from_world)?;
        let first_poses: BTreeMap<KeyframeId, Sim3> = self.first_poses.into_iter().collect();
        for scan in scans {
            let first = first_poses.get(&scan.id);
            let is_inside = poses.in_main_map(scan.id).is_some();
            if let Some(first) = first.filter(|_| is_inside) {
                remade.first_poses.push((scan.id, *first));
                remade.waiting.push((scan.into(), *first));
            } else if first.is_some() || self.apart.contains_key(&scan.id) {
                remade.apart.insert(scan.id, scan.into());
            }
        }
        Ok(remade)
    }

    /// The final maps: *global* at the poses of `snapshot`, all in the frame of `map_from_world`,
    /// *local* around `camera_in_map`.
    ///
    /// `done` grows with every keyframe that is put in its place. The maps are those that a build
    /// from scratch gives, whatever [`LiveMaps::step`] had done.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn finish(
        mut self,
        snapshot: &Arc<PoseSnapshot>,
        map_from_world: &Sim3,
        camera_in_map: Option<Vec3>,
        threads: usize,
        done: &AtomicUsize,
    ) -> Result<Maps, MapError> {
        self.follow(Arc::clone(snapshot))?;
        let mapper = self.mapper.with_threads(threads);
        let waiting = self.waiting.into_iter();
        let waiting: Vec<(KeyframeScan, Sim3)> = waiting
            .map(|(keyframe, pose)| (keyframe.scan(mapper.config(), false), pose))
            .collect();
        let (large, (global, stats)) = if waiting.len() == self.first_poses.len() {
            // nothing was integrated yet
            both_from_scratch(&mapper, waiting, snapshot, map_from_world, threads, done)?
        } else {
            let mut global = self.global;
            global.settle(&mapper, snapshot, map_from_world, waiting, done)?;
            let first_poses = self.first_poses.iter();
            let first_poses = first_poses.map(|(id, pose)| (*id, *map_from_world * *pose));
            let large = global.elsewhere(first_poses)?;
            let stats = global.stats();
            (large, (global.map.into_map(), stats))
        };
        let local = match camera_in_map {
            Some(center) => global.within(center.into(), mapper.config().local_radius)?,
            None => mapper.empty_map()?,
        };
        Ok(Maps {
            global,
            large,
            local,
            stats,
        })
    }
}

/// *large* and *global* of keyframes with the poses that they had first. The two have nothing to do
/// with each other, so each gets half of the threads.
fn both_from_scratch(
    mapper: &Mapper,
    mut keyframes: Vec<(KeyframeScan, Sim3)>,
    snapshot: &PoseSnapshot,
    map_from_world: &Sim3,
    threads: usize,
    done: &AtomicUsize,
) -> Result<(OccupancyMap, (OccupancyMap, MapStats)), MapError> {
    keyframes.sort_by_key(|(scan, _)| scan.id);
    let first = keyframes.iter().map(|(scan, first)| (scan, *first));
    let last = keyframes.iter().map(|(scan, first)| {
        let pose = snapshot.world_from_keyframe.get(scan.id as usize);
        (scan, *pose.unwrap_or(first))
    });
    let in_map = |(scan, pose): (_, Sim3)| (scan, *map_from_world * pose);
    let first: Vec<(&KeyframeScan, Sim3)> = first.map(in_map).collect();
    let last: Vec<(&KeyframeScan, Sim3)> = last.map(in_map).collect();
    let mapper = mapper.with_threads((threads / 2).max(1));
    let (large, global) = rayon::join(
        || mapper.build_posed(&first, &AtomicUsize::new(0)),
        || mapper.build_posed(&last, done),
    );
    Ok((large?.0, global?))
}
