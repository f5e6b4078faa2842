//! Ways from what the camera sees to sources of light: few of many are chosen, and looked along.
//!
//! Each quarter of a tile's pixels, one of every square of four, is offered the sources of some
//! hundred light paths. A pixel chooses as many as it has samples, in proportion to about what they
//! add to it, and makes up for the choice by the sum over all (resampled importance sampling:
//! Talbot, Cline and Egbert 2005). A path that the reflectance sends out may come to the same place:
//! the balance heuristic (Veach 1997) shares between the two.

use crate::render::material::{Coat, Material, Surface, coat_fresnel, fresnel, ggx};
use crate::render::path::First;
use crate::render::path::bsdf::towards;
use crate::render::path::sobol::{dimension, hash, unit};
use crate::render::path::subsurface::offset;
use crate::render::path::virtual_lights::{OWN, Offer, Shares, Source, Sources};
use crate::render::path::wavefront::Tracer;
use crate::simd::f32x64::*;
use crate::wall::packet::Hits;
use crate::wall::ray;
use crate::wall::visibility::FREE_WAY;
use std::f32::consts::PI;
use std::ops::Range;

/// Pixels that are offered the same sources.
const SOME: usize = LANES / 4;

/// A way from a lane to a source.
#[derive(Clone, Copy)]
struct Pair {
    lane: u32,
    /// Number of the source among those offered.
    source: u32,
    /// One over how often it was expected to be chosen.
    weight: f32,
}

/// Room for what a tile chooses from; kept from tile to tile.
#[derive(Default)]
pub struct Room {
    /// What each source adds to each place, about.
    worth: Vec<[f32; SOME]>,
    pairs: Vec<Pair>,
}

/// Places that are offered the same sources, and the lanes where they are.
struct Places {
    lanes: [usize; SOME],
    position: [[f32; SOME]; 3],
    normal: [[f32; SOME]; 3],
    facet: [[f32; SOME]; 3],
    /// Base colours; 0 where nothing is seen.
    albedo: [[f32; SOME]; 3],
}

