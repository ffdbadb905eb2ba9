//! What is around the camera, by odometry alone.

use super::mapper::Mapper;
use crate::KeyframeScan;
use monogrid_geometry::{Sim3, Vec3};
use monogrid_occupancy::{MapError, OccupancyMap};

/// A map around the camera that no correction moves, for steering around obstacles: it drifts as
/// odometry does, and is as smooth.
///
/// A keyframe is put where odometry has it when it is seen first, and stays there. It is mapped
/// anew whenever its depth has become better, until another is in use; of those before, what lies
/// within the radius ([`crate::MappingConfig::local_radius`]) is kept.
#[derive(Clone, Debug)]
pub struct LocalMap {
    mapper: Mapper,
    /// Keyframes that are in use no longer.
    before: OccupancyMap,
    newest: Option<Newest>,
}

/// The keyframe in use.
#[derive(Clone, Debug)]
struct Newest {
    scan: KeyframeScan,
    local_from_keyframe: Sim3,
}

impl LocalMap {
    /// An empty map.
    ///
    /// # Errors
    /// A setting of the map outside its range.
    pub fn new(mapper: Mapper) -> Result<Self, MapError> {
        Ok(Self {
            before: mapper.empty_map()?,
            mapper,
            newest: None,
        })
    }

    /// Takes the keyframe in use as it is now, where odometry has it; the map around the camera
    /// then.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn take(
        &mut self,
        scan: KeyframeScan,
        local_from_keyframe: Sim3,
        camera: Vec3,
    ) -> Result<OccupancyMap, MapError> {
        let radius = self.mapper.config().local_radius;
        let local_from_keyframe = match self.newest.take() {
            Some(newest) if newest.scan.id == scan.id => newest.local_from_keyframe,
            Some(Newest {
                scan,
                local_from_keyframe: pose,
            }) => {
                self.mapper.integrate(&mut self.before, &scan, &pose)?;
                self.before = self.before.within(camera.into(), radius)?;
                local_from_keyframe
            }
            None => local_from_keyframe,
        };
        let mut map = self.before.clone();
        self.mapper
            .integrate(&mut map, &scan, &local_from_keyframe)?;
        self.newest = Some(Newest {
            scan,
            local_from_keyframe,
        });
        map.within(camera.into(), radius)
    }
}
