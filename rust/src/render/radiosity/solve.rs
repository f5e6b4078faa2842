//! One frame of indirect light.

use super::deformed_transport::DeformedTransport;
use super::direct_light::direct_illumination;
use super::form_factors::{FormFactor, FormFactorVector};
use super::lazy_cache::{FrameCache, Light};
use super::subsurface::{SubsurfaceFrame, SubsurfaceLight};
use super::{Color, Radiosity};
use crate::render::led::Led;
use crate::render::material::Surface;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::packet::{Hits, MISS};
use glam::Vec4;
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};

/// Maximum of the light on relief over that along the smooth normal: where the latter is tiny, the
/// tangential light is mostly noise.
const MAX_RELIEF_GAIN: f32 = 4.0;
/// Distance in gather points between the computed one and the prefetched row.
const AHEAD: usize = 4;
/// Number of gather points that one thread takes at a time.
pub const CHUNK: usize = 32;

/// Irradiance by indirect light in one frame.
pub struct Irradiance<'a> {
    light: &'a Radiosity,
    rest: &'a Wall,
    wall: &'a Wall,
    /// Deformation of the wall relative to rest; None at rest.
    deformed: Option<DeformedTransport<'a>>,
    /// Radiosity of each gather point [W/m²].
    radiosity: Vec<Color>,
    /// Light at each gather point and vertex, computed on first use.
    known: FrameCache<'a>,
    /// Light through the tissue behind the wall, if enabled.
    subsurface_frame: Option<SubsurfaceFrame<'a>>,
}

impl Radiosity {
    /// Solves for the irradiance by indirect light, with or without shadows of the LEDs.
    pub fn solve<'a>(
        &'a self,
        rest: &'a Wall,
        wall: &'a Wall,
        (leds, shadows): (&[Led], bool),
    ) -> Irradiance<'a> {
        let mut radiosity = direct_illumination(self, wall, leds);
        let active = self.active(rest, &radiosity);
        let kept = self.shape_factors(rest, &active, &mut radiosity);
        let deformed =
            (!std::ptr::eq(rest, wall)).then(|| DeformedTransport::new(self, rest, wall, &active));
        if let Some(deformed) = &deformed {
            for &s in &active {
                let thinner = 1.0 / max(deformed.area_ratio(s as usize), 1e-3);
                radiosity[s as usize] = radiosity[s as usize].map(|x| x * thinner);
            }
        }
        let bent = deformed.as_ref().map(|deformed| self.deformed_rows(rest, deformed, &active));
        let row = |n: usize| match &bent {
            Some(rows) => &rows[n][..],
            None => &self.row(rest, active[n] as usize).coarse,
        };
        let next = self.reflect((&active, &kept), row, &radiosity);
        let series = series_factor(total(&next), total(&radiosity));
        for (&s, light) in active.iter().zip(next) {
            for k in 0..3 {
                radiosity[s as usize][k] += light[k] * series[k];
            }
        }
        let subsurface_frame =
            self.tissue.as_ref().map(|tissue| tissue.frame(rest, wall, leds, shadows));
        Irradiance {
            light: self,
            rest,
            wall,
            deformed,
            radiosity,
            known: self.cache.lend(),
            subsurface_frame,
        }
    }

    /// Fraction of its reflected light that each gather point keeps; `last` is multiplied by it.
    fn shape_factors(&self, rest: &Wall, gather_points: &[u32], last: &mut [Color]) -> Vec<Vec3> {
        let of_site = |&s: &u32| self.kept(rest, s as usize);
        let kept: Vec<Vec3> = gather_points.par_iter().with_min_len(CHUNK).map(of_site).collect();
        for (&s, kept) in gather_points.iter().zip(&kept) {
            let [r, g, b, _] = last[s as usize];
            last[s as usize] = [r * kept[0], g * kept[1], b * kept[2], 0.0];
        }
        kept
    }

    /// Gather points that are lit or have a form factor to one that is, in order.
    fn active(&self, rest: &Wall, radiosity: &[Color]) -> Vec<u32> {
        let is_reached: Vec<AtomicBool> =
            radiosity.iter().map(|_| AtomicBool::new(false)).collect();
        let reach =
            |gather_point: u32| is_reached[gather_point as usize].store(true, Ordering::Relaxed);
        let lit: Vec<u32> =
            (0..radiosity.len() as u32).filter(|&s| radiosity[s as usize] != [0.0; 4]).collect();
        lit.par_iter().enumerate().with_min_len(CHUNK).for_each(|(n, &s)| {
            fetch(lit.get(n + AHEAD).map(|&s| &self.row(rest, s as usize).coarse[..]));
            reach(s);
            self.row(rest, s as usize).coarse.iter().for_each(|link| reach(link.from));
        });
        let all = is_reached.into_iter().map(AtomicBool::into_inner);
        all.zip(0..).filter_map(|(is_reached, s)| is_reached.then_some(s)).collect()
    }

    /// Coarse rows of gather points on the current wall.
    fn deformed_rows(
        &self,
        rest: &Wall,
        deformed: &DeformedTransport<'_>,
        gather_points: &[u32],
    ) -> Vec<Vec<FormFactor>> {
        let bend = |&gather_point: &u32| {
            let row = &self.row(rest, gather_point as usize).coarse;
            let links = row.iter().map(|l| (l.from, l.form_factor, l.geometry));
            let factors = deformed.factors(gather_point as usize, links);
            let bent = |(link, factor): (&FormFactor, f32)| FormFactor {
                form_factor: link.form_factor * factor,
                ..*link
            };
            row.iter().zip(factors).map(bent).collect()
        };
        gather_points.par_iter().with_min_len(CHUNK).map(bend).collect()
    }

    /// Radiosity of gather points, given their rows and the radiosity of all others.
    fn reflect<'a>(
        &self,
        (gather_points, kept): (&[u32], &[Vec3]),
        row: impl Fn(usize) -> &'a [FormFactor] + Sync,
        radiosity: &[Color],
    ) -> Vec<Color> {
        let of_site = |(n, (&s, kept)): (usize, (&u32, &Vec3))| {
            fetch((n + AHEAD < gather_points.len()).then(|| row(n + AHEAD)));
            let mut light = [0.0; 4];
            for link in row(n) {
                let from = &radiosity[link.from as usize];
                for k in 0..4 {
                    light[k] += link.form_factor * from[k];
                }
            }
            let [r, g, b] = self.reflected(s as usize, self.reflectance.mean);
            [light[0] * r * kept[0], light[1] * g * kept[1], light[2] * b * kept[2], 0.0]
        };
        gather_points.par_iter().zip(kept).enumerate().with_min_len(CHUNK).map(of_site).collect()
    }
}

