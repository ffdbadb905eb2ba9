//! A path beside the readings of an inertial sensor: a frame of the map in metres, with z against
//! gravity.

use crate::TrajectoryPose;
use monogrid_geometry::{Rotation, Sim3, Vec3};
use monogrid_inertial::{Estimate, EstimateConfig, Imu, NotDetermined, Observation, estimate};
use std::sync::Arc;

/// The path of the main map at one moment, and what an inertial sensor beside the camera read;
/// whoever has it can work on it in a thread of its own.
#[derive(Clone, Debug)]
pub struct InertialPath {
    imu: Arc<Imu>,
    observations: Vec<Observation>,
    config: EstimateConfig,
    is_metric: bool,
}

/// A frame for maps, as far as an inertial sensor has a say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensedFrame {
    /// From the world of the run.
    pub map_from_world: Sim3,
    /// Whether lengths in it are metres by the sensor.
    pub is_metric: bool,
    /// Whether its z is against gravity by the sensor.
    pub is_level: bool,
    /// Relative standard deviation of the scale as the sensor has it.
    pub scale_sigma: f64,
    /// Standard deviation of gravity's direction, rad.
    pub gravity_sigma_rad: f64,
}

impl InertialPath {
    pub(crate) fn new(
        imu: Arc<Imu>,
        path: &[TrajectoryPose],
        config: EstimateConfig,
        is_metric: bool,
    ) -> Self {
        let seen = |pose: &TrajectoryPose| Observation {
            timestamp_ns: pose.timestamp_ns,
            seen: Some((0, pose.world_from_camera)),
        };
        Self {
            imu,
            observations: path.iter().map(seen).collect(),
            config,
            is_metric,
        }
    }

    /// The frame given by `map_from_world`, made level by the shortest turn, and metric about its
    /// origin, where the readings are sure enough; a world that is metric already stays as long as
    /// it is. Takes some tenths of a second for a path of a minute.
    ///
    /// # Errors
    /// When nothing follows from the readings.
    pub fn sensed(&self, map_from_world: &Sim3) -> Result<SensedFrame, NotDetermined> {
        let found = estimate(&self.imu, &self.observations, &self.config)?;
        Ok(self.frame_of(&found, map_from_world))
    }

    fn frame_of(&self, found: &Estimate, map_from_world: &Sim3) -> SensedFrame {
        let is_metric = found.is_scale_determined && !self.is_metric;
        let is_level = found.is_gravity_determined;
        let scale = if is_metric {
            found.parts[0].metric_from_part.scale / map_from_world.scale
        } else {
            1.0
        };
        let turn = if is_level {
            turn_to_z(&(map_from_world.rotation * -found.down))
        } else {
            Rotation::identity()
        };
        SensedFrame {
            map_from_world: Sim3::new(scale, turn, Vec3::zeros()) * *map_from_world,
            is_metric,
            is_level,
            scale_sigma: found.parts[0].scale_sigma,
            gravity_sigma_rad: found.gravity_sigma_rad,
        }
    }
}

/// The shortest turn that brings a direction to z; from -z the one around x.
fn turn_to_z(direction: &Vec3) -> Rotation {
    Rotation::rotation_between(direction, &Vec3::z())
        .unwrap_or_else(|| Rotation::from_scaled_axis(Vec3::x() * std::f64::consts::PI))
}

