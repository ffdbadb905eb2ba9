//! Occupancy maps.

use crate::arrays::{Kind, contiguous, kind_of, pose_of, rows, triples};
use crate::errors::{of_map, type_of, value};
use monogrid::occupancy::{
    self, DepthPixel, DepthScan, DistanceConfig, IntegrationConfig, IntegrationRule, MapConfig,
    MapFormat, Occupancy, PoseSigma, RayHit, Scan, ScanData, Similarity, UnknownCells, VoxelKey,
    integrate, read_map, save_atomically,
};
use numpy::{
    IntoPyArray, Ix1, Ix2, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;
use std::sync::Arc;

type Array1<'py, T> = Bound<'py, PyArray1<T>>;
type Array2<'py, T> = Bound<'py, PyArray2<T>>;

/// Most cells of a dense array.
const MAX_DENSE_CELLS: u64 = 1 << 30;

/// Log-odds per cell; shared with whoever looks at it until one of them writes.
#[pyclass(module = "monogrid")]
#[derive(Clone)]
pub struct OccupancyMap {
    pub map: Arc<occupancy::OccupancyMap>,
    next_scan: u32,
}

impl OccupancyMap {
    pub fn of(map: Arc<occupancy::OccupancyMap>) -> Self {
        Self { map, next_scan: 0 }
    }

    /// Adds a scan without Python's lock; how many measurements were used.
    fn add(&mut self, py: Python, how: &How, data: ScanData, world: Similarity) -> PyResult<usize> {
        let scan = Scan {
            id: self.next_scan,
            world_from_sensor: world,
            pose_sigma: PoseSigma::default(),
            data,
        };
        let map = Arc::make_mut(&mut self.map);
        let report = py.detach(|| integrate(map, &scan, &how.config, how.threads));
        self.next_scan = self.next_scan.wrapping_add(1);
        report.map(|report| report.points).map_err(of_map)
    }
}

/// How scans are integrated.
struct How {
    config: IntegrationConfig,
    threads: usize,
}

impl How {
    fn new(rule: &str, max_range: Option<f64>, threads: Option<usize>) -> PyResult<Self> {
        let default = IntegrationConfig::default();
        let rule = match rule {
            "fused" => IntegrationRule::Fused,
            "rays" => IntegrationRule::Rays,
            other => {
                return Err(value(format!(
                    "rule is {other:?}, expected \"fused\" or \"rays\""
                )));
            }
        };
        let max_range = max_range.unwrap_or(default.max_range);
        positive(max_range, "max_range", Some(f64::INFINITY))?;
        if threads == Some(0) {
            return Err(value("threads is 0, expected at least 1"));
        }
        Ok(Self {
            config: IntegrationConfig {
                rule,
                max_range,
                ..default
            },
            threads: threads.unwrap_or_else(all_threads),
        })
    }
}

/// Refuses a number that is not positive, or not finite but for the one that is allowed.
fn positive(number: f64, name: &str, allowed: Option<f64>) -> PyResult<()> {
    let is_fine = number > 0.0 && number.is_finite() || Some(number) == allowed;
    is_fine
        .then_some(())
        .ok_or_else(|| value(format!("{name} is {number}, expected a positive number")))
}

/// Refuses numbers that are not finite.
fn finite(numbers: &[f64], name: &str) -> PyResult<()> {
    match numbers.iter().all(|number| number.is_finite()) {
        true => Ok(()),
        false => Err(value(format!(
            "{name} is {numbers:?}, expected finite numbers"
        ))),
    }
}

/// Metres of one unit of a depth image.
///
/// A depth image of integers is in some unit that only who made it knows. No unit is larger than a
/// metre, so that both usual ways to say it are understood: metres of a unit (0.001), or units of a
/// metre (1000).
fn metres_per_unit(depth: &Bound<PyAny>, depth_scale: Option<f64>) -> PyResult<f32> {
    if let Some(scale) = depth_scale {
        positive(scale, "depth_scale", None)?;
    }
    let metres = depth_scale.map(|scale| if scale > 1.0 { 1.0 / scale } else { scale });
    match (kind_of(depth)?, metres) {
        (Kind::Float | Kind::Integer, Some(metres)) => Ok(metres as f32),
        (Kind::Float, None) => Ok(1.0),
        (Kind::Integer, None) => Err(type_of(
            "depth is an array of integers, expected floats in metres, or depth_scale for integers \
             (0.001 or 1000 for millimetres, 5000 for TUM RGB-D)",
        )),
        (Kind::Bool | Kind::Other, _) => Err(type_of(
            "depth is an array of neither floats nor integers, expected floats in metres, or \
             integers with depth_scale",
        )),
    }
}

pub fn all_threads() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

fn unknown_cells(unknown_blocks: bool) -> UnknownCells {
    match unknown_blocks {
        true => UnknownCells::Stop,
        false => UnknownCells::PassThrough,
    }
}

fn code(state: Occupancy) -> i8 {
    match state {
        Occupancy::Unknown => -1,
        Occupancy::Free => 0,
        Occupancy::Occupied => 1,
    }
}

#[pymethods]
impl OccupancyMap {
    #[new]
    #[pyo3(signature = (resolution = 0.05))]
    fn new(resolution: f64) -> PyResult<Self> {
        let map = occupancy::OccupancyMap::new(MapConfig::with_resolution(resolution));
        Ok(Self::of(Arc::new(map.map_err(of_map)?)))
    }

    #[staticmethod]
    fn read(py: Python, path: PathBuf) -> PyResult<Self> {
        let file = File::open(&path)?;
        let bytes = file.metadata()?.len();
        let map = py.detach(|| read_map(BufReader::new(file), bytes));
        let (map, _) = map.map_err(|error| value(format!("map {}: {error}", path.display())))?;
        Ok(Self::of(Arc::new(map)))
    }

    fn write(&self, py: Python, path: PathBuf) -> PyResult<()> {
        let format = MapFormat::from_name(&path, &MapFormat::ALL).map_err(of_map)?;
        let save = || save_atomically(&path, |file| format.write(&self.map, file));
        py.detach(save).map_err(of_map)
    }

    #[pyo3(signature = (
        points, pose = None, *, origin = None, sigma = None, rule = "fused", max_range = None,
        threads = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn insert(
        &mut self,
        points: &Bound<PyAny>,
        pose: Option<&Bound<PyAny>>,
        origin: Option<[f64; 3]>,
        sigma: Option<&Bound<PyAny>>,
        rule: &str,
        max_range: Option<f64>,
        threads: Option<usize>,
    ) -> PyResult<usize> {
        let py = points.py();
        let how = How::new(rule, max_range, threads)?;
        if let Some(origin) = origin {
            if pose.is_some() {
                return Err(value(
                    "give a pose for points in the sensor's frame, or the origin of points in the \
                     map's, not both",
                ));
            }
            finite(&origin, "origin")?;
            let array = contiguous::<f64, Ix2>(points, "(n, 3)")?;
            let relative = |p: &[f64; 3]| std::array::from_fn(|i| (p[i] - origin[i]) as f32);
            let points: Vec<[f32; 3]> = rows(&array, "points")?.iter().map(relative).collect();
            let world = Similarity {
                translation: origin,
                ..Similarity::IDENTITY
            };
            return self.insert_points(py, &how, &points, sigma, world);
        }
        let array = contiguous::<f32, Ix2>(points, "(n, 3)")?;
        let world = similarity(&pose_of(pose)?);
        self.insert_points(py, &how, rows(&array, "points")?, sigma, world)
    }

    #[pyo3(signature = (
        depth, fx, fy, cx, cy, pose = None, *, depth_scale = None, relative_sigma = 0.01,
        rule = "fused", max_range = None, threads = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn insert_depth(
        &mut self,
        depth: &Bound<PyAny>,
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        pose: Option<&Bound<PyAny>>,
        depth_scale: Option<f64>,
        relative_sigma: f64,
        rule: &str,
        max_range: Option<f64>,
        threads: Option<usize>,
    ) -> PyResult<usize> {
        let py = depth.py();
        let how = How::new(rule, max_range, threads)?;
        let metres = metres_per_unit(depth, depth_scale)?;
        positive(relative_sigma, "relative_sigma", None)?;
        positive(fx, "fx", None)?;
        positive(fy, "fy", None)?;
        finite(&[cx, cy], "the principal point")?;
        let array = contiguous::<f32, Ix2>(depth, "(height, width)")?;
        let (height, width) = (array.shape()[0], array.shape()[1]);
        if width.max(height) > u16::MAX.into() {
            return Err(value(format!(
                "a depth image of {width}x{height} pixels, expected at most 65535"
            )));
        }
        let world = similarity(&pose_of(pose)?);
        let values = array.as_slice()?;
        let pixels = py.detach(|| depth_pixels(values, width, metres, relative_sigma as f32));
        let scan = DepthScan {
            width: width as u32,
            height: height as u32,
            fx,
            fy,
            cx,
            cy,
            pixels: &pixels,
        };
        self.add(py, &how, ScanData::Depth(scan), world)
    }

    fn state<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array1<'py, i8>> {
        let states = each(points, |point| code(self.map.state(point)))?;
        Ok(states.into_pyarray(points.py()))
    }

    fn log_odds<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array1<'py, f32>> {
        let log_odds = each(points, |point| self.map.log_odds(point).unwrap_or(f32::NAN))?;
        Ok(log_odds.into_pyarray(points.py()))
    }

    #[pyo3(signature = (points, radius, *, unknown_blocks = false))]
    fn collides<'py>(
        &self,
        points: &Bound<'py, PyAny>,
        radius: f64,
        unknown_blocks: bool,
    ) -> PyResult<Array1<'py, bool>> {
        let unknown = unknown_cells(unknown_blocks);
        let collides = |point| self.map.sphere_collides(point, radius, unknown);
        Ok(each(points, collides)?.into_pyarray(points.py()))
    }

    #[pyo3(signature = (origins, directions, max_range = 100.0, *, unknown_blocks = false))]
    fn cast_rays<'py>(
        &self,
        origins: &Bound<'py, PyAny>,
        directions: &Bound<'py, PyAny>,
        max_range: f64,
        unknown_blocks: bool,
    ) -> PyResult<(Array1<'py, f64>, Array1<'py, i8>)> {
        let py = origins.py();
        let origins = contiguous::<f64, Ix2>(origins, "(n, 3)")?;
        let directions = contiguous::<f64, Ix2>(directions, "(n, 3)")?;
        let (from, along) = (rows(&origins, "origins")?, rows(&directions, "directions")?);
        if from.len() != along.len() && from.len() != 1 {
            return Err(value(format!(
                "{} origins for {} directions, expected as many, or one",
                from.len(),
                along.len()
            )));
        }
        let unknown = unknown_cells(unknown_blocks);
        let cast = |(k, direction): (usize, &[f64; 3])| {
            let origin = from[if from.len() == 1 { 0 } else { k }];
            match self.map.cast_ray(origin, *direction, max_range, unknown) {
                RayHit::Occupied { range, .. } => (range, 1),
                RayHit::Unknown { range, .. } => (range, -1),
                RayHit::Nothing => (f64::INFINITY, 0),
                RayHit::Invalid => (f64::NAN, 0),
            }
        };
        let (ranges, states): (Vec<_>, Vec<_>) =
            py.detach(|| along.iter().enumerate().map(cast).unzip());
        Ok((ranges.into_pyarray(py), states.into_pyarray(py)))
    }

    #[pyo3(signature = (max_distance = 1.0, *, unknown_blocks = false))]
    fn distance_field(
        &self,
        py: Python,
        max_distance: f64,
        unknown_blocks: bool,
    ) -> PyResult<DistanceField> {
        let config = DistanceConfig {
            max_distance,
            unknown: unknown_cells(unknown_blocks),
        };
        let field = py.detach(|| occupancy::DistanceField::new(&self.map, config, all_threads()));
        Ok(DistanceField {
            field: field.map_err(of_map)?,
        })
    }

    #[pyo3(signature = (state = None))]
    fn cells<'py>(
        &self,
        py: Python<'py>,
        state: Option<i8>,
    ) -> PyResult<(Array2<'py, f64>, Array1<'py, f32>)> {
        let resolution = self.map.resolution();
        let (centres, log_odds): (Vec<_>, Vec<_>) = py.detach(|| {
            let cells = self.map.cells();
            let wanted = cells.filter(|cell| state.is_none_or(|state| code(cell.state) == state));
            wanted
                .map(|cell| (cell.key.center(resolution), cell.log_odds))
                .unzip()
        });
        Ok((triples(py, centres)?, log_odds.into_pyarray(py)))
    }

    #[pyo3(signature = (low = None, high = None))]
    fn dense<'py>(
        &self,
        py: Python<'py>,
        low: Option<[f64; 3]>,
        high: Option<[f64; 3]>,
    ) -> PyResult<(Bound<'py, PyArray3<f32>>, [f64; 3])> {
        let resolution = self.map.resolution();
        let Some((first, last)) = self.key_box(low, high)? else {
            return Ok((
                Vec::<f32>::new().into_pyarray(py).reshape([0, 0, 0])?,
                [0.0; 3],
            ));
        };
        let from_first =
            |key: VoxelKey| [key.x - first.x, key.y - first.y, key.z - first.z].map(|n| n as usize);
        let size = from_first(last).map(|n| n + 1);
        let values = py.detach(|| {
            let mut values = vec![f32::NAN; size.iter().product()];
            for cell in self.map.cells_in_key_box(first, last) {
                let [x, y, z] = from_first(cell.key);
                values[(x * size[1] + y) * size[2] + z] = cell.log_odds;
            }
            values
        });
        let origin = [first.x, first.y, first.z].map(|n| f64::from(n) * resolution);
        Ok((values.into_pyarray(py).reshape(size)?, origin))
    }

    fn project<'py>(
        &self,
        py: Python<'py>,
        low: f64,
        high: f64,
    ) -> PyResult<(Array2<'py, i8>, [f64; 2])> {
        let seen = py
            .detach(|| self.map.projected(low, high))
            .map_err(of_map)?;
        let Some(seen) = seen else {
            return Ok((Vec::<i8>::new().into_pyarray(py).reshape([0, 0])?, [0.0; 2]));
        };
        let states: Vec<i8> = seen.columns.iter().map(|state| code(*state)).collect();
        Ok((
            states.into_pyarray(py).reshape([seen.height, seen.width])?,
            seen.origin,
        ))
    }

    fn merge(&mut self, py: Python, other: PyRef<Self>) -> PyResult<()> {
        let (map, other) = (Arc::make_mut(&mut self.map), Arc::clone(&other.map));
        py.detach(|| map.merge(&other)).map_err(of_map)
    }

    fn crop(&self, py: Python, low: [f64; 3], high: [f64; 3]) -> PyResult<Self> {
        let map = py.detach(|| self.map.cropped(low, high)).map_err(of_map)?;
        Ok(Self::of(Arc::new(map)))
    }

    fn copy(&self) -> Self {
        self.clone()
    }

    #[getter]
    fn resolution(&self) -> f64 {
        self.map.resolution()
    }

    #[getter]
    fn bounds(&self) -> Option<([f64; 3], [f64; 3])> {
        self.map.bounds()
    }

    #[getter]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let counts = py.detach(|| self.map.cell_counts());
        let dictionary = PyDict::new(py);
        dictionary.set_item("occupied", counts.occupied)?;
        dictionary.set_item("free", counts.free)?;
        Ok(dictionary)
    }

    fn __repr__(&self) -> String {
        let counts = self.map.cell_counts();
        format!(
            "<monogrid.OccupancyMap: {} occupied and {} free cells of {}>",
            counts.occupied,
            counts.free,
            self.map.resolution()
        )
    }
}

