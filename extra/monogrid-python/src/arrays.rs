//! Arrays of numpy as slices of Rust, without a copy where they are contiguous.

use crate::errors::{type_of, value};
use monogrid::geometry::{Rotation, Se3, Sim3, Vec3, nalgebra};
use numpy::ndarray::Dimension;
use numpy::{Element, IntoPyArray, PyArray, PyArray2, PyArray3, PyArrayMethods};
use numpy::{PyReadonlyArray, PyUntypedArrayMethods, dtype};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyTuple};

/// What the numbers of an array are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Of any width.
    Float,
    /// With or without a sign.
    Integer,
    /// True or false.
    Bool,
    /// Complex numbers, text, times, objects.
    Other,
}

/// What the numbers of an array-like are.
pub fn kind_of(array_like: &Bound<PyAny>) -> PyResult<Kind> {
    let numpy = array_like.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (array_like,))?;
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    Ok(match kind.as_str() {
        "f" => Kind::Float,
        "i" | "u" => Kind::Integer,
        "b" => Kind::Bool,
        _ => Kind::Other,
    })
}

/// What Python calls an array-like: contiguous and of this type and dimension, copied only if it is
/// not so yet.
pub fn contiguous<'py, T: Element, D: Dimension>(
    array_like: &Bound<'py, PyAny>,
    expected: &str,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let py = array_like.py();
    let kind = kind_of(array_like)?;
    if !matches!(kind, Kind::Float | Kind::Integer | Kind::Bool) {
        let found = array_like
            .py()
            .import("numpy")?
            .call_method1("asarray", (array_like,))?;
        return Err(type_of(format!(
            "found an array of {}, expected real numbers of shape {expected}",
            found.getattr("dtype")?
        )));
    }
    let keywords = [("dtype", dtype::<T>(py))].into_py_dict(py)?;
    let array =
        py.import("numpy")?
            .call_method("ascontiguousarray", (array_like,), Some(&keywords))?;
    let found = array.getattr("shape")?;
    let other = |_| {
        value(format!(
            "found an array of shape {found}, expected {expected}"
        ))
    };
    let array = array.cast_into::<PyArray<T, D>>().map_err(other)?;
    Ok(array.try_readonly()?)
}

/// The rows of an array of shape (n, 3).
pub fn rows<'a, T: Element>(
    array: &'a PyReadonlyArray<T, numpy::Ix2>,
    name: &str,
) -> PyResult<&'a [[T; 3]]> {
    let (n, columns) = (array.shape()[0], array.shape()[1]);
    if columns != 3 {
        return Err(value(format!(
            "{name} has the shape ({n}, {columns}), expected (n, 3)"
        )));
    }
    Ok(array.as_slice()?.as_chunks().0)
}

/// A 4x4 matrix `a_from_b`, or nothing for the identity.
pub fn pose_of(matrix: Option<&Bound<PyAny>>) -> PyResult<[[f64; 4]; 4]> {
    let Some(matrix) = matrix else {
        return Ok(std::array::from_fn(|i| {
            std::array::from_fn(|j| f64::from(u8::from(i == j)))
        }));
    };
    let array = contiguous::<f64, numpy::Ix2>(matrix, "(4, 4)")?;
    if array.shape() != [4, 4] {
        return Err(value(format!(
            "a pose of shape {:?}, expected (4, 4)",
            array.shape()
        )));
    }
    let numbers = array.as_slice()?;
    if let Some(bad) = numbers.iter().find(|number| !number.is_finite()) {
        return Err(value(format!(
            "a pose holds {bad}, expected finite numbers"
        )));
    }
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| numbers[4 * i + j]));
    let is_rigid_row = rows[3] == [0.0, 0.0, 0.0, 1.0];
    if !is_rigid_row {
        return Err(value(format!(
            "the last row of a pose is {:?}, expected [0, 0, 0, 1]",
            rows[3]
        )));
    }
    Ok(rows)
}

/// A rigid motion of a 4x4 matrix.
pub fn rigid(rows: &[[f64; 4]; 4]) -> PyResult<Se3> {
    let matrix = nalgebra::Matrix3::from_fn(|i, j| rows[i][j]);
    let off = (matrix * matrix.transpose() - nalgebra::Matrix3::identity()).norm();
    // negated so that NaN is refused too
    if !(off < 1e-3 && matrix.determinant() > 0.0) {
        return Err(value("the left upper 3x3 of a pose is not a rotation"));
    }
    let translation = Vec3::new(rows[0][3], rows[1][3], rows[2][3]);
    Ok(Se3::new(Rotation::from_matrix(&matrix), translation))
}

/// The 4x4 matrix of a rigid motion, row by row.
pub fn matrix(motion: &Se3) -> [f64; 16] {
    let (r, t) = (motion.rotation_matrix(), &motion.translation);
    std::array::from_fn(|k| match (k / 4, k % 4) {
        (3, j) => f64::from(u8::from(j == 3)),
        (i, 3) => t[i],
        (i, j) => r[(i, j)],
    })
}

/// The 4x4 matrix of a similarity, row by row: rotation times scale, and translation.
pub fn similarity(motion: &Sim3) -> [f64; 16] {
    let mut rows = matrix(&motion.to_se3());
    for row in rows[..12].as_chunks_mut::<4>().0 {
        row[..3].iter_mut().for_each(|v| *v *= motion.scale);
    }
    rows
}

/// Triples as an array of shape (n, 3), which takes them over.
pub fn triples<T: Element + Copy>(
    py: Python<'_>,
    values: Vec<[T; 3]>,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let n = values.len();
    values.into_flattened().into_pyarray(py).reshape([n, 3])
}

/// A matrix as an array of shape (4, 4).
pub fn square<'py>(py: Python<'py>, matrix: &[f64; 16]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    matrix.to_vec().into_pyarray(py).reshape([4, 4])
}

/// Matrices as an array of shape (n, 4, 4).
pub fn matrices(py: Python<'_>, poses: Vec<[f64; 16]>) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let n = poses.len();
    poses.into_flattened().into_pyarray(py).reshape([n, 4, 4])
}

/// A dictionary of what `serde` can write.
pub fn dictionary<'py>(
    py: Python<'py>,
    report: &impl serde::Serialize,
) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(report).map_err(value)?;
    py.import("json")?
        .call_method1("loads", PyTuple::new(py, [text])?)
}
