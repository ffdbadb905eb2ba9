//! A running system: images in, poses and a growing map out.

use crate::arrays::{contiguous, matrices, matrix, similarity, vector};
use crate::errors::{of_pipeline, value};
use crate::inertial::{Imu, nanoseconds, readings};
use crate::map::OccupancyMap;
use monogrid::geometry::Sim3;
use monogrid::pipeline::Unusable;
use monogrid::slam::mapping::Maps;
use monogrid::slam::{Scale, SensedFrame};
use monogrid::{
    Calibration, Distortion, Finished, FrameReport, GrayImage, Pinhole, Pipeline, PipelineError,
    Settings,
};
use numpy::{
    IntoPyArray, Ix2, Ix3, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// A camera: size of its images, pinhole, lens.
#[pyclass(module = "monogrid", frozen)]
#[derive(Clone)]
pub struct Camera {
    camera: monogrid::Camera,
    readout_ms: f64,
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (width, height, fx, fy, cx, cy, distortion = None, *, model = "radial-tangential", rolling_shutter_ms = 0.0))]
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
        let distortion = match (model, distortion.as_deref()) {
            (_, None | Some([])) => Distortion::None,
            ("radial-tangential", Some([k1, k2, p1, p2, rest @ ..])) if rest.len() <= 1 => {
                let k3 = rest.first().copied().unwrap_or(0.0);
                Distortion::RadialTangential {
                    k1: *k1,
                    k2: *k2,
                    p1: *p1,
                    p2: *p2,
                    k3,
                }
            }
            ("equidistant", Some([a, b, c, d])) => Distortion::Equidistant {
                k: [*a, *b, *c, *d],
            },
            ("fov", Some([omega])) => Distortion::Fov { omega: *omega },
            (model, Some(numbers)) => {
                return Err(value(format!(
                    "model {model:?} with {} numbers, expected \"radial-tangential\" with k1, k2, p1, p2 and perhaps k3, \
                     \"equidistant\" with four, or \"fov\" with one",
                    numbers.len()
                )));
            }
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
        let readout_ms = calibration.readout_ms.unwrap_or(0.0);
        Ok(Self {
            camera: calibration.camera,
            readout_ms,
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

    #[getter]
    fn rolling_shutter_ms(&self) -> f64 {
        self.readout_ms
    }

    fn __repr__(&self) -> String {
        format!("<monogrid.{:?}>", self.camera)
    }
}

/// What became of an image.
#[pyclass(module = "monogrid", frozen)]
pub struct Frame {
    report: Result<FrameReport, Unusable>,
}

#[pymethods]
impl Frame {
    #[getter]
    fn index(&self) -> Option<usize> {
        self.report.as_ref().ok().map(|report| report.index)
    }

    #[getter]
    fn state(&self) -> &'static str {
        self.report
            .as_ref()
            .map_or("unused", |report| report.state.name())
    }

    #[getter]
    fn reason(&self) -> Option<String> {
        match &self.report {
            Ok(report) => report.reason.map(|reason| reason.to_string()),
            Err(unusable) => Some(unusable.to_string()),
        }
    }

    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let pose = self
            .report
            .as_ref()
            .ok()
            .and_then(|report| report.world_from_camera);
        pose.map(|pose| matrix(&pose).to_vec().into_pyarray(py).reshape([4, 4]))
            .transpose()
    }

    #[getter]
    fn is_keyframe(&self) -> bool {
        self.report
            .as_ref()
            .is_ok_and(|report| report.created_keyframe)
    }

    fn __repr__(&self) -> String {
        match self.reason() {
            None => format!("<monogrid.Frame: {}>", self.state()),
            Some(reason) => format!("<monogrid.Frame: {}, {reason}>", self.state()),
        }
    }
}

/// What a system has found in the end.
#[pyclass(module = "monogrid", frozen)]
pub struct SlamResult {
    map: Option<Arc<monogrid::OccupancyMap>>,
    times_ns: Vec<i64>,
    poses: Vec<[f64; 16]>,
    num_keyframes: usize,
    map_from_world: [f64; 16],
    is_metric: bool,
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

/// What a pipeline has found, its maps, their frame, and what an inertial sensor says of it.
type Ended = (Finished, Option<Maps>, Sim3, Option<SensedFrame>);

/// Ends a pipeline.
fn all_of(pipeline: Pipeline) -> Result<Ended, PipelineError> {
    let mut finished = pipeline.finish()?;
    let sensed = finished.sensed();
    let settings_frame = *finished.map_from_world();
    let frame = sensed.map_or(settings_frame, |sensed| sensed.map_from_world);
    let maps = finished.maps_around_camera(&frame)?;
    Ok((finished, maps, frame, sensed))
}

fn finished() -> PyErr {
    PyRuntimeError::new_err("this Slam is finished: make another one for more images")
}

#[pymethods]
impl Slam {
    #[new]
    #[pyo3(signature = (camera, *, imu = None, mask = None, config = None, settings = Vec::new(), threads = None))]
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
        let chosen = monogrid::program::settings(config.as_deref(), &settings).map_err(value)?;
        let settings = Settings {
            mask,
            readout_ms: camera.readout_ms,
            imu: imu.as_ref().map(|imu| imu.without_readings()),
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
        let image = grey(image, self.size)?;
        let time_ns = nanoseconds(seconds, "the image")?;
        let report = self.with(image.1, |pipeline| pipeline.push(image.0, time_ns))?;
        Ok(Frame { report })
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
        Ok(report.map(|report| Frame { report }))
    }

