//! A video of a world with its truth, frame by frame.

use super::effects::{EffectsConfig, Sensor};
use super::lighting::LightingConfig;
use super::path::{CameraPath, Carrier, PathError};
use super::render::{Mover, Renderer};
use super::scene::Tint;
use super::world::World;
use super::worlds::{
    Motion, WorldError, mover_pose, mover_world, path_of, traffic, traffic_worlds,
};
use monogrid_geometry::{Camera, CameraError, Distortion, Pinhole, Se3, Vec3, mix};
use monogrid_image::{GrayImage, Image};
use std::sync::Arc;

/// What cannot be made into a sequence.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SynthError {
    /// Unknown or unreadable world.
    #[error(transparent)]
    World(#[from] WorldError),
    /// Unusable camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Unusable motion.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// Settings of a sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthConfig {
    /// The camera.
    pub camera: Camera,
    /// Frames per second. Default 30.
    pub fps: f64,
    /// Number of frames before any are dropped.
    pub frames: usize,
    /// Effects of a real camera.
    pub effects: EffectsConfig,
    /// Seed of noise, exposure and unsteadiness. Default 0.
    pub seed: u64,
}

impl SynthConfig {
    /// Pinhole camera of the demonstration: 640x480, 65 degrees wide.
    #[must_use]
    pub fn demo() -> Self {
        Self {
            camera: pinhole(640, 480, 500.0),
            fps: 30.0,
            frames: DEMO_FRAMES,
            effects: EffectsConfig::demo(),
            seed: 0,
        }
    }

    /// The same view at 320x240, for tests.
    #[must_use]
    pub fn small() -> Self {
        Self {
            camera: pinhole(320, 240, 250.0),
            ..Self::demo()
        }
    }
}

/// Frames of the demonstration.
pub const DEMO_FRAMES: usize = 1500;

/// Makes another seed of that of the first camera.
const SECOND_CAMERA: u64 = 0x5EC0;

/// Instants that are averaged over the open shutter.
const BLUR_SAMPLES: usize = 5;

fn pinhole(width: usize, height: usize, focal_px: f64) -> Camera {
    Camera {
        width,
        height,
        pinhole: Pinhole::centred(focal_px, width, height),
        distortion: Distortion::None,
    }
}

/// One frame with its truth.
#[derive(Clone, Debug)]
pub struct SynthFrame {
    /// Number of the frame at the full rate; gaps are dropped frames.
    pub index: usize,
    /// Time, ns from the start.
    pub timestamp_ns: i64,
    /// Whole grey values in [0, 255].
    pub image: GrayImage,
    /// True pose (of the middle row at the middle of the exposure).
    pub world_from_camera: Se3,
}

/// A world, a motion and a camera. Frames may be asked for in any order.
#[derive(Clone, Debug)]
pub struct SynthSequence {
    world: Arc<World>,
    mover: Option<Arc<World>>,
    /// Cars that drive through the world.
    traffic: Arc<Vec<World>>,
    path: CameraPath,
    /// Where the camera is beside what moves along the path, m to the right.
    right_m: f64,
    renderer: Renderer,
    sensor: Sensor,
    config: SynthConfig,
    /// Frames that were not dropped.
    kept: Vec<usize>,
}

impl SynthSequence {
    /// Combines a world and a motion.
    ///
    /// # Errors
    /// When the camera is unusable.
    pub fn new(
        world: Arc<World>,
        path: CameraPath,
        config: SynthConfig,
    ) -> Result<Self, SynthError> {
        config.camera.validate()?;
        let sensor = Sensor::new(config.effects, config.seed);
        let mover = config.effects.has_mover.then(|| Arc::new(mover_world()));
        Ok(Self {
            traffic: Arc::new(traffic_worlds(&world)),
            world,
            mover,
            path,
            right_m: 0.0,
            renderer: Renderer::new(&config.camera, config.effects.gamma),
            kept: (0..config.frames).filter(|&i| sensor.is_kept(i)).collect(),
            sensor,
            config,
        })
    }

    /// A built-in world with its own motion, which takes as long as there are frames.
    ///
    /// # Errors
    /// When there is no such world, or the camera is unusable.
    pub fn built_in(
        name: &str,
        motion: impl Into<Motion>,
        config: SynthConfig,
    ) -> Result<Self, SynthError> {
        Self::built_in_with(name, motion, config, &LightingConfig::default())
    }

    /// The same with a choice of how carefully the world is lit.
    ///
    /// # Errors
    /// As [`Self::built_in`].
    pub fn built_in_with(
        name: &str,
        motion: impl Into<Motion>,
        config: SynthConfig,
        lighting: &LightingConfig,
    ) -> Result<Self, SynthError> {
        let world = Arc::new(World::by_name_with(name, lighting)?);
        let path = Self::path_for(name, motion.into(), &config)?;
        Self::new(world, path, config)
    }

    /// The built-in motion of a world, as long as the frames of the settings take.
    ///
    /// # Errors
    /// None in practice.
    pub fn path_for(
        name: &str,
        motion: Motion,
        config: &SynthConfig,
    ) -> Result<CameraPath, SynthError> {
        let duration_secs = config.frames as f64 / config.fps;
        Ok(path_of(name, motion, duration_secs, config.seed)?)
    }

    /// The sequence of `monogrid demo`: the living room, a hand, noise and exposure change.
    ///
    /// # Errors
    /// None in practice; see [`Self::built_in`].
    pub fn demo() -> Result<Self, SynthError> {
        Self::built_in("living-room", Carrier::Hand, SynthConfig::demo())
    }

