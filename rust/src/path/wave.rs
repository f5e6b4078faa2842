//! Waves of paths: all paths of a band of tiles take a step together.

use crate::lanes::*;
use crate::material::{Led, Surface, add_light};
use crate::path::afloat::Afloat;
use crate::path::lobes::{Bounce, Draw, bounce};
use crate::path::random::{dimension, hash, point, unit};
use crate::path::ray::{self, Hit};
use crate::path::shadow::{Request, Requests};
use crate::path::through::Entry;
use crate::path::walk::{Exit, offset};
use crate::path::{First, Settings};
use crate::render::REACH;
use crate::scene::SceneData;
use crate::shade::{attributes_at, surface};
use crate::tile::{Hits, MISS};
use crate::wall::Wall;

/// Paths of one wave, about: enough that ways to an LED have neighbours, few enough for a cache.
const WAVE: usize = 65_536;
/// Reflections that every path takes; after them a path may end early (Russian roulette).
const FIRM: u32 = 2;

/// What paths travel in.
pub struct Tracer<'a> {
    /// The wall.
    pub wall: &'a Wall,
    /// What is drawn on it.
    pub scene: &'a SceneData,
    /// LEDs about the wall's centre.
    pub leds: &'a [Led],
    /// Angle between neighbouring pixels [rad].
    pub pixel_angle: f32,
    /// How paths are traced.
    pub settings: Settings,
    /// What floats in the lumen, if anything does.
    pub afloat: Option<Afloat<'a>>,
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
}