/// Prefetches a row, because the processor cannot predict the address of the next one.
fn fetch(row: Option<&[FormFactor]>) {
    std::hint::black_box(row.and_then(|row| row.first().copied()));
}

/// Sum of the light of all gather points.
fn total(light: &[Color]) -> Vec3 {
    light.iter().fold([0.0; 3], |sum, c| add(sum, [c[0], c[1], c[2]]))
}

/// Sum of a geometric series from its last known term onwards, relative to that term.
fn series_factor(term: Vec3, before: Vec3) -> Vec3 {
    [0, 1, 2].map(|k| 1.0 / (1.0 - clamp(term[k] / max(before[k], 1e-30), 0.0, 0.95)))
}

impl Irradiance<'_> {
    /// Subsurface light of surfaces, if light enters the tissue behind them.
    #[inline(always)]
    pub fn subsurface(
        &self,
        surface: &Surface,
        hits: &Hits,
        walls: &[u32; LANES],
    ) -> Option<SubsurfaceLight> {
        let subsurface_frame = self.subsurface_frame.as_ref()?;
        let is_wall = walls.map(|triangle| triangle != MISS);
        Some(
            subsurface_frame
                .subsurface(surface, hits, is_wall, &|v| Vec4::from_slice(&self.vertex(v))),
        )
    }

    /// Adds the radiance that indirect light leaves towards the viewer [W/(sr·m²)]; `smooth` are
    /// the wall's normals without relief, `beneath` is the subsurface light.
    ///
    /// Relief that tilts by τ turns a part of its hemisphere into the wall: of diffuse light it
    /// receives (1 + cos τ)/2. All colors are assumed to come from the same directions.
    #[inline(always)]
    pub fn add(
        &self,
        (surface, smooth): (&Surface, &Lane3),
        hits: &Hits,
        subsurface: Option<&SubsurfaceLight>,
        radiance: &mut Lane3,
    ) {
        let mut diffuse = [0.0; LANES];
        let mut tilt = [[0.0; LANES]; 3];
        let mut reflected = [[0.0; LANES]; 2];
        for i in 0..LANES {
            let (normal, flat) = (at(&surface.normal, i), at(smooth, i));
            let [base, gloss] = self.light.reflectance.at(dot(normal, at(&surface.view, i)));
            (reflected[0][i], reflected[1][i]) = (base, gloss);
            let level = dot(normal, flat);
            diffuse[i] = 0.5 * (1.0 + level);
            for k in 0..3 {
                tilt[k][i] = normal[k] - flat[k] * level;
            }
        }
        let (mut first_weight, mut second_weight) = ([0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            let inverse = 1.0 / hits.edges[2][i];
            (first_weight[i], second_weight[i]) =
                (hits.edges[0][i] * inverse, hits.edges[1][i] * inverse);
        }
        // A tile shows few triangles, so the loop takes each in turn for all lanes.
        let triangles = &hits.triangle;
        let mut lights = [[0.0; LANES]; 7];
        let mut is_done = triangles.map(|triangle| triangle == MISS);
        for lane in 0..LANES {
            if is_done[lane] {
                continue;
            }
            let triangle = triangles[lane];
            let [first, second, third] = light_at_corners(self, triangle);
            for (n, light) in lights.iter_mut().enumerate() {
                for i in 0..LANES {
                    let here = third[n] + first[n] * first_weight[i] + second[n] * second_weight[i];
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
            let gain = diffuse[i] + more / max(all[i], 1e-30);
            diffuse[i] = clamp(gain, 0.0, MAX_RELIEF_GAIN) * (1.0 / PI);
        }
        for (k, irradiance) in [red, green, blue].into_iter().enumerate() {
            for i in 0..LANES {
                let base = reflected[0][i] * surface.albedo[k][i];
                let (base, through) =
                    subsurface.map_or((base, 0.0), |subsurface| subsurface.of(base, k, i));
                radiance[k][i] +=
                    max(irradiance[i], 0.0) * diffuse[i] * (base + reflected[1][i]) + through;
            }
        }
    }

    #[inline(always)]
    fn vertex(&self, v: usize) -> Light {
        if let Some(light) = self.known.vertex(v) {
            return light;
        }
        let mut sum = Light::default();
        for &(s, weight) in
            self.light.gather_points.neighbors[v].iter().take_while(|neighbors| neighbors.1 > 0.0)
        {
            let s = s as usize;
            let light =
                self.known.gather_point(s).unwrap_or_else(|| light_at_gather_point(self, s));
            for n in 0..8 {
                sum[n] += weight * light[n];
            }
        }
        self.known.keep_vertex(v, &sum);
        sum
    }

    #[inline(always)]
    fn gather_point(&self, s: usize) -> Light {
        let vertex = self.light.gather_points.vertex[s] as usize;
        let vectors_in = &self.light.row(self.rest, s).fine;
        let mut vectors = match &self.deformed {
            None => self.gather(vectors_in.iter().map(|beam| (beam, 1.0))),
            Some(deformed) => {
                let normal = self.rest.normals[vertex];
                let links =
                    vectors_in.iter().map(|b| (b.from, dot(b.direction, normal), b.geometry));
                self.gather(vectors_in.iter().zip(deformed.factors(s, links)))
            }
        };
        if let Some(deformed) = &self.deformed {
            vectors = vectors.map(|vector| deformed.turn(vertex, vector));
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
        self.known.keep_gather_point(s, &light);
        light
    }

    /// Red, green and blue light vectors from the radiosity of the gather points of a row, whose
    /// form factors are multiplied by the given factors.
    #[inline(always)]
    fn gather<'b>(&self, row: impl Iterator<Item = (&'b FormFactorVector, f32)>) -> [Vec3; 3] {
        let mut sum = [[0.0f32; 4]; 3];
        for (beam, factor) in row {
            let from = &self.radiosity[beam.from as usize];
            for k in 0..3 {
                let weight = factor * beam.direction[k];
                for color in 0..4 {
                    sum[k][color] += from[color] * weight;
                }
            }
        }
        [0, 1, 2].map(|color| [sum[0][color], sum[1][color], sum[2][color]])
    }
}

/// Irradiance of a triangle's third corner, after the differences of the first two from it.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn light_at_corners(light: &Irradiance<'_>, triangle: u32) -> [Light; 3] {
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

/// Irradiance of a gather point.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn light_at_gather_point(light: &Irradiance<'_>, gather_point: usize) -> Light {
    light.gather_point(gather_point)
}
