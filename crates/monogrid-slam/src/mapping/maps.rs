//! Building maps from scans and poses.

use super::{IntegrationKind, KeyframeCamera, KeyframeScan, MappingConfig, SigmaMode};
use crate::PoseSnapshot;
use monogrid_geometry::{Pinhole, Rotation, Sim3, Vec3, nalgebra::Matrix3};
use monogrid_occupancy::{
    BRICK_CELLS, DepthScan, IntegrationConfig, IntegrationRule, MapError, OccupancyMap, PointScan,
    PoseSigma, Scan, ScanData, SigmaMode as OccupancySigmaMode, Similarity, integrate,
};

/// Axes of robotics (x forward, y left, z up) from those of the first camera (x right, y down, z
/// forward): the frame of all exports when nothing better is known about "up".
#[must_use]
pub fn z_up_from_camera_world() -> Sim3 {
    let matrix = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let rotation = Rotation::from_rotation_matrix(
        &monogrid_geometry::nalgebra::Rotation3::from_matrix_unchecked(matrix),
    );
    Sim3::new(1.0, rotation, Vec3::zeros())
}

/// What an integration did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MapStats {
    /// Measurements mapped.
    pub points: usize,
    /// Keyframes mapped.
    pub keyframes: usize,
}

/// Turns scans into maps with fixed settings.
#[derive(Clone, Debug)]
pub struct Mapper {
    config: MappingConfig,
    camera: KeyframeCamera,
    integration: IntegrationConfig,
    threads: usize,
}

impl Mapper {
    /// Prepares mapping of keyframes of one camera on `threads` threads.
    #[must_use]
    pub fn new(config: MappingConfig, camera: KeyframeCamera, threads: usize) -> Self {
        let integration = IntegrationConfig {
            rule: match config.integration {
                IntegrationKind::Fused => IntegrationRule::Fused,
                IntegrationKind::Rays => IntegrationRule::Rays,
            },
            model: config.sensor(),
            max_range: config.max_range,
            update_min: config.update_limits[0] as f32,
            update_max: config.update_limits[1] as f32,
            cutoff_log_odds: config.tail_log_odds as f32,
            // Depth from video has false measurements enough: they would gain as well.
            obstacle_weight: 0,
            sigma_mode: match config.sigma_mode {
                SigmaMode::Range => OccupancySigmaMode::Range,
                SigmaMode::RawInverseDepth => OccupancySigmaMode::RawInverseDepth,
            },
        };
        Self {
            config,
            camera,
            integration,
            threads,
        }
    }

    /// Prepares mapping of points, which need no camera.
    #[must_use]
    pub fn without_camera(config: MappingConfig, threads: usize) -> Self {
        let camera = KeyframeCamera {
            pinhole: Pinhole::new(1.0, 1.0, 0.0, 0.0),
            width: 0,
            height: 0,
        };
        Self::new(config, camera, threads)
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &MappingConfig {
        &self.config
    }

    /// The settings of the integration that follow from them.
    #[must_use]
    pub fn integration(&self) -> &IntegrationConfig {
        &self.integration
    }

    /// An empty map.
    ///
    /// # Errors
    /// A setting of the map outside its range.
    pub fn empty_map(&self) -> Result<OccupancyMap, MapError> {
        OccupancyMap::new(self.config.map_config())
    }

    /// Adds one scan to a map; returns how many measurements were used.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn integrate(
        &self,
        map: &mut OccupancyMap,
        scan: &KeyframeScan,
        map_from_keyframe: &Sim3,
    ) -> Result<usize, MapError> {
        let pinhole = &self.camera.pinhole;
        let num_filled = scan.num_filled;
        let scan = Scan {
            id: scan.id,
            world_from_sensor: similarity(map_from_keyframe),
            pose_sigma: self.pose_sigma(),
            data: ScanData::Depth(DepthScan {
                width: self.camera.width as u32,
                height: self.camera.height as u32,
                fx: pinhole.fx,
                fy: pinhole.fy,
                cx: pinhole.cx,
                cy: pinhole.cy,
                pixels: &scan.pixels,
            }),
        };
        integrate(map, &scan, &self.integration, self.threads)
            .map(|report| report.points.saturating_sub(num_filled))
    }

