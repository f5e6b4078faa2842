//! Python binding of a layer of finite elements.

use super::Outcome;
use super::elements::{Elements, Hyperelastic, NODES};
use super::embedding::{CARRIERS, Embedding};
use super::factor::{Factor, Symbolic};
use super::minimize::{Objective, minimize};
use super::sparse::{Pattern, add_scaled, dot};
use crate::pool::detached;
use glam::{DMat3, DVec3};
use numpy::{
    IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArray4,
    PyUntypedArrayMethods, ndarray::Array2,
};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Maximum number of steps of the minimization.
const MOST_ROUNDS: usize = 200;

/// Matrices of the layer over its free nodes: `vrcaps.tissue.fem.assembly.Matrices`.
#[derive(FromPyObject)]
struct MatrixArrays<'py> {
    starts: PyReadonlyArray1<'py, i64>,
    columns: PyReadonlyArray1<'py, u32>,
    mass: PyReadonlyArray1<'py, f64>,
    support: PyReadonlyArray1<'py, f64>,
    stiffness: PyReadonlyArray3<'py, f64>,
    node_mass: PyReadonlyArray1<'py, f64>,
}

/// Elements of the layer, for a nonlinear wall: `vrcaps.tissue.fem.assembly.ElementPoints`.
#[derive(FromPyObject)]
struct ElementArrays<'py> {
    nodes: PyReadonlyArray2<'py, u32>,
    gradients: PyReadonlyArray4<'py, f64>,
    weights: PyReadonlyArray2<'py, f64>,
    modes: PyReadonlyArray3<'py, f64>,
    shear: f64,
    lame: f64,
    stiffening: f64,
}

/// Embedding of the surface in the layer, as in `vrcaps.tissue.fem.wall.Embedding`.
#[derive(FromPyObject)]
struct EmbeddingArrays<'py> {
    nodes: PyReadonlyArray2<'py, u32>,
    weights: PyReadonlyArray2<'py, f64>,
}

/// Discretization of `ρ dv/dt = ρ b + div σ` on the layer, with all its matrices.
pub(super) struct Body {
    pattern: Pattern,
    /// Mass between nodes [kg].
    mass: Vec<f64>,
    /// Elastic support between nodes [N/m].
    support: Vec<f64>,
    /// Stiffness at rest, including the support [N/m].
    stiffness: Vec<DMat3>,
    /// Lumped mass of each node under uniform acceleration [kg].
    node_mass: Vec<f64>,
    /// Time of the viscous stress, which is the rest stiffness times the strain rate times it [s].
    damping: f64,
    /// Elements; `None` for a linear wall.
    pub(super) elements: Option<Elements>,
}

/// Factor, and the time step that it is for.
struct Prepared {
    dt: f64,
    factor: Factor,
}

/// Implicit step as a minimization over the new velocities.
struct Step<'a> {
    body: &'a Body,
    elements: &'a Elements,
    symbolic: &'a Symbolic,
    factor: &'a mut Factor,
    dt: f64,
    displacement: &'a [DVec3],
    velocity: &'a [DVec3],
    force: &'a [DVec3],
}

impl Objective for Step<'_> {
    /// `½ δᵀMδ + ½ dt c ẇᵀKẇ + Ψ(u + dt w) − dt f·w` with `δ = w − v`.
    fn evaluate(&mut self, w: &[DVec3], slope: &mut [DVec3]) -> f64 {
        let (body, dt) = (self.body, self.dt);
        let change: Vec<DVec3> = w.iter().zip(self.velocity).map(|(w, v)| *w - *v).collect();
        slope.fill(DVec3::ZERO);
        body.pattern.add_product(&body.mass, &change, 1.0, slope);
        let mut value = 0.5 * dot(slope, &change);
        if body.damping > 0.0 {
            let mut viscous = vec![DVec3::ZERO; w.len()];
            body.pattern.add_product(&body.stiffness, w, dt * body.damping, &mut viscous);
            value += 0.5 * dot(&viscous, w);
            add_scaled(&viscous, 1.0, slope);
        }
        let mut moved = self.displacement.to_vec();
        add_scaled(w, dt, &mut moved);
        let mut held = vec![DVec3::ZERO; w.len()];
        body.pattern.add_product(&body.support, &moved, 1.0, &mut held);
        value += 0.5 * dot(&held, &moved) - dt * dot(self.force, w);
        add_scaled(&held, dt, slope);
        add_scaled(self.force, -dt, slope);
        value + self.elements.add_force(&moved, dt, slope)
    }

    fn precondition(&mut self, vector: &mut [DVec3]) {
        self.symbolic.solve(self.factor, vector);
    }
}

