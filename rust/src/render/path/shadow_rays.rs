//! Shadow rays to the LEDs, requested one by one and traced together.
//!
//! Shadow rays from one LED share their origin. Sorted by direction, 64 neighbors form a narrow
//! packet, and are traced like a tile of an image.

use crate::render::led::Led;
use crate::render::led_visibility::lanes_of;
use crate::render::path::tracer::Tracer;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::disc_visibility::{DiscRays, visible_from_disc};
use crate::wall::packet::{Hits, MISS, Pyramid, trace_at_most};
use crate::wall::ray;
use crate::wall::visibility::{SHADOW_REACH, shadow_segments};

/// Number of cells along each side of the square by which directions are sorted.
const DIRECTION_CELLS: u32 = 16;
/// Minimum rays and sine of the maximum half angle of a packet; others are traced one by one.
const MIN_PACKET: usize = 6;
const MAX_PACKET_SINE: f32 = 0.6;
/// Number of triangles after which the remaining rays are traced one by one: where triangles are
/// small, a packet visits more of them than its rays do.
const MAX_TRIANGLES: u32 = 300;

/// Light from an LED to a point, with its pixel.
#[derive(Clone, Copy)]
pub struct ShadowRay {
    /// Point on the wall [m].
    pub point: Vec3,
    /// Contribution to the pixel if it is unoccluded.
    pub light: Vec3,
    /// Index of the pixel among the sums.
    pub pixel: u32,
    /// Index of the LED.
    pub led: u32,
    /// Start of the ray relative to the LED's center [m].
    pub start: Vec3,
}

/// Requests of one wavefront; its memory is reused.
#[derive(Default)]
pub struct ShadowRays {
    /// Requests since the last `resolve`.
    pub pending: Vec<ShadowRay>,
    keys: Vec<u32>,
    starts: Vec<u32>,
    order: Vec<u32>,
}

impl ShadowRays {
    /// Adds the unoccluded light to `sums` and clears all requests.
    #[inline(always)]
    pub fn resolve(&mut self, tracer: &Tracer<'_>, sums: &mut [[f64; 3]]) {
        let leds = tracer.transport.leds;
        self.sort(leds);
        let mut rest = &self.order[..];
        while let Some(&first) = rest.first() {
            let led = self.pending[first as usize].led;
            let most = rest.len().min(LANES);
            let same = |&number: &u32| self.pending[number as usize].led == led;
            let count = rest[..most].iter().take_while(|number| same(number)).count();
            let (chunk, after) = rest.split_at(count);
            let led = &leds[led as usize];
            let lit = self.unoccluded(tracer.transport.wall, led, chunk);
            for (&number, _) in chunk.iter().zip(lit).filter(|&(_, lit)| lit) {
                let ShadowRay { point, light, pixel, start, .. } = self.pending[number as usize];
                let start = add(led.position, start);
                let left = tracer.media.as_ref().map(|a| a.led_transmittance(start, point));
                let left = left.unwrap_or([1.0; 3]);
                for k in 0..3 {
                    sums[pixel as usize][k] += f64::from(light[k] * left[k]);
                }
            }
            rest = after;
        }
        self.pending.clear();
    }

