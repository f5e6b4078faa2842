//! Python binding of a capsule in a wall.

use super::body::{Body, Motion};
use super::coupling_state::CouplingState;
use super::fem_coupling::FemCoupling;
use super::magnetic_coupling::{MagneticCoupling, Report, SOURCE_ROW};
use super::parameters::{
    BodyParameters, DragParameters, FoundationParameters, SpringWallParameters, laws,
};
use super::soft_wall::{Drive, SoftWall};
use super::solve::Twist;
use super::substep::Load;
use super::time_stepping::{Dynamics, StepTotals, Stepper};
use crate::magnet::field_sources::{FieldSources, internal_magnets};
use crate::pool::detached;
use crate::poses::{pose_rows, read_pose, rows};
use crate::tissue::fem::layer::FemLayer;
use crate::tissue::spring_wall::{SpringWall, VertexMotion};
use crate::wall::Wall;
use glam::{DMat3, DQuat, DVec3};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, ndarray, ndarray::Array2};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use rayon::prelude::*;

/// Position [m], quaternion wxyz, velocity [m/s] and angular velocity [rad/s] of the capsule.
type Pose = ([f64; 3], [f64; 4], [f64; 3], [f64; 3]);

/// Two tables of numbers.
type Tables<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// Motion, displaced vertices, active wall [m] and contact of the last step.
type Saved = (Motion, Vec<(u32, VertexMotion)>, Vec<DVec3>, StepTotals);

/// Capsule in a soft wall. Positions are relative to the wall's center, see `Wall.center`.
#[pyclass(module = "vrcaps._core")]
pub struct World {
    pub wall: Py<Wall>,
    /// Layer of finite elements under the wall.
    pub layer: Option<Py<FemLayer>>,
    /// Center of the wall, which is subtracted from every position [m].
    pub center: DVec3,
    pub stepper: Stepper,
    /// State that `undo` restores.
    saved: Option<Saved>,
}

