//! Where the camera is at any time: built-in motions, recorded trajectories, smoothly interpolated.

use super::jitter::{CAR_JITTER, DRONE_JITTER, HAND_JITTER, Jitter, JitterBand};
use monogrid_datasets::TimedPose;
use monogrid_geometry::nalgebra::Rotation3;
use monogrid_geometry::{Mat3, Rotation, Se3, Vec3, Vec6};

/// Who carries the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// A hand: slow, trembling.
    Hand,
    /// A drone: swaying.
    Drone,
    /// A car: held fast, rocking a little.
    Car,
    /// Rails: no unsteadiness at all.
    Rails,
}

/// What is wrong with a recorded motion.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum PathError {
    /// Not enough of it: so many poses or waypoints.
    #[error("a camera path needs at least 2 poses, found {0}")]
    TooShort(usize),
    /// Times that do not increase, first at this pose, counted from 0.
    #[error(
        "pose {0} of the camera path is not later than the one before it; sort the file by time"
    )]
    Unsorted(usize),
    /// Poses that are not numbers, first this one, counted from 0.
    #[error("pose {0} of the camera path is not finite")]
    NotFinite(usize),
}

/// A smooth camera motion from time 0 to [`Self::duration_secs`].
#[derive(Clone, Debug)]
pub struct CameraPath {
    kind: Kind,
    duration_secs: f64,
    is_backwards: bool,
}

#[derive(Clone, Debug)]
enum Kind {
    Scripted {
        eyes: Vec<Vec3>,
        targets: Vec<Vec3>,
        jitter: Option<Jitter>,
    },
    Recorded {
        knots: Vec<Se3>,
    },
}

/// A point of a scripted motion: where the camera is and what it looks at (x, y, z in the world,
/// m).
pub type Waypoint = ([f64; 3], [f64; 3]);

impl CameraPath {
    /// A motion through waypoints, evenly spread over the duration: cubic B-splines of the eye and
    /// of the point looked at, plus the unsteadiness of the carrier.
    ///
    /// # Errors
    /// With fewer than two waypoints.
    pub fn scripted(
        waypoints: &[Waypoint],
        carrier: Carrier,
        duration_secs: f64,
        seed: u64,
    ) -> Result<Self, PathError> {
        if waypoints.len() < 2 {
            return Err(PathError::TooShort(waypoints.len()));
        }
        let bands: &[JitterBand] = match carrier {
            Carrier::Hand => &HAND_JITTER,
            Carrier::Drone => &DRONE_JITTER,
            Carrier::Car => &CAR_JITTER,
            Carrier::Rails => &[],
        };
        Ok(Self {
            kind: Kind::Scripted {
                eyes: waypoints.iter().map(|w| Vec3::from(w.0)).collect(),
                targets: waypoints.iter().map(|w| Vec3::from(w.1)).collect(),
                jitter: (!bands.is_empty()).then(|| Jitter::new(bands, seed)),
            },
            duration_secs,
            is_backwards: false,
        })
    }

    /// A recorded motion (TUM or EuRoC file), resampled to `knots_hz` control poses per second of a
    /// cumulative cubic B-spline on SE(3); 20 Hz keeps a hand's motion and drops the tracker's
    /// noise.
    ///
    /// # Errors
    /// With fewer than two poses, unsorted times, or poses that are not finite.
    pub fn recorded(poses: &[TimedPose], knots_hz: f64) -> Result<Self, PathError> {
        if poses.len() < 2 {
            return Err(PathError::TooShort(poses.len()));
        }
        for (index, pose) in poses.iter().enumerate() {
            if !pose.world_from_camera.is_finite() {
                return Err(PathError::NotFinite(index));
            }
            if index > 0 && pose.timestamp_ns <= poses[index - 1].timestamp_ns {
                return Err(PathError::Unsorted(index));
            }
        }
        let start = poses[0].timestamp_ns;
        let secs = |ns: i64| (ns - start) as f64 * 1e-9;
        let duration_secs = secs(poses[poses.len() - 1].timestamp_ns);
        let count = ((duration_secs * knots_hz).round() as usize).max(1) + 1;
        let mut at = 0;
        let knots = (0..count)
            .map(|k| {
                let time = duration_secs * k as f64 / (count - 1) as f64;
                while at + 2 < poses.len() && secs(poses[at + 1].timestamp_ns) < time {
                    at += 1;
                }
                let (a, b) = (&poses[at], &poses[at + 1]);
                let (ta, tb) = (secs(a.timestamp_ns), secs(b.timestamp_ns));
                let fraction = ((time - ta) / (tb - ta)).clamp(0.0, 1.0);
                a.world_from_camera
                    .interpolate(&b.world_from_camera, fraction)
            })
            .collect();
        Ok(Self {
            kind: Kind::Recorded { knots },
            duration_secs,
            is_backwards: false,
        })
    }

