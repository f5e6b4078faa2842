//! Tracer of camera paths, and one path: what every part of path tracing shares.

use crate::render::material::Surface;
use crate::render::path::light_paths::LightTransport;
use crate::render::path::lumen_contents::LumenMedia;
use crate::render::path::sobol::{dimension, hash, unit};
use crate::render::path::subsurface::ray_offset;
use crate::render::path::virtual_lights::{MisWeights, VirtualLights};
use crate::simd::f32x64::*;
use crate::wall::packet::MISS;

/// Reflections that every path takes; after them a path may end early (Russian roulette).
const RR_MIN_BOUNCES: u32 = 2;
/// Russian roulette: survival probability over throughput. Most of the noise is light of late
/// reflections, which are few, so that more of them pay.
const RR_SURVIVAL: f32 = 3.0;

/// Tracer of camera paths.
pub struct Tracer<'a> {
    /// Transport of light, shared with the LEDs' paths.
    pub transport: LightTransport<'a>,
    /// Lumen contents; None for an empty lumen.
    pub media: Option<LumenMedia<'a>>,
    /// Virtual lights of the LEDs, if surfaces are connected to them.
    pub sources: Option<&'a VirtualLights>,
    /// Light paths whose virtual lights are candidates at a time.
    pub candidate_paths: usize,
}

/// A path on its way from one surface to the next.
#[derive(Clone, Copy)]
pub struct Path {
    pub origin: Vec3,
    pub direction: Vec3,
    /// Weight of radiance found along it in the pixel.
    pub throughput: Vec3,
    /// Number of its pixel among the sums.
    pub pixel: u32,
    /// Key of its pixel's random numbers.
    pub key: u32,
    pub sample: u32,
    /// Triangle it leaves.
    pub from: u32,
    /// Density with which it was drawn, where its surface may be connected to a virtual light: of
    /// its direction [1/sr] on the way there, of its place [1/m²] there; infinite elsewhere.
    pub density: f32,
    /// Part of the throughput that is gloss, where the density is finite.
    pub gloss: f32,
}

impl Path {
    /// Weight of the path itself for the light that base and gloss of its current point reflect,
    /// next to virtual lights, of which each of the given number of light paths leaves this many
    /// there [1/m²].
    #[inline(always)]
    pub fn own(&self, density: f32, paths: usize) -> [Vec3; 2] {
        let MisWeights { base, gloss } = MisWeights::new(density, self.density, paths);
        let shiny = (1.0 - gloss) * self.gloss;
        let matt = self.throughput.map(|t| (1.0 - base) * (t - self.gloss) + shiny);
        [matt, scale(self.throughput, 1.0 - gloss)]
    }
}

impl Tracer<'_> {
    /// Ends some of the paths that carry little and makes up for them with the others.
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

    /// Adds a path unless it carries nothing or leads into the wall, whose unit normal is
    /// `face_normal`.
    #[inline(always)]
    pub fn extend_path(&self, mut path: Path, face_normal: Vec3, paths: &mut Vec<Path>) {
        let [r, g, b] = path.throughput;
        if (max(r, max(g, b)) > 0.0) & (dot(path.direction, face_normal) > 0.0) {
            path.origin = add(path.origin, scale(face_normal, ray_offset(self.transport.wall)));
            paths.push(path);
        }
    }

    /// A surface without the base that tissue stands for, if light goes through tissue.
    #[inline(always)]
    pub fn without_base(&self, surface: &Surface, triangles: &[u32; LANES]) -> Option<Surface> {
        self.transport.scene.tissue.as_ref().map(|_| surface.without_base(triangles))
    }
    /// Unit normals of the faces on the viewer's side; the surface's own where there is no face.
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
