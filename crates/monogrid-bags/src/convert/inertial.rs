//! Readings of an inertial sensor.

use monogrid_geometry::Vec3;
use monogrid_inertial::ImuSample;
use monogrid_messages::sensor_msgs::Imu;

/// A reading; `None` where the message says that the sensor has no gyroscope or no accelerometer.
#[must_use]
pub fn imu_sample_of(message: &Imu) -> Option<ImuSample> {
    let [rate, force] = [&message.angular_velocity, &message.linear_acceleration];
    let has_both = message.angular_velocity_covariance[0] != -1.0
        && message.linear_acceleration_covariance[0] != -1.0;
    has_both.then(|| ImuSample {
        timestamp_ns: message.header.stamp.nanoseconds(),
        angular_velocity: Vec3::new(rate.x, rate.y, rate.z),
        specific_force: Vec3::new(force.x, force.y, force.z),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_messages::builtin_interfaces::Time;
    use monogrid_messages::geometry_msgs::Vector3;

    #[test]
    fn a_sensor_without_one_of_the_two_has_no_reading() {
        let mut message = Imu::default();
        message.header.stamp = Time { sec: 2, nanosec: 5 };
        message.angular_velocity = Vector3 {
            x: 0.1,
            y: 0.2,
            z: 0.3,
        };
        message.linear_acceleration.z = 9.8;
        let reading = imu_sample_of(&message).unwrap();
        assert_eq!(reading.timestamp_ns, 2_000_000_005);
        assert_eq!(reading.angular_velocity, Vec3::new(0.1, 0.2, 0.3));
        assert_eq!(reading.specific_force, Vec3::new(0.0, 0.0, 9.8));
        // only the orientation is said to be missing
        message.orientation_covariance[0] = -1.0;
        assert!(imu_sample_of(&message).is_some());
        message.angular_velocity_covariance[0] = -1.0;
        assert_eq!(imu_sample_of(&message), None);
        message.angular_velocity_covariance[0] = 0.0;
        message.linear_acceleration_covariance[0] = -1.0;
        assert_eq!(imu_sample_of(&message), None);
    }
}