    /// The same sequence at 320x240 with quick lighting, for tests.
    ///
    /// # Errors
    /// None in practice; see [`Self::built_in`].
    pub fn small_demo() -> Result<Self, SynthError> {
        let quick = LightingConfig::quick();
        Self::built_in_with("living-room", Carrier::Hand, SynthConfig::small(), &quick)
    }

    /// The same frames as a second camera sees them, so many metres to the right of the first: with
    /// noise and exposure of its own.
    #[must_use]
    pub fn beside(&self, right_m: f64) -> Self {
        Self {
            right_m: self.right_m + right_m,
            sensor: Sensor::new(self.config.effects, mix(self.config.seed ^ SECOND_CAMERA)),
            ..self.clone()
        }
    }

    /// The beginning of the same sequence.
    #[must_use]
    pub fn shortened(mut self, frames: usize) -> Self {
        self.kept.retain(|&index| index < frames);
        self
    }

    /// Number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Whether there is no frame.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The motion.
    #[must_use]
    pub fn path(&self) -> &CameraPath {
        &self.path
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        self.renderer.camera()
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &SynthConfig {
        &self.config
    }

    /// The `k`-th frame that was not dropped; `None` after the last.
    #[must_use]
    pub fn frame(&self, k: usize) -> Option<SynthFrame> {
        let index = *self.kept.get(k)?;
        let secs = self.secs(k)?;
        Some(SynthFrame {
            index,
            timestamp_ns: self.timestamp_ns(k)?,
            image: self.sensor.expose(&self.radiance(secs), index, secs),
            world_from_camera: self.pose(secs),
        })
    }

    /// Exact depth (z, m) of the `k`-th frame, NaN where there is nothing; `None` after the last
    /// frame.
    #[must_use]
    pub fn depth(&self, k: usize) -> Option<GrayImage> {
        self.depth_through(&self.renderer, k)
    }

    /// The same as another camera at the same place sees it, whose rows are read at the same times.
    #[must_use]
    pub fn depth_through(&self, renderer: &Renderer, k: usize) -> Option<GrayImage> {
        let secs = self.secs(k)?;
        Some(renderer.depth(&self.world, &self.movers(secs), &self.row_poses(secs)))
    }

    /// Colour of what another camera at the same place sees in the `k`-th frame, as shares of its
    /// grey; `None` after the last frame.
    #[must_use]
    pub fn tints_through(&self, renderer: &Renderer, k: usize) -> Option<Image<Tint>> {
        let secs = self.secs(k)?;
        Some(renderer.tints(&self.world, &self.movers(secs), &self.row_poses(secs)))
    }

    /// True pose of the `k`-th frame; `None` after the last.
    #[must_use]
    pub fn world_from_camera(&self, k: usize) -> Option<Se3> {
        Some(self.pose(self.secs(k)?))
    }

    /// Time of the `k`-th frame, ns; `None` after the last.
    #[must_use]
    pub fn timestamp_ns(&self, k: usize) -> Option<i64> {
        Some((self.secs(k)? * 1e9).round() as i64)
    }

    /// Pose of the camera at a time.
    fn pose(&self, secs: f64) -> Se3 {
        let mut world_from_camera = self.path.world_from_camera(secs);
        if self.right_m != 0.0 {
            let right = Vec3::new(self.right_m, 0.0, 0.0);
            world_from_camera.translation += world_from_camera.rotation * right;
        }
        world_from_camera
    }

    fn secs(&self, k: usize) -> Option<f64> {
        Some(*self.kept.get(k)? as f64 / self.config.fps)
    }

    /// Mean light over the time that the shutter is open.
    fn radiance(&self, secs: f64) -> GrayImage {
        let effects = &self.config.effects;
        let is_blurred = effects.shutter_secs > 0.0;
        let count = if is_blurred { BLUR_SAMPLES } else { 1 };
        let at_instant = |k: usize| {
            let offset = ((k as f64 + 0.5) / count as f64 - 0.5) * effects.shutter_secs;
            let (movers, poses) = (self.movers(secs + offset), self.row_poses(secs + offset));
            self.renderer.radiance(&self.world, &movers, &poses)
        };
        let mut mean = at_instant(0);
        for k in 1..count {
            let pixels = mean.as_mut_slice().iter_mut();
            pixels
                .zip(at_instant(k).as_slice())
                .for_each(|(sum, value)| *sum += value);
        }
        if count > 1 {
            let pixels = mean.as_mut_slice().iter_mut();
            pixels.for_each(|value| *value /= count as f32);
        }
        mean
    }

    /// Pose of every row (rolling shutter), or just one.
    fn row_poses(&self, secs: f64) -> Vec<Se3> {
        let readout_secs = self.config.effects.readout_secs;
        if readout_secs <= 0.0 {
            return vec![self.pose(secs)];
        }
        let height = self.config.camera.height;
        let pose = |row| {
            let part = (row as f64 + 0.5) / height as f64 - 0.5;
            self.pose(secs + part * readout_secs)
        };
        (0..height).map(pose).collect()
    }

    /// Cars are where the camera has come to, however fast that is; who walks has a pace of their
    /// own.
    fn movers(&self, secs: f64) -> Vec<Mover<'_>> {
        let cars = self.traffic.iter().zip(traffic(self.path.progress(secs)));
        let walker = self.mover.as_deref();
        let walker = walker.map(|mover| (mover, mover_pose(&self.world, secs)));
        let mover = |(world, world_from_mover)| Mover {
            world,
            world_from_mover,
        };
        cars.chain(walker).map(mover).collect()
    }
}
