//! Distances to many walls along given directions, in one call.

use crate::pool::on_pool;
use crate::wall::Wall;
use crate::wall::packet::MISS;
use crate::wall::ray::{Pile, cast_in};
use glam::DVec3;
use numpy::{
    IntoPyArray, PyArray2, PyReadonlyArray2, PyReadonlyArray3,
    ndarray::{Array2, ArrayView1},
};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Distance [m] [n k] from points [n 3], one in each of `walls`, to the wall along directions [n k
/// 3] of any length; `reach` if there is no nearer hit.
///
/// # Errors
/// If the numbers of walls, points and directions differ, a value is not finite, or a direction is
/// zero.
#[pyfunction]
pub fn wall_distances<'py>(
    py: Python<'py>,
    walls: Vec<PyRef<'py, Wall>>,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray3<'py, f64>,
    reach: f32,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let (places, ways) = (origins.as_array(), directions.as_array());
    let (count, num_rays, axes) = ways.dim();
    if axes != 3 || places.dim() != (count, 3) || walls.len() != count {
        return Err(PyValueError::new_err(
            "Distances need a position [3] and directions [k 3] for each wall.",
        ));
    }
    let vector = |row: ArrayView1<'_, f64>| DVec3::new(row[0], row[1], row[2]);
    let rays: Vec<_> = ways.rows().into_iter().map(|way| vector(way).normalize_or_zero()).collect();
    let is_finite = places.iter().all(|x| x.is_finite()) && reach.is_finite();
    if !is_finite || !rays.iter().all(|ray| ray.is_finite() && *ray != DVec3::ZERO) {
        return Err(PyValueError::new_err("Points and directions must be finite, and not zero."));
    }
    let walls: Vec<&Wall> = walls.iter().map(|wall| &**wall).collect();
    let places: Vec<_> = places.rows().into_iter().map(|row| vector(row).to_array()).collect();
    let mut found = vec![reach; count * num_rays];
    on_pool(py, || {
        let parts = (found.par_chunks_mut(num_rays.max(1)), rays.par_chunks(num_rays.max(1)));
        let parts = parts.into_par_iter().zip((&walls, &places)).with_max_len(1);
        parts.for_each(|((found, rays), (wall, place))| {
            let (mut pile, origin) = (Pile::default(), wall.localize(*place));
            for (distance, ray) in found.iter_mut().zip(rays) {
                let ray = (origin, ray.as_vec3().to_array());
                if let Some(hit) = cast_in::<false>(&mut pile, &wall.bvh, ray, reach, MISS) {
                    *distance = hit.distance;
                }
            }
        });
    });
    Ok(Array2::from_shape_vec((count, num_rays), found).expect("one per ray").into_pyarray(py))
}
