//! Numerical inverse kinematics of any arm: damped least squares (Wampler 1986).

use super::kinematic_chain::{Chain, Pose};
use super::rotation::rotation_vector;
use crate::world::solve::{Symmetric6, Twist};

/// Maximum damping; near the target, the damping is the remaining distance.
const DAMPING: f64 = 1e-2;
/// Maximum number of iterations.
const STEPS: usize = 200;
/// Maximum rotation of a joint per iteration [rad].
const LONGEST_STEP: f64 = 0.3;
/// Tolerance of the pose [m and rad].
const LANDED: f64 = 1e-10;

/// Displacement [m] and rotation [rad] from one pose to another.
fn twist(from: &Pose, to: &Pose) -> [f64; 6] {
    let angular = rotation_vector(to.rotation * from.rotation.transpose());
    Twist { linear: to.position - from.position, angular }.to_array()
}

fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Joint angles within limits that place the flange at a target in the base, iterated from `start`.
pub fn descend(chain: &Chain, target: &Pose, start: &[f64]) -> Option<Vec<f64>> {
    let within = |(angle, joint): (f64, usize)| {
        let (low, high) = chain.joints[joint].limits;
        angle.clamp(low, high)
    };
    let mut angles: Vec<f64> = start.iter().copied().zip(0..).map(within).collect();
    let (mut frames, mut columns) = (Vec::new(), Vec::new());
    for _ in 0..STEPS {
        chain.frames(&angles, &mut frames);
        let error = twist(&frames[frames.len() - 1], target);
        let size = dot(&error, &error).sqrt();
        if size < LANDED {
            return Some(angles);
        }
        chain.jacobian(&frames, &mut columns);
        let mut square = Symmetric6::default();
        for (row, column) in (0..6).flat_map(|row| (0..=row).map(move |column| (row, column))) {
            square.0[row][column] = columns.iter().map(|c| c[row] * c[column]).sum();
        }
        (0..6).for_each(|k| square.0[k][k] += DAMPING.min(size).powi(2));
        let solved = square.solve(error);
        let step: Vec<f64> = columns.iter().map(|column| dot(column, &solved)).collect();
        let longest = step.iter().fold(1e-300, |most: f64, s| most.max(s.abs()));
        let part = (LONGEST_STEP / longest).min(1.0);
        let moved = angles.iter().zip(&step).map(|(angle, step)| angle + part * step);
        angles = moved.zip(0..).map(within).collect();
    }
    None
}
