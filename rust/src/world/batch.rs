//! Batches of worlds: parallel steps, and states as arrays.

use super::binding::{World, busy, table};
use super::parameters::{LOAD_ROW, load};
use super::substep::Load;
use super::time_stepping::Stepper;
use crate::pool::detached;
use crate::poses::{pose_of, rows};
use crate::tissue::fem::layer::FemLayer;
use crate::wall::Wall;
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Work of one thread: the step of one world.
struct Task<'a> {
    stepper: &'a mut Stepper,
    wall: &'a mut Wall,
    layer: Option<&'a mut FemLayer>,
    load: Load,
    /// Number of substeps and of steps of the layer.
    strides: (usize, usize),
}

/// Poses, motions, wrenches of the wall and remaining contact values, one row per world.
type States<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
);

/// Advances each world by `dt`, as `World.step` does, on all threads.
///
/// `loads` [n 10] are force [N], torque [N·m], gravity [m/s²] and damping [N·s/m]; `strides`
/// numbers of substeps and of steps of a layer; `lumen_scales` [2 k] as in `World.step`. Returns,
/// for each world, `None` or an error message; after an error the world is unchanged.
#[pyfunction]
pub fn step_worlds(
    py: Python<'_>,
    worlds: Vec<Bound<'_, World>>,
    dt: f64,
    loads: PyReadonlyArray2<'_, f64>,
    strides: Vec<(usize, usize)>,
    lumen_scales: Vec<Option<PyReadonlyArray2<'_, f64>>>,
) -> PyResult<Vec<Option<&'static str>>> {
    let loads = rows(&loads, LOAD_ROW)?;
    let counts = [loads.len() / LOAD_ROW, strides.len(), lumen_scales.len()];
    if counts != [worlds.len(); 3] || strides.iter().any(|&(n, m)| m == 0 || n % m != 0) {
        let what = "Each world needs a load, strides (n, a divisor of n), a lumen_scale.";
        return Err(PyValueError::new_err(what));
    }
    let mut held = borrowed(&worlds)?;
    let walls: Vec<Py<Wall>> = held.iter().map(|world| world.wall.clone_ref(py)).collect();
    let mut walls = held_by(py, &walls)?;
    let layers = held.iter().map(|world| world.layer.as_ref().map(|layer| layer.clone_ref(py)));
    let layers: Vec<Option<Py<FemLayer>>> = layers.collect();
    let layers = layers.iter().map(|layer| {
        layer.as_ref().map(|layer| layer.try_borrow_mut(py)).transpose().map_err(busy)
    });
    let mut layers = layers.collect::<PyResult<Vec<_>>>()?;
    for ((world, scales), &(count, _)) in held.iter_mut().zip(&lumen_scales).zip(&strides) {
        if let Some(scales) = scales {
            let count = count as f64;
            world.stepper.aim(scales.as_slice()?, dt / count * count)?;
        }
    }
    let parts = held.iter_mut().zip(&mut walls).zip(&mut layers).zip(&strides);
    let mut tasks: Vec<Task> = parts
        .zip(loads.chunks_exact(LOAD_ROW))
        .map(|((((world, wall), layer), &strides), row)| Task {
            stepper: &mut world.stepper,
            wall,
            layer: layer.as_deref_mut(),
            load: load(row),
            strides,
        })
        .collect();
    let step = |task: &mut Task| {
        let Task { stepper, wall, layer, load, strides } = task;
        stepper.run(wall, layer.as_deref_mut(), load, dt / strides.0 as f64, *strides).err()
    };
    Ok(detached(py, || tasks.par_iter_mut().with_max_len(1).map(step).collect()))
}

/// States of the worlds, with the patient at a row of `poses` [n 16]: the capsule's pose in the
/// world [n 16]; its velocity and angular velocity [n 6], and force and torque of the wall [n 6],
/// in the patient's frame; and the remaining numbers of `World.contact` [n 5].
#[pyfunction]
pub fn world_states<'py>(
    py: Python<'py>,
    worlds: Vec<PyRef<'py, World>>,
    poses: PyReadonlyArray2<'py, f64>,
) -> PyResult<States<'py>> {
    let poses = rows(&poses, 16)?;
    if poses.len() != 16 * worlds.len() {
        return Err(PyValueError::new_err("Each world needs a pose, a row of 16 numbers."));
    }
    let (mut places, mut motions, mut wrenches, mut rest) = (vec![], vec![], vec![], vec![]);
    for (world, pose) in worlds.iter().zip(poses.chunks_exact(16)) {
        let (motion, last) = (&world.stepper.motion, &world.stepper.last);
        places.extend(world.pose_at(pose_of(pose)));
        motions.extend([motion.velocity, motion.angular_velocity].map(|v| v.to_array()).concat());
        wrenches.extend([last.force, last.torque].map(|v| v.to_array()).concat());
        rest.extend([last.normal_force_total, last.friction_work]);
        rest.extend(last.patch);
    }
    Ok((table(py, places, 16), table(py, motions, 6), table(py, wrenches, 6), table(py, rest, 5)))
}

/// True for each capsule whose axis is in its lumen.
#[pyfunction]
pub fn worlds_inside(py: Python<'_>, worlds: Vec<Bound<'_, World>>) -> PyResult<Vec<bool>> {
    on_each(py, &worlds, |stepper, wall| stepper.is_inside_now(wall))
}

/// Refits the hierarchy of each wall to its current vertices, as `World.settle` does.
#[pyfunction]
pub fn settle_worlds(py: Python<'_>, worlds: Vec<Bound<'_, World>>) -> PyResult<()> {
    on_each(py, &worlds, |stepper, wall| stepper.soft.settle(wall)).map(|_| ())
}

/// Applies a function to each world and its wall, on all threads.
fn on_each<R: Send>(
    py: Python<'_>,
    worlds: &[Bound<'_, World>],
    work: impl Fn(&mut Stepper, &mut Wall) -> Result<R, &'static str> + Sync + Send,
) -> PyResult<Vec<R>> {
    let mut held = borrowed(worlds)?;
    let walls: Vec<Py<Wall>> = held.iter().map(|world| world.wall.clone_ref(py)).collect();
    let mut walls = held_by(py, &walls)?;
    let pairs = held.iter_mut().zip(&mut walls);
    let mut pairs: Vec<(&mut Stepper, &mut Wall)> =
        pairs.map(|(world, wall)| (&mut world.stepper, &mut **wall)).collect();
    let each = |(stepper, wall): &mut (&mut Stepper, &mut Wall)| work(stepper, wall);
    let done = detached(py, || pairs.par_iter_mut().with_max_len(1).map(each).collect());
    let done: Result<Vec<R>, &'static str> = done;
    done.map_err(PyValueError::new_err)
}

fn borrowed<'py>(worlds: &[Bound<'py, World>]) -> PyResult<Vec<PyRefMut<'py, World>>> {
    worlds.iter().map(|world| world.try_borrow_mut().map_err(busy)).collect()
}

fn held_by<'a>(py: Python<'a>, walls: &'a [Py<Wall>]) -> PyResult<Vec<PyRefMut<'a, Wall>>> {
    walls.iter().map(|wall| wall.try_borrow_mut(py).map_err(busy)).collect()
}
