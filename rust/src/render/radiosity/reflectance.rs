//! Directional reflectance of the wall as a function of the angle of incidence or exitance.

use crate::render::led::Led;
use crate::render::material::{Material, Surface, add_light};
use crate::simd::f32x64::*;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Number of directions at which the reflectance is computed; it is smooth in between.
const NODES: usize = 5;
/// Number of steps of the mean over directions.
const STEPS: usize = 64;
/// Number of rings around the mirror direction in the integral.
const RINGS: usize = 96;
/// Angle between half vector and normal of the innermost ring [rad].
const FIRST_RING: f32 = 1e-4;

/// Fraction of light from one direction that is reflected, or of diffuse light that is reflected in
/// one direction (equal by reciprocity), as a function of the cosine of that direction.
pub struct Reflectance {
    /// Reflectance of the diffuse base for an albedo of 1.
    base: Quartic,
    /// Reflectance that the base does not color: specular lobe and clearcoat.
    gloss: Quartic,
    /// Reflectance of both for diffuse light, over all directions.
    pub mean: [f32; 2],
}

/// A polynomial of 1 − cosine, by Newton's divided differences.
struct Quartic {
    nodes: [f32; NODES],
    differences: [f32; NODES],
}

impl Quartic {
    fn through(nodes: [f32; NODES], values: [f32; NODES]) -> Self {
        let mut differences = values;
        for order in 1..NODES {
            for k in (order..NODES).rev() {
                differences[k] =
                    (differences[k] - differences[k - 1]) / (nodes[k] - nodes[k - order]);
            }
        }
        Quartic { nodes, differences }
    }

    #[inline(always)]
    fn at(&self, x: f32) -> f32 {
        let mut value = self.differences[NODES - 1];
        for k in (0..NODES - 1).rev() {
            value = self.differences[k] + (x - self.nodes[k]) * value;
        }
        value
    }

    /// Mean over diffuse light, weighted by the cosine.
    fn mean(&self) -> f32 {
        let part = |k: usize| {
            let cosine = (k as f32 + 0.5) / STEPS as f32;
            self.at(1.0 - cosine) * 2.0 * cosine / STEPS as f32
        };
        (0..STEPS).map(part).sum()
    }
}

impl Reflectance {
    /// Integrates the wall's reflection over all incident directions.
    pub fn integrate(material: &Material, roughness: f32) -> Self {
        // Chebyshev nodes.
        let nodes: [f32; NODES] = std::array::from_fn(|k| {
            0.5 - 0.5 * ((2 * k + 1) as f32 * PI / (2 * NODES) as f32).cos()
        });
        let albedos = nodes.map(|x| albedo(material, roughness, 1.0 - x));
        let base = Quartic::through(nodes, albedos.map(|[gloss, all]| max(all - gloss, 0.0)));
        let gloss = Quartic::through(nodes, albedos.map(|[gloss, _]| gloss));
        let mean = [base.mean(), gloss.mean()];
        Reflectance { base, gloss, mean }
    }

    /// Replaces the reflectance of the base, for an albedo of 1, by a function of the cosine.
    pub fn set_base(&mut self, albedo: impl Fn(f32) -> f32) {
        self.base = Quartic::through(self.base.nodes, self.base.nodes.map(|x| albedo(1.0 - x)));
        self.mean[0] = self.base.mean();
    }

    /// Reflectance of base and gloss at a cosine of 0 to 1.
    #[inline(always)]
    pub fn at(&self, cosine: f32) -> [f32; 2] {
        let x = clamp(1.0 - cosine, 0.0, 1.0);
        [max(self.base.at(x), 0.0), max(self.gloss.at(x), 0.0)]
    }
}

/// Radiance towards a cosine under uniform light of radiance 1: of a black base, and of a white
/// base.
///
/// Half vectors on rings whose angle grows by a constant factor resolve the narrow lobe of the
/// clearcoat. An element of light directions is 4 (v·h) times the element of half vectors.
fn albedo(material: &Material, roughness: f32, cosine: f32) -> [f32; 2] {
    let view = [(1.0 - cosine * cosine).sqrt(), 0.0, cosine];
    let led = Led {
        position: [0.0; 3],
        direction: [0.0, 0.0, 1.0],
        intensity: [1.0; 3],
        exponent: 0.0,
        radius: 0.0,
    };
    let growth = (FRAC_PI_2 / FIRST_RING).powf(1.0 / RINGS as f32);
    let mut total = [0.0f64; 2];
    for ring in 0..RINGS {
        let inner = FIRST_RING * growth.powi(ring as i32);
        let angle = inner * growth.sqrt();
        let element = (inner.cos() - (inner * growth).cos()) * TAU / LANES as f32;
        let mut surface = Surface {
            position: [[0.0; LANES]; 3],
            normal: [[0.0; LANES], [0.0; LANES], [1.0; LANES]],
            view: view.map(|x| [x; LANES]),
            albedo: [[0.0; LANES], [1.0; LANES], [0.0; LANES]],
            roughness: [roughness; LANES],
        };
        let (mut lit, mut weight) = ([1.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let turn = TAU * (i as f32 + 0.5) / LANES as f32;
            let half = [angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos()];
            let towards = dot(view, half);
            let light = sub(scale(half, 2.0 * towards), view);
            lit[i] = f32::from(u8::from(towards > 0.0 && light[2] > 0.0));
            weight[i] = 4.0 * towards * element;
            for k in 0..3 {
                surface.position[k][i] = -light[k];
            }
        }
        let mut radiance = [[0.0; LANES]; 3];
        add_light(&surface, material, &led, &lit, &mut radiance);
        for i in 0..LANES {
            total[0] += f64::from(radiance[0][i] * weight[i]);
            total[1] += f64::from(radiance[1][i] * weight[i]);
        }
    }
    total.map(|x| x as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reflectances of a wet wall by cosine, from another program.
    const EXACT: [[f32; 3]; 4] =
        [[0.125, 1.106, 0.089], [0.375, 1.039, 0.063], [0.625, 1.014, 0.047], [1.0, 1.018, 0.055]];

    #[test]
    fn agrees_with_another_program() {
        let material = Material { ior: 1.4, clearcoat: 1.0, clearcoat_alpha: 0.1 - 0.099 * 0.93 };
        let found = Reflectance::integrate(&material, 0.64);
        for [cosine, base, gloss] in EXACT {
            let [ours, shine] = found.at(cosine);
            assert!((ours - base).abs() < 0.01 && (shine - gloss).abs() < 0.003, "{cosine}");
        }
        assert!((found.mean[0] - 1.03).abs() < 0.02 && (found.mean[1] - 0.055).abs() < 0.01);
    }
}
