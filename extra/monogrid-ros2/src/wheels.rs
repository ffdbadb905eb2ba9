//! A robot's own odometry beside the camera: where its base is at each image, and how long a unit
//! of the camera's world is.
//!
//! Wheels measure metres, and slip; the camera measures shape, and knows no metre. Along the path
//! both say how far the camera moved between places a decimetre apart: the median of the
//! ratios is the scale, which wheels that spin for a while do not change.

use monogrid_geometry::median::{SIGMA_OF_MEDIAN, median};
use monogrid_geometry::{Se3, Sim3, Vec3};
use monogrid_slam::{KeyframeId, PoseSnapshot};
use std::collections::VecDeque;

/// Readings that are kept: some seconds.
const READINGS: usize = 500;
/// Distance between places that are compared, m.
const STEP: f64 = 0.1;
/// Places that are kept: the newest ones, some hundred metres of the way.
const PLACES: usize = 2000;
/// Fewer distances than this say nothing of their spread.
const LEAST_STEPS: usize = 10;
/// The standard error, relative, below which a scale is believed.
const BELIEVED: f64 = 0.02;
/// A scale that is believed changes when another one differs by this much, relative.
const CHANGE: f64 = 0.01;

/// How long a unit of the world is, and how sure that is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Metres of a unit.
    pub metres_per_unit: f64,
    /// Standard error, relative; `None` where somebody gave the scale.
    pub deviation: Option<f64>,
}

impl Scale {
    /// As somebody gave it.
    #[must_use]
    pub fn given(metres_per_unit: f64) -> Self {
        Self {
            metres_per_unit,
            deviation: None,
        }
    }
}

/// Where the camera was at an image, by both.
#[derive(Clone, Copy, Debug)]
struct Place {
    keyframe: KeyframeId,
    keyframe_from_camera: Sim3,
    /// By the wheels, m.
    odom_from_camera: Vec3,
}

/// The odometry of a robot, and what it says of the scale.
#[derive(Clone, Debug)]
pub struct Wheels {
    base_from_camera: Se3,
    /// Times, ns, and odom_from_base, m; times grow.
    readings: VecDeque<(i64, Se3)>,
    places: VecDeque<Place>,
    scale: Option<Scale>,
}

impl Wheels {
    /// For a camera that sits at `base_from_camera` (m).
    #[must_use]
    pub fn new(base_from_camera: Se3) -> Self {
        Self {
            base_from_camera,
            readings: VecDeque::new(),
            places: VecDeque::new(),
            scale: None,
        }
    }

    /// A reading. Where time jumps back, a recording begins again: what was read before is of no
    /// use.
    pub fn add(&mut self, time_ns: i64, odom_from_base: Se3) {
        if self.newest_ns().is_some_and(|newest| time_ns <= newest) {
            self.readings.clear();
        }
        if self.readings.len() == READINGS {
            self.readings.pop_front();
        }
        self.readings.push_back((time_ns, odom_from_base));
    }

    /// The time of the newest reading.
    #[must_use]
    pub fn newest_ns(&self) -> Option<i64> {
        self.readings.back().map(|(time_ns, _)| *time_ns)
    }

    /// odom_from_base at a time between readings.
    #[must_use]
    pub fn at(&self, time_ns: i64) -> Option<Se3> {
        let after = self.readings.partition_point(|(time, _)| *time < time_ns);
        let (end_ns, end) = self.readings.get(after)?;
        if *end_ns == time_ns {
            return Some(*end);
        }
        let (begin_ns, begin) = self.readings.get(after.checked_sub(1)?)?;
        let fraction = (time_ns - begin_ns) as f64 / (end_ns - begin_ns) as f64;
        Some(begin.interpolate(end, fraction))
    }

    /// The scale that is believed.
    #[must_use]
    pub fn scale(&self) -> Option<Scale> {
        self.scale
    }

    /// Nothing is known of the scale of the next world.
    pub fn begin_again(&mut self) {
        self.places.clear();
        self.scale = None;
    }

    /// The camera was tracked on a keyframe while the wheels were at `odom_from_base`; whether
    /// another scale is believed since.
    pub fn compare(
        &mut self,
        world_from_camera: &Se3,
        keyframe: KeyframeId,
        poses: &PoseSnapshot,
        odom_from_base: &Se3,
    ) -> bool {
        let Some(world_from_keyframe) = poses.in_main_map(keyframe) else {
            return false;
        };
        let odom_from_camera = (*odom_from_base * self.base_from_camera).translation;
        let last = self.places.back();
        let moved = last.map(|last| (odom_from_camera - last.odom_from_camera).norm());
        if moved.is_some_and(|moved| moved < STEP) {
            return false;
        }
        if self.places.len() == PLACES {
            self.places.pop_front();
        }
        self.places.push_back(Place {
            keyframe,
            keyframe_from_camera: world_from_keyframe.inverse() * world_from_camera.with_scale(1.0),
            odom_from_camera,
        });
        let estimate = self.estimate(poses);
        let estimate = estimate.filter(|found| found.deviation.is_some_and(|d| d < BELIEVED));
        let is_other = |found: &Scale| {
            let change = |scale: Scale| (found.metres_per_unit / scale.metres_per_unit).ln().abs();
            self.scale.is_none_or(|scale| change(scale) > CHANGE)
        };
        let Some(found) = estimate.filter(is_other) else {
            return false;
        };
        self.scale = Some(found);
        true
    }

