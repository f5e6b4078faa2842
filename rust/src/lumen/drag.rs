//! Speed of a sphere that rises or sinks in a liquid.

use std::f64::consts::PI;

/// A liquid at rest.
#[derive(Clone, Copy)]
pub struct Medium {
    /// Density [kg/m³].
    pub density: f64,
    /// Dynamic viscosity [Pa·s].
    pub viscosity: f64,
}

impl Medium {
    /// Drag on a sphere over its speed [N·s/m]: Stokes' law with the correction of Schiller and
    /// Naumann (Z. VDI 77, 1933) up to a Reynolds number of 800, and C_d = 0.44 beyond.
    pub fn resistance(&self, radius: f64, speed: f64) -> f64 {
        let reynolds = 2.0 * self.density * speed * radius / self.viscosity;
        let stokes = 6.0 * PI * self.viscosity * radius;
        let bluff = 0.5 * 0.44 * self.density * PI * radius * radius * speed;
        (stokes * (1.0 + 0.15 * power(reynolds, 0.687))).max(bluff)
    }

    /// Upward speed at which buoyancy and drag balance, negative for a sphere that sinks [m/s].
    pub fn terminal_speed(&self, radius: f64, density: f64, gravity: f64) -> f64 {
        let lift = 4.0 / 3.0 * PI * radius.powi(3) * (self.density - density) * gravity;
        let mut speed = 0.0;
        // Drag grows with speed, so bisection finds the balance.
        let (mut low, mut high) = (0.0, lift.abs() / self.resistance(radius, 0.0));
        for _ in 0..60 {
            speed = 0.5 * (low + high);
            if self.resistance(radius, speed) * speed < lift.abs() {
                low = speed;
            } else {
                high = speed;
            }
        }
        speed.copysign(lift)
    }
}

/// `x` to the power `y`, bit-identical on every machine.
fn power(x: f64, y: f64) -> f64 {
    f64::from(crate::simd::f32x64::pow(x as f32, y as f32))
}
