//! The built-in worlds.

mod furniture;
mod living_room;
mod mover;
mod paths;

use super::lighting::LightingConfig;
use super::world::World;

pub(super) use mover::{mover_pose, mover_world};
pub(super) use paths::path_of;

/// Names of the built-in worlds.
pub const WORLD_NAMES: [&str; 1] = ["living-room"];

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
        match name {
            "living-room" => Ok(Self::new(name, &living_room::scene(), lighting)),
            _ => Err(WorldError::UnknownName {
                name: name.to_owned(),
            }),
        }
    }
}