    /// The scale of all places where the keyframes are now.
    fn estimate(&self, poses: &PoseSnapshot) -> Option<Scale> {
        let places = self.places.iter().filter_map(|place| {
            let world_from_camera =
                *poses.in_main_map(place.keyframe)? * place.keyframe_from_camera;
            Some((world_from_camera.translation, place.odom_from_camera))
        });
        let places: Vec<(Vec3, Vec3)> = places.collect();
        let ratios = places.windows(2).map(|pair| {
            let [(world, odom), (next_world, next_odom)] = [pair[0], pair[1]];
            ((next_odom - odom).norm() / (next_world - world).norm()).ln()
        });
        let mut ratios: Vec<f64> = ratios.filter(|ratio| ratio.is_finite()).collect();
        if ratios.len() < LEAST_STEPS {
            return None;
        }
        let middle = median(&mut ratios)?;
        let mut apart: Vec<f64> = ratios.iter().map(|ratio| (ratio - middle).abs()).collect();
        let spread = SIGMA_OF_MEDIAN * median(&mut apart)?;
        // the standard error of a median of numbers of a normal distribution
        let error = (std::f64::consts::FRAC_PI_2 / ratios.len() as f64).sqrt() * spread;
        Some(Scale {
            metres_per_unit: middle.exp(),
            deviation: Some(error),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Rotation;

    fn at(x: f64) -> Se3 {
        Se3::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0))
    }

    fn poses(scale: f64) -> PoseSnapshot {
        PoseSnapshot {
            world_from_keyframe: vec![at(0.0).with_scale(scale)],
            ..PoseSnapshot::default()
        }
    }

    #[test]
    fn where_the_base_is_between_readings() {
        let mut wheels = Wheels::new(Se3::identity());
        wheels.add(100, at(1.0));
        wheels.add(200, at(2.0));
        assert!((wheels.at(150).unwrap().translation.x - 1.5).abs() < 1e-12);
        assert_eq!(wheels.at(200), Some(at(2.0)));
        assert_eq!((wheels.at(99), wheels.at(201)), (None, None));
        // a recording begins again
        wheels.add(50, at(0.0));
        assert_eq!((wheels.at(150), wheels.at(50)), (None, Some(at(0.0))));
    }

    /// Drives `count` steps of a decimetre in a world whose unit is half a metre. Wheels read
    /// alternately too much and too little, and spin in every fifth step.
    fn drive(wheels: &mut Wheels, count: usize) -> usize {
        let (mut metres, mut read, mut changes) = (0.0, 0.0, 0);
        for step in 0..count {
            let error = if step % 2 == 0 { 1.02 } else { 0.98 };
            let moved = 0.12;
            metres += moved;
            read += if step % 5 == 0 {
                3.0 * moved
            } else {
                error * moved
            };
            changes += usize::from(wheels.compare(&at(metres / 0.5), 0, &poses(1.0), &at(read)));
        }
        changes
    }

    #[test]
    fn wheels_that_spin_now_and_then_give_the_scale_and_how_sure_it_is() {
        let mut wheels = Wheels::new(Se3::identity());
        assert_eq!(drive(&mut wheels, 8), 0);
        assert_eq!(wheels.scale(), None, "a metre says too little");
        wheels.begin_again();
        assert!(drive(&mut wheels, 60) >= 1);
        let scale = wheels.scale().unwrap();
        assert!(
            (scale.metres_per_unit / 0.5).ln().abs() < 0.025,
            "{scale:?}"
        );
        assert!(scale.deviation.unwrap() < BELIEVED);
        wheels.begin_again();
        assert_eq!(wheels.scale(), None);
    }

    #[test]
    fn a_map_that_changes_its_scale_has_another_unit() {
        let mut wheels = Wheels::new(Se3::identity());
        drive(&mut wheels, 60);
        let before = wheels.scale().unwrap();
        // the keyframe is now twice as large
        let moved = at(60.0);
        assert!(wheels.compare(&moved, 0, &poses(2.0), &at(40.0)));
        let ratio = before.metres_per_unit / wheels.scale().unwrap().metres_per_unit;
        assert!((ratio - 2.0).abs() < 0.05, "{ratio}");
    }

    #[test]
    fn of_a_long_way_the_newest_part_is_kept() {
        let mut wheels = Wheels::new(Se3::identity());
        drive(&mut wheels, PLACES + 100);
        assert_eq!(wheels.places.len(), PLACES);
        let scale = wheels.scale().unwrap().metres_per_unit;
        assert!((scale / 0.5).ln().abs() < 0.025, "{scale}");
    }
}
