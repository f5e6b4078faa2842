//! Points of the wall that send light of the LEDs on: where light paths from the LEDs meet it
//! (Veach 1997, chapter 10; Keller 1997, *Instant radiosity*).
//!
//! A place that is connected to a source has the light of one path and all its reflections from there.

use crate::render::material::gloss_alpha;
use crate::render::path::Settings;
use crate::render::path::light_paths::{Arrival, Lamp, Lit, go_on, lamps, leave};
use crate::render::path::sobol::{dimension, hash};
use crate::simd::f32x64::*;
use crate::wall::packet::Hits;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Light paths of a block, and most blocks that a place is offered at a time.
const BLOCK: usize = 128;
const OFFERED: usize = 8;
/// Light paths that a place is offered for each of its samples.
const EACH: usize = 64;
/// Most blocks of an image, and how many paths of the camera there are for a light path.
const MOST: u64 = 512;
const PATHS: u64 = 4;
/// What a path's own way counts beside light paths: more where there is gloss, whose sources throw
/// spots of light that neighbours would share.
pub const OWN: Shares = Shares { base: 1.0, gloss: 16.0 };
/// Least cosine at which light is taken to come to a source, where sources are chosen.
const LEAST_COSINE: f32 = 0.05;

/// A point of the wall with light to send on.
#[derive(Clone, Copy)]
pub struct Source {
    /// Place [m].
    pub point: Vec3,
    /// Triangle, in leaf order.
    pub triangle: u32,
    /// As in `Hit::edges`, met from where its light comes from.
    pub edges: Vec3,
    /// Unit normal of the triangle on that side.
    pub facet: Vec3,
    /// Unit direction to where its light comes from.
    pub back: Vec3,
    /// What a light path brings, over the density of its reflection [W/sr·…]: times reflectance and
    /// cosine it is radiant intensity [W/sr].
    pub carried: Vec3,
    /// Sources of a light path at this place, about [1/m²].
    pub density: f32,
    /// About π times what its base sends straight out [W/sr].
    pub sent: Vec3,
    /// Unit normal with relief, roughness α of the gloss, and the cosine at which its light comes.
    pub normal: Vec3,
    pub alpha: f32,
    pub cosine: f32,
    /// A matt place finds it as often by its own paths where cosines over square distance are the
    /// number of light paths over this [m²].
    pub near: f32,
    /// Reflections of its light with the one that it waits for.
    pub order: u32,
}

/// All sources of an image.
pub struct Sources {
    /// Block by block, in each those that lie together in a row.
    all: Vec<Source>,
    /// First source of each block; one number more than blocks.
    starts: Vec<usize>,
    /// Density of sources of light reflected before, about, were all light to come straight [1/m²].
    pub scattered: f32,
    /// LEDs that shine.
    pub lamps: Vec<Lamp>,
}

/// Sources of some light paths.
pub struct Offer<'a> {
    /// The sources.
    pub sources: &'a [Source],
    /// Number of light paths.
    pub paths: usize,
}

/// Shares of sources in the light of a place.
pub struct Shares {
    /// In light that base reflects from base.
    pub base: f32,
    /// In light in which gloss has a part.
    pub gloss: f32,
}

impl Shares {
    /// Where each of so many light paths leaves so many sources, and the camera's comes with a
    /// density of `own`; both in 1/m².
    #[inline(always)]
    pub fn new(sources: f32, own: f32, paths: usize) -> Self {
        let sources = max(paths as f32 * sources, 1e-20);
        let share = |weight: f32| sources / (sources + weight * own);
        Shares { base: share(OWN.base), gloss: share(OWN.gloss) }
    }
}

impl Sources {
    /// Of an image of so many pixels; None if no LED shines or light is reflected only once.
    pub fn new(lit: &Lit<'_>, pixels: usize) -> Option<Self> {
        let lamps = lamps(lit.leds);
        if lamps.is_empty() || lit.settings.depth < 2 {
            return None;
        }
        let paths = pixels as u64 * u64::from(lit.settings.samples);
        let count = (paths / PATHS / BLOCK as u64).clamp(OFFERED as u64, MOST) as usize;
        let mut sources = Sources { all: Vec::new(), starts: vec![0], scattered: 0.0, lamps };
        let numbers = (0..count).into_par_iter();
        let blocks: Vec<_> = numbers.map(|number| block(&sources.lamps, lit, number)).collect();
        for block in blocks {
            sources.all.extend(block);
            sources.starts.push(sources.all.len());
        }
        sources.weigh();
        Some(sources)
    }

