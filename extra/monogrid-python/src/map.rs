//! Occupancy maps.

use crate::arrays::{Kind, contiguous, kind_of, pose_of, rows, triples};
use crate::errors::{of_map, type_of, value};
use crate::interrupt::{look_at, wait_for};
use monogrid::occupancy::{
    self, DepthPixel, DepthScan, DistanceConfig, IntegrationConfig, IntegrationRule, MapConfig,
    MapFormat, Occupancy, PoseSigma, RayHit, Scan, ScanData, Similarity, UnknownCells, VoxelKey,
    integrate, read_map, read_mgo, save_atomically, write_mgo,
};
use numpy::{
    IntoPyArray, Ix1, Ix2, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyType};
use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};

type Array1<'py, T> = Bound<'py, PyArray1<T>>;
type Array2<'py, T> = Bound<'py, PyArray2<T>>;

/// Most cells of a dense array.
const MAX_DENSE_CELLS: u64 = 1 << 30;

/// Log-odds of occupancy per cell, compatible with OctoMap. Lengths are in map units (metres, if
/// the measurements are).
///
/// memory_budget: bytes that the map may take (default: 8 GiB); MemoryError where a scan would need
/// more. Several threads may look at a map at once, and change it in turn. It can be pickled and
/// copied.
#[pyclass(module = "monogrid", frozen)]
pub struct OccupancyMap {
    inner: Arc<RwLock<Inner>>,
}

/// A map, shared with whoever looks at it until one of them writes.
struct Inner {
    map: Arc<occupancy::OccupancyMap>,
    next_scan: u32,
}

impl Inner {
    /// Adds a scan; how many measurements were used.
    fn add(&mut self, how: &How, data: ScanData, world: Similarity) -> PyResult<usize> {
        let scan = Scan {
            id: self.next_scan,
            world_from_sensor: world,
            pose_sigma: PoseSigma::default(),
            data,
        };
        let map = Arc::make_mut(&mut self.map);
        let report = integrate(map, &scan, &how.config, how.threads);
        self.next_scan = self.next_scan.wrapping_add(1);
        report.map(|report| report.points).map_err(of_map)
    }
}

/// Bytes, bytes of the budget, and the number of the next scan.
type State<'py> = (Bound<'py, PyBytes>, usize, u32);

fn read(inner: &RwLock<Inner>) -> RwLockReadGuard<'_, Inner> {
    inner.read().unwrap_or_else(PoisonError::into_inner)
}

impl OccupancyMap {
    pub fn of(map: Arc<occupancy::OccupancyMap>) -> Self {
        let next_scan = 0;
        let inner = Inner { map, next_scan };
        Self {
            inner: Arc::new(RwLock::new(inner)),
        }
    }

    /// The map as it is now.
    pub fn snapshot(&self, py: Python) -> Arc<occupancy::OccupancyMap> {
        py.detach(|| Arc::clone(&read(&self.inner).map))
    }

