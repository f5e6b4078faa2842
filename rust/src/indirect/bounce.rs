//! One frame of bounced light.

use super::lamps::first_reflection;
use super::moved::Moved;
use super::rows::{Beam, Link};
use super::through::Lamps;
use super::{Color, QuickLight};
use crate::lanes::*;
use crate::material::{Led, Surface};
use crate::tile::{Hits, MISS};
use crate::wall::Wall;
use rayon::prelude::*;
use std::borrow::Cow;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Reflections that are followed after the first; the rest is the tail of a geometric series.
const BOUNCES: usize = 2;
/// Sites that one thread takes at a time.
const CHUNK: usize = 64;

/// Irradiance by bounced light in one frame.
pub struct Irradiance<'a> {
    light: &'a QuickLight,
    rest: &'a Wall,
    wall: &'a Wall,
    /// How the wall differs from itself at rest, if it does.
    moved: Option<Moved<'a>>,
    /// Radiosity of each site [W/m²].
    leaving: Vec<Color>,
    /// LEDs, and whether things cast shadows, if light goes through tissue.
    through: Option<Lamps<'a>>,
    /// Light at each site and vertex, gathered when first needed.
    of_site: Vec<Lazy<12>>,
    of_vertex: Vec<Lazy<12>>,
}

/// For red, green and blue: irradiance, and how it grows as the normal tilts along x, y and z
/// [W/m²]. The latter is the tangential part of the light vector.
type Light = [f32; 12];

/// Light that is reckoned when first needed; all bits zero is not yet known, a zero that
/// is known is negative.
///
/// Threads that need it at once all reckon it; their results are the same, so it matters
/// neither who writes last nor whether a reader finds parts of one and of the other.
pub(super) struct Lazy<const N: usize>([AtomicU32; N]);

impl<const N: usize> Lazy<N> {
    /// So many that are not yet known.
    pub(super) fn none_of(count: usize) -> Vec<Self> {
        (0..count).map(|_| Lazy(std::array::from_fn(|_| AtomicU32::new(0)))).collect()
    }

    #[inline(always)]
    pub(super) fn get(&self, reckon: impl FnOnce() -> [f32; N]) -> [f32; N] {
        let known: [u32; N] = std::array::from_fn(|k| self.0[k].load(Relaxed));
        if known.iter().all(|&bits| bits != 0) {
            return known.map(f32::from_bits);
        }
        let found = reckon().map(|x| if x == 0.0 { -0.0 } else { x });
        for (slot, x) in self.0.iter().zip(found) {
            slot.store(x.to_bits(), Relaxed);
        }
        found
    }
}

impl QuickLight {
    /// Irradiance by bounced light.
    pub fn solve<'a>(
        &'a self,
        rest: &'a Wall,
        wall: &'a Wall,
        leds: &[Led],
        shadows: bool,
    ) -> Irradiance<'a> {
        let mut last = first_reflection(self, wall, leds);
        let reached = self.reached(rest, &last);
        let moved = (!std::ptr::eq(rest, wall)).then(|| Moved::new(self, rest, wall, &reached));
        if let Some(moved) = &moved {
            for &s in &reached {
                let thinner = 1.0 / max(moved.stretch(s as usize), 1e-3);
                last[s as usize] = last[s as usize].map(|x| x * thinner);
            }
        }
        let rows: Vec<Cow<'_, [Link]>> = reached
            .par_iter()
            .with_min_len(CHUNK)
            .map(|&s| self.coarse_row(rest, moved.as_ref(), s as usize))
            .collect();
        let mut leaving = last.clone();
        let mut before = [0.0; 3];
        for bounce in 0..BOUNCES {
            let next = self.reflect(&reached, &rows, &last);
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
        let of_site = Lazy::none_of(self.albedo.len());
        let of_vertex = Lazy::none_of(wall.vertices.len());
        let through = self.through.as_ref().map(|through| through.lit(wall, leds, shadows));
        Irradiance { light: self, rest, wall, moved, leaving, through, of_site, of_vertex }
    }

    /// Sites that are lit or see one that is, in order.
    fn reached(&self, rest: &Wall, leaving: &[Color]) -> Vec<u32> {
        let mut is_reached = vec![false; leaving.len()];
        let lit: Vec<usize> = (0..leaving.len()).filter(|&s| leaving[s] != [0.0; 4]).collect();
        lit.par_iter().with_min_len(CHUNK).for_each(|&s| {
            self.row(rest, s);
        });
        for s in lit {
            is_reached[s] = true;
            for link in &self.row(rest, s).coarse {
                is_reached[link.from as usize] = true;
            }
        }
        (0..is_reached.len() as u32).filter(|&s| is_reached[s as usize]).collect()
    }

    /// A site's coarse row on the wall as it is.
    fn coarse_row<'a>(
        &'a self,
        rest: &Wall,
        moved: Option<&Moved<'_>>,
        site: usize,
    ) -> Cow<'a, [Link]> {
        let row = &self.row(rest, site).coarse;
        let Some(moved) = moved else { return Cow::Borrowed(row) };
        let factors = moved.factors(site, row.iter().map(|l| (l.from, l.share, l.exchange)));
        let bent = |(link, factor): (&Link, f32)| Link { share: link.share * factor, ..*link };
        row.iter().zip(factors).map(bent).collect()
    }

    /// Radiosity of sites by what leaves all others.
    fn reflect(&self, sites: &[u32], rows: &[Cow<'_, [Link]>], leaving: &[Color]) -> Vec<Color> {
        let of_site = |(&s, row): (&u32, &Cow<'_, [Link]>)| {
            let mut light = [0.0; 4];
            for link in row.iter() {
                let from = &leaving[link.from as usize];
                for k in 0..4 {
                    light[k] += link.share * from[k];
                }
            }
            let [r, g, b] = self.reflected(s as usize, self.reflectance.mean);
            [light[0] * r, light[1] * g, light[2] * b, 0.0]
        };
        sites.par_iter().zip(rows).with_min_len(CHUNK).map(of_site).collect()
    }
}

