//! A running system: images in, poses and a growing map out.

use crate::arrays::{contiguous, matrices, matrix, pose_of, similarity, square};
use crate::errors::{of_pipeline, value};
use crate::inertial::{Imu, nanoseconds, readings};
use crate::interrupt::wait_for;
use crate::map::OccupancyMap;
use monogrid::pipeline::Unusable;
use monogrid::slam::Scale;
use monogrid::{
    Calibration, Distortion, FrameReport, GrayImage, Pinhole, Pipeline, PipelineError, Settings,
};
use numpy::{IntoPyArray, Ix2, IxDyn, PyArray1, PyArray2, PyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Size of the images, pinhole and lens. The centre of the top-left pixel is (0, 0).
///
/// `model`: "radial-tangential" (k1, k2, p1, p2, k3 as OpenCV), "rational" (eight numbers in the
/// order of OpenCV), "equidistant" (four), "fov" (one), "double-sphere" (xi, alpha),
/// "extended-unified" (alpha, beta) or "omnidirectional" (xi, k1, k2, p1, p2).
#[pyclass(module = "monogrid", frozen)]
#[derive(Clone)]
pub struct Camera {
    camera: monogrid::Camera,
    /// Time from the first row of an image to the last, ms.
    #[pyo3(get, name = "rolling_shutter_ms")]
    readout_ms: f64,
}

/// What a camera is made of, without keywords.
type CameraArgs = (usize, usize, f64, f64, f64, f64, Vec<f64>);

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

    /// Reads any calibration file that the program understands; `size` where the file does not say
    /// it.
    #[staticmethod]
    #[pyo3(signature = (path, size = None))]
    fn read(path: PathBuf, size: Option<(usize, usize)>) -> PyResult<Self> {
        let calibration = Calibration::read(&path, size).map_err(value)?;
        Ok(Self {
            camera: calibration.camera,
            readout_ms: calibration.readout_ms.unwrap_or(0.0),
        })
    }

    /// Width and height of the images, px.
    #[getter]
    fn size(&self) -> (usize, usize) {
        (self.camera.width, self.camera.height)
    }

    /// fx, fy, cx and cy, px.
    #[getter]
    fn pinhole(&self) -> (f64, f64, f64, f64) {
        let Pinhole { fx, fy, cx, cy } = self.camera.pinhole;
        (fx, fy, cx, cy)
    }

    /// For pickle and copy.
    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(CameraArgs, Bound<'py, PyDict>)> {
        let ((width, height), (fx, fy, cx, cy)) = (self.size(), self.pinhole());
        let lens = self.camera.distortion;
        let coefficients = lens.parameters().iter().map(|(_, value)| *value).collect();
        let keywords = PyDict::new(py);
        keywords.set_item("model", lens.name())?;
        keywords.set_item("rolling_shutter_ms", self.readout_ms)?;
        Ok(((width, height, fx, fy, cx, cy, coefficients), keywords))
    }

    fn __repr__(&self) -> String {
        let ((width, height), (fx, fy, cx, cy)) = (self.size(), self.pinhole());
        let lens = self.camera.distortion.name();
        format!("<monogrid.Camera: {width}x{height}, {fx} {fy} {cx} {cy}, {lens}>")
    }
}

/// What became of an image.
#[pyclass(module = "monogrid", frozen)]
pub struct Frame {
    /// Which image it is, from 0 on; None where it was not used.
    #[pyo3(get)]
    index: Option<usize>,
    /// "initialising", "good", "degraded", "fragment", "lost", or "unused".
    #[pyo3(get)]
    state: String,
    /// Why it is not good.
    #[pyo3(get)]
    reason: Option<String>,
    /// Whether it became a keyframe.
    #[pyo3(get)]
    is_keyframe: bool,
    pose: Option<[f64; 16]>,
}

impl Frame {
    fn of(report: Result<FrameReport, Unusable>) -> Self {
        match report {
            Ok(report) => Self {
                index: Some(report.index),
                state: report.state.name().to_owned(),
                reason: report.reason.map(|reason| reason.to_string()),
                is_keyframe: report.created_keyframe,
                pose: report.world_from_camera.as_ref().map(matrix),
            },
            Err(unusable) => Self {
                index: None,
                state: "unused".to_owned(),
                reason: Some(unusable.to_string()),
                is_keyframe: false,
                pose: None,
            },
        }
    }
}

#[pymethods]
impl Frame {
    #[new]
    #[pyo3(signature = (index, state, reason = None, is_keyframe = false, pose = None))]
    fn new(
        index: Option<usize>,
        state: String,
        reason: Option<String>,
        is_keyframe: bool,
        pose: Option<&Bound<PyAny>>,
    ) -> PyResult<Self> {
        let pose = pose.map(|pose| pose_of(Some(pose))).transpose()?;
        Ok(Self {
            index,
            state,
            reason,
            is_keyframe,
            pose: pose.map(|rows| *rows.as_flattened().first_chunk().unwrap_or(&[0.0; 16])),
        })
    }

    /// For pickle and copy.
    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<FrameArgs<'py>> {
        let (state, reason) = (self.state.clone(), self.reason.clone());
        Ok((self.index, state, reason, self.is_keyframe, self.pose(py)?))
    }

    /// `world_from_camera`, shape (4, 4), as known now; the world is the first keyframe's camera.
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

/// What a frame is made of.
type FrameArgs<'py> = (
    Option<usize>,
    String,
    Option<String>,
    bool,
    Option<Bound<'py, PyArray2<f64>>>,
);