    /// Tests which of up to `LANES` rays from one LED are unoccluded.
    #[inline(always)]
    fn unoccluded(&self, wall: &Wall, led: &Led, chunk: &[u32]) -> [bool; LANES] {
        let (mut points, mut starts) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let mut used = [false; LANES];
        for (i, &number) in chunk.iter().enumerate() {
            used[i] = true;
            for k in 0..3 {
                points[k][i] = self.pending[number as usize].point[k];
                starts[k][i] = self.pending[number as usize].start[k];
            }
        }
        let center = led.position;
        let (directions, reach) = shadow_segments(center, &points, &used);
        let pyramid = Pyramid::around(directions, &used);
        let width = pyramid.sides.iter().fold(0.0, |w, &side| max(w, dot(side, pyramid.axis)));
        let is_narrow = pyramid.closed && width < MAX_PACKET_SINE && chunk.len() >= MIN_PACKET;
        let (mut lit, mut is_done) = (used, false);
        if is_narrow && led.radius > 0.0 {
            let rays = DiscRays { center, radius: led.radius, starts: &starts, ends: &points };
            let (bits, all) = visible_from_disc(wall, &rays, &used, MAX_TRIANGLES);
            (lit, is_done) = (lanes_of(bits), all);
        } else if is_narrow {
            let mut hits = Hits::within(reach);
            let (bvh, extent) = (&wall.bvh, wall.extent);
            is_done =
                trace_at_most::<true>(MAX_TRIANGLES, bvh, center, &pyramid, extent, &mut hits);
            lit = std::array::from_fn(|i| used[i] & (hits.triangle[i] == MISS));
        }
        for i in 0..chunk.len() {
            if lit[i] & !is_done {
                let start = add(center, at(&starts, i));
                let way = sub(at(&points, i), start);
                let distance = dot(way, way).sqrt();
                let direction = scale(way, 1.0 / max(distance, 1e-12));
                let reach = distance * SHADOW_REACH;
                lit[i] = ray::cast::<true>(&wall.bvh, start, direction, reach, MISS).is_none();
            }
        }
        lit
    }

    /// Sorts the requests by LED and direction, by counting.
    #[inline(always)]
    fn sort(&mut self, leds: &[Led]) {
        let cells = (DIRECTION_CELLS * DIRECTION_CELLS) as usize;
        self.keys.clear();
        self.keys.extend(self.pending.iter().map(|request| {
            let direction = sub(request.point, leds[request.led as usize].position);
            request.led * DIRECTION_CELLS * DIRECTION_CELLS + cell(direction)
        }));
        self.starts.clear();
        self.starts.resize(leds.len() * cells + 1, 0);
        for &key in &self.keys {
            self.starts[key as usize + 1] += 1;
        }
        for key in 1..self.starts.len() {
            self.starts[key] += self.starts[key - 1];
        }
        self.order.clear();
        self.order.resize(self.pending.len(), 0);
        for (number, &key) in self.keys.iter().enumerate() {
            let place = &mut self.starts[key as usize];
            self.order[*place as usize] = number as u32;
            *place += 1;
        }
    }
}

/// Cell of a direction of any length: the octahedron unfolded to a square (Cigolle et al. 2014),
/// with cells indexed so that consecutive ones are neighbors (Morton 1966).
#[inline(always)]
fn cell([x, y, z]: Vec3) -> u32 {
    let inverse = 1.0 / max(x.abs() + y.abs() + z.abs(), 1e-20);
    let (u, v) = (x * inverse, y * inverse);
    let folded = |a: f32, b: f32| (1.0 - b.abs()).copysign(a);
    let (u, v) = if z < 0.0 { (folded(u, v), folded(v, u)) } else { (u, v) };
    let whole =
        |a: f32| (((a + 1.0) * (0.5 * DIRECTION_CELLS as f32)) as u32).min(DIRECTION_CELLS - 1);
    let spread = |a: u32| {
        let a = (a | a << 2) & 0x33;
        (a | a << 1) & 0x55
    };
    spread(whole(u)) | spread(whole(v)) << 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_a_share_of_the_sphere() {
        let (steps, mut count) = (400, vec![0; (DIRECTION_CELLS * DIRECTION_CELLS) as usize]);
        for i in 0..steps {
            for j in 0..steps {
                let z = (2 * i + 1) as f32 / steps as f32 - 1.0;
                let angle = std::f32::consts::TAU * j as f32 / steps as f32;
                let radius = 3.0 * (1.0 - z * z).sqrt();
                count[cell([radius * angle.cos(), radius * angle.sin(), 3.0 * z]) as usize] += 1;
            }
        }
        let mean = steps * steps / count.len();
        assert!(count.iter().all(|&n| n > mean / 3 && n < mean * 3), "{count:?}");
    }
}
