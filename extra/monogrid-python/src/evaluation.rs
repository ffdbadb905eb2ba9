//! Trajectories and maps against the truth.

use crate::arrays::{contiguous, dictionary, rigid};
use crate::errors::value;
use crate::interrupt::wait_for;
use crate::map::OccupancyMap;
use monogrid::evaluation::{
    self, MapEvaluationConfig, StampedPose, TrajectoryAlignment, TrajectoryConfig, TruthGrid,
};
use numpy::{Ix1, Ix3, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Most cells of the box of a true map, two bits each.
const MAX_TRUE_CELLS: u64 = 4_000_000_000;

/// ATE and RPE as `evo` computes them, scale drift, coverage, as `monogrid evaluate trajectory
/// --json` prints them.
///
/// Times in seconds, shape (n,); poses `world_from_camera`, shape (n, 4, 4). `align`: "sim3", "se3"
/// or "none".
#[pyfunction]
#[pyo3(signature = (
    times, poses, true_times, true_poses, *, align = "sim3", max_difference = 0.01
))]
pub fn evaluate_trajectory<'py>(
    times: &Bound<'py, PyAny>,
    poses: &Bound<'py, PyAny>,
    true_times: &Bound<'py, PyAny>,
    true_poses: &Bound<'py, PyAny>,
    align: &str,
    max_difference: f64,
) -> PyResult<Bound<'py, PyAny>> {
    let py = times.py();
    let config = TrajectoryConfig {
        alignment: match align {
            "sim3" => TrajectoryAlignment::Sim3,
            "se3" => TrajectoryAlignment::Se3,
            "none" => TrajectoryAlignment::None,
            other => {
                return Err(value(format!(
                    "align is {other:?}, expected \"sim3\", \"se3\" or \"none\""
                )));
            }
        },
        max_difference_secs: max_difference,
        ..TrajectoryConfig::default()
    };
    let (estimate, truth) = (stamped(times, poses)?, stamped(true_times, true_poses)?);
    let evaluate = move || evaluation::evaluate_trajectory(&estimate, &truth, &config);
    let report = wait_for(py, evaluate)?;
    dictionary(py, &report.map_err(value)?)
}

/// Poses by time, from arrays of seconds and of 4x4 matrices.
fn stamped(times: &Bound<PyAny>, poses: &Bound<PyAny>) -> PyResult<Vec<StampedPose>> {
    let times = contiguous::<f64, Ix1>(times, "(n,)")?;
    let poses = contiguous::<f64, Ix3>(poses, "(n, 4, 4)")?;
    let n = times.len();
    if poses.shape() != [n, 4, 4] {
        let found = poses.shape();
        return Err(value(format!(
            "poses have the shape {found:?}, expected ({n}, 4, 4)"
        )));
    }
    let matrices = poses.as_slice()?.as_chunks::<4>().0.as_chunks::<4>().0;
    let each = times.as_slice()?.iter().zip(matrices);
    each.map(|(seconds, rows)| Ok(((seconds * 1e9).round() as i64, rigid(rows)?)))
        .collect()
}

/// ROC, AUC, MCC, calibration and distances under four rules for unknown cells, as `monogrid
/// evaluate map --json` prints them.
///
/// The truth has cells of the same size, or of a whole fraction of it. Keys: `policies` (each with
/// `roc`), `surface`, ...
#[pyfunction]
#[pyo3(signature = (estimate, truth, *, tolerance = None))]
pub fn evaluate_map<'py>(
    py: Python<'py>,
    estimate: PyRef<OccupancyMap>,
    truth: PyRef<OccupancyMap>,
    tolerance: Option<f64>,
) -> PyResult<Bound<'py, PyAny>> {
    let (estimate, truth) = (estimate.snapshot(py), truth.snapshot(py));
    let report = wait_for(py, move || {
        let truth = TruthGrid::from_map(&truth, MAX_TRUE_CELLS).map_err(value)?;
        let truth = truth.with_cells_of(&estimate).map_err(value)?;
        let config = MapEvaluationConfig {
            tolerance_m: tolerance,
            ..MapEvaluationConfig::default()
        };
        evaluation::evaluate_map(&estimate, &truth, &config).map_err(value)
    });
    dictionary(py, &report??)
}
