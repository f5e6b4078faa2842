//! Camera-path tracer and path state, shared by all parts of path tracing.

use crate::render::material::Surface;
use crate::render::path::light_paths::LightTransport;
use crate::render::path::lumen_contents::LumenMedia;
use crate::render::path::sobol::{dimension, hash, unit};
use crate::render::path::subsurface::ray_offset;
use crate::render::path::virtual_lights::{MisWeights, VirtualLights};
use crate::simd::f32x64::*;
use crate::wall::packet::MISS;

/// Number of reflections of every path; after them a path may end early (Russian roulette).
const RR_MIN_BOUNCES: u32 = 2;
/// Russian roulette: survival probability over throughput. Most noise comes from late reflections;
/// they are few, so more of them are worth their cost.
const RR_SURVIVAL: f32 = 3.0;

/// Tracer of camera paths.
pub struct Tracer<'a> {
    /// Light transport, shared with the light paths.
    pub transport: LightTransport<'a>,
    /// Lumen contents; None for an empty lumen.
    pub media: Option<LumenMedia<'a>>,
    /// Virtual lights of the LEDs, if surfaces are connected to them.
    pub sources: Option<&'a VirtualLights>,
    /// Number of light paths whose virtual lights are candidates at a time.
    pub candidate_paths: usize,
}

/// A path between two surfaces.
#[derive(Clone, Copy)]
pub struct Path {
    pub origin: Vec3,
    pub direction: Vec3,
    /// Weight of its radiance in the pixel.
    pub throughput: Vec3,
    /// Index of its pixel among the sums.
    pub pixel: u32,
    /// Key of its pixel's random numbers.
    pub key: u32,
    pub sample: u32,
    /// Triangle that it leaves.
    pub from: u32,
    /// Sampling density where its surface may be connected to a virtual light: of its direction
    /// [1/sr] before the hit, of its position [1/m²] at the hit; infinite elsewhere.
    pub density: f32,
    /// Part of the throughput from gloss, where the density is finite.
    pub gloss: f32,
}

impl Path {
    /// MIS weights of the path for the light that base and gloss of its current point reflect,
    /// relative to virtual lights; `density` is that of one light path's virtual lights there
    /// [1/m²], `paths` the number of light paths.
    #[inline(always)]
    pub fn own(&self, density: f32, paths: usize) -> [Vec3; 2] {
        let MisWeights { base, gloss } = MisWeights::new(density, self.density, paths);
        let shiny = (1.0 - gloss) * self.gloss;
        let matt = self.throughput.map(|t| (1.0 - base) * (t - self.gloss) + shiny);
        [matt, scale(self.throughput, 1.0 - gloss)]
    }
}

impl Tracer<'_> {
    /// Ends some paths of low throughput and reweights the others (Russian roulette).
    #[inline(always)]
    pub fn survives_roulette(&self, reflection: u32, path: &mut Path) -> bool {
        if reflection < RR_MIN_BOUNCES {
            return true;
        }
        let [r, g, b] = path.throughput;
        let chance = min(RR_SURVIVAL * max(r, max(g, b)), 1.0);
        let number = hash(dimension(path.key, 4 * reflection + 3) ^ hash(path.sample));
        path.throughput = scale(path.throughput, 1.0 / max(chance, 1e-20));
        unit(number) < chance
    }

    /// Adds a path unless its throughput is zero or it leads into the wall, whose unit normal is
    /// `face_normal`.
    #[inline(always)]
    pub fn extend_path(&self, mut path: Path, face_normal: Vec3, paths: &mut Vec<Path>) {
        let [r, g, b] = path.throughput;
        if (max(r, max(g, b)) > 0.0) & (dot(path.direction, face_normal) > 0.0) {
            path.origin = add(path.origin, scale(face_normal, ray_offset(self.transport.wall)));
            paths.push(path);
        }
    }

    /// A surface without the base that the tissue replaces, if light passes through tissue.
    #[inline(always)]
    pub fn without_base(&self, surface: &Surface, triangles: &[u32; LANES]) -> Option<Surface> {
        self.transport.scene.tissue.as_ref().map(|_| surface.without_base(triangles))
    }
    /// Unit normals of the faces on the viewer's side; the surface's normal if there is no face.
    #[inline(always)]
    pub fn face_normals(&self, triangles: &[u32; LANES], surface: &Surface) -> Lane3 {
        let mut face_normals = surface.normal;
        for i in (0..LANES).filter(|&i| triangles[i] != MISS) {
            let [a, b, c] = self.transport.wall.bvh.triangles[triangles[i] as usize].corners;
            let normal = normalize(cross(sub(b, a), sub(c, a)));
            let side = if dot(normal, at(&surface.view, i)) < 0.0 { -1.0 } else { 1.0 };
            for k in 0..3 {
                face_normals[k][i] = side * normal[k];
            }
        }
        face_normals
    }
}
