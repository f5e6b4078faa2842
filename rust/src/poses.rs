//! Rigid poses and vectors from the rows of NumPy arrays.

use glam::{DMat3, DVec3};
use numpy::PyReadonlyArray2;
use pyo3::{exceptions::PyValueError, prelude::*};

/// Numbers of an array of rows with a number of columns.
pub fn rows(array: &PyReadonlyArray2<'_, f64>, columns: usize) -> PyResult<Vec<f64>> {
    let view = array.as_array();
    if view.ncols() != columns {
        return Err(PyValueError::new_err(format!("Rows of {columns} numbers are needed.")));
    }
    Ok(view.iter().copied().collect())
}

/// Three rows of three numbers of an array [3 3].
pub fn three_rows(array: &PyReadonlyArray2<'_, f64>) -> PyResult<DMat3> {
    square(array, 3).map(|flat| DMat3::from_cols_slice(&flat))
}

/// Numbers of a square array.
pub fn square(array: &PyReadonlyArray2<'_, f64>, size: usize) -> PyResult<Vec<f64>> {
    if array.as_array().dim() != (size, size) {
        return Err(PyValueError::new_err(format!(
            "An array of shape ({size}, {size}) is needed."
        )));
    }
    rows(array, size)
}

/// Vector of the first three numbers.
pub fn vector(v: &[f64]) -> DVec3 {
    DVec3::new(v[0], v[1], v[2])
}

/// Rotation and position of a pose of four rows.
pub fn pose_of(m: &[f64]) -> (DMat3, DVec3) {
    let column = |k: usize| DVec3::new(m[k], m[4 + k], m[8 + k]);
    (DMat3::from_cols(column(0), column(1), column(2)), column(3))
}

/// Rotation and position of a pose [4 4].
pub fn read_pose(array: &PyReadonlyArray2<'_, f64>) -> PyResult<(DMat3, DVec3)> {
    Ok(pose_of(&square(array, 4)?))
}

/// Rows of a pose.
pub fn pose_rows(rotation: &DMat3, place: DVec3) -> [f64; 16] {
    let [x, y, z] = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
    let p = place;
    [x.x, y.x, z.x, p.x, x.y, y.y, z.y, p.y, x.z, y.z, z.z, p.z, 0.0, 0.0, 0.0, 1.0]
}
