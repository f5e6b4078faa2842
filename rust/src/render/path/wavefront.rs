//! Wavefront path tracing: all paths of a band of tiles advance together.

use crate::render::led::Led;
use crate::render::material::{Surface, add_light};
use crate::render::path::bsdf::{BsdfRandom, BsdfSample, sample_bsdf};
use crate::render::path::light_paths::density;
use crate::render::path::resampling::Scratch;
use crate::render::path::shadow_rays::ShadowRays;
use crate::render::path::sobol::{dimension, hash, point};
use crate::render::path::subsurface::SubsurfaceExit;
use crate::render::path::subsurface_paths::SubsurfaceEntry;
use crate::render::path::tracer::{Path, Tracer};
use crate::render::path::{PrimaryHit, Settings};
use crate::simd::f32x64::*;
use crate::wall::packet::{Hits, MAX_DISTANCE, MISS};
use crate::wall::ray::{self, Hit};

/// Approximate number of paths: shadow rays need neighbors, the paths must fit into a cache.
const WAVEFRONT_PATHS: usize = 65_536;
/// Number of samples for each continued path if surfaces are connected to virtual lights.
const SAMPLES_PER_PATH: u32 = 2;
/// Maximum number of samples that choose from the same virtual lights.
const MAX_CONNECTED_SAMPLES: usize = 16;

/// Paths of one wavefront, and scratch memory of the next.
#[derive(Default)]
struct Wavefront {
    paths: Vec<Path>,
    next: Vec<Path>,
    hits: Vec<(u32, Hit)>,
    entries: Vec<SubsurfaceEntry>,
    exits: Vec<(Path, SubsurfaceExit)>,
    requests: ShadowRays,
    scratch: Scratch,
}

/// Radiance [W/(sr·m²)] of indirect light from the surfaces of a band's tiles towards the viewer.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
pub fn indirect(tracer: &Tracer<'_>, firsts: &[PrimaryHit]) -> Vec<Lane3> {
    let Settings { spp, max_bounces, .. } = tracer.transport.settings;
    let mut sums = vec![[0.0f64; 3]; firsts.len() * LANES];
    let mut wavefront = Wavefront::default();
    let count = samples_per_wavefront(firsts.len());
    let is_needed = max_bounces > 1 || max_bounces == 1 && tracer.transport.scene.tissue.is_some();
    let mut done = if is_needed && !tracer.transport.leds.is_empty() { 0 } else { spp };
    while done < spp {
        let after = spp.min(done.saturating_add(count));
        tracer.spawn_paths(firsts, done..after, &mut wavefront, &mut sums);
        for reflection in 1..=max_bounces {
            if reflection > 1 {
                tracer.advance(reflection, &mut wavefront);
            }
            let Wavefront { paths, entries, exits, requests, .. } = &mut wavefront;
            tracer.walk_tissue_paths(reflection, entries, exits, (paths, requests));
            wavefront.requests.resolve(tracer, &mut sums);
            if wavefront.paths.is_empty() {
                break;
            }
        }
        wavefront.paths.clear();
        done = after;
    }
    let mean = 1.0 / f64::from(spp);
    let tiles = sums.chunks_exact(LANES);
    tiles
        .map(|tile| [0, 1, 2].map(|k| std::array::from_fn(|i| (tile[i][k] * mean) as f32)))
        .collect()
}

/// Number of samples of `tiles` tiles that form a wavefront.
pub fn samples_per_wavefront(tiles: usize) -> u32 {
    (WAVEFRONT_PATHS / (tiles * LANES).max(1)).max(1) as u32
}