impl Body {
    /// Kinetic energy, then energy stored in wall and support [J].
    fn energies(&self, displacement: &[DVec3], velocity: &[DVec3]) -> (f64, f64) {
        let mut out = vec![DVec3::ZERO; displacement.len()];
        self.pattern.add_product(&self.mass, velocity, 1.0, &mut out);
        let kinetic = 0.5 * dot(&out, velocity);
        out.fill(DVec3::ZERO);
        let mut stored = 0.0;
        match &self.elements {
            Some(elements) => {
                self.pattern.add_product(&self.support, displacement, 1.0, &mut out);
                stored += elements.add_force(displacement, 0.0, &mut []);
            }
            None => self.pattern.add_product(&self.stiffness, displacement, 1.0, &mut out),
        }
        stored += 0.5 * dot(&out, displacement);
        (kinetic, stored)
    }
}

/// Wall as a layer: its matrices, their factor and its motion.
#[pyclass(module = "vrcaps._core")]
pub struct FemLayer {
    pub(super) body: Body,
    /// Embedding of the surface's vertices in the nodes.
    pub embedding: Embedding,
    symbolic: Symbolic,
    prepared: Option<Prepared>,
    /// Displacements of the free nodes [m].
    pub displacement: Vec<DVec3>,
    /// Velocities of the free nodes [m/s].
    pub velocity: Vec<DVec3>,
    /// Number of back-substitutions of the last step.
    #[pyo3(get)]
    rounds: usize,
}

fn vectors(numbers: &[f64]) -> Vec<DVec3> {
    numbers.chunks_exact(3).map(DVec3::from_slice).collect()
}

fn fixed<T: Copy + Default, const N: usize>(numbers: &[T]) -> Vec<[T; N]> {
    let row = |chunk: &[T]| std::array::from_fn(|k| chunk[k]);
    numbers.chunks_exact(N).map(row).collect()
}

fn elements(given: ElementArrays) -> PyResult<Elements> {
    let gradients = vectors(given.gradients.as_slice()?);
    Ok(Elements {
        material: Hyperelastic {
            shear: given.shear,
            lame: given.lame,
            stiffening: given.stiffening,
        },
        nodes: fixed(given.nodes.as_slice()?),
        gradients: gradients.chunks_exact(NODES).map(|g| std::array::from_fn(|k| g[k])).collect(),
        weights: given.weights.as_slice()?.to_vec(),
        modes: fixed(given.modes.as_slice()?),
    })
}

impl FemLayer {
    /// Computes the factor for steps of `dt` [s], if it is not available.
    pub(super) fn prepare(&mut self, dt: f64) -> Outcome<()> {
        if self.prepared.as_ref().is_some_and(|prepared| prepared.dt == dt) {
            return Ok(());
        }
        let (body, weight) = (&self.body, dt * (dt + self.body.damping));
        let factor = self.symbolic.factorize(&body.pattern, &body.mass, &body.stiffness, weight)?;
        self.prepared = Some(Prepared { dt, factor });
        Ok(())
    }

    /// Velocities after a step of a linear wall: one back-substitution.
    ///
    /// `(M + dt (dt + c) K) w = M v + dt (f − K u)`.
    pub(super) fn linear_step(&mut self, force: &[DVec3], dt: f64) -> Vec<DVec3> {
        let body = &self.body;
        let mut right = vec![DVec3::ZERO; force.len()];
        body.pattern.add_product(&body.mass, &self.velocity, 1.0, &mut right);
        body.pattern.add_product(&body.stiffness, &self.displacement, -dt, &mut right);
        add_scaled(force, dt, &mut right);
        self.solve(&mut right);
        self.rounds = 1;
        right
    }

    /// True if the material is linear (Hooke's law).
    pub fn is_linear(&self) -> bool {
        self.body.elements.is_none()
    }

    /// Replaces b by the solution of `(M + dt (dt + c) K) x = b` for the last prepared step.
    pub(super) fn solve(&mut self, b: &mut [DVec3]) {
        if let Some(prepared) = &mut self.prepared {
            self.symbolic.solve(&mut prepared.factor, b);
        }
    }

    /// Solves as `solve`, for three right-hand sides at once.
    pub(super) fn solve_three(&self, mut b: [Vec<DVec3>; 3]) -> [Vec<DVec3>; 3] {
        if let Some(prepared) = &self.prepared {
            self.symbolic.solve_three(&prepared.factor, &mut b);
        }
        b
    }

    /// Velocities after a step of a nonlinear wall, to `tolerance` [m], from an initial guess.
    pub(super) fn nonlinear_step(
        &mut self,
        force: &[DVec3],
        mut velocity: Vec<DVec3>,
        dt: f64,
        tolerance: f64,
    ) -> Outcome<Vec<DVec3>> {
        let (Some(elements), Some(prepared)) = (&self.body.elements, &mut self.prepared) else {
            return Err("The layer has no elements.");
        };
        let mut step = Step {
            body: &self.body,
            elements,
            symbolic: &self.symbolic,
            factor: &mut prepared.factor,
            dt,
            displacement: &self.displacement,
            velocity: &self.velocity,
            force,
        };
        let rounds = minimize(&mut step, &mut velocity, tolerance / dt, MOST_ROUNDS);
        self.rounds = rounds.ok_or(
            "The wall's step did not converge: the force crushes it. Allowed: a shorter dt or a \
             smaller force.",
        )?;
        Ok(velocity)
    }
}

