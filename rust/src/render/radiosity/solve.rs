//! One frame of bounced light.

use super::deformed_transport::Moved;
use super::direct_light::first_reflection;
use super::form_factors::{Beam, Link};
use super::lazy_cache::{Light, Lights};
use super::subsurface::{Beneath, Skin};
use super::{Color, Radiosity};
use crate::render::material::{Led, Surface};
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MISS};
use glam::Vec4;
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};

/// Most of the light along the smooth normal that relief gets: where hardly any comes along that, what
/// comes aside is all but noise.
const MOST_SHARE: f32 = 4.0;
/// Sites from the one whose light is reckoned to the one whose row is fetched.
const AHEAD: usize = 4;
/// Sites that one thread takes at a time.
const CHUNK: usize = 32;

/// Irradiance by bounced light in one frame.
pub struct Irradiance<'a> {
    light: &'a Radiosity,
    rest: &'a Wall,
    wall: &'a Wall,
    /// How the wall differs from itself at rest, if it does.
    moved: Option<Moved<'a>>,
    /// Radiosity of each site [W/m²].
    leaving: Vec<Color>,
    /// Light at each site and vertex, gathered when first needed.
    known: Lights<'a>,
    /// Light through the tissue behind the wall, if it goes there.
    skin: Option<Skin<'a>>,
}

impl Radiosity {
    /// Irradiance by bounced light; LEDs cast shadows or not.
    pub fn solve<'a>(
        &'a self,
        rest: &'a Wall,
        wall: &'a Wall,
        (leds, shadows): (&[Led], bool),
    ) -> Irradiance<'a> {
        let mut leaving = first_reflection(self, wall, leds);
        let reached = self.reached(rest, &leaving);
        let kept = self.kept_of(rest, &reached, &mut leaving);
        let moved = (!std::ptr::eq(rest, wall)).then(|| Moved::new(self, rest, wall, &reached));
        if let Some(moved) = &moved {
            for &s in &reached {
                let thinner = 1.0 / max(moved.stretch(s as usize), 1e-3);
                leaving[s as usize] = leaving[s as usize].map(|x| x * thinner);
            }
        }
        let bent = moved.as_ref().map(|moved| self.bent_rows(rest, moved, &reached));
        let row = |n: usize| match &bent {
            Some(rows) => &rows[n][..],
            None => &self.row(rest, reached[n] as usize).coarse,
        };
        let next = self.reflect((&reached, &kept), row, &leaving);
        let series = tail(total(&next), total(&leaving));
        for (&s, light) in reached.iter().zip(next) {
            for k in 0..3 {
                leaving[s as usize][k] += light[k] * series[k];
            }
        }
        let skin = self.tissue.as_ref().map(|tissue| tissue.frame(rest, wall, leds, shadows));
        Irradiance { light: self, rest, wall, moved, leaving, known: self.room.lend(), skin }
    }

    /// What each of the sites keeps of the light that it reflects; `last` is made less by that.
    fn kept_of(&self, rest: &Wall, sites: &[u32], last: &mut [Color]) -> Vec<Vec3> {
        let of_site = |&s: &u32| self.kept(rest, s as usize);
        let kept: Vec<Vec3> = sites.par_iter().with_min_len(CHUNK).map(of_site).collect();
        for (&s, kept) in sites.iter().zip(&kept) {
            let [r, g, b, _] = last[s as usize];
            last[s as usize] = [r * kept[0], g * kept[1], b * kept[2], 0.0];
        }
        kept
    }

    /// Sites that are lit or see one that is, in order.
    fn reached(&self, rest: &Wall, leaving: &[Color]) -> Vec<u32> {
        let is_reached: Vec<AtomicBool> = leaving.iter().map(|_| AtomicBool::new(false)).collect();
        let reach = |site: u32| is_reached[site as usize].store(true, Ordering::Relaxed);
        let lit: Vec<u32> =
            (0..leaving.len() as u32).filter(|&s| leaving[s as usize] != [0.0; 4]).collect();
        lit.par_iter().enumerate().with_min_len(CHUNK).for_each(|(n, &s)| {
            fetch(lit.get(n + AHEAD).map(|&s| &self.row(rest, s as usize).coarse[..]));
            reach(s);
            self.row(rest, s as usize).coarse.iter().for_each(|link| reach(link.from));
        });
        let all = is_reached.into_iter().map(AtomicBool::into_inner);
        all.zip(0..).filter_map(|(is_reached, s)| is_reached.then_some(s)).collect()
    }

    /// Coarse rows of sites on the wall as it has moved.
    fn bent_rows(&self, rest: &Wall, moved: &Moved<'_>, sites: &[u32]) -> Vec<Vec<Link>> {
        let bend = |&site: &u32| {
            let row = &self.row(rest, site as usize).coarse;
            let links = row.iter().map(|l| (l.from, l.share, l.exchange));
            let factors = moved.factors(site as usize, links);
            let bent = |(link, factor): (&Link, f32)| Link { share: link.share * factor, ..*link };
            row.iter().zip(factors).map(bent).collect()
        };
        sites.par_iter().with_min_len(CHUNK).map(bend).collect()
    }

    /// Radiosity of sites, given their rows, by what leaves all others.
    fn reflect<'a>(
        &self,
        (sites, kept): (&[u32], &[Vec3]),
        row: impl Fn(usize) -> &'a [Link] + Sync,
        leaving: &[Color],
    ) -> Vec<Color> {
        let of_site = |(n, (&s, kept)): (usize, (&u32, &Vec3))| {
            fetch((n + AHEAD < sites.len()).then(|| row(n + AHEAD)));
            let mut light = [0.0; 4];
            for link in row(n) {
                let from = &leaving[link.from as usize];
                for k in 0..4 {
                    light[k] += link.share * from[k];
                }
            }
            let [r, g, b] = self.reflected(s as usize, self.reflectance.mean);
            [light[0] * r * kept[0], light[1] * g * kept[1], light[2] * b * kept[2], 0.0]
        };
        sites.par_iter().zip(kept).enumerate().with_min_len(CHUNK).map(of_site).collect()
    }
}

