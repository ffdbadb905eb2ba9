//! The frames of a robot (REP 105): map, odom, base.
//!
//! What the camera moved from image to image is added up in `odom_from_base`, which never jumps:
//! not when a loop is closed, not when the scale is set, not when the map is thrown away. All of
//! that goes into `map_from_odom`.

use crate::wheels::Scale;
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3};
use monogrid_mapping::z_up_from_camera_world;
use monogrid_slam::FrameReport;

/// How the camera sits on the robot: base_from_camera of the optical axes (x right, y down, z
/// forward), m, from the place of the camera and the angles of its body (x forward, y left, z up)
/// around x, y, z (roll, pitch, yaw; rad).
#[must_use]
pub fn mount(place: [f64; 3], [roll, pitch, yaw]: [f64; 3]) -> Se3 {
    let base_from_body = Rotation::from_euler_angles(roll, pitch, yaw);
    let body_from_optical = z_up_from_camera_world().rotation;
    Se3::new(base_from_body * body_from_optical, Vec3::from(place))
}

/// The frame of the map, from the world: that of the mapper, with its scale where neither somebody
/// nor wheels say how long a unit is. In it the camera was first at the origin, and its axes are
/// those of the base then, made level where an inertial sensor says so.
#[must_use]
pub fn frame_of_map(mapper_from_world: &Sim3, scale: Option<Scale>) -> Sim3 {
    Sim3 {
        scale: scale.map_or(mapper_from_world.scale, |scale| scale.metres_per_unit),
        ..*mapper_from_world
    }
}

/// A pose of the camera in the map, m, from that in the world.
#[must_use]
pub fn map_from_camera(map_from_world: &Sim3, world_from_camera: &Se3) -> Se3 {
    (*map_from_world * world_from_camera.with_scale(1.0)).to_se3()
}

/// Where everything is at one image, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Poses {
    /// The robot in the map.
    pub map_from_base: Se3,
    /// The robot by what moved.
    pub odom_from_base: Se3,
    /// last_from_this of the robot since the last image that was tracked without a gap.
    pub step: Option<Se3>,
}

impl Poses {
    /// What the map corrects of odometry.
    #[must_use]
    pub fn map_from_odom(&self) -> Se3 {
        self.map_from_base * self.odom_from_base.inverse()
    }
}

/// From reports of a camera of unknown scale to the frames of a robot.
#[derive(Clone, Debug)]
pub struct Frames {
    base_from_camera: Se3,
    /// The frame of the map from now on.
    pub map_from_world: Sim3,
    odom_from_base: Option<Se3>,
    /// odom_from_camera of the last report with a pose, in units of the world.
    last: Option<Se3>,
    /// Whether that was the last image.
    is_without_gap: bool,
}

impl Frames {
    /// For a camera that sits at `base_from_camera` (m), in a map of this frame.
    #[must_use]
    pub fn new(base_from_camera: Se3, map_from_world: Sim3) -> Self {
        Self {
            base_from_camera,
            map_from_world,
            odom_from_base: None,
            last: None,
            is_without_gap: false,
        }
    }

    /// The next report belongs to a new world. Odometry goes on from where it is.
    pub fn begin_again(&mut self) {
        self.last = None;
        self.is_without_gap = false;
    }

