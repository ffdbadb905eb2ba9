//! Poses.

use monogrid_geometry::nalgebra::Quaternion as Quaternion4;
use monogrid_geometry::{Rotation, Se3, Vec3, rotation_log};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::{
    Covariance, Pose, PoseStamped, PoseWithCovariance, Quaternion, Transform, TransformStamped,
    Twist, TwistWithCovariance, Vector3,
};
use monogrid_messages::nav_msgs::{Odometry, Path};
use monogrid_messages::std_msgs::Header;

/// A pose, m.
#[must_use]
pub fn pose_of(parent_from_child: &Se3) -> Pose {
    Pose {
        position: vector_of(&parent_from_child.translation),
        orientation: quaternion_of(parent_from_child),
    }
}

/// A transform between the frame of the header and its child, m.
#[must_use]
pub fn transform_of(header: Header, child: &str, parent_from_child: &Se3) -> TransformStamped {
    TransformStamped {
        header,
        child_frame_id: child.to_owned(),
        transform: Transform {
            translation: vector_of(&parent_from_child.translation),
            rotation: quaternion_of(parent_from_child),
        },
    }
}

/// parent_from_child of a transform, m; `None` where its numbers are no pose.
#[must_use]
pub fn pose_of_transform(transform: &Transform) -> Option<Se3> {
    let Vector3 { x, y, z } = transform.translation;
    let rotation = &transform.rotation;
    let quaternion = Quaternion4::new(rotation.w, rotation.x, rotation.y, rotation.z);
    let norm = quaternion.norm();
    let pose = Se3::new(Rotation::new_normalize(quaternion), Vec3::new(x, y, z));
    (norm > 0.5 && norm < 2.0 && pose.is_finite()).then_some(pose)
}

/// Poses in the frame of the header, m, with their times.
#[must_use]
pub fn path_of(header: Header, poses: impl IntoIterator<Item = (Time, Se3)>) -> Path {
    let stamped = |(stamp, pose): (Time, Se3)| PoseStamped {
        header: Header {
            stamp,
            frame_id: header.frame_id.clone(),
        },
        pose: pose_of(&pose),
    };
    Path {
        poses: poses.into_iter().map(stamped).collect(),
        header,
    }
}

/// Where odometry stands, and how fast it moved over the last `seconds`, in the child's frame;
/// `step` is last_from_this of the child. The velocity of a first pose is not known: it is 0 with a
/// large variance. Filters that fuse odometry are told its standard deviations.
#[must_use]
pub fn odometry_of(
    header: Header,
    child: &str,
    odom_from_base: &Se3,
    step: Option<(Se3, f64)>,
    deviations: &OdometryDeviations,
) -> Odometry {
    let step = step.filter(|(_, seconds)| *seconds > 0.0);
    let twist = step.map_or_else(Twist::default, |(last_from_this, seconds)| {
        let moved = last_from_this.rotation.inverse() * last_from_this.translation / seconds;
        let turned = rotation_log(&last_from_this.rotation) / seconds;
        Twist {
            linear: vector_of(&moved),
            angular: vector_of(&turned),
        }
    });
    let velocity = step.map_or([UNKNOWN_DEVIATION; 2], |_| deviations.velocity);
    Odometry {
        header,
        child_frame_id: child.to_owned(),
        pose: PoseWithCovariance {
            pose: pose_of(odom_from_base),
            covariance: diagonal(deviations.pose),
        },
        twist: TwistWithCovariance {
            twist,
            covariance: diagonal(velocity),
        },
    }
}

/// Standard deviations of odometry: along all axes and around them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryDeviations {
    /// Of the pose, m and rad.
    pub pose: [f64; 2],
    /// Of the velocity, m/s and rad/s.
    pub velocity: [f64; 2],
}

/// Nothing is known.
pub const UNKNOWN_DEVIATION: f64 = 1e3;

