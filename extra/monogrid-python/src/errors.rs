//! Errors of the library as exceptions of Python.

use monogrid::PipelineError;
use monogrid::occupancy::MapError;
use pyo3::PyErr;
use pyo3::exceptions::{PyMemoryError, PyOSError, PyRuntimeError, PyTypeError, PyValueError};
use std::fmt::Display;

/// Bad input.
pub fn value(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Input of a type that cannot be meant.
pub fn type_of(error: impl Display) -> PyErr {
    PyTypeError::new_err(error.to_string())
}

/// What a map cannot do.
pub fn of_map(error: MapError) -> PyErr {
    let text = error.to_string();
    match error {
        MapError::Io { .. } | MapError::File { .. } => PyOSError::new_err(text),
        MapError::MemoryBudget { .. } | MapError::TooFine { .. } => PyMemoryError::new_err(text),
        _ => PyValueError::new_err(text),
    }
}

/// What a running system cannot do.
pub fn of_pipeline(error: PipelineError) -> PyErr {
    match error {
        PipelineError::Settings(_) => value(error),
        PipelineError::Map(error) => of_map(error),
        error => PyRuntimeError::new_err(error.to_string()),
    }
}
