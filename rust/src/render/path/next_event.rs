//! Next event estimation: light of one LED at each surface that paths hit.

use crate::render::led::Led;
use crate::render::path::shadow_rays::{ShadowRay, ShadowRays};
use crate::render::path::sobol::{DISC_DIMENSION, dimension, point};
use crate::render::path::tracer::{Path, Tracer};
use crate::simd::f32x64::*;

impl Tracer<'_> {
    /// Requests a shadow ray to one LED from each surface that `paths` hit; `light` adds the
    /// radiance that an unoccluded LED reflects there.
    #[inline(always)]
    pub(super) fn request_led_light(
        &self,
        reflection: u32,
        position: &Lane3,
        light: impl Fn(&Led, &mut Lane3),
        paths: &[Path],
        requests: &mut ShadowRays,
    ) {
        let mut throughput = [[0.0; LANES]; 3];
        let mut number = [0.0; LANES];
        for (i, path) in paths.iter().enumerate() {
            number[i] = point(dimension(path.key, 4 * reflection + 2), path.sample)[0];
            for k in 0..3 {
                throughput[k][i] = path.throughput[k];
            }
        }
        let light = self.choose_led(light, &throughput, number);
        for (i, path) in paths.iter().enumerate().filter(|&(i, _)| light.weight[i] > 0.0) {
            let factor = light.total[i] / light.weight[i];
            let radiance = at(&light.radiance, i);
            requests.pending.push(ShadowRay {
                point: at(position, i),
                light: [0, 1, 2].map(|k| path.throughput[k] * radiance[k] * factor),
                pixel: path.pixel,
                led: light.led[i],
                start: self.led_point(path, reflection, light.led[i]),
            });
        }
    }

    /// Start of a path's shadow ray on an LED's disc, relative to the LED's center [m].
    #[inline(always)]
    fn led_point(&self, path: &Path, reflection: u32, led: u32) -> Vec3 {
        let key = dimension(path.key, DISC_DIMENSION + reflection);
        self.transport.leds[led as usize].offset(point(key, path.sample))
    }

    /// Chooses one LED for each lane in proportion to its unoccluded contribution to the pixel.
    #[inline(always)]
    fn choose_led(
        &self,
        light: impl Fn(&Led, &mut Lane3),
        throughput: &Lane3,
        mut number: Lane,
    ) -> ChosenLed {
        let mut out = ChosenLed {
            led: [0; LANES],
            radiance: [[0.0; LANES]; 3],
            weight: [0.0; LANES],
            total: [0.0; LANES],
        };
        for (led_number, led) in self.transport.leds.iter().enumerate() {
            let mut radiance = [[0.0; LANES]; 3];
            light(led, &mut radiance);
            for i in 0..LANES {
                let [r, g, b] = at(throughput, i);
                let weight = r * radiance[0][i] + g * radiance[1][i] + b * radiance[2][i];
                let total = out.total[i] + weight;
                let probability = if total > 0.0 { weight / total } else { 0.0 };
                // One random number makes all choices: within each outcome it is uniform again.
                let chosen = number[i] < probability;
                number[i] = if chosen {
                    number[i] / probability
                } else {
                    (number[i] - probability) / max(1.0 - probability, 1e-7)
                };
                out.total[i] = total;
                out.led[i] = if chosen { led_number as u32 } else { out.led[i] };
                out.weight[i] = if chosen { weight } else { out.weight[i] };
                for k in 0..3 {
                    out.radiance[k][i] = if chosen { radiance[k][i] } else { out.radiance[k][i] };
                }
            }
        }
        out
    }
}

/// One LED for each lane.
struct ChosenLed {
    led: [u32; LANES],
    /// Radiance that the surface reflects of its light.
    radiance: Lane3,
    /// Weights of the choice: of this LED, and the sum over all.
    weight: Lane,
    total: Lane,
}