    /// The same poses, known to be a way from its end to its beginning: what else moves goes back
    /// too.
    #[must_use]
    pub(crate) fn played_backwards(mut self) -> Self {
        self.is_backwards = true;
        self
    }

    /// Part of the way that is gone at a time, in [0, 1].
    #[must_use]
    pub(crate) fn progress(&self, secs: f64) -> f64 {
        let progress = (secs / self.duration_secs.max(1e-9)).clamp(0.0, 1.0);
        if self.is_backwards {
            1.0 - progress
        } else {
            progress
        }
    }

    /// Length in time, s.
    #[must_use]
    pub fn duration_secs(&self) -> f64 {
        self.duration_secs
    }

    /// Pose at a time, clamped to the duration.
    #[must_use]
    pub fn world_from_camera(&self, secs: f64) -> Se3 {
        let secs = secs.clamp(0.0, self.duration_secs);
        let progress = secs / self.duration_secs.max(1e-9);
        match &self.kind {
            Kind::Scripted {
                eyes,
                targets,
                jitter,
            } => {
                let smooth = look_at(&spline(eyes, progress), &spline(targets, progress));
                let Some(shake) = jitter.as_ref().map(|jitter| jitter.at(secs)) else {
                    return smooth;
                };
                let rotation = smooth.rotation * shake.rotation;
                Se3::new(rotation, smooth.translation + shake.translation)
            }
            Kind::Recorded { knots } => pose_spline(knots, progress),
        }
    }

    /// Distance travelled, sampled at `rate_hz`, m.
    #[must_use]
    pub fn length_m(&self, rate_hz: f64) -> f64 {
        let count = (self.duration_secs * rate_hz) as usize;
        let at = |k: usize| self.world_from_camera(k as f64 / rate_hz).translation;
        (0..count).map(|k| (at(k + 1) - at(k)).norm()).sum()
    }
}

/// Pose of a camera at `eye` that looks at `target` with the horizon level (z up).
#[must_use]
pub fn look_at(eye: &Vec3, target: &Vec3) -> Se3 {
    let forward = (target - eye).try_normalize(1e-9).unwrap_or_else(Vec3::x);
    // straight up or down any heading will do
    let right = forward.cross(&Vec3::z()).try_normalize(1e-6);
    let right = right.unwrap_or_else(Vec3::x);
    let down = forward.cross(&right);
    let matrix = Mat3::from_columns(&[right, down, forward]);
    let rotation = Rotation3::from_matrix_unchecked(matrix);
    Se3::new(Rotation::from_rotation_matrix(&rotation), *eye)
}

/// Segment and position in it of a progress in [0, 1] over `count` control points.
fn segment(count: usize, progress: f64) -> (usize, f64) {
    let position = progress.clamp(0.0, 1.0) * (count - 1) as f64;
    let k = (position as usize).min(count - 2);
    (k, position - k as f64)
}

/// The four points of segment `k`; beyond an end stands the mirror image of the point inside it.
fn around<T: Copy>(points: &[T], k: usize, mirror: impl Fn(&T, &T) -> T) -> [T; 4] {
    let last = points.len() - 1;
    let before = match k {
        0 => mirror(&points[0], &points[1]),
        _ => points[k - 1],
    };
    let after = points.get(k + 2).copied();
    let after = after.unwrap_or_else(|| mirror(&points[last], &points[last - 1]));
    [before, points[k], points[k + 1], after]
}

/// Uniform cubic B-spline; mirrored ends, so that it starts and ends on the first and last point.
fn spline(points: &[Vec3], progress: f64) -> Vec3 {
    let (k, s) = segment(points.len(), progress);
    let [before, from, to, after] = around(points, k, |end, inner| 2.0 * end - inner);
    let (s2, s3) = (s * s, s * s * s);
    (before * (1.0 - s).powi(3)
        + from * (3.0 * s3 - 6.0 * s2 + 4.0)
        + to * (-3.0 * s3 + 3.0 * s2 + 3.0 * s + 1.0)
        + after * s3)
        / 6.0
}