impl SensedFrame {
    /// Whether a map in the frame of `shown` should be brought to this one: by less neither a robot
    /// nor a reader is misled, and all of the map has to be built again.
    #[must_use]
    pub fn is_another(&self, shown: &Sim3) -> bool {
        const MAX_SCALE_RATIO: f64 = 1.01;
        const MAX_TURN_RAD: f64 = 0.5 / 180.0 * std::f64::consts::PI;
        let ratio = self.map_from_world.scale / shown.scale;
        ratio.max(1.0 / ratio) > MAX_SCALE_RATIO
            || self.map_from_world.rotation.angle_to(&shown.rotation) > MAX_TURN_RAD
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PoseSource;
    use monogrid_geometry::{Se3, rotation_exp, z_up_from_camera_world};
    use monogrid_inertial::{GRAVITY_M_S2, ImuNoise, ImuSample};

    /// A camera that swings along all of its axes, pitched by `tilt` rad; its world has units of
    /// `unit` metres.
    fn path(tilt: f64, unit: f64, is_metric: bool) -> InertialPath {
        let camera_from_up = rotation_exp(&Vec3::new(tilt, 0.0, 0.0)) * -Vec3::y();
        let rates = [1.9, 2.6, 3.4];
        let place = |secs: f64| Vec3::from(rates.map(|rate| 0.1 * (rate * secs).sin()));
        let force = |secs: f64| {
            let pushed =
                Vec3::from(rates.map(|rate: f64| -0.1 * rate.powi(2) * (rate * secs).sin()));
            pushed + camera_from_up * GRAVITY_M_S2
        };
        let readings = (0..1200).map(|k| ImuSample {
            timestamp_ns: k * 5_000_000,
            angular_velocity: Vec3::zeros(),
            specific_force: force(k as f64 * 0.005),
        });
        let imu = Imu::new(readings.collect(), ImuNoise::default(), Se3::identity());
        let pose = |k: i64| TrajectoryPose {
            frame_index: k as usize,
            timestamp_ns: k * 33_000_000,
            world_from_camera: Se3::new(Rotation::identity(), place(k as f64 * 0.033) / unit),
            source: PoseSource::Certain,
        };
        let poses: Vec<TrajectoryPose> = (0..180).map(pose).collect();
        InertialPath::new(Arc::new(imu), &poses, EstimateConfig::default(), is_metric)
    }

    #[test]
    fn a_tilted_world_of_unknown_scale_becomes_level_and_metric() {
        let sensed = path(0.3, 2.5, false)
            .sensed(&z_up_from_camera_world())
            .unwrap();
        assert!(sensed.is_metric && sensed.is_level, "{sensed:?}");
        let frame = sensed.map_from_world;
        assert!((frame.scale / 2.5).ln().abs() < 0.01, "{sensed:?}");
        let up = rotation_exp(&Vec3::new(0.3, 0.0, 0.0)) * -Vec3::y();
        assert!(
            (frame.rotation * up).angle(&Vec3::z()) < 0.005,
            "{sensed:?}"
        );
        // the camera still looks along x, not to a side
        assert!((frame.rotation * Vec3::z()).y.abs() < 0.01, "{sensed:?}");
        // lengths that are metres already stay
        let sensed = path(0.3, 1.0, true)
            .sensed(&z_up_from_camera_world())
            .unwrap();
        assert!(!sensed.is_metric && sensed.map_from_world.scale == 1.0);
    }

    #[test]
    fn maps_are_brought_elsewhere_for_more_than_a_percent_or_half_a_degree_only() {
        let shown = z_up_from_camera_world();
        let frame = |scale: f64, degrees: f64| {
            let turn = rotation_exp(&Vec3::new(0.0, degrees.to_radians(), 0.0));
            SensedFrame {
                map_from_world: Sim3::new(scale, turn, Vec3::zeros()) * shown,
                is_metric: true,
                is_level: true,
                scale_sigma: 0.0,
                gravity_sigma_rad: 0.0,
            }
        };
        assert!(
            !frame(1.009, 0.4).is_another(&shown) && !frame(1.0 / 1.009, -0.4).is_another(&shown)
        );
        for (scale, degrees) in [(1.011, 0.0), (1.0 / 1.011, 0.0), (1.0, 0.6), (1.0, -0.6)] {
            assert!(
                frame(scale, degrees).is_another(&shown),
                "{scale} {degrees}"
            );
        }
    }

    #[test]
    fn what_stands_on_its_head_is_turned_around_x() {
        let turn = turn_to_z(&-Vec3::z());
        assert!((turn * -Vec3::z() - Vec3::z()).norm() < 1e-9);
        assert!((turn * Vec3::x() - Vec3::x()).norm() < 1e-9);
    }
}
