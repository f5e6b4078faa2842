//! Rotation vectors of one body at a time.

use crate::poses::three_rows;
use glam::{DMat3, DVec3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2, ndarray::arr2};
use pyo3::prelude::*;

/// Cosine below which a rotation is so near to a half turn that its sine does not define an axis.
const NEAR_HALF: f64 = -0.99;
/// Sine below which an axis is undefined.
const PARALLEL: f64 = 1e-9;

/// Rotation followed by a rotation vector [rad] in the same frame.
///
/// Rodrigues' formula; a step of Newton's iteration keeps the result orthonormal.
pub fn rotate(vector: DVec3, rotation: DMat3) -> DMat3 {
    let angle = vector.length();
    if angle == 0.0 {
        return rotation;
    }
    let product = DMat3::from_axis_angle(vector / angle, angle) * rotation;
    1.5 * product - 0.5 * (product * product.transpose() * product)
}

/// Axis times angle [rad] of a rotation, 0 to π.
pub fn rotation_vector(rotation: DMat3) -> DVec3 {
    let [x, y, z] = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
    let across = DVec3::new(y.z - z.y, z.x - x.z, x.y - y.x);
    let (sine, cosine) = (0.5 * across.length(), 0.5 * (x.x + y.y + z.z - 1.0));
    let angle = sine.atan2(cosine);
    if cosine < NEAR_HALF {
        // R + Rᵀ = 2 c 1 + 2 (1 − c) a aᵀ: the longest column is along the axis.
        let square = rotation + rotation.transpose() - 2.0 * cosine * DMat3::IDENTITY;
        let sizes = DVec3::new(square.x_axis.x, square.y_axis.y, square.z_axis.z);
        let axis = square.col(sizes.max_position()).normalize();
        return if axis.dot(across) < 0.0 { -angle * axis } else { angle * axis };
    }
    across * if sine > 0.0 { 0.5 * angle / sine } else { 0.5 }
}

/// Direction rotated towards another by at most `most` [rad]; about `about` if they are opposite.
pub fn towards(start: DVec3, end: DVec3, most: f64, about: DVec3) -> DVec3 {
    let axis = start.cross(end);
    let sine = axis.length();
    if sine.atan2(start.dot(end)) <= most {
        return end;
    }
    let unit = if sine > PARALLEL { axis / sine } else { about };
    (DMat3::from_axis_angle(unit, most) * start).normalize()
}

fn rotation(rows_of: &PyReadonlyArray2<'_, f64>) -> PyResult<DMat3> {
    three_rows(rows_of).map(|rows| rows.transpose())
}

/// Result of `rotate` for a rotation vector [rad] and a rotation [3 3].
#[pyfunction]
pub fn rotate_by_vector<'py>(
    py: Python<'py>,
    vector: [f64; 3],
    matrix: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = rotate(vector.into(), rotation(&matrix)?).transpose().to_cols_array_2d();
    Ok(PyArray2::from_owned_array(py, arr2(&rows)))
}

/// Result of `rotation_vector` for a rotation [3 3].
#[pyfunction]
#[pyo3(name = "rotation_vector")]
pub fn rotation_vector_rows<'py>(
    py: Python<'py>,
    matrix: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let vector = rotation_vector(rotation(&matrix)?).to_array();
    Ok(PyArray1::from_slice(py, &vector))
}