impl Tracer<'_> {
    /// Starts paths at the primary hits.
    #[inline(always)]
    fn spawn_paths(
        &self,
        firsts: &[PrimaryHit],
        samples: std::ops::Range<u32>,
        wavefront: &mut Wavefront,
        sums: &mut [[f64; 3]],
    ) {
        let seed = self.transport.settings.seed;
        let key = hash(hash(seed as u32) ^ (seed >> 32) as u32);
        let each = if self.sources.is_some() { SAMPLES_PER_PATH } else { 1 };
        let own = samples.start.div_ceil(each)..samples.end.div_ceil(each);
        let weight =
            self.transport.settings.spp as f32 / self.transport.settings.spp.div_ceil(each) as f32;
        for (tile, first) in firsts.iter().enumerate() {
            let face_normals = self.face_normals(&first.triangle, &first.surface);
            let keys = first.pixel.map(|pixel| hash(key ^ hash(pixel)));
            let without_base = self.without_base(&first.surface, &first.triangle);
            if let Some(sources) = self.sources {
                let sums = &mut sums[tile * LANES..(tile + 1) * LANES];
                for start in samples.clone().step_by(MAX_CONNECTED_SAMPLES) {
                    let some = start..samples.end.min(start + MAX_CONNECTED_SAMPLES as u32);
                    let scratch = (&mut wavefront.scratch, &mut *sums);
                    self.connect_virtual_lights(
                        sources,
                        (first, &face_normals),
                        (&keys, some),
                        scratch,
                    );
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
                let from = (&first.surface, without_base.as_ref(), &face_normals);
                self.scatter_paths(
                    1,
                    from,
                    (&paths, &first.hit),
                    (&mut wavefront.paths, &mut wavefront.entries),
                );
            }
        }
    }

    /// Traces all paths to the next surface, requests light there, and continues them.
    #[inline(always)]
    fn advance(&self, reflection: u32, wavefront: &mut Wavefront) {
        let Wavefront { paths, next, hits, entries, requests, .. } = wavefront;
        hits.clear();
        for (number, path) in paths.iter_mut().enumerate() {
            let Path { origin, direction, from, .. } = *path;
            let hit =
                ray::cast::<false>(&self.transport.wall.bvh, origin, direction, MAX_DISTANCE, from);
            let Some(mut hit) = hit else { continue };
            if let Some(media) = &self.media {
                let left;
                (hit, left) = media.intersect(origin, direction, from, hit);
                path.throughput = [0, 1, 2].map(|k| path.throughput[k] * left[k]);
            }
            hits.push((number as u32, hit));
        }
        next.clear();
        for block in hits.chunks(LANES) {
            self.shade(reflection, block, paths, (next, entries, requests));
        }
        std::mem::swap(paths, next);
    }

    /// Shades up to `LANES` surfaces hit.
    #[inline(always)]
    fn shade(
        &self,
        reflection: u32,
        block: &[(u32, Hit)],
        paths: &[Path],
        (next, entries, requests): (&mut Vec<Path>, &mut Vec<SubsurfaceEntry>, &mut ShadowRays),
    ) {
        let mut own: [Path; LANES] =
            std::array::from_fn(|i| paths[block[i.min(block.len() - 1)].0 as usize]);
        let surface = self.hit_surfaces(block, &own);
        let triangles = std::array::from_fn(|i| block.get(i).map_or(MISS, |hits| hits.1.triangle));
        let without_base = self.without_base(&surface, &triangles);
        let face_normals = self.face_normals(&triangles, &surface);
        let (mut lit, mut asking) = (without_base.clone().unwrap_or_else(|| surface.clone()), own);
        if let Some(sources) = self.sources.filter(|_| reflection == 2) {
            for (i, (_, hit)) in block.iter().enumerate() {
                let cosine = max(-dot(own[i].direction, at(&face_normals, i)), 0.0);
                own[i].density *= cosine / (hit.distance * hit.distance);
                let sent =
                    density(&sources.emitters, at(&surface.position, i), at(&face_normals, i));
                let [matt, shiny] = own[i].own(sent, self.candidate_paths);
                // Attenuates the base instead of the incident light.
                for k in 0..3 {
                    lit.albedo[k][i] *= matt[k] / max(shiny[k], 1e-30);
                }
                asking[i].throughput = shiny;
            }
        }
        let light = |led: &Led, radiance: &mut Lane3| {
            add_light(&lit, &self.transport.scene.material, led, &[1.0; LANES], radiance);
        };
        self.request_led_light(
            reflection,
            &surface.position,
            light,
            &asking[..block.len()],
            requests,
        );
        if reflection == self.transport.settings.max_bounces && without_base.is_none() {
            return;
        }
        for i in 0..LANES {
            own[i].origin = at(&surface.position, i);
            own[i].from = triangles[i];
        }
        let used = std::array::from_fn(|i| i < block.len());
        let from = (&surface, without_base.as_ref(), &face_normals);
        self.scatter_paths(reflection, from, (&own, &used), (next, entries));
    }

    /// Continues paths from a surface: along the wall, or into the tissue behind it.
    ///
    /// `without_base` is the surface without the base that the tissue replaces.
    #[inline(always)]
    fn scatter_paths(
        &self,
        reflection: u32,
        (surface, without_base, face_normals): (&Surface, Option<&Surface>, &Lane3),
        (own, used): (&[Path; LANES], &[bool; LANES]),
        (next, entries): (&mut Vec<Path>, &mut Vec<SubsurfaceEntry>),
    ) {
        let stays = match &self.transport.scene.tissue {
            Some(tissue) => {
                self.enter_tissue(reflection, tissue, (surface, face_normals), (own, used), entries)
            }
            None => [1.0; LANES],
        };
        if reflection == self.transport.settings.max_bounces {
            return;
        }
        let (keys, samples) = (own.map(|path| path.key), own.map(|path| path.sample));
        let out =
            self.sample_directions(without_base.unwrap_or(surface), &keys, &samples, reflection);
        for i in (0..LANES).filter(|&i| used[i] && stays[i] > 0.0) {
            let weight = scale(at(&out.weight, i), 1.0 / stays[i]);
            let mut path = own[i];
            path.direction = at(&out.direction, i);
            if let Some(sources) = self.sources {
                let cosine = max(dot(path.direction, at(face_normals, i)), 0.0);
                [path.throughput, _] =
                    path.own(2.0 * cosine * sources.scattered, self.candidate_paths);
                let is_first = reflection == 1;
                path.density = if is_first { out.pdf[i] } else { f32::INFINITY };
                path.gloss = if is_first { path.throughput[0] * out.gloss[i] } else { 0.0 };
            }
            path.throughput = [0, 1, 2].map(|k| path.throughput[k] * weight[k]);
            if self.survives_roulette(reflection, &mut path) {
                self.extend_path(path, at(face_normals, i), next);
            }
        }
    }

    #[inline(always)]
    fn sample_directions(
        &self,
        surface: &Surface,
        keys: &[u32; LANES],
        samples: &[u32; LANES],
        reflection: u32,
    ) -> BsdfSample {
        let mut draw = BsdfRandom { lobe: [0.0; LANES], direction: [[0.0; LANES]; 2] };
        for i in 0..LANES {
            let direction = point(dimension(keys[i], 4 * reflection), samples[i]);
            let lobe = point(dimension(keys[i], 4 * reflection + 1), samples[i]);
            draw.lobe[i] = lobe[0];
            draw.direction[0][i] = direction[0];
            draw.direction[1][i] = direction[1];
        }
        sample_bsdf(surface, &self.transport.scene.material, &draw)
    }

    /// Surfaces that paths hit.
    #[inline(always)]
    fn hit_surfaces(&self, block: &[(u32, Hit)], paths: &[Path; LANES]) -> Surface {
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
        let mut surface = self.transport.surface(position, view, &hits);
        if let Some(media) = &self.media {
            media.shade_particles(block, &mut surface);
        }
        surface
    }
}