    /// Looks at it, while others may look too.
    fn look<T: Send + 'static>(
        &self,
        py: Python,
        look: impl FnOnce(&occupancy::OccupancyMap) -> T + Send + 'static,
    ) -> PyResult<T> {
        let inner = Arc::clone(&self.inner);
        wait_for(py, move || look(&read(&inner).map))
    }

    /// Changes it, while nobody looks.
    fn change<T: Send + 'static>(
        &self,
        py: Python,
        change: impl FnOnce(&mut Inner) -> T + Send + 'static,
    ) -> PyResult<T> {
        let inner = Arc::clone(&self.inner);
        wait_for(py, move || {
            change(&mut inner.write().unwrap_or_else(PoisonError::into_inner))
        })
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
    #[pyo3(signature = (resolution = 0.05, *, memory_budget = None))]
    fn new(resolution: f64, memory_budget: Option<usize>) -> PyResult<Self> {
        let config = MapConfig::with_resolution(resolution);
        let memory_budget_bytes = memory_budget.unwrap_or(config.memory_budget_bytes);
        let map = occupancy::OccupancyMap::new(MapConfig {
            memory_budget_bytes,
            ..config
        });
        Ok(Self::of(Arc::new(map.map_err(of_map)?)))
    }

    /// Reads `.ot`, `.bt` (OctoMap) or `.mgo`, whatever the name.
    #[staticmethod]
    fn read(py: Python, path: PathBuf) -> PyResult<Self> {
        let file = File::open(&path)?;
        let bytes = file.metadata()?.len();
        let map = wait_for(py, move || read_map(BufReader::new(file), bytes))?;
        let (map, _) = map.map_err(|error| value(format!("map {}: {error}", path.display())))?;
        Ok(Self::of(Arc::new(map)))
    }

    /// Writes `.ot`, `.bt`, `.mgo`, `.ply` or `.pcd`; a file that exists is replaced whole or not
    /// at all.
    fn write(&self, py: Python, path: PathBuf) -> PyResult<()> {
        let format = MapFormat::from_name(&path, &MapFormat::ALL).map_err(of_map)?;
        let save = move |map: &occupancy::OccupancyMap| {
            save_atomically(&path, |file| format.write(map, file))
        };
        self.look(py, save)?.map_err(of_map)
    }

    /// Adds a scan; how many points were used.
    ///
    /// points: shape (n, 3), in the frame of the sensor (read without a copy if float32), or, with
    /// `origin`, in that of the map. pose: `map_from_sensor`, shape (4, 4). sigma: standard
    /// deviation of each range, or one for all, positive (default: half a cell). Points that are
    /// not finite are left out. ValueError or TypeError where anything else is not what is
    /// expected. rule: "fused" for scans that cover surfaces, "rays" for lone points.
    #[pyo3(signature = (
        points, pose = None, *, origin = None, sigma = None, rule = "fused", max_range = None,
        threads = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn insert(
        &self,
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
            return self.insert_points(py, how, points, sigma, world);
        }
        let array = contiguous::<f32, Ix2>(points, "(n, 3)")?;
        let world = similarity(&pose_of(pose)?);
        self.insert_points(py, how, rows(&array, "points")?.to_vec(), sigma, world)
    }

    /// Adds a depth image; how many pixels were used.
    ///
    /// depth: shape (height, width), along the optical axis, 0 or NaN where unknown; floats are
    /// metres, integers need a `depth_scale`: metres of a unit (0.001 for millimetres), or units of
    /// a metre (1000; 5000 for TUM RGB-D). TypeError without it. pose: `map_from_camera` (x right,
    /// y down, z forward), shape (4, 4). relative_sigma: standard deviation as a part of the depth.
    #[pyo3(signature = (
        depth, fx, fy, cx, cy, pose = None, *, depth_scale = None, relative_sigma = 0.01,
        rule = "fused", max_range = None, threads = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn insert_depth(
        &self,
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
        self.change(py, move |inner| {
            let scan = DepthScan {
                width: width as u32,
                height: height as u32,
                fx,
                fy,
                cx,
                cy,
                pixels: &pixels,
            };
            inner.add(&how, ScanData::Depth(scan), world)
        })?
    }

    /// Of each point, shape (n, 3): 1 occupied, 0 free, -1 unknown.
    fn state<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array1<'py, i8>> {
        let states = each(&self.inner, points, |inner, p| code(inner.map.state(p)))?;
        Ok(states.into_pyarray(points.py()))
    }

    /// Of each point, shape (n, 3); NaN where unknown.
    fn log_odds<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array1<'py, f32>> {
        let log_odds = |inner: &Inner, p| inner.map.log_odds(p).unwrap_or(f32::NAN);
        let log_odds = each(&self.inner, points, log_odds)?;
        Ok(log_odds.into_pyarray(points.py()))
    }

    /// Whether a ball around each point touches an occupied (or unknown) cell.
    #[pyo3(signature = (points, radius, *, unknown_blocks = false))]
    fn collides<'py>(
        &self,
        points: &Bound<'py, PyAny>,
        radius: f64,
        unknown_blocks: bool,
    ) -> PyResult<Array1<'py, bool>> {
        let unknown = unknown_cells(unknown_blocks);
        let collides = |inner: &Inner, p| inner.map.sphere_collides(p, radius, unknown);
        let collides = each(&self.inner, points, collides)?;
        Ok(collides.into_pyarray(points.py()))
    }

    /// Range of the first occupied (or unknown) cell on each ray, infinite where there is none, and
    /// its state (0: none).
    ///
    /// origins: shape (n, 3) or (1, 3) for all. directions: shape (n, 3), of any length.
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
        let cast = |inner: &Inner, k: usize, direction: &[f64; 3]| {
            let origin = from[if from.len() == 1 { 0 } else { k }];
            match inner.map.cast_ray(origin, *direction, max_range, unknown) {
                RayHit::Occupied { range, .. } => (range, 1),
                RayHit::Unknown { range, .. } => (range, -1),
                RayHit::Nothing => (f64::INFINITY, 0),
                RayHit::Invalid => (f64::NAN, 0),
            }
        };
        let hits = look_at(py, &self.inner, along, cast)?;
        let (ranges, states): (Vec<f64>, Vec<i8>) = hits.into_iter().unzip();
        Ok((ranges.into_pyarray(py), states.into_pyarray(py)))
    }

    /// Distances to the nearest obstacle, up to `max_distance`.
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
        let field = self.look(py, move |map| {
            occupancy::DistanceField::new(map, config, all_threads())
        })?;
        Ok(DistanceField {
            field: Arc::new(RwLock::new(field.map_err(of_map)?)),
            max_distance,
            unknown_blocks,
        })
    }

    /// Centres, shape (n, 3), and log-odds of all known cells, or of the free (0) or occupied (1)
    /// ones.
    #[pyo3(signature = (state = None))]
    fn cells<'py>(
        &self,
        py: Python<'py>,
        state: Option<i8>,
    ) -> PyResult<(Array2<'py, f64>, Array1<'py, f32>)> {
        let (centres, log_odds): (Vec<[f64; 3]>, Vec<f32>) = self.look(py, move |map| {
            let (cells, resolution) = (map.cells(), map.resolution());
            let wanted = cells.filter(|cell| state.is_none_or(|state| code(cell.state) == state));
            wanted
                .map(|cell| (cell.key.center(resolution), cell.log_odds))
                .unzip()
        })?;
        Ok((triples(py, centres)?, log_odds.into_pyarray(py)))
    }

    /// Log-odds of a box as an array [x, y, z], NaN where unknown, and the corner of its first
    /// cell.
    #[pyo3(signature = (low = None, high = None))]
    fn dense<'py>(
        &self,
        py: Python<'py>,
        low: Option<[f64; 3]>,
        high: Option<[f64; 3]>,
    ) -> PyResult<(Bound<'py, PyArray3<f32>>, [f64; 3])> {
        let (values, size, origin) = self.look(py, move |map| dense(map, low, high))??;
        Ok((values.into_pyarray(py).reshape(size)?, origin))
    }

    /// Seen from above between two heights, as [row from below, column] (1, 0, -1), and the lower
    /// left corner.
    fn project<'py>(
        &self,
        py: Python<'py>,
        low: f64,
        high: f64,
    ) -> PyResult<(Array2<'py, i8>, [f64; 2])> {
        let seen = self.look(py, move |map| map.projected(low, high))?;
        let seen = seen.map_err(of_map)?;
        let Some(seen) = seen else {
            return Ok((Vec::<i8>::new().into_pyarray(py).reshape([0, 0])?, [0.0; 2]));
        };
        let states: Vec<i8> = seen.columns.iter().map(|state| code(*state)).collect();
        Ok((
            states.into_pyarray(py).reshape([seen.height, seen.width])?,
            seen.origin,
        ))
    }

    /// Adds the log-odds of a map with cells of the same size.
    fn merge(&self, py: Python, other: PyRef<Self>) -> PyResult<()> {
        let other = other.snapshot(py);
        let merge = move |inner: &mut Inner| Arc::make_mut(&mut inner.map).merge(&other);
        self.change(py, merge)?.map_err(of_map)
    }

    /// The part in a box.
    fn crop(&self, py: Python, low: [f64; 3], high: [f64; 3]) -> PyResult<Self> {
        let map = self.look(py, move |map| map.cropped(low, high))?;
        Ok(Self::of(Arc::new(map.map_err(of_map)?)))
    }

    /// A copy, at once: cells are copied when one of the two is changed.
    fn copy(&self, py: Python) -> Self {
        py.detach(|| {
            let inner = read(&self.inner);
            let (map, next_scan) = (Arc::clone(&inner.map), inner.next_scan);
            let inner = Arc::new(RwLock::new(Inner { map, next_scan }));
            Self { inner }
        })
    }

    /// As `copy`.
    fn __copy__(&self, py: Python) -> Self {
        self.copy(py)
    }

    /// As `copy`.
    fn __deepcopy__(&self, py: Python, _memo: &Bound<PyAny>) -> Self {
        self.copy(py)
    }

    /// For pickle: exact.
    fn __reduce__<'py>(
        this: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyType>, (f64,), State<'py>)> {
        let (py, inner) = (this.py(), Arc::clone(&this.get().inner));
        let packed = wait_for(py, move || {
            let (inner, mut bytes) = (read(&inner), Vec::new());
            let written = write_mgo(&inner.map, &mut bytes);
            let config = inner.map.config().clone();
            written.map(|()| (bytes, config, inner.next_scan))
        })?;
        let (bytes, config, next_scan) = packed.map_err(of_map)?;
        let state = (
            PyBytes::new(py, &bytes),
            config.memory_budget_bytes,
            next_scan,
        );
        Ok((this.get_type(), (config.resolution,), state))
    }

    /// For pickle.
    fn __setstate__(&self, py: Python, state: State) -> PyResult<()> {
        let (bytes, budget, next_scan) = state;
        let map = read_mgo(bytes.as_bytes(), budget).map_err(of_map)?;
        self.change(py, move |inner| {
            *inner = Inner {
                map: Arc::new(map),
                next_scan,
            };
        })
    }

    /// Edge of a cell.
    #[getter]
    fn resolution(&self, py: Python) -> f64 {
        self.snapshot(py).resolution()
    }

    /// Corners of the box of all known cells.
    #[getter]
    fn bounds(&self, py: Python) -> PyResult<Option<([f64; 3], [f64; 3])>> {
        self.look(py, |map| map.bounds())
    }

    /// Number of occupied and of free cells.
    #[getter]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let counts = self.look(py, |map| map.cell_counts())?;
        let dictionary = PyDict::new(py);
        dictionary.set_item("occupied", counts.occupied)?;
        dictionary.set_item("free", counts.free)?;
        Ok(dictionary)
    }

    fn __repr__(&self, py: Python) -> PyResult<String> {
        self.look(py, |map| {
            let (counts, resolution) = (map.cell_counts(), map.resolution());
            format!(
                "<monogrid.OccupancyMap: {} occupied and {} free cells of {resolution}>",
                counts.occupied, counts.free
            )
        })
    }
}