/// Cumulative cubic B-spline on SE(3) (`[LOVEGROVE13]` equations 3 and 4).
fn pose_spline(knots: &[Se3], progress: f64) -> Se3 {
    let (k, s) = segment(knots.len(), progress);
    let chain = around(knots, k, |end, inner| *end * inner.inverse() * *end);
    let (s2, s3) = (s * s, s * s * s);
    let weights = [
        (5.0 + 3.0 * s - 3.0 * s2 + s3) / 6.0,
        (1.0 + 3.0 * s + 3.0 * s2 - 2.0 * s3) / 6.0,
        s3 / 6.0,
    ];
    let mut pose = chain[0];
    for (i, weight) in weights.iter().enumerate() {
        let step: Vec6 = (chain[i].inverse() * chain[i + 1]).log();
        pose = pose * Se3::exp(&(step * *weight));
    }
    pose
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waypoints() -> Vec<Waypoint> {
        (0..8)
            .map(|k| {
                let a = f64::from(k) * 0.6;
                ([a.cos(), a.sin(), 1.4], [3.0 * (a + 0.3).cos(), 3.0, 1.0])
            })
            .collect()
    }

    /// Largest jump of the second difference of the position, m/s².
    fn largest_acceleration(path: &CameraPath) -> f64 {
        let h = 1e-3;
        let count = (path.duration_secs() / h) as usize - 2;
        (0..count)
            .map(|k| {
                let at = |i: usize| path.world_from_camera((k + i) as f64 * h).translation;
                (at(2) - 2.0 * at(1) + at(0)).norm() / (h * h)
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn looking_at_a_point_puts_it_on_the_optical_axis_with_the_sky_up() {
        let (eye, target) = (Vec3::new(1.0, 2.0, 1.5), Vec3::new(3.0, -1.0, 0.5));
        let camera_from_world = look_at(&eye, &target).inverse();
        let seen = camera_from_world * target;
        assert!(seen.xy().norm() < 1e-12 && seen.z > 0.0);
        let above = camera_from_world * (target + Vec3::z());
        assert!(above.y < 0.0 && above.x.abs() < 1e-12);
    }

    #[test]
    fn scripted_paths_have_bounded_acceleration() {
        for (carrier, limit) in [
            (Carrier::Rails, 1.5),
            (Carrier::Hand, 4.0),
            (Carrier::Drone, 8.0),
        ] {
            let path = CameraPath::scripted(&waypoints(), carrier, 8.0, 1).unwrap();
            let found = largest_acceleration(&path);
            assert!(found < limit, "{carrier:?}: {found}");
        }
    }

    #[test]
    fn pose_spline_reproduces_constant_motion() {
        let twist = Vec6::new(0.1, -0.02, 0.05, 0.02, 0.05, -0.03);
        let poses: Vec<TimedPose> = (0..20)
            .map(|k| TimedPose {
                timestamp_ns: 1_000_000_000 + i64::from(k) * 50_000_000,
                world_from_camera: Se3::exp(&(twist * f64::from(k))),
            })
            .collect();
        let path = CameraPath::recorded(&poses, 10.0).unwrap();
        for k in 0..60 {
            let secs = path.duration_secs() * f64::from(k) / 59.0;
            let expected = Se3::exp(&(twist * (secs / 0.05)));
            let error = (path.world_from_camera(secs) * expected.inverse())
                .log()
                .norm();
            assert!(error < 1e-9, "{secs}: {error}");
        }
    }

    #[test]
    fn bad_recordings_are_refused() {
        let pose = |ns| TimedPose {
            timestamp_ns: ns,
            world_from_camera: Se3::identity(),
        };
        assert_eq!(
            CameraPath::recorded(&[pose(0)], 20.0).err(),
            Some(PathError::TooShort(1))
        );
        let unsorted = [pose(0), pose(5), pose(5)];
        assert_eq!(
            CameraPath::recorded(&unsorted, 20.0).err(),
            Some(PathError::Unsorted(2))
        );
    }
}
