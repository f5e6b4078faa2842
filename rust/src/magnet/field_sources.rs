//! Python handle of a set of sources: `vrcaps.magnet.field`.

use super::axial::{Ring, Shell};
use super::field_map::FieldMap;
use super::sources::{InternalMagnet, Kind, MAGNETIC_CONSTANT, Source, field, wrench};
use crate::pool::map;
use crate::poses::{read_pose, rows, vector};
use glam::{DQuat, DVec3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray4,
    ndarray::{Array1, Array2, Array3},
};
use pyo3::{exceptions::PyValueError, prelude::*};
use std::sync::Arc;

/// Number of points in a chunk for one thread.
const CHUNK: usize = 256;

/// Sources of a magnetic field in the world.
#[pyclass(module = "vrcaps._core")]
#[derive(Default)]
pub struct FieldSources {
    /// Sources, in the order in which they were added.
    pub sources: Vec<Source>,
}

/// Magnets of a body from rows of position and moment.
pub fn internal_magnets(magnets: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<InternalMagnet>> {
    let rows = rows(magnets, 6)?;
    let magnet = |m: &[f64]| InternalMagnet { position: vector(m), moment: vector(&m[3..]) };
    Ok(rows.chunks_exact(6).map(magnet).collect())
}

impl FieldSources {
    fn source(&mut self, index: usize) -> PyResult<&mut Source> {
        let count = self.sources.len();
        self.sources
            .get_mut(index)
            .ok_or_else(|| PyValueError::new_err(format!("No source {index} of {count}.")))
    }

    fn add(&mut self, pose: &PyReadonlyArray2<'_, f64>, kind: Kind) -> PyResult<()> {
        let (rotation, position) = read_pose(pose)?;
        self.sources.push(Source { kind, rotation, position, strength: 1.0, solid: None });
        Ok(())
    }

    /// Adds a magnet within a cylinder about its moment, of a radius and half a length [m].
    fn add_solid(
        &mut self,
        pose: &PyReadonlyArray2<'_, f64>,
        kind: Kind,
        around: (f64, f64),
    ) -> PyResult<()> {
        self.add(pose, kind)?;
        if let Some(source) = self.sources.last_mut() {
            source.solid = Some(around);
        }
        Ok(())
    }
}

/// Flux density, gradient and validity at each point.
type Fields<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray1<u8>>);

/// Force and torque, and validity at each pose.
type Wrenches<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<u8>>);

#[pymethods]
impl FieldSources {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    fn __len__(&self) -> usize {
        self.sources.len()
    }

    /// Adds a point dipole of a moment [A·m²].
    fn add_dipole(&mut self, pose: PyReadonlyArray2<'_, f64>, moment: f64) -> PyResult<()> {
        self.add(&pose, Kind::Dipole(moment))
    }

    /// Adds a shell of radius and length [m] with μ₀ × current per length [T], or a solid magnet of
    /// that remanence.
    #[pyo3(signature = (pose, radius, length, sheet, is_solid=false))]
    fn add_shell(
        &mut self,
        pose: PyReadonlyArray2<'_, f64>,
        radius: f64,
        length: f64,
        sheet: f64,
        is_solid: bool,
    ) -> PyResult<()> {
        let kind = Kind::Shell(Shell::new(radius, 0.5 * length, sheet));
        if is_solid {
            self.add_solid(&pose, kind, (radius, 0.5 * length))
        } else {
            self.add(&pose, kind)
        }
    }

    /// Adds a ring of outer and inner radius and length [m]; `across`: magnetized across its axis,
    /// which is then x. An inner radius of 0 makes a cylinder.
    fn add_magnet_ring(
        &mut self,
        pose: PyReadonlyArray2<'_, f64>,
        radii: (f64, f64),
        length: f64,
        remanence: f64,
        across: bool,
    ) -> PyResult<()> {
        let (radius, hole) = radii;
        let outer = Shell::new(radius, 0.5 * length, remanence);
        let inner = (hole > 0.0).then(|| Shell::new(hole, 0.5 * length, remanence));
        let kind = match (across, inner) {
            (true, inner) => Kind::Across(outer, inner),
            (false, Some(inner)) => Kind::Tube(outer, inner),
            (false, None) => Kind::Shell(outer),
        };
        let half = 0.5 * length;
        let around = if across { (half.hypot(radius), radius) } else { (radius, half) };
        self.add_solid(&pose, kind, around)
    }

    /// Adds a block of edges [m] and a remanence [T], magnetized along its z.
    fn add_block(
        &mut self,
        pose: PyReadonlyArray2<'_, f64>,
        size: [f64; 3],
        remanence: f64,
    ) -> PyResult<()> {
        let half = 0.5 * DVec3::from(size);
        self.add_solid(&pose, Kind::Block(half, remanence), (half.x.hypot(half.y), half.z))
    }

