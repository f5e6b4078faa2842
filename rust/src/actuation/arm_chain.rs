//! Python handle of an arm: `vrcaps.actuation.arm`.

use super::damped_least_squares::descend;
use super::inverse_kinematics::{All, Angles, BRANCHES, Inverse, JOINTS};
use super::kinematic_chain::{Chain, Joint, Pose};
use super::link_capsules::{LinkCapsule, Obstacles};
use crate::pool::map;
use crate::poses::{pose_of, rows, square};
use glam::DVec3;
use numpy::{IntoPyArray, PyArrayDyn, PyReadonlyArray2, PyReadonlyArray3, ndarray::ArrayD};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Number of poses in a chunk for one thread.
const CHUNK: usize = 64;

/// Chain of revolute joints with limits, and capsules around its links.
#[pyclass(module = "vrcaps._core")]
#[derive(Clone)]
pub struct ArmChain {
    /// Joints of the arm.
    pub(super) chain: Chain,
    inverse: Option<Inverse>,
    /// Capsules around the links.
    pub(super) obstacles: Obstacles,
}

/// Array with a shape.
pub(super) fn array<'py>(
    py: Python<'py>,
    shape: &[usize],
    flat: Vec<f64>,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let shaped = ArrayD::from_shape_vec(shape, flat);
    Ok(shaped.map_err(|error| PyValueError::new_err(error.to_string()))?.into_pyarray(py))
}

/// Pose from its four rows.
pub(super) fn pose(m: &[f64]) -> Pose {
    let (rotation, position) = pose_of(m);
    Pose { rotation, position }
}

fn poses(array: &PyReadonlyArray3<'_, f64>) -> PyResult<Vec<Pose>> {
    let view = array.as_array();
    if view.shape()[1..] != [4, 4] {
        return Err(PyValueError::new_err("Poses must be 4 by 4."));
    }
    let flat: Vec<f64> = view.iter().copied().collect();
    Ok(flat.chunks_exact(16).map(pose).collect())
}

fn angles(row: &[f64]) -> Angles {
    std::array::from_fn(|i| row[i])
}

fn all_rows(array: Option<PyReadonlyArray2<'_, f64>>, columns: usize) -> PyResult<Vec<f64>> {
    array.map_or(Ok(vec![]), |array| rows(&array, columns))
}

impl ArmChain {
    /// Number of joints.
    pub(super) fn count(&self) -> usize {
        self.chain.joints.len()
    }

    /// Joint angles within limits that place the flange at a target in the base, nearest to `near`.
    /// Without a closed form: the first numerical solution from `near`, then from `others`.
    pub(super) fn solve(&self, target: &Pose, near: &[f64], others: &[f64]) -> Option<Vec<f64>> {
        if let Some(solver) = &self.inverse {
            return solver.nearest(target, &angles(near)).map(Vec::from);
        }
        let mut starts = std::iter::once(near).chain(others.chunks_exact(self.count()));
        starts.find_map(|start| descend(&self.chain, target, start))
    }

    fn closed_form(&self) -> PyResult<&Inverse> {
        let inverse = self.inverse.as_ref();
        inverse.ok_or_else(|| PyValueError::new_err("This arm has no closed-form inverse."))
    }
}

#[pymethods]
impl ArmChain {
    /// Arm from joints, as rows of a, d, α, θ, minimum and maximum angle; the flange's pose in the
    /// last joint; links, as rows of frame, both ends and radius; pairs of links to compare; fixed
    /// poses [n 4 4] in the frame before each joint from which its parameters start.
    #[new]
    #[pyo3(signature = (joints, flange, links, pairs, placements=None))]
    fn new(
        joints: PyReadonlyArray2<'_, f64>,
        flange: PyReadonlyArray2<'_, f64>,
        links: PyReadonlyArray2<'_, f64>,
        pairs: Vec<(usize, usize)>,
        placements: Option<PyReadonlyArray3<'_, f64>>,
    ) -> PyResult<Self> {
        let joints = rows(&joints, 6)?;
        let joint = |j: &[f64]| Joint::new(j[0], j[1], j[2], j[3], (j[4], j[5]));
        let mut chain = Chain {
            joints: joints.chunks_exact(6).map(joint).collect(),
            flange: pose(&square(&flange, 4)?),
        };
        let placements = placements.map_or(Ok(vec![]), |array| poses(&array))?;
        for (joint, placement) in chain.joints.iter_mut().zip(placements) {
            joint.placement = Some(placement);
        }
        let links = rows(&links, 8)?;
        let vector = |l: &[f64]| DVec3::new(l[0], l[1], l[2]);
        let link = |l: &[f64]| LinkCapsule {
            frame: l[0] as usize,
            ends: [vector(&l[1..4]), vector(&l[4..7])],
            radius: l[7],
        };
        let capsules: Vec<_> = links.chunks_exact(8).map(link).collect();
        if chain.joints.is_empty() {
            return Err(PyValueError::new_err("An arm needs at least one joint."));
        }
        let most = chain.joints.len() + 1;
        if capsules.iter().any(|c| c.frame > most)
            || pairs.iter().any(|&(i, j)| i.max(j) >= capsules.len())
        {
            return Err(PyValueError::new_err("A link or pair has an index out of range."));
        }
        let obstacles = Obstacles { capsules, pairs, table: None };
        Ok(ArmChain { inverse: Inverse::new(&chain), chain, obstacles })
    }

