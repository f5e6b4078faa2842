//! Light from the LEDs to the sites: each LED sends rays of equal power.

use super::lobe::Lobe;
use super::sites::nearest_corner;
use super::{Color, QuickLight};
use crate::lanes::*;
use crate::material::Led;
use crate::path::ray;
use crate::wall::Wall;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Rays of all LEDs together, about: fewer miss hot spots where LEDs are near the wall.
const RAYS: usize = 1536;
/// Arms of the spiral of an LED's rays (Fibonacci's number, so that those of an arm are neighbours).
const ARMS: usize = 21;
/// Fewest rays of an LED are the square of this.
const LEAST_SIDE: usize = 8;

/// Share of the gloss of the first reflection that counts. LEDs are beside the camera, and gloss
/// throws their light on, away from both; measured against path tracing in three organs.
const GLOSS: f32 = 0.7;

/// What a ray leaves: a site, and of the light of each colour the share that it reflects [1/m²].
type End = (u32, Vec3);

/// Radiosity of each site by its first reflection of the LEDs' light [W/m²].
pub fn first_reflection(light: &QuickLight, wall: &Wall, leds: &[Led]) -> Vec<Color> {
    let side = ((RAYS as f32 / leds.len().max(1) as f32).sqrt() as usize).max(LEAST_SIDE);
    let parts: Vec<Vec<End>> = (0..leds.len() * ARMS)
        .into_par_iter()
        .with_max_len(2)
        .map(|k| {
            let (number, arm) = (k / ARMS, k % ARMS);
            let led = &leds[number];
            let lobe = Lobe::shifted(led.direction, led.exponent, side, number);
            send(light, wall, led.position, &lobe, (arm..side * side).step_by(ARMS))
        })
        .collect();
    let mut leaving = vec![[0.0; 4]; light.albedo.len()];
    for (led, ends) in leds.iter().zip(parts.chunks(ARMS)) {
        let solid_angle = if led.exponent == 0.0 { 2.0 * TAU } else { TAU / (led.exponent + 1.0) };
        let ray = scale(led.intensity, solid_angle / (side * side) as f32);
        for (site, shares) in ends.iter().flatten() {
            for k in 0..3 {
                leaving[*site as usize][k] += ray[k] * shares[k];
            }
        }
    }
    leaving
}

/// What some of the rays of a lobe leave where they end.
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
    rays: impl ExactSizeIterator<Item = usize>,
) -> Vec<End> {
    let (mut ends, mut pile) = (Vec::with_capacity(rays.len()), ray::Pile::default());
    for direction in rays.map(|k| lobe.on_spiral(k)) {
        let way = (origin, direction);
        let hit = ray::cast_in::<false>(&mut pile, &wall.bvh, way, f32::MAX, u32::MAX);
        // The back of a wall is dark.
        if let Some(hit) = hit.filter(|hit| hit.edges[2] < 0.0) {
            let vertex = nearest_corner(wall, hit.triangle, hit.edges);
            let cosine = max(-dot(direction, wall.normals[vertex]), 0.0);
            let site = light.sites.of_vertex[vertex];
            let [base, gloss] = light.reflectance.at(cosine);
            let shares = light.reflected(site as usize, [base, GLOSS * gloss]);
            ends.push((site, scale(shares, light.per_area[site as usize])));
        }
    }
    ends
}
