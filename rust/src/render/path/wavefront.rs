//! Waves of paths: all paths of a band of tiles take a step together.

use crate::render::frame::REACH;
use crate::render::material::{Led, Surface, add_light};
use crate::render::path::bsdf::{Bounce, Draw, bounce};
use crate::render::path::light_paths::{Lit, density};
use crate::render::path::lumen_contents::Afloat;
use crate::render::path::resampling::Room;
use crate::render::path::shadow_rays::Requests;
use crate::render::path::sobol::{dimension, hash, point, unit};
use crate::render::path::subsurface::{Exit, offset};
use crate::render::path::subsurface_paths::Entry;
use crate::render::path::virtual_lights::{Shares, Sources};
use crate::render::path::{First, Settings};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, MISS};
use crate::wall::ray::{self, Hit};

/// Paths of one wave, about: enough that ways to an LED have neighbours, few enough for a cache.
const WAVE: usize = 65_536;
/// Reflections that every path takes; after them a path may end early (Russian roulette).
const FIRM: u32 = 2;
/// Chance that a path goes on, over what it carries: most of the noise is light of late
/// reflections, which are few, so that more of them pay.
const KEPT: f32 = 3.0;

/// Samples for which one path goes on where surfaces are connected to sources.
const EACH: u32 = 2;
/// Most samples that choose from the same sources.
const CONNECTED: usize = 16;

/// What the camera's paths travel in.
pub struct Tracer<'a> {
    /// What the LEDs' paths travel in, too.
    pub lit: Lit<'a>,
    /// What floats in the lumen, if anything does.
    pub afloat: Option<Afloat<'a>>,
    /// Where the LEDs' light comes from, if surfaces are connected to that.
    pub sources: Option<&'a Sources>,
    /// Light paths whose sources a surface is offered at a time.
    pub offered: usize,
}

/// A path on its way from one surface to the next.
#[derive(Clone, Copy)]
pub(super) struct Path {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
    /// What the pixel gets of a unit of radiance found along it.
    pub(super) throughput: Vec3,
    /// Number of its pixel among the sums.
    pub(super) pixel: u32,
    /// Key of its pixel's random numbers.
    pub(super) key: u32,
    pub(super) sample: u32,
    /// Triangle it leaves.
    pub(super) from: u32,
    /// Density with which it was drawn, where its surface may be connected to a source: of its
    /// direction [1/sr] on the way there, of its place [1/m²] there; infinite elsewhere.
    pub(super) density: f32,
    /// Part of the throughput that is gloss, where the density is finite.
    pub(super) gloss: f32,
}

impl Path {
    /// What is left for the path itself of light that base and gloss of the place it has come to
    /// reflect, beside sources of which each of so many light paths leaves so many there [1/m²].
    #[inline(always)]
    fn own(&self, density: f32, paths: usize) -> [Vec3; 2] {
        let Shares { base, gloss } = Shares::new(density, self.density, paths);
        let shiny = (1.0 - gloss) * self.gloss;
        let matt = self.throughput.map(|t| (1.0 - base) * (t - self.gloss) + shiny);
        [matt, scale(self.throughput, 1.0 - gloss)]
    }
}

/// Paths at one step, and room for the next.
#[derive(Default)]
pub(super) struct Wave {
    pub(super) paths: Vec<Path>,
    pub(super) next: Vec<Path>,
    met: Vec<(u32, Hit)>,
    pub(super) entries: Vec<Entry>,
    pub(super) exits: Vec<(Path, Exit)>,
    pub(super) requests: Requests,
    room: Room,
}

/// Radiance [W/(sr·m²)] that surfaces of a band's tiles send to the viewer beyond direct light.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn indirect(tracer: &Tracer<'_>, firsts: &[First]) -> Vec<Lane3> {
    let Settings { samples, depth, .. } = tracer.lit.settings;
    let mut sums = vec![[0.0f64; 3]; firsts.len() * LANES];
    let leds: Vec<Vec3> = tracer.lit.leds.iter().map(|led| led.position).collect();
    let mut wave = Wave::default();
    let count = at_once(firsts.len());
    let is_needed = depth > 1 || depth == 1 && tracer.lit.scene.tissue.is_some();
    let mut done = if is_needed && !leds.is_empty() { 0 } else { samples };
    while done < samples {
        let after = samples.min(done.saturating_add(count));
        tracer.set_out(firsts, done..after, &mut wave, &mut sums);
        for reflection in 1..=depth {
            if reflection > 1 {
                tracer.step(reflection, &mut wave);
            }
            tracer.walk(reflection, &mut wave);
            wave.requests.settle(tracer, &leds, &mut sums);
            if wave.paths.is_empty() {
                break;
            }
        }
        wave.paths.clear();
        done = after;
    }
    let mean = 1.0 / f64::from(samples);
    let tiles = sums.chunks_exact(LANES);
    tiles
        .map(|tile| [0, 1, 2].map(|k| std::array::from_fn(|i| (tile[i][k] * mean) as f32)))
        .collect()
}

