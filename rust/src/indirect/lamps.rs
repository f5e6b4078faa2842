//! Light from the LEDs to the sites: each LED sends rays of equal power.

use super::QuickLight;
use super::lobe::Lobe;
use super::sites::nearest_corner;
use crate::lanes::*;
use crate::material::Led;
use crate::path::ray;
use crate::wall::Wall;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Rays of all LEDs together, about.
const RAYS: usize = 1536;
/// Fewest rays of an LED are the square of this.
const LEAST_SIDE: usize = 8;

/// Where a ray ends: a site, and the cosine at which the light comes there.
type End = (u32, f32);

/// Power of the LEDs' light that each site reflects [W], by site; unlit sites are left out.
pub fn first_reflection(light: &QuickLight, wall: &Wall, leds: &[Led]) -> Vec<(u32, Vec3)> {
    let side = ((RAYS as f32 / leds.len().max(1) as f32).sqrt() as usize).max(LEAST_SIDE);
    let rings: Vec<Vec<End>> = (0..leds.len() * side)
        .into_par_iter()
        .map(|k| {
            let (number, ring) = (k / side, k % side);
            // LEDs are close together: their patterns are turned against each other.
            let led = &leds[number];
            let lobe = Lobe::turned(led.direction, led.exponent, side, number);
            send(light, wall, led.position, &lobe, ring, side)
        })
        .collect();
    let mut power = Vec::with_capacity(leds.len() * side * side);
    for (led, ends) in leds.iter().zip(rings.chunks(side)) {
        let solid_angle = if led.exponent == 0.0 { 2.0 * TAU } else { TAU / (led.exponent + 1.0) };
        let ray = scale(led.intensity, solid_angle / (side * side) as f32);
        for &(site, cosine) in ends.iter().flatten() {
            let [base, gloss] = light.reflectance.at(cosine);
            let albedo = light.albedo[site as usize];
            power.push((site, [0, 1, 2].map(|k| ray[k] * (base * albedo[k] + gloss))));
        }
    }
    power.sort_by_key(|&(site, _)| site);
    let total = |run: &[(u32, Vec3)]| (run[0].0, run.iter().fold([0.0; 3], |s, p| add(s, p.1)));
    power.chunk_by(|a, b| a.0 == b.0).map(total).collect()
}

/// Where the rays of one ring of a lobe end.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn send(
    light: &QuickLight,
    wall: &Wall,
    origin: Vec3,
    lobe: &Lobe,
    ring: usize,
    side: usize,
) -> Vec<End> {
    let mut ends = Vec::with_capacity(side);
    for column in 0..side {
        let direction = lobe.direction(ring, column);
        let hit = ray::cast::<false>(&wall.bvh, origin, direction, f32::MAX, u32::MAX);
        // The back of a wall is dark.
        if let Some(hit) = hit.filter(|hit| hit.edges[2] < 0.0) {
            let vertex = nearest_corner(wall, hit.triangle, hit.edges);
            let cosine = max(-dot(direction, wall.normals[vertex]), 0.0);
            ends.push((light.sites.of_vertex[vertex], cosine));
        }
    }
    ends
}
