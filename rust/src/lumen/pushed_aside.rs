//! Displacement of spheres by a capsule.

use crate::poses::read_pose;
use crate::world::body::Axis;
use glam::DVec3;
use numpy::{
    IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2,
    ndarray::{Array2, ArrayView1},
};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Centers [n 3] of spheres around a capsule [m]: those inside it are moved straight off its axis,
/// the last ones to their `dome_sites` [k 3] in its frame. None if nothing has moved.
///
/// `pose` maps the capsule's frame, with the origin at its center and z along its axis, to that of
/// the centers; `capsule` is half of its straight length and its radius.
#[pyfunction]
pub fn around_capsule<'py>(
    py: Python<'py>,
    centers: PyReadonlyArray2<'py, f64>,
    radius: PyReadonlyArray1<'py, f64>,
    dome_sites: PyReadonlyArray2<'py, f64>,
    pose: PyReadonlyArray2<'py, f64>,
    capsule: (f64, f64),
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
    let (centers, radius) = (centers.as_array(), radius.as_array());
    let dome_sites = dome_sites.as_array();
    let count = centers.nrows();
    let fits = centers.ncols() == 3 && dome_sites.ncols() == 3 && pose.as_array().dim() == (4, 4);
    if !fits || radius.len() != count || dome_sites.nrows() > count {
        return Err(PyValueError::new_err("Spheres need a center and a radius each, and sites."));
    }
    let (rotation, middle) = read_pose(&pose)?;
    let half = rotation.z_axis * capsule.0;
    let axis = Axis::new(middle - half, 2.0 * half);
    let row = |row: ArrayView1<'_, f64>| DVec3::new(row[0], row[1], row[2]);
    let mut moved: Option<Array2<f64>> = None;
    let mut put = |k: usize, place: DVec3| {
        let all = moved.get_or_insert_with(|| centers.to_owned());
        for (axis, x) in place.to_array().into_iter().enumerate() {
            all[[k, axis]] = x;
        }
    };
    let free = count - dome_sites.nrows();
    for (k, center) in centers.outer_iter().take(free).map(row).enumerate() {
        if let Some(place) = pushed(center, &axis, capsule.1 + radius[k]) {
            put(k, place);
        }
    }
    for (k, site) in dome_sites.outer_iter().map(row).enumerate() {
        put(free + k, rotation * site + middle);
    }
    Ok(moved.map(|all| all.into_pyarray(py)))
}

/// New center of a sphere that is nearer to a capsule's axis than `need` [m].
fn pushed(center: DVec3, axis: &Axis, need: f64) -> Option<DVec3> {
    let away = center - axis.nearest(center);
    let distance = away.length();
    (distance < need).then(|| center + away * ((need - distance) / distance.max(1e-12)))
}
