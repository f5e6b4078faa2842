//! Direct illumination of gather points: each LED emits rays of equal power.

use super::gather_points::nearest_corner;
use super::stratified_lobe::Lobe;
use super::{Color, Radiosity};
use crate::render::led::Led;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::ray;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Approximate number of rays of all LEDs: with fewer, hot spots of LEDs near the wall are missed.
const RAYS: usize = 2592;
/// Arms of the spiral of an LED's rays (a Fibonacci number: rays of an arm are neighbors).
const ARMS: usize = 21;
/// Square root of the minimum number of rays of an LED.
const LEAST_SIDE: usize = 8;

/// Fraction of the gloss of the first reflection that counts. LEDs are next to the camera, and
/// gloss reflects their light away from both; measured against path tracing in three organs.
const GLOSS: f32 = 0.5;

/// End of a ray: a gather point, and the light of the ray that it reflects, by color [W/m²].
type End = (u32, Vec3);

/// Radiosity of each gather point by its first reflection of the LEDs' light [W/m²].
pub fn direct_illumination(light: &Radiosity, wall: &Wall, leds: &[Led]) -> Vec<Color> {
    let side = ((RAYS as f32 / leds.len().max(1) as f32).sqrt() as usize).max(LEAST_SIDE);
    let lobe = |(k, led): (usize, &Led)| Lobe::shifted(led.direction, led.exponent, side, k);
    let lobes: Vec<Lobe> = leds.iter().enumerate().map(lobe).collect();
    // Interleaves the arms of all LEDs by angle: arms of similar direction hit the same part of the
    // wall, which is then in the cache of their thread.
    let mut arms: Vec<_> = (0..leds.len() * ARMS).map(|k| (k / ARMS, k % ARMS)).collect();
    arms.sort_by(|a, b| lobes[a.0].turns(a.1).total_cmp(&lobes[b.0].turns(b.1)));
    let ends: Vec<Vec<End>> = arms
        .par_iter()
        .with_max_len(2)
        .map(|&(number, arm)| {
            let (led, lobe) = (&leds[number], &lobes[number]);
            send(light, wall, led, lobe, (arm..side * side).step_by(ARMS))
        })
        .collect();
    let mut radiosity = vec![[0.0; 4]; light.albedo.len()];
    for (gather_point, power) in ends.iter().flatten() {
        for k in 0..3 {
            radiosity[*gather_point as usize][k] += power[k];
        }
    }
    radiosity
}

/// Reflected light at the ends of some rays of a lobe.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn send(
    light: &Radiosity,
    wall: &Wall,
    led: &Led,
    lobe: &Lobe,
    rays: impl ExactSizeIterator<Item = usize>,
) -> Vec<End> {
    let solid_angle = if led.exponent == 0.0 { 2.0 * TAU } else { TAU / (led.exponent + 1.0) };
    let power = scale(led.intensity, solid_angle / lobe.count() as f32);
    let (mut ends, mut pile) = (Vec::with_capacity(rays.len()), ray::Pile::default());
    for number in rays {
        let direction = lobe.on_spiral(number);
        // Neighboring rays start at different points of the disc, by Roberts' sequence R2.
        let start = [0.754_877_7, 0.569_840_3].map(|step| (0.5 + number as f32 * step).fract());
        let ray = (add(led.position, led.offset(start)), direction);
        let hit = ray::cast_in::<false>(&mut pile, &wall.bvh, ray, f32::MAX, u32::MAX);
        // The back of a wall reflects no light.
        if let Some(hit) = hit.filter(|hit| hit.edges[2] < 0.0) {
            let vertex = nearest_corner(wall, hit.triangle, hit.edges);
            let cosine = max(-dot(direction, wall.normals[vertex]), 0.0);
            let gather_point = light.gather_points.of_vertex[vertex];
            let [base, gloss] = light.reflectance.at(cosine);
            let reflectance = light.reflected(gather_point as usize, [base, GLOSS * gloss]);
            let per_area = light.per_area[gather_point as usize];
            ends.push((gather_point, [0, 1, 2].map(|k| per_area * power[k] * reflectance[k])));
        }
    }
    ends
}