impl OccupancyMap {
    fn insert_points(
        &mut self,
        py: Python,
        how: &How,
        points: &[[f32; 3]],
        sigma: Option<&Bound<PyAny>>,
        world: Similarity,
    ) -> PyResult<usize> {
        let sigmas = match sigma {
            Some(sigma) => sigmas(sigma, points.len())?,
            // half a cell: what the map tells apart
            None => vec![0.5 * self.map.resolution() as f32],
        };
        let scan = Scan::of_points(0, world, points, &sigmas);
        self.add(py, how, scan.data, world)
    }

    /// The cells between two corners, by default all that are known; none of an empty map.
    fn key_box(
        &self,
        low: Option<[f64; 3]>,
        high: Option<[f64; 3]>,
    ) -> PyResult<Option<(VoxelKey, VoxelKey)>> {
        let known = self.map.key_bounds();
        let key = |corner: [f64; 3]| {
            let key = self.map.key(corner);
            key.ok_or_else(|| value(format!("{corner:?} is not in reach of a map")))
        };
        let (Some(first), Some(last)) = (
            low.map(key).transpose()?.or(known.map(|known| known.0)),
            high.map(key).transpose()?.or(known.map(|known| known.1)),
        ) else {
            return Ok(None);
        };
        let sides = [(first.x, last.x), (first.y, last.y), (first.z, last.z)];
        let sizes = sides.map(|(a, b)| u64::try_from(i64::from(b) - i64::from(a) + 1).unwrap_or(0));
        let cells = sizes.into_iter().fold(1, u64::saturating_mul);
        if cells == 0 || cells > MAX_DENSE_CELLS {
            return Err(value(format!(
                "a box of {sizes:?} cells, expected 1 to {MAX_DENSE_CELLS}"
            )));
        }
        Ok(Some((first, last)))
    }
}

