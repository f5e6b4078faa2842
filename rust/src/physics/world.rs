//! A capsule in a wall: what Python holds and steps.

use super::body::{Body, Motion};
use super::exchange::Exchange;
use super::held::Held;
use super::magnets::{Magnets, Report, SOURCE_ROW};
use super::march::Tally;
use super::parameters::{
    BodyParameters, DragParameters, MaterialParameters, QuickParameters, laws,
};
use super::quick::{Quick, Yield};
use super::soft_wall::{Drive, SoftWall};
use super::solve::Twist;
use super::step::{Laws, Load, press};
use crate::fem::layer::FemLayer;
use crate::magnet::field_sources::{FieldSources, internal_magnets};
use crate::poses::{pose_rows, read_pose, rows};
use crate::wall::Wall;
use glam::{DMat3, DQuat, DVec3};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, ndarray, ndarray::Array2};
use pyo3::{exceptions::PyValueError, prelude::*};
use rayon::prelude::*;

/// Position [m], quaternion wxyz, velocity [m/s] and angular velocity [rad/s] of the capsule.
type Pose = ([f64; 3], [f64; 4], [f64; 3], [f64; 3]);

/// Two tables of numbers.
type Tables<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// Motion, the vertices that give way, the driven wall [m].
type Saved = (Motion, Vec<(u32, Yield)>, Vec<DVec3>);

/// A capsule in a soft wall. Positions are about the wall's centre, see `Wall.center`.
#[pyclass(module = "vrcaps._core")]
pub struct World {
    pub(super) wall: Py<Wall>,
    pub(super) body: Body,
    pub(super) laws: Laws,
    pub(super) quick: Option<Quick>,
    /// The layer of finite elements under the wall, and the exchange with it.
    pub(super) layer: Option<(Py<FemLayer>, Exchange)>,
    /// Sources outside, and the magnets in the capsule.
    pub(super) magnets: Option<Magnets>,
    pub(super) motion: Motion,
    /// The wall's centre; subtracted from every position [m].
    pub(super) center: DVec3,
    pub(super) soft: SoftWall,
    /// Means over the last step.
    pub(super) last: Tally,
    /// What `undo` goes back to.
    pub(super) saved: Option<Saved>,
}

#[pymethods]
impl World {
    /// A capsule in a wall at rest, at a pose.
    #[new]
    fn new(
        py: Python<'_>,
        wall: Py<Wall>,
        body: BodyParameters<'_>,
        material: MaterialParameters,
        drag: DragParameters,
        quick: Option<QuickParameters>,
        pose: Pose,
    ) -> PyResult<Self> {
        let (soft, center) = {
            let wall = wall.borrow(py);
            (SoftWall::new(&wall, quick.is_some()), DVec3::from(wall.center))
        };
        let quick = quick.map(Quick::from);
        let body: Body = body.into();
        let laws = laws(material, drag, body.radius);
        let mut world = World {
            wall,
            body,
            laws,
            quick,
            layer: None,
            magnets: None,
            motion: Motion::default(),
            center,
            soft,
            last: Tally::default(),
            saved: None,
        };
        world.set_pose(pose)?;
        Ok(world)
    }

    /// Moves on by `count` substeps of `dt`, with a wrench [N, N·m] and gravity [m/s²].
    ///
    /// `calibre` [2 k] is how wide the lumen is and how wide it is to be at the end, see `set_drive`.
    /// A layer makes `outer` steps meanwhile, of which `count` is a multiple.
    #[pyo3(signature = (dt, count, wrench, gravity, calibre=None, outer=1))]
    #[allow(clippy::too_many_arguments)]
    fn step(
        &mut self,
        py: Python<'_>,
        dt: f64,
        count: usize,
        wrench: [f64; 6],
        gravity: [f64; 3],
        calibre: Option<PyReadonlyArray2<'_, f64>>,
        outer: usize,
    ) -> PyResult<()> {
        if outer == 0 || !count.is_multiple_of(outer) {
            return Err(PyValueError::new_err("The count must be a multiple of outer."));
        }
        let load = Load { wrench: Twist::from_array(wrench), gravity: DVec3::from(gravity) };
        if let Some(calibre) = calibre {
            self.aim(calibre.as_slice()?, dt * count as f64)?;
        }
        let wall = self.wall.clone_ref(py);
        let mut wall = wall.borrow_mut(py);
        let wall: &mut Wall = &mut wall;
        let layer = self.layer.as_ref().map(|(layer, _)| layer.clone_ref(py));
        let mut layer = layer.as_ref().map(|layer| layer.borrow_mut(py));
        let layer: Option<&mut FemLayer> = layer.as_deref_mut();
        py.detach(|| self.run(wall, layer, &load, dt, (count, outer)))
            .map_err(PyValueError::new_err)
    }

