//! Inverse magnetic actuation: the magnet pose that exerts a given wrench on a capsule:
//! `vrcaps.actuation.magnet_pose_solver`.

use super::arm_chain::array;
use crate::magnet::field_sources::{FieldSources, internal_magnets};
use crate::magnet::sources::{InternalMagnet, Source, Wrench, wrench};
use crate::poses::{pose_rows, read_pose};
use crate::world::solve::Symmetric6;
use glam::{DMat3, DQuat, DVec3};
use numpy::{PyArrayDyn, PyReadonlyArray2};
use pyo3::{exceptions::PyValueError, prelude::*};

/// Step of the central differences, in units of the distance and in radians.
const DIFFERENCE: f64 = 1e-5;
/// Maximum step, in units of the distance and in radians.
const MAX_STEP: f64 = 0.25;
/// Step below which the iteration ends, in units of the distance and in radians.
const CONVERGED: f64 = 1e-7;
/// Initial damping, and its bounds.
const DAMPING: f64 = 1e-3;
const MIN_DAMPING: f64 = 1e-9;
const MAX_DAMPING: f64 = 1e6;
/// Number of residuals: force, torque, and change of pose.
const RESIDUALS: usize = 12;

/// Target of the solver: `vrcaps.actuation.magnet_pose_solver.WrenchTarget`.
#[derive(FromPyObject)]
pub struct WrenchTarget {
    /// Force [N] in the world.
    force: [f64; 3],
    /// Torque [N·m] in the world.
    torque: [f64; 3],
    /// Weight of the force error, by direction [1/N].
    force_weight: [[f64; 3]; 3],
    /// Weight of the torque error [1/(N·m)].
    torque_weight: f64,
    /// Weight of moving the magnet by its distance to the capsule, or rotating it by a radian.
    motion_weight: f64,
}

/// Limits of the magnet: `vrcaps.actuation.magnet_pose_solver.Workspace`.
#[derive(FromPyObject)]
pub struct Workspace {
    /// Corners of the box for the magnet's center [m].
    low: [f64; 3],
    high: [f64; 3],
    /// Minimum distance from the capsule [m].
    min_distance: f64,
}

/// Problem to solve: the magnet that moves, and all constants.
struct Problem<'a> {
    target: &'a WrenchTarget,
    workspace: &'a Workspace,
    weight: DMat3,
    magnets: &'a [InternalMagnet],
    position: DVec3,
    rotation: DQuat,
    /// Wrench of the other sources.
    others: Wrench,
    start: (DVec3, DMat3),
    /// Distance that scales changes of position [m].
    scale: f64,
}

/// Force, torque and residuals of a pose.
struct Trial {
    wrench: Wrench,
    residuals: [f64; RESIDUALS],
    cost: f64,
}

fn moved(pose: (DVec3, DMat3), change: &[f64; 6], scale: f64) -> (DVec3, DMat3) {
    let turn = DVec3::new(change[3], change[4], change[5]);
    let angle = turn.length();
    let rotation = if angle > 0.0 {
        let (sine, cosine) = libm::sincos(0.5 * angle);
        let turn = DQuat::from_vec4((turn / angle * sine).extend(cosine));
        pose.1 * DMat3::from_quat(turn)
    } else {
        pose.1
    };
    (pose.0 + scale * DVec3::new(change[0], change[1], change[2]), rotation)
}