/// What a geometric series adds up to from its last known term on, over that term.
fn tail(term: Vec3, before: Vec3) -> Vec3 {
    [0, 1, 2].map(|k| 1.0 / (1.0 - clamp(term[k] / max(before[k], 1e-30), 0.0, 0.95)))
}

impl Irradiance<'_> {
    /// Adds the radiance that bounced light leaves towards the viewer [W/(sr·m²)]; `smooth` are
    /// the wall's normals without relief.
    ///
    /// Relief that tilts by τ looks into the wall with a part of its hemisphere: of even light it
    /// gets (1 + cos τ)/2.
    #[inline(always)]
    pub fn add(&self, (surface, smooth): (&Surface, &Lane3), hits: &Hits, radiance: &mut Lane3) {
        let mut light = [[0.0; LANES]; 12];
        let mut last = (MISS, [[0.0; 12]; 3]);
        for i in 0..LANES {
            let triangle = hits.triangle[i];
            if triangle == MISS {
                continue;
            }
            if triangle != last.0 {
                let corners = self.wall.bvh.corners[triangle as usize];
                last = (triangle, corners.map(|v| self.vertex(v as usize)));
            }
            let [a, b, c] = &last.1;
            let inverse = 1.0 / hits.edges[2][i];
            let (wa, wb) = (hits.edges[0][i] * inverse, hits.edges[1][i] * inverse);
            for k in 0..12 {
                light[k][i] = c[k] + wa * (a[k] - c[k]) + wb * (b[k] - c[k]);
            }
        }
        for i in 0..LANES {
            let (normal, flat) = (at(&surface.normal, i), at(smooth, i));
            let [base, gloss] = self.light.reflectance.at(dot(normal, at(&surface.view, i)));
            let level = dot(normal, flat);
            let tilt = sub(normal, scale(flat, level));
            for k in 0..3 {
                let [even, x, y, z] = [0, 1, 2, 3].map(|part| light[4 * k + part][i]);
                let irradiance = 0.5 * (1.0 + level) * even + dot(tilt, [x, y, z]);
                let share = base * surface.albedo[k][i] + gloss;
                radiance[k][i] += max(irradiance, 0.0) * (1.0 / PI) * share;
            }
        }
    }

    #[inline(always)]
    fn vertex(&self, v: usize) -> Light {
        self.of_vertex[v].get(|| {
            let mut sum = [0.0; 12];
            for &(s, weight) in self.light.sites.heard[v].iter().filter(|heard| heard.1 > 0.0) {
                let light = self.site(s as usize);
                for k in 0..12 {
                    sum[k] += weight * light[k];
                }
            }
            sum
        })
    }

    fn site(&self, s: usize) -> Light {
        self.of_site[s].get(|| {
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
            let through = self.through.as_ref().map_or([0.0; 3], |lamps| {
                let albedo = self.light.albedo[s];
                let gained = lamps.gained(self.rest, &self.light.sites, (s, albedo));
                // A pixel gives of it what it gives of all irradiance, gloss too: less that.
                let [base, gloss] = self.light.reflectance.mean;
                [0, 1, 2].map(|k| gained[k] * base * albedo[k] / max(base * albedo[k] + gloss, 1e-6))
            });
            std::array::from_fn(|k| {
                let vector = vectors[k / 4];
                let even = dot(vector, normal);
                if k % 4 == 0 {
                    even + through[k / 4]
                } else {
                    vector[k % 4 - 1] - even * normal[k % 4 - 1]
                }
            })
        })
    }

    /// Red, green and blue light vectors by what leaves the sites of a row, whose shares are
    /// multiplied by factors.
    #[inline(always)]
    fn gather<'b>(&self, row: impl Iterator<Item = (&'b Beam, f32)>) -> [Vec3; 3] {
        let mut sum = [[0.0; 3]; 3];
        for (beam, factor) in row {
            let from = &self.leaving[beam.from as usize];
            for k in 0..9 {
                sum[k / 3][k % 3] += from[k / 3] * (factor * beam.way[k % 3]);
            }
        }
        sum
    }
}