    /// Sources of so many light paths, which a number chooses.
    #[inline(always)]
    pub fn offer(&self, number: u32, paths: usize) -> Offer<'_> {
        let count = paths / BLOCK;
        let first = number as usize % ((self.starts.len() - 1) / count) * count;
        let sources = &self.all[self.starts[first]..self.starts[first + count]];
        Offer { sources, paths }
    }

    /// Light paths whose sources a place is offered for so many samples.
    pub fn offered(samples: u32) -> usize {
        (samples as usize * EACH / BLOCK).clamp(1, OFFERED) * BLOCK
    }

    /// Finds about how many sources a light path leaves of light reflected before, by how many there
    /// are and by where the LEDs' own light comes.
    fn weigh(&mut self) {
        let (mut firsts, mut seconds, mut logarithms) = (0u32, 0u32, 0.0f64);
        for source in &self.all {
            let is_first = source.order == 1;
            firsts += u32::from(is_first);
            seconds += u32::from(source.order == 2);
            logarithms += if is_first { f64::from(log2(max(source.density, 1e-20))) } else { 0.0 };
        }
        let (firsts, seconds) = (f64::from(firsts.max(1)), f64::from(seconds));
        self.scattered = exp2((logarithms / firsts) as f32) * (seconds / firsts) as f32;
        for source in &mut self.all {
            source.density *= if source.order == 1 { 1.0 } else { self.scattered };
            source.near = OWN.base / (PI * max(source.density, 1e-20));
        }
    }
}

/// Sources of a block of light paths, neighbours on the wall in a row.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn block(lamps: &[Lamp], lit: &Lit<'_>, block: usize) -> Vec<Source> {
    let Settings { seed, depth, .. } = lit.settings;
    let key = hash(hash(seed as u32 ^ 0x5bd1_e995) ^ (seed >> 32) as u32);
    let first = (block * BLOCK) as u32;
    let mut out = Vec::new();
    for start in (first..first + BLOCK as u32).step_by(LANES) {
        let numbers = start..start + LANES as u32;
        let mut on_way: Vec<Arrival> =
            numbers.filter_map(|number| leave(lamps, lit, key, number)).collect();
        for order in 1..depth {
            out.extend(on_way.iter().map(|arrival| Source { order, ..arrival.source }));
            if order + 1 < depth && !on_way.is_empty() {
                on_way = go_on(lit, dimension(key, order), &on_way);
            }
        }
    }
    sort(&mut out);
    out.chunks_mut(LANES).for_each(|sources| color(lit, sources));
    out
}

/// Finds about what sources send.
fn color(lit: &Lit<'_>, sources: &mut [Source]) {
    let (mut hits, mut view) = (Hits::within([0.0; LANES]), [[0.0; LANES]; 3]);
    let mut position = [[0.0; LANES]; 3];
    for (i, source) in sources.iter().enumerate() {
        source.put(i, (source.facet, 0.0), (&mut hits, &mut position, &mut view));
    }
    let surface = lit.surface(position, view, &hits);
    for (i, source) in sources.iter_mut().enumerate() {
        let albedo = at(&surface.albedo, i);
        source.normal = at(&surface.normal, i);
        source.alpha = gloss_alpha(surface.roughness[i]);
        source.cosine = max(dot(source.normal, source.back), LEAST_COSINE);
        let color = albedo.map(|a| (a + Source::GLOSS) * source.cosine);
        source.sent = [0, 1, 2].map(|k| color[k] * source.carried[k]);
    }
}

impl Source {
    /// Added to base colours, so that gloss is not left out where sources are chosen.
    pub const GLOSS: f32 = 0.03;

    /// Makes it what lane `i` has met: seen from a point in a unit direction, at a distance [m].
    #[inline(always)]
    pub fn put(
        &self,
        i: usize,
        (direction, distance): (Vec3, f32),
        (hits, position, view): (&mut Hits, &mut Lane3, &mut Lane3),
    ) {
        hits.distance[i] = distance;
        hits.triangle[i] = self.triangle;
        for k in 0..3 {
            hits.edges[k][i] = self.edges[k];
            position[k][i] = self.point[k];
            view[k][i] = direction[k];
        }
    }
}

/// Puts sources in an order in which neighbours are near each other (Morton 1966).
fn sort(sources: &mut [Source]) {
    let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
    for Source { point, .. } in sources.iter() {
        low = [0, 1, 2].map(|k| min(low[k], point[k]));
        high = [0, 1, 2].map(|k| max(high[k], point[k]));
    }
    let size = (0..3).fold(1e-9, |size, k| max(size, high[k] - low[k]));
    sources.sort_by_cached_key(|Source { point, .. }| {
        let whole = |k: usize| ((point[k] - low[k]) / size * 1023.0) as u32;
        spread(whole(0)) | spread(whole(1)) << 1 | spread(whole(2)) << 2
    });
}

/// The lowest ten bits, each followed by two zeros.
fn spread(bits: u32) -> u32 {
    let bits = (bits | bits << 16) & 0x0300_00ff;
    let bits = (bits | bits << 8) & 0x0300_f00f;
    let bits = (bits | bits << 4) & 0x030c_30c3;
    (bits | bits << 2) & 0x0924_9249
}
