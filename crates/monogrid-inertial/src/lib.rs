//! Inertial measurements beside the images of a camera.
//!
//! [`Imu`] holds what a gyroscope and an accelerometer measured, [`Preintegrated`] what that says
//! about the motion between two times (`[FORSTER17]`), and [`estimate`] what it says about a path
//! that a single camera found: its scale, where gravity pulls, the biases of the sensor, and where
//! the camera was while it saw nothing.
//!
//! The frame of the sensor is called `imu`; `imu_from_camera` is fixed. Specific force is what an
//! accelerometer measures: a sensor at rest measures 9.81 m/s² upwards. Lengths are metres unless
//! said otherwise.
#![deny(missing_docs)]

mod estimate;
mod preintegration;
mod sample;

pub use estimate::{
    Estimate, EstimateConfig, Fix, NotDetermined, Observation, PartPlace, estimate,
};
pub use preintegration::{Bias, Preintegrated};
pub use sample::{Imu, ImuNoise, ImuSample, Step};

/// Standard gravity, m/s²; the real one differs from it by at most 0.3 %.
pub const GRAVITY_M_S2: f64 = 9.806_65;
