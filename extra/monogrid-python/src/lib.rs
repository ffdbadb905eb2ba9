//! The Python package `monogrid`: numpy arrays in and out, errors as exceptions with the texts of
//! the library.
//!
//! Arrays are read where they lie if they are contiguous and of the type that is asked for, and
//! copied once otherwise. Python's lock is released while something is computed.

mod arrays;
mod errors;
mod evaluation;
mod inertial;
mod interrupt;
mod map;
mod slam;

use pyo3::prelude::*;
use std::ffi::OsString;

/// Does what a command line asks for, the name of the program first; the exit code. Takes the whole
/// process.
#[pyfunction]
fn main(py: Python, arguments: Vec<OsString>) -> u8 {
    py.detach(|| monogrid_cli::program::main(arguments))
}

#[pymodule]
fn _monogrid(module: &Bound<PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<map::OccupancyMap>()?;
    module.add_class::<map::DistanceField>()?;
    module.add_class::<slam::Camera>()?;
    module.add_class::<inertial::Imu>()?;
    module.add_class::<slam::Slam>()?;
    module.add_class::<slam::Frame>()?;
    module.add_class::<slam::SlamResult>()?;
    module.add_function(wrap_pyfunction!(evaluation::evaluate_trajectory, module)?)?;
    module.add_function(wrap_pyfunction!(evaluation::evaluate_map, module)?)?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    Ok(())
}
