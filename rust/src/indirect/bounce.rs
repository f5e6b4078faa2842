//! One frame of bounced light.

use super::QuickLight;
use super::lamps::first_reflection;
use super::rows::Link;
use crate::lanes::*;
use crate::material::{Led, Surface};
use crate::tile::{Hits, MISS};
use crate::wall::Wall;
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Reflections that are followed after the first; the rest is the tail of a geometric series.
const BOUNCES: usize = 2;
/// Sites that one thread takes at a time.
const CHUNK: usize = 64;

/// A colour with a fourth number, so that it is one vector.
type Color = [f32; 4];

/// Irradiance by bounced light in one frame.
pub struct Irradiance<'a> {
    light: &'a QuickLight,
    rest: &'a Wall,
    /// Radiosity of each site [W/m²].
    leaving: Vec<Color>,
    /// Irradiance of each site and vertex [W/m²], gathered when first needed.
    of_site: Vec<Lazy>,
    of_vertex: Vec<Lazy>,
}

/// A colour above 0 that is reckoned when first needed.
///
/// Threads that need it at once all reckon it; their results are the same, so it matters neither
/// who writes last nor whether a reader finds the parts of one or of the other.
#[derive(Default)]
struct Lazy([AtomicU32; 3]);

impl Lazy {
    #[inline(always)]
    fn get(&self, reckon: impl FnOnce() -> Vec3) -> Vec3 {
        let known = [0, 1, 2].map(|k| f32::from_bits(self.0[k].load(Relaxed)));
        if known[0] > 0.0 && known[1] > 0.0 && known[2] > 0.0 {
            return known;
        }
        let found = reckon().map(|x| max(x, 1e-30));
        for k in 0..3 {
            self.0[k].store(found[k].to_bits(), Relaxed);
        }
        found
    }
}

impl QuickLight {
    /// Irradiance by bounced light.
    pub fn solve<'a>(&'a self, rest: &'a Wall, wall: &Wall, leds: &[Led]) -> Irradiance<'a> {
        let lit = first_reflection(self, wall, leds);
        let mut last = vec![[0.0; 4]; self.albedo.len()];
        for &(s, power) in &lit {
            let inverse = 1.0 / max(self.area[s as usize], 1e-30);
            let [r, g, b] = scale(power, inverse);
            last[s as usize] = [r, g, b, 0.0];
        }
        let reached = self.reached(rest, lit.iter().map(|l| l.0));
        let mut leaving = last.clone();
        let mut before = [0.0; 3];
        for bounce in 0..BOUNCES {
            let next = self.reflect(rest, &reached, &last);
            let total = next.iter().fold([0.0; 3], |s, c| add(s, [c[0], c[1], c[2]]));
            let rest_of_series = if bounce + 1 < BOUNCES { [1.0; 3] } else { tail(total, before) };
            before = total;
            for (&s, light) in reached.iter().zip(next) {
                for k in 0..3 {
                    leaving[s as usize][k] += light[k] * rest_of_series[k];
                }
                last[s as usize] = light;
            }
        }
        let lazy = |n: usize| (0..n).map(|_| Lazy::default()).collect();
        let (of_site, of_vertex) = (lazy(self.albedo.len()), lazy(wall.vertices.len()));
        Irradiance { light: self, rest, leaving, of_site, of_vertex }
    }

    /// Sites that are lit or see one that is, in order.
    fn reached(&self, rest: &Wall, lit: impl Iterator<Item = u32>) -> Vec<u32> {
        let mut is_reached = vec![false; self.albedo.len()];
        let lit: Vec<u32> = lit.collect();
        lit.par_iter().with_min_len(CHUNK).for_each(|&s| {
            self.row(rest, s as usize);
        });
        for s in lit {
            is_reached[s as usize] = true;
            for link in &self.row(rest, s as usize).coarse {
                is_reached[link.from as usize] = true;
            }
        }
        (0..is_reached.len() as u32).filter(|&s| is_reached[s as usize]).collect()
    }

    /// Radiosity of sites by what leaves all others.
    fn reflect(&self, rest: &Wall, sites: &[u32], leaving: &[Color]) -> Vec<Color> {
        let [base, gloss] = self.reflectance.mean;
        let of_site = |&s: &u32| {
            let mut light = gather(&self.row(rest, s as usize).coarse, leaving);
            for k in 0..3 {
                light[k] *= base * self.albedo[s as usize][k] + gloss;
            }
            light
        };
        sites.par_iter().with_min_len(CHUNK).map(of_site).collect()
    }
}

/// Irradiance by what leaves the sites that are seen [W/m²].
#[inline(always)]
fn gather(links: &[Link], leaving: &[Color]) -> Color {
    let mut total = [0.0; 4];
    for link in links {
        let from = &leaving[link.from as usize];
        for k in 0..4 {
            total[k] += link.share * from[k];
        }
    }
    total
}

/// What a geometric series adds up to from its last known term on, over that term.
fn tail(term: Vec3, before: Vec3) -> Vec3 {
    [0, 1, 2].map(|k| 1.0 / (1.0 - clamp(term[k] / max(before[k], 1e-30), 0.0, 0.95)))
}

impl Irradiance<'_> {
    /// Adds the radiance that bounced light leaves towards the viewer [W/(sr·m²)].
    #[inline(always)]
    pub fn add(&self, wall: &Wall, surface: &Surface, hits: &Hits, radiance: &mut Lane3) {
        let mut light = [[0.0; LANES]; 3];
        let mut last = (MISS, [[0.0; 3]; 3]);
        for i in 0..LANES {
            let triangle = hits.triangle[i];
            if triangle == MISS {
                continue;
            }
            if triangle != last.0 {
                let corners = wall.bvh.corners[triangle as usize];
                last = (triangle, corners.map(|v| self.vertex(v as usize)));
            }
            let [a, b, c] = last.1;
            let inverse = 1.0 / hits.edges[2][i];
            let (wa, wb) = (hits.edges[0][i] * inverse, hits.edges[1][i] * inverse);
            for k in 0..3 {
                light[k][i] = c[k] + wa * (a[k] - c[k]) + wb * (b[k] - c[k]);
            }
        }
        for i in 0..LANES {
            let cosine = dot(at(&surface.normal, i), at(&surface.view, i));
            let [base, gloss] = self.light.reflectance.at(cosine);
            for k in 0..3 {
                let share = base * surface.albedo[k][i] + gloss;
                radiance[k][i] += light[k][i] * (1.0 / PI) * share;
            }
        }
    }

    #[inline(always)]
    fn vertex(&self, v: usize) -> Vec3 {
        self.of_vertex[v].get(|| {
            let heard = self.light.sites.heard[v].iter();
            let loud = heard.filter(|h| h.1 > 0.0);
            loud.fold([0.0; 3], |sum, &(s, weight)| add(sum, scale(self.site(s as usize), weight)))
        })
    }

    fn site(&self, s: usize) -> Vec3 {
        self.of_site[s].get(|| {
            let [r, g, b, _] = gather(&self.light.row(self.rest, s).fine, &self.leaving);
            [r, g, b]
        })
    }
}
