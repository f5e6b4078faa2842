//! How much light the wall throws back by the angle at which it comes or goes.

use crate::lanes::*;
use crate::material::{Led, Material, Surface, add_light};

/// Steps of the cosine in the tables.
const STEPS: usize = 32;
/// Rings around the mirrored direction over which is integrated.
const RINGS: usize = 96;
/// Angle between half vector and normal of the innermost ring [rad].
const FIRST_RING: f32 = 1e-4;

/// Share of light from one direction that goes anywhere, or of even light from everywhere that goes
/// to one direction (they are the same by reciprocity), over the cosine of that direction.
pub struct Reflectance {
    /// Of the diffuse base for an albedo of 1.
    pub base: [f32; STEPS + 1],
    /// Of what is not coloured by the base: specular lobe and coat.
    pub gloss: [f32; STEPS + 1],
    /// Of both for even light from everywhere, to everywhere.
    pub mean: [f32; 2],
}

impl Reflectance {
    /// Integrates the wall's reflection over all directions of light.
    pub fn integrate(material: &Material, roughness: f32) -> Self {
        let (mut base, mut gloss) = ([0.0; STEPS + 1], [0.0; STEPS + 1]);
        for step in 0..=STEPS {
            let cosine = max(step as f32 / STEPS as f32, 0.02);
            let [colored, all] = share(material, roughness, cosine);
            base[step] = max(all - colored, 0.0);
            gloss[step] = clamp(colored, 0.0, 1.0);
        }
        let mean = [&base, &gloss].map(|table| {
            let part = |k: usize| {
                let weight = if k == 0 || k == STEPS { 0.5 } else { 1.0 };
                weight * 2.0 * table[k] * k as f32 / (STEPS * STEPS) as f32
            };
            (0..=STEPS).map(part).sum()
        });
        Reflectance { base, gloss, mean }
    }

    /// Base and gloss at a cosine of 0 to 1.
    #[inline(always)]
    pub fn at(&self, cosine: f32) -> [f32; 2] {
        let place = clamp(cosine, 0.0, 0.9999) * STEPS as f32;
        let k = place as usize;
        let t = place - k as f32;
        [&self.base, &self.gloss].map(|table| table[k] + t * (table[k + 1] - table[k]))
    }
}

/// What leaves towards a cosine under light of radiance 1 from everywhere: of a black base, and of
/// a white one.
///
/// Half vectors on rings whose angle grows by the same factor find the narrow lobe of the coat. An
/// element of half vectors is an element of light of 4 (v·h) times its size.
fn share(material: &Material, roughness: f32, cosine: f32) -> [f32; 2] {
    let view = [(1.0 - cosine * cosine).sqrt(), 0.0, cosine];
    let led =
        Led { position: [0.0; 3], direction: [0.0, 0.0, 1.0], intensity: [1.0; 3], exponent: 0.0 };
    let growth = (std::f32::consts::FRAC_PI_2 / FIRST_RING).powf(1.0 / RINGS as f32);
    let mut total = [0.0f64; 2];
    for ring in 0..RINGS {
        let inner = FIRST_RING * growth.powi(ring as i32);
        let angle = inner * growth.sqrt();
        let element = (inner.cos() - (inner * growth).cos()) * std::f32::consts::TAU / LANES as f32;
        let mut surface = Surface {
            position: [[0.0; LANES]; 3],
            normal: [[0.0; LANES], [0.0; LANES], [1.0; LANES]],
            view: view.map(|x| [x; LANES]),
            albedo: [[0.0; LANES], [1.0; LANES], [0.0; LANES]],
            roughness: [roughness; LANES],
        };
        let (mut lit, mut weight) = ([true; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let turn = std::f32::consts::TAU * (i as f32 + 0.5) / LANES as f32;
            let half = [angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos()];
            let towards = dot(view, half);
            let light = sub(scale(half, 2.0 * towards), view);
            lit[i] = towards > 0.0 && light[2] > 0.0;
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

    #[test]
    fn reflects_between_nothing_and_all() {
        let material = Material { ior: 1.4, coat: 1.0, coat_alpha: 0.0079 };
        let table = Reflectance::integrate(&material, 0.6);
        println!("{:?}\n{:?}\n{:?}", table.base, table.gloss, table.mean);
        assert!(table.base.iter().all(|&x| (0.4..1.4).contains(&x)));
        assert!(table.gloss.windows(2).all(|w| w[1] <= w[0] + 1e-3));
        assert!(table.mean[0] > 0.8 && table.mean[0] < 1.1);
        assert!(table.mean[1] > 0.03 && table.mean[1] < 0.2);
    }
}