#[pymethods]
impl World {
    /// Capsule in a wall at rest, at a pose; its motion has inertia unless `is_quasi_static`.
    #[new]
    #[pyo3(signature = (
        wall, body, foundation, drag, spring_wall, pose, is_quasi_static=false
    ))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        wall: Py<Wall>,
        body: BodyParameters<'_>,
        foundation: FoundationParameters,
        drag: DragParameters,
        spring_wall: Option<SpringWallParameters>,
        pose: Pose,
        is_quasi_static: bool,
    ) -> PyResult<Self> {
        let (soft, center) = {
            let wall = wall.try_borrow(py).map_err(busy)?;
            (SoftWall::new(&wall, spring_wall.is_some()), DVec3::from(wall.center))
        };
        let spring_wall = spring_wall.map(SpringWall::from);
        let body = Body::try_from(body)?;
        let dynamics = if is_quasi_static { Dynamics::QuasiStatic } else { Dynamics::Physics };
        let laws = laws(foundation, drag, body.radius, dynamics);
        let stepper = Stepper {
            dynamics,
            body,
            laws,
            spring_wall,
            coupling: None,
            magnets: None,
            motion: Motion::default(),
            soft,
            last: StepTotals::default(),
        };
        let mut world = World { wall, layer: None, center, stepper, saved: None };
        world.set_pose(pose)?;
        Ok(world)
    }

    /// Advances by `count` substeps of `dt`, with a wrench [N, N·m] and gravity [m/s²].
    ///
    /// `lumen_scale` [2 k] is the lumen's radius as a factor of that at rest, at the start and at
    /// the end; see `set_lumen_drive`. A layer makes `outer` steps, a divisor of `count`.
    #[pyo3(signature = (dt, count, wrench, gravity, lumen_scale=None, outer=1))]
    #[allow(clippy::too_many_arguments)]
    fn step(
        &mut self,
        py: Python<'_>,
        dt: f64,
        count: usize,
        wrench: [f64; 6],
        gravity: [f64; 3],
        lumen_scale: Option<PyReadonlyArray2<'_, f64>>,
        outer: usize,
    ) -> PyResult<()> {
        if outer == 0 || !count.is_multiple_of(outer) {
            return Err(PyValueError::new_err("The count must be a multiple of outer."));
        }
        let (wrench, gravity) = (Twist::from_array(wrench), DVec3::from(gravity));
        let load = Load { wrench, gravity, damping: 0.0 };
        if let Some(lumen_scale) = lumen_scale {
            self.stepper.aim(lumen_scale.as_slice()?, dt * count as f64)?;
        }
        let wall = self.wall.clone_ref(py);
        let mut wall = wall.try_borrow_mut(py).map_err(busy)?;
        let wall: &mut Wall = &mut wall;
        let layer = self.layer.as_ref().map(|layer| layer.clone_ref(py));
        let mut layer =
            layer.as_ref().map(|layer| layer.try_borrow_mut(py)).transpose().map_err(busy)?;
        let layer: Option<&mut FemLayer> = layer.as_deref_mut();
        detached(py, || self.stepper.run(wall, layer, &load, dt, (count, outer)))
            .map_err(PyValueError::new_err)
    }

    /// Attaches a layer of finite elements to the wall, solved to `tolerance` [m].
    fn set_layer(&mut self, py: Python<'_>, layer: Py<FemLayer>, tolerance: f64) -> PyResult<()> {
        if self.stepper.dynamics == Dynamics::QuasiStatic {
            return Err(PyValueError::new_err(
                "A layer has inertia: it takes no quasi-static world.",
            ));
        }
        let now = layer.try_borrow(py).map_err(busy)?;
        let coupling = FemCoupling::new(&now, tolerance);
        drop(now);
        self.stepper.coupling = Some(coupling);
        self.layer = Some(layer);
        Ok(())
    }

    /// Couples sources to magnets [k 6] (position, moment) in the capsule; call `aim_sources` next.
    fn set_magnets(
        &mut self,
        sources: PyRef<'_, FieldSources>,
        magnets: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        self.stepper.magnets =
            Some(MagneticCoupling::new(sources.sources.clone(), internal_magnets(&magnets)?));
        Ok(())
    }

    /// Moves the sources during the next `duration` [s] from rows [k 8] to rows: position,
    /// quaternion wxyz and strength in the world, with the wall at a pose [4 4].
    fn aim_sources(
        &mut self,
        begin: PyReadonlyArray2<'_, f64>,
        end: PyReadonlyArray2<'_, f64>,
        duration: f64,
        pose: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let (begin, end) = (rows(&begin, SOURCE_ROW)?, rows(&end, SOURCE_ROW)?);
        let (rotation, position) = read_pose(&pose)?;
        let magnets = self.stepper.magnets.as_mut().filter(|magnets| {
            begin.len() == end.len() && begin.len() == SOURCE_ROW * magnets.count()
        });
        let magnets = magnets.ok_or_else(|| PyValueError::new_err("Each source needs a row."))?;
        let pose = (rotation, position + rotation * self.center);
        magnets.aim((&begin, &end), duration, pose, &self.stepper.motion);
        Ok(())
    }

    /// Effect of the sources since `aim_sources`, and their field for a capsule at a pose [4 4].
    fn magnetic_coupling(&mut self, pose: PyReadonlyArray2<'_, f64>) -> PyResult<Option<Report>> {
        let Some(magnets) = self.stepper.magnets.as_mut() else { return Ok(None) };
        magnets.finish();
        Ok(Some(magnets.report(read_pose(&pose)?)))
    }

    /// State of the coupling with the layer: force [N], offset of the felt wall [m] and deferred
    /// momentum [N·s] of each node, [nodes 9]; index, normal force [N] and friction [N] of
    /// triangles in contact, [k 5]. `None` without a layer.
    #[getter]
    fn coupling_state<'py>(&self, py: Python<'py>) -> Option<Tables<'py>> {
        let coupling = self.stepper.coupling.as_ref()?;
        let (nodes, touched) = coupling.state.to_rows();
        Some((table(py, nodes, 9), table(py, touched, 5)))
    }

    #[setter]
    fn set_coupling_state(
        &mut self,
        rows: Option<(PyReadonlyArray2<'_, f64>, PyReadonlyArray2<'_, f64>)>,
    ) -> PyResult<()> {
        if let (Some(coupling), Some((nodes, touched))) = (self.stepper.coupling.as_mut(), rows) {
            let count = coupling.state.force.len();
            if nodes.as_array().dim() != (count, 9) || touched.as_array().ncols() != 5 {
                return Err(PyValueError::new_err(format!(
                    "The state of the coupling has {count} rows of 9 numbers, and rows of 5."
                )));
            }
            coupling.state = CouplingState::from_rows(nodes.as_slice()?, touched.as_slice()?);
        }
        Ok(())
    }

    /// Sets the radial motion of the lumen: `inward` [n 3] from each vertex at rest to the
    /// centerline, `sample` [n] its index along the samples of the `lumen_scale` that `step` takes.
    fn set_lumen_drive(
        &mut self,
        inward: PyReadonlyArray2<'_, f64>,
        sample: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        let (rows, sample) = (inward.as_array(), sample.as_slice()?);
        if rows.dim() != (self.stepper.soft.active_wall.len(), 3)
            || sample.len() != self.stepper.soft.active_wall.len()
        {
            return Err(PyValueError::new_err("The drive of the lumen needs a row per vertex."));
        }
        let inward = rows.outer_iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect();
        self.stepper.soft.drive =
            Some(Drive::new(self.stepper.soft.active_wall.clone(), inward, sample));
        Ok(())
    }

    /// Saves all state except a layer and its coupling, for `undo`.
    fn save(&mut self) {
        let Stepper { motion, soft, last, .. } = &self.stepper;
        let mut active_wall = self.saved.take().map_or_else(Vec::new, |saved| saved.2);
        active_wall.clone_from(&soft.active_wall);
        self.saved = Some((*motion, soft.awake_displacements(), active_wall, *last));
    }

    /// Restores the last saved state.
    fn undo(&mut self) {
        if let Some((motion, wall_displacement, active_wall, last)) = self.saved.take() {
            (self.stepper.motion, self.stepper.last) = (motion, last);
            self.stepper.soft.restore_displacements(wall_displacement);
            self.stepper.soft.set_active_wall(active_wall);
            self.stepper.soft.stay();
        }
    }

    /// Refits the hierarchy to the current wall, for rendering and queries, if it may be off by
    /// more than a tolerance [m].
    #[pyo3(signature = (tolerance=0.0))]
    fn settle(&mut self, py: Python<'_>, tolerance: f64) -> PyResult<()> {
        if self.stepper.soft.wall_travel <= tolerance {
            return Ok(());
        }
        let wall = self.wall.clone_ref(py);
        let mut wall = wall.try_borrow_mut(py).map_err(busy)?;
        let wall: &mut Wall = &mut wall;
        detached(py, || self.stepper.soft.settle(wall)).map_err(PyValueError::new_err)
    }

    /// Center of mass [m], unit quaternion wxyz, velocity and angular velocity.
    #[getter]
    fn pose(&self) -> Pose {
        let m = &self.stepper.motion;
        let q = m.rotation;
        (
            m.position.to_array(),
            [q.w, q.x, q.y, q.z],
            m.velocity.to_array(),
            m.angular_velocity.to_array(),
        )
    }

    /// Pose [4 4] of the capsule in the world, with the wall at a pose [4 4].
    fn pose_in<'py>(
        &self,
        py: Python<'py>,
        wall: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        Ok(table(py, self.pose_at(read_pose(&wall)?).to_vec(), 4))
    }

    #[setter]
    fn set_pose(&mut self, pose: Pose) -> PyResult<()> {
        let (position, [w, x, y, z], velocity, angular_velocity) = pose;
        let numbers = [&position[..], &[w, x, y, z], &velocity, &angular_velocity].concat();
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err(PyValueError::new_err("A capsule's pose and motion must be finite."));
        }
        self.stepper.motion = Motion {
            position: DVec3::from(position),
            rotation: DQuat::from_xyzw(x, y, z, w),
            velocity: DVec3::from(velocity),
            angular_velocity: DVec3::from(angular_velocity),
        };
        self.stepper.soft.travel = f64::INFINITY;
        Ok(())
    }

    /// Displacement [m] and velocity [m/s] of each vertex, [n 6].
    #[getter]
    fn wall_displacement<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let rows = self.stepper.soft.wall_displacement.iter();
        let flat =
            rows.flat_map(|y| Twist { linear: y.displacement, angular: y.velocity }.to_array());
        table(py, flat.collect(), 6)
    }

    #[setter]
    fn set_wall_displacement(
        &mut self,
        wall_displacement: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let rows = wall_displacement.as_array();
        if rows.dim() != (self.stepper.soft.wall_displacement.len(), 6) {
            return Err(PyValueError::new_err(
                "The displacement of the wall needs six numbers for each vertex.",
            ));
        }
        self.stepper.soft.wall_displacement = rows
            .outer_iter()
            .map(|r| VertexMotion {
                displacement: DVec3::new(r[0], r[1], r[2]),
                velocity: DVec3::new(r[3], r[4], r[5]),
            })
            .collect();
        let awake = (0..)
            .zip(&self.stepper.soft.wall_displacement)
            .filter(|(_, y)| **y != VertexMotion::default());
        let is_spring_wall = self.stepper.spring_wall.is_some();
        self.stepper.soft.awake = awake.filter(|_| is_spring_wall).map(|(v, _)| v).collect();
        self.stepper.soft.forget_near();
        Ok(())
    }

    /// Positions of the wall without contact [m], [n 3].
    #[getter]
    fn active_wall<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let flat = self.stepper.soft.active_wall.iter().flat_map(|p| p.to_array());
        table(py, flat.collect(), 3)
    }

    #[setter]
    fn set_active_wall(&mut self, active_wall: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = active_wall.as_array();
        if rows.dim() != (self.stepper.soft.active_wall.len(), 3) {
            return Err(PyValueError::new_err("The active wall needs a row for each vertex."));
        }
        let place = |r: ndarray::ArrayView1<f64>| DVec3::new(r[0], r[1], r[2]);
        self.stepper.soft.set_active_wall(rows.outer_iter().map(place).collect());
        Ok(())
    }

    /// Current vertices of the wall [n 3], transformed from the wall's frame by `transform` [4 4].
    fn vertices<'py>(
        &self,
        py: Python<'py>,
        transform: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let t = transform.as_array();
        if t.dim() != (4, 4) {
            return Err(PyValueError::new_err("A transform needs four rows and four columns."));
        }
        let [x, y, z, origin] = [0, 1, 2, 3].map(|k| DVec3::new(t[[0, k]], t[[1, k]], t[[2, k]]));
        let mut flat = vec![0.0; 3 * self.stepper.soft.active_wall.len()];
        detached(py, || {
            let rows = flat.par_chunks_exact_mut(3).with_min_len(4096).enumerate();
            rows.for_each(|(v, row)| {
                let p = self.stepper.soft.vertex(v as u32).0 + self.center;
                (x * p.x + y * p.y + z * p.z + origin).write_to_slice(row);
            });
        });
        Ok(table(py, flat, 3))
    }

    /// Mean force [N] and torque [N·m] of the wall on the capsule over the last step, mean sum of
    /// normal forces [N], energy lost to friction [J]; then stored energy [J], contact area [m²]
    /// and maximum depth [m] at its end.
    fn contact(&self) -> ([f64; 3], [f64; 3], f64, f64, f64, f64, f64) {
        let StepTotals { force, torque, normal_force_total, friction_work, patch } =
            self.stepper.last;
        let [energy, area, depth] = patch;
        let wrench = (force.to_array(), torque.to_array());
        (wrench.0, wrench.1, normal_force_total, friction_work, energy, area, depth)
    }

    /// Sets the result of `contact`, its numbers in a row.
    fn set_contact(&mut self, row: [f64; 11]) {
        self.stepper.last = StepTotals {
            force: DVec3::from_slice(&row),
            torque: DVec3::from_slice(&row[3..]),
            normal_force_total: row[6],
            friction_work: row[7],
            patch: [row[8], row[9], row[10]],
        };
    }

    /// Points [m] and forces [N] of the capsule's contact with a spring wall, [n 6].
    fn contact_forces<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let rows = self.stepper.soft.contact_forces.iter();
        let flat = rows.flat_map(|p| Twist { linear: p.center, angular: p.force }.to_array());
        table(py, flat.collect(), 6)
    }

    /// Maximum depth [m] of the capsule in the wall at the current pose.
    fn penetration_depth(&mut self, py: Python<'_>) -> PyResult<f64> {
        let wall = self.wall.clone_ref(py);
        let mut wall = wall.try_borrow_mut(py).map_err(busy)?;
        let stepper = &mut self.stepper;
        stepper.soft.travel = f64::INFINITY; // forces a new search
        stepper.touch(&mut wall, &mut None).map_err(PyValueError::new_err)?;
        stepper.last.patch = stepper.soft.patch.extent();
        Ok(stepper.soft.patch.depth)
    }

    /// Kinetic energy of the capsule [J].
    fn kinetic_energy(&self) -> f64 {
        self.stepper.body.kinetic_energy(&self.stepper.motion)
    }

    /// Resistance [N] of the published and continuous laws at a speed [m/s].
    fn resistance(&self, speed: f64) -> f64 {
        self.stepper.laws.drag.resistance(speed)
    }

    /// True if the capsule's axis is in the lumen.
    fn inside(&mut self, py: Python<'_>) -> PyResult<bool> {
        let wall = self.wall.clone_ref(py);
        let mut wall = wall.try_borrow_mut(py).map_err(busy)?;
        self.stepper.is_inside_now(&mut wall).map_err(PyValueError::new_err)
    }
}

impl World {
    /// Pose of the capsule in the world by rows, with the wall at a pose.
    pub fn pose_at(&self, (rotation, position): (DMat3, DVec3)) -> [f64; 16] {
        let turn = rotation * DMat3::from_quat(self.stepper.motion.rotation);
        let place = rotation * (self.stepper.motion.position + self.center) + position;
        pose_rows(&turn, place)
    }
}

/// Error for a wall that another thread is using.
pub fn busy<E>(_: E) -> PyErr {
    PyRuntimeError::new_err(
        "The wall is in use by another thread. Each world needs a wall and layer for itself.",
    )
}

pub fn table(py: Python<'_>, flat: Vec<f64>, columns: usize) -> Bound<'_, PyArray2<f64>> {
    let rows = flat.len() / columns;
    Array2::from_shape_vec((rows, columns), flat).expect("whole rows").into_pyarray(py)
}