/// Samples of so many tiles that make a wave.
pub fn at_once(tiles: usize) -> u32 {
    (WAVE / (tiles * LANES).max(1)).max(1) as u32
}

impl Tracer<'_> {
    /// Starts paths from what the camera sees.
    #[inline(always)]
    fn set_out(
        &self,
        firsts: &[First],
        samples: std::ops::Range<u32>,
        wave: &mut Wave,
        sums: &mut [[f64; 3]],
    ) {
        let seed = self.lit.settings.seed;
        let key = hash(hash(seed as u32) ^ (seed >> 32) as u32);
        let each = if self.sources.is_some() { EACH } else { 1 };
        let own = samples.start.div_ceil(each)..samples.end.div_ceil(each);
        let weight =
            self.lit.settings.samples as f32 / self.lit.settings.samples.div_ceil(each) as f32;
        for (tile, first) in firsts.iter().enumerate() {
            let facets = self.facets(&first.triangle, &first.surface);
            let keys = first.pixel.map(|pixel| hash(key ^ hash(pixel)));
            let bare = self.bare(&first.surface, &first.triangle);
            if let Some(sources) = self.sources {
                let sums = &mut sums[tile * LANES..(tile + 1) * LANES];
                for start in samples.clone().step_by(CONNECTED) {
                    let some = start..samples.end.min(start + CONNECTED as u32);
                    let room = (&mut wave.room, &mut *sums);
                    self.connect(sources, (first, &facets), (&keys, some), room);
                }
            }
            for sample in own.clone() {
                let paths = std::array::from_fn(|i| Path {
                    origin: at(&first.surface.position, i),
                    direction: [0.0; 3],
                    throughput: [weight; 3],
                    pixel: (tile * LANES + i) as u32,
                    key: keys[i],
                    sample,
                    from: first.triangle[i],
                    density: f32::INFINITY,
                    gloss: 0.0,
                });
                let from = (&first.surface, bare.as_ref(), &facets);
                self.send_on(1, from, (&paths, &first.hit), (&mut wave.paths, &mut wave.entries));
            }
        }
    }

    /// Takes all paths to the next surface, asks for light there, and sends them on.
    #[inline(always)]
    fn step(&self, reflection: u32, wave: &mut Wave) {
        let Wave { paths, next, met, entries, requests, .. } = wave;
        met.clear();
        for (number, path) in paths.iter_mut().enumerate() {
            let Path { origin, direction, from, .. } = *path;
            let hit = ray::cast::<false>(&self.lit.wall.bvh, origin, direction, REACH, from);
            let Some(mut hit) = hit else { continue };
            if let Some(afloat) = &self.afloat {
                let left;
                (hit, left) = afloat.meet(origin, direction, from, hit);
                path.throughput = [0, 1, 2].map(|k| path.throughput[k] * left[k]);
            }
            met.push((number as u32, hit));
        }
        next.clear();
        for block in met.chunks(LANES) {
            self.shade(reflection, block, paths, (next, entries, requests));
        }
        std::mem::swap(paths, next);
    }

    /// Shades up to `LANES` surfaces met.
    #[inline(always)]
    fn shade(
        &self,
        reflection: u32,
        block: &[(u32, Hit)],
        paths: &[Path],
        (next, entries, requests): (&mut Vec<Path>, &mut Vec<Entry>, &mut Requests),
    ) {
        let mut own: [Path; LANES] =
            std::array::from_fn(|i| paths[block[i.min(block.len() - 1)].0 as usize]);
        let surface = self.met(block, &own);
        let triangles = std::array::from_fn(|i| block.get(i).map_or(MISS, |met| met.1.triangle));
        let bare = self.bare(&surface, &triangles);
        let facets = self.facets(&triangles, &surface);
        let (mut lit, mut asking) = (bare.clone().unwrap_or_else(|| surface.clone()), own);
        if let Some(sources) = self.sources.filter(|_| reflection == 2) {
            for (i, (_, hit)) in block.iter().enumerate() {
                let cosine = max(-dot(own[i].direction, at(&facets, i)), 0.0);
                own[i].density *= cosine / (hit.distance * hit.distance);
                let sent = density(&sources.lamps, at(&surface.position, i), at(&facets, i));
                let [matt, shiny] = own[i].own(sent, self.offered);
                // The base is dimmed instead of the light that comes.
                for k in 0..3 {
                    lit.albedo[k][i] *= matt[k] / max(shiny[k], 1e-30);
                }
                asking[i].throughput = shiny;
            }
        }
        let light = |led: &Led, radiance: &mut Lane3| {
            add_light(&lit, &self.lit.scene.material, led, &[true; LANES], radiance);
        };
        self.ask(reflection, &surface.position, light, &asking[..block.len()], requests);
        if reflection == self.lit.settings.depth && bare.is_none() {
            return;
        }
        for i in 0..LANES {
            own[i].origin = at(&surface.position, i);
            own[i].from = triangles[i];
        }
        let used = std::array::from_fn(|i| i < block.len());
        let from = (&surface, bare.as_ref(), &facets);
        self.send_on(reflection, from, (&own, &used), (next, entries));
    }

    /// Sends paths on from a surface: along the wall, or into the tissue behind it.
    ///
    /// `bare` is the surface without the base that tissue stands for.
    #[inline(always)]
    fn send_on(
        &self,
        reflection: u32,
        (surface, bare, facets): (&Surface, Option<&Surface>, &Lane3),
        (own, used): (&[Path; LANES], &[bool; LANES]),
        (next, entries): (&mut Vec<Path>, &mut Vec<Entry>),
    ) {
        let stays = match &self.lit.scene.tissue {
            Some(tissue) => self.enter(reflection, tissue, (surface, facets), (own, used), entries),
            None => [1.0; LANES],
        };
        if reflection == self.lit.settings.depth {
            return;
        }
        let (keys, samples) = (own.map(|path| path.key), own.map(|path| path.sample));
        let out = self.scattered(bare.unwrap_or(surface), &keys, &samples, reflection);
        for i in (0..LANES).filter(|&i| used[i] && stays[i] > 0.0) {
            let weight = scale(at(&out.weight, i), 1.0 / stays[i]);
            let mut path = own[i];
            path.direction = at(&out.direction, i);
            if let Some(sources) = self.sources {
                let cosine = max(dot(path.direction, at(facets, i)), 0.0);
                [path.throughput, _] = path.own(2.0 * cosine * sources.scattered, self.offered);
                let is_first = reflection == 1;
                path.density = if is_first { out.density[i] } else { f32::INFINITY };
                path.gloss = if is_first { path.throughput[0] * out.gloss[i] } else { 0.0 };
            }
            path.throughput = [0, 1, 2].map(|k| path.throughput[k] * weight[k]);
            if self.survives(reflection, &mut path) {
                self.go_on(path, at(facets, i), next);
            }
        }
    }

    /// Ends some of the paths that carry little and makes up for them with the others.
    #[inline(always)]
    pub(super) fn survives(&self, reflection: u32, path: &mut Path) -> bool {
        if reflection < FIRM {
            return true;
        }
        let [r, g, b] = path.throughput;
        let chance = min(KEPT * max(r, max(g, b)), 1.0);
        let number = hash(dimension(path.key, 4 * reflection + 3) ^ hash(path.sample));
        path.throughput = scale(path.throughput, 1.0 / max(chance, 1e-20));
        unit(number) < chance
    }

    /// Adds a path unless it carries nothing or leads into the wall, whose unit normal is `facet`.
    #[inline(always)]
    pub(super) fn go_on(&self, mut path: Path, facet: Vec3, paths: &mut Vec<Path>) {
        let [r, g, b] = path.throughput;
        if (max(r, max(g, b)) > 0.0) & (dot(path.direction, facet) > 0.0) {
            path.origin = add(path.origin, scale(facet, offset(self.lit.wall)));
            paths.push(path);
        }
    }

    #[inline(always)]
    fn scattered(
        &self,
        surface: &Surface,
        keys: &[u32; LANES],
        samples: &[u32; LANES],
        reflection: u32,
    ) -> Bounce {
        let mut draw = Draw { lobe: [0.0; LANES], way: [[0.0; LANES]; 2] };
        for i in 0..LANES {
            let way = point(dimension(keys[i], 4 * reflection), samples[i]);
            let lobe = point(dimension(keys[i], 4 * reflection + 1), samples[i]);
            draw.lobe[i] = lobe[0];
            draw.way[0][i] = way[0];
            draw.way[1][i] = way[1];
        }
        bounce(surface, &self.lit.scene.material, &draw)
    }

    /// The surfaces that paths met.
    #[inline(always)]
    fn met(&self, block: &[(u32, Hit)], paths: &[Path; LANES]) -> Surface {
        let mut hits = Hits::within([0.0; LANES]);
        let (mut position, mut view) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for (i, (_, hit)) in block.iter().enumerate() {
            hits.distance[i] = hit.distance;
            hits.triangle[i] = hit.triangle;
            for k in 0..3 {
                hits.edges[k][i] = hit.edges[k];
                position[k][i] = paths[i].origin[k] + hit.distance * paths[i].direction[k];
                view[k][i] = -paths[i].direction[k];
            }
        }
        let mut surface = self.lit.surface(position, view, &hits);
        if let Some(afloat) = &self.afloat {
            afloat.show(block, &mut surface);
        }
        surface
    }

    /// Unit normals of the faces on the viewer's side; the surface's own where there is no face.
    #[inline(always)]
    fn facets(&self, triangles: &[u32; LANES], surface: &Surface) -> Lane3 {
        let mut facets = surface.normal;
        for i in (0..LANES).filter(|&i| triangles[i] != MISS) {
            let [a, b, c] = self.lit.wall.bvh.triangles[triangles[i] as usize].corners;
            let normal = normalize(cross(sub(b, a), sub(c, a)));
            let side = if dot(normal, at(&surface.view, i)) < 0.0 { -1.0 } else { 1.0 };
            for k in 0..3 {
                facets[k][i] = side * normal[k];
            }
        }
        facets
    }
}