/// Brings a row near the processor, which does not foresee by itself where the next ones are.
fn fetch(row: Option<&[Link]>) {
    std::hint::black_box(row.and_then(|row| row.first().copied()));
}

/// Light of all sites together.
fn total(light: &[Color]) -> Vec3 {
    light.iter().fold([0.0; 3], |sum, c| add(sum, [c[0], c[1], c[2]]))
}

/// What a geometric series adds up to from its last known term on, over that term.
fn tail(term: Vec3, before: Vec3) -> Vec3 {
    [0, 1, 2].map(|k| 1.0 / (1.0 - clamp(term[k] / max(before[k], 1e-30), 0.0, 0.95)))
}

impl Irradiance<'_> {
    /// What the tissue behind surfaces makes of light, if it goes there.
    #[inline(always)]
    pub fn beneath(&self, surface: &Surface, hits: &Hits, walls: &[u32; LANES]) -> Option<Beneath> {
        let skin = self.skin.as_ref()?;
        let is_wall = walls.map(|triangle| triangle != MISS);
        Some(skin.beneath(surface, hits, is_wall, &|v| Vec4::from_slice(&self.vertex(v))))
    }

    /// Adds the radiance that bounced light leaves towards the viewer [W/(sr·m²)]; `smooth` are
    /// the wall's normals without relief, `beneath` is what tissue makes of it.
    ///
    /// Relief that tilts by τ looks into the wall with a part of its hemisphere: of even light it
    /// gets (1 + cos τ)/2. Colours are taken to come from the same directions.
    #[inline(always)]
    pub fn add(
        &self,
        (surface, smooth): (&Surface, &Lane3),
        hits: &Hits,
        beneath: Option<&Beneath>,
        radiance: &mut Lane3,
    ) {
        let mut even = [0.0; LANES];
        let mut tilt = [[0.0; LANES]; 3];
        let mut reflected = [[0.0; LANES]; 2];
        for i in 0..LANES {
            let (normal, flat) = (at(&surface.normal, i), at(smooth, i));
            let [base, gloss] = self.light.reflectance.at(dot(normal, at(&surface.view, i)));
            (reflected[0][i], reflected[1][i]) = (base, gloss);
            let level = dot(normal, flat);
            even[i] = 0.5 * (1.0 + level);
            for k in 0..3 {
                tilt[k][i] = normal[k] - flat[k] * level;
            }
        }
        let (mut first_share, mut second_share) = ([0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let inverse = 1.0 / hits.edges[2][i];
            (first_share[i], second_share[i]) =
                (hits.edges[0][i] * inverse, hits.edges[1][i] * inverse);
        }
        // A tile sees few triangles: each in turn, for all lanes at once.
        let triangles = &hits.triangle;
        let mut lights = [[0.0; LANES]; 7];
        let mut is_done = triangles.map(|triangle| triangle == MISS);
        for lane in 0..LANES {
            if is_done[lane] {
                continue;
            }
            let triangle = triangles[lane];
            let [first, second, third] = corners_of(self, triangle);
            for (n, light) in lights.iter_mut().enumerate() {
                for i in 0..LANES {
                    let here = third[n] + first[n] * first_share[i] + second[n] * second_share[i];
                    light[i] = if triangles[i] == triangle { here } else { light[i] };
                }
            }
            for i in 0..LANES {
                is_done[i] |= triangles[i] == triangle;
            }
        }
        let [red, green, blue, all, x, y, z] = &lights;
        for i in 0..LANES {
            let more = x[i] * tilt[0][i] + y[i] * tilt[1][i] + z[i] * tilt[2][i];
            let share = even[i] + more / max(all[i], 1e-30);
            even[i] = clamp(share, 0.0, MOST_SHARE) * (1.0 / PI);
        }
        for (k, irradiance) in [red, green, blue].into_iter().enumerate() {
            for i in 0..LANES {
                let base = reflected[0][i] * surface.albedo[k][i];
                let (base, through) = beneath.map_or((base, 0.0), |beneath| beneath.of(base, k, i));
                radiance[k][i] +=
                    max(irradiance[i], 0.0) * even[i] * (base + reflected[1][i]) + through;
            }
        }
    }

    #[inline(always)]
    fn vertex(&self, v: usize) -> Light {
        if let Some(light) = self.known.vertex(v) {
            return light;
        }
        let mut sum = Light::default();
        for &(s, weight) in self.light.sites.heard[v].iter().take_while(|heard| heard.1 > 0.0) {
            let s = s as usize;
            let light = self.known.site(s).unwrap_or_else(|| site_of(self, s));
            for n in 0..8 {
                sum[n] += weight * light[n];
            }
        }
        self.known.keep_vertex(v, &sum);
        sum
    }

    #[inline(always)]
    fn site(&self, s: usize) -> Light {
        let vertex = self.light.sites.vertex[s] as usize;
        let beams = &self.light.row(self.rest, s).fine;
        let mut vectors = match &self.moved {
            None => self.gather(beams.iter().map(|beam| (beam, 1.0))),
            Some(moved) => {
                let normal = self.rest.normals[vertex];
                let links = beams.iter().map(|b| (b.from, dot(b.way, normal), b.exchange));
                self.gather(beams.iter().zip(moved.factors(s, links)))
            }
        };
        if let Some(moved) = &self.moved {
            vectors = vectors.map(|vector| moved.turn(self.wall, vertex, vector));
        }
        let normal = self.wall.normals[vertex];
        let mut light = Light::default();
        for (color, vector) in vectors.iter().enumerate() {
            light[color] = dot(*vector, normal);
        }
        let all = vectors.into_iter().fold([0.0; 3], add);
        light[3] = dot(all, normal);
        for k in 0..3 {
            light[4 + k] = all[k] - light[3] * normal[k];
        }
        self.known.keep_site(s, &light);
        light
    }

    /// Red, green and blue light vectors by what leaves the sites of a row, whose shares are
    /// multiplied by factors.
    #[inline(always)]
    fn gather<'b>(&self, row: impl Iterator<Item = (&'b Beam, f32)>) -> [Vec3; 3] {
        let mut sum = [[0.0f32; 4]; 3];
        for (beam, factor) in row {
            let from = &self.leaving[beam.from as usize];
            for k in 0..3 {
                let way = factor * beam.way[k];
                for color in 0..4 {
                    sum[k][color] += from[color] * way;
                }
            }
        }
        [0, 1, 2].map(|color| [sum[0][color], sum[1][color], sum[2][color]])
    }
}

/// What the third corner of a triangle gets, after how much more the first two get.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn corners_of(light: &Irradiance<'_>, triangle: u32) -> [Light; 3] {
    let mut corners = [Light::default(); 3];
    for (corner, &v) in corners.iter_mut().zip(&light.wall.bvh.corners[triangle as usize]) {
        *corner = light.vertex(v as usize);
    }
    let [mut first, mut second, third] = corners;
    for n in 0..8 {
        first[n] -= third[n];
        second[n] -= third[n];
    }
    [first, second, third]
}

/// What a site gets.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn site_of(light: &Irradiance<'_>, site: usize) -> Light {
    light.site(site)
}
