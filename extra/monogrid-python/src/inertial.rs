//! An inertial sensor beside the camera.

use crate::arrays::{contiguous, matrix, pose_of, rigid, rows, square};
use crate::errors::value;
use monogrid::geometry::Vec3;
use monogrid::inertial::{ImuNoise, ImuSample};
use numpy::{Ix1, Ix2, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// An inertial sensor beside the camera: how it is mounted, and its noise as densities (rad/s/√Hz,
/// m/s²/√Hz, rad/s²/√Hz, m/s³/√Hz; by default those of a phone).
///
/// imu_from_camera: shape (4, 4), metres; without it the axes of the sensor are taken to be the
/// camera's (x right, y down, z ahead).
#[pyclass(module = "monogrid", frozen)]
pub struct Imu {
    /// Without readings.
    pub imu: Arc<monogrid::inertial::Imu>,
}

#[pymethods]
impl Imu {
    #[new]
    #[pyo3(signature = (
        imu_from_camera = None, *, gyroscope_noise = None, accelerometer_noise = None,
        gyroscope_walk = None, accelerometer_walk = None
    ))]
    fn new(
        imu_from_camera: Option<&Bound<PyAny>>,
        gyroscope_noise: Option<f64>,
        accelerometer_noise: Option<f64>,
        gyroscope_walk: Option<f64>,
        accelerometer_walk: Option<f64>,
    ) -> PyResult<Self> {
        let phone = ImuNoise::default();
        let density = |given: Option<f64>, usual: f64| match given {
            None => Ok(usual),
            Some(density) if density.is_finite() && density > 0.0 => Ok(density),
            Some(density) => Err(value(format!(
                "a density of noise is {density}, expected a number above 0"
            ))),
        };
        let noise = ImuNoise {
            gyroscope: density(gyroscope_noise, phone.gyroscope)?,
            accelerometer: density(accelerometer_noise, phone.accelerometer)?,
            gyroscope_walk: density(gyroscope_walk, phone.gyroscope_walk)?,
            accelerometer_walk: density(accelerometer_walk, phone.accelerometer_walk)?,
        };
        let mount = rigid(&pose_of(imu_from_camera)?)?;
        let imu = monogrid::inertial::Imu::new(Vec::new(), noise, mount);
        Ok(Self { imu: Arc::new(imu) })
    }

    /// For pickle and copy.
    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Arguments<'py>, Bound<'py, PyDict>)> {
        let (mount, noise) = (matrix(&self.imu.imu_from_camera), self.imu.noise);
        let keywords = PyDict::new(py);
        for (name, density) in [
            ("gyroscope_noise", noise.gyroscope),
            ("accelerometer_noise", noise.accelerometer),
            ("gyroscope_walk", noise.gyroscope_walk),
            ("accelerometer_walk", noise.accelerometer_walk),
        ] {
            keywords.set_item(name, density)?;
        }
        Ok(((square(py, &mount)?,), keywords))
    }

    fn __repr__(&self) -> String {
        format!("<monogrid.Imu: {:?}>", self.imu.noise)
    }
}

/// The arguments that are given by place: `imu_from_camera`.
type Arguments<'py> = (Bound<'py, PyArray2<f64>>,);

/// Readings of arrays: n times in seconds, and n rows of each sensor; or one time and one row each.
pub fn readings(
    seconds: &Bound<PyAny>,
    gyroscope: &Bound<PyAny>,
    accelerometer: &Bound<PyAny>,
) -> PyResult<Vec<ImuSample>> {
    let py = seconds.py();
    let numpy = py.import("numpy")?;
    let times = numpy.call_method1("atleast_1d", (seconds,))?;
    let times = contiguous::<f64, Ix1>(&times, "(n,)")?;
    let times = times.as_slice()?;
    let [rates, forces] = [gyroscope, accelerometer].map(|readings| {
        let readings = numpy.call_method1("atleast_2d", (readings,))?;
        contiguous::<f64, Ix2>(&readings, "(n, 3)")
    });
    let (rates, forces) = (rates?, forces?);
    let (rates, forces) = (rows(&rates, "gyroscope")?, rows(&forces, "accelerometer")?);
    if rates.len() != times.len() || forces.len() != times.len() {
        return Err(value(format!(
            "found {} times, {} readings of the gyroscope and {} of the accelerometer, expected as \
             many of each",
            times.len(),
            rates.len(),
            forces.len()
        )));
    }
    let sample = |((seconds, rate), force): ((&f64, &[f64; 3]), &[f64; 3])| {
        Ok(ImuSample {
            timestamp_ns: nanoseconds(*seconds, "a reading")?,
            angular_velocity: Vec3::from(*rate),
            specific_force: Vec3::from(*force),
        })
    };
    times.iter().zip(rates).zip(forces).map(sample).collect()
}

/// A time of something in nanoseconds.
pub fn nanoseconds(seconds: f64, of_what: &str) -> PyResult<i64> {
    let time_ns = (seconds * 1e9).round();
    if !time_ns.is_finite() || time_ns.abs() >= i64::MAX as f64 {
        return Err(value(format!(
            "the time of {of_what} is {seconds} s, expected a finite number"
        )));
    }
    Ok(time_ns as i64)
}