    /// Adds points measured from the origin of a sensor, with the standard deviation of each range.
    ///
    /// `world_from_sensor` are the rows of a 3x4 matrix.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn integrate_points(
        &self,
        map: &mut OccupancyMap,
        id: u32,
        world_from_sensor: &[f64; 12],
        map_from_world: &Sim3,
        (points, sigmas): (&[[f32; 3]], &[f32]),
    ) -> Result<usize, MapError> {
        let row = |i: usize| -> [f64; 4] { std::array::from_fn(|j| world_from_sensor[4 * i + j]) };
        let rigid = Similarity::from_rigid_rows([row(0), row(1), row(2)]);
        let outer = similarity(map_from_world);
        let scan = Scan {
            id,
            world_from_sensor: Similarity {
                scale: outer.scale,
                rotation: std::array::from_fn(|i| {
                    std::array::from_fn(|j| {
                        (0..3)
                            .map(|k| outer.rotation[i][k] * rigid.rotation[k][j])
                            .sum()
                    })
                }),
                translation: outer.transform(rigid.translation),
            },
            pose_sigma: self.pose_sigma(),
            data: ScanData::Points(PointScan { points, sigmas }),
        };
        // A range sensor, unlike depth from video, measures few obstacles that are not there.
        let integration = IntegrationConfig {
            obstacle_weight: IntegrationConfig::default().obstacle_weight,
            ..self.integration.clone()
        };
        integrate(map, &scan, &integration, self.threads).map(|report| report.points)
    }

    fn pose_sigma(&self) -> PoseSigma {
        PoseSigma {
            translation: self.config.pose_sigma,
            rotation_rad: self.config.pose_sigma_deg.to_radians(),
        }
    }

    /// A map from all scans, in the order of their ids, at the given poses.
    ///
    /// Scans without a pose are left out.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn build(
        &self,
        scans: &[KeyframeScan],
        world_from_keyframe: &[Option<Sim3>],
        map_from_world: &Sim3,
    ) -> Result<(OccupancyMap, MapStats), MapError> {
        let mut map = self.empty_map()?;
        let mut stats = MapStats::default();
        for (scan, pose) in scans.iter().zip(world_from_keyframe) {
            if let Some(pose) = pose {
                stats.points += self.integrate(&mut map, scan, &(*map_from_world * *pose))?;
                stats.keyframes += 1;
            }
        }
        Ok((map, stats))
    }
}

/// The same transform in the types of the occupancy crate.
fn similarity(transform: &Sim3) -> Similarity {
    let rotation = transform.to_se3().rotation_matrix();
    Similarity {
        scale: transform.scale,
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
        translation: transform.translation.into(),
    }
}

/// The three maps at the end of a run.
#[derive(Clone, Debug)]
pub struct Maps {
    /// Every keyframe at its final pose.
    pub global: OccupancyMap,
    /// Every keyframe at its first pose.
    pub large: OccupancyMap,
    /// *global* around the camera.
    pub local: OccupancyMap,
    /// What *global* was built from.
    pub stats: MapStats,
}

/// Maps that grow while keyframes are finished.
#[derive(Debug)]
pub struct LiveMaps {
    mapper: Mapper,
    map_from_world: Sim3,
    large: OccupancyMap,
    stats: MapStats,
    scans: Vec<KeyframeScan>,
    first_poses: Vec<Sim3>,
    /// Whether a scan changed after it was integrated.
    is_revised: bool,
}

impl LiveMaps {
    /// Empty maps in the frame given by `map_from_world`.
    ///
    /// # Errors
    /// A setting of the map outside its range.
    pub fn new(mapper: Mapper, map_from_world: Sim3) -> Result<Self, MapError> {
        Ok(Self {
            large: mapper.empty_map()?,
            mapper,
            map_from_world,
            stats: MapStats::default(),
            scans: Vec::new(),
            first_poses: Vec::new(),
            is_revised: false,
        })
    }

