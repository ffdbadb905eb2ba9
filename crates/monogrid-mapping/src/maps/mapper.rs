//! One scan into one map.

use crate::{AutoLength, KeyframeCamera, KeyframeScan, MappingConfig, SensorModelKind};
use monogrid_geometry::Sim3;
use monogrid_occupancy::{
    DepthPixel as Measurement, DepthScan, IntegrationConfig, MapError, OccupancyMap, PointScan,
    PoseSigma, Scan, ScanData, Similarity, integrate, integrate_scans,
};
use std::sync::atomic::{AtomicUsize, Ordering};

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
    /// The settings of the integration that follow from them.
    pub(super) integration: IntegrationConfig,
    pub(super) threads: usize,
}

impl Mapper {
    /// Prepares mapping on `threads` threads.
    #[must_use]
    pub fn new(config: MappingConfig, threads: usize) -> Self {
        let integration = IntegrationConfig {
            rule: config.integration,
            model: config.sensor(),
            max_range: config.max_range,
            update_min: config.update_limits[0] as f32,
            update_max: config.update_limits[1] as f32,
            cutoff_log_odds: config.tail_log_odds as f32,
            updates_to_belief: match config.sensor_model {
                // states the probabilities of single measurements
                SensorModelKind::Andert => [0, 0],
                _ => config.updates_to_belief,
            },
            // Depth from video has false measurements enough: they would gain as well.
            obstacle_weight: 0,
            band_by_slope: true,
            sigma_mode: config.sigma_mode,
        };
        Self {
            config,
            integration,
            threads,
        }
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &MappingConfig {
        &self.config
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
        let pixels = scan.pixels();
        let occupancy_scan = self.scan(scan, &pixels, map_from_keyframe);
        integrate(map, &occupancy_scan, &self.integration, self.threads)
            .map(|report| report.points.saturating_sub(scan.num_filled))
    }

    /// Makes the space that the camera moved through free (`body_radius`): paths as
    /// [`super::super::camera_paths`] gives them.
    ///
    /// # Errors
    /// A map that would exceed its memory.
    pub fn free_body(
        &self,
        map: &mut OccupancyMap,
        paths: &[Vec<[f64; 3]>],
    ) -> Result<(), MapError> {
        let radius = match self.config.body_radius {
            AutoLength::Auto => self.config.resolution,
            AutoLength::Fixed(radius) => radius,
        };
        if radius > 0.0 {
            for path in paths {
                map.free_along(path, radius)?;
            }
        }
        Ok(())
    }

    /// A scan at a pose as the occupancy map takes it.
    pub(super) fn scan<'a>(
        &self,
        scan: &KeyframeScan,
        pixels: &'a [Measurement],
        map_from_keyframe: &Sim3,
    ) -> Scan<'a> {
        let KeyframeCamera {
            pinhole,
            width,
            height,
        } = scan.camera;
        Scan {
            id: scan.id,
            world_from_sensor: similarity(map_from_keyframe),
            pose_sigma: self.pose_sigma(),
            data: ScanData::Depth(DepthScan {
                width: width as u32,
                height: height as u32,
                fx: pinhole.fx,
                fy: pinhole.fy,
                cx: pinhole.cx,
                cy: pinhole.cy,
                pixels,
            }),
        }
    }

    /// The same on another number of threads; the results are the same.
    pub(super) fn with_threads(&self, threads: usize) -> Self {
        Self {
            threads,
            ..self.clone()
        }
    }

    /// The same with cells of another edge.
    #[must_use]
    pub fn with_resolution(&self, edge: f64) -> Self {
        let config = MappingConfig {
            resolution: edge,
            ..self.config.clone()
        };
        Self::new(config, self.threads)
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
        let rigid = Similarity::from_rigid(world_from_sensor);
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
            // nor are its points as dense as an image
            band_by_slope: false,
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
        let posed = scans.iter().zip(world_from_keyframe);
        let posed: Vec<(&KeyframeScan, Sim3)> = posed
            .filter_map(|(scan, pose)| Some((scan, *map_from_world * (*pose)?)))
            .collect();
        self.build_posed(&posed, &AtomicUsize::new(0))
    }

    /// As [`Mapper::build`], of scans with `map_from_keyframe`; `done` grows with the keyframes,
    /// for those who wait.
    pub(super) fn build_posed(
        &self,
        posed: &[(&KeyframeScan, Sim3)],
        done: &AtomicUsize,
    ) -> Result<(OccupancyMap, MapStats), MapError> {
        /// Keyframes that are in memory, and counted, at once, per thread: twice as many as are
        /// integrated together.
        const COUNTED: usize = 4;
        let mut map = self.empty_map()?;
        let num_filled: usize = posed.iter().map(|(scan, _)| scan.num_filled).sum();
        let mut points = 0;
        for some in posed.chunks(COUNTED * self.threads) {
            let pixels: Vec<_> = some.iter().map(|(scan, _)| scan.pixels()).collect();
            let scans = some.iter().zip(&pixels);
            let scans: Vec<Scan> = scans
                .map(|((scan, pose), pixels)| self.scan(scan, pixels, pose))
                .collect();
            points += integrate_scans(&mut map, &scans, &self.integration, self.threads)?.points;
            done.fetch_add(some.len(), Ordering::Relaxed);
        }
        let stats = MapStats {
            points: points.saturating_sub(num_filled),
            keyframes: posed.len(),
        };
        Ok((map, stats))
    }
}

/// The same transform in the types of the occupancy crate.
pub(super) fn similarity(transform: &Sim3) -> Similarity {
    let rotation = transform.to_se3().rotation_matrix();
    Similarity {
        scale: transform.scale,
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
        translation: transform.translation.into(),
    }
}
