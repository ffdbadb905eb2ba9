//! A running system: images in, poses and a growing map out.

use crate::arrays::{contiguous, matrices, matrix, similarity, square};
use crate::errors::{of_pipeline, value};
use crate::inertial::{Imu, nanoseconds, readings};
use crate::map::OccupancyMap;
use monogrid::pipeline::Unusable;
use monogrid::slam::Scale;
use monogrid::{
    Calibration, Distortion, FrameReport, GrayImage, Pinhole, Pipeline, PipelineError, Settings,
};
use numpy::{IntoPyArray, Ix2, IxDyn, PyArray1, PyArray2, PyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// A camera: size of its images, pinhole, lens.
#[pyclass(module = "monogrid", frozen)]
#[derive(Clone)]
pub struct Camera {
    camera: monogrid::Camera,
    #[pyo3(get, name = "rolling_shutter_ms")]
    readout_ms: f64,
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (
        width, height, fx, fy, cx, cy, distortion = None, *, model = "radial-tangential",
        rolling_shutter_ms = 0.0
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        width: usize,
        height: usize,
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        distortion: Option<Vec<f64>>,
        model: &str,
        rolling_shutter_ms: f64,
    ) -> PyResult<Self> {
        let distortion = match distortion.as_deref() {
            None | Some([]) => Distortion::None,
            Some(coefficients) => Distortion::from_name(model, coefficients).map_err(value)?,
        };
        let pinhole = Pinhole::new(fx, fy, cx, cy);
        let camera = monogrid::Camera {
            width,
            height,
            pinhole,
            distortion,
        };
        camera.validate().map_err(value)?;
        Ok(Self {
            camera,
            readout_ms: rolling_shutter_ms,
        })
    }

    #[staticmethod]
    #[pyo3(signature = (path, size = None))]
    fn read(path: PathBuf, size: Option<(usize, usize)>) -> PyResult<Self> {
        let calibration = Calibration::read(&path, size).map_err(value)?;
        Ok(Self {
            camera: calibration.camera,
            readout_ms: calibration.readout_ms.unwrap_or(0.0),
        })
    }

    #[getter]
    fn size(&self) -> (usize, usize) {
        (self.camera.width, self.camera.height)
    }

    #[getter]
    fn pinhole(&self) -> (f64, f64, f64, f64) {
        let Pinhole { fx, fy, cx, cy } = self.camera.pinhole;
        (fx, fy, cx, cy)
    }

    fn __repr__(&self) -> String {
        format!("<monogrid.{:?}>", self.camera)
    }
}

/// What became of an image.
#[pyclass(module = "monogrid", frozen)]
pub struct Frame {
    #[pyo3(get)]
    index: Option<usize>,
    #[pyo3(get)]
    state: &'static str,
    #[pyo3(get)]
    reason: Option<String>,
    #[pyo3(get)]
    is_keyframe: bool,
    pose: Option<[f64; 16]>,
}

impl Frame {
    fn of(report: Result<FrameReport, Unusable>) -> Self {
        match report {
            Ok(report) => Self {
                index: Some(report.index),
                state: report.state.name(),
                reason: report.reason.map(|reason| reason.to_string()),
                is_keyframe: report.created_keyframe,
                pose: report.world_from_camera.as_ref().map(matrix),
            },
            Err(unusable) => Self {
                index: None,
                state: "unused",
                reason: Some(unusable.to_string()),
                is_keyframe: false,
                pose: None,
            },
        }
    }
}

#[pymethods]
impl Frame {
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.pose.map(|pose| square(py, &pose)).transpose()
    }

    fn __repr__(&self) -> String {
        match &self.reason {
            None => format!("<monogrid.Frame: {}>", self.state),
            Some(reason) => format!("<monogrid.Frame: {}, {reason}>", self.state),
        }
    }
}

/// What a system has found in the end.
#[pyclass(module = "monogrid", frozen)]
pub struct SlamResult {
    #[pyo3(get)]
    map: Option<OccupancyMap>,
    /// s.
    times: Vec<f64>,
    poses: Vec<[f64; 16]>,
    #[pyo3(get)]
    num_keyframes: usize,
    map_from_world: [f64; 16],
    #[pyo3(get)]
    is_metric: bool,
    #[pyo3(get)]
    is_level: bool,
}

/// Images in, poses and a growing map out.
#[pyclass(module = "monogrid", frozen)]
pub struct Slam {
    /// None when it is finished.
    pipeline: Mutex<Option<Pipeline>>,
    has_imu: bool,
    size: (usize, usize),
}

impl Slam {
    /// Does something with the running pipeline, without Python's lock.
    fn with<T: Send>(
        &self,
        py: Python,
        act: impl FnOnce(&mut Pipeline) -> T + Send,
    ) -> PyResult<T> {
        let done = py.detach(|| {
            let mut pipeline = self.pipeline.lock().unwrap_or_else(PoisonError::into_inner);
            pipeline.as_mut().map(act)
        });
        done.ok_or_else(finished)
    }
}