/// A value for every point of an array of shape (n, 3), without Python's lock.
fn each<T: Send>(points: &Bound<PyAny>, of: impl Fn([f64; 3]) -> T + Sync) -> PyResult<Vec<T>> {
    let array = contiguous::<f64, Ix2>(points, "(n, 3)")?;
    let (rows, py) = (rows(&array, "points")?, points.py());
    Ok(py.detach(|| rows.iter().map(|point| of(*point)).collect()))
}

fn similarity(rows: &[[f64; 4]; 4]) -> Similarity {
    let row_major = std::array::from_fn(|k| rows[k / 4][k % 4]);
    Similarity::from_rigid(&row_major)
}

/// Standard deviations: one for all points, or one of each.
fn sigmas(sigma: &Bound<PyAny>, count: usize) -> PyResult<Vec<f32>> {
    let numpy = sigma.py().import("numpy")?;
    let sigma = numpy.call_method1("atleast_1d", (sigma,))?;
    let array = contiguous::<f32, Ix1>(&sigma, "(n,), or one number")?;
    let sigmas = array.as_slice()?;
    if sigmas.len() != 1 && sigmas.len() != count {
        return Err(value(format!(
            "found {} sigmas of {count} points, expected as many, or one number",
            sigmas.len()
        )));
    }
    match sigmas
        .iter()
        .find(|sigma| !(**sigma > 0.0 && sigma.is_finite()))
    {
        Some(bad) => Err(value(format!(
            "sigma holds {bad}, expected positive numbers"
        ))),
        None => Ok(sigmas.to_vec()),
    }
}