/// Radiance [W/(sr·m²)] that surfaces of a band's tiles send to the viewer beyond direct light.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn indirect(tracer: &Tracer<'_>, firsts: &[First]) -> Vec<Lane3> {
    let Settings { samples, depth, .. } = tracer.settings;
    let mut sums = vec![[0.0f64; 3]; firsts.len() * LANES];
    let leds: Vec<Vec3> = tracer.leds.iter().map(|led| led.position).collect();
    let mut wave = Wave::default();
    let count = (WAVE / (firsts.len() * LANES).max(1)).max(1) as u32;
    let is_needed = depth > 1 || depth == 1 && tracer.scene.tissue.is_some();
    let mut done = if is_needed && !leds.is_empty() { 0 } else { samples };
    while done < samples {
        let after = samples.min(done.saturating_add(count));
        tracer.set_out(firsts, done..after, &mut wave);
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

impl Tracer<'_> {
    /// Starts paths from what the camera sees.
    #[inline(always)]
    fn set_out(&self, firsts: &[First], samples: std::ops::Range<u32>, wave: &mut Wave) {
        let seed = self.settings.seed;
        let key = hash(hash(seed as u32) ^ (seed >> 32) as u32);
        for (tile, first) in firsts.iter().enumerate() {
            let facets = self.facets(&first.triangle, &first.surface);
            let keys = first.pixel.map(|pixel| hash(key ^ hash(pixel)));
            let bare = self.bare(&first.surface, &first.triangle);
            for sample in samples.clone() {
                let own = std::array::from_fn(|i| Path {
                    origin: at(&first.surface.position, i),
                    direction: [0.0; 3],
                    throughput: [1.0; 3],
                    pixel: (tile * LANES + i) as u32,
                    key: keys[i],
                    sample,
                    from: first.triangle[i],
                });
                let from = (&first.surface, bare.as_ref(), &facets);
                self.send_on(1, from, (&own, &first.hit), (&mut wave.paths, &mut wave.entries));
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
            let hit = ray::cast::<false>(&self.wall.bvh, origin, direction, REACH, from);
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
        let lit = bare.as_ref().unwrap_or(&surface);
        let light = |led: &Led, radiance: &mut Lane3| {
            add_light(lit, &self.scene.material, led, &[true; LANES], radiance);
        };
        self.ask(reflection, &surface.position, light, &own[..block.len()], requests);
        if reflection == self.settings.depth && bare.is_none() {
            return;
        }
        let facets = self.facets(&triangles, &surface);
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
        let stays = match &self.scene.tissue {
            Some(tissue) => self.enter(reflection, tissue, (surface, facets), (own, used), entries),
            None => [1.0; LANES],
        };
        if reflection == self.settings.depth {
            return;
        }
        let (keys, samples) = (own.map(|path| path.key), own.map(|path| path.sample));
        let out = self.scattered(bare.unwrap_or(surface), &keys, &samples, reflection);
        for i in (0..LANES).filter(|&i| used[i] && stays[i] > 0.0) {
            let weight = scale(at(&out.weight, i), 1.0 / stays[i]);
            let mut path = own[i];
            path.direction = at(&out.direction, i);
            path.throughput = [0, 1, 2].map(|k| path.throughput[k] * weight[k]);
            if self.survives(reflection, &mut path) {
                self.go_on(path, at(facets, i), next);
            }
        }
    }

    /// Asks for the light of one LED on each of the places that `paths` have come to; `light` adds
    /// what an LED would leave there.
    #[inline(always)]
    pub(super) fn ask(
        &self,
        reflection: u32,
        position: &Lane3,
        light: impl Fn(&Led, &mut Lane3),
        paths: &[Path],
        requests: &mut Requests,
    ) {
        let mut throughput = [[0.0; LANES]; 3];
        let mut number = [0.0; LANES];
        for (i, path) in paths.iter().enumerate() {
            number[i] = point(dimension(path.key, 4 * reflection + 2), path.sample)[0];
            for k in 0..3 {
                throughput[k][i] = path.throughput[k];
            }
        }
        let light = self.one_led(light, &throughput, number);
        for (i, path) in paths.iter().enumerate().filter(|&(i, _)| light.weight[i] > 0.0) {
            let factor = light.total[i] / light.weight[i];
            let radiance = at(&light.radiance, i);
            requests.open.push(Request {
                point: at(position, i),
                light: [0, 1, 2].map(|k| path.throughput[k] * radiance[k] * factor),
                pixel: path.pixel,
                led: light.led[i],
            });
        }
    }

    /// Ends some of the paths that carry little and makes up for them with the others.
    #[inline(always)]
    pub(super) fn survives(&self, reflection: u32, path: &mut Path) -> bool {
        if reflection < FIRM {
            return true;
        }
        let [r, g, b] = path.throughput;
        let chance = min(max(r, max(g, b)), 1.0);
        let number = hash(dimension(path.key, 4 * reflection + 3) ^ hash(path.sample));
        path.throughput = scale(path.throughput, 1.0 / max(chance, 1e-20));
        unit(number) < chance
    }

    /// Adds a path unless it carries nothing or leads into the wall, whose unit normal is `facet`.
    #[inline(always)]
    pub(super) fn go_on(&self, mut path: Path, facet: Vec3, paths: &mut Vec<Path>) {
        let [r, g, b] = path.throughput;
        if (max(r, max(g, b)) > 0.0) & (dot(path.direction, facet) > 0.0) {
            path.origin = add(path.origin, scale(facet, offset(self.wall)));
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
        bounce(surface, &self.scene.material, &draw)
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
        let found = attributes_at(self.wall, self.scene, position, view, &hits);
        let mut surface = surface(self.scene, &found, &hits.distance, self.pixel_angle);
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
            let [a, b, c] = self.wall.bvh.triangles[triangles[i] as usize].corners;
            let normal = normalize(cross(sub(b, a), sub(c, a)));
            let side = if dot(normal, at(&surface.view, i)) < 0.0 { -1.0 } else { 1.0 };
            for k in 0..3 {
                facets[k][i] = side * normal[k];
            }
        }
        facets
    }

    /// Chooses one LED for each lane in proportion to what it would add to the pixel unshadowed.
    #[inline(always)]
    fn one_led(
        &self,
        light: impl Fn(&Led, &mut Lane3),
        throughput: &Lane3,
        mut number: Lane,
    ) -> OneLed {
        let mut out = OneLed {
            led: [0; LANES],
            radiance: [[0.0; LANES]; 3],
            weight: [0.0; LANES],
            total: [0.0; LANES],
        };
        for (led_number, led) in self.leds.iter().enumerate() {
            let mut radiance = [[0.0; LANES]; 3];
            light(led, &mut radiance);
            for i in 0..LANES {
                let [r, g, b] = at(throughput, i);
                let weight = r * radiance[0][i] + g * radiance[1][i] + b * radiance[2][i];
                let total = out.total[i] + weight;
                let share = if total > 0.0 { weight / total } else { 0.0 };
                // One number decides all: within each outcome it is even again.
                let chosen = number[i] < share;
                number[i] = if chosen {
                    number[i] / share
                } else {
                    (number[i] - share) / max(1.0 - share, 1e-7)
                };
                out.total[i] = total;
                out.led[i] = if chosen { led_number as u32 } else { out.led[i] };
                out.weight[i] = if chosen { weight } else { out.weight[i] };
                for k in 0..3 {
                    out.radiance[k][i] = if chosen { radiance[k][i] } else { out.radiance[k][i] };
                }
            }
        }
        out
    }
}

/// One LED for each lane.
struct OneLed {
    led: [u32; LANES],
    /// Radiance that the surface would leave of its light.
    radiance: Lane3,
    /// What the choice went by: of this LED, and of all.
    weight: Lane,
    total: Lane,
}