impl Problem<'_> {
    fn wrench(&self, source: &mut Source, pose: (DVec3, DMat3)) -> Wrench {
        (source.position, source.rotation) = pose;
        let mut sum =
            wrench(std::slice::from_ref(source), self.magnets, self.position, self.rotation);
        sum.force += self.others.force;
        sum.torque += self.others.torque;
        sum
    }

    fn evaluate(&self, source: &mut Source, pose: (DVec3, DMat3)) -> Trial {
        let wrench = self.wrench(source, pose);
        let force = self.weight * (wrench.force - DVec3::from(self.target.force));
        let torque = self.target.torque_weight * (wrench.torque - DVec3::from(self.target.torque));
        let displacement = self.target.motion_weight / self.scale * (pose.0 - self.start.0);
        let bend = self.target.motion_weight * (pose.1.z_axis - self.start.1.z_axis);
        let mut residuals = [0.0; RESIDUALS];
        for (k, part) in [force, torque, displacement, bend].iter().enumerate() {
            part.write_to_slice(&mut residuals[3 * k..]);
        }
        Trial { wrench, residuals, cost: residuals.iter().map(|r| r * r).sum() }
    }

    /// Clamps a pose to the box, and away from the capsule.
    fn clamp(&self, (position, rotation): (DVec3, DMat3)) -> (DVec3, DMat3) {
        let (low, high) = (DVec3::from(self.workspace.low), DVec3::from(self.workspace.high));
        let mut place = position.clamp(low, high);
        let away = place - self.position;
        let distance = away.length();
        if distance > 0.0 && distance < self.workspace.min_distance {
            place =
                (self.position + self.workspace.min_distance / distance * away).clamp(low, high);
        }
        (place, rotation)
    }

    /// Jacobian of the residuals by position and by rotations about the magnet's x and y; rotation
    /// about its axis has no effect.
    fn slopes(&self, source: &mut Source, pose: (DVec3, DMat3)) -> [[f64; RESIDUALS]; 6] {
        let mut slopes = [[0.0; RESIDUALS]; 6];
        for (k, slope) in slopes.iter_mut().enumerate().take(5) {
            let mut side = |sign: f64| {
                let mut change = [0.0; 6];
                change[k] = sign * DIFFERENCE;
                self.evaluate(source, moved(pose, &change, self.scale)).residuals
            };
            let (after, before) = (side(1.0), side(-1.0));
            for i in 0..RESIDUALS {
                slope[i] = (after[i] - before[i]) / (2.0 * DIFFERENCE);
            }
        }
        slopes
    }

    /// Levenberg-Marquardt method within the box; coordinates that would leave it are fixed at it.
    fn solve(&self, source: &mut Source, max_iterations: usize) -> ((DVec3, DMat3), Trial) {
        let mut pose = self.clamp(self.start);
        let mut best = self.evaluate(source, pose);
        let mut damping = DAMPING;
        for _ in 0..max_iterations {
            let slopes = self.hold_bounds(self.slopes(source, pose), &best, pose.0);
            let mut found = false;
            while !found && damping < MAX_DAMPING {
                let change = step(&slopes, &best.residuals, damping);
                let next = self.clamp(moved(pose, &change, self.scale));
                let tried = self.evaluate(source, next);
                found = tried.cost < best.cost;
                if found {
                    let displacement = (next.0 - pose.0).length() / self.scale;
                    let bend = (next.1.z_axis - pose.1.z_axis).length();
                    (pose, best) = (next, tried);
                    damping = (0.1 * damping).max(MIN_DAMPING);
                    if displacement + bend < CONVERGED {
                        return (pose, best);
                    }
                } else {
                    damping *= 10.0;
                }
            }
            if !found {
                break;
            }
        }
        (pose, best)
    }

    fn hold_bounds(
        &self,
        mut slopes: [[f64; RESIDUALS]; 6],
        at: &Trial,
        place: DVec3,
    ) -> [[f64; RESIDUALS]; 6] {
        for k in 0..3 {
            let rise: f64 = (0..RESIDUALS).map(|i| slopes[k][i] * at.residuals[i]).sum();
            let leaves = (place[k] <= self.workspace.low[k] && rise > 0.0)
                || (place[k] >= self.workspace.high[k] && rise < 0.0);
            if leaves {
                slopes[k] = [0.0; RESIDUALS];
            }
        }
        slopes
    }
}

/// Change of pose from the Jacobian and a damping, at most `MAX_STEP`.
fn step(slopes: &[[f64; RESIDUALS]; 6], residuals: &[f64; RESIDUALS], damping: f64) -> [f64; 6] {
    let dot = |a: &[f64; RESIDUALS], b: &[f64; RESIDUALS]| -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    };
    let mut square = Symmetric6::default();
    let mut fall = [0.0; 6];
    for row in 0..6 {
        for column in 0..=row {
            square.0[row][column] = dot(&slopes[row], &slopes[column]);
        }
        fall[row] = -dot(&slopes[row], residuals);
    }
    let largest = (0..6).map(|k| square.0[k][k]).fold(1e-30, f64::max);
    (0..6).for_each(|k| square.0[k][k] += damping * largest);
    let change = square.solve(fall);
    let length = dot6(&change).sqrt();
    let part = if length > MAX_STEP { MAX_STEP / length } else { 1.0 };
    change.map(|c| part * c)
}

fn dot6(a: &[f64; 6]) -> f64 {
    a.iter().map(|a| a * a).sum()
}

/// Pose [4 4] of a source, force [N], torque [N·m], maximum torque of the field [N·m].
type Solution<'py> = (Bound<'py, PyArrayDyn<f64>>, [f64; 3], [f64; 3], f64);

/// Pose of source `index`, near its current one, with which all sources exert the target wrench, as
/// closely as possible, on a body at a pose [4 4] with magnets [k 6].
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn solve_magnet_pose<'py>(
    py: Python<'py>,
    sources: PyRef<'py, FieldSources>,
    index: usize,
    magnets: PyReadonlyArray2<'py, f64>,
    pose: PyReadonlyArray2<'py, f64>,
    start: PyReadonlyArray2<'py, f64>,
    target: WrenchTarget,
    workspace: Workspace,
    max_iterations: usize,
) -> PyResult<Solution<'py>> {
    let magnets = internal_magnets(&magnets)?;
    let (turn, position) = read_pose(&pose)?;
    let start = read_pose(&start)?;
    let rotation = DQuat::from_mat3(&turn);
    let mut others = sources.sources.clone();
    if index >= others.len() {
        return Err(PyValueError::new_err(format!("No source {index} of {}.", others.len())));
    }
    let mut source = others.remove(index);
    let problem = Problem {
        target: &target,
        workspace: &workspace,
        weight: DMat3::from_cols_array_2d(&target.force_weight).transpose(),
        magnets: &magnets,
        position,
        rotation,
        others: wrench(&others, &magnets, position, rotation),
        start: (start.1, start.0),
        scale: (start.1 - position).length().max(workspace.min_distance),
    };
    let ((place, turned), best) = problem.solve(&mut source, max_iterations);
    let rows = array(py, &[4, 4], pose_rows(&turned, place).to_vec())?;
    let (force, torque) = (best.wrench.force.to_array(), best.wrench.torque.to_array());
    Ok((rows, force, torque, best.wrench.hold))
}