impl Tracer<'_> {
    /// Adds to `sums`, of one tile, its light by way of sources for some samples.
    #[inline(always)]
    pub(super) fn connect(
        &self,
        sources: &Sources,
        (first, facets): (&First, &Lane3),
        (keys, samples): (&[u32; LANES], Range<u32>),
        (room, sums): (&mut Room, &mut [[f64; 3]]),
    ) {
        let gloss = Gloss::new(&self.lit.scene.material);
        for quarter in 0..4 {
            let places = Places::new(first, facets, quarter);
            let key = |lane: usize| hash(dimension(keys[lane], 6) ^ hash(samples.start));
            let offer = sources.offer(key(places.lanes[0]), self.offered);
            let numbers = places.lanes.map(|lane| unit(key(lane)));
            let numbers = (&numbers, samples.len());
            if gloss.is_any() {
                places.choose::<true>(&offer, &gloss, numbers, room);
            } else {
                places.choose::<false>(&offer, &gloss, numbers, room);
            }
            for pairs in room.pairs.chunks(LANES) {
                let light = self.arriving(&offer, &first.surface, pairs);
                let scale = samples.len() as f32 / offer.paths as f32;
                self.look(&offer, (first, facets), pairs, (&light, scale, &mut *sums));
            }
        }
    }

    /// Radiance towards the viewer by way of up to `LANES` pairs, were nothing in the way.
    #[inline(always)]
    fn arriving(&self, offer: &Offer<'_>, surface: &Surface, pairs: &[Pair]) -> Lane3 {
        let of = |i: usize| {
            let pair = pairs[i.min(pairs.len() - 1)];
            (pair, &offer.sources[pair.source as usize])
        };
        let place = gathered(surface, &std::array::from_fn(|i| of(i).0.lane as usize));
        let (mut hits, mut view) = (Hits::within([0.0; LANES]), [[0.0; LANES]; 3]);
        let (mut position, mut ways) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for i in 0..LANES {
            let source = of(i).1;
            let offset = sub(source.point, at(&place.position, i));
            let (way, distance) = (normalize(offset), dot(offset, offset).sqrt());
            source.put(i, (scale(way, -1.0), distance), (&mut hits, &mut position, &mut view));
            for k in 0..3 {
                ways[k][i] = way[k];
            }
        }
        let seen = self.lit.surface(position, view, &hits);
        let mut back = [[0.0; LANES]; 3];
        for i in 0..LANES {
            for k in 0..3 {
                back[k][i] = of(i).1.back[k];
            }
        }
        let sent = towards(&seen, &self.lit.scene.material, &back);
        let taken = towards(&place, &self.lit.scene.material, &ways);
        let mut light = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let (pair, source) = of(i);
            let square = max(hits.distance[i] * hits.distance[i], 1e-14);
            let spread = -dot(source.facet, at(&ways, i)) / square;
            let own = taken.density[i] * spread;
            let Shares { base, gloss } = Shares::new(source.density, own, offer.paths);
            // Where the LED's own light is reflected, gloss at either end counts as gloss.
            let glossy = if source.order == 1 { gloss } else { base };
            for k in 0..3 {
                let matt = base * sent.base[k][i] + glossy * sent.gloss[i];
                let shiny = gloss * (sent.base[k][i] + sent.gloss[i]);
                let value = taken.base[k][i] * matt + taken.gloss[i] * shiny;
                light[k][i] = value * source.carried[k] * spread * pair.weight;
            }
        }
        light
    }

    /// Looks along the ways of pairs and adds what comes along those that are free.
    #[inline(always)]
    fn look(
        &self,
        offer: &Offer<'_>,
        (first, facets): (&First, &Lane3),
        pairs: &[Pair],
        (light, scaled, sums): (&Lane3, f32, &mut [[f64; 3]]),
    ) {
        let clear = offset(self.lit.wall);
        for (i, pair) in pairs.iter().enumerate() {
            let value = scale(at(light, i), scaled);
            if max(value[0], max(value[1], value[2])) <= 0.0 {
                continue;
            }
            let (lane, source) = (pair.lane as usize, &offer.sources[pair.source as usize]);
            let start = add(source.point, scale(source.facet, clear));
            let end = add(at(&first.surface.position, lane), scale(at(facets, lane), clear));
            let way = sub(end, start);
            let reach = dot(way, way).sqrt() * FREE_WAY;
            let way = normalize(way);
            if ray::cast::<true>(&self.lit.wall.bvh, start, way, reach, source.triangle).is_none() {
                for k in 0..3 {
                    sums[lane][k] += f64::from(value[k]);
                }
            }
        }
    }
}

impl Places {
    /// Of a quarter of a tile's lanes.
    #[inline(always)]
    fn new(first: &First, facets: &Lane3, quarter: usize) -> Self {
        let lanes = std::array::from_fn(|p| {
            let (row, column) = (p / (TILE / 2), p % (TILE / 2));
            (2 * row + quarter / 2) * TILE + 2 * column + quarter % 2
        });
        let some = |v: &Lane3| [0, 1, 2].map(|k| lanes.map(|i: usize| v[k][i]));
        let surface = &first.surface;
        let color = |k: usize| {
            lanes.map(|i| if first.hit[i] { surface.albedo[k][i] + Source::GLOSS } else { 0.0 })
        };
        Places {
            lanes,
            position: some(&surface.position),
            normal: some(&surface.normal),
            facet: some(facets),
            albedo: [color(0), color(1), color(2)],
        }
    }