    /// True if the arm's geometry permits the closed-form inverse of this module.
    #[getter]
    fn has_closed_form(&self) -> bool {
        self.inverse.is_some()
    }

    /// Poses [k n+1 4 4] of the joints' frames and of the flange in the base, for angles [k n].
    fn frames<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let n = self.count();
        let angles = rows(&angles, n)?;
        let each: Vec<&[f64]> = angles.chunks_exact(n).collect();
        let frames = map(py, &each, CHUNK, |q| {
            let mut frames = Vec::with_capacity(n + 1);
            self.chain.frames(q, &mut frames);
            frames.iter().flat_map(Pose::rows).collect::<Vec<f64>>()
        });
        array(py, &[each.len(), n + 1, 4, 4], frames.concat())
    }

    /// Jacobian [k 6 n]: velocity of the flange's origin, then angular velocity, in the base.
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let n = self.count();
        let angles = rows(&angles, n)?;
        let (mut frames, mut columns) = (Vec::new(), Vec::new());
        let mut flat = Vec::with_capacity(6 * angles.len());
        for q in angles.chunks_exact(n) {
            self.chain.frames(q, &mut frames);
            self.chain.jacobian(&frames, &mut columns);
            flat.extend((0..6).flat_map(|row| columns.iter().map(move |column| column[row])));
        }
        array(py, &[angles.len() / n, 6, n], flat)
    }

    /// All branches [k 8 7] within limits for targets [k 4 4] and last angles [k], padded by NaN.
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        targets: PyReadonlyArray3<'py, f64>,
        last: Vec<f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let solver = self.closed_form()?;
        let targets = poses(&targets)?;
        if targets.len() != last.len() {
            return Err(PyValueError::new_err("One last angle per target is needed."));
        }
        let mut flat = Vec::with_capacity(targets.len() * BRANCHES * JOINTS);
        for (target, &q7) in targets.iter().zip(&last) {
            let mut found = All::default();
            solver.solve(target, q7, &mut found);
            found.angles[..found.count].iter().for_each(|a| flat.extend(a));
            flat.extend(std::iter::repeat_n(f64::NAN, (BRANCHES - found.count) * JOINTS));
        }
        array(py, &[targets.len(), BRANCHES, JOINTS], flat)
    }

    /// Joint angles [k n] nearest to `near` [k n] for each target [k 4 4]; NaN without a solution.
    /// An arm without a closed form starts from `near`, then from other angles [m n].
    #[pyo3(signature = (targets, near, others=None))]
    fn nearest<'py>(
        &self,
        py: Python<'py>,
        targets: PyReadonlyArray3<'py, f64>,
        near: PyReadonlyArray2<'py, f64>,
        others: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let n = self.count();
        let (targets, near, others) = (poses(&targets)?, rows(&near, n)?, all_rows(others, n)?);
        if targets.len() * n != near.len() {
            return Err(PyValueError::new_err("One start per target is needed."));
        }
        let each: Vec<(&Pose, &[f64])> = targets.iter().zip(near.chunks_exact(n)).collect();
        let solved = map(py, &each, CHUNK, |(target, near)| {
            self.solve(target, near, &others).unwrap_or_else(|| vec![f64::NAN; n])
        });
        array(py, &[targets.len(), n], solved.concat())
    }

    /// Joint angles [k n] along a path of targets [k 4 4]: each nearest to the previous ones; NaN
    /// from the first pose without a solution.
    #[pyo3(signature = (targets, start, others=None))]
    fn follow<'py>(
        &self,
        py: Python<'py>,
        targets: PyReadonlyArray3<'py, f64>,
        start: Vec<f64>,
        others: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let n = self.count();
        let (targets, others) = (poses(&targets)?, all_rows(others, n)?);
        if start.len() != n {
            return Err(PyValueError::new_err("One angle per joint is needed."));
        }
        let mut at = Some(start);
        let mut flat = Vec::with_capacity(targets.len() * n);
        for target in &targets {
            at = at.and_then(|near| self.solve(target, &near, &others));
            flat.extend(at.clone().unwrap_or_else(|| vec![f64::NAN; n]));
        }
        array(py, &[targets.len(), n], flat)
    }

    /// Minimum distances [k 2] between the arm's own links, and to a table (a point on it and its
    /// outward normal, in the base), for angles [k n].
    #[pyo3(signature = (angles, table=None))]
    fn clearance<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray2<'py, f64>,
        table: Option<([f64; 3], [f64; 3])>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let n = self.count();
        let angles = rows(&angles, n)?;
        let table = table.map(|(p, normal)| (DVec3::from(p), DVec3::from(normal)));
        let obstacles = Obstacles { table, ..self.obstacles.clone() };
        let mut frames = Vec::new();
        let mut flat = Vec::with_capacity(2 * angles.len() / n);
        for q in angles.chunks_exact(n) {
            self.chain.frames(q, &mut frames);
            flat.extend(<[f64; 2]>::from(obstacles.clearance(&frames)));
        }
        array(py, &[angles.len() / n, 2], flat)
    }
}