    /// Adds a finished keyframe at the pose it has now; keyframes come in the order of their ids.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn add(&mut self, scan: KeyframeScan, world_from_keyframe: Sim3) -> Result<(), MapError> {
        let pose = self.map_from_world * world_from_keyframe;
        self.stats.points += self.mapper.integrate(&mut self.large, &scan, &pose)?;
        self.stats.keyframes += 1;
        self.scans.push(scan);
        self.first_poses.push(world_from_keyframe);
        Ok(())
    }

    /// Takes better depth of a keyframe that was added before; the final *global* map uses it.
    pub fn revise(&mut self, scan: KeyframeScan) {
        if let Some(old) = self.scans.iter_mut().find(|old| old.id == scan.id) {
            self.is_revised |= *old != scan;
            *old = scan;
        }
    }

    /// What maps are built with.
    #[must_use]
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// The map as it is now.
    #[must_use]
    pub fn large(&self) -> &OccupancyMap {
        &self.large
    }

    /// What was mapped so far.
    #[must_use]
    pub fn stats(&self) -> MapStats {
        self.stats
    }

    /// The final maps: *global* at the poses of `snapshot`, all in the frame of `map_from_world`,
    /// *local* around `camera_in_map`.
    ///
    /// # Errors
    /// An invalid pose, or a map that would exceed its memory.
    pub fn finish(
        self,
        snapshot: &PoseSnapshot,
        map_from_world: &Sim3,
        camera_in_map: Option<Vec3>,
        threads: usize,
    ) -> Result<Maps, MapError> {
        let mapper = Mapper {
            threads,
            ..self.mapper
        };
        let in_same_frame = self.map_from_world == *map_from_world;
        let first: Vec<Option<Sim3>> = self.first_poses.iter().copied().map(Some).collect();
        let last: Vec<Option<Sim3>> = self
            .scans
            .iter()
            .map(|scan| snapshot.world_from_keyframe.get(scan.id as usize).copied())
            .collect();
        let large = if in_same_frame {
            self.large
        } else {
            mapper.build(&self.scans, &first, map_from_world)?.0
        };
        let (global, stats) = if first == last && !(in_same_frame && self.is_revised) {
            (large.clone(), self.stats)
        } else {
            mapper.build(&self.scans, &last, map_from_world)?
        };
        let local = match camera_in_map {
            Some(center) => within(&global, center, mapper.config.local_radius)?,
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

/// The cells of a map whose centres lie within a radius.
fn within(map: &OccupancyMap, center: Vec3, radius: f64) -> Result<OccupancyMap, MapError> {
    let mut part = OccupancyMap::new(map.config().clone())?;
    for brick in map.bricks() {
        for key in (0..BRICK_CELLS).map(|index| brick.cell(index)) {
            let cell: [f64; 3] = key.center(map.resolution());
            if (Vec3::from(cell) - center).norm() <= radius
                && let Some(log_odds) = map.log_odds_of(key)
            {
                part.set_log_odds(key, Some(log_odds))?;
            }
        }
    }
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DepthPixel;
    use monogrid_occupancy::{Occupancy, write_ot};

    const CAMERA: KeyframeCamera = KeyframeCamera {
        pinhole: Pinhole {
            fx: 40.0,
            fy: 40.0,
            cx: 31.5,
            cy: 23.5,
        },
        width: 64,
        height: 48,
    };

    fn config() -> MappingConfig {
        MappingConfig {
            resolution: 0.1,
            ..MappingConfig::default()
        }
    }

    /// A wall two units before the camera, in units of half that length.
    fn wall(id: u32) -> KeyframeScan {
        let pixels: Vec<DepthPixel> = (0..CAMERA.height as u16)
            .flat_map(|y| (0..CAMERA.width as u16).map(move |x| (x, y)))
            .map(|(x, y)| DepthPixel {
                x,
                y,
                idepth: 1.0,
                idepth_var: 1e-4,
            })
            .collect();
        KeyframeScan::new(id, &pixels, None, &CAMERA, &config())
    }

    fn pose(x: f64) -> Sim3 {
        Sim3::new(2.0, Rotation::identity(), Vec3::new(x, 0.0, 0.0))
    }

    fn bytes(map: &OccupancyMap) -> Vec<u8> {
        let mut out = Vec::new();
        write_ot(map, &mut out).unwrap();
        out
    }

    fn finished(last: &[Sim3], threads: usize) -> Maps {
        let mapper = Mapper::new(config(), CAMERA, threads);
        let z_up = z_up_from_camera_world();
        let mut live = LiveMaps::new(mapper, z_up).unwrap();
        for (id, x) in [(0, 0.0), (1, 0.3)] {
            live.add(wall(id), pose(x)).unwrap();
        }
        let snapshot = PoseSnapshot {
            revision: 1,
            world_from_keyframe: last.to_vec(),
            ..PoseSnapshot::default()
        };
        live.finish(&snapshot, &z_up, Some(Vec3::zeros()), threads)
            .unwrap()
    }

    #[test]
    fn a_wall_ahead_of_the_camera_is_ahead_and_upright_in_the_map() {
        let maps = finished(&[pose(0.0), pose(0.3)], 1);
        // x forward, y left, z up
        assert_eq!(maps.global.state([2.05, 0.0, 0.0]), Occupancy::Occupied);
        assert_eq!(maps.global.state([1.0, 0.0, 0.0]), Occupancy::Free);
        assert_eq!(maps.global.state([3.0, 0.0, 0.0]), Occupancy::Unknown);
        // the second keyframe is to the right: y < 0
        let right_edge = 2.0 * 31.0 / 40.0 + 0.2;
        assert_eq!(
            maps.global.state([2.05, -right_edge, 0.0]),
            Occupancy::Occupied
        );
        assert_eq!(
            maps.global.state([2.05, right_edge, 0.0]),
            Occupancy::Unknown
        );
        assert!(maps.stats.points > 4000 && maps.stats.keyframes == 2);
    }

    #[test]
    fn the_global_map_follows_the_poses_and_the_large_one_does_not() {
        let unmoved = finished(&[pose(0.0), pose(0.3)], 1);
        assert_eq!(bytes(&unmoved.global), bytes(&unmoved.large));
        let moved = finished(&[pose(0.0), pose(0.6)], 2);
        assert_eq!(bytes(&moved.large), bytes(&unmoved.large));
        assert_ne!(bytes(&moved.global), bytes(&unmoved.global));
        // always what a build from scratch gives
        let mapper = Mapper::new(config(), CAMERA, 1);
        let (scratch, stats) = mapper
            .build(
                &[wall(0), wall(1)],
                &[Some(pose(0.0)), Some(pose(0.6))],
                &z_up_from_camera_world(),
            )
            .unwrap();
        assert_eq!(bytes(&moved.global), bytes(&scratch));
        assert_eq!(moved.stats, stats);
    }

    #[test]
    fn the_local_map_is_the_part_of_the_global_one_around_the_camera() {
        let mut config = config();
        config.local_radius = 1.5;
        let mapper = Mapper::new(config, CAMERA, 1);
        let z_up = z_up_from_camera_world();
        let mut live = LiveMaps::new(mapper, z_up).unwrap();
        live.add(wall(0), pose(0.0)).unwrap();
        let snapshot = PoseSnapshot {
            revision: 1,
            world_from_keyframe: vec![pose(0.0)],
            ..PoseSnapshot::default()
        };
        let maps = live
            .finish(&snapshot, &z_up, Some(Vec3::zeros()), 1)
            .unwrap();
        for point in [[1.0, 0.05, 0.05], [0.5, 0.05, 0.05]] {
            assert_eq!(maps.local.log_odds(point), maps.global.log_odds(point));
        }
        assert_eq!(maps.global.state([2.05, 0.05, 0.05]), Occupancy::Occupied);
        assert_eq!(maps.local.state([2.05, 0.05, 0.05]), Occupancy::Unknown);
    }
}