    /// Adds a ball of a radius [m] and a remanence [T].
    fn add_ball(
        &mut self,
        pose: PyReadonlyArray2<'_, f64>,
        radius: f64,
        remanence: f64,
    ) -> PyResult<()> {
        self.add_solid(&pose, Kind::Ball(radius, remanence), (radius, radius))
    }

    /// Adds a loop of a radius [m] with current × turns [A].
    fn add_ring(
        &mut self,
        pose: PyReadonlyArray2<'_, f64>,
        radius: f64,
        current: f64,
    ) -> PyResult<()> {
        self.add(&pose, Kind::Ring(Ring::new(radius, MAGNETIC_CONSTANT * current)))
    }

    /// Adds a uniform flux density [T].
    fn add_uniform(&mut self, pose: PyReadonlyArray2<'_, f64>, flux: f64) -> PyResult<()> {
        self.add(&pose, Kind::Uniform(flux))
    }

    /// Adds values [nx ny nz 3] in T on a grid with an origin and a spacing [m], times a factor.
    fn add_map(
        &mut self,
        pose: PyReadonlyArray2<'_, f64>,
        origin: [f64; 3],
        spacing: [f64; 3],
        values: PyReadonlyArray4<'_, f64>,
        factor: f64,
    ) -> PyResult<()> {
        let view = values.as_array();
        let (nx, ny, nz, three) = view.dim();
        if three != 3 || nx.min(ny).min(nz) < 4 {
            return Err(PyValueError::new_err("A map needs 4 points per axis, 3 numbers each."));
        }
        let flat: Vec<f64> = view.iter().copied().collect();
        let values: Vec<DVec3> = flat.chunks_exact(3).map(vector).collect();
        let map = FieldMap::new(DVec3::from(origin), DVec3::from(spacing), [nx, ny, nz], &values);
        self.add(&pose, Kind::Map(Arc::new(map), factor))
    }

    /// Sets the pose of a source.
    fn set_pose(&mut self, index: usize, pose: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let pose = read_pose(&pose)?;
        let source = self.source(index)?;
        (source.rotation, source.position) = pose;
        Ok(())
    }

    /// Sets the factor of a source's field.
    fn set_strength(&mut self, index: usize, strength: f64) -> PyResult<()> {
        self.source(index)?.strength = strength;
        Ok(())
    }

    /// Flux density [n 3], gradient [n 3 3] and validity [n] at points [n 3].
    fn field<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Fields<'py>> {
        let points = rows(&points, 3)?;
        let each: Vec<&[f64]> = points.chunks_exact(3).collect();
        let fields = map(py, &each, CHUNK, |p| field(&self.sources, vector(p)));
        let n = fields.len();
        let flux = fields.iter().flat_map(|f| f.flux.to_array()).collect();
        let gradient = fields.iter().flat_map(|f| f.gradient.transpose().to_cols_array()).collect();
        let place = fields.iter().map(|f| f.place as u8).collect();
        Ok((
            shaped(Array2::from_shape_vec((n, 3), flux))?.into_pyarray(py),
            shaped(Array3::from_shape_vec((n, 3, 3), gradient))?.into_pyarray(py),
            Array1::<u8>::from_vec(place).into_pyarray(py),
        ))
    }

    /// Force and torque [n 6] on a body with magnets [k 6] (position, moment) at poses [n 7]
    /// (position, quaternion wxyz), and validity [n].
    fn wrench<'py>(
        &self,
        py: Python<'py>,
        magnets: PyReadonlyArray2<'py, f64>,
        poses: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Wrenches<'py>> {
        let magnets = internal_magnets(&magnets)?;
        let poses = rows(&poses, 7)?;
        let wrenches: Vec<_> = py.detach(|| {
            let one = |p: &[f64]| {
                let rotation = DQuat::from_xyzw(p[4], p[5], p[6], p[3]);
                wrench(&self.sources, &magnets, vector(p), rotation)
            };
            poses.chunks_exact(7).map(one).collect()
        });
        let flat = wrenches.iter().flat_map(|w| [w.force.to_array(), w.torque.to_array()]);
        let flat = flat.flatten().collect();
        let place = wrenches.iter().map(|w| w.place as u8).collect();
        Ok((
            shaped(Array2::from_shape_vec((wrenches.len(), 6), flat))?.into_pyarray(py),
            Array1::<u8>::from_vec(place).into_pyarray(py),
        ))
    }
}

fn shaped<T>(result: Result<T, numpy::ndarray::ShapeError>) -> PyResult<T> {
    result.map_err(|error| PyValueError::new_err(error.to_string()))
}