fn rows_of_six<'py>(py: Python<'py>, rows: &[(DVec3, DVec3)]) -> Bound<'py, PyArray2<f64>> {
    let shape = (rows.len(), 6);
    let numbers = rows.iter().flat_map(|(u, v)| [u.x, u.y, u.z, v.x, v.y, v.z]).collect();
    Array2::from_shape_vec(shape, numbers).expect("six numbers a row").into_pyarray(py)
}

#[pymethods]
impl FemLayer {
    #[new]
    #[pyo3(signature = (matrices, elements, embedding, damping))]
    fn new(
        matrices: MatrixArrays,
        elements: Option<ElementArrays>,
        embedding: EmbeddingArrays,
        damping: f64,
    ) -> PyResult<Self> {
        let starts = matrices.starts.as_slice()?.iter().map(|&k| k as usize).collect();
        let pattern = Pattern { starts, columns: matrices.columns.as_slice()?.to_vec() };
        let blocks = matrices.stiffness.as_slice()?.chunks_exact(9);
        // Blocks are stored by rows, but a matrix is made from columns.
        let stiffness = blocks.map(|b| DMat3::from_cols_slice(b).transpose()).collect();
        let symbolic = Symbolic::new(&pattern).map_err(PyValueError::new_err)?;
        let still = vec![DVec3::ZERO; pattern.len()];
        Ok(FemLayer {
            body: Body {
                pattern,
                mass: matrices.mass.as_slice()?.to_vec(),
                support: matrices.support.as_slice()?.to_vec(),
                stiffness,
                node_mass: matrices.node_mass.as_slice()?.to_vec(),
                damping,
                elements: elements.map(self::elements).transpose()?,
            },
            embedding: Embedding {
                nodes: fixed::<u32, CARRIERS>(embedding.nodes.as_slice()?),
                weights: fixed::<f64, CARRIERS>(embedding.weights.as_slice()?),
            },
            symbolic,
            prepared: None,
            displacement: still.clone(),
            velocity: still,
            rounds: 0,
        })
    }

    /// Advances by `dt` [s] under forces on the surface's vertices [N] and a uniform acceleration
    /// [m/s²]; the motion is unchanged after an error.
    fn step(
        &mut self,
        py: Python<'_>,
        force: PyReadonlyArray2<f64>,
        acceleration: [f64; 3],
        dt: f64,
        tolerance: f64,
    ) -> PyResult<()> {
        if force.shape() != [self.embedding.nodes.len(), 3] {
            return Err(PyValueError::new_err("One force for each vertex is needed."));
        }
        let (force, acceleration) = (force.as_slice()?, DVec3::from_array(acceleration));
        py.detach(|| {
            let push = |mass: &f64| *mass * acceleration;
            let mut nodal: Vec<DVec3> = self.body.node_mass.iter().map(push).collect();
            self.embedding.gather(|v| DVec3::from_slice(&force[3 * v..]), &mut nodal);
            let velocity = self.predict(&nodal, dt, tolerance)?;
            self.advance(velocity, dt);
            Ok(())
        })
        .map_err(|error: &str| PyValueError::new_err(error))
    }

    /// Displacement [m] and velocity [m/s] of the surface's vertices.
    fn wall_displacement<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let mut rows = vec![(DVec3::ZERO, DVec3::ZERO); self.embedding.nodes.len()];
        detached(py, || self.embedding.carry(&self.displacement, &self.velocity, &mut rows));
        rows_of_six(py, &rows)
    }

    /// Displacement [m] and velocity [m/s] of the free nodes.
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let rows: Vec<_> =
            self.displacement.iter().copied().zip(self.velocity.iter().copied()).collect();
        rows_of_six(py, &rows)
    }

    #[setter]
    fn set_nodes(&mut self, nodes: PyReadonlyArray2<f64>) -> PyResult<()> {
        if nodes.shape() != [self.displacement.len(), 6] {
            return Err(PyValueError::new_err("Six numbers for each free node are needed."));
        }
        for (k, row) in nodes.as_slice()?.chunks_exact(6).enumerate() {
            self.displacement[k] = DVec3::from_slice(row);
            self.velocity[k] = DVec3::from_slice(&row[3..]);
        }
        Ok(())
    }

    /// Kinetic energy, then energy stored in wall and support [J].
    fn energies(&self) -> (f64, f64) {
        self.body.energies(&self.displacement, &self.velocity)
    }

    /// Number of entries of the factor.
    #[getter]
    pub fn fill(&self) -> usize {
        self.symbolic.fill()
    }
}
