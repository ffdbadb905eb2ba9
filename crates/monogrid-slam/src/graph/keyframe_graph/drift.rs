//! What drift can do between keyframes: the one rule by which loops, and what is said about fragments, are
//! told from errors.

use super::state::KeyframeGraph;
use crate::KeyframeId;
use crate::graph::DriftConfig;
use crate::map::path_between;
use monogrid_geometry::{Sim3, Vec7};
use std::ops::Add;

/// The way along which tracking came from one keyframe to another.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Way {
    /// Keyframes.
    steps: f64,
    /// Length in units of the second keyframe.
    length: f64,
}

impl Add for Way {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            steps: self.steps + other.steps,
            length: self.length + other.length,
        }
    }
}

impl DriftConfig {
    /// Whether drift over a way can be as large as `error`, the logarithm of the similarity between what was
    /// measured and what was expected.
    ///
    /// Successive errors have common causes (calibration, the scale of what is seen), so drift grows with the
    /// way, not with its root as the edges of the graph would have it.
    pub(super) fn explains(&self, error: &Vec7, way: Way) -> bool {
        let (translation, rotation) = (error.fixed_rows::<3>(0), error.fixed_rows::<3>(3));
        translation.norm() <= self.translation_start + self.translation_share * way.length
            && rotation.norm() <= self.rotation_start + self.rotation_step * way.steps
            && error[6].abs() <= self.scale_start + self.scale_step * way.steps
    }

    /// The same growth over the way, from another start.
    pub(super) fn starting_at(&self, start: f64) -> Self {
        Self {
            translation_start: start,
            rotation_start: start,
            scale_start: start,
            ..self.clone()
        }
    }
}

impl KeyframeGraph {
    /// Whether the poses of two keyframes differ from a measurement by more than drift is at least. A loop that
    /// agrees with them would not correct anything but tie keyframes together that see each other from far
    /// away, where direct alignment is worse than what holds them: in a room that is in view all the time
    /// such edges make the poses worse.
    pub(super) fn is_drift(&self, i: KeyframeId, j: KeyframeId, i_from_j: &Sim3) -> bool {
        let error = self.contradiction(i, j, i_from_j);
        !self.config.places.drift.explains(&error, Way::default())
    }

    /// Whether the poses of two keyframes differ from a measurement by no more than tracking drifts between
    /// them. The edges of the graph expect less: a loop that corrects drift contradicts them, and would be
    /// switched off as if it were wrong.
    pub(super) fn can_have_drifted(&self, i: KeyframeId, j: KeyframeId, i_from_j: &Sim3) -> bool {
        let error = self.contradiction(i, j, i_from_j);
        self.config.places.drift.explains(&error, self.way(i, j))
    }

    /// Logarithm of the similarity between a measurement and the poses of two keyframes.
    fn contradiction(&self, i: KeyframeId, j: KeyframeId, i_from_j: &Sim3) -> Vec7 {
        (i_from_j.inverse() * self.relative(i, j)).log()
    }

    /// The way along which tracking came from one keyframe to another.
    pub(super) fn way(&self, i: KeyframeId, j: KeyframeId) -> Way {
        let path = path_between(|id| self.poses.parent_of(id), i, j);
        let position = |id: KeyframeId| self.pose(id).translation;
        let length = |pair: &[KeyframeId]| (position(pair[1]) - position(pair[0])).norm();
        let in_world: f64 = path.windows(2).map(length).sum();
        Way {
            steps: path.len().saturating_sub(1) as f64,
            length: in_world / self.pose(j).scale,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(translation: f64, rotation: f64, scale: f64) -> Vec7 {
        Vec7::from_column_slice(&[0.0, translation, 0.0, rotation, 0.0, 0.0, -scale])
    }

    #[test]
    fn drift_grows_with_the_way_and_each_part_has_its_own_limit() {
        let drift = DriftConfig {
            translation_start: 0.1,
            translation_share: 0.5,
            rotation_start: 0.2,
            rotation_step: 0.25,
            scale_start: 0.3,
            scale_step: 0.125,
        };
        let way = Way {
            steps: 1.0,
            length: 1.0,
        } + Way {
            steps: 3.0,
            length: 1.0,
        };
        // limits: 0.1 + 0.5 * 2, 0.2 + 0.25 * 4, 0.3 + 0.125 * 4
        assert!(drift.explains(&error(1.09, 1.19, 0.79), way));
        assert!(!drift.explains(&error(1.11, 0.0, 0.0), way));
        assert!(!drift.explains(&error(0.0, 1.21, 0.0), way));
        assert!(!drift.explains(&error(0.0, 0.0, 0.81), way));
        assert!(!drift.explains(&error(0.11, 0.0, 0.0), Way::default()));
        let later = drift.starting_at(0.6);
        assert!(later.explains(&error(1.59, 1.59, 1.09), way));
        assert!(!later.explains(&error(0.0, 0.0, 1.11), way));
        assert!(!later.explains(&error(0.0, f64::NAN, 0.0), way));
    }
}