    /// Where everything is after a report; `None` where the camera has no pose in the map.
    pub fn advance(&mut self, report: &FrameReport) -> Option<Poses> {
        let poses = report.world_from_camera.zip(report.odom_from_camera);
        let Some((world_from_camera, odom_from_camera)) = poses else {
            self.is_without_gap = false;
            return None;
        };
        let (base_from_camera, camera_from_base) =
            (self.base_from_camera, self.base_from_camera.inverse());
        let map_from_base =
            map_from_camera(&self.map_from_world, &world_from_camera) * camera_from_base;
        let last = self.last.replace(odom_from_camera);
        let step = last.map(|last| {
            let metric = (last.inverse() * odom_from_camera).stretched(self.map_from_world.scale);
            base_from_camera * metric * camera_from_base
        });
        let before = *self.odom_from_base.get_or_insert(map_from_base);
        let odom_from_base = step.map_or(before, |step| before * step);
        self.odom_from_base = Some(odom_from_base);
        let was_without_gap = std::mem::replace(&mut self.is_without_gap, true);
        Some(Poses {
            map_from_base,
            odom_from_base,
            step: step.filter(|_| was_without_gap),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::rotation_exp;
    use monogrid_slam::TrackingState;

    fn pose(x: f64, y: f64, z: f64) -> Se3 {
        Se3::new(Rotation::identity(), Vec3::new(x, y, z))
    }

    fn report(world_from_camera: Option<Se3>, odom_from_camera: Option<Se3>) -> FrameReport {
        FrameReport {
            world_from_camera,
            odom_from_camera,
            ..FrameReport::new(0, 0, TrackingState::Good)
        }
    }

    fn near(a: &Se3, b: &Se3) -> bool {
        (a.inverse() * *b).log().norm() < 1e-9
    }

    fn frames(base_from_camera: Se3, metres_per_unit: f64) -> Frames {
        let axes = base_from_camera.rotation;
        let map_from_world = Sim3::new(metres_per_unit, axes, Vec3::zeros());
        Frames::new(base_from_camera, map_from_world)
    }

    /// The camera 1 m above the base, looking ahead.
    fn on_a_mast() -> Se3 {
        mount([0.0, 0.0, 1.0], [0.0; 3])
    }

    #[test]
    fn a_camera_that_moves_forward_moves_the_robot_along_x() {
        let mut frames = frames(on_a_mast(), 2.0);
        let first = frames.advance(&report(
            Some(pose(0.0, 0.0, 0.0)),
            Some(pose(0.0, 0.0, 0.0)),
        ));
        // the map begins at the camera, 1 m above the base
        assert!(near(&first.unwrap().map_from_base, &pose(0.0, 0.0, -1.0)));
        assert!(near(&first.unwrap().map_from_odom(), &Se3::identity()));
        assert_eq!(first.unwrap().step, None);
        // optical z is forward
        let moved = pose(0.0, 0.0, 1.5);
        let second = frames.advance(&report(Some(moved), Some(moved))).unwrap();
        assert!(near(&second.map_from_base, &pose(3.0, 0.0, -1.0)));
        assert!(near(&second.odom_from_base, &pose(3.0, 0.0, -1.0)));
        assert!(near(&second.step.unwrap(), &pose(3.0, 0.0, 0.0)));
    }

    #[test]
    fn a_camera_that_looks_down_gives_a_level_map() {
        // pitched down by 30 degrees; what it sees as down-forward is level for the robot
        let tilt = 30_f64.to_radians();
        let mut frames = frames(mount([0.2, 0.0, 0.5], [0.0, tilt, 0.0]), 1.0);
        let start = Se3::identity();
        frames.advance(&report(Some(start), Some(start)));
        // the robot drives 1 m ahead: in optical axes up by sin, forward by cos
        let ahead = pose(0.0, -tilt.sin(), tilt.cos());
        let poses = frames.advance(&report(Some(ahead), Some(ahead))).unwrap();
        assert!(near(&poses.step.unwrap(), &pose(1.0, 0.0, 0.0)));
        let turn = poses.map_from_base.rotation;
        assert!(turn.angle() < 1e-9);
    }

    #[test]
    fn the_lever_of_the_mount_turns_with_the_robot() {
        // the camera is 1 m ahead of the base, which turns by 90 degrees to the left on the spot
        let mut frames = frames(mount([1.0, 0.0, 0.0], [0.0; 3]), 1.0);
        let start = Se3::identity();
        frames.advance(&report(Some(start), Some(start)));
        // left is -x of the optical axes, and a turn to the left one around -y
        let turned = Se3::new(
            rotation_exp(&Vec3::new(0.0, -std::f64::consts::FRAC_PI_2, 0.0)),
            Vec3::new(-1.0, 0.0, -1.0),
        );
        let poses = frames.advance(&report(Some(turned), Some(turned))).unwrap();
        let step = poses.step.unwrap();
        assert!(step.translation.norm() < 1e-9, "{step:?}");
        assert!((step.rotation.euler_angles().2 - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    }

    #[test]
    fn corrections_of_the_map_and_of_the_scale_never_move_odometry() {
        let mut frames = frames(on_a_mast(), 1.0);
        let start = Se3::identity();
        frames.advance(&report(Some(start), Some(start)));
        let tracked = pose(0.0, 0.0, 1.0);
        let before = frames
            .advance(&report(Some(tracked), Some(tracked)))
            .unwrap();
        // a loop moves the camera in the map by half a metre, nothing moved
        let corrected = pose(0.5, 0.0, 1.0);
        let after = frames
            .advance(&report(Some(corrected), Some(tracked)))
            .unwrap();
        assert!(near(&after.odom_from_base, &before.odom_from_base));
        assert!(near(&after.map_from_odom(), &pose(0.0, -0.5, 0.0)));
        // the scale is set: what is added from now on is longer, what was added stays
        let axes = on_a_mast().rotation;
        frames.map_from_world = Sim3::new(3.0, axes, Vec3::zeros());
        let still = frames
            .advance(&report(Some(corrected), Some(tracked)))
            .unwrap();
        assert!(near(&still.odom_from_base, &before.odom_from_base));
        assert!(near(&still.map_from_base, &pose(3.0, -1.5, -1.0)));
        let on = pose(0.0, 0.0, 2.0);
        let moved = frames.advance(&report(Some(on), Some(on))).unwrap();
        assert!(near(&moved.step.unwrap(), &pose(3.0, 0.0, 0.0)));
    }

    #[test]
    fn a_map_that_becomes_level_and_metric_never_moves_odometry() {
        let mut frames = frames(on_a_mast(), 1.0);
        let start = Se3::identity();
        frames.advance(&report(Some(start), Some(start)));
        let at = pose(0.0, 0.0, 1.0);
        let before = frames.advance(&report(Some(at), Some(at))).unwrap();
        // the robot stands on a slope: its nose is up by 0.1 rad, and a unit is 2 m
        let level = Rotation::from_scaled_axis(Vec3::new(0.0, -0.1, 0.0));
        let mapper_from_world = Sim3::new(2.0, level * on_a_mast().rotation, Vec3::zeros());
        frames.map_from_world = frame_of_map(&mapper_from_world, None);
        let after = frames.advance(&report(Some(at), Some(at))).unwrap();
        assert!(near(&after.odom_from_base, &before.odom_from_base));
        let ahead = after.map_from_base * on_a_mast() * Vec3::zeros();
        let expected = Vec3::new(2.0 * 0.1_f64.cos(), 0.0, 2.0 * 0.1_f64.sin());
        assert!((ahead - expected).norm() < 1e-9, "{ahead}");
        // what was given counts more than what was measured
        assert_eq!(
            frame_of_map(&mapper_from_world, Some(Scale::given(3.0))).scale,
            3.0
        );
        assert_eq!(frame_of_map(&mapper_from_world, None), mapper_from_world);
    }

    #[test]
    fn a_lost_camera_has_no_pose_and_odometry_waits() {
        let mut frames = frames(on_a_mast(), 1.0);
        let at = pose(0.0, 0.0, 1.0);
        let before = frames.advance(&report(Some(at), Some(at))).unwrap();
        assert_eq!(frames.advance(&report(None, None)), None);
        // in a fragment there is a pose, but not in the map
        assert_eq!(frames.advance(&report(None, Some(at))), None);
        let found = pose(1.0, 0.0, 4.0);
        let again = frames.advance(&report(Some(found), Some(at))).unwrap();
        assert!(near(&again.odom_from_base, &before.odom_from_base));
        assert_eq!(again.step, None, "the velocity over a gap is not known");
        assert!(
            frames
                .advance(&report(Some(found), Some(at)))
                .unwrap()
                .step
                .is_some()
        );
    }

    #[test]
    fn a_new_world_takes_over_where_odometry_is() {
        let mut frames = frames(on_a_mast(), 1.0);
        let at = pose(0.0, 0.0, 1.0);
        frames.advance(&report(Some(Se3::identity()), Some(Se3::identity())));
        let before = frames.advance(&report(Some(at), Some(at))).unwrap();
        frames.begin_again();
        let start = Se3::identity();
        let again = frames.advance(&report(Some(start), Some(start))).unwrap();
        assert!(near(&again.odom_from_base, &before.odom_from_base));
        assert!(near(&again.map_from_base, &pose(0.0, 0.0, -1.0)));
        assert_eq!(again.step, None);
    }
}