    fn map(&self, py: Python) -> PyResult<Option<OccupancyMap>> {
        let map = self
            .with(py, |pipeline| pipeline.map())?
            .map_err(of_pipeline)?;
        Ok(map.map(OccupancyMap::of))
    }

    fn finish(&self, py: Python) -> PyResult<SlamResult> {
        let ended = py.detach(|| {
            let mut pipeline = self.pipeline.lock().unwrap_or_else(PoisonError::into_inner);
            Some(all_of(pipeline.take()?))
        });
        let (done, maps, frame, sensed) = ended.ok_or_else(finished)?.map_err(of_pipeline)?;
        let told = done.slam.scale() == Scale::Metric;
        Ok(SlamResult {
            map: maps.map(|maps| Arc::new(maps.global)),
            times_ns: done
                .trajectory
                .iter()
                .map(|pose| pose.timestamp_ns)
                .collect(),
            poses: done
                .trajectory
                .iter()
                .map(|pose| matrix(&pose.world_from_camera))
                .collect(),
            num_keyframes: done.slam.num_keyframes(),
            map_from_world: similarity(&frame),
            is_metric: told || sensed.is_some_and(|sensed| sensed.is_metric),
            is_level: sensed.is_some_and(|sensed| sensed.is_level),
        })
    }
}

#[pymethods]
impl SlamResult {
    #[getter]
    fn map(&self) -> Option<OccupancyMap> {
        self.map.clone().map(OccupancyMap::of)
    }

    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        vector(
            py,
            self.times_ns
                .iter()
                .map(|time_ns| *time_ns as f64 / 1e9)
                .collect(),
        )
    }

    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        matrices(py, self.poses.clone())
    }

    #[getter]
    fn map_from_world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let matrix = self.map_from_world.to_vec();
        matrix.into_pyarray(py).reshape([4, 4])
    }

    #[getter]
    fn is_metric(&self) -> bool {
        self.is_metric
    }

    #[getter]
    fn is_level(&self) -> bool {
        self.is_level
    }

    #[getter]
    fn num_keyframes(&self) -> usize {
        self.num_keyframes
    }
}

/// An image of bytes, grey or red, green and blue.
fn grey<'py>(
    image: &Bound<'py, PyAny>,
    (width, height): (usize, usize),
) -> PyResult<(GrayImage, Python<'py>)> {
    let py = image.py();
    let found = || {
        let say = |name| {
            image
                .getattr(name)
                .map(|v| v.to_string())
                .unwrap_or_default()
        };
        value(format!(
            "found an image of shape {} and type {}, expected uint8 of shape ({height}, {width}) or ({height}, {width}, 3)",
            say("shape"),
            say("dtype")
        ))
    };
    if image
        .getattr("dtype")
        .is_ok_and(|dtype| dtype.to_string() != "uint8")
    {
        return Err(found());
    }
    let dimensions: usize = image.getattr("ndim").map_err(|_| found())?.extract()?;
    let made = match dimensions {
        2 => {
            let array = contiguous::<u8, Ix2>(image, "(height, width)")?;
            let fits = array.shape() == [height, width];
            fits.then(|| {
                array
                    .as_slice()
                    .ok()
                    .and_then(|v| GrayImage::from_gray8(width, height, v))
            })
        }
        3 => {
            let array = contiguous::<u8, Ix3>(image, "(height, width, 3)")?;
            let fits = array.shape() == [height, width, 3];
            fits.then(|| {
                array
                    .as_slice()
                    .ok()
                    .and_then(|v| GrayImage::from_rgb8(width, height, v))
            })
        }
        _ => None,
    };
    let made = made.flatten().ok_or_else(found)?;
    Ok((made, py))
}

/// A mask: not zero where pixels may be used.
fn mask_of(mask: &Bound<PyAny>) -> PyResult<monogrid::Mask> {
    let array = contiguous::<u8, Ix2>(mask, "(height, width)")?;
    let (height, width) = (array.shape()[0], array.shape()[1]);
    let pixels = array
        .as_slice()?
        .iter()
        .map(|v| if *v == 0 { 0 } else { 255 });
    monogrid::Mask::from_vec(width, height, pixels.collect()).ok_or_else(|| value("an empty mask"))
}