    /// Puts a layer of finite elements under the wall, solved to `tolerance` [m].
    fn set_layer(&mut self, py: Python<'_>, layer: Py<FemLayer>, tolerance: f64) {
        let exchange = Exchange::new(&layer.borrow(py), tolerance);
        self.layer = Some((layer, exchange));
    }

    /// Lets sources act on magnets [k 6] (place, moment) in the capsule; `aim_sources` comes next.
    fn set_magnets(
        &mut self,
        sources: PyRef<'_, FieldSources>,
        magnets: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        self.magnets = Some(Magnets::new(sources.sources.clone(), internal_magnets(&magnets)?));
        Ok(())
    }

    /// Moves the sources in the steps of the next `duration` [s] from rows [k 8] to rows: place,
    /// quaternion wxyz, strength, in the world, where the wall is at a pose [4 4].
    fn aim_sources(
        &mut self,
        begin: PyReadonlyArray2<'_, f64>,
        end: PyReadonlyArray2<'_, f64>,
        duration: f64,
        pose: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let (begin, end) = (rows(&begin, SOURCE_ROW)?, rows(&end, SOURCE_ROW)?);
        let (rotation, position) = read_pose(&pose)?;
        let magnets = self.magnets.as_mut().filter(|magnets| {
            begin.len() == end.len() && begin.len() == SOURCE_ROW * magnets.count()
        });
        let magnets = magnets.ok_or_else(|| PyValueError::new_err("A row for each source."))?;
        let pose = (rotation, position + rotation * self.center);
        magnets.aim((&begin, &end), duration, pose, &self.motion);
        Ok(())
    }

    /// What the sources did since `aim_sources`, and their field for a capsule at a pose [4 4].
    fn pulled(&mut self, pose: PyReadonlyArray2<'_, f64>) -> PyResult<Option<Report>> {
        let Some(magnets) = self.magnets.as_mut() else { return Ok(None) };
        magnets.finish();
        Ok(Some(magnets.report(read_pose(&pose)?)))
    }