    /// About what a source adds to each place, but for a factor that is the same for all.
    #[inline(always)]
    fn worth<const GLOSSY: bool>(&self, source: &Source, gloss: &Gloss, near: f32) -> [f32; SOME] {
        let mut out = [0.0; SOME];
        let shiny = near * (OWN.gloss / OWN.base);
        for i in 0..SOME {
            let get = |v: &[[f32; SOME]; 3]| [v[0][i], v[1][i], v[2][i]];
            let (offset, albedo) = (sub(source.point, get(&self.position)), get(&self.albedo));
            let square = max(dot(offset, offset), 1e-14);
            let leaving = max(-dot(source.facet, offset), 0.0);
            let met = max(dot(get(&self.normal), offset), 0.0) * leaving;
            let mut value = dot(albedo, source.sent) * met / (square * square + met * near);
            if GLOSSY {
                let sent = gloss.sent(source, scale(offset, -1.0 / square.sqrt()));
                let sent = dot(albedo, source.carried) * sent;
                value += sent * met / (square * square + met * shiny);
            }
            out[i] = if dot(get(&self.facet), offset) > 0.0 { value } else { 0.0 };
        }
        out
    }

    /// Chooses `count` sources for each place in proportion to their worth, evenly in their order.
    #[inline(always)]
    fn choose<const GLOSSY: bool>(
        &self,
        offer: &Offer<'_>,
        gloss: &Gloss,
        (numbers, count): (&[f32; SOME], usize),
        room: &mut Room,
    ) {
        let Room { worth, pairs } = room;
        let mut total = [0.0; SOME];
        worth.clear();
        pairs.clear();
        for source in offer.sources {
            let each = self.worth::<GLOSSY>(source, gloss, source.near / offer.paths as f32);
            for i in 0..SOME {
                total[i] += each[i];
            }
            worth.push(each);
        }
        let step = total.map(|t| if t > 0.0 { count as f32 / t } else { 0.0 });
        let (mut sum, mut taken) = (*numbers, [0.0f32; SOME]);
        for (source, each) in worth.iter().enumerate() {
            let mut is_any = false;
            let before = sum;
            for i in 0..SOME {
                sum[i] += each[i] * step[i];
                is_any |= sum[i] >= taken[i] + 1.0;
            }
            if !is_any {
                continue;
            }
            for i in 0..SOME {
                if sum[i] < taken[i] + 1.0 {
                    continue;
                }
                let times = (sum[i] as u32) as f32 - taken[i];
                taken[i] += times;
                // The expected number of times, as rounded as the sums are.
                let weight = times / (sum[i] - before[i]);
                pairs.push(Pair { lane: self.lanes[i] as u32, source: source as u32, weight });
            }
        }
    }
}

/// Gloss of sources, about.
struct Gloss {
    coat: Coat,
    /// Strength of the film.
    film: f32,
    /// Reflectance of the base's gloss at right angles.
    straight: f32,
}

impl Gloss {
    fn new(material: &Material) -> Self {
        let straight = fresnel(1.0, material.ior);
        Gloss { coat: Coat::new(material), film: 0.25 * material.coat, straight }
    }

    /// Whether there is any gloss.
    fn is_any(&self) -> bool {
        self.film > 0.0 || self.straight > 0.0
    }

    /// π times what a source's gloss sends along a unit way, over what it carries.
    #[inline(always)]
    fn sent(&self, source: &Source, way: Vec3) -> f32 {
        let half = add(way, source.back);
        let square = max(dot(half, half), 1e-6);
        let inverse = 1.0 / square.sqrt();
        let cosine = dot(source.normal, half) * inverse;
        // Half the length of the sum is the cosine between way and half vector.
        let fresnel = coat_fresnel(0.5 * square * inverse);
        let shown = max(dot(source.normal, way), 0.5 * source.alpha);
        let base = max(self.straight, fresnel - 0.04) * ggx(cosine, source.alpha) * 0.25 / shown;
        let base = if self.straight > 0.0 { base } else { 0.0 };
        PI * (base + self.film * fresnel * self.coat.density(cosine) * source.cosine)
    }
}

/// A surface of other lanes.
#[inline(always)]
fn gathered(from: &Surface, lanes: &[usize; LANES]) -> Surface {
    let some = |v: &Lane| std::array::from_fn(|i| v[lanes[i]]);
    let each = |v: &Lane3| [0, 1, 2].map(|k| some(&v[k]));
    Surface {
        position: each(&from.position),
        normal: each(&from.normal),
        view: each(&from.view),
        albedo: each(&from.albedo),
        roughness: some(&from.roughness),
    }
}