/// Ends a pipeline.
fn result_of(pipeline: Pipeline) -> Result<SlamResult, PipelineError> {
    let mut finished = pipeline.finish()?;
    let sensed = finished.sensed();
    let settings_frame = *finished.map_from_world();
    let frame = sensed.map_or(settings_frame, |sensed| sensed.map_from_world);
    let maps = finished.maps_around_camera(&frame)?;
    let told = finished.slam.scale() == Scale::Metric;
    let trajectory = finished.trajectory.iter();
    Ok(SlamResult {
        map: maps.map(|maps| OccupancyMap::of(Arc::new(maps.global))),
        times: trajectory
            .clone()
            .map(|pose| pose.timestamp_ns as f64 / 1e9)
            .collect(),
        poses: trajectory
            .map(|pose| matrix(&pose.world_from_camera))
            .collect(),
        num_keyframes: finished.slam.num_keyframes(),
        map_from_world: similarity(&frame),
        is_metric: told || sensed.is_some_and(|sensed| sensed.is_metric),
        is_level: sensed.is_some_and(|sensed| sensed.is_level),
    })
}

fn finished() -> PyErr {
    PyRuntimeError::new_err("this Slam is finished: make another one for more images")
}

#[pymethods]
impl Slam {
    #[new]
    #[pyo3(signature = (
        camera, *, imu = None, mask = None, config = None, settings = Vec::new(), threads = None
    ))]
    fn new(
        py: Python,
        camera: PyRef<Camera>,
        imu: Option<PyRef<Imu>>,
        mask: Option<&Bound<PyAny>>,
        config: Option<PathBuf>,
        settings: Vec<String>,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let mask = mask.map(mask_of).transpose()?;
        let chosen =
            monogrid_cli::program::settings(config.as_deref(), &settings).map_err(value)?;
        let settings = Settings {
            mask,
            readout_ms: camera.readout_ms,
            imu: imu.as_ref().map(|imu| Arc::clone(&imu.imu)),
            threads: threads.unwrap_or_else(crate::map::all_threads),
            ..chosen
        };
        let camera = camera.camera;
        let pipeline = py.detach(|| Pipeline::new(&camera, settings));
        Ok(Self {
            pipeline: Mutex::new(Some(pipeline.map_err(of_pipeline)?)),
            has_imu: imu.is_some(),
            size: (camera.width, camera.height),
        })
    }

    fn push(&self, image: &Bound<PyAny>, seconds: f64) -> PyResult<Frame> {
        let (py, image) = (image.py(), grey(image, self.size)?);
        let time_ns = nanoseconds(seconds, "the image")?;
        let report = self.with(py, |pipeline| pipeline.push(image, time_ns))?;
        Ok(Frame::of(report))
    }

    fn push_imu(
        &self,
        seconds: &Bound<PyAny>,
        gyroscope: &Bound<PyAny>,
        accelerometer: &Bound<PyAny>,
    ) -> PyResult<Option<Frame>> {
        if !self.has_imu {
            return Err(value(
                "this Slam knows no inertial sensor: Slam(camera, imu=Imu(imu_from_camera))",
            ));
        }
        let readings = readings(seconds, gyroscope, accelerometer)?;
        let report = self.with(seconds.py(), |pipeline| pipeline.push_readings(&readings))?;
        Ok(report.map(Frame::of))
    }

    fn map(&self, py: Python) -> PyResult<Option<OccupancyMap>> {
        let map = self.with(py, |pipeline| pipeline.map())?;
        Ok(map.map_err(of_pipeline)?.map(OccupancyMap::of))
    }

    fn finish(&self, py: Python) -> PyResult<SlamResult> {
        let ended = py.detach(|| {
            let mut pipeline = self.pipeline.lock().unwrap_or_else(PoisonError::into_inner);
            pipeline.take().map(result_of)
        });
        ended.ok_or_else(finished)?.map_err(of_pipeline)
    }
}

#[pymethods]
impl SlamResult {
    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.times.clone().into_pyarray(py)
    }

    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        matrices(py, self.poses.clone())
    }

    #[getter]
    fn map_from_world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        square(py, &self.map_from_world)
    }
}

/// An image of bytes, grey or red, green and blue.
fn grey(image: &Bound<PyAny>, (width, height): (usize, usize)) -> PyResult<GrayImage> {
    let found = || {
        let say = |name| {
            image
                .getattr(name)
                .map_or_else(|_| String::new(), |v| v.to_string())
        };
        value(format!(
            "found an image of shape {} and type {}, expected uint8 of shape ({height}, {width}) \
             or ({height}, {width}, 3)",
            say("shape"),
            say("dtype")
        ))
    };
    let dtype = image.getattr("dtype");
    if dtype.is_ok_and(|dtype| dtype.to_string() != "uint8") || !image.hasattr("ndim")? {
        return Err(found());
    }
    let array = contiguous::<u8, IxDyn>(image, "an image")?;
    let values = array.as_slice()?;
    let made = match *array.shape() {
        [h, w] if (w, h) == (width, height) => GrayImage::from_gray8(width, height, values),
        [h, w, 3] if (w, h) == (width, height) => GrayImage::from_rgb8(width, height, values),
        _ => None,
    };
    made.ok_or_else(found)
}

/// A mask: not zero where pixels may be used.
fn mask_of(mask: &Bound<PyAny>) -> PyResult<monogrid::Mask> {
    let array = contiguous::<u8, Ix2>(mask, "(height, width)")?;
    let (height, width) = (array.shape()[0], array.shape()[1]);
    let values = array.as_slice()?.iter();
    let pixels = values.map(|v| if *v == 0 { 0 } else { 255 });
    monogrid::Mask::from_vec(width, height, pixels.collect()).ok_or_else(|| value("an empty mask"))
}