impl OccupancyMap {
    fn insert_points(
        &self,
        py: Python,
        how: How,
        points: Vec<[f32; 3]>,
        sigma: Option<&Bound<PyAny>>,
        world: Similarity,
    ) -> PyResult<usize> {
        let sigmas = match sigma {
            Some(sigma) => sigmas(sigma, points.len())?,
            // half a cell: what the map tells apart
            None => vec![0.5 * self.resolution(py) as f32],
        };
        self.change(py, move |inner| {
            let scan = Scan::of_points(0, world, &points, &sigmas);
            inner.add(&how, scan.data, world)
        })?
    }
}

/// The cells of a box as an array, its shape, and the corner of its first cell.
type Dense = (Vec<f32>, [usize; 3], [f64; 3]);

fn dense(
    map: &occupancy::OccupancyMap,
    low: Option<[f64; 3]>,
    high: Option<[f64; 3]>,
) -> PyResult<Dense> {
    let Some((first, last)) = key_box(map, low, high)? else {
        return Ok((Vec::new(), [0; 3], [0.0; 3]));
    };
    let from_first =
        |key: VoxelKey| [key.x - first.x, key.y - first.y, key.z - first.z].map(|n| n as usize);
    let size = from_first(last).map(|n| n + 1);
    let mut values = vec![f32::NAN; size.iter().product()];
    for cell in map.cells_in_key_box(first, last) {
        let [x, y, z] = from_first(cell.key);
        values[(x * size[1] + y) * size[2] + z] = cell.log_odds;
    }
    let origin = [first.x, first.y, first.z].map(|n| f64::from(n) * map.resolution());
    Ok((values, size, origin))
}

