//! What is left of a pipeline that has ended: path, poses, and the final maps, which are made when
//! somebody wants them.

use crate::pipeline::PipelineError;
use monogrid_geometry::{Sim3, Vec3};
use monogrid_mapping::{KeyframeScan, LiveMaps, MappingConfig, Maps, camera_paths, final_scans_of};
use monogrid_occupancy::MapError;
use monogrid_slam::{MapSize, PoseSnapshot, SensedFrame, Slam, TrackedFrame, TrajectoryPose};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::time::Duration;

/// CPU time of the threads of a pipeline.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cpu {
    /// The mapper's.
    pub mapping: Duration,
    /// That of all listeners.
    pub listening: Duration,
}

/// A pipeline that has ended.
#[derive(Debug)]
pub struct Finished {
    /// The system, which holds the finished keyframes, and no longer what only more frames would
    /// need.
    pub slam: Slam,
    /// How large the map was after the last frame.
    pub map_size: MapSize,
    /// Final poses of the keyframes.
    pub poses: Arc<PoseSnapshot>,
    /// Frames with a believed pose, final.
    pub trajectory: Vec<TrajectoryPose>,
    /// CPU time of the threads.
    pub cpu: Cpu,
    /// What went wrong, if anything did: a listener gave up, or a part has panicked.
    pub failure: Option<PipelineError>,
    pub(crate) maps: Option<Result<LiveMaps, MapError>>,
    /// Whether no keyframe is in the maps, since the mapper has failed.
    pub(crate) must_be_remade: bool,
    pub(crate) threads: usize,
    pub(crate) map_from_world: Sim3,
    pub(crate) localise_only: bool,
}

impl Finished {
    /// What an inertial sensor says of the frame of the settings; `None` without one, or where
    /// nothing follows from its readings.
    #[must_use]
    pub fn sensed(&self) -> Option<SensedFrame> {
        let path = self.slam.inertial_path()?;
        path.sensed(&self.map_from_world).ok()
    }

    /// The frame of the settings.
    #[must_use]
    pub fn map_from_world(&self) -> &Sim3 {
        &self.map_from_world
    }

    /// The final maps in the frame of the settings, level and in metres as far as an inertial
    /// sensor says so ([`Self::sensed`]); `None` where there is nothing to map.
    ///
    /// # Errors
    /// A map that would exceed its memory.
    pub fn maps(&mut self) -> Result<Option<Maps>, PipelineError> {
        let sensed = self.sensed().map(|sensed| sensed.map_from_world);
        self.maps_around_camera(&sensed.unwrap_or(self.map_from_world))
    }

    /// The same in the frame given by `map_from_world`; the local map is around where the camera
    /// was last. Where the camera was is free. The second call has none.
    ///
    /// # Errors
    /// A map that would exceed its memory.
    pub fn maps_around_camera(
        &mut self,
        map_from_world: &Sim3,
    ) -> Result<Option<Maps>, PipelineError> {
        let last = self.trajectory.last();
        let camera = last.map(|pose| *map_from_world * pose.world_from_camera.translation);
        let done = AtomicUsize::new(0);
        let scans = self.final_scans(&done);
        self.maps_of(scans, map_from_world, camera, (&[], None), &done)
    }

    /// As [`Self::maps_around_camera`] with the local map around `camera`, which is in the same
    /// frame, of measurements that are at hand: [`Self::final_scans`]. Where the camera was in the
    /// frames of `earlier` sessions is free too; cells have the edge of the settings, or `edge`.
    /// `done` grows with every keyframe that is put in its place, for those who wait.
    ///
    /// # Errors
    /// A map that would exceed its memory, or depth that cannot be read back from the file of
    /// [`Slam::spill_into`].
    pub fn maps_of(
        &mut self,
        scans: Vec<KeyframeScan>,
        map_from_world: &Sim3,
        camera: Option<Vec3>,
        (earlier, edge): (&[TrackedFrame], Option<f64>),
        done: &AtomicUsize,
    ) -> Result<Option<Maps>, PipelineError> {
        let live = self.maps.take().transpose()?;
        let Some(mut live) = live.filter(|_| !scans.is_empty()) else {
            return Ok(None);
        };
        let mapper = match edge {
            Some(edge) => live.mapper().with_resolution(edge),
            None => live.mapper().clone(),
        };
        if edge.is_some() || self.must_be_remade || self.slam.exchanged().is_some() {
            live = live.remade(mapper.clone(), scans, &self.poses)?;
        } else {
            scans.into_iter().for_each(|scan| live.revise(scan));
        }
        let mut maps = live.finish(&self.poses, map_from_world, camera, self.threads, done)?;
        self.slam.check_spilled()?;
        let mut frames = earlier.to_vec();
        frames.extend(self.slam.tracked_frames());
        let paths = camera_paths(&frames, |id| self.poses.in_main_map(id), map_from_world);
        mapper.free_body(&mut maps.global, &paths)?;
        if let Some(centre) = camera {
            let radius = mapper.config().local_radius;
            maps.local = maps.global.within(centre.into(), radius)?;
        }
        for map in [&mut maps.global, &mut maps.large, &mut maps.local] {
            map.pack(self.threads);
        }
        Ok(Some(maps))
    }

    /// The depth of all keyframes as the filter left it, where [`Self::final_scans`] cannot be.
    #[must_use]
    pub fn filter_scans(&self) -> Vec<KeyframeScan> {
        match &self.maps {
            Some(Ok(_)) if !self.localise_only => {
                let config = MappingConfig::thesis();
                let done = AtomicUsize::new(0);
                final_scans_of(&self.slam, &config, self.threads, &done)
            }
            _ => Vec::new(),
        }
    }

    /// The depth of all keyframes as it is mapped in the end, made better at the final poses; empty
    /// where there is nothing to map. `done` grows with every keyframe, for those who wait.
    #[must_use]
    pub fn final_scans(&self, done: &AtomicUsize) -> Vec<KeyframeScan> {
        match &self.maps {
            Some(Ok(maps)) if !self.localise_only => {
                let config = maps.mapper().config();
                final_scans_of(&self.slam, config, self.threads, done)
            }
            _ => Vec::new(),
        }
    }
}