/// What a run has found.
#[pyclass(module = "monogrid", frozen)]
pub struct SlamResult {
    map: Option<Arc<monogrid::occupancy::OccupancyMap>>,
    /// s.
    times: Vec<f64>,
    poses: Vec<[f64; 16]>,
    /// How many keyframes there are.
    #[pyo3(get)]
    num_keyframes: usize,
    map_from_world: [f64; 16],
    /// Whether lengths of the map are metres.
    #[pyo3(get)]
    is_metric: bool,
    /// Whether z of the map is against gravity by an inertial sensor.
    #[pyo3(get)]
    is_level: bool,
}

/// What a result is made of.
type ResultArgs = (
    Option<OccupancyMap>,
    Vec<f64>,
    Vec<[f64; 16]>,
    usize,
    [f64; 16],
    bool,
    bool,
);

/// Images of one camera in, poses and a growing map out. The same images and settings give the same
/// bytes.
///
/// imu: a sensor whose readings come by `push_imu`: the map becomes level and metric when they are
/// sure enough. mask: uint8, shape (height, width), 0 where pixels must be ignored. config: a
/// `config.toml`, e.g. one that says `profile = "fast"` for a small computer. settings: changes of
/// it, as `["mapping.resolution=0.02"]`.
#[pyclass(module = "monogrid", frozen)]
pub struct Slam {
    /// None when it is finished.
    pipeline: Arc<Mutex<Option<Pipeline>>>,
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
        map: maps.map(|maps| Arc::new(maps.global)),
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
            pipeline: Arc::new(Mutex::new(Some(pipeline.map_err(of_pipeline)?))),
            has_imu: imu.is_some(),
            size: (camera.width, camera.height),
        })
    }

    /// Takes the next image, uint8 of shape (height, width) or (height, width, 3: red, green,
    /// blue).
    ///
    /// With a rolling shutter, or when readings until its time are missing, it tells what became of
    /// the image before, and of this one later.
    fn push(&self, image: &Bound<PyAny>, seconds: f64) -> PyResult<Frame> {
        let (py, image) = (image.py(), grey(image, self.size)?);
        let time_ns = nanoseconds(seconds, "the image")?;
        let report = self.with(py, |pipeline| pipeline.push(image, time_ns))?;
        Ok(Frame::of(report))
    }

    /// Takes readings: times (n,) on the clock of the images, rad/s (n, 3), m/s² with gravity in it
    /// (n, 3); or a single one.
    ///
    /// Readings come before images that are later. Tells what became of the image that waited for
    /// them, if one did.
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

    /// The map as it is now, z up as the first camera was held, or as an inertial sensor says; None
    /// before the first finished keyframe.
    fn map(&self, py: Python) -> PyResult<Option<OccupancyMap>> {
        let pipeline = Arc::clone(&self.pipeline);
        let map = wait_for(py, move || {
            let mut pipeline = pipeline.lock().unwrap_or_else(PoisonError::into_inner);
            pipeline.as_mut().map(|pipeline| pipeline.map())
        })?;
        let map = map.ok_or_else(finished)?.map_err(of_pipeline)?;
        Ok(map.map(OccupancyMap::of))
    }

    /// Ends the run: final depth, poses and map. What Ctrl-C interrupts here is lost.
    fn finish(&self, py: Python) -> PyResult<SlamResult> {
        let pipeline = Arc::clone(&self.pipeline);
        let ended = wait_for(py, move || {
            let mut pipeline = pipeline.lock().unwrap_or_else(PoisonError::into_inner);
            pipeline.take().map(result_of)
        })?;
        ended.ok_or_else(finished)?.map_err(of_pipeline)
    }

    fn __repr__(&self) -> String {
        let ((width, height), imu) = (
            self.size,
            if self.has_imu {
                ", inertial sensor"
            } else {
                ""
            },
        );
        format!("<monogrid.Slam: {width}x{height}{imu}>")
    }
}

#[pymethods]
impl SlamResult {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "all that is kept")]
    fn new(
        py: Python,
        map: Option<PyRef<OccupancyMap>>,
        times: Vec<f64>,
        poses: Vec<[f64; 16]>,
        num_keyframes: usize,
        map_from_world: [f64; 16],
        is_metric: bool,
        is_level: bool,
    ) -> Self {
        Self {
            map: map.map(|map| map.snapshot(py)),
            times,
            poses,
            num_keyframes,
            map_from_world,
            is_metric,
            is_level,
        }
    }

    /// For pickle and copy.
    fn __getnewargs__(&self) -> ResultArgs {
        (
            self.map(),
            self.times.clone(),
            self.poses.clone(),
            self.num_keyframes,
            self.map_from_world,
            self.is_metric,
            self.is_level,
        )
    }

    /// z up as the first camera was held, or as an inertial sensor says; None if nothing was
    /// mapped.
    #[getter]
    fn map(&self) -> Option<OccupancyMap> {
        self.map.clone().map(OccupancyMap::of)
    }

    /// Seconds of every frame with a pose.
    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.times.clone().into_pyarray(py)
    }

    /// `world_from_camera` of every frame with a pose, shape (n, 4, 4); the world is the first
    /// keyframe's camera.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        matrices(py, self.poses.clone())
    }

    /// From the world of `poses` to the map: scale times rotation, and translation, shape (4, 4).
    #[getter]
    fn map_from_world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        square(py, &self.map_from_world)
    }

    fn __repr__(&self) -> String {
        let (poses, keyframes) = (self.poses.len(), self.num_keyframes);
        let unit = if self.is_metric { ", metric" } else { "" };
        format!("<monogrid.SlamResult: {poses} poses, {keyframes} keyframes{unit}>")
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