/// The cells between two corners, by default all that are known; none of an empty map.
fn key_box(
    map: &occupancy::OccupancyMap,
    low: Option<[f64; 3]>,
    high: Option<[f64; 3]>,
) -> PyResult<Option<(VoxelKey, VoxelKey)>> {
    let known = map.key_bounds();
    let key = |corner: [f64; 3]| {
        let key = map.key(corner);
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

/// A value for every point of an array of shape (n, 3).
fn each<L: Send + Sync, T: Send>(
    lock: &RwLock<L>,
    points: &Bound<PyAny>,
    of: impl Fn(&L, [f64; 3]) -> T + Sync,
) -> PyResult<Vec<T>> {
    let array = contiguous::<f64, Ix2>(points, "(n, 3)")?;
    let rows = rows(&array, "points")?;
    look_at(points.py(), lock, rows, |looked_at, _, point| {
        of(looked_at, *point)
    })
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

/// Distance from everywhere to the nearest obstacle; made by `OccupancyMap.distance_field`.
#[pyclass(module = "monogrid", frozen)]
pub struct DistanceField {
    field: Arc<RwLock<occupancy::DistanceField>>,
    max_distance: f64,
    unknown_blocks: bool,
}

#[pymethods]
impl DistanceField {
    /// Of each point, shape (n, 3), from the centre of its cell; infinite beyond the reach.
    fn distance<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array1<'py, f64>> {
        let distance =
            |field: &occupancy::DistanceField, p| field.distance(p).unwrap_or(f64::INFINITY);
        Ok(each(&self.field, points, distance)?.into_pyarray(points.py()))
    }

    /// Direction in which the distance grows, shape (n, 3); NaN where there is none.
    fn gradient<'py>(&self, points: &Bound<'py, PyAny>) -> PyResult<Array2<'py, f64>> {
        let gradient =
            |field: &occupancy::DistanceField, p| field.gradient(p).unwrap_or([f64::NAN; 3]);
        triples(points.py(), each(&self.field, points, gradient)?)
    }

    /// Follows the map that it was made of; how many bricks were looked at.
    fn update(&self, py: Python, map: PyRef<OccupancyMap>) -> PyResult<usize> {
        let (field, map) = (Arc::clone(&self.field), Arc::clone(&map.inner));
        wait_for(py, move || {
            let mut field = field.write().unwrap_or_else(PoisonError::into_inner);
            field.update(&read(&map).map, all_threads())
        })
    }

    fn __repr__(&self) -> String {
        let unknown = match self.unknown_blocks {
            true => ", unknown cells are obstacles",
            false => "",
        };
        format!(
            "<monogrid.DistanceField: up to {}{unknown}>",
            self.max_distance
        )
    }
}