/// The pixels of a depth image that have a depth.
fn depth_pixels(depth: &[f32], width: usize, metres: f32, relative_sigma: f32) -> Vec<DepthPixel> {
    let all = depth.iter().map(|units| units * metres).enumerate();
    let known = all.filter(|(_, z)| z.is_finite() && *z > 0.0);
    let pixel = |(k, z): (usize, f32)| DepthPixel {
        x: (k % width) as u16,
        y: (k / width) as u16,
        idepth: 1.0 / z,
        sigma_idepth: relative_sigma / z,
    };
    known.map(pixel).collect()
}

/// Distances to the nearest obstacle.
#[pyclass(module = "monogrid")]
pub struct DistanceField {
    field: occupancy::DistanceField,
}

#[pymethods]
impl DistanceField {
    fn distance<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array1<'py, f64>> {
        let distance = |point| self.field.distance(point).unwrap_or(f64::INFINITY);
        Ok(each(points, distance)?.into_pyarray(points.py()))
    }

    fn gradient<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array2<'py, f64>> {
        let gradient = |point| self.field.gradient(point).unwrap_or([f64::NAN; 3]);
        triples(points.py(), each(points, gradient)?)
    }

    fn update(&mut self, py: Python, map: PyRef<OccupancyMap>) -> usize {
        let (field, map) = (&mut self.field, Arc::clone(&map.map));
        py.detach(|| field.update(&map, all_threads()))
    }
}
