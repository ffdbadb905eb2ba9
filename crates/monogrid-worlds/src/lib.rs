//! Synthetic worlds with exact depth and pose.
//!
//! [`World`] (built in or any mesh) + [`CameraPath`] (hand, drone or file) + [`Renderer`] + effects
//! of a real camera = [`SynthSequence`], which yields frames with truth and writes data sets in TUM
//! layout.
//!
//! World axes: z up, metres. Camera: x right, y down, z forward. Everything is a function of the
//! configuration and its seed, whatever the number of threads.

mod bvh;
mod effects;
mod imu;
mod jitter;
mod light_map;
mod lighting;
mod mesh;
mod noise;
mod packet;
mod path;
pub mod patterns;
pub mod random;
mod render;
pub mod scene;
mod sequence;
mod shapes;
mod texture;
mod triangle_mesh;
mod world;
pub mod worlds;
mod write;

pub use bvh::{Bounds, P3};
pub use effects::{EffectsConfig, NoiseConfig};
pub use imu::{ImuConfig, imu_samples};
pub use lighting::LightingConfig;
pub use mesh::{MeshLighting, MeshModel, read_picture, read_ply};
pub use path::{CameraPath, Carrier, PathError, Waypoint, look_at};
pub use render::{Mover, Rendered, Renderer};
pub use scene::Tint;
pub use sequence::{DEMO_FRAMES, SynthConfig, SynthError, SynthFrame, SynthSequence};
pub use shapes::BoxFaces;
pub use texture::Texture;
pub use triangle_mesh::TriangleMesh;
pub use world::World;
pub use worlds::{MOTION_NAMES, Motion, WORLD_NAMES, WorldError, usual_frames};
pub use write::{WriteConfig, write_ply, write_sequence_imu, write_tum_layout};
