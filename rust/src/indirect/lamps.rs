//! Light from the LEDs to the sites: each LED sends rays of equal power.

use super::QuickLight;
use super::sites::nearest_corner;
use crate::lanes::*;
use crate::material::Led;
use crate::tile::{Hits, MISS, Pyramid, trace};
use crate::wall::Wall;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Sectors around an LED's axis and rings about it, a tile of rays in each.
const SECTORS: usize = 4;
const RINGS: usize = 4;
/// Share of an LED's power that a ray carries.
const RAY: f32 = 1.0 / (SECTORS * RINGS * LANES) as f32;

/// Where a ray ends: a site, and the cosine at which the light comes there (0 for nowhere).
type End = (u32, f32);

/// Power that each site reflects of the LEDs' light [W], by site; unlit sites are left out.
pub fn first_reflection(light: &QuickLight, wall: &Wall, leds: &[Led]) -> Vec<(u32, Vec3)> {
    let tiles = leds.len() * RINGS * SECTORS;
    let ends: Vec<[End; LANES]> = (0..tiles)
        .into_par_iter()
        .map(|t| {
            let (led, part) = (t / (RINGS * SECTORS), t % (RINGS * SECTORS));
            // LEDs are close together: their patterns are turned against each other.
            let turn = TAU * (led as f32 * 0.618_034).fract();
            let directions = lobe_part(&leds[led], part / SECTORS, part % SECTORS, turn);
            send(light, wall, leds[led].position, directions)
        })
        .collect();
    let mut power = Vec::with_capacity(tiles * LANES);
    for (t, tile) in ends.iter().enumerate() {
        let led = &leds[t / (RINGS * SECTORS)];
        let solid_angle = if led.exponent == 0.0 { 2.0 * TAU } else { TAU / (led.exponent + 1.0) };
        for &(site, cosine) in tile.iter().filter(|end| end.1 > 0.0) {
            let [base, gloss] = light.reflectance.at(cosine);
            let albedo = light.albedo[site as usize];
            let reflected = albedo.map(|a| solid_angle * RAY * (base * a + gloss));
            power.push((site, [0, 1, 2].map(|k| led.intensity[k] * reflected[k])));
        }
    }
    power.sort_by_key(|&(site, _)| site);
    let total = |run: &[(u32, Vec3)]| (run[0].0, run.iter().fold([0.0; 3], |s, p| add(s, p.1)));
    power.chunk_by(|a, b| a.0 == b.0).map(total).collect()
}

/// Directions of one tile: cells of equal power in a ring and sector of an LED's lobe.
fn lobe_part(led: &Led, ring: usize, sector: usize, turn: f32) -> Lane3 {
    let axis = led.direction;
    let least = if axis[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let right = normalize(cross(axis, least));
    let down = cross(axis, right);
    let mut directions = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let inner = (ring as f32 + ((i / TILE) as f32 + 0.5) / TILE as f32) / RINGS as f32;
        let around = (sector as f32 + ((i % TILE) as f32 + 0.5) / TILE as f32) / SECTORS as f32;
        // cosᵐ has the share 1 − cosᵐ⁺¹ of its power inside a cone; exponent 0 is a whole sphere.
        let up = if led.exponent == 0.0 {
            1.0 - 2.0 * inner
        } else {
            pow(1.0 - inner, 1.0 / (led.exponent + 1.0))
        };
        let across = max(1.0 - up * up, 0.0).sqrt();
        let angle = turn + TAU * around;
        let (x, y) = (across * angle.cos(), across * angle.sin());
        for k in 0..3 {
            directions[k][i] = x * right[k] + y * down[k] + up * axis[k];
        }
    }
    directions
}

#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn send(light: &QuickLight, wall: &Wall, origin: Vec3, directions: Lane3) -> [End; LANES] {
    let rays = Pyramid::around(directions, &[true; LANES]);
    let mut hits = Hits::within([f32::MAX; LANES]);
    trace::<false>(&wall.bvh, origin, &rays, wall.extent, &mut hits);
    let mut ends = [(0, 0.0); LANES];
    for i in 0..LANES {
        // The back of a wall is dark.
        if hits.triangle[i] == MISS || hits.edges[2][i] > 0.0 {
            continue;
        }
        let vertex = nearest_corner(wall, hits.triangle[i], at(&hits.edges, i));
        let cosine = max(-dot(at(&rays.directions, i), wall.normals[vertex]), 0.0);
        ends[i] = (light.sites.of_vertex[vertex], cosine);
    }
    ends
}
