//! Batched rendering: images of many walls, or of one wall from many poses, in one call.

use crate::pool::on_pool;
use crate::render::channels::{ChannelArrays, refuse_partial};
use crate::render::frame::render_bands;
use crate::render::ray_table::RayTable;
use crate::render::scene::Scene;
use crate::render::tile::WallTiles;
use crate::render::view::View;
use crate::wall::Wall;
use crate::world::binding::busy;
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::{exceptions::PyValueError, prelude::*, types::PyDict};
use rayon::prelude::*;

/// Renders the views of cameras at poses [n 4 4] into the channels of `out`, a dictionary of
/// C-contiguous arrays of n images of the table's shape; direct light, no lumen contents.
///
/// One wall and one scene for all images, or one for each. Arrays are those of `render`, except
/// subsampled and planar ones.
///
/// # Errors
/// If the numbers of walls, scenes and poses or the shapes differ, or a pose is not finite.
#[pyfunction]
#[pyo3(signature = (walls, scenes, rays, poses, leds, out, *, exposure, shadows))]
#[allow(clippy::too_many_arguments)] // called from Python only
pub fn render_batch(
    py: Python<'_>,
    walls: Vec<Py<Wall>>,
    scenes: Vec<PyRef<'_, Scene>>,
    rays: &RayTable,
    poses: PyReadonlyArray3<'_, f64>,
    leds: PyReadonlyArray2<'_, f64>,
    out: &Bound<'_, PyDict>,
    exposure: f32,
    shadows: bool,
) -> PyResult<()> {
    let poses = poses.as_array();
    let count = poses.shape()[0];
    let fits = |given: usize| given == 1 || given == count;
    if !fits(walls.len()) || !fits(scenes.len()) || poses.shape()[1..] != [4, 4] {
        return Err(PyValueError::new_err(format!(
            "Images of {count} poses [n 4 4] need 1 or {count} walls and scenes, were given {} and \
             {}.",
            walls.len(),
            scenes.len()
        )));
    }
    for wall in &walls {
        if !wall.try_borrow(py).map_err(busy)?.has_normals {
            let mut wall = wall.try_borrow_mut(py).map_err(busy)?;
            let wall: &mut Wall = &mut wall;
            py.detach(|| wall.renew_normals());
        }
    }
    let walls: Vec<PyRef<'_, Wall>> =
        walls.iter().map(|wall| wall.try_borrow(py)).collect::<Result<_, _>>().map_err(busy)?;
    let mut views = Vec::with_capacity(count);
    for (number, pose) in poses.outer_iter().enumerate() {
        let wall: &Wall = &walls[number.min(walls.len() - 1)];
        let scene = &scenes[number.min(scenes.len() - 1)].data;
        scene.check_size(wall)?;
        views.push((wall, scene, View::new(wall, pose, leds.as_array(), exposure, shadows)?));
    }
    refuse_partial(out)?;
    let mut arrays = ChannelArrays::borrow(out, (count * rays.height, rays.width))?;
    let images = arrays.channels()?.images(rays.height * rays.width, count);
    on_pool(py, || {
        images.into_par_iter().with_max_len(1).zip(&views).for_each(|(channels, view)| {
            let tiles = WallTiles { wall: view.0, scene: view.1, view: &view.2 };
            render_bands(&tiles, tiles, rays, channels);
        });
    });
    Ok(())
}
