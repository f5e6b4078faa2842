//! Virtual point lights (VPLs): vertices of light paths on the wall (Keller 1997, *Instant
//! radiosity*; Veach 1997, chapter 10).

use crate::render::material::gloss_alpha;
use crate::render::path::Settings;
use crate::render::path::light_paths::{
    LedEmitter, LightTransport, LightVertex, VirtualLight, emit, emitters, extend_light_paths,
};
use crate::render::path::sobol::{dimension, hash};
use crate::simd::f32x64::*;
use crate::wall::packet::Hits;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Light paths per block, and the maximum number of blocks whose virtual lights are candidates.
const BLOCK: usize = 128;
const MAX_CANDIDATE_BLOCKS: usize = 8;
/// Number of candidate light paths per sample.
const CANDIDATES_PER_SAMPLE: usize = 64;
/// Maximum number of blocks of an image, and number of camera paths per light path.
const MAX_BLOCKS: u64 = 512;
const CAMERA_PATHS_PER_LIGHT_PATH: u64 = 4;
/// MIS weight of BSDF samples relative to virtual lights: higher for gloss, whose virtual lights
/// cause bright spots in neighboring pixels.
pub const PATH_WEIGHT: MisWeights = MisWeights { base: 1.0, gloss: 16.0 };
/// Minimum cosine of incident light at a virtual light, in the choice of virtual lights.
const LEAST_COSINE: f32 = 0.05;

/// All virtual lights of an image.
pub struct VirtualLights {
    /// Sorted by block; within a block, neighbors on the wall are consecutive.
    all: Vec<VirtualLight>,
    /// Index of the first virtual light of each block, and the total number at the end.
    starts: Vec<usize>,
    /// Approximate density of virtual lights of light that was reflected before, if all of it came
    /// at normal incidence [1/m²].
    pub scattered: f32,
    /// LEDs with nonzero power.
    pub emitters: Vec<LedEmitter>,
}

/// Virtual lights of some light paths, as candidates for a connection.
pub struct Candidates<'a> {
    /// The virtual lights.
    pub sources: &'a [VirtualLight],
    /// Number of light paths.
    pub paths: usize,
}

/// Multiple importance sampling (MIS) weights of virtual lights.
pub struct MisWeights {
    /// Weight of light reflected diffusely at both ends.
    pub base: f32,
    /// Weight of light with a gloss reflection.
    pub gloss: f32,
}

impl MisWeights {
    /// Weights for `sources` virtual lights per light path and a camera path of density `own` [1/m²
    /// each], given the number of light paths.
    #[inline(always)]
    pub fn new(sources: f32, own: f32, paths: usize) -> Self {
        let sources = max(paths as f32 * sources, 1e-20);
        let weight = |weight: f32| sources / (sources + weight * own);
        MisWeights { base: weight(PATH_WEIGHT.base), gloss: weight(PATH_WEIGHT.gloss) }
    }
}

impl VirtualLights {
    /// Virtual lights of an image of `pixels` pixels; None without LED power or indirect light.
    pub fn new(transport: &LightTransport<'_>, pixels: usize) -> Option<Self> {
        let emitters = emitters(transport.leds);
        if emitters.is_empty() || transport.settings.max_bounces < 2 {
            return None;
        }
        let paths = pixels as u64 * u64::from(transport.settings.spp);
        let count = (paths / CAMERA_PATHS_PER_LIGHT_PATH / BLOCK as u64)
            .clamp(MAX_CANDIDATE_BLOCKS as u64, MAX_BLOCKS) as usize;
        let mut sources =
            VirtualLights { all: Vec::new(), starts: vec![0], scattered: 0.0, emitters };
        let numbers = (0..count).into_par_iter();
        let blocks: Vec<_> =
            numbers.map(|number| block(&sources.emitters, transport, number)).collect();
        for block in blocks {
            sources.all.extend(block);
            sources.starts.push(sources.all.len());
        }
        sources.estimate_densities();
        Some(sources)
    }

    /// Virtual lights of `paths` light paths, chosen by a random number.
    #[inline(always)]
    pub fn candidates(&self, number: u32, paths: usize) -> Candidates<'_> {
        let count = paths / BLOCK;
        let first = number as usize % ((self.starts.len() - 1) / count) * count;
        let sources = &self.all[self.starts[first]..self.starts[first + count]];
        Candidates { sources, paths }
    }

    /// Number of light paths whose virtual lights are candidates for `samples` samples.
    pub fn candidate_paths(samples: u32) -> usize {
        (samples as usize * CANDIDATES_PER_SAMPLE / BLOCK).clamp(1, MAX_CANDIDATE_BLOCKS) * BLOCK
    }

    /// Estimates the density of virtual lights of light that was reflected before, from their
    /// number and from the density of those of direct light.
    fn estimate_densities(&mut self) {
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
            source.near = PATH_WEIGHT.base / (PI * max(source.density, 1e-20));
        }
    }
}

/// Virtual lights of a block of light paths, sorted by position on the wall.
#[multiversion::multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2",
    "aarch64+neon"
))]
fn block(
    emitters: &[LedEmitter],
    transport: &LightTransport<'_>,
    block: usize,
) -> Vec<VirtualLight> {
    let Settings { seed, max_bounces, .. } = transport.settings;
    let key = hash(hash(seed as u32 ^ 0x5bd1_e995) ^ (seed >> 32) as u32);
    let first = (block * BLOCK) as u32;
    let mut out = Vec::new();
    for start in (first..first + BLOCK as u32).step_by(LANES) {
        let numbers = start..start + LANES as u32;
        let mut light_paths: Vec<LightVertex> =
            numbers.filter_map(|number| emit(emitters, transport, key, number)).collect();
        for order in 1..max_bounces {
            out.extend(light_paths.iter().map(|vertex| VirtualLight { order, ..vertex.source }));
            if order + 1 < max_bounces && !light_paths.is_empty() {
                light_paths = extend_light_paths(transport, dimension(key, order), &light_paths);
            }
        }
    }
    sort_by_place(&mut out);
    out.chunks_mut(LANES).for_each(|sources| color(transport, sources));
    out
}

/// Estimates the intensity of virtual lights.
fn color(transport: &LightTransport<'_>, sources: &mut [VirtualLight]) {
    let (mut hits, mut view) = (Hits::within([0.0; LANES]), [[0.0; LANES]; 3]);
    let mut position = [[0.0; LANES]; 3];
    for (i, source) in sources.iter().enumerate() {
        source.write_lane(i, (source.face_normal, 0.0), (&mut hits, &mut position, &mut view));
    }
    let surface = transport.surface(position, view, &hits);
    for (i, source) in sources.iter_mut().enumerate() {
        let albedo = at(&surface.albedo, i);
        source.normal = at(&surface.normal, i);
        source.alpha = gloss_alpha(surface.roughness[i]);
        source.cosine = max(dot(source.normal, source.back), LEAST_COSINE);
        let color = albedo.map(|a| (a + VirtualLight::GLOSS) * source.cosine);
        source.sent = [0, 1, 2].map(|k| color[k] * source.carried[k]);
    }
}

/// Sorts virtual lights so that neighbors are near each other (Morton 1966).
fn sort_by_place(sources: &mut [VirtualLight]) {
    let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
    for VirtualLight { point, .. } in sources.iter() {
        low = [0, 1, 2].map(|k| min(low[k], point[k]));
        high = [0, 1, 2].map(|k| max(high[k], point[k]));
    }
    let size = (0..3).fold(1e-9, |size, k| max(size, high[k] - low[k]));
    sources.sort_by_cached_key(|VirtualLight { point, .. }| {
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