/// Covariance of what has one standard deviation along all axes and one around them.
fn diagonal([along, around]: [f64; 2]) -> Covariance {
    let mut covariance = Covariance::default();
    for axis in 0..3 {
        covariance[axis][axis] = along * along;
        covariance[axis + 3][axis + 3] = around * around;
    }
    covariance
}

fn vector_of(v: &Vec3) -> Vector3 {
    let [x, y, z] = (*v).into();
    Vector3 { x, y, z }
}

fn quaternion_of(pose: &Se3) -> Quaternion {
    let [x, y, z, w] = pose.rotation.coords.into();
    Quaternion { x, y, z, w }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::rotation_exp;
    use std::f64::consts::FRAC_PI_2;

    const DEVIATIONS: OdometryDeviations = OdometryDeviations {
        pose: [0.2, 0.05],
        velocity: [0.1, 0.3],
    };

    #[test]
    fn a_transform_comes_back_and_what_is_none_does_not() {
        let pose = Se3::new(
            rotation_exp(&Vec3::new(0.1, -0.2, 0.3)),
            Vec3::new(1.0, 2.0, 3.0),
        );
        let mut transform = transform_of(Header::default(), "camera", &pose).transform;
        let back = pose_of_transform(&transform).unwrap();
        assert!((back.translation - pose.translation).norm() < 1e-12);
        assert!(back.rotation.angle_to(&pose.rotation) < 1e-12);
        transform.translation.x = f64::NAN;
        assert!(pose_of_transform(&transform).is_none());
        assert!(
            pose_of_transform(&Transform {
                rotation: Quaternion {
                    x: 0.0,
                    y: 0.0,
                    z: 0.0,
                    w: 0.0
                },
                ..Transform::default()
            })
            .is_none()
        );
    }

    #[test]
    fn a_quarter_turn_around_z() {
        let turned = Se3::new(
            rotation_exp(&Vec3::new(0.0, 0.0, FRAC_PI_2)),
            Vec3::new(1.0, 2.0, 3.0),
        );
        let half = 0.5_f64.sqrt();
        let pose = pose_of(&turned);
        assert_eq!(
            (pose.position.x, pose.position.y, pose.position.z),
            (1.0, 2.0, 3.0)
        );
        let transform = transform_of(Header::default(), "child", &turned);
        assert_eq!(transform.child_frame_id, "child");
        for q in [pose.orientation, transform.transform.rotation] {
            let wrong = [q.x, q.y, q.z - half, q.w - half];
            assert!(wrong.iter().all(|v| v.abs() < 1e-12), "{q:?}");
        }
        assert_eq!(transform.transform.translation.y, 2.0);
    }

    #[test]
    fn velocities_are_in_the_frame_of_the_child() {
        // it turned by 0.2 rad in 0.1 s and moved by 1 m along its x as it is now
        let turn = rotation_exp(&Vec3::new(0.0, 0.0, 0.2));
        let step = Se3::new(turn, turn * Vec3::new(1.0, 0.0, 0.0));
        let here = Se3::new(Rotation::identity(), Vec3::zeros());
        let odometry = odometry_of(
            Header::default(),
            "base",
            &here,
            Some((step, 0.1)),
            &DEVIATIONS,
        );
        let twist = odometry.twist.twist;
        assert!((twist.linear.x - 10.0).abs() < 1e-9 && twist.linear.y.abs() < 1e-9);
        assert!((twist.angular.z - 2.0).abs() < 1e-9);
        assert_eq!(odometry.twist.covariance[0][0], 0.1 * 0.1);
        assert_eq!(odometry.pose.covariance[5][5], 0.05 * 0.05);
        assert_eq!(odometry.pose.covariance[0][1], 0.0);
    }

    #[test]
    fn without_a_step_the_velocity_is_not_known() {
        let here = Se3::identity();
        for step in [None, Some((here, 0.0))] {
            let odometry = odometry_of(Header::default(), "base", &here, step, &DEVIATIONS);
            assert_eq!(odometry.twist.twist, Twist::default());
            assert_eq!(odometry.twist.covariance[0][0], 1e6);
        }
    }
}