    /// What lasts of the exchange with the layer: force [N] on each node, how far the felt wall is
    /// off it [m] and the momentum it is owed [N·s], [nodes 9]; number, normal force [N] and friction [N] of touched triangles,
    /// [k 5]. None without a layer.
    #[getter]
    fn exchange<'py>(&self, py: Python<'py>) -> Option<Tables<'py>> {
        let (_, exchange) = self.layer.as_ref()?;
        let (nodes, touched) = exchange.held.to_rows();
        Some((table(py, nodes, 9), table(py, touched, 5)))
    }

    #[setter]
    fn set_exchange(
        &mut self,
        rows: Option<(PyReadonlyArray2<'_, f64>, PyReadonlyArray2<'_, f64>)>,
    ) -> PyResult<()> {
        if let (Some((_, exchange)), Some((nodes, touched))) = (self.layer.as_mut(), rows) {
            exchange.held = Held::from_rows(nodes.as_slice()?, touched.as_slice()?);
        }
        Ok(())
    }

    /// Lets the lumen narrow and widen: `inward` [n 3] from each vertex at rest to the centreline,
    /// `station` [n] its place along the samples of the calibres that `step` takes.
    fn set_drive(
        &mut self,
        inward: PyReadonlyArray2<'_, f64>,
        station: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        let (rows, station) = (inward.as_array(), station.as_slice()?);
        if rows.dim() != (self.soft.driven.len(), 3) || station.len() != self.soft.driven.len() {
            return Err(PyValueError::new_err("A drive has a row for each vertex."));
        }
        let inward = rows.outer_iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect();
        self.soft.drive = Some(Drive::new(self.soft.driven.clone(), inward, station));
        Ok(())
    }

    /// Keeps all that changes but a layer and its exchange, for `undo`.
    fn save(&mut self) {
        let mut driven = self.saved.take().map_or_else(Vec::new, |(_, _, driven)| driven);
        driven.clone_from(&self.soft.driven);
        self.saved = Some((self.motion, self.soft.awake_yields(), driven));
    }

    /// Goes back to what was last saved.
    fn undo(&mut self) {
        if let Some((motion, yields, driven)) = self.saved.take() {
            self.motion = motion;
            self.soft.restore_yields(yields);
            self.soft.driven = driven;
            self.soft.stay();
        }
    }

    /// Brings the hierarchy to where the wall is now, for rendering and queries, if it may be off
    /// by more than a tolerance [m].
    #[pyo3(signature = (tolerance=0.0))]
    fn settle(&mut self, py: Python<'_>, tolerance: f64) -> PyResult<()> {
        if self.soft.wall_travel <= tolerance {
            return Ok(());
        }
        let wall = self.wall.clone_ref(py);
        let mut wall = wall.borrow_mut(py);
        let wall: &mut Wall = &mut wall;
        py.detach(|| self.soft.settle(wall)).map_err(PyValueError::new_err)
    }

    /// Centre of mass [m], quaternion wxyz of unit length, velocity and angular velocity.
    #[getter]
    fn pose(&self) -> Pose {
        let m = &self.motion;
        let q = m.rotation;
        (
            m.position.to_array(),
            [q.w, q.x, q.y, q.z],
            m.velocity.to_array(),
            m.angular_velocity.to_array(),
        )
    }

    /// Pose [4 4] of the capsule in the world, where the wall is at a pose [4 4].
    fn pose_in<'py>(
        &self,
        py: Python<'py>,
        wall: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (rotation, position) = read_pose(&wall)?;
        let turn = rotation * DMat3::from_quat(self.motion.rotation);
        let place = rotation * (self.motion.position + self.center) + position;
        Ok(table(py, pose_rows(&turn, place).to_vec(), 4))
    }

    #[setter]
    fn set_pose(&mut self, pose: Pose) -> PyResult<()> {
        let (position, [w, x, y, z], velocity, angular_velocity) = pose;
        let numbers = [&position[..], &[w, x, y, z], &velocity, &angular_velocity].concat();
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err(PyValueError::new_err("A capsule's pose and motion must be finite."));
        }
        self.motion = Motion {
            position: DVec3::from(position),
            rotation: DQuat::from_xyzw(x, y, z, w),
            velocity: DVec3::from(velocity),
            angular_velocity: DVec3::from(angular_velocity),
        };
        self.soft.travel = f64::INFINITY;
        Ok(())
    }

    /// Displacement [m] and velocity [m/s] of each vertex, [n 6].
    #[getter]
    fn yields<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let rows = self.soft.yields.iter();
        let flat =
            rows.flat_map(|y| Twist { linear: y.displacement, angular: y.velocity }.to_array());
        table(py, flat.collect(), 6)
    }

    #[setter]
    fn set_yields(&mut self, yields: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = yields.as_array();
        if rows.dim() != (self.soft.yields.len(), 6) {
            return Err(PyValueError::new_err("Yields are six numbers for each vertex."));
        }
        self.soft.yields = rows
            .outer_iter()
            .map(|r| Yield {
                displacement: DVec3::new(r[0], r[1], r[2]),
                velocity: DVec3::new(r[3], r[4], r[5]),
            })
            .collect();
        let awake = (0..).zip(&self.soft.yields).filter(|(_, y)| **y != Yield::default());
        let is_quick = self.quick.is_some();
        self.soft.awake = awake.filter(|_| is_quick).map(|(v, _)| v).collect();
        (self.soft.travel, self.soft.wall_travel) = (f64::INFINITY, f64::INFINITY);
        Ok(())
    }

    /// Where the wall would be if nothing touched it [n 3].
    #[getter]
    fn driven<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let flat = self.soft.driven.iter().flat_map(|p| p.to_array());
        table(py, flat.collect(), 3)
    }

    #[setter]
    fn set_driven(&mut self, driven: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let rows = driven.as_array();
        if rows.dim() != (self.soft.driven.len(), 3) {
            return Err(PyValueError::new_err("A driven wall has a row for each vertex."));
        }
        let place = |r: ndarray::ArrayView1<f64>| DVec3::new(r[0], r[1], r[2]);
        self.soft.driven = rows.outer_iter().map(place).collect();
        (self.soft.travel, self.soft.wall_travel) = (f64::INFINITY, f64::INFINITY);
        Ok(())
    }

    /// Vertices of the wall now [n 3], in the frame to which `transform` [4 4] brings the wall's.
    fn vertices<'py>(
        &self,
        py: Python<'py>,
        transform: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let t = transform.as_array();
        if t.dim() != (4, 4) {
            return Err(PyValueError::new_err("A transform has four rows and four columns."));
        }
        let [x, y, z, origin] = [0, 1, 2, 3].map(|k| DVec3::new(t[[0, k]], t[[1, k]], t[[2, k]]));
        let mut flat = vec![0.0; 3 * self.soft.driven.len()];
        py.detach(|| {
            let rows = flat.par_chunks_exact_mut(3).with_min_len(4096).enumerate();
            rows.for_each(|(v, row)| {
                let p = self.soft.vertex(v as u32).0 + self.center;
                (x * p.x + y * p.y + z * p.z + origin).write_to_slice(row);
            });
        });
        Ok(table(py, flat, 3))
    }

    /// Mean force [N] and torque [N·m] of the wall on the capsule over the last step, mean sum of
    /// normal forces [N], energy lost to friction [J]; then stored energy [J], touched area [m²]
    /// and largest depth [m] of the last substep.
    fn contact(&self) -> ([f64; 3], [f64; 3], f64, f64, f64, f64, f64) {
        let (last, patch) = (&self.last, &self.soft.patch);
        (
            last.force.to_array(),
            last.torque.to_array(),
            last.grip,
            last.friction_work,
            patch.energy,
            patch.area,
            patch.depth,
        )
    }

    /// Where [m] and how [N] the capsule pushes the wall in the quick model, [n 6].
    fn pushes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let rows = self.soft.pushes.iter();
        let flat = rows.flat_map(|p| Twist { linear: p.center, angular: p.force }.to_array());
        table(py, flat.collect(), 6)
    }

    /// Largest depth [m] to which the capsule presses in where it is now.
    fn probe(&mut self, py: Python<'_>) -> PyResult<f64> {
        let wall = self.wall.clone_ref(py);
        let mut wall = wall.borrow_mut(py);
        let reach = self.quick.map_or(0.0, |q| q.reach);
        let found = self.soft.search(&mut wall, &self.body, &self.motion, reach);
        found.map_err(PyValueError::new_err)?;
        self.soft.update_facets(&self.body.axis(&self.motion), self.body.radius);
        let soft = &mut self.soft;
        press(&self.body, &self.laws, &soft.facets, &self.motion, &mut soft.patch);
        Ok(self.soft.patch.depth)
    }

    /// Kinetic energy of the capsule [J].
    fn kinetic_energy(&self) -> f64 {
        self.body.kinetic_energy(&self.motion)
    }

    /// Resistance [N] of the printed and continuous laws at a speed [m/s].
    fn resistance(&self, speed: f64) -> f64 {
        self.laws.drag.resistance(speed)
    }

    /// Whether the capsule's axis is in the lumen, by the hierarchy as last settled.
    fn inside(&self, py: Python<'_>) -> bool {
        self.is_inside(&self.wall.borrow(py))
    }
}

fn table(py: Python<'_>, flat: Vec<f64>, columns: usize) -> Bound<'_, PyArray2<f64>> {
    let rows = flat.len() / columns;
    Array2::from_shape_vec((rows, columns), flat).expect("whole rows").into_pyarray(py)
}
