//! Quasi-Newton minimization with a constant, factorized matrix as preconditioner.
//!
//! Limited-memory BFGS whose initial Hessian is that matrix (Liu, Bouaziz, Kavan, ACM Trans. Graph.
//! 36(3), 2017; Nocedal, Wright, Numerical Optimization, 2006, algorithm 7.4): it is factorized
//! once, for any change of the stiffness.

use super::sparse::{add_scaled, dot, longest};
use glam::DVec3;
use std::collections::VecDeque;

/// Number of stored pairs of steps and changes of the gradient.
const MEMORY: usize = 8;
/// Fraction of the predicted decrease that a step must reach (Armijo condition);
const GAIN: f64 = 1e-4;
/// or fraction to which the directional derivative must fall, where rounding hides the decrease.
const FLATTENED: f64 = 0.9;
/// Maximum number of halvings of a step.
const HALVINGS: usize = 30;

/// Function to minimize.
pub trait Objective {
    /// Value at `x`, infinite outside the domain; writes the gradient to `slope`.
    fn evaluate(&mut self, x: &[DVec3], slope: &mut [DVec3]) -> f64;
    /// Applies the inverse of the constant matrix.
    fn precondition(&mut self, vector: &mut [DVec3]);
}

/// Step, with the change of the gradient along it.
struct Pair {
    step: Vec<DVec3>,
    change: Vec<DVec3>,
    /// Dot product of step and change.
    curvature: f64,
}

/// Minimizes from `x`, until a full step would move no node by more than `tolerance`.
///
/// Returns the number of steps, or `None` if `most` steps do not suffice.
pub fn minimize(
    objective: &mut impl Objective,
    x: &mut Vec<DVec3>,
    tolerance: f64,
    most: usize,
) -> Option<usize> {
    let mut pairs: VecDeque<Pair> = VecDeque::with_capacity(MEMORY);
    let mut slope = vec![DVec3::ZERO; x.len()];
    let mut value = objective.evaluate(x, &mut slope);
    if !value.is_finite() {
        x.fill(DVec3::ZERO);
        value = objective.evaluate(x, &mut slope);
    }
    let (mut next, mut next_slope) = (x.clone(), slope.clone());
    for count in 0..most {
        let direction = descent(objective, &pairs, &slope);
        if longest(&direction) <= tolerance {
            add_scaled(&direction, 1.0, x);
            return Some(count + 1);
        }
        let along = dot(&slope, &direction);
        let mut share = 1.0;
        let mut found = false;
        for _ in 0..HALVINGS {
            next.copy_from_slice(x);
            add_scaled(&direction, share, &mut next);
            let reached = objective.evaluate(&next, &mut next_slope);
            let flat = dot(&next_slope, &direction).abs() <= -FLATTENED * along;
            let rounding = 1e-12 * value.abs();
            if reached <= value + GAIN * share * along || (flat && reached <= value + rounding) {
                (found, value) = (true, reached);
                break;
            }
            share *= 0.5;
        }
        if !found {
            return None;
        }
        remember(&mut pairs, x, &next, &slope, &next_slope);
        std::mem::swap(x, &mut next);
        std::mem::swap(&mut slope, &mut next_slope);
    }
    None
}

/// Search direction: the negative gradient times the approximate inverse Hessian.
fn descent(objective: &mut impl Objective, pairs: &VecDeque<Pair>, slope: &[DVec3]) -> Vec<DVec3> {
    let mut direction: Vec<DVec3> = slope.iter().map(|g| -*g).collect();
    let mut shares = [0.0; MEMORY];
    for (k, pair) in pairs.iter().enumerate().rev() {
        let share = &mut shares[k];
        *share = dot(&pair.step, &direction) / pair.curvature;
        add_scaled(&pair.change, -*share, &mut direction);
    }
    objective.precondition(&mut direction);
    for (share, pair) in shares.iter().zip(pairs) {
        let back = dot(&pair.change, &direction) / pair.curvature;
        add_scaled(&pair.step, share - back, &mut direction);
    }
    direction
}

fn remember(
    pairs: &mut VecDeque<Pair>,
    x: &[DVec3],
    next: &[DVec3],
    slope: &[DVec3],
    next_slope: &[DVec3],
) {
    let difference = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| *a - *b).collect();
    let step: Vec<DVec3> = difference(next, x);
    let change: Vec<DVec3> = difference(next_slope, slope);
    let curvature = dot(&step, &change);
    if curvature > 1e-12 * dot(&step, &step).sqrt() * dot(&change, &change).sqrt() {
        if pairs.len() == MEMORY {
            pairs.pop_front();
        }
        pairs.push_back(Pair { step, change, curvature });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stiffening spring for each node: the matrix is its stiffness at rest only.
    struct Springs;

    impl Objective for Springs {
        fn evaluate(&mut self, x: &[DVec3], slope: &mut [DVec3]) -> f64 {
            let pull = DVec3::new(3.0, -40.0, 0.5);
            let mut value = 0.0;
            for (x, slope) in x.iter().zip(slope) {
                value += (*x * *x + *x * *x * *x * *x).element_sum() - pull.dot(*x);
                *slope = 2.0 * *x + 4.0 * *x * *x * *x - pull;
            }
            value
        }
        fn precondition(&mut self, vector: &mut [DVec3]) {
            vector.iter_mut().for_each(|v| *v *= 0.5);
        }
    }

    #[test]
    fn finds_the_rest_of_stiffening_springs() {
        let mut x = vec![DVec3::ZERO; 5];
        let count = minimize(&mut Springs, &mut x, 1e-10, 100);
        assert!(count.is_some());
        let mut slope = x.clone();
        Springs.evaluate(&x, &mut slope);
        assert!(longest(&slope) < 1e-6);
        assert!(minimize(&mut Springs, &mut vec![DVec3::ZERO; 5], 0.0, 2).is_none());
    }
}
