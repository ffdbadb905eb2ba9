//! The built-in worlds.

mod corridor_loop;
mod furniture;
mod living_room;
mod machine_hall;
mod mover;
mod office;
mod paths;
mod stairs;
mod street;
mod workplace;

use super::lighting::LightingConfig;
use super::world::World;
use living_room::Covering;

pub(super) use mover::{mover_pose, mover_world, traffic_worlds};
pub(super) use paths::path_of;
pub use paths::{MOTION_NAMES, Motion, usual_frames};
pub(super) use street::traffic;

/// Names of the built-in worlds.
pub const WORLD_NAMES: [&str; 7] = [
    "living-room",
    "office",
    "machine-hall",
    "corridor-loop",
    "blank-walls",
    "stairs",
    "street",
];

/// What is wrong with a request for a world.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WorldError {
    /// No such world.
    #[error("there is no built-in world {name:?}; there are {}", WORLD_NAMES.join(", "))]
    UnknownName {
        /// What was asked for.
        name: String,
    },
}

impl World {
    /// A built-in world, fully lit.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn by_name(name: &str) -> Result<Self, WorldError> {
        Self::by_name_with(name, &LightingConfig::default())
    }

    /// A built-in world with a choice of how carefully it is lit.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn by_name_with(name: &str, lighting: &LightingConfig) -> Result<Self, WorldError> {
        let scene = match name {
            "living-room" => living_room::scene(Covering::Patterned),
            "blank-walls" => living_room::scene(Covering::Blank),
            "office" => office::scene(),
            "machine-hall" => machine_hall::scene(),
            "corridor-loop" => corridor_loop::scene(),
            "stairs" => stairs::scene(),
            "street" => street::scene(),
            _ => {
                return Err(WorldError::UnknownName {
                    name: name.to_owned(),
                });
            }
        };
        Ok(Self::new(name, &scene, lighting))
    }
}
