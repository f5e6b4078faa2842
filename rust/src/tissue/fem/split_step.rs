//! Step of a layer in two parts, for loads that depend on its motion.

use super::Outcome;
use super::layer::FemLayer;
use super::sparse::add_scaled;
use glam::{DMat3, DVec3};

impl FemLayer {
    /// Velocities at the end of a step of `dt` [s] under forces on the free nodes [N], solved to
    /// `tolerance` [m]. The layer itself is unchanged.
    pub fn predict(&mut self, force: &[DVec3], dt: f64, tolerance: f64) -> Outcome<Vec<DVec3>> {
        self.prepare(dt)?;
        match self.body.elements {
            Some(_) => self.nonlinear_step(force, self.velocity.clone(), dt, tolerance),
            None => Ok(self.linear_step(force, dt)),
        }
    }

    /// Predicted velocities corrected for other forces, which add the momentum `gained` [N·s].
    pub fn correct(
        &mut self,
        predicted: Vec<DVec3>,
        force: &[DVec3],
        mut gained: Vec<DVec3>,
        dt: f64,
        tolerance: f64,
    ) -> Outcome<Vec<DVec3>> {
        if gained.iter().all(|p| *p == DVec3::ZERO) {
            return Ok(predicted);
        }
        if self.is_linear() {
            self.solve(&mut gained);
            add_scaled(&predicted, 1.0, &mut gained);
            return Ok(gained);
        }
        self.nonlinear_step(force, predicted, dt, tolerance)
    }

    /// Ends a step of `dt` [s] with these velocities.
    pub fn advance(&mut self, velocity: Vec<DVec3>, dt: f64) {
        self.velocity = velocity;
        add_scaled(&self.velocity, dt, &mut self.displacement);
    }

    /// Change of the velocity of every node at the end of a step of `dt` by a force on one node
    /// [m/s per N]; for the stiffness at rest.
    ///
    /// Each node is solved for separately, so that its bytes do not depend on the other requests.
    pub fn mobility(&mut self, node: u32, dt: f64) -> Outcome<Vec<DMat3>> {
        self.prepare(dt)?;
        let columns = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| {
            let mut column = vec![DVec3::ZERO; self.displacement.len()];
            column[node as usize] = dt * axis;
            column
        });
        let [x, y, z] = self.solve_three(columns);
        Ok(x.iter().zip(&y).zip(&z).map(|((x, y), z)| DMat3::from_cols(*x, *y, *z)).collect())
    }
}
