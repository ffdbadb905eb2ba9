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
use super::scene::Scene;
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
    #[error("there is no built-in world {0:?}; there are {names}", names = WORLD_NAMES.join(", "))]
    UnknownName(String),
}

impl World {
    /// A built-in world with a choice of how carefully it is lit.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn by_name_with(name: &str, lighting: &LightingConfig) -> Result<Self, WorldError> {
        let scene = scene(name).ok_or_else(|| WorldError::UnknownName(name.to_owned()))?;
        Ok(Self::new(name, &scene, lighting))
    }
}

fn scene(name: &str) -> Option<Scene> {
    Some(match name {
        "living-room" => living_room::scene(Covering::Patterned),
        "blank-walls" => living_room::scene(Covering::Blank),
        "office" => office::scene(),
        "machine-hall" => machine_hall::scene(),
        "corridor-loop" => corridor_loop::scene(),
        "stairs" => stairs::scene(),
        "street" => street::scene(),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Patch;

    #[test]
    fn every_world_is_furnished_and_partly_plain() {
        for name in WORLD_NAMES {
            let scene = scene(name).expect("a world");
            let area = |is_counted: &dyn Fn(&Patch) -> bool| {
                let patches = scene.patches.iter().filter(|patch| is_counted(patch));
                patches.map(Patch::area_m2).sum::<f32>()
            };
            let is_plain = |patch: &Patch| scene.materials[patch.material].texture.is_none();
            let plain = area(&is_plain) / area(&|_| true);
            let least_plain = if name == "blank-walls" {
                0.70
            } else {
                1.0 / 3.0
            };
            assert!((least_plain..0.85).contains(&plain), "{name}: {plain}");
            let num_objects = scene.objects.len();
            assert!(num_objects >= 21, "{name}: {num_objects}");
        }
    }
}
