//! Triangles of a folded surface that are turned over (`vrcaps.mesh.untangle`).

use glam::DVec3;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Indices of the triangles that are turned by more than 90° from the mean normal, weighted by area,
/// of the triangles at one of their vertices; `vertices` are positions [n 3], `faces` indices [m 3].
///
/// # Errors
/// If arrays have another shape, or a vertex does not exist.
#[pyfunction]
pub fn turned_triangles<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, i64>,
) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let (vertices, faces) = (vertices.as_array(), faces.as_array());
    if vertices.ncols() != 3 || faces.ncols() != 3 {
        return Err(PyValueError::new_err("expected vertices (n, 3) and faces (m, 3)"));
    }
    let points: Vec<DVec3> =
        vertices.rows().into_iter().map(|row| DVec3::new(row[0], row[1], row[2])).collect();
    let mut corners = Vec::with_capacity(faces.nrows());
    for face in faces.rows() {
        let face = [0, 1, 2].map(|k| usize::try_from(face[k]).unwrap_or(usize::MAX));
        if face.iter().any(|&vertex| vertex >= points.len()) {
            return Err(PyValueError::new_err("a vertex does not exist"));
        }
        corners.push(face);
    }
    let normal = |&[a, b, c]: &[usize; 3]| (points[b] - points[a]).cross(points[c] - points[a]);
    let normals: Vec<DVec3> = corners.iter().map(normal).collect();
    let mut sums = vec![DVec3::ZERO; points.len()];
    for (face, &normal) in corners.iter().zip(&normals) {
        face.iter().for_each(|&vertex| sums[vertex] += normal);
    }
    let is_turned = |face: usize| corners[face].iter().any(|&v| normals[face].dot(sums[v]) < 0.0);
    let turned = (0..corners.len()).filter(|&face| is_turned(face)).map(|face| face as i64);
    Ok(turned.collect::<Vec<_>>().into_pyarray(py))
}
